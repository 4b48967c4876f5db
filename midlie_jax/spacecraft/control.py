"""Attitude control: feedback, momentum wheels, reaction wheels, driven wheels and thrust.

Reference: P. C. Hughes, Spacecraft Attitude Dynamics (1986), chapters 3 and 6 (gyrostats).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import (
    as_count,
    as_finite,
    as_floats,
    as_function_of_time,
    as_not_negative,
    is_unit,
    require,
    require_function,
    vector_at,
)
from .._math import components as cp
from ..drivers.stepper import Carry, Stepper
from ..model import so3
from ..model.free_body import Wrench
from ..model.state import AnyState, Time, attitude_of
from ..model.torques.base import Torque
from ..model.torques.reads_body import ReadsVelocity, as_gain, knows_axis_alone
from ..model.torques.travel import acts_on_one, travelling


class PDControl(ReadsVelocity):
    """Proportional and derivative feedback towards an attitude, -proportional * 2 sgn(w) v - derivative * dOmega.

    (w, v) is the quaternion of the rotation from the target to the attitude; `sgn(w)` selects the shorter rotation.
    dOmega is the angular velocity relative to the target, whose own velocity is its exact derivative. A fixed target is
    stable for all positive gains (B. Wie, H. Weiss, A. Arapostathis, J. Guid. Control Dyn. 12 (1989) 375). The torque
    jumps where the error is pi.

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
        target, change = self.target, None
        if callable(target):
            t = jnp.asarray(t, attitude.dtype)
            target, change = jax.jvp(target, (t,), (jnp.ones_like(t),))
            if jnp.shape(target) != (4,):
                raise ValueError(f"target must return a quaternion (4,) at each time, got shape {jnp.shape(target)}.")
            target = target.astype(attitude.dtype)
        error = so3.multiply(so3.conjugate(target), attitude)
        if change is not None:
            of_target = 2 * so3.multiply(so3.conjugate(target), change.astype(attitude.dtype))[..., 1:]
            velocity = velocity - so3.rotate(so3.conjugate(error), of_target)
        factor = jnp.where(error[..., 0] < 0, -2.0, 2.0).astype(error.dtype)  # 2 sgn(w)
        torque = -self.proportional * (factor * error[..., 1:]) - self.derivative * velocity
        return torque if self.limit is None else jnp.clip(torque, -self.limit, self.limit)


class MomentumWheels(ReadsVelocity):
    """Wheels that spin at constant speed relative to the body, torque h x Omega: a gyrostat (Hughes, section 6.3).

    The momentum of the state is I Omega, without the spin of the wheels. Without other torques, R (Pi + h) and the
    kinetic energy of the body, which `midlie_jax.observe.energy` returns, are conserved.

    Attributes:
        momentum: angular momentum h of the wheels relative to the body, body frame, (3,). For an `AxisState` it must
            lie along the third axis.

    Raises:
        ValueError: momentum not of shape (..., 3) or not finite. When a run begins: not along the axis of an
            `AxisState`.

    Examples:
        >>> body, wheels = ml.RigidBody([2.0, 3.0, 4.0]), ml.spacecraft.MomentumWheels([1.0, 2.0, 4.0])
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
        >>> engine(0.0, state).torque[1].item()  # of lever x force
        -1.0
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


class DrivenWheels(eqx.Module):
    """Wheels with motors on a rotating body, for loops of a `midlie_jax.stepper`.

    The momentum h of a wheel is J (a . Omega + spin), its angular momentum along its axis a, with J the moment of the
    wheel about a. Motor and friction are the only torques about the axis, h' = motor - friction * spin, and the body
    feels their reaction and the gyroscopic torque. The state has the momentum I Omega without the wheels, where I
    contains the masses of the wheels but not their moments J about the axes.

    Without other torques the total R (Pi + sum of h a) in space is constant to rounding for every command, if the
    method conserves the momentum of a free body (for a `TensorBody` to a few eps per step). The motion has an error of
    order 2.

    Attributes:
        axes: the axes of the wheels, body frame, (n, 3); scaled to unit length.
        torque: the largest motor torque, () or (n,); None for no limit. Larger commands are reduced to it.
        momentum: the largest momentum, () or (n,); None for no limit. At this momentum the wheel is saturated: its
            motor gives no torque that increases it.
        friction: viscous friction of the bearings, torque per spin rate, () or (n,); None for none.
        inertia: the moments J, () or (n,), required for friction.

    Raises:
        ValueError: axes of another shape or zero; a limit that is negative or not finite; friction or inertia
            that is not positive, or one without the other.

    Examples:
        >>> wheels = ml.spacecraft.DrivenWheels(jnp.eye(3), torque=0.02, momentum=0.5)  # N m, N m s
        >>> body, start = ml.RigidBody([5.0, 4.0, 3.0]), ml.RigidState([0.1, -0.2, 0.1], [1.0, 0.0, 0.0, 0.0])
        >>> free = ml.stepper("JACOBI[EA]", body, None, start, dt=0.1)
        >>> def sample(loop, _):
        ...     state = free.state(loop[0])
        ...     wanted = 0.1 * state.attitude[1:] + 1.0 * body.velocity(state.momentum)  # on the wheels
        ...     return wheels.advance(free, *loop, wanted, 5), None
        >>> (carry, momenta), _ = jax.lax.scan(sample, (free.init(), jnp.zeros(3)), length=400)
        >>> end = free.state(carry)
        >>> jnp.round(ml.so3.rotate(end.attitude, end.momentum + momenta @ wheels.axes), 12)  # as at the start
        Array([ 0.1, -0.2,  0.1], dtype=float64)
    """

    axes: Float[Array, "n 3"]
    torque: Float[Array, "*n"] | None
    momentum: Float[Array, "*n"] | None
    friction: Float[Array, "*n"] | None
    inertia: Float[Array, "*n"] | None

    def __init__(self, axes: Any, torque: Any = None, momentum: Any = None, friction: Any = None, inertia: Any = None):
        axes = as_finite("axes", axes, (3,))
        if axes.ndim != 2:
            raise ValueError(f"axes must have shape (n, 3), one row for each wheel, got {axes.shape}.")
        require("axes", axes, lambda x: np.any(x != 0, axis=-1), "must not be zero", "give a direction for each wheel.")
        self.axes = axes / jnp.linalg.norm(axes, axis=-1, keepdims=True)
        self.torque, self.momentum = self._of_wheels("torque", torque), self._of_wheels("momentum", momentum)
        self.friction, self.inertia = self._of_wheels("friction", friction), self._of_wheels("inertia", inertia)
        if (self.friction is None) != (self.inertia is None):
            raise ValueError("friction and inertia must be given together: friction acts on the spin of a wheel.")
        if self.inertia is not None:
            for name in ("inertia", "friction"):
                require(name, getattr(self, name), lambda x: x > 0, "must be positive", "or leave out both.")

    def advance(
        self,
        stepper: Stepper,
        carry: Carry,
        momenta: Any,
        command: Any,
        steps: int = 1,
        *,
        torque: Any = None,
        body: Any = None,
    ) -> tuple[Carry, Float[Array, " n"]]:
        """Carry and wheel momenta after a number of steps with a held command.

        Args:
            stepper: of a body with a state that has an attitude. Its torque must not read the momentum.
            carry: from `stepper.init` or this function.
            momenta: the momenta h of the wheels, (n,).
            command: motor torques on the wheels, (n,), constant in these steps.
            steps, torque, body: as for `Stepper.advance`; for torques that are held, such as magnetic torquers.

        Raises:
            ValueError: momenta or command of another shape, or momenta beyond the limit; several bodies or no attitude;
                a torque that reads the momentum; or as for `Stepper.advance`.
        """
        dtype = stepper.dt.dtype
        momenta, command = (self._one_each(name, x, dtype) for name, x in (("momenta", momenta), ("command", command)))
        if (most := self.momentum) is not None and not cp.is_traced(most):
            within = "must be within the limit of the wheels"
            require("momenta", momenta, lambda x: np.abs(x) <= np.asarray(most), within, "raise momentum=.")
        if stepper.reads_momentum(torque):
            raise ValueError("torque must not read the momentum, which contains the wheels there. Hold its value.")
        motor = command if self.torque is None else jnp.clip(command, -self.torque, self.torque)
        body = stepper.body if body is None else body

        def step(loop: tuple[Carry, Array], _: Any) -> tuple[tuple[Carry, Array], None]:
            carry, begin = loop
            state = stepper.state(carry)
            total = state.momentum + begin @ self.axes
            middle = self._driven(body, total, begin, motor, stepper.dt / 2)
            turn = so3.exp(-stepper.dt / 2 * body.velocity(middle @ self.axes))
            carry = stepper.with_state(carry, _turned(state, total, turn))
            carry = stepper.step(carry, torque=torque, body=body)
            state = stepper.state(carry)
            state = _turned(state, state.momentum, turn)
            end = self._driven(body, state.momentum, middle, motor, stepper.dt / 2)
            own = eqx.tree_at(lambda s: s.momentum, state, state.momentum - end @ self.axes)
            return (stepper.with_state(carry, own), end), None

        return jax.lax.scan(step, (carry, momenta), length=as_count("steps", steps))[0]

    def _driven(self, body: Any, total: Array, begin: Array, motor: Array, h: Array) -> Array:
        """The momenta after a time in which motors and bearings act and the total momentum is constant."""
        if self.friction is None or self.inertia is None:
            return self._limited(begin + h * motor)
        rate = self.friction / self.inertia
        share = -jnp.expm1(-rate * h)

        def after(now: Array) -> Array:
            drive = motor + self.friction * (self.axes @ body.velocity(total - now @ self.axes))
            return begin + share * (drive / rate - begin)

        return self._limited(after((begin + after(begin)) / 2))

    def _limited(self, momenta: Array) -> Array:
        return momenta if self.momentum is None else jnp.clip(momenta, -self.momentum, self.momentum)

    def _of_wheels(self, name: str, value: Any) -> Array | None:
        if value is None:
            return None
        value = as_not_negative(name, value, cure="pass its size.")
        if value.shape not in ((), self.axes.shape[:1]):
            raise ValueError(f"{name} must have shape () or {self.axes.shape[:1]}, got {value.shape}.")
        return value

    def _one_each(self, name: str, value: Any, dtype: Any) -> Array:
        value = jnp.asarray(value, dtype)
        if value.shape != self.axes.shape[:1]:
            raise ValueError(f"{name} must have shape {self.axes.shape[:1]}, one for each wheel, got {value.shape}.")
        return value


def _turned(state: AnyState, momentum: Array, turn: Array) -> Any:
    if state.several:
        raise ValueError(f"wheels need a state of one body, got a {type(state).__name__}.")
    arrays = so3.rotate(so3.conjugate(turn), momentum), so3.multiply(attitude_of(state), turn)
    return eqx.tree_at(lambda s: (s.momentum, s.attitude), state, arrays)
