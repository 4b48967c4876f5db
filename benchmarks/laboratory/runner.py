"""`Runner`: one method on a batch of runs, compiled once, for laboratory work that asks one method many questions.

Body, torque, start and step differ from row to row, and the number of steps is an argument of the compiled program. So
a single compilation serves a ladder of steps, single steps from many neighbouring states, and a run of 1e8 steps that
stops for samples. `advice.program.Program` has one body, one torque and one step for all rows, and shares its inputs.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from midlie_jax._math import components as cp
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.drivers.clock import time_of
from midlie_jax.drivers.steps import OneStep
from midlie_jax.integrators.base import Method, Progress
from midlie_jax.integrators.system import System
from midlie_jax.model.bodies import RigidBody
from midlie_jax.model.states import RigidState


class Rows(NamedTuple):
    """A batch of runs; every leaf has the leading axis (n,).

    Attributes:
        body: moments (n, 3).
        torque: a torque whose parameters have one row for each run, or None.
        start: body-frame momenta (n, 3) and attitudes (n, 4).
        dt: steps, (n,).
    """

    body: RigidBody
    torque: Any
    start: RigidState
    dt: Array

    def energy(self, momentum: np.ndarray, attitude: np.ndarray) -> np.ndarray:
        """The energies (..., n) of states of these heavy tops or free bodies, in the precision of the states."""
        found = np.sum(momentum**2 / np.asarray(self.body.moments), axis=-1) / 2
        if self.torque is None:
            return found
        return found + np.asarray(self.torque.mgl) * (1 - 2 * np.sum(attitude[..., 1:3] ** 2, axis=-1))


class Runner:
    """A method on batches of runs; compiled for each shape and class of torque that it meets.

    Attributes:
        method: the method, fitted to the bodies.
    """

    def __init__(self, method: Method, body: RigidBody, most: int = 1):
        """Takes the method, the bodies (n, 3) to which it is fitted, and the most states that `path` returns."""
        self.method, self._most = method.fitted(body), most
        rows = jax.vmap(partial(_path, self.method, most), in_axes=(0, None, None, None))
        self._run = jax.jit(rows, compiler_options=compiler_options(len(body.moments)))

    def run(self, rows: Rows, steps: int, first: int = 0) -> tuple[RigidState, Array]:
        """The states after `steps` steps, the first of which has the index `first`, and `ok` for each row."""
        states, ok = self._run(rows, jnp.int32(first), jnp.int32(steps), jnp.int32(1))
        return jax.tree.map(lambda x: x[:, 0], states), ok

    def path(self, rows: Rows, every: int, count: int, first: int = 0) -> tuple[RigidState, Array]:
        """`count` states of each row, `every` steps apart, without the start: leading axes (n, count); and `ok`."""
        if not 1 <= count <= self._most:
            raise ValueError(f"count must be from 1 to {self._most}, got {count}; give the Runner a larger `most`.")
        states, ok = self._run(rows, jnp.int32(first), jnp.int32(every), jnp.int32(count))
        return jax.tree.map(lambda x: x[:, :count], states), ok


def _path(method: Method, most: int, row: Rows, first: Array, every: Array, count: Array) -> tuple[RigidState, Array]:
    zero = jnp.zeros_like(row.dt)
    system = System.of(row.body, row.torque, row.start, zero)

    def save(k: Array, carry: tuple[Progress, RigidState]) -> tuple[Progress, RigidState]:
        progress = OneStep(method, system, zero, row.dt).loop(carry[0], first + k * every, every)
        return progress, jax.tree.map(lambda all, x: all.at[k].set(x), carry[1], system.state(progress.motion))

    saved = jax.tree.map(lambda x: jnp.zeros((most, *x.shape), x.dtype), row.start)
    progress = method.begin(system, row.start, time_of(zero, row.dt, first))
    progress, saved = jax.lax.fori_loop(0, count, save, (progress, saved))
    return saved, progress.ok & cp.all_finite(progress.motion)


# ---- free bodies at random, and their spatial momentum without JAX ----

TURNS = 10.0 ** np.arange(-5.0, 0.5)  # radians a step, nearly


def free_bodies(equal_moments: bool, dtype: Any, *, count: int, seed: int) -> list[np.ndarray]:
    """Moments, momenta with angular velocities of 0.45 to 0.9, attitudes, steps: `count` bodies for each of `TURNS`."""
    rng, rows = np.random.default_rng(seed), count * len(TURNS)
    masses = rng.uniform(0.3, 1, (rows, 3))
    if equal_moments:
        masses[:, 1] = masses[:, 0]
    moments = masses.sum(1, keepdims=True) - masses
    momentum, attitude = rng.normal(size=(rows, 3)), rng.normal(size=(rows, 4))
    momentum *= rng.uniform(0.45, 0.9, (rows, 1)) / np.linalg.norm(momentum / moments, axis=1, keepdims=True)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return [x.astype(dtype) for x in (moments, momentum, attitude, np.repeat(TURNS, count))]


def spatial_momentum(attitude: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """R Pi, with R the rotation that the attitude stands for whatever its length; in the precision of the arguments."""
    w, u = attitude[..., :1], attitude[..., 1:]
    square = np.sum(attitude**2, axis=-1, keepdims=True)
    return momentum + 2 * np.cross(u, w * momentum + np.cross(u, momentum)) / square
