"""`Program`: a method on a batch of bodies, compiled once for any step and any number of steps.

`recommend`, the convergence charts and the comparison with other programs run and time it. It has the loop of
`integrate`, but the number of steps is an argument of the compiled program; so it has no reverse derivative.
`tests/test_work_precision.py` checks that its results equal those of `integrate`.
"""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .._kernel.width import vector_width_options
from ..methods.base import Method, Progress
from ..methods.system import System
from ..model.bodies import Body
from ..model.state import AnyState
from ..model.torques import TorqueLike
from .clock import ends_of_step


class Program:
    """A compiled method on a batch of bodies.

    Attributes:
        method: the method, fitted to the body.
        unroll: steps in each turn of the loop; the number of steps of a run must be a multiple of `unroll`.
    """

    def __init__(
        self,
        method: Method,
        body: Body,
        torque: TorqueLike | None,
        starts: AnyState,
        *,
        chunk: int | None = None,
        unroll: int | None = None,
    ):
        """Compiles the program.

        Args:
            method, body, torque: as for `integrate`, but not checked.
            starts: states with a leading axis of bodies.
            chunk: number of bodies moved at once, if it divides the number of bodies; otherwise, and by default, all
                bodies are moved at once.
            unroll: by default `method.unroll`.
        """
        self.method = method.fitted(body)
        self.unroll = self.method.unroll if unroll is None else unroll
        self._starts, self._dtype = starts, starts.momentum.dtype
        count = len(starts.momentum)
        size = chunk if chunk and count % chunk == 0 else count

        def run(starts: AnyState, dt: Array, turns: Array) -> tuple[AnyState, Array]:
            parts = jax.tree.map(lambda leaf: leaf.reshape(-1, size, *leaf.shape[1:]), starts)
            end_of_body = partial(end_state, self.method, body, torque, unroll=self.unroll)
            ends, ok = jax.lax.map(jax.vmap(lambda start: end_of_body(start, dt, turns)), parts)
            return jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[2:]), ends), ok.reshape(count)

        lowered = jax.jit(run).lower(starts, *self._arguments(0.0, 0))
        self._compiled = lowered.compile(compiler_options=vector_width_options())
        self.run(0.0, 0)  # the first call takes longer than the others and must not be timed

    def run(self, dt: float, steps: int) -> tuple[Any, Array]:
        """The states at the end, and `ok` for each body; waits until both are computed."""
        return jax.block_until_ready(self._compiled(self._starts, *self._arguments(dt, steps)))

    def whole(self, steps: int) -> int:
        """The least multiple of `unroll` that is at least `steps`, and not zero."""
        return self.unroll * max(1, math.ceil(steps / self.unroll))

    def _arguments(self, dt: float, steps: int) -> tuple[Array, Array]:
        return jnp.asarray(dt, self._dtype), jnp.asarray(steps // self.unroll, jnp.int32)


def end_state(
    method: Method,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState,
    dt: Array,
    turns: Array,
    *,
    unroll: int,
) -> tuple[AnyState, Array]:
    """The state after `turns` turns of the loop, each of `unroll` steps, and its `ok`; arguments are not checked."""
    zero = jnp.zeros((), start.momentum.dtype)
    system = System.of(body, torque, start, zero)
    motion = system.motion(start)
    force = system.force(zero, motion) if method.keeps_force(system) else None

    def turn(i: Array, progress: Progress) -> Progress:
        for k in range(unroll):
            progress, _ = method.advance(system, (zero, dt), partial(ends_of_step, i * unroll + k), dt, progress)
        return progress

    progress = jax.lax.fori_loop(0, turns, turn, Progress(motion, force, jnp.array(True)))
    return system.state(progress.motion), progress.ok
