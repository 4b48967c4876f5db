"""Torques on a spacecraft: control, damping, rotors and reaction wheels, and air drag.

The torque of a residual magnetic dipole is a `DipoleInField` (`fields.py`) in a `midlie_jax.orbits.DipoleField`.

Reference: P. C. Hughes, Spacecraft Attitude Dynamics (1986), chapters 6 (gyrostats) and 8 (environment).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import (
    as_floats,
    as_function_of_time,
    is_unit,
    require,
    require_finite,
    require_function,
    vector_at,
)
from ..._math import components as cp
from .. import so3
from ..rotor import Rotor
from ..state import AnyState, Time
from ..states import TravellingState, attitude_of
from ..wrench import Wrench
from .base import Torque
from .fields import to_body_components
from .reads_body import ReadsBody, ReadsVelocity, angular_velocity_of, knows_axis_alone
from .travel import acts_on_one, through_air, travelling


def _gain(name: str, value: Any) -> Array:
    gain = as_floats(name, value)
    if gain.ndim and gain.shape[-1] != 3:
        raise ValueError(
            f"{name} must be a number or have shape (3,), got {gain.shape}. For one number per body write "
            f"jnp.tile({name}[:, None], (1, 3))."
        )
    require(name, gain, lambda g: np.isfinite(g) & (g >= 0), "must be finite and not negative", "pass its magnitude.")
    return gain


class Damping(ReadsVelocity):
    """Viscous friction, -coefficient * Omega.

    Attributes:
        coefficient: torque per angular velocity, () or one for each body axis (3,), not negative. For an `AxisState`
            the first two must be equal, and the body is a `Rotor(moment, along)`.

    Raises:
        ValueError: a negative or not finite coefficient, or another shape. When a run begins: an `AxisState` with a
            coefficient that varies across the axis, or a `Rotor` without `along`.

    Examples:
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> ml.torques.Damping([0.5, 0.5, 0.25]).on(body)(0.0, state)
        Array([-0.5 , -0.5 , -0.25], dtype=float64)
    """

    coefficient: Float[Array, "*batch"]

    def __init__(self, coefficient: Any):
        self.coefficient = _gain("coefficient", coefficient)

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
        del t
        if not isinstance(body.turning, Rotor):
            return -self.coefficient * body.velocity(state.momentum)
        velocity, gain = angular_velocity_of(state, body), jnp.broadcast_to(self.coefficient, state.momentum.shape)
        axis, _ = state.in_one_frame((0.0, 0.0, 1.0), velocity)
        across = jnp.where(gain[..., 0] == gain[..., 1], gain[..., 0], jnp.nan)
        along = (gain[..., 2] - across) * cp.dot(axis, velocity)
        return -cp.pack(cp.add(cp.scale(across, velocity), cp.scale(along, axis)))


class PDControl(ReadsVelocity):
    """Proportional and derivative feedback towards an attitude, -proportional * 2 sgn(w) v - derivative * dOmega.

    (w, v) is the quaternion of the rotation from the target to the attitude. For small errors 2 v is the rotation
    vector of the error in the body frame; `sgn(w)` selects the shorter rotation to the target. dOmega is the angular
    velocity relative to the target, whose own velocity is its exact derivative. A fixed target is stable for all
    positive gains (B. Wie, H. Weiss, A. Arapostathis, J. Guid. Control Dyn. 12 (1989) 375). The torque jumps where
    the error is pi.

    Attributes:
        target: unit quaternion (w, x, y, z) that takes body components to space components, (4,); or a function of
            time t -> (4,), such as `orbit.lvlh`.
        proportional: torque per radian, () or one for each body axis (3,), not negative.
        derivative: torque per angular velocity, () or one for each body axis (3,), not negative.
        limit: the largest torque about each body axis, () or (3,), not negative; None for no limit.

    Raises:
        ValueError: a target that is not a unit quaternion, or gains that are negative, not finite or of another shape.
            When called: the state has no attitude, or holds coupled bodies.

    Examples:
        >>> control = ml.torques.PDControl(target=[1.0, 0.0, 0.0, 0.0], proportional=2.0, derivative=3.0)
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([0.2, 0.0, 0.0], ml.so3.exp(jnp.array([0.2, 0.0, 0.0])))
        >>> round(float(control.on(body)(0.0, state)[0]), 6)  # -2 * 2 sin(0.1) - 3 * 0.1
        -0.699334
    """

    target: Any
    proportional: Float[Array, "*batch"]
    derivative: Float[Array, "*batch"]
    limit: Float[Array, "*batch"] | None

    def __init__(self, target: Any, proportional: Any, derivative: Any, limit: Any = None):
        if callable(target):
            require_function("target", target, "t")
            self.target = target
        else:
            self.target = as_floats("target", target, (4,))
            require("target", self.target, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its norm.")
        self.proportional = _gain("proportional", proportional)
        self.derivative = _gain("derivative", derivative)
        self.limit = None if limit is None else _gain("limit", limit)

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        if state.several:
            raise acts_on_one(self)
        attitude, velocity = attitude_of(state), body.velocity(state.momentum)
        target, change = self._aim(t, attitude)
        error = so3.multiply(so3.conjugate(target), attitude)
        if change is not None:
            of_target = 2 * so3.multiply(so3.conjugate(target), change)[..., 1:]
            velocity = velocity - so3.rotate(so3.conjugate(error), of_target)
        factor = jnp.where(error[..., 0] < 0, -2.0, 2.0).astype(error.dtype)  # 2 sgn(w)
        torque = -self.proportional * (factor * error[..., 1:]) - self.derivative * velocity
        return torque if self.limit is None else jnp.clip(torque, -self.limit, self.limit)

    def _aim(self, t: Time, attitude: Array) -> tuple[Array, Array | None]:
        if not callable(self.target):
            return self.target, None
        t = jnp.asarray(t, attitude.dtype)
        target, change = jax.jvp(self.target, (t,), (jnp.ones_like(t),))
        if jnp.shape(target) != (4,):
            raise ValueError(f"target must return a quaternion (4,) at each time, got shape {jnp.shape(target)}.")
        return target.astype(attitude.dtype), change.astype(attitude.dtype)


class Rotors(ReadsVelocity):
    """Rotors that spin at constant speed relative to the body, torque h x Omega: a gyrostat (Hughes, section 6.3).

    The momentum of the state is I Omega, without the spin of the rotors. If no other torque acts, R (Pi + h) is
    conserved, and so is the kinetic energy of the body, which `midlie_jax.energy` returns.

    Attributes:
        momentum: angular momentum h of the rotors relative to the body, body frame, (3,). For an `AxisState` it must
            lie along the third axis.

    Raises:
        ValueError: momentum not of shape (..., 3) or not finite. When a run begins: not along the axis of an
            `AxisState`.

    Examples:
        >>> rotor = ml.torques.Rotors([1.0, 2.0, 4.0])
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> rotor.on(body)(0.0, state)  # h x Omega
        Array([-2.,  3., -1.], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]

    def __init__(self, momentum: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        require_finite("momentum", self.momentum)

    def check(self, state: AnyState) -> None:
        super().check(state)
        if knows_axis_alone(state):
            state.in_one_frame(cp.vector(self.momentum))

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        del t
        # The spin of a `Rotor`, which its velocity omits, is along h.
        return cp.pack(cp.cross(_in_frame(self.momentum, state), cp.vector(body.velocity(state.momentum))))

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        """Zero: the torque is perpendicular to the angular velocity and does no work."""
        del t, body
        return jnp.zeros_like(state.momentum[..., 0])


class ReactionWheels(ReadsVelocity):
    """Wheels with motors that change their speed, torque -h' - Omega x h.

    Attributes:
        momentum: `momentum(t) -> (3,)`, the angular momentum h of all wheels relative to the body, body frame. Its
            derivative h' is computed by automatic differentiation. Make it a pytree if you differentiate with respect
            to its parameters. For an `AxisState` it must lie along the third axis; otherwise the state becomes NaN.

    Raises:
        ValueError: momentum cannot be called.

    Examples:
        >>> wheels = ml.torques.ReactionWheels(lambda t: jnp.array([0.0, 0.0, 0.5 * t]))
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> wheels.on(body)(2.0, state)
        Array([-1. ,  1. , -0.5], dtype=float64)
    """

    momentum: Callable[[Any], Array]

    def __check_init__(self) -> None:
        require_function("momentum", self.momentum, "t")

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        t = jnp.asarray(t, state.momentum.dtype)
        momentum, rate = jax.jvp(lambda t: vector_at("momentum", self.momentum, t), (t,), (jnp.ones_like(t),))
        turning = cp.cross(_in_frame(momentum, state), cp.vector(body.velocity(state.momentum)))
        return cp.pack(cp.subtract(turning, _in_frame(rate, state)))


class Drag(ReadsBody):
    """Air drag on a body whose cross section does not depend on the attitude: F = -1/2 rho A |v| v, and lever x F.

    This holds in free molecular flow (Hughes, section 8.2), and for a ball in air. For a body made of plates, add one
    `Drag` for each plate, or write a custom torque. With `velocity`, a known path, it is a torque alone. Without, it
    uses the velocity of a body that translates, and the drag is a wrench.

    Attributes:
        lever: vector from the centre of mass to the centre of pressure, body frame, (3,), length.
        area: drag coefficient times cross section A, (), length^2, not negative.
        density: density rho of the air, (), mass/length^3, not negative.
        velocity: velocity v of the body relative to the air, space frame, (3,), or a function `velocity(t) -> (3,)`,
            length/time; None for the velocity of a `FreeState`.
        wind: with `velocity` None, the velocity of the air, in the same forms; None for air at rest.

    Raises:
        ValueError: wrong shapes, values that are not finite, a negative area or density, or velocity and wind together.
            When called: as for `DipoleInField`; without `velocity`, body and state do not translate.

    Examples:
        >>> drag = ml.torques.Drag(lever=[0.0, 0.0, 0.5], area=2.0, density=1e-11, velocity=[7600.0, 0.0, 0.0])
        >>> state = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> round(1e6 * float(drag(0.0, state)[1]), 3)  # micro-N m: -lever * rho A v^2 / 2
        -288.8
    """

    lever: Float[Array, "*batch 3"]
    area: Float[Array, "*batch"]
    density: Float[Array, "*batch"]
    velocity: Float[Array, "*batch 3"] | Callable[[Any], Array] | None
    wind: Float[Array, "*batch 3"] | Callable[[Any], Array] | None

    def __init__(self, lever: Any, area: Any, density: Any, velocity: Any = None, *, wind: Any = None):
        self.lever = as_floats("lever", lever, (3,))
        require_finite("lever", self.lever)
        self.area, self.density = as_floats("area", area), as_floats("density", density)
        for name, value in (("area", self.area), ("density", self.density)):
            require(name, value, lambda x: np.isfinite(x) & (x >= 0), "must be finite and not negative", "check units.")
        self.velocity = None if velocity is None else as_function_of_time("velocity", velocity)
        self.wind = None if wind is None else as_function_of_time("wind", wind)
        if self.velocity is not None and self.wind is not None:
            raise ValueError("velocity is relative to the air: give velocity or wind, not both.")

    @property
    def velocity_dependent(self) -> bool:
        return self.velocity is None

    def check(self, state: AnyState) -> None:
        if isinstance(state, TravellingState):
            state.in_one_frame(cp.vector(self.lever))

    def on(self, body: Any) -> Torque:
        return super().on(body) if self.velocity is None else self

    def __call__(self, t: Time, state: AnyState) -> Array:
        if self.velocity is None:
            return super().__call__(t, state)
        force = self._force(to_body_components("velocity", self.velocity, t, state))
        return cp.pack(cp.cross(cp.vector(self.lever), force))

    def at(self, t: Time, state: AnyState, body: Any) -> Any:
        state, body = travelling(self, state, body)
        force = self._force(through_air(t, state, body, self.wind))
        return Wrench(cp.pack(cp.cross(*state.in_one_frame(cp.vector(self.lever), force))), cp.pack(force))

    def _force(self, velocity: cp.Vector) -> cp.Vector:
        return cp.scale(-self.density * self.area / 2 * cp.norm(velocity), velocity)


def _in_frame(of_body: Array, state: AnyState) -> cp.Vector:
    """A body vector in the frame of the torque; NaN if the state holds one axis and the vector is not along it."""
    return state.in_one_frame(cp.vector(of_body))[0] if knows_axis_alone(state) else cp.vector(of_body)
