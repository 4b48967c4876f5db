"""Two classical Lie-group methods of order 4, written with the rotations of this package and run like its own methods.

Both integrate the pair (R, pi), where pi = R Pi is the momentum in space: R' = R skew(I^-1 R^T pi), pi' = R T. The
momentum takes a classical Runge-Kutta step, and the attitude a step of products of exponentials. So pi is constant for
a free body.
"""

from typing import Any

import equinox as eqx
from jax import Array

from midlie_jax._math import components as cp
from midlie_jax._math.short_series import LARGEST_SQUARE, half_turn
from midlie_jax._xla.fusion import fuse
from midlie_jax.integrators.base import Method
from midlie_jax.integrators.system import AnyMotion, Motion, System
from midlie_jax.model.bodies import RigidBody


class _OnTheGroup(Method):
    """Base of both methods: the properties that they share."""

    name: eqx.AbstractVar[str]
    order: int = eqx.field(static=True, default=4)
    symmetric: bool = eqx.field(static=True, default=False)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=True)
    bodies: type = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=4)

    def keeps_force(self, system: System) -> bool:
        return False


def _rates(system: System, t: Array, momentum: cp.Vector, pose: Any) -> tuple[cp.Vector, cp.Vector]:
    """Angular velocity in the body frame I^-1 R^T pi, and torque in space R T."""
    body = cp.rotate_back(pose, momentum)
    velocity = cp.times(system.inertia.inverses, body)
    if system.torque is None:
        return velocity, (body[0] * 0, body[0] * 0, body[0] * 0)
    return velocity, cp.rotate(pose, system.force(t, Motion(body, pose)))


def _exp(v: cp.Vector) -> tuple[cp.Quaternion, Array]:
    half = cp.scale(0.5, v)
    root = half_turn(half)
    return cp.square(root), cp.dot(half, half)


def _sum(*terms: tuple[float, cp.Vector]) -> cp.Vector:
    total = cp.scale(*terms[0])
    for c, v in terms[1:]:
        total = cp.add(total, cp.scale(c, v))
    return total


def _weighted(k: list[cp.Vector]) -> cp.Vector:
    return _sum((1 / 6, k[0]), (1 / 3, k[1]), (1 / 3, k[2]), (1 / 6, k[3]))


class RKMK4(_OnTheGroup):
    """The classical Runge-Kutta method on u' = dexp_(-u)^-1 Omega, R = R0 exp(u), the inverse cut after two brackets.

    Order 4. Munthe-Kaas, Appl. Numer. Math. 29 (1999) 115.
    """

    name: str = eqx.field(static=True, default="RKMK4")

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        del force
        start, pose = cp.rotate(motion.pose, motion.momentum), motion.pose
        turns: list[cp.Vector] = []  # h times the angular velocity of each stage
        impulses: list[cp.Vector] = []  # h times the torque of each stage
        u, momentum, stage_pose = None, start, pose
        for stage, (c, t) in enumerate(((0.5, t0), (0.5, t0 + h / 2), (1.0, t0 + h / 2), (None, t1))):
            velocity, torque = _rates(system, t, momentum, stage_pose)
            if u is not None:  # dexp_(-u)^-1 v = v + u x v / 2 + u x (u x v) / 12
                first = cp.cross(u, velocity)
                velocity = _sum((1.0, velocity), (0.5, first), (1 / 12, cp.cross(u, first)))
            turns.append(cp.scale(h, velocity))
            impulses.append(cp.scale(h, torque))
            if c is not None:
                u, momentum = cp.scale(c, turns[stage]), cp.add(start, cp.scale(c, impulses[stage]))
                turns, impulses, u, momentum = fuse((turns, impulses, u, momentum))
                stage_pose = cp.multiply(pose, _exp(u)[0])
        increment, square = _exp(_weighted(turns))
        momentum = cp.add(start, _weighted(impulses))
        turned = system.turned(pose, increment, h)
        return Motion(cp.rotate_back(turned, momentum), turned), None, square <= LARGEST_SQUARE


class CF4(_OnTheGroup):
    """The commutator-free method of order 4: five exponentials and no bracket.

    Celledoni, Marthinsen & Owren, Future Gener. Comput. Syst. 19 (2003) 341.
    """

    name: str = eqx.field(static=True, default="CF4")

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        del force
        start, pose = cp.rotate(motion.pose, motion.momentum), motion.pose

        def stage(t: Array, momentum: cp.Vector, stage_pose: Any) -> tuple[cp.Vector, cp.Vector]:
            velocity, torque = _rates(system, t, momentum, stage_pose)
            return fuse((cp.scale(h, velocity), cp.scale(h, torque)))

        v1, f1 = stage(t0, start, pose)
        second = cp.multiply(pose, _exp(cp.scale(0.5, v1))[0])
        v2, f2 = stage(t0 + h / 2, cp.add(start, cp.scale(0.5, f1)), second)
        third = cp.multiply(pose, _exp(cp.scale(0.5, v2))[0])
        v3, f3 = stage(t0 + h / 2, cp.add(start, cp.scale(0.5, f2)), third)
        fourth = cp.multiply(second, _exp(_sum((1.0, v3), (-0.5, v1)))[0])
        v4, f4 = stage(t1, cp.add(start, f3), fourth)
        inner, inner_square = _exp(_sum((0.25, v1), (1 / 6, v2), (1 / 6, v3), (-1 / 12, v4)))
        outer, outer_square = _exp(_sum((-1 / 12, v1), (1 / 6, v2), (1 / 6, v3), (0.25, v4)))
        momentum = cp.add(start, _weighted([f1, f2, f3, f4]))
        turned = system.turned(cp.multiply(pose, inner), outer, h)
        ok = (inner_square <= LARGEST_SQUARE) & (outer_square <= LARGEST_SQUARE)
        return Motion(cp.rotate_back(turned, momentum), turned), None, ok
