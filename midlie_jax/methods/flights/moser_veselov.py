"""The discrete rigid body of Moser and Veselov, plain and preprocessed to order 4 or 6.

    I_i c_i = a (h/2) Pi_i + (I_j - I_k) c_j c_k,  a = 1 + |c|^2,    R1 = R0 (1, c)/sqrt(a),    Pi1 = Pi0 turned back

It moves along the trajectories of the free body, at a wrong speed and with a wrong turn about the momentum. Both
depend on constants of the motion alone, so the map becomes more accurate by starting from other moments,
1/I_i -> s/I_i + d with s and d series in h^2. The same solve at every order. Because s and d depend on the momentum,
the preprocessed maps keep the energy and the Poisson structure of the momentum, but are not symplectic together with
the attitude: the defect of a step is of the order of its error (see `tests/test_flights.py`).

J. Moser, A. P. Veselov, Comm. Math. Phys. 139 (1991) 217; E. Hairer, G. Vilmart, J. Phys. A 39 (2006) 13225.
"""

from functools import partial
from typing import Any, ClassVar

import jax
from jax import Array

from ..._kernel import components as cp
from ..._kernel.fusion import fuse
from ..._kernel.newton import newton_pairs
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight

# Pairs of steps from the explicit guess; enough for h |Omega| <= 0.7, where the roots come close to each other.
_PAIRS = 3
_RESIDUAL_LIMIT = 8  # units of eps |Pi|
# The terms of s and d cancel on a slender body that spins about a thick axis; their rounding is that of their size.
_LARGEST_TERMS = 4.0
# Beyond this, about 1.5 radians of a slender body about its thin axis, s and d lead to a root that is another motion's.
_LARGEST_SUM = 0.3


class _Preprocessed(Flight):
    """What the family shares: all but the order of the series of s and d, which is the order of the map."""

    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 1
    one_loop: ClassVar[bool] = False

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        return _fly(inertia, h, momentum, self.order)


class MoserVeselov(_Preprocessed):
    """The plain map, order 2. Useless on a fast spin, where its turn about the momentum is far off.

    Says False where the residual exceeds 8 eps |Pi|: from h |Omega| = 1 on there is no root.
    """

    name: ClassVar[str] = "DMV"
    use: ClassVar[str] = "the discrete Moser-Veselov body, for comparison: symplectic"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = True


class MoserVeselov4(_Preprocessed):
    """Preprocessed to order 4.

    Says False like the plain map, or where the series of s and d are of no use, or lose digits because terms cancel.
    """

    name: ClassVar[str] = "DMV4"
    use: ClassVar[str] = "comparison with Hairer and Vilmart's order 4"
    order: ClassVar[int | None] = 4
    symplectic: ClassVar[bool] = False


class MoserVeselov6(_Preprocessed):
    """Preprocessed to order 6.

    Says False like the plain map, or where the series of s and d are of no use, or lose digits because terms cancel.
    """

    name: ClassVar[str] = "DMV6"
    use: ClassVar[str] = "comparison with Hairer and Vilmart's order 6"
    order: ClassVar[int | None] = 6
    symplectic: ClassVar[bool] = False


def _fly(inertia: Inertia, h: Array, momentum: cp.Vector, order: int | None) -> tuple[cp.Quaternion, cp.Vector, Array]:
    spins, y = inertia.spins, inertia.travel(h, momentum)
    speed, extra, terms = _preprocessed(inertia.relative, spins, y, order)
    moments = (
        cp.reciprocal(speed * spins[0] + extra),
        cp.reciprocal(speed * spins[1] + extra),
        cp.reciprocal(speed * spins[2] + extra),
    )
    others = (moments[1] * moments[2], moments[2] * moments[0], moments[0] * moments[1])
    gaps = cp.scale(speed, cp.times(inertia.gaps, others))  # I_j - I_k
    y = cp.scale(0.5, y)

    c = _root(moments, gaps, y)
    error = _residual(moments, gaps, y, c)
    limit = _RESIDUAL_LIMIT * cp.epsilon(h)
    ok = cp.dot(error, error) <= limit * limit * cp.dot(y, y)
    # On a root beyond the first, where a > 2, the map would be another one.
    ok = ok & (cp.dot(c, c) <= 1) & (terms <= _LARGEST_TERMS)
    ok = ok & (abs(speed - 1) <= _LARGEST_SUM) & (abs(extra) <= _LARGEST_SUM)
    factor = cp.inverse_root(1 + cp.dot(c, c))
    increment = (factor, factor * c[0], factor * c[1], factor * c[2])
    return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok


def _preprocessed(i: cp.Vector, spins: cp.Vector, y: cp.Vector, order: int | None) -> tuple[Array, Array, Array]:
    """s and d, for a unit of time and a body of moments i; and the sizes of their terms, which may cancel, summed."""
    squares = cp.times(y, y)
    n, energy = 0.5 * (squares[0] + squares[1] + squares[2]), 0.5 * cp.dot(squares, spins)
    one, zero = 1 + 0 * n, 0 * n
    if order == 2:
        return one, zero, zero
    per = spins[0] * spins[1] * spins[2]  # 1 / (I1 I2 I3)
    sum_1, inverse_1 = i[0] + i[1] + i[2], spins[0] + spins[1] + spins[2]
    for_s = [sum_1 * n * per / 6, -inverse_1 * energy / 3]
    for_d = [sum_1 * energy * per / 6, -n * per / 3]
    if order == 6:
        sum_2, inverse_2 = cp.dot(i, i), cp.dot(spins, spins)
        ratios = sum_1 * inverse_1 - 3
        for_s += [
            sum_2 * per * n * n * per / 30,
            -inverse_1 * n * n * per / 30,
            (1 - ratios) * n * energy * per / 30,
            3 * sum_1 * per * energy * energy / 60,
            2 * inverse_2 * energy * energy / 60,
        ]
        for_d += [
            -sum_1 * n * n * per * per / 60,
            inverse_1 * per / 10 * n * energy,
            -sum_2 * per * per / 60 * n * energy,
            -(9 + ratios) * energy * energy * per / 60,
        ]
    sizes = [abs(term) for term in (*for_s, *for_d)]
    return sum(for_s, start=one), sum(for_d, start=zero), sum(sizes, start=zero)


@jax.custom_jvp
def _root(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector) -> cp.Vector:
    """The root c nearest zero, with the derivative of the implicit function, of any order."""
    guess = (cp.reciprocal(moments[0]) * y[0], cp.reciprocal(moments[1]) * y[1], cp.reciprocal(moments[2]) * y[2])
    c = cp.scale(1 + cp.dot(guess, guess), guess)
    return newton_pairs(partial(_residual, moments, gaps, y), partial(_slope, moments, gaps, y), c, _PAIRS)


@_root.defjvp
def _root_jvp(primals: Any, tangents: Any) -> Any:
    moments, gaps, y = primals
    c = fuse(_root(moments, gaps, y))
    inverse = cp.Inverse3.of(_slope(moments, gaps, y, c))
    _, change = jax.jvp(partial(_residual, c=c), primals, tangents)
    return c, cp.scale(-1, inverse.times(change))


def _residual(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector, c: cp.Vector) -> cp.Vector:
    """I_i c_i - a y_i - (I_j - I_k) c_j c_k."""
    products = cp.times(gaps, (c[1] * c[2], c[2] * c[0], c[0] * c[1]))
    return cp.subtract(cp.subtract(cp.times(moments, c), cp.scale(1 + cp.dot(c, c), y)), products)


def _slope(moments: cp.Vector, gaps: cp.Vector, y: cp.Vector, c: cp.Vector) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
    """Columns of the derivative of the residual in c."""
    x = cp.scale(2, c)
    return (
        (moments[0] - x[0] * y[0], -x[0] * y[1] - gaps[1] * c[2], -x[0] * y[2] - gaps[2] * c[1]),
        (-x[1] * y[0] - gaps[0] * c[2], moments[1] - x[1] * y[1], -x[1] * y[2] - gaps[2] * c[0]),
        (-x[2] * y[0] - gaps[0] * c[1], -x[2] * y[1] - gaps[1] * c[0], moments[2] - x[2] * y[2]),
    )
