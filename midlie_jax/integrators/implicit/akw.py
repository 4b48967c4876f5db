"""AKW: the implicit midpoint rule in the momentum, with the Cayley map for the attitude."""

from typing import Any

import equinox as eqx
from jax import Array

from ..._math import components as cp
from ..._math.newton import newton
from ..._math.short_series import LARGEST_SQUARE, LARGEST_TURN
from ..system import Motion, System
from ..verdict import verdict
from .base import ITERATIONS, Implicit, converged


class AKW(Implicit):
    """Pi1 = Pi0 + h Pb x I^-1 Pb + (h/2)(T0 + T1), Pb = (Pi0 + Pi1)/2, R1 = R0 cay(h I^-1 Pb).

    Order 2, symmetric. A step reports False in `ok` if the solve did not converge or the step rotates by more than 2.4
    radians. Austin, Krishnaprasad & Wang, J. Comput. Phys. 107 (1993) 105.
    """

    name: str = eqx.field(static=True, default="AKW")

    @property
    def reach(self) -> float:
        return LARGEST_TURN

    def keeps_force(self, system: System) -> bool:
        return not system.by_step

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion[cp.Vector, Any], force: Any
    ) -> tuple[Motion[cp.Vector, Any], Any, Array | bool]:
        force = system.force(t0, motion) if force is None else force

        def mean_and_turn(half: cp.Vector) -> tuple[cp.Vector, cp.Vector]:
            """The mean momentum Pb and the rotation h I^-1 Pb, for `half`, half the change of the momentum."""
            mean = cp.add(motion.momentum, half)
            return mean, cp.scale(h, cp.times(system.inertia.inverses, mean))

        def residual(half: cp.Vector) -> cp.Vector:
            mean, turn = mean_and_turn(half)
            end_momentum = cp.add(motion.momentum, cp.scale(2, half))
            torque = system.force(t1, Motion(end_momentum, system.kind.act(motion.pose, _cayley(turn))))
            kick = cp.scale(h / 2, cp.add(force, torque))
            return cp.subtract(cp.scale(2, half), cp.add(cp.cross(mean, turn), kick))

        # The unknown is the change of the momentum rather than the mean: the change is small, and so is its rounding
        # error.
        rate = cp.add(cp.cross(*mean_and_turn(cp.scale(0, motion.momentum))), cp.scale(h, force))
        half, remaining = newton(residual, cp.scale(0.5, rate), ITERATIONS)
        turn = mean_and_turn(half)[1]
        end = system.pushed(motion, cp.scale(2, half))
        end = Motion(end.momentum, system.turned(end.pose, _cayley(turn), h))
        ok = verdict(converged(remaining, end.momentum, motion.momentum), (cp.dot(turn, turn), 4 * LARGEST_SQUARE))
        return end, system.force(t1, end) if self.keeps_force(system) else None, ok


def _cayley(angle: cp.Vector) -> cp.Quaternion:
    """(1 - w^/2)^-1 (1 + w^/2) as a unit quaternion."""
    x, y, z = cp.scale(0.5, angle)
    factor = cp.inverse_root(1 + x * x + y * y + z * z)
    return factor, factor * x, factor * y, factor * z
