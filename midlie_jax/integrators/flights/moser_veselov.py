"""The discrete rigid body of Moser and Veselov, plain and preprocessed to order 4 or 6.

    I_i c_i = a (h/2) Pi_i + (I_j - I_k) c_j c_k,  a = 1 + |c|^2,    q = (1, c)/sqrt(a),    R1 = R0 q,    Pi1 = q^-1 Pi0

The momentum of the discrete body follows the trajectories of the free body, but at a wrong speed; the rotation about
the momentum is also wrong. Both errors depend on constants of the motion alone. Preprocessing corrects them by modified
moments, 1/I_i -> s/I_i + d, with s and d series in h^2. Because s and d depend on the momentum, the preprocessed maps
conserve the energy and the Poisson structure of the momentum, but are not symplectic as maps of momentum and attitude.

J. Moser, A. P. Veselov, Comm. Math. Phys. 139 (1991) 217; E. Hairer, G. Vilmart, J. Phys. A 39 (2006) 13225.
"""

from typing import ClassVar

from jax import Array

from ..._math import components as cp
from ..._math.newton import newton_pairs
from ...model.inertia import Inertia
from ..verdict import verdict
from .base import JudgedFlight

_RESIDUAL_LIMIT = 8  # units of eps |Pi|
_LARGEST_TERM_SUM = 4.0  # of the sizes of the terms of s and d, which cancel for a slender body about a thick axis
_LARGEST_CORRECTION = 0.3  # of |s - 1| and |d|, beyond which they lead to the root of another motion


class _Preprocessed(JudgedFlight):
    """The common part of the three flights, which differ only in the order of the series of s and d."""

    solves: ClassVar[int] = 1
    per_loop: ClassVar[int] = 1
    # A spin about a principal axis, c = (1 + c^2) (h/2) Omega, has real roots only up to h |Omega| = 1. DMV4 and DMV6
    # reach up to a fifth further.
    reach: ClassVar[float] = 1.0

    def judged(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        spins, y = inertia.spins, inertia.travel(h, momentum)
        s, d, term_sum = _preprocessed(inertia.relative, spins, y, self.order)
        i1, i2, i3 = (cp.reciprocal(s * spin + d) for spin in spins)
        moments = i1, i2, i3
        gaps = cp.scale(s, cp.times(inertia.gaps, cp.others(moments)))  # I_j - I_k
        y = cp.scale(0.5, y)

        c = newton_pairs(_residual, _slope, _guess, moments, gaps, y)  # the root nearest zero
        residual = _residual(moments, gaps, y, c)
        limit = _RESIDUAL_LIMIT * cp.epsilon(h)
        solved = cp.dot(residual, residual) <= limit * limit * cp.dot(y, y)
        # A root with a > 2 is not the root nearest zero, and would give a different map.
        solved = solved & (cp.dot(c, c) <= 1)
        corrections = [(abs(s - 1), _LARGEST_CORRECTION), (abs(d), _LARGEST_CORRECTION)]
        ok = verdict(solved, (term_sum, _LARGEST_TERM_SUM), *corrections)
        factor = cp.inverse_root(1 + cp.dot(c, c))
        increment = factor, *cp.scale(factor, c)
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok


class MoserVeselov(_Preprocessed):
    """The plain map, order 2. Useless for a fast spin, where its rotation about the momentum is far from the true one.

    The flight reports False in `ok` if the residual exceeds 8 eps |Pi|; above h |Omega| = 1 there is no root.

    Examples:
        >>> turn, change, ok = ml.flights.MoserVeselov()(inertia, jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)  # the exact second component is 0.0502
        (Array([ 0.9982,  0.0503,  0.019 , -0.0264], dtype=float64), True)
    """

    name: ClassVar[str] = "DMV"
    use: ClassVar[str] = "comparison with the discrete Moser-Veselov body: symplectic"
    order: ClassVar[int | None] = 2


class MoserVeselov4(_Preprocessed):
    """Preprocessed to order 4.

    The flight reports False in `ok` if `MoserVeselov` does, or if the series of s and d are out of range or lose digits
    by cancellation.

    Examples:
        >>> ml.method(ml.flights.MoserVeselov4(), "EA").name
        'DMV4[EA]'
    """

    name: ClassVar[str] = "DMV4"
    use: ClassVar[str] = "comparison with Hairer and Vilmart's order 4"
    order: ClassVar[int | None] = 4
    symplectic: ClassVar[bool] = False


class MoserVeselov6(_Preprocessed):
    """Preprocessed to order 6; reports False in `ok` as `MoserVeselov4` does.

    Examples:
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


def _guess(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector) -> cp.Vector:
    guess = (cp.reciprocal(moments[0]) * y[0], cp.reciprocal(moments[1]) * y[1], cp.reciprocal(moments[2]) * y[2])
    return cp.scale(1 + cp.dot(guess, guess), guess)


def _residual(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector, c: cp.Vector) -> cp.Vector:
    """I_i c_i - a y_i - (I_j - I_k) c_j c_k."""
    products = cp.times(gaps, cp.others(c))
    return cp.subtract(cp.subtract(cp.times(moments, c), cp.scale(1 + cp.dot(c, c), y)), products)


def _slope(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector, c: cp.Vector) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
    x = cp.scale(2, c)
    return (
        (moments[0] - x[0] * y[0], -x[0] * y[1] - gaps[1] * c[2], -x[0] * y[2] - gaps[2] * c[1]),
        (-x[1] * y[0] - gaps[0] * c[2], moments[1] - x[1] * y[1], -x[1] * y[2] - gaps[2] * c[0]),
        (-x[2] * y[0] - gaps[0] * c[1], -x[2] * y[1] - gaps[1] * c[0], moments[2] - x[2] * y[2]),
    )
