"""Torques that read the body, and their binding to a body; `WithBath`, the torque and the heat bath of a run."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_not_negative, described, require_function
from ..._math import components as cp
from ..baths.base import HeatBath
from ..bodies import SymmetricRotor
from ..state import AnyState, Time
from .base import Torque, TorqueLike, no_potential, on_body, potential_of, velocity_dependent


class ReadsBody(Torque):
    """Base class of torques that read the body; a run passes the body to `on`."""

    def at(self, t: Time, state: Any, body: Any) -> Any:
        raise NotImplementedError(f"{type(self).__name__} must define at(t, state, body).")

    def potential_at(self, t: Time, state: Any, body: Any) -> Array:
        raise no_potential(self)

    def on(self, body: Any) -> Torque:
        return OnBody(self, body)

    def __call__(self, t: Time, state: Any) -> Any:
        raise ValueError(f"{type(self).__name__} reads the body: call torque.on(body)(t, state).")

    def potential(self, t: Time, state: Any) -> Array:
        raise ValueError(f"{type(self).__name__} reads the body: call torque.on(body).potential(t, state).")


class ReadsVelocity(ReadsBody):
    """A torque that depends on the angular velocity, computed from the momentum and the body."""

    def check(self, state: Any) -> None:
        if hasattr(state, "spin"):
            raise ValueError(
                f"{type(self).__name__} reads the angular velocity of a body, and spins have none; for friction use "
                "midlie_jax.spins.Spins(damping=...)."
            )

    @property
    def velocity_dependent(self) -> bool:
        return True


def knows_axis_alone(state: AnyState) -> bool:
    return state.leaves[0].in_space


def angular_velocity_of(state: AnyState, body: Any) -> cp.Vector:
    turning = body.turning
    velocity = cp.vector(turning.velocity(state.momentum))
    if not isinstance(turning, SymmetricRotor):
        return velocity
    momentum, along = cp.vector(state.momentum), turning.known_along
    axis, _ = state.in_one_frame((0.0, 0.0, 1.0), momentum)
    # A linear molecule, whose moment about its axis is zero, does not spin.
    spin = jnp.where(along > 0, cp.dot(axis, momentum) / jnp.where(along > 0, along, 1), 0)
    return cp.add(velocity, cp.scale(spin - cp.dot(axis, velocity), axis))


def as_gain(name: str, value: Any) -> Array:
    gain = as_not_negative(name, value, cure="pass its magnitude.")
    if gain.ndim and gain.shape[-1] != 3:
        raise ValueError(
            f"{name} must be a number or have shape (3,), got {gain.shape}. For one number per body write "
            f"jnp.tile({name}[:, None], (1, 3))."
        )
    return gain


class Damping(ReadsVelocity):
    """Viscous friction, -coefficient * Omega.

    Attributes:
        coefficient: torque per angular velocity, () or one for each body axis (3,), not negative. For an `AxisState`
            the first two must be equal, and the body is a `SymmetricRotor(moment, along)`.

    Examples:
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> ml.torques.Damping([0.5, 0.5, 0.25]).on(ml.RigidBody([2.0, 3.0, 4.0]))(0.0, state)
        Array([-0.5 , -0.5 , -0.25], dtype=float64)
    """

    coefficient: Float[Array, "*batch"]

    def __init__(self, coefficient: Any):
        self.coefficient = as_gain("coefficient", coefficient)

    def check(self, state: AnyState) -> None:
        super().check(state)
        if not knows_axis_alone(state) or cp.is_traced(self.coefficient):
            return
        gain = np.asarray(self.coefficient)
        if gain.ndim and np.any(gain[..., 0] != gain[..., 1]):
            raise ValueError(
                f"coefficient is {gain.tolist()}, but the first two must be equal for "
                f"{type(state).__name__}, which holds only the axis of symmetry; use a RigidState."
            )

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        if not isinstance(body.turning, SymmetricRotor):
            return -self.coefficient * body.velocity(state.momentum)
        velocity, gain = angular_velocity_of(state, body), jnp.broadcast_to(self.coefficient, state.momentum.shape)
        axis, _ = state.in_one_frame((0.0, 0.0, 1.0), velocity)
        across = jnp.where(gain[..., 0] == gain[..., 1], gain[..., 0], jnp.nan)
        along = (gain[..., 2] - across) * cp.dot(axis, velocity)
        return -cp.pack(cp.add(cp.scale(across, velocity), cp.scale(along, axis)))


class OnBody(Torque):
    """A torque that reads the body, bound to a body: a callable of (t, state)."""

    torque: ReadsBody
    body: Any

    def __call__(self, t: Time, state: Any) -> Any:
        return self.torque.at(t, state, self.body)

    def potential(self, t: Time, state: Any) -> Array:
        return self.torque.potential_at(t, state, self.body)

    @property
    def velocity_dependent(self) -> bool:
        return self.torque.velocity_dependent


class BodyTorque(ReadsBody):
    """A torque that is a function of time, state and body: for example of the inertia or the angular velocity.

    Attributes:
        function: `function(t, state, body) -> (3,)`, body frame; a run passes its body.

    Examples:
        >>> brake = ml.torques.BodyTorque(lambda t, state, body: -0.5 * body.velocity(state.momentum))
        >>> brake.on(body)(0.0, start)
        Array([ -0.,  -0., -25.], dtype=float64)
    """

    function: Callable[[Any, Any, Any], Array]

    def __check_init__(self) -> None:
        require_function("function", self.function, "t, state, body")

    def at(self, t: Time, state: Any, body: Any) -> Array:
        return self.function(t, state, body)


class WithBath(ReadsBody):
    torque: TorqueLike | None
    bath: HeatBath

    def at(self, t: Time, state: Any, body: Any) -> Any:
        self.bath.check_on(state, body)
        return jnp.zeros_like(state.momentum) if self.torque is None else on_body(self.torque, body)(t, state)

    def potential_at(self, t: Time, state: Any, body: Any) -> Array:
        if self.torque is None:
            return jnp.zeros((), state.momentum.dtype)
        return potential_of(on_body(self.torque, body))(t, state)

    def check(self, state: Any) -> None:
        self.bath.check(state)
        if isinstance(self.torque, Torque):
            self.torque.check(state)

    @property
    def velocity_dependent(self) -> bool:
        return velocity_dependent(self.torque)


def with_bath(torque: Any, bath: Any) -> Any:
    if bath is None:
        return torque
    if not isinstance(bath, HeatBath):
        cure = "; add baths with a + b" if isinstance(bath, list | tuple) else ""
        raise ValueError(f"bath must be a midlie_jax.baths.Langevin or None, got {described(bath)}{cure}.")
    return WithBath(torque, bath)


def without_bath(torque: Any) -> tuple[Any, HeatBath | None]:
    return (torque.torque, torque.bath) if isinstance(torque, WithBath) else (torque, None)
