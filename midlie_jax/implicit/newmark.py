"""NMB: the explicit Newmark rule in the body frame."""

from typing import Any

import equinox as eqx
from jax import Array

from .. import _components as cp
from .. import solve
from .._half_turn import LARGEST_SQUARE, half_turn
from ..bodies import RigidBody
from ..stepper import Method, Motion, System
from ._common import ITERATIONS, converged


class NewmarkBody(Method):
    """R1 = R0 exp(h Om0 + h^2 A0/2), I A1 + Om1 x I Om1 = T1, Om1 = Om0 + (h/2)(A0 + A1), gamma = 1/2.

    A0 is the angular acceleration at the start. Order 2, symmetric (the two accelerations change places under
    reversal); it does not keep the spatial momentum of a free body. Simo & Wong, IJNME 31 (1991) 19; Krysl &
    Endres, IJNME 62 (2005) 2154.
    """

    name: str = eqx.field(static=True, default="NMB")
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=True)
    bodies: type = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=1)

    def keeps_force(self, system: System) -> bool:
        return True

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion, force: Any
    ) -> tuple[Motion, Any, Array | bool]:
        inertia = system.inertia
        velocity = cp.times(inertia.inverses, motion.momentum)
        rate = cp.add(cp.cross(motion.momentum, velocity), force)  # I A0
        w = cp.scale(h / 2, cp.add(velocity, cp.scale(h / 2, cp.times(inertia.inverses, rate))))
        half = half_turn(w)
        pose = system.landed(motion.pose, cp.multiply(half, half), h)

        def kicked(new_rate: cp.Vector) -> cp.Vector:
            return cp.add(motion.momentum, cp.scale(h / 2, cp.add(rate, new_rate)))

        # One evaluation serves all iterations, unless the torque reads the momentum that is being solved for.
        torque = None if system.reads_momentum else system.force(t1, Motion(motion.momentum, pose))

        def torque_at(momentum: cp.Vector) -> cp.Vector:
            return system.force(t1, Motion(momentum, pose)) if torque is None else torque

        def residual(new_rate: cp.Vector) -> cp.Vector:
            momentum = kicked(new_rate)
            spin = cp.cross(momentum, cp.times(inertia.inverses, momentum))
            return cp.subtract(new_rate, cp.add(spin, torque_at(momentum)))

        new_rate, left = solve.newton(residual, rate, ITERATIONS, unrolled=torque is not None)
        momentum = kicked(new_rate)
        spin_scale = cp.scale(cp.largest(cp.times(inertia.inverses, momentum)), momentum)
        ok = converged(left, new_rate, spin_scale) & (cp.dot(w, w) <= LARGEST_SQUARE)
        return Motion(momentum, pose), torque_at(momentum), ok
