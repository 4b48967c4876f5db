"""`Program`: a method on a batch of bodies, compiled once for any step and any number of steps.

It has the loop of `integrate`, but the number of steps is an argument of the compiled program, so it has no reverse
derivative. Later programs with the same method, torque function and shapes reuse the compiled code.
`tests/test_selection.py` checks that its results equal those of `integrate`.
"""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .._xla import budgets
from .._xla.compiler import tuned_jit
from ..drivers import shared_inputs
from ..drivers.steps import OneStep
from ..integrators.base import Method, Progress
from ..integrators.system import System
from ..model.bodies import Body
from ..model.state import AnyState
from ..model.torques import TorqueLike


class Program:
    """A compiled method on a batch of bodies; the number of steps of a run must be a multiple of `unroll`."""

    def __init__(
        self,
        method: Method,
        body: Body,
        torque: TorqueLike | None,
        starts: AnyState,
        *,
        chunk: int | None = None,
        unroll: int | None = None,
        t0: float | Array = 0.0,
    ):
        """Compiles the program, unless it was compiled before; `starts` have a leading axis of bodies.

        `chunk` bodies are moved at once, if it divides their number; otherwise, and by default, all of them.
        """
        self.method = method.fitted(body)
        self.unroll = self.method.unroll if unroll is None else unroll
        self._dtype = starts.momentum.dtype
        count = len(starts.momentum)
        size = chunk if chunk and count % chunk == 0 else count

        self._given = self.method, body, torque, size, self.unroll, jnp.asarray(t0, self._dtype), starts
        self.run(0.0, 0)  # the first call takes longer than the others and must not be timed

    def run(self, dt: float, steps: int) -> tuple[Any, Array]:
        """The states at the end, and `ok` for each body; waits until both are computed."""
        iterations = jnp.asarray(steps // self.unroll, jnp.int32)
        return jax.block_until_ready(_run(*self._given, jnp.asarray(dt, self._dtype), iterations))

    def whole(self, steps: int) -> int:
        """The least positive multiple of `unroll` that is at least `steps`."""
        return self.unroll * max(1, math.ceil(steps / self.unroll))


@partial(tuned_jit, bodies=lambda method, body, torque, size, *others: size)
def _run(
    method: Method,
    body: Body,
    torque: TorqueLike | None,
    size: int,
    unroll: int,
    t0: Array,
    starts: AnyState,
    dt: Array,
    iterations: Array,
) -> tuple[AnyState, Array]:
    """The states of all bodies after `iterations` iterations of the loop, each of `unroll` steps, and their `ok`.

    Inputs shared by all bodies are prepared for one block of iterations at a time, used by all chunks. Without such
    inputs all iterations form one block.
    """
    count = len(starts.momentum)
    first = jax.tree.map(lambda leaf: leaf[0], starts)
    own = (*jax.tree.map(lambda _: False, (body, torque)), jax.tree.map(lambda _: True, first), False, False)
    inputs = shared_inputs.find(method, (body, torque, first, dt, t0), own)
    system = System.of(body, torque, first, t0)
    if inputs is not None:
        system = inputs.placed(system)

    one = OneStep(method, system, t0, dt, inputs)

    def take_block(block: Array, progress: Progress) -> Progress:
        before = block * budgets.PREPARED_ROWS
        if inputs is None:
            in_block, rows = iterations, None
        else:
            in_block = jnp.minimum(iterations - before, budgets.PREPARED_ROWS)
            indices = before * unroll + jnp.arange(budgets.PREPARED_ROWS * unroll, dtype=jnp.int32)
            rows = inputs.table(system, t0, dt, indices)

        def of_body(progress: Progress) -> Progress:
            return one.loop(progress, before * unroll, in_block, unroll, rows)

        return jax.lax.map(jax.vmap(of_body), progress)

    parts = jax.tree.map(lambda leaf: leaf.reshape(-1, size, *leaf.shape[1:]), starts)
    progress = jax.vmap(jax.vmap(lambda start: method.begin(system, start, t0)))(parts)
    blocks = 1 if inputs is None else -(-iterations // budgets.PREPARED_ROWS)
    progress = jax.lax.fori_loop(0, blocks, take_block, progress)
    progress = jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[2:]), progress)
    return jax.vmap(system.state)(progress.motion), progress.ok
