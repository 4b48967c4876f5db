"""`DrivenWheels`: wheels with motors, whose momenta a control loop carries along with the body.

Reference: P. C. Hughes, Spacecraft Attitude Dynamics (1986), chapters 3 and 6 (gyrostats).
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_count, as_finite, as_not_negative, require
from .._math import components as cp
from ..drivers.stepper import Carry, Stepper
from ..model import so3
from ..model.state import AnyState, attitude_of


class DrivenWheels(eqx.Module):
    """Wheels with motors on a rotating body, for loops of a `midlie_jax.stepper`.

    The momentum h of a wheel is J (a . Omega + spin), its angular momentum along its axis a, with J the moment of the
    wheel about a. Motor and friction are the only torques about the axis, h' = motor - friction * spin, and the body
    feels their reaction and the gyroscopic torque. The state has the momentum I Omega without the wheels, where I
    contains the masses of the wheels but not their moments J about the axes.

    Each step exchanges momentum between body and wheels exactly. The total R (Pi + sum of h a) in space is therefore
    constant to rounding without other torques, for every command, if the method conserves the momentum of a free body
    (for a `TensorBody` to a few eps per step). The motion has an error of order 2.

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
        ...     carry, momenta = loop
        ...     state = free.state(carry)
        ...     wanted = 0.1 * state.attitude[1:] + 1.0 * body.velocity(state.momentum)  # on the wheels
        ...     return wheels.advance(free, carry, momenta, wanted, 5), None
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
            command: motor torques on the wheels, (n,), constant in these steps. Reduced to `torque`.
            steps: number of steps.
            torque, body: as for `Stepper.advance`; for external torques that are held, such as magnetic torquers.

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
