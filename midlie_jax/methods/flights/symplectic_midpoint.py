"""The mended midpoint flight: LIEMID with the factor that makes it symplectic, of order 2 or 4.

    grad S(Psi) = h dexp(-Psi) Pi0,    R1 = R0 exp(Psi),    Pi1 = exp(-Psi) Pi0

S is a generating function of the turn Psi: whatever it is, the map is symplectic, reversible and keeps the spatial
momentum. S = Psi . I Psi / 2 is the first term of the exact one (a discrete Lagrangian of the free body) and gives
order 2; with the next, -(1/24) m . I^-1 m with m = Psi x I Psi, the order is 4 at the price of the same one solve.
The paper's flight has exp(-Psi/2) where this has dexp(-Psi): the two agree to second order in Psi.
"""

from functools import partial
from typing import Any, ClassVar

import jax
from jax import Array

from ..._kernel import components as cp
from ..._kernel.fusion import fuse
from ..._kernel.newton import newton_pairs
from ..._kernel.short_series import LARGEST_SQUARE, half_turn, stumpff
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight
from .lie_midpoint import free_start

# Pairs of steps from the start below; enough for |Psi| <= .3 and the moments of any real body with ratios up to 1e3.
# Beyond that, the thinner the body the sooner a solve fails, and is refused.
_PAIRS = 3
_RESIDUAL_LIMIT = 8  # units of eps |Pi|


class _Generated(Flight):
    """What the family shares: all but the terms of the generating function, which make the order."""

    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        return _fly(inertia, h, momentum, self.order)


class SymplecticMidpoint(_Generated):
    """I Psi = h dexp(-Psi) Pi0: order 2, symplectic.

    Says False where the residual exceeds 8 eps |Pi|, or the flight turned by more than 2.4 radians or began with more
    than 12.
    """

    name: ClassVar[str] = "SLIEMID"
    use: ClassVar[str] = "the paper's flight made symplectic, for comparison with LIEMID"
    order: ClassVar[int | None] = 2
    per_loop: ClassVar[int] = 2
    one_loop: ClassVar[bool] = False


class SymplecticMidpoint4(_Generated):
    """I Psi - (1/12) (I Psi x d + I (d x Psi)) = h dexp(-Psi) Pi0, d = I^-1 (Psi x I Psi): order 4, symplectic.

    Says False like SLIEMID, or where the second term of the series outweighs the first, as on slender bodies.
    """

    name: ClassVar[str] = "SLIEMID4"
    use: ClassVar[str] = "symplectic, of order 4 with one solve; JACOBI is exact and faster"
    order: ClassVar[int | None] = 4
    per_loop: ClassVar[int] = 1
    one_loop: ClassVar[bool] = False


def _fly(inertia: Inertia, h: Array, momentum: cp.Vector, order: int | None) -> tuple[cp.Quaternion, cp.Vector, Array]:
    y = inertia.travel(h, momentum)
    turn = _turn(order, inertia, y)
    error = _residual(order, inertia, y, turn)
    limit = _RESIDUAL_LIMIT * cp.epsilon(h)
    half = half_turn(cp.scale(0.5, turn))
    ok = (cp.dot(error, error) <= limit * limit * cp.dot(y, y)) & (cp.dot(turn, turn) <= 4 * LARGEST_SQUARE)
    ok = ok & inertia.on_first_root(y)
    if order == 4:
        # Where its second term outweighs the first, the series tells nothing, and other roots appear.
        a, b, c = stiffness(order, inertia, turn)
        ok = ok & (a > 0) & (b > 0) & (c > 0)
    increment = cp.square(half)
    return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _turn(order: int | None, inertia: Inertia, y: cp.Vector) -> cp.Vector:
    """The root Psi, y = h Pi0 per unit, with the derivative of the implicit function, of any order."""
    # Right to second order in |Psi|, as far as the equation agrees with that of the paper's flight.
    turn = cp.scale(2, free_start(cp.scale(2, inertia.relative), y))
    return newton_pairs(partial(_residual, order, inertia, y), partial(_slope, order, inertia, y), turn, _PAIRS)


@_turn.defjvp
def _turn_jvp(order: int | None, primals: tuple[Inertia, cp.Vector], tangents: tuple[Inertia, cp.Vector]) -> Any:
    inertia, y = primals
    turn = fuse(_turn(order, inertia, y))
    inverse = cp.Inverse3.of(_slope(order, inertia, y, turn))
    _, change = jax.jvp(lambda inertia, y: _residual(order, inertia, y, turn), primals, tangents)
    return turn, cp.scale(-1, inverse.times(change))


def _residual(order: int | None, inertia: Inertia, y: cp.Vector, turn: cp.Vector) -> cp.Vector:
    """grad S - dexp(-Psi) y, per unit."""
    a, b, c = turn
    first, second, third = stiffness(order, inertia, turn)
    double, triple, _, _ = stumpff(cp.dot(turn, turn))
    once = cp.cross(turn, y)
    carried = cp.add(cp.subtract(y, cp.scale(double, once)), cp.scale(triple, cp.cross(turn, once)))
    return cp.subtract((first * a, second * b, third * c), carried)


def stiffness(order: int | None, inertia: Inertia, turn: cp.Vector) -> cp.Vector:
    """grad S = stiffness * Psi: the moments, and for order 4 less f2 Psi3^2 + f3 Psi2^2 and so on.

    The second term of S is -(1/2) sum f_i (Psi_j Psi_k)^2 with 12 f_i I_i = (I_k - I_j)^2.
    """
    if order == 2:
        return inertia.relative
    f, (a, b, c) = inertia.bends, (turn[0] * turn[0], turn[1] * turn[1], turn[2] * turn[2])
    i = inertia.relative
    return i[0] - (f[1] * c + f[2] * b), i[1] - (f[2] * a + f[0] * c), i[2] - (f[0] * b + f[1] * a)


def _slope(
    order: int | None, inertia: Inertia, y: cp.Vector, turn: cp.Vector
) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
    """Columns of the derivative of the residual in Psi.

    That of dexp(-Psi) y is b [y] - c [u] + c (Psi . y) + r Psi^T with u = Psi x y, r = -c y - b' u + c' Psi x u.
    """
    a, b, c = turn
    two, three, four, five = stumpff(cp.dot(turn, turn))
    u = cp.cross(turn, y)
    steep = cp.scale(3 * five - four, cp.cross(turn, u))
    r = cp.subtract(cp.subtract(steep, cp.scale(2 * four - three, u)), cp.scale(three, y))
    x, y_, z = cp.subtract(cp.scale(two, y), cp.scale(three, u))  # b [y] - c [u]
    middle = three * cp.dot(turn, y)
    first, second, third = stiffness(order, inertia, turn)
    ab, ac, bc = 0.0, 0.0, 0.0
    if order == 4:
        f = inertia.bends
        ab, ac, bc = -2 * f[2] * a * b, -2 * f[1] * a * c, -2 * f[0] * b * c
    return (
        (first - middle - r[0] * a, ab - z - r[1] * a, ac + y_ - r[2] * a),
        (ab + z - r[0] * b, second - middle - r[1] * b, bc - x - r[2] * b),
        (ac - y_ - r[0] * c, bc + x - r[1] * c, third - middle - r[2] * c),
    )
