"""NMB: the explicit Newmark rule in the body frame."""

from typing import Any

import equinox as eqx
from jax import Array

from ..._math import components as cp
from ..._math.newton import newton
from ..._math.short_series import LARGEST_SQUARE, LARGEST_TURN, half_turn
from ..system import Motion, System
from ..verdict import verdict
from .base import ITERATIONS, Implicit, converged


class NewmarkBody(Implicit):
    """R1 = R0 exp(h Om0 + h^2 A0/2), I A1 + Om1 x I Om1 = T1, Om1 = Om0 + (h/2)(A0 + A1), gamma = 1/2.

    A0 and A1 are the angular accelerations at the start and the end. Order 2, symmetric (reversing a step exchanges the
    two accelerations); the method does not conserve the spatial momentum of a free body. Simo & Wong, IJNME
    31 (1991) 19; Krysl & Endres, IJNME 62 (2005) 2154.
    """

    name: str = eqx.field(static=True, default="NMB")
    keeps_momentum: bool = eqx.field(static=True, default=False)
    evaluations: int = eqx.field(static=True, default=1)

    @property
    def reach(self) -> float:
        return LARGEST_TURN

    def keeps_force(self, system: System) -> bool:
        return not system.by_step

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion[cp.Vector, Any], force: Any
    ) -> tuple[Motion[cp.Vector, Any], Any, Array | bool]:
        def change(momentum: cp.Vector, torque: cp.Vector) -> cp.Vector:
            """h I A, with A the angular acceleration under this momentum and torque."""
            turn = cp.scale(h, system.velocity(momentum))
            return system.kind.momentum_rate(momentum, turn, cp.scale(h, torque))

        impulse = change(motion.momentum, system.force(t0, motion) if force is None else force)
        ahead = cp.add(motion.momentum, cp.scale(0.5, impulse))
        w = cp.scale(h / 2, system.velocity(ahead))
        half = half_turn(w)
        turned = Motion(motion.momentum, system.turned(motion.pose, cp.square(half), h))

        def end(end_impulse: cp.Vector) -> Motion[cp.Vector, Any]:
            return system.pushed(turned, cp.scale(0.5, cp.add(impulse, end_impulse)))

        # The torque is evaluated once for all iterations, unless it reads the momentum, which is the unknown.
        torque = None if system.reads_momentum else system.force(t1, turned)

        def torque_at(motion: Motion[cp.Vector, Any]) -> cp.Vector:
            return system.force(t1, motion) if torque is None else torque

        def residual(end_impulse: cp.Vector) -> cp.Vector:
            motion = end(end_impulse)
            return cp.subtract(end_impulse, change(motion.momentum, torque_at(motion)))

        end_impulse, remaining = newton(residual, impulse, ITERATIONS, unrolled=torque is not None)
        found = end(end_impulse)
        ok = verdict(converged(remaining, end_impulse, found.momentum), (cp.dot(w, w), LARGEST_SQUARE))
        return found, torque_at(found) if self.keeps_force(system) else None, ok
