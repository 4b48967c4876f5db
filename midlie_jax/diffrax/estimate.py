"""The error estimate for adaptive controllers: the step minus its companion, a quadrature of known rates.

The companion of a step from Pi0 to Pi1 is a second approximation of the end of the step. It rotates by the fourth-order
Magnus expansion of the angular velocities a0, a1 and angular accelerations b0, b1 at both ends,

    c = h/2 (a0 + a1) + h^2/12 (b0 - b1) + h^2/12 a0 x a1      (Iserles & Norsett, Phil. Trans. A 357 (1999) 983)

and its spatial momentum grows by the trapezium rule of the spatial torque, corrected by the second derivative T'',

    h/2 (T0 + T1) - h^3/12 T''.

T'' is computed from three values of the torque: at both ends of the step and at the start of the previous step. All
other quantities are taken at the two ends of the step. For any method, the local error of the companion is of order h^5
in the attitude and h^4 in the momentum.

On the first step, and after a jump, there is no previous step. A constant torque is then assumed, which leaves an error
of order h^2 in the momentum: the first step becomes smaller than necessary, never too large.

The expansion is useless for large rotations, so a step of more than 2.4 radians has no companion. The size of an
estimate is its `RotationNorm`.
"""

from functools import reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._math.short_series import LARGEST_SQUARE, half_turn
from ..integrators.system import AnyMotion, Motion, System
from ..model.state import State

REFERENCE_ORDER = 3  # order of the companion; its local error is of order h^(REFERENCE_ORDER + 1)


class History(NamedTuple):
    """Data of a step for the error estimate of the next step.

    Attributes:
        slope: mean rate of change of the spatial torque over the step, in body components at the end of the step.
        span: the signed length of the step; 0 before the first step and after a jump.
    """

    slope: Any
    span: Array


def _of_rates(
    system: System,
    h: Array,
    motion: AnyMotion,
    end: AnyMotion,
    torques: tuple[Any, Any],
    history: History,
    fraction: Array,
    rate: Array,
) -> tuple[AnyMotion, History, Array]:
    """The companion if the pose is more than an attitude; both formulas are applied to the rates of its components."""

    def rates(motion: AnyMotion, torque: Any) -> tuple[Any, Any, Any]:
        """The rates of momentum and pose, and the second derivative of the pose."""
        velocity = system.velocity(motion.momentum)
        force = system.kind.momentum_rate(motion.momentum, velocity, torque)
        pose = system.kind.rate(motion.pose, velocity)
        _, second = jax.jvp(system.kind.rate, (motion.pose, velocity), (pose, system.velocity(force)))
        return force, pose, second

    (f0, q0, s0), (f1, q1, s1) = rates(motion, torques[0]), rates(end, torques[1])

    def momentum(start: Array, a: Array, b: Array, slope: Array) -> Array:
        return start + (h / 2 * (a + b) - h / 6 * fraction * ((b - a) - h * slope))

    def pose(start: Array, a: Array, b: Array, c: Array, d: Array) -> Array:
        return start + (h / 2 * (a + b) - h * h / 12 * (d - c))

    target = Motion(
        jax.tree.map(momentum, motion.momentum, f0, f1, history.slope), jax.tree.map(pose, motion.pose, q0, q1, s0, s1)
    )
    return target, History(jax.tree.map(lambda a, b: rate * (b - a), f0, f1), h), jnp.array(True)


def companion(
    system: System, h: Array, motion: AnyMotion, end: AnyMotion, torques: tuple[Any, Any], history: History
) -> tuple[AnyMotion, History, Array]:
    """The end of the companion of a step, the history for the next step, and whether the companion is valid.

    The torques at both ends are components in the body frame; for particles they are the forces. It is valid if the
    step rotates by at most 2.4 radians.
    """
    total = h + history.span
    # The length of this step divided by the sum of this and the previous step; 0 for a step of length zero.
    fraction = h / jnp.where(total == 0, jnp.ones_like(total), total)
    rate = 1 / jnp.where(h == 0, jnp.ones_like(h), h)
    if not system.kind.turns:
        return _of_rates(system, h, motion, end, torques, history, fraction, rate)
    v0, v1 = system.velocity(motion.momentum), system.velocity(end.momentum)

    def acceleration(momentum: cp.Vector, velocity: cp.Vector, torque: cp.Vector) -> cp.Vector:
        return system.velocity(system.kind.momentum_rate(momentum, velocity, torque))

    acceleration_change = cp.subtract(
        acceleration(motion.momentum, v0, torques[0]), acceleration(end.momentum, v1, torques[1])
    )
    mean = cp.add(cp.scale(h / 4, cp.add(v0, v1)), cp.scale(h * h / 24, cp.add(acceleration_change, cp.cross(v0, v1))))
    half, valid = half_turn(mean), cp.dot(mean, mean) <= LARGEST_SQUARE
    turn = cp.square(half)
    later = cp.rotate(turn, torques[1])
    change = cp.subtract(later, torques[0])
    impulse = cp.scale(h / 2, cp.add(torques[0], later))
    impulse = cp.subtract(impulse, cp.scale(h / 6 * fraction, cp.subtract(change, cp.scale(h, history.slope))))
    momentum = cp.rotate_back(turn, cp.add(motion.momentum, impulse))
    pose = system.kind.act(motion.pose, turn)
    return Motion(momentum, pose), History(cp.rotate_back(turn, cp.scale(rate, change)), h), valid


class RotationNorm(eqx.Module):
    """A norm for `diffrax.PIDController(norm=...)` that measures momentum and attitude separately.

    The norm is the largest of two numbers, for a body that translates of four: the length of each error, or the angle
    between the two attitudes, in its unit. PIDController divides errors entry by entry by atol + rtol |y| before it
    calls the norm, and entries of a quaternion pass through zero. With rtol=0 the angle is therefore exact, and `atol`
    is the error allowed per step, in these units. With 0 < rtol <= atol the norm is accurate within a factor of 2.
    Under `BacksolveAdjoint` only the state is measured, not its adjoint.

    Attributes:
        momentum, linear, position: the units of the errors of the angular momentum, the linear momentum and position.
        angle: the unit of attitude error, in radians.

    Examples:
        >>> import diffrax
        >>> norm = ml.diffrax.RotationNorm(momentum=50.0)  # a momentum error of 50 has the weight of one radian
        >>> controller = diffrax.PIDController(rtol=0.0, atol=1e-6, norm=norm)
    """

    momentum: float | Array = 1.0
    angle: float | Array = 1.0
    linear: float | Array = 1.0
    position: float | Array = 1.0

    def __call__(self, error: Any) -> Array:
        parts = jax.tree.leaves(error, is_leaf=lambda part: isinstance(part, State))
        state = next(part for part in parts if isinstance(part, State))
        units = self.momentum, self.angle, self.linear, self.position
        return reduce(jnp.maximum, (size / unit for size, unit in zip(state.kind.sizes(state), units, strict=False)))
