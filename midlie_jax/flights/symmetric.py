"""The exact flight of a body with two equal moments, I1 = I2: two rotations and no solve.

b = h (1/I3 - 1/I1) Pi3,    R1 = R0 exp(h Pi0/I1) exp(b e3),    Pi1 = exp(-b e3) Pi0
"""

from typing import ClassVar

from jax import Array

from .. import _components as cp
from .._half_turn import LARGEST_SQUARE, half_turn, spin
from ..bodies import RigidBody
from .base import Flight, Inertia


class Symmetric(Flight):
    """Exact where the first two moments are equal; symplectic, keeps energy and spatial momentum to rounding.

    Says False where they differ by more than 8 eps, or a flight turned by more than 2.4 radians in one of its parts.
    """

    name: ClassVar[str] = "SYMMETRIC"
    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 4

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        a, b, c = inertia.inverses
        equal = abs(a - b) <= 8 * cp.epsilon(a) * a
        increment, new, ok = symmetric_flight(h, a, c, momentum)
        return increment, new, ok & equal


def symmetric_flight(h: Array, a: Array, c: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
    """That of a body with 1/I1 = 1/I2 = a and 1/I3 = c."""
    turn = cp.scale(h / 2 * a, momentum)
    half = half_turn(turn)
    angle = h / 2 * (c - a) * momentum[2]
    cosine, sine = spin(angle)
    increment = cp.multiply_about(cp.multiply(half, half), 2, cosine, sine)
    turned = cp.rotate_back_about(2, cosine, sine, momentum)
    return increment, turned, (cp.dot(turn, turn) <= LARGEST_SQUARE) & (angle * angle <= LARGEST_SQUARE)
