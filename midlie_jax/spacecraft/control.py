"""Attitude control: feedback, momentum wheels, reaction wheels and thrust."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_floats, as_function_of_time, is_unit, require, require_function, vector_at
from .._math import components as cp
from ..model import so3
from ..model.state import AnyState, Time, attitude_of
from ..model.torques.base import Torque
from ..model.torques.reads_body import ReadsVelocity, as_gain, knows_axis_alone
from ..model.torques.travel import acts_on_one, travelling
from ..model.wrench import Wrench


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
        >>> control = ml.spacecraft.PDControl(target=[1.0, 0.0, 0.0, 0.0], proportional=2.0, derivative=3.0)
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
        self.proportional = as_gain("proportional", proportional)
        self.derivative = as_gain("derivative", derivative)
        self.limit = None if limit is None else as_gain("limit", limit)

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


class MomentumWheels(ReadsVelocity):
    """Wheels that spin at constant speed relative to the body, torque h x Omega: a gyrostat (Hughes, section 6.3).

    The momentum of the state is I Omega, without the spin of the wheels. If no other torque acts, R (Pi + h) is
    conserved, and so is the kinetic energy of the body, which `midlie_jax.observe.energy` returns.

    Attributes:
        momentum: angular momentum h of the wheels relative to the body, body frame, (3,). For an `AxisState` it must
            lie along the third axis.

    Raises:
        ValueError: momentum not of shape (..., 3) or not finite. When a run begins: not along the axis of an
            `AxisState`.

    Examples:
        >>> wheels = ml.spacecraft.MomentumWheels([1.0, 2.0, 4.0])
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> wheels.on(body)(0.0, state)  # h x Omega
        Array([-2.,  3., -1.], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]

    def __init__(self, momentum: Any):
        self.momentum = as_finite("momentum", momentum, (3,))

    def check(self, state: AnyState) -> None:
        super().check(state)
        if knows_axis_alone(state):
            state.in_one_frame(cp.vector(self.momentum))

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        # The spin of a `SymmetricRotor`, which its velocity omits, is along h.
        return cp.pack(cp.cross(_in_frame(self.momentum, state), cp.vector(body.velocity(state.momentum))))

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        """Zero: the torque is perpendicular to the angular velocity and does no work."""
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
        >>> wheels = ml.spacecraft.ReactionWheels(lambda t: jnp.array([0.0, 0.0, 0.5 * t]))
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


def _in_frame(of_body: Array, state: AnyState) -> cp.Vector:
    return state.in_one_frame(cp.vector(of_body))[0] if knows_axis_alone(state) else cp.vector(of_body)


class Thrust(Torque):
    """An engine fixed in the body: its force, and the torque lever x force, both in the body frame.

    Attributes:
        force: the thrust, body frame, (3,), or a function `force(t) -> (3,)`.
        lever: vector from the centre of mass to the engine, body frame, (3,), or a function `lever(t) -> (3,)`.

    Raises:
        ValueError: force or lever of another shape, or not finite. When called: the state does not translate.

    Examples:
        >>> engine = ml.spacecraft.Thrust(force=[0.0, 0.0, 2.0], lever=[0.5, 0.0, 0.0])
        >>> state = ml.FreeState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], position=[0.0, 0.0, 0.0])
        >>> engine(0.0, state).torque[1].item(), engine(0.0, state).force[2].item()  # lever x force; in space
        (-1.0, 2.0)
    """

    force: Float[Array, "*batch 3"] | Callable[[Any], Array]
    lever: Float[Array, "*batch 3"] | Callable[[Any], Array]

    def __init__(self, force: Any, lever: Any):
        self.force, self.lever = as_function_of_time("force", force), as_function_of_time("lever", lever)

    def check(self, state: AnyState) -> None:
        for vector in (self.force, self.lever):
            if not callable(vector):
                state.in_one_frame(cp.vector(vector))

    def __call__(self, t: Time, state: AnyState) -> Any:
        state, _ = travelling(self, state, None)
        vectors = (cp.vector(vector_at(name, getattr(self, name), t)) for name in ("force", "lever"))
        force, lever = (state.in_one_frame(v)[0] for v in vectors)
        return Wrench(cp.pack(cp.cross(lever, force)), cp.pack(state.to_space(force)))
