"""NMB: the explicit Newmark rule in the body frame."""

from typing import Any

import equinox as eqx
from jax import Array

from ..._kernel import components as cp
from ..._kernel.newton import newton
from ..._kernel.short_series import LARGEST_SQUARE, half_turn
from ..system import Motion, System
from .base import ITERATIONS, Implicit, converged


class NewmarkBody(Implicit):
    """R1 = R0 exp(h Om0 + h^2 A0/2), I A1 + Om1 x I Om1 = T1, Om1 = Om0 + (h/2)(A0 + A1), gamma = 1/2.

    A0 is the angular acceleration at the start. Order 2, symmetric (the two accelerations change places under
    reversal); it does not keep the spatial momentum of a free body. Simo & Wong, IJNME 31 (1991) 19; Krysl &
    Endres, IJNME 62 (2005) 2154.
    """

    name: str = eqx.field(static=True, default="NMB")
    keeps_momentum: bool = eqx.field(static=True, default=False)
    evaluations: int = eqx.field(static=True, default=1)

    def keeps_force(self, system: System) -> bool:
        return True

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion[cp.Vector, Any], force: Any
    ) -> tuple[Motion[cp.Vector, Any], Any, Array | bool]:
        def change(momentum: cp.Vector, torque: cp.Vector) -> cp.Vector:
            """h I A, for the angular acceleration A."""
            turn = cp.scale(h, system.velocity(momentum))
            return system.kind.momentum_rate(momentum, turn, cp.scale(h, torque))

        impulse = change(motion.momentum, force)
        ahead = cp.add(motion.momentum, cp.scale(0.5, impulse))
        w = cp.scale(h / 2, system.velocity(ahead))
        half = half_turn(w)
        pose = system.turned(motion.pose, cp.square(half), t0, h)

        def kicked(new: cp.Vector) -> cp.Vector:
            return cp.accumulate(motion.momentum, cp.scale(0.5, cp.add(impulse, new)), t0)

        # One evaluation serves all iterations, unless the torque reads the momentum that is being solved for.
        torque = None if system.reads_momentum else system.force(t1, Motion(motion.momentum, pose))

        def torque_at(momentum: cp.Vector) -> cp.Vector:
            return system.force(t1, Motion(momentum, pose)) if torque is None else torque

        def residual(new: cp.Vector) -> cp.Vector:
            momentum = kicked(new)
            return cp.subtract(new, change(momentum, torque_at(momentum)))

        new, left = newton(residual, impulse, ITERATIONS, unrolled=torque is not None)
        momentum = kicked(new)
        ok = converged(left, new, momentum) & (cp.dot(w, w) <= LARGEST_SQUARE)
        return Motion(momentum, pose), torque_at(momentum), ok
