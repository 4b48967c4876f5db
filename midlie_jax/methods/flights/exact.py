"""`ExactFlight`, the base class of the exact flights of rigid bodies, whose derivative is that of `turn_tangent`."""

from abc import abstractmethod
from functools import partial
from typing import Any, ClassVar

import jax
from jax import Array

from ..._kernel import components as cp
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight
from .turn_tangent import Changes, increment_tangent

Flown = tuple[cp.Quaternion, cp.Vector]  # the increment, and the change of the momentum


class ExactFlight(Flight):
    """An exact flight, of which the derivative of the momentum is enough."""

    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
    long_derivative: ClassVar[bool] = False

    @abstractmethod
    def formula(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Flown:
        """The increment and the change of the momentum, by formulas that are never differentiated."""

    @abstractmethod
    def momentum_tangent(
        self, inertia: Inertia, h: Array, momentum: cp.Vector, changes: Changes
    ) -> tuple[cp.Vector, Array | None]:
        """The tangent of the change of the momentum, and the `lag` of `turn_tangent` if the inverse moments change."""

    def fly(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Flown:
        """`formula`, with its derivative."""
        return _fly(self, inertia, h, momentum, None)

    def again(self, inertia: Inertia, h: Array, momentum: cp.Vector, increment: cp.Quaternion) -> Flown:
        """`fly`, of which the increment is known and only the derivative is wanted."""
        return _fly(self, inertia, h, momentum, increment)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _fly(flight: ExactFlight, inertia: Inertia, h: Array, momentum: cp.Vector, known: cp.Quaternion | None) -> Flown:
    if known is None:
        return flight.formula(inertia, h, momentum)
    return known, cp.rotation_change(cp.conjugate(known), momentum)


def _tangent(flight: ExactFlight, primals: Any, tangents: Any) -> tuple[Flown, Flown]:
    inertia, h, momentum, _ = primals
    changes = Changes.of(inertia, *tangents[:3])
    change_dot, lag = flight.momentum_tangent(inertia, h, momentum, changes)
    increment, change = _fly(flight, *primals)
    increment_dot = increment_tangent(inertia, h, momentum, increment, changes, change_dot, lag)
    return (increment, change), (increment_dot, change_dot)


_fly.defjvp(_tangent, symbolic_zeros=True)
