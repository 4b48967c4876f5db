"""`TorqueHalfWay`, the common step of LIEMID[I] and SW: implicit, on the group, with the torque at mid-step."""

from abc import abstractmethod
from typing import Any

import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.newton import newton
from ..._math.short_series import half_turn
from ...model.inertia import Inertia
from ..flights.lie_midpoint import free_start
from ..system import Motion, System
from ..verdict import verdict
from .base import ITERATIONS, Implicit, converged

_LARGEST_HALF_TURN = 0.75  # radians


class TorqueHalfWay(Implicit):
    """I Psi = h M, Pi1 = exp(-Psi) Pi0 + h exp(-Psi/2) Tm, R1 = R0 exp(Psi).

    Tm is the torque at t + h/2 and R0 exp(Psi/2). The methods differ in the mean momentum M. A step reports False in
    `ok` if the solve did not converge, the step rotates by more than 1.5 radians, or h |Omega| at the start or the end
    exceeds 12 radians.
    """

    @property
    def reach(self) -> float:
        return 2 * _LARGEST_HALF_TURN

    @abstractmethod
    def mean_momentum(self, start: cp.Vector, half: cp.Quaternion, impulse: cp.Vector) -> cp.Vector:
        """M, from the momentum at the start, `half` = exp(Psi/2), and `impulse` = h Tm."""

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion[cp.Vector, Any], force: Any
    ) -> tuple[Motion[cp.Vector, Any], Any, Array | bool]:
        del t1, force
        inertia: Inertia = system.inertia
        double = cp.scale(2, inertia.relative)

        def impulse(w: cp.Vector) -> tuple[cp.Quaternion, cp.Vector]:
            """exp(w) and h Tm, for half the rotation, w = Psi/2."""
            half = half_turn(w)
            torque = system.force(t0 + h / 2, _half_way(system, motion, h, w, half))
            return half, cp.scale(h, torque)

        def residual(w: cp.Vector) -> cp.Vector:
            mean = self.mean_momentum(motion.momentum, *impulse(w))
            return cp.subtract(cp.times(double, w), inertia.travel(h, mean))

        y = inertia.travel(h, motion.momentum)
        w, remaining = newton(residual, free_start(double, y), ITERATIONS)
        half, torque_impulse = impulse(w)
        turned = cp.rotation_change(cp.conjugate(cp.square(half)), motion.momentum)
        end = system.pushed(motion, cp.add(turned, cp.rotate_back(half, torque_impulse)))
        bounds = _bounds_of_single_root(inertia, h, w, motion.momentum, end.momentum)
        end = Motion(end.momentum, system.turned(end.pose, cp.square(half), h))
        return end, None, verdict(converged(remaining, cp.times(double, w), y), *bounds)


def _bounds_of_single_root(
    inertia: Inertia, h: Array, w: cp.Vector, start: cp.Vector, end: cp.Vector
) -> list[tuple[Array, float]]:
    """Bounds within which the equation of a step with rotation 2 w has a single root.

    They bound the rotation by 1.5 radians, and h |Omega| at both ends. Beyond them, several rotations may satisfy the
    rule for a slender body or for a spin about the middle axis.
    """
    ends = [inertia.bound_of_first_root(inertia.travel(h, momentum)) for momentum in (start, end)]
    return [(cp.dot(w, w), _LARGEST_HALF_TURN**2), *ends]


def _half_way(
    system: System, motion: Motion[cp.Vector, Any], h: Array, w: cp.Vector, half: cp.Quaternion
) -> Motion[cp.Vector, Any]:
    """The motion at mid-step of a step with rotation 2 w: the momentum 2 I w / h, and the pose rotated by exp(w)."""
    no_step = h == 0
    rate = 2 / jnp.where(no_step, jnp.ones_like(h), h)
    x, y, z = cp.times(system.inertia.moments, cp.scale(rate, w))
    a, b, c = motion.momentum
    momentum = jnp.where(no_step, a, x), jnp.where(no_step, b, y), jnp.where(no_step, c, z)
    return Motion(momentum, system.kind.act(motion.pose, half))
