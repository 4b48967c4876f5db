"""The symplectic midpoint flight of order 2 or 4: LIEMID with dexp(-Psi) in place of exp(-Psi/2).

    grad S(Psi) = h dexp(-Psi) Pi0,    R1 = R0 exp(Psi),    Pi1 = exp(-Psi) Pi0

S is a generating function of the rotation Psi. For any S the map is symplectic, reversible and conserves the spatial
momentum. The exact S is a discrete Lagrangian of the free body. Its first term, Psi . I Psi / 2, gives order 2. With
the second term, -(1/24) m . I^-1 m with m = Psi x I Psi, the order is 4, still with a single solve.
"""

from functools import partial
from typing import ClassVar

from jax import Array

from ..._math import components as cp
from ..._math.newton import newton_pairs
from ..._math.short_series import LARGEST_SQUARE, LARGEST_TURN, half_turn, stumpff
from ...model.inertia import Inertia
from ..verdict import verdict
from .base import JudgedFlight
from .lie_midpoint import free_start

_RESIDUAL_LIMIT = 8  # units of eps |Pi|


class _Generated(JudgedFlight):
    """The common part of both flights, which differ in the terms of S and therefore in the order."""

    solves: ClassVar[int] = 1
    reach: ClassVar[float] = LARGEST_TURN

    def judged(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        y = inertia.travel(h, momentum)
        residual_of = partial(_residual, self.order)
        turn = newton_pairs(residual_of, partial(_slope, self.order), _guess, inertia, y)
        residual = residual_of(inertia, y, turn)
        limit = _RESIDUAL_LIMIT * cp.epsilon(h)
        half = half_turn(cp.scale(0.5, turn))
        solved = cp.dot(residual, residual) <= limit * limit * cp.dot(y, y)
        if self.order == 4:
            # If the second term of the series exceeds the first, the series is useless and further roots appear.
            a, b, c = stiffness(self.order, inertia, turn)
            solved = solved & (a > 0) & (b > 0) & (c > 0)
        ok = verdict(solved, (cp.dot(turn, turn), 4 * LARGEST_SQUARE), inertia.bound_of_first_root(y))
        increment = cp.square(half)
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok


class SymplecticMidpoint(_Generated):
    """I Psi = h dexp(-Psi) Pi0: order 2, symplectic.

    The flight reports False in `ok` if the residual exceeds 8 eps |Pi|, the rotation exceeds 2.4 radians, or h |Omega|
    at the start exceeds 12 radians.

    Examples:
        >>> ml.method(ml.flights.SymplecticMidpoint(), "EA").name
        'SLIEMID[EA]'
    """

    name: ClassVar[str] = "SLIEMID"
    use: ClassVar[str] = "comparison with LIEMID: the paper's flight made symplectic"
    order: ClassVar[int | None] = 2
    per_loop: ClassVar[int] = 2


class SymplecticMidpoint4(_Generated):
    """I Psi - (1/12) (I Psi x d + I (d x Psi)) = h dexp(-Psi) Pi0, d = I^-1 (Psi x I Psi): order 4, symplectic.

    The flight reports False in `ok` if SLIEMID does, or if the second term of the series exceeds the first, as on
    slender bodies.

    Examples:
        >>> ml.method(ml.flights.SymplecticMidpoint4(), "EA").name
        'SLIEMID4[EA]'
    """

    name: ClassVar[str] = "SLIEMID4"
    use: ClassVar[str] = "symplectic, of order 4 with one solve; JACOBI is exact and faster"
    order: ClassVar[int | None] = 4
    per_loop: ClassVar[int] = 1


def _guess(inertia: Inertia, y: cp.Vector) -> cp.Vector:
    """Correct to second order in |Psi|, because the equation agrees with LIEMID up to there."""
    return cp.scale(2, free_start(cp.scale(2, inertia.relative), y))


def _residual(order: int | None, inertia: Inertia, y: cp.Vector, turn: cp.Vector) -> cp.Vector:
    """grad S - dexp(-Psi) y, per unit."""
    a, b, c = turn
    first, second, third = stiffness(order, inertia, turn)
    two, three, _, _ = stumpff(cp.dot(turn, turn))
    turn_cross_y = cp.cross(turn, y)
    dexp_y = cp.add(cp.subtract(y, cp.scale(two, turn_cross_y)), cp.scale(three, cp.cross(turn, turn_cross_y)))
    return cp.subtract((first * a, second * b, third * c), dexp_y)


def stiffness(order: int | None, inertia: Inertia, turn: cp.Vector) -> cp.Vector:
    """The vector s for which grad S = s * Psi, entry by entry.

    For order 2, s holds the moments. The second term of S is -(1/2) sum f_i (Psi_j Psi_k)^2, with
    12 f_i I_i = (I_k - I_j)^2. For order 4 it subtracts f_2 Psi_3^2 + f_3 Psi_2^2 from s_1, and so on cyclically.
    """
    if order == 2:
        return inertia.relative
    f, (a, b, c) = inertia.quartic, (turn[0] * turn[0], turn[1] * turn[1], turn[2] * turn[2])
    i = inertia.relative
    return i[0] - (f[1] * c + f[2] * b), i[1] - (f[2] * a + f[0] * c), i[2] - (f[0] * b + f[1] * a)


def _slope(
    order: int | None, inertia: Inertia, y: cp.Vector, turn: cp.Vector
) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
    """Columns of the derivative of the residual with respect to Psi.

    The derivative of dexp(-Psi) y is b [y] - c [u] + c (Psi . y) + r Psi^T, with u = Psi x y and r = -c y - b' u +
    c' Psi x u. Here b and c are c2 and c3 of `stumpff`, and a prime is twice the derivative by |Psi|^2.
    """
    a, b, c = turn
    two, three, four, five = stumpff(cp.dot(turn, turn))
    u = cp.cross(turn, y)
    slope_terms = cp.scale(3 * five - four, cp.cross(turn, u))
    r = cp.subtract(cp.subtract(slope_terms, cp.scale(2 * four - three, u)), cp.scale(three, y))
    skew_x, skew_y, skew_z = cp.subtract(cp.scale(two, y), cp.scale(three, u))  # b [y] - c [u]
    diagonal = three * cp.dot(turn, y)
    first, second, third = stiffness(order, inertia, turn)
    ab, ac, bc = 0.0, 0.0, 0.0
    if order == 4:
        f = inertia.quartic
        ab, ac, bc = -2 * f[2] * a * b, -2 * f[1] * a * c, -2 * f[0] * b * c
    return (
        (first - diagonal - r[0] * a, ab - skew_z - r[1] * a, ac + skew_y - r[2] * a),
        (ab + skew_z - r[0] * b, second - diagonal - r[1] * b, bc - skew_x - r[2] * b),
        (ac - skew_y - r[0] * c, bc + skew_x - r[1] * c, third - diagonal - r[2] * c),
    )
