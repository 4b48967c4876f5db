"""The exact flight of an axis of symmetry: one rotation about the spatial momentum, without a root and without I3.

With I1 = I2 the axis e rotates about the momentum pi at the rate |pi|/I1, and the spatial momentum is constant:

    w = h pi / (2 I1),    e' = e + sin(2 |w|)/|w| w x e + (1 - cos(2 |w|))/|w|^2 w x (w x e)
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.short_series import WIDEST_SQUARE, WIDEST_TURN, cosine_and_sinc_of_square
from ...model.bodies import Body, SymmetricRotor
from ...model.inertia import RotorInertia
from ...model.states.unit_vector import Swing
from .base import JudgedFlight


class AxisTurn(JudgedFlight):
    """The flight of a `SymmetricRotor` in SYMMETRIC[...]; its increment is a rotation in the space frame."""

    name: ClassVar[str] = "SYMMETRIC"
    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type[Body]] = SymmetricRotor
    per_loop: ClassVar[int] = 8
    per_kernel: ClassVar[int] = 8
    long_derivative: ClassVar[bool] = False
    reach: ClassVar[float] = WIDEST_TURN

    def judged(self, inertia: RotorInertia, h: Array, momentum: cp.Vector) -> tuple[Swing, cp.Vector, Any]:
        turn = cp.scale(h / 2 * inertia.inverse, momentum)
        square = cp.dot(turn, turn)
        still = jnp.zeros_like(square), jnp.zeros_like(square), jnp.zeros_like(square)
        return Swing.of(turn, square, *cosine_and_sinc_of_square(square)), still, square * (1 / WIDEST_SQUARE)


class Circle(NamedTuple):
    """The motion of a free axis: one rotation, about the unit vector along pi (zero at rest), at the rate |pi| / I1."""

    momentum: cp.Vector
    about: cp.Vector
    rate: Array

    @classmethod
    def of(cls, inertia: RotorInertia, momentum: cp.Vector) -> "Circle":
        size = cp.norm(momentum)
        still = size == 0
        per_size = jnp.where(still, jnp.zeros_like(size), 1 / jnp.where(still, jnp.ones_like(size), size))
        return cls(momentum, cp.scale(per_size, momentum), inertia.inverse * size)

    def at(self, t: Array, turns: bool) -> tuple[cp.Vector, Swing, Array]:
        """The momentum, the rotation in the time t, and whether rounding leaves digits of its angle."""
        half = self.rate * t / 2
        sine, one = jnp.sin(half), jnp.ones_like(half)
        swing = Swing(self.about, one, 2 * sine * jnp.cos(half), 2 * sine * sine)
        return self.momentum, swing, abs(half) * cp.epsilon(half) < 0.1
