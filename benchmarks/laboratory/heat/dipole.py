"""A dipole in a field at a temperature: its known averages, and those of runs with their standard errors.

Units of kT, of the dipole's moment of inertia across its axis, and of the time sqrt(I/kT). In the field x = mu B/kT the
energy is -x cos(theta), and <cos(theta)> = coth x - 1/x (P. Langevin 1905). Friction and steps are given in units of
the rate sqrt(1 + x), which is about that of libration.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import Compiled, compiled
from jax import Array

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options

FIELDS = 0.5, 2.0, 10.0
MOMENTS = 1.0, 1.0, 0.5
BODIES = 10_000
FRICTION = 1.0  # per moment of inertia, in units of the rate
_BURN_IN, _TIME, _BLOCKS = 10.0, 200.0, 8  # times of a run in units of 1/rate; and parts into which it is cut
_OBSERVED = 1.0  # the time between two observations, likewise: in between, little is new
_GRID = 256  # steps are multiples of 1/_GRID, so that float32 has all times of a run exactly


class Average(NamedTuple):
    """<cos(theta)> and the kinetic temperature in units of kT, and their standard errors."""

    cosine: float
    temperature: float
    cosine_error: float
    temperature_error: float


def exact(x: float) -> float:
    """<cos(theta)>."""
    return 1 / math.tanh(x) - 1 / x


def rate(x: Any) -> Any:
    return (1 + x) ** 0.5


def step(x: float, share: float) -> float:
    """The step that is this share of 1/rate, rounded."""
    return round(share / rate(x) * _GRID) / _GRID


class Plan(NamedTuple):
    """How many steps a run has, those before it counts, and those between two observations."""

    steps: int
    skipped: int
    every: int

    @classmethod
    def of(cls, share: float) -> "Plan":
        """That of a step which is this share of 1/rate."""
        every = max(1, round(_OBSERVED / share))
        skipped = math.ceil(_BURN_IN / share / every)
        counted = math.ceil(_TIME / share / every / _BLOCKS) * _BLOCKS
        return cls(every * (skipped + counted), every * skipped, every)


def thermal(key: Array, x: Any, dtype: Any = jnp.float32) -> ml.RigidState:
    """Bodies in the equilibrium of the exact motion."""
    a, b, c = jax.random.split(key, 3)
    low = jnp.exp(-2 * x)
    cosine = 1 + jnp.log(low + (1 - low) * jax.random.uniform(a, (BODIES,), dtype, 1e-7)) / x
    half, turn, spin = jnp.arccos(jnp.clip(cosine, -1, 1)) / 2, *jax.random.uniform(b, (2, BODIES), dtype) * 2 * math.pi
    attitude = jnp.cos(half) * jnp.cos(turn), jnp.sin(half) * jnp.cos(spin), jnp.sin(half) * jnp.sin(spin)
    attitude = jnp.stack([*attitude, jnp.cos(half) * jnp.sin(turn)], axis=-1)
    momentum = jax.random.normal(c, (BODIES, 3), dtype) * jnp.sqrt(jnp.asarray(MOMENTS, dtype))
    return ml.RigidState(momentum, attitude)


def observed(t: Array, state: ml.RigidState) -> Array:
    """cos(theta), and the kinetic temperature."""
    del t
    return jnp.stack(of_parts(state.momentum, state.attitude))


def of_parts(momentum: Any, attitude: Any) -> tuple[Array, Array]:
    """The same of the components of momentum and attitude along the last axis."""
    cosine = 1 - 2 * (attitude[..., 1] ** 2 + attitude[..., 2] ** 2)
    p, q, r = (momentum[..., i] ** 2 / MOMENTS[i] for i in range(3))
    return cosine, (p + q + r) / 3


def scene(x: Any, keys: Array, dtype: Any) -> tuple[ml.RigidBody, Any, Any]:
    """The body, the torque of the field, and the bath."""
    field = ml.torques.HeavyTop(jnp.asarray(-x, dtype))
    bath = ml.baths.Langevin(jnp.asarray(1.0, dtype), jnp.asarray(FRICTION * rate(x), dtype), keys)
    return ml.RigidBody(jnp.asarray(MOMENTS, dtype)), field, bath


Run = Callable[[Array, Any, Any], Array]  # from a key, the field and the step to the means of `observed`, (k, 2)


def ours(method: str, share: float, dtype: Any = jnp.float32) -> Run:
    """Runs of all bodies, compiled once for all fields."""
    plan = Plan.of(share)

    def run(key: Array, x: Array, h: Array) -> Array:
        a, b = jax.random.split(key)
        body, torque, bath = scene(x, jax.random.split(b, BODIES), dtype)
        mean = ml.observe.Mean(observed)
        options: Any = {"dt": h, "steps": plan.steps, "save_every": plan.every, "observe": mean}
        path = ml.ensemble(method, body, torque, thermal(a, x, dtype), bath=bath, **options)
        return path.states.mean[1 + plan.skipped // plan.every :]

    return jax.jit(run, compiler_options=compiler_options(BODIES))


def timed(method: str, x: float, h: float, steps: int, dtype: Any = jnp.float32) -> Compiled:
    """A run of this many steps without observations, compiled."""
    key = jax.random.key(0)
    body, torque, bath = scene(x, jax.random.split(key, BODIES), dtype)

    def run(start: ml.RigidState) -> Any:
        return ml.ensemble(method, body, torque, start, dt=jnp.asarray(h, dtype), steps=steps, bath=bath)

    start = thermal(key, x, dtype)
    return compiled(run, start, bodies=BODIES)


def averaged(run: Run, x: float, share: float, runs: int, seed: int = 0) -> Average:
    """The averages over several runs, and over blocks of each for the standard errors."""
    place = jnp.float32(x), jnp.float32(step(x, share))
    blocks = np.concatenate(list(_blocks(lambda key: run(key, *place), runs, seed)))
    mean, error = blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / math.sqrt(len(blocks))
    return Average(*map(float, (*mean, *error)))


def _blocks(run: Callable[[Array], Array], runs: int, seed: int) -> Iterator[np.ndarray]:
    for key in jax.random.split(jax.random.key(seed), runs):
        means = np.asarray(run(key), np.float64)
        yield means.reshape(_BLOCKS, -1, 2).mean(axis=1)
