"""The observables that most runs want: energy, directions, momenta, velocities and places."""

from typing import Any, cast

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import shown
from ..._math import components as cp
from ...model import observables, so3
from ...model.bodies import Body
from ...model.state import AnyState
from ...model.states import AxisState, FreeAxisState, attitude_of
from ...model.torques import TorqueLike
from ...model.tumbling import Tumble, tumble
from .observables import Observable


class Energy(Observable):
    """The energy (), kinetic plus potential. A ValueError for a torque without a potential."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.energy(body, torque, state, t)


class Axis(Observable):
    """The direction in space of an axis that is fixed in the body, a unit vector (3,); by default the third axis.

    An `AxisState` knows the third axis alone; for another axis, a ValueError.
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __check_init__(self) -> None:
        if not np.all(np.isfinite(self.axis)) or not np.any(self.axis):
            raise ValueError(f"axis must be three finite numbers, not all zero, got {shown(self.axis)}.")

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        if isinstance(state, AxisState | FreeAxisState):
            return cp.pack(state.in_one_frame(tuple(map(float, axis)))[0])
        return so3.rotate(attitude_of(state), jnp.asarray(axis, state.momentum.dtype))


class SpatialMomentum(Observable):
    """The angular momentum in the space frame about its origin, (3,)."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.spatial_momentum(cast(Any, state))


class AngularVelocity(Observable):
    """The angular velocity in the body frame, (3,), radians per unit of time."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.angular_velocity(body, state)


class Tumbling(Observable):
    """How the body tumbles, a `midlie_jax.Tumble`: mode, energy ratio, periods, effective rate, pole and phases."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Tumble:
        return tumble(body, state)


class Position(Observable):
    """The position of the centre of mass of a body that travels, space frame, (3,)."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        observables.linear_momentum(state)  # which raises for a state that does not travel
        return state.position  # pyright: ignore[reportAttributeAccessIssue]


class Velocity(Observable):
    """The velocity of the centre of mass of a body that travels, space frame, (3,)."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.velocity(body, state)
