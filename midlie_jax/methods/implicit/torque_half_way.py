"""Steps on the group with the torque taken half way: what LIEMID[I] and SW share."""

from abc import abstractmethod
from typing import Any

import jax.numpy as jnp
from jax import Array

from ..._kernel import components as cp
from ..._kernel.newton import newton
from ..._kernel.short_series import half_turn
from ..flights.lie_midpoint import free_start
from ..inertia import Inertia
from ..system import Motion, System
from .base import ITERATIONS, Implicit, converged

_REACH = 0.75  # radians of half the turn


class TorqueHalfWay(Implicit):
    """I Psi = h M, Pi1 = exp(-Psi) Pi0 + h exp(-Psi/2) Tm, R1 = R0 exp(Psi).

    Tm is the torque at t + h/2 and R0 exp(Psi/2). The methods differ in the mean momentum M. They say False where the
    solve did not settle, or the step turned by more than 1.5 radians or began or ended with more than 12.
    """

    @abstractmethod
    def mean_momentum(self, start: cp.Vector, half: cp.Quaternion, impulse: cp.Vector) -> cp.Vector:
        """M, from the momentum at the start, exp(Psi/2), and h Tm."""

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion[cp.Vector, Any], force: Any
    ) -> tuple[Motion[cp.Vector, Any], Any, Array | bool]:
        del t1, force
        inertia: Inertia = system.inertia
        double = cp.scale(2, inertia.relative)

        def impulse(w: cp.Vector) -> tuple[cp.Quaternion, cp.Vector]:
            """exp(w), and h Tm."""
            half = half_turn(w)
            torque = system.force(t0 + h / 2, _half_way(system, motion, h, w, half))
            return half, cp.scale(h, torque)

        def residual(w: cp.Vector) -> cp.Vector:
            mean = self.mean_momentum(motion.momentum, *impulse(w))
            return cp.subtract(cp.times(double, w), inertia.travel(h, mean))

        y = inertia.travel(h, motion.momentum)
        w, left = newton(residual, free_start(double, y), ITERATIONS)
        half, push = impulse(w)
        turned = cp.rotation_change(cp.conjugate(cp.square(half)), motion.momentum)
        momentum = cp.accumulate(motion.momentum, cp.add(turned, cp.rotate_back(half, push)), t0)
        pose = system.turned(motion.pose, cp.square(half), t0, h)
        ok = converged(left, cp.times(double, w), y) & _within_reach(inertia, h, w, motion.momentum, momentum)
        return Motion(momentum, pose), None, ok


def _within_reach(inertia: Inertia, h: Array, w: cp.Vector, start: cp.Vector, end: cp.Vector) -> Array:
    """Whether a step that turns by 2 w has one root only: by 1.5 radians at most, and not too fast at either end.

    Beyond that a slender body, or one about its middle axis, may have several rotations by which the rule is satisfied.
    """
    ends = [inertia.on_first_root(inertia.travel(h, momentum)) for momentum in (start, end)]
    return (cp.dot(w, w) <= _REACH**2) & ends[0] & ends[1]


def _half_way(
    system: System, motion: Motion[cp.Vector, Any], h: Array, w: cp.Vector, half: cp.Quaternion
) -> Motion[cp.Vector, Any]:
    """The motion half way through a step that turns by 2 w: momentum 2 I w / h, pose turned by exp(w)."""
    still = h == 0
    rate = 2 / jnp.where(still, jnp.ones_like(h), h)
    x, y, z = cp.times(system.inertia.moments, cp.scale(rate, w))
    a, b, c = motion.momentum
    momentum = jnp.where(still, a, x), jnp.where(still, b, y), jnp.where(still, c, z)
    return Motion(momentum, system.kind.rotate(motion.pose, half))
