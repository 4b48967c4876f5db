"""Detects blow-ups of translating or coupled bodies: the run gained energy that its forces do not give.

A step beyond the stability limit of a force makes the motion grow without bound, but stay finite; the reach of a method
detects this only for rotations. For a potential that does not depend on time, the run therefore compares its final
energy with its initial energy, once, outside the loop over steps; `simulate` at the end of each part.

With the kinetic energy K and the potential V, a stable step of an oscillator of frequency w gains at most a / (1 - a)
(K0 + max(V0 - V1, 0)), where a is the square of h w over its limit. `_MOST` admits h w up to 0.976 of it.
"""

from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from ..integrators.base import Progress
from ..integrators.projection import steady_potential
from ..integrators.system import AnyMotion, System
from ..integrators.verdict import FINE, UNSTABLE, earlier
from ..model.bodies import Particles
from ..model.state import AnyState

_MOST = 20.0
_LEAST_STEPS = 128  # in a shorter run, two potentials would take at least 3 % of the time
_ROUNDING = 1e4  # in units of eps: a motion per step, relative to the position, that rounding alone may cause


def with_gain_judged(
    system: System, start: AnyState, t: Array, h: Array, steps: int | Array, progress: Progress
) -> Progress:
    """The progress at the end of a run, with the verdict UNSTABLE if the run gained energy."""
    judged = steps >= _LEAST_STEPS
    potential = None if judged is False else _potential(system, start, t)
    if potential is None:
        return progress

    def kinetic_of(motion: AnyMotion) -> Array:
        products = jax.tree.map(jnp.multiply, motion.momentum, system.velocity(motion.momentum))
        zero = jnp.zeros((), jax.tree.leaves(motion)[0].dtype)
        return sum(map(jnp.sum, jax.tree.leaves(products)), start=zero) / 2

    ends = jax.lax.stop_gradient(jax.tree.map(lambda *x: jnp.stack(x), system.motion(start), progress.motion))
    kinetic = jax.vmap(kinetic_of)(ends)
    height = jax.lax.stop_gradient(jax.vmap(lambda motion: system.number(potential, t, motion))(ends))
    gain = (kinetic[1] - kinetic[0]) + (height[1] - height[0])
    given = kinetic[0] + jnp.maximum(height[0] - height[1], 0)
    eps = jnp.finfo(gain.dtype).eps
    gained = judged & (gain > _MOST * given + _ROUNDING * eps * jnp.abs(height[0]))
    unstable = gained & _moves(system, _ROUNDING * float(eps), h, jax.lax.stop_gradient(progress.motion))
    return progress._replace(verdict=earlier(progress.verdict, jnp.where(unstable, UNSTABLE, FINE)))


def _potential(system: System, start: AnyState, t: Array) -> Any:
    """The potential that conserves the energy of translating or coupled bodies, or particles; None if none does."""
    travels = system.kind.rotation is not None or system.kind.several or isinstance(system.inertia, Particles)
    if system.torque is None or not travels or system.reads_momentum or system.bath is not None:
        return None
    return steady_potential(system.torque, t, start)


def _moves(system: System, least: float, h: Array, motion: AnyMotion) -> Array:
    """Whether a step moves a body by more than `least`, relative to its distance from the origin, or in radians."""
    moved = jnp.zeros_like(h, bool)
    for own, one in system.members(motion):
        velocity: Any = own.velocity(one.momentum)
        if own.kind.rotation is not None:
            moved = moved | (jnp.abs(h) * _largest(velocity.linear) > least * _largest(one.pose.position))
            velocity = velocity.angular
        size = _largest(one.pose) if isinstance(own.inertia, Particles) else 1.0
        moved = moved | (jnp.abs(h) * _largest(velocity) > least * size)
    return moved


def _largest(vector: Any) -> Array:
    return reduce(jnp.maximum, [jnp.max(jnp.abs(x)) for x in jax.tree.leaves(vector)])
