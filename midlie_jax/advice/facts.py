"""Quantities of a body in a field at one moment, for the rules of `check`."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp
from .._xla.replay import traits
from ..integrators.base import Method
from ..integrators.system import Motion, System
from ..model.observables import kinetic_energy
from ..model.state import AnyState
from ..model.torques import on_body, potential_of

FAST = 2.0  # a spin is fast if the frequency of its nutation exceeds that of the torque by this factor
_DIRECTIONS = 64  # number of directions of lambda, from growth to decay, with a computed stability limit


class Facts(NamedTuple):
    """Quantities of a body at one moment; with leading axes, of many bodies or moments.

    Attributes:
        turn_rate: the angle per unit of time to which the reach of the method refers, ().
        linear: the body under the linearised torque alone, as a matrix of its k velocities' displacements (a rotation
            vector for a rigid body) and its momentum, (2 k, 2 k).
        nutation: the frequency of a fast spin, `Body.inertia().nutation`, ().
        changes: the rates at which flight and torque change the momentum, relative to its size, (2,); see `Rounding`.
        variations: the rates at which these changes vary, relative to the size of the momentum, (2,).
        acceleration: |d Omega/dt|, ().
    """

    turn_rate: Any
    linear: Any
    nutation: Any
    changes: Any
    variations: Any
    acceleration: Any

    @classmethod
    def of(cls, method: Method, body: Any, torque: Any, state: AnyState, t: Array) -> "Facts":
        system = System.of(body, torque, state, t)
        motion = system.motion(state)
        rates = [method.turn_rate(own.inertia, one.momentum) for own, one in system.rotations(motion)]
        turn_rate = jnp.max(jnp.stack(rates))  # for coupled bodies, the fastest
        size = _norm(motion.momentum)
        speed, pull, jerk, acceleration = _speeds(system, t, motion)
        changes, variations = jnp.stack([speed, pull / size]), jnp.stack([speed * speed, jerk / size])
        nutation = jnp.max(system.inertia.nutation(motion.momentum))
        return cls(turn_rate, _linearised(system, t, motion), nutation, changes, variations, acceleration)

    @property
    def rates(self) -> Any:
        """The rates lambda of the torque, (..., 2 k); infinite if the torque or its derivative is not finite."""
        finite = np.all(np.isfinite(self.linear), axis=(-1, -2), keepdims=True)
        values = np.linalg.eigvals(np.where(finite, np.asarray(self.linear, np.float64), 0))
        return np.where(finite[..., 0], values, np.inf)

    @property
    def fastest_turn(self) -> Any:
        """`turn_rate` in root sum square with twice the largest rate of growth, (...).

        A body at rest falls from the unstable direction of a field, I x'' = k sin x, to the stable one. Its final speed
        is twice the rate of growth: I x'^2 / 2 = 2 k.
        """
        growth = np.max(np.maximum(self.rates.real, 0), axis=-1)
        return np.hypot(self.turn_rate, 2 * growth)


def _speeds(system: System, t: Array, motion: Any) -> tuple[Array, Array, Array, Array]:
    """|Omega|, |T|, the rate |dT/dt| of the torque along the motion, and |d Omega/dt|."""
    velocity = system.velocity(motion.momentum)
    torque = system.force(t, motion)
    rates = system.kind.momentum_rate(motion.momentum, velocity, torque), system.kind.rate(motion.pose, velocity)
    _, change = jax.jvp(system.force, (t, motion), (jnp.ones_like(t), Motion(*rates)))
    squares = (jnp.max(system.inertia.square_of_turn(1.0, x)) for x in (motion.momentum, rates[0]))
    speed, acceleration = map(cp.root, squares)
    return speed, _norm(torque), _norm(change), acceleration


def _norm(tree: Any) -> Array:
    numbers = cp.flat(tree)
    return cp.root(jnp.sum(numbers * numbers))


def _linearised(system: System, t: Array, motion: Any) -> Array:
    """The matrix of (displacement, momentum) under the linearised torque, without the terms of the free motion."""
    numbers = cp.flat(motion.momentum)
    units = jnp.eye(len(numbers), dtype=numbers.dtype)
    still = jnp.zeros_like(units)

    def tree(row: Array) -> Any:
        return cp.of_flat(row, motion.momentum)

    def change(momentum: Array, displacement: Array) -> Array:
        moved = Motion(tree(momentum), system.kind.rate(motion.pose, tree(displacement)))
        return cp.flat(jax.jvp(lambda m: system.force(t, m), (motion,), (moved,))[1])

    # Mapped, so the torque is traced once for all directions.
    changes = jax.vmap(change)(jnp.concatenate([still, units]), jnp.concatenate([units, still]))
    speeds = jax.vmap(lambda momentum: cp.flat(system.velocity(tree(momentum))))(units)
    return jnp.concatenate([jnp.concatenate([still, speeds]), changes], axis=1).T


def energies_if_constant(body: Any, torque: Any, states: AnyState, times: Array) -> tuple[Array, Array] | None:
    """Kinetic and potential energies (k,) of one body at several times.

    None if the sum is not constant, because the torque has no potential, or a time-dependent one.
    """
    kinetic = jax.vmap(lambda state: kinetic_energy(body, state))(states)
    if torque is None:
        return kinetic, jnp.zeros_like(kinetic)
    first = jax.tree.map(lambda x: x[0], states)
    try:
        potential = potential_of(on_body(torque, body))
        reads_time = traits(lambda t, s: jnp.asarray(potential(t, s)), times[0], first).reads[0]
    except ValueError:  # the torque, or a term of a sum, has no potential
        return None
    return None if reads_time else (kinetic, jax.vmap(potential)(times, states))


def stability_limits(method: Method, rates: np.ndarray) -> np.ndarray:
    """The stability limit for each rate; directions are rounded, so that few limits need be computed."""
    turns = np.rint(np.abs(np.angle(rates)) / np.pi * _DIRECTIONS).astype(int)
    turns = np.where(rates == 0, _DIRECTIONS // 2, turns)
    known = {n: method.stability_limit(_direction(n)) for n in set(turns.ravel().tolist())}
    return np.vectorize(known.__getitem__, otypes=[float])(turns)


def _direction(n: int) -> complex:
    """Direction number n, from growth (n = 0) to decay (n = `_DIRECTIONS`)."""
    angle = math.pi * n / _DIRECTIONS
    return complex(0 if 2 * n == _DIRECTIONS else math.cos(angle), math.sin(angle))
