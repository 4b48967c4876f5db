"""What an adaptive controller is told: a step less its companion, a quadrature of rates that are known anyway.

The companion of a step from Pi0 to Pi1 turns by the fourth-order Magnus expansion of the angular velocities a0, a1
and angular accelerations b0, b1 at both ends,

    c = h/2 (a0 + a1) + h^2/12 (b0 - b1) + h^2/12 a0 x a1      (Iserles & Norsett, Phil. Trans. A 357 (1999) 983)

and its spatial momentum grows by the trapezium rule of the spatial torque, put right by its curvature T'',

    h/2 (T0 + T1) - h^3/12 T''.

Everything comes from the two ends, but T'': from three values of the torque, one of them of the step before. So the
companion is of local order h^5 in the attitude and h^4 in the momentum, whatever the method, which therefore shows its
own error if its order is 1 or 2, asymptotically exactly, and that of the companion, which is larger, if it is 4 or
more. On the first step, and after a jump, there is no step before: the torque is then taken to have been constant,
which leaves h^2 in the momentum, and makes a first step small rather than wrong.

An expansion tells nothing of long turns, and so a step of more than 2.4 radians has no companion.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.short_series import LARGEST_SQUARE, half_turn
from ..methods.inertia import Inertia
from ..methods.system import AnyMotion, Motion, System

REFERENCE_ORDER = 3  # of the companion: what it leaves out is of one order more


class History(NamedTuple):
    """What a step hands on to the estimate of the next.

    Attributes:
        slope: mean rate of change of the spatial torque over the step, in body components at its end.
        span: the signed length of the step; 0 where there was none, or a jump since.
    """

    slope: Any
    span: Array

    @classmethod
    def none(cls, momentum: Any, h: Array) -> "History":
        """Before the first step."""
        return cls(jax.tree.map(lambda p: p * 0, momentum), h * 0)


def companion(
    system: System, h: Array, motion: AnyMotion, end: AnyMotion, torques: tuple[Any, Any], history: History
) -> tuple[AnyMotion, History, Array]:
    """Where the step from `motion` to `end` should have ended, seen from the rates at both; what to hand on; if known.

    Args:
        h: the signed step.
        torques: at both ends, body frame, as components; for particles forces.
        history: of the step before.
    """
    total = h + history.span
    # The share of the step in the time since the step before; a step without length has nothing to estimate.
    share = h / jnp.where(total == 0, jnp.ones_like(total), total)
    rate = 1 / jnp.where(h == 0, jnp.ones_like(h), h)
    v0, v1 = system.velocity(motion.momentum), system.velocity(end.momentum)
    if not isinstance(system.inertia, Inertia):
        change = torques[1] - torques[0]
        impulse = h / 2 * (torques[0] + torques[1]) - h / 6 * share * (change - h * history.slope)
        travel = h / 2 * (v0 + v1) - h * h / 12 * system.inertia.velocity(change)
        return Motion(motion.momentum + impulse, motion.pose + travel), History(rate * change, h), jnp.array(True)

    def acceleration(momentum: cp.Vector, velocity: cp.Vector, torque: cp.Vector) -> cp.Vector:
        return system.velocity(system.kind.momentum_rate(momentum, velocity, torque))

    bend = cp.subtract(acceleration(motion.momentum, v0, torques[0]), acceleration(end.momentum, v1, torques[1]))
    mean = cp.add(cp.scale(h / 4, cp.add(v0, v1)), cp.scale(h * h / 24, cp.add(bend, cp.cross(v0, v1))))
    half, known = half_turn(mean), cp.dot(mean, mean) <= LARGEST_SQUARE
    turn = cp.square(half)
    later = cp.rotate(turn, torques[1])
    change = cp.subtract(later, torques[0])
    impulse = cp.scale(h / 2, cp.add(torques[0], later))
    impulse = cp.subtract(impulse, cp.scale(h / 6 * share, cp.subtract(change, cp.scale(h, history.slope))))
    momentum = cp.rotate_back(turn, cp.add(motion.momentum, impulse))
    pose = system.kind.rotate(motion.pose, turn)
    return Motion(momentum, pose), History(cp.rotate_back(turn, cp.scale(rate, change)), h), known
