"""SW: Simo and Wong's conserving algorithm, ALGO_C1."""

from typing import Any

import equinox as eqx
from jax import Array

from ..._kernel import components as cp
from ..._kernel.newton import newton
from ..._kernel.short_series import half_turn
from ...model.bodies import RigidBody
from ..flights.lie_midpoint import free_start
from ..stepper import Method, Motion, System
from ._common import ITERATIONS, carried, converged, middle, within_reach


class SW(Method):
    """I Psi = (h/2)(Pi0 + Pi1), R1 = R0 exp(Psi), Pi1 = exp(-Psi) Pi0 + h exp(-Psi/2) Tm.

    Tm is the torque at t + h/2 and R0 exp(Psi/2). Order 2, symmetric; Simo & Wong, IJNME 31 (1991) 19.
    """

    name: str = eqx.field(static=True, default="SW")
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=True)
    bodies: type = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=4 * ITERATIONS + 2)

    def keeps_force(self, system: System) -> bool:
        return False

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion, force: Any
    ) -> tuple[Motion, Any, Array | bool]:
        del t1, force
        inertia = system.inertia
        double = cp.scale(2, inertia.relative)

        def impulse(w: cp.Vector) -> tuple[cp.Quaternion, cp.Vector]:
            """exp(w), and h Tm."""
            half = half_turn(w)
            torque = system.force(t0 + h / 2, middle(system, motion, h, w, half))
            return half, cp.scale(h, torque)

        def residual(w: cp.Vector) -> cp.Vector:
            half, kick = impulse(w)
            end = cp.rotate_back(half, cp.add(cp.rotate_back(half, motion.momentum), kick))
            total = inertia.travel(h, cp.add(motion.momentum, end))
            return cp.subtract(cp.times(double, w), cp.scale(0.5, total))

        y = inertia.travel(h, motion.momentum)
        w, left = newton(residual, free_start(double, y), ITERATIONS)
        half, kick = impulse(w)
        momentum = carried(motion.momentum, half, kick, t0)
        pose = system.turned(motion.pose, cp.square(half), t0, h)
        ok = converged(left, cp.times(double, w), y) & within_reach(inertia, h, w, motion.momentum, momentum)
        return Motion(momentum, pose), None, ok
