"""SPIRAL: a leapfrog of the discrete element method, with a Runge-Kutta method of order 3 for the momentum."""

from typing import Any

import equinox as eqx
from jax import Array

from .._math import components as cp
from .._math.short_series import half_turn
from ..model.bodies import RigidBody
from .base import Method
from .system import AnyMotion, Motion, Stepped, System
from .verdict import verdict

_REACH = 1.6  # radians
_LARGEST_DECAY = 2.5127  # the largest x with |1 - x + x^2/2 - x^3/6| <= 1: the limit of a Runge-Kutta step of order 3


class Spiral(Method):
    """Pi <- S(h/2) Pi at R0, R1 = R0 exp(h I^-1 Pi), Pi <- S(h/2) Pi at R1.

    S(k) is a step k of Pi' = Pi x I^-1 Pi + T at a fixed attitude by the Runge-Kutta method SSPRK3 of order 3:

        k1 = k f(Pi),  k2 = k f(Pi + k1),  k3 = k f(Pi + (k1 + k2)/4),  Pi + (k1 + k2 + 4 k3)/6

    This is the leapfrog form of the algorithm, as its first author wrote it for velocity Verlet (JaxDEM). The torque is
    evaluated once per step, or at each stage if it reads the momentum. The order is 2; only the momentum at a fixed
    attitude has order 3. A step reports False in `ok` if it rotates by more than 1.6 radians.

    C. A. del Valle, V. Angelidakis, S. Roy, J. D. Munoz, T. Poeschel, Comput. Phys. Commun. 297 (2024) 109077, arXiv
    2311.04106.
    """

    name: str = eqx.field(static=True, default="SPIRAL")
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=False)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=False)
    bodies: type[Any] = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=1)

    @property
    def reach(self) -> float:
        return _REACH

    def stability_limit(self, direction: complex) -> float:
        """2 under a field, as for every leapfrog; a damping torque acts in two Runge-Kutta steps of h/2."""
        return 2 * _LARGEST_DECAY if -direction.real > abs(direction.imag) else 2.0

    def keeps_force(self, system: System) -> bool:
        return system.keeps_torque

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
        half_way = _pushed(system, t0, h / 2, motion, force)
        w = cp.scale(h / 2, system.velocity(half_way.momentum))
        turned = Motion(half_way.momentum, system.turned(half_way.pose, cp.square(half_turn(w)), h))
        force = system.force(t1, turned) if self.keeps_force(system) else None
        return _pushed(system, t1, h / 2, turned, force), force, verdict(True, (cp.dot(w, w), (_REACH / 2) ** 2))


def _pushed(system: System, t: Array, h: Array, motion: Motion[cp.Vector, Any], torque: Any) -> Motion[cp.Vector, Any]:
    """The motion after a step h of the momentum alone; the torque is evaluated at each stage unless given."""

    def change(added: cp.Vector) -> cp.Vector:
        momentum = cp.add(motion.momentum, added)
        here = system.force(t, Motion(momentum, motion.pose)) if torque is None else torque
        return cp.add(system.inertia.gyroscopic(h, momentum), cp.scale(h, here))

    first = change(cp.scale(0, motion.momentum))
    second = change(first)
    third = change(cp.scale(0.25, cp.add(first, second)))
    return system.pushed(motion, cp.scale(1 / 6, cp.add(cp.add(first, second), cp.scale(4, third))))
