"""The implicit methods, which do not consist of flights and kicks: the other methods in Figure 1 of the paper."""

from abc import abstractmethod
from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._math.newton import newton
from .._math.short_series import LARGEST_SQUARE, LARGEST_TURN, half_turn
from ..model.bodies import Particles, RigidBody
from ..model.inertia import Inertia
from .base import Method
from .flights.lie_midpoint import free_start
from .system import AnyMotion, Motion, Stepped, System
from .verdict import verdict

# Newton steps with the exact Jacobian; five suffice up to a rotation of |Psi| = 1.5.
_ITERATIONS = 5
# In units of eps times the largest term; large, because a torque whose terms cancel has large rounding errors.
_RESIDUAL_LIMIT = 1024
_LARGEST_HALF_TURN = 0.75  # radians


class Implicit(Method):
    """A method of order 2 whose step is solved by Newton's method, with the torque in the residual."""

    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=True)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=True)
    bodies: type[Any] = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=4 * _ITERATIONS + 2)

    def stability_limit(self, direction: complex) -> float:
        """2: above, the equation of a step may have several solutions (`tests/test_limits.py`), and NMB is unstable."""
        return 2.0

    @property
    def solves(self) -> int:
        return 1


def _converged(residual: Array, *terms: cp.Vector) -> Array:
    """Whether the residual is at the level of rounding of the largest of its terms."""
    size = reduce(jnp.maximum, map(cp.largest, terms))
    return residual <= _RESIDUAL_LIMIT * cp.epsilon(size) * size


class _TorqueHalfWay(Implicit):
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

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
        inertia: Inertia = system.inertia
        double = cp.scale(2, inertia.relative)

        def impulse(w: cp.Vector) -> tuple[cp.Quaternion, cp.Vector]:
            """exp(w) and h Tm, for half the rotation, w = Psi/2."""
            half = half_turn(w)
            no_step = h == 0
            rate = 2 / jnp.where(no_step, jnp.ones_like(h), h)
            middle = cp.times(inertia.moments, cp.scale(rate, w))  # the momentum at mid-step, 2 I w / h
            half_way = Motion(cp.where(no_step, motion.momentum, middle), system.kind.act(motion.pose, half))
            return half, cp.scale(h, system.force(t0 + h / 2, half_way))

        def residual(w: cp.Vector) -> cp.Vector:
            mean = self.mean_momentum(motion.momentum, *impulse(w))
            return cp.subtract(cp.times(double, w), inertia.travel(h, mean))

        y = inertia.travel(h, motion.momentum)
        w, remaining = newton(residual, free_start(double, y), _ITERATIONS)
        half, torque_impulse = impulse(w)
        turned = cp.rotation_change(cp.conjugate(cp.square(half)), motion.momentum)
        end = system.pushed(motion, cp.add(turned, cp.rotate_back(half, torque_impulse)))
        # Beyond these bounds several rotations may satisfy the rule for a slender body or for a spin about the middle
        # axis.
        ends = [inertia.bound_of_first_root(inertia.travel(h, each.momentum)) for each in (motion, end)]
        bounds = [(cp.dot(w, w), _LARGEST_HALF_TURN**2), *ends]
        end = Motion(end.momentum, system.turned(end.pose, cp.square(half), h))
        return end, None, verdict(_converged(remaining, cp.times(double, w), y), *bounds)


class LieMidpointImplicit(_TorqueHalfWay):
    """I Psi = h (exp(-Psi/2) Pi0 + (h/2) Tm): order 2, symmetric; Krysl 2004."""

    name: str = eqx.field(static=True, default="LIEMID[I]")

    def mean_momentum(self, start: cp.Vector, half: cp.Quaternion, impulse: cp.Vector) -> cp.Vector:
        return cp.add(cp.rotate_back(half, start), cp.scale(0.5, impulse))


class SW(_TorqueHalfWay):
    """I Psi = (h/2)(Pi0 + Pi1): order 2, symmetric; Simo & Wong, IJNME 31 (1991) 19."""

    name: str = eqx.field(static=True, default="SW")

    def mean_momentum(self, start: cp.Vector, half: cp.Quaternion, impulse: cp.Vector) -> cp.Vector:
        end = cp.rotate_back(half, cp.add(cp.rotate_back(half, start), impulse))
        return cp.scale(0.5, cp.add(start, end))


class _TorqueAtEnds(Implicit):
    """A step has the torques at its start and its end; the next step begins with the latter."""

    @property
    def reach(self) -> float:
        return LARGEST_TURN

    def keeps_force(self, system: System) -> bool:
        return not system.by_step


class AKW(_TorqueAtEnds):
    """Pi1 = Pi0 + h Pb x I^-1 Pb + (h/2)(T0 + T1), Pb = (Pi0 + Pi1)/2, R1 = R0 cay(h I^-1 Pb).

    Order 2, symmetric. A step reports False in `ok` if the solve did not converge or the step rotates by more than 2.4
    radians. Austin, Krishnaprasad & Wang, J. Comput. Phys. 107 (1993) 105.
    """

    name: str = eqx.field(static=True, default="AKW")

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
        force = system.force(t0, motion) if force is None else force

        def mean_and_turn(half: cp.Vector) -> tuple[cp.Vector, cp.Vector]:
            """The mean momentum Pb and the rotation h I^-1 Pb, for `half`, half the change of the momentum."""
            mean = cp.add(motion.momentum, half)
            return mean, cp.scale(h, cp.times(system.inertia.inverses, mean))

        def residual(half: cp.Vector) -> cp.Vector:
            mean, turn = mean_and_turn(half)
            end_momentum = cp.add(motion.momentum, cp.scale(2, half))
            torque = system.force(t1, Motion(end_momentum, system.kind.act(motion.pose, cp.cayley(turn))))
            kick = cp.scale(h / 2, cp.add(force, torque))
            return cp.subtract(cp.scale(2, half), cp.add(cp.cross(mean, turn), kick))

        # The unknown is the change of the momentum rather than the mean, because its rounding error is small.
        rate = cp.add(cp.cross(*mean_and_turn(cp.scale(0, motion.momentum))), cp.scale(h, force))
        half, remaining = newton(residual, cp.scale(0.5, rate), _ITERATIONS)
        turn = mean_and_turn(half)[1]
        end = system.pushed(motion, cp.scale(2, half))
        end = Motion(end.momentum, system.turned(end.pose, cp.cayley(turn), h))
        ok = verdict(_converged(remaining, end.momentum, motion.momentum), (cp.dot(turn, turn), 4 * LARGEST_SQUARE))
        return end, system.force(t1, end) if self.keeps_force(system) else None, ok


class NewmarkBody(_TorqueAtEnds):
    """R1 = R0 exp(h Om0 + h^2 A0/2), I A1 + Om1 x I Om1 = T1, Om1 = Om0 + (h/2)(A0 + A1), gamma = 1/2.

    A0 and A1 are the angular accelerations at the start and the end. Order 2, symmetric; the method does not conserve
    the spatial momentum of a free body. Simo & Wong, IJNME 31 (1991) 19; Krysl & Endres, IJNME 62 (2005) 2154.
    """

    name: str = eqx.field(static=True, default="NMB")
    keeps_momentum: bool = eqx.field(static=True, default=False)
    evaluations: int = eqx.field(static=True, default=1)

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
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

        end_impulse, remaining = newton(residual, impulse, _ITERATIONS, unrolled=torque is not None)
        found = end(end_impulse)
        ok = verdict(_converged(remaining, end_impulse, found.momentum), (cp.dot(w, w), LARGEST_SQUARE))
        return found, torque_at(found) if self.keeps_force(system) else None, ok


class ImplicitMidpoint(Implicit):
    """p1 = p0 + h f(t + h/2, (u0 + u1)/2), u1 = u0 + h M^-1 (p0 + p1)/2: order 2, symmetric, symplectic."""

    name: str = eqx.field(static=True, default="implicit midpoint")
    symplectic: bool = eqx.field(static=True, default=True)
    bodies: type[Any] = eqx.field(static=True, default=Particles)
    evaluations: int = eqx.field(static=True, default=2 * _ITERATIONS + 1)

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
        start, position = motion.momentum, motion.pose

        def travel(mean: Array) -> Array:
            return h * system.inertia.velocity(mean)

        def residual(flat: Array) -> Array:
            mean = flat.reshape(start.shape)
            pushed = start + h / 2 * system.force(t0 + h / 2, Motion(mean, position + travel(mean) / 2))
            return (mean - pushed).ravel()

        def tangent(linear: Any, right: Array) -> Array:
            return jnp.linalg.solve(jax.jacfwd(linear)(right), right)

        def iterate(function: Any, flat: Array) -> Array:
            for _ in range(_ITERATIONS):
                flat = flat - jnp.linalg.solve(jax.jacfwd(function)(flat), function(flat))
            return flat

        flat = jax.lax.custom_root(residual, jax.lax.stop_gradient(start.ravel()), iterate, tangent)
        remaining = jnp.max(jnp.abs(jax.lax.stop_gradient(residual(flat))))
        mean = flat.reshape(start.shape)
        size = jnp.maximum(jnp.max(jnp.abs(mean)), jnp.max(jnp.abs(start)))
        ok = verdict(remaining <= 64 * jnp.finfo(start.dtype).eps * size)
        return Motion(2 * mean - start, position + travel(mean)), None, ok
