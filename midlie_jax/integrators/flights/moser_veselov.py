"""The discrete rigid body of Moser and Veselov, plain and preprocessed to order 4 or 6.

    I_i c_i = a (h/2) Pi_i + (I_j - I_k) c_j c_k,  a = 1 + |c|^2,    q = (1, c)/sqrt(a),    R1 = R0 q,    Pi1 = q^-1 Pi0

The momentum of the discrete body follows the trajectories of the free body, but at a wrong speed; the rotation about
the momentum is also wrong. Both errors depend on constants of the motion alone. Preprocessing therefore corrects them
by modified moments, 1/I_i -> s/I_i + d, with s and d series in h^2. The solve is the same at every order. Because s and
d depend on the momentum, the preprocessed maps conserve the energy and the Poisson structure of the momentum. As maps
of momentum and attitude they are not symplectic: the symplectic defect of a step is of the order of its error (see
`tests/test_flights.py`).

J. Moser, A. P. Veselov, Comm. Math. Phys. 139 (1991) 217; E. Hairer, G. Vilmart, J. Phys. A 39 (2006) 13225.
"""

from functools import partial
from typing import Any, ClassVar

import jax
from jax import Array

from ..._math import components as cp
from ..._math.newton import newton_pairs
from ..._xla.fusion import split
from ...model.bodies import RigidBody
from ...model.inertia import Inertia
from ..verdict import verdict
from .base import JudgedFlight

# Pairs of Newton steps from the explicit guess: enough up to h |Omega| = 0.7, where two roots come close to each other.
_PAIRS = 3
_RESIDUAL_LIMIT = 8  # units of eps |Pi|
# Limit on the sum of the sizes of the terms of s and d. On a slender body that spins about a thick axis these terms
# cancel, and their sum has the rounding error of the largest term.
_LARGEST_TERM_SUM = 4.0
# Limit on |s - 1| and |d|. Beyond this limit, at h |Omega| of about 1.5 for a slender body that spins about its thin
# axis, s and d lead to the root of another motion.
_LARGEST_CORRECTION = 0.3


class _Preprocessed(JudgedFlight):
    """The common part of the three flights, which differ only in the order of the series of s and d."""

    solves: ClassVar[int] = 1
    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 1
    # For a spin about a principal axis c = (1 + c^2) (h/2) Omega, which has real roots only up to h |Omega| = 1, where
    # both meet at c = 1, a rotation by 90 degrees. DMV4 and DMV6 reach up to a fifth further.
    reach: ClassVar[float] = 1.0

    def judged(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        spins, y = inertia.spins, inertia.travel(h, momentum)
        s, d, term_sum = _preprocessed(inertia.relative, spins, y, self.order)
        moments = (
            cp.reciprocal(s * spins[0] + d),
            cp.reciprocal(s * spins[1] + d),
            cp.reciprocal(s * spins[2] + d),
        )
        products_of_others = (moments[1] * moments[2], moments[2] * moments[0], moments[0] * moments[1])
        gaps = cp.scale(s, cp.times(inertia.gaps, products_of_others))  # I_j - I_k
        y = cp.scale(0.5, y)

        c = _root(moments, gaps, y)
        residual = _residual(moments, gaps, y, c)
        limit = _RESIDUAL_LIMIT * cp.epsilon(h)
        solved = cp.dot(residual, residual) <= limit * limit * cp.dot(y, y)
        # A root with a > 2 is not the root nearest zero, and would give a different map.
        solved = solved & (cp.dot(c, c) <= 1)
        corrections = [(abs(s - 1), _LARGEST_CORRECTION), (abs(d), _LARGEST_CORRECTION)]
        ok = verdict(solved, (term_sum, _LARGEST_TERM_SUM), *corrections)
        factor = cp.inverse_root(1 + cp.dot(c, c))
        increment = (factor, factor * c[0], factor * c[1], factor * c[2])
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok


class MoserVeselov(_Preprocessed):
    """The plain map, order 2. Useless for a fast spin, where its rotation about the momentum is far from the true one.

    The flight reports False in `ok` if the residual exceeds 8 eps |Pi|; above h |Omega| = 1 there is no root.

    Examples:
        >>> turn, change, ok = ml.flights.MoserVeselov()(inertia, jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)  # the exact second component is 0.0502
        (Array([ 0.9982,  0.0503,  0.019 , -0.0264], dtype=float64), True)
        >>> ml.method(ml.flights.MoserVeselov(), "EA").name
        'DMV[EA]'
    """

    name: ClassVar[str] = "DMV"
    use: ClassVar[str] = "comparison with the discrete Moser-Veselov body: symplectic"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = True


class MoserVeselov4(_Preprocessed):
    """Preprocessed to order 4.

    The flight reports False in `ok` if `MoserVeselov` does, or if the series of s and d are out of range or lose digits
    by cancellation.

    Examples:
        >>> turn, change, ok = ml.flights.MoserVeselov4()(inertia, jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)
        (Array([ 0.9982,  0.0502,  0.019 , -0.0264], dtype=float64), True)
        >>> ml.method(ml.flights.MoserVeselov4(), "EA").name
        'DMV4[EA]'
    """

    name: ClassVar[str] = "DMV4"
    use: ClassVar[str] = "comparison with Hairer and Vilmart's order 4"
    order: ClassVar[int | None] = 4
    symplectic: ClassVar[bool] = False


class MoserVeselov6(_Preprocessed):
    """Preprocessed to order 6.

    The flight reports False in `ok` if `MoserVeselov` does, or if the series of s and d are out of range or lose digits
    by cancellation.

    Examples:
        >>> turn, change, ok = ml.flights.MoserVeselov6()(inertia, jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)
        (Array([ 0.9982,  0.0502,  0.019 , -0.0264], dtype=float64), True)
        >>> ml.method(ml.flights.MoserVeselov6(), "EA").name
        'DMV6[EA]'
    """

    name: ClassVar[str] = "DMV6"
    use: ClassVar[str] = "comparison with Hairer and Vilmart's order 6"
    order: ClassVar[int | None] = 6
    symplectic: ClassVar[bool] = False


def _preprocessed(i: cp.Vector, spins: cp.Vector, y: cp.Vector, order: int | None) -> tuple[Array, Array, Array]:
    """s and d for a unit of time and moments i, and the sum of the absolute values of their terms, which may cancel."""
    squares = cp.times(y, y)
    n, energy = 0.5 * (squares[0] + squares[1] + squares[2]), 0.5 * cp.dot(squares, spins)
    unit, zero = 1 + 0 * n, 0 * n
    if order == 2:
        return unit, zero, zero
    inverse_product = spins[0] * spins[1] * spins[2]  # 1 / (I1 I2 I3)
    sum_1, inverse_1 = i[0] + i[1] + i[2], spins[0] + spins[1] + spins[2]
    s_terms = [sum_1 * n * inverse_product / 6, -inverse_1 * energy / 3]
    d_terms = [sum_1 * energy * inverse_product / 6, -n * inverse_product / 3]
    if order == 6:
        sum_2, inverse_2 = cp.dot(i, i), cp.dot(spins, spins)
        ratios = sum_1 * inverse_1 - 3
        s_terms += [
            sum_2 * inverse_product * n * n * inverse_product / 30,
            -inverse_1 * n * n * inverse_product / 30,
            (1 - ratios) * n * energy * inverse_product / 30,
            3 * sum_1 * inverse_product * energy * energy / 60,
            2 * inverse_2 * energy * energy / 60,
        ]
        d_terms += [
            -sum_1 * n * n * inverse_product * inverse_product / 60,
            inverse_1 * inverse_product / 10 * n * energy,
            -sum_2 * inverse_product * inverse_product / 60 * n * energy,
            -(9 + ratios) * energy * energy * inverse_product / 60,
        ]
    sizes = [abs(term) for term in (*s_terms, *d_terms)]
    return sum(s_terms, start=unit), sum(d_terms, start=zero), sum(sizes, start=zero)


@jax.custom_jvp
def _root(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector) -> cp.Vector:
    """The root c nearest zero, with derivatives of any order by the implicit function theorem."""
    guess = (cp.reciprocal(moments[0]) * y[0], cp.reciprocal(moments[1]) * y[1], cp.reciprocal(moments[2]) * y[2])
    c = cp.scale(1 + cp.dot(guess, guess), guess)
    return newton_pairs(partial(_residual, moments, gaps, y), partial(_slope, moments, gaps, y), c, _PAIRS)


@_root.defjvp
def _root_jvp(primals: Any, tangents: Any) -> Any:
    moments, gaps, y = primals
    c = split(_root(moments, gaps, y))
    inverse = cp.Inverse3.of(_slope(moments, gaps, y, c))
    _, change = jax.jvp(partial(_residual, c=c), primals, tangents)
    return c, cp.scale(-1, inverse.times(change))


def _residual(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector, c: cp.Vector) -> cp.Vector:
    """I_i c_i - a y_i - (I_j - I_k) c_j c_k."""
    products = cp.times(gaps, (c[1] * c[2], c[2] * c[0], c[0] * c[1]))
    return cp.subtract(cp.subtract(cp.times(moments, c), cp.scale(1 + cp.dot(c, c), y)), products)


def _slope(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector, c: cp.Vector) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
    x = cp.scale(2, c)
    return (
        (moments[0] - x[0] * y[0], -x[0] * y[1] - gaps[1] * c[2], -x[0] * y[2] - gaps[2] * c[1]),
        (-x[1] * y[0] - gaps[0] * c[2], moments[1] - x[1] * y[1], -x[1] * y[2] - gaps[2] * c[0]),
        (-x[2] * y[0] - gaps[0] * c[1], -x[2] * y[1] - gaps[1] * c[0], moments[2] - x[2] * y[2]),
    )
