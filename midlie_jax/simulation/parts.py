"""Computes the parts of a run, one after the other, while a thread writes those before."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from .._kernel.width import wide_jit
from ..drivers.adjoints import as_adjoint
from ..drivers.chunks import run_ensemble, shared_tables
from ..drivers.ensemble import Batch
from ..drivers.observe import Observe, Statistic
from ..methods.base import Method
from ..model.state import AnyState
from .names import named
from .plan import Part, Plan
from .sink import Arrays, Sink

_AHEAD = 2  # parts that are being computed or written at the same time


class Progress(NamedTuple):
    """How far a group of bodies is.

    Attributes:
        state: of all rows of the group, also of those that only fill it.
        first_bad: `Simulation.first_bad` of these rows, as far as they have come.
    """

    state: AnyState
    first_bad: Array


class Computation(NamedTuple):
    """A run, and the devices for it."""

    batch: Batch
    observe: Observe | None
    plan: Plan
    mesh: Mesh

    def begin(self, group: int) -> Progress:
        """A group at the start of the run."""
        rows = self.rows(group)
        start = jax.tree.map(lambda x: x[rows], self.batch.mapped[2])
        return Progress(start, jnp.full(len(rows), self.plan.saves, jnp.int32))

    def resume(self, group: int, state: Arrays, first_bad: np.ndarray) -> Progress:
        """A group at the end of a segment, with the states and `first_bad` that the segment left in a file."""
        rows = self.rows(group) - self.plan.bodies_of(group).start
        structure = jax.tree.structure(self.batch.mapped[2])
        arrays = [jnp.asarray(state[name][rows]) for name in named(self.batch.mapped[2])]
        return Progress(jax.tree.unflatten(structure, arrays), jnp.asarray(first_bad[rows]))

    def tables(self, segment: int) -> Any:
        """What all bodies share in a segment, computed once for all its groups."""
        mapped = jax.tree.map(lambda x: x[:1], self.batch.mapped)
        first, steps = jnp.int32(self.plan.first_step(segment)), self.plan.steps(segment)
        return shared_tables(self.batch.method, as_adjoint(None), mapped, self.batch.shared, first, steps)

    def compute(self, part: Part, progress: Progress, tables: Any) -> tuple[dict[str, Array], Progress]:
        """What a part writes, and the group at its end; does not wait for them."""
        plan, rows = self.plan, self.rows(part.group)
        body, torque, _, dt, t0 = self.batch.mapped
        body, torque, dt, t0 = jax.tree.map(lambda x: x[rows], (body, torque, dt, t0))
        return _compute(
            self.batch.method,
            self.observe,
            (body, torque, progress.state, dt, t0),
            self.batch.shared,
            progress.first_bad,
            jnp.asarray(np.arange(part.group * plan.group, part.group * plan.group + len(rows)) < plan.bodies),
            jnp.int32(plan.first_step(part.segment)),
            plan.steps(part.segment),
            plan,
            self.mesh,
            part.segment == 0,
            tables,
        )

    def rows(self, group: int) -> np.ndarray:
        """The bodies of a group; the last group is filled with copies, so that one compiled program serves all."""
        first = group * self.plan.group
        return np.minimum(np.arange(first, first + self.plan.group), self.plan.bodies - 1)


@wide_jit
def _compute(
    method: Method,
    observe: Observe | None,
    mapped: Any,
    shared: Any,
    first_bad: Array,
    real: Array,
    first: Array,
    steps: int,
    plan: Plan,
    mesh: Mesh,
    from_start: bool,
    tables: Any,
) -> tuple[dict[str, Array], Progress]:
    every = plan.save_every
    counted = real & (first_bad == plan.saves)
    run = method, as_adjoint(None), mapped, shared, first, steps, every, plan.chunk
    path, end = run_ensemble(*run, observe, mesh, counted, tables)
    last = steps // every
    local = jnp.where(path.ok, path.first_bad, jnp.minimum(path.first_bad, last))
    found = jnp.where(local <= last, first // every + local, plan.saves)
    seen = path.states
    if isinstance(observe, Statistic):
        seen = jax.tree.map(lambda x: x[None], seen)
    if not from_start:  # the segment before has saved the state with which this one begins
        seen = jax.tree.map(lambda x: x[:, 1:], seen)
    return named(seen), Progress(end, jnp.minimum(first_bad, found))


def compute_and_write(
    computation: Computation,
    parts: Iterable[Part],
    groups: dict[int, Progress],
    sink: Sink,
    written: Callable[[Part], Any],
) -> None:
    """Computes and writes the parts in turn; `written` is called in this thread after each.

    After an error no further part is written. After an interruption (ctrl-C) those that are being computed still are.
    """
    plan, stopped = computation.plan, False

    def write(part: Part, seen: dict[str, Array], progress: Progress) -> Part:
        nonlocal stopped
        if stopped:
            return part
        try:
            real = slice(plan.bodies_of(part.group).stop - plan.bodies_of(part.group).start)
            of_bodies = not isinstance(computation.observe, Statistic)
            arrays = {name: np.asarray(x)[real] if of_bodies else np.asarray(x) for name, x in seen.items()}
            state = {name: np.asarray(x)[real] for name, x in named(progress.state).items()}
            sink.write(part, arrays, state, np.asarray(progress.first_bad)[real])
        except Exception:  # `result()` raises it in the main thread; until then no later part may be written
            stopped = True
            raise
        return part

    waiting: deque[Future[Part]] = deque()
    with ThreadPoolExecutor(1, "writer") as writer:
        segment, tables = None, None
        for part in parts:
            if part.segment != segment:
                segment, tables = part.segment, computation.tables(part.segment)
            seen, groups[part.group] = computation.compute(part, groups[part.group], tables)
            waiting.append(writer.submit(write, part, seen, groups[part.group]))
            while len(waiting) >= _AHEAD:
                written(waiting.popleft().result())
        while waiting:
            written(waiting.popleft().result())
