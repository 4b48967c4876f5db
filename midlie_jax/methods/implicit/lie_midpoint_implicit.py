"""LIEMID[I]: the midpoint rule on the group with the torque taken half way, implicit in it."""

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


class LieMidpointImplicit(Method):
    """I Psi = h (exp(-Psi/2) Pi0 + (h/2) Tm), Pi1 = exp(-Psi) Pi0 + h exp(-Psi/2) Tm, R1 = R0 exp(Psi).

    Tm is the torque at t + h/2 and R0 exp(Psi/2). Order 2, symmetric; Krysl 2004.
    """

    name: str = eqx.field(static=True, default="LIEMID[I]")
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
            """exp(w), and (h/2) Tm."""
            half = half_turn(w)
            torque = system.force(t0 + h / 2, middle(system, motion, h, w, half))
            return half, cp.scale(h / 2, torque)

        def residual(w: cp.Vector) -> cp.Vector:
            half, kick = impulse(w)
            inward = cp.add(cp.rotate_back(half, motion.momentum), kick)
            return cp.subtract(cp.times(double, w), inertia.travel(h, inward))

        guess = free_start(double, inertia.travel(h, motion.momentum))
        w, left = newton(residual, guess, ITERATIONS)
        half, kick = impulse(w)
        momentum = carried(motion.momentum, half, cp.scale(2, kick), t0)
        pose = system.turned(motion.pose, cp.square(half), t0, h)
        ok = converged(left, cp.times(double, w)) & within_reach(inertia, h, w, motion.momentum, momentum)
        return Motion(momentum, pose), None, ok
