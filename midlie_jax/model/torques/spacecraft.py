"""Torques on a spacecraft: its control, what spins inside it, and the air that it meets.

A residual magnetic dipole is a `DipoleInField` whose field is a function of time (`midlie_jax.orbits.DipoleField`).

P. C. Hughes, Spacecraft Attitude Dynamics (1986), chapters 6 (gyrostats) and 8 (environment).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._kernel import components as cp
from ..._kernel.checks import as_floats, as_function_of_time, is_unit, require, require_finite, require_function
from .. import so3
from ..bodies import RigidBody, TensorBody
from ..states import attitude_of
from .base import ReadsBody, Torque
from .fields import from_body


def _gain(name: str, value: Any) -> Array:
    """One number not below zero, or one for each body axis."""
    gain = as_floats(name, value)
    if gain.ndim and gain.shape[-1] != 3:
        raise ValueError(f"{name} must be a number or have shape (3,), one for each body axis, got {gain.shape}.")
    require(name, gain, lambda g: np.isfinite(g) & (g >= 0), "must be finite and not negative", "its sign is built in.")
    return gain


class _ReadsVelocity(ReadsBody):
    """A torque that depends on the angular velocity, and takes the body to know it."""

    @property
    def velocity_dependent(self) -> bool:
        return True


class Damping(_ReadsVelocity):
    """Viscous friction, -coefficient * Omega.

    Attributes:
        coefficient: torque per angular velocity, () or one for each body axis (3,), not negative.
    """

    coefficient: Float[Array, "*batch"]

    def __init__(self, coefficient: Any):
        self.coefficient = _gain("coefficient", coefficient)

    def at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        del t
        return -self.coefficient * body.velocity(state.momentum)


class PDControl(_ReadsVelocity):
    """Proportional and derivative feedback to an attitude, -proportional * 2 sgn(w) v - derivative * Omega.

    (w, v) is the quaternion from the target to the attitude; for small errors 2 v is the error's rotation vector, in
    the body frame, and `sgn(w)` takes the short way round. B. Wie, H. Weiss, A. Arapostathis, J. Guid. Control Dyn. 12
    (1989) 375. Stable about the target for every positive gain. The torque jumps where the error is half a turn.

    Attributes:
        target: unit quaternion (w, x, y, z), body to space, (4,).
        proportional: torque per radian, () or one for each body axis (3,), not negative.
        derivative: torque per angular velocity, () or (3,), not negative.
    """

    target: Float[Array, "*batch 4"]
    proportional: Float[Array, "*batch"]
    derivative: Float[Array, "*batch"]

    def __init__(self, target: Any, proportional: Any, derivative: Any):
        self.target = as_floats("target", target, (4,))
        require("target", self.target, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its norm.")
        self.proportional = _gain("proportional", proportional)
        self.derivative = _gain("derivative", derivative)

    def at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        del t
        error = so3.multiply(so3.conjugate(self.target), attitude_of(state))
        short = jnp.where(error[..., 0] < 0, -2.0, 2.0).astype(error.dtype)
        return -self.proportional * (short * error[..., 1:]) - self.derivative * body.velocity(state.momentum)


class Rotors(_ReadsVelocity):
    """Rotors that spin at constant speed in the body, h x Omega: a gyrostat (Hughes, section 6.3).

    The state's momentum is that of the body without the spin of the rotors, I Omega; R (Pi + h) is conserved where
    nothing else acts, and so is the kinetic energy of the body, which `midlie_jax.energy` gives.

    Attributes:
        momentum: angular momentum h of the rotors relative to the body, body frame, (3,).
    """

    momentum: Float[Array, "*batch 3"]

    def __init__(self, momentum: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        require_finite("momentum", self.momentum)

    def at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        del t
        return _cross(self.momentum, body.velocity(state.momentum))

    def potential_at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        """Zero: the torque is across the angular velocity and does no work."""
        del t, body
        return jnp.zeros_like(state.momentum[..., 0])


class ReactionWheels(_ReadsVelocity):
    """Wheels that are sped up and slowed down by their motors, -h' - Omega x h.

    Attributes:
        momentum: `momentum(t) -> (3,)`, the angular momentum h of all wheels relative to the body, body frame; it is
            differentiated for the torque of the motors. A pytree if it has parameters to differentiate.
    """

    momentum: Callable[[Any], Array]

    def __check_init__(self) -> None:
        require_function("momentum", self.momentum, "t")

    def at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        t = jnp.asarray(t, state.momentum.dtype)
        momentum, rate = jax.jvp(self.momentum, (t,), (jnp.ones_like(t),))
        return _cross(momentum, body.velocity(state.momentum)) - rate


class Drag(Torque):
    """The drag of thin air on a body whose shadow is about the same from all sides, lever x F, F = -1/2 rho A |v| v.

    Free molecular flow (Hughes, section 8.2), for an area that does not change with the attitude; for plates, add one
    of these for each, or write a torque of your own.

    Attributes:
        lever: from the centre of mass to the centre of pressure, in the body, (3,): length.
        area: drag coefficient times area, (): length^2.
        density: of the air, (): mass/length^3.
        velocity: of the body through the air, in space, (3,), or a function `velocity(t) -> (3,)`: length/time.
    """

    lever: Float[Array, "*batch 3"]
    area: Float[Array, "*batch"]
    density: Float[Array, "*batch"]
    velocity: Float[Array, "*batch 3"] | Callable[[Any], Array]

    def __init__(self, lever: Any, area: Any, density: Any, velocity: Any):
        self.lever = as_floats("lever", lever, (3,))
        require_finite("lever", self.lever)
        self.area, self.density = as_floats("area", area), as_floats("density", density)
        for name, value in (("area", self.area), ("density", self.density)):
            require(name, value, lambda x: np.isfinite(x) & (x >= 0), "must be finite and not negative", "check units.")
        self.velocity = as_function_of_time("velocity", velocity)

    def __call__(self, t: Any, state: Any) -> Array:
        velocity = from_body(self.velocity, t, state)
        force = cp.scale(-self.density * self.area / 2 * cp.norm(velocity), velocity)
        return cp.pack(cp.cross(cp.vector(self.lever), force))


def _cross(a: Array, b: Array) -> Array:
    return cp.pack(cp.cross(cp.vector(a), cp.vector(b)))
