"""AKW: the midpoint rule in the momentum, with Cayley's map for the attitude."""

from typing import Any

import equinox as eqx
from jax import Array

from .. import _components as cp
from .. import solve
from ..bodies import RigidBody
from ..stepper import Method, Motion, System
from ._common import ITERATIONS, converged


class AKW(Method):
    """Pi1 = Pi0 + h Pb x I^-1 Pb + (h/2)(T0 + T1), Pb = (Pi0 + Pi1)/2, R1 = R0 cay(h I^-1 Pb).

    Order 2, symmetric; Austin, Krishnaprasad & Wang, J. Comput. Phys. 107 (1993) 105.
    """

    name: str = eqx.field(static=True, default="AKW")
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=True)
    bodies: type = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=4 * ITERATIONS + 2)

    def keeps_force(self, system: System) -> bool:
        return True

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion, force: Any
    ) -> tuple[Motion, Any, Array | bool]:
        inertia = system.inertia

        def end(mean: cp.Vector) -> tuple[Motion, cp.Vector, cp.Vector]:
            """The motion at the end, the torque there, and the mean angular velocity."""
            velocity = cp.times(inertia.inverses, mean)
            momentum = cp.subtract(cp.scale(2, mean), motion.momentum)
            there = Motion(momentum, system.landed(motion.pose, _cayley(cp.scale(h, velocity)), h))
            return there, system.force(t1, there), velocity

        def residual(mean: cp.Vector) -> cp.Vector:
            _, torque, velocity = end(mean)
            change = cp.add(cp.cross(mean, velocity), cp.scale(0.5, cp.add(force, torque)))
            return cp.subtract(cp.scale(2, cp.subtract(mean, motion.momentum)), cp.scale(h, change))

        mean, left = solve.newton(residual, motion.momentum, ITERATIONS)
        there, torque, _ = end(mean)
        return there, torque, converged(left, mean, motion.momentum)


def _cayley(angle: cp.Vector) -> cp.Quaternion:
    """(1 - w^/2)^-1 (1 + w^/2) as a unit quaternion."""
    x, y, z = cp.scale(0.5, angle)
    factor = cp.inverse_root(1 + x * x + y * y + z * z)
    return factor, factor * x, factor * y, factor * z
