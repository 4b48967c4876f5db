"""Computes the parts of a run, each in one or more legs."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from .._xla.compiler import tuned_jit
from ..drivers.chunks import bodies_in, run_ensemble, shared_tables
from ..drivers.clock import time_of
from ..drivers.derivatives import as_adjoint
from ..drivers.ensemble import Batch
from ..drivers.observe import Observe, Statistic
from ..drivers.observe.arguments import Values
from ..drivers.observe.series import Series
from ..drivers.stepper import Carry, check_carried
from ..drivers.steps import Leg, iteration, next_stop
from ..integrators.base import Method
from .plan import Arrays, Part, Plan
from .variables import named, value_leaves

_SEEN = "seen_"


class Progress(NamedTuple):
    """The progress of a group of bodies."""

    begun: Any  # the progress of its bodies at the beginning of the part, for all rows, including padding rows
    carried: Any  # the present progress
    first_bad: np.ndarray  # `Simulation.first_bad` of these rows, from the steps taken so far
    steps: int = 0  # of the part taken so far
    seen: tuple[Arrays, ...] = ()  # the values that the part will write, in pieces ordered by time
    series: Any = None  # the carry of a statistic over times; until the part is complete, of the earlier parts
    span: int = 0

    def all_seen(self) -> Arrays:
        """The values that the part will write, in one piece."""
        names = self.seen[0] if self.seen else {}
        return {name: np.concatenate([piece[name] for piece in self.seen], axis=1) for name in names}

    def after(self) -> "Progress":
        """The group at the beginning of the next part."""
        return Progress(self.carried, self.carried, self.first_bad, series=self.series, span=self.span + 1)

    def stored(self, bodies: int) -> Arrays:
        """The arrays of a checkpoint of the group, from which `Computation.restored` continues."""
        found = {"span": np.array(self.span), "steps": np.array(self.steps), "first_bad": self.first_bad[:bodies]}
        trees = {"begun": self.begun, "carried": self.carried if self.steps else None, "series": self.series}
        found |= {name: leaf[:bodies] for name, leaf in named(trees).items()}
        return found | {f"{_SEEN}{name}": values for name, values in self.all_seen().items() if self.steps}


class Computation(NamedTuple):
    """A run, and its devices."""

    batch: Batch
    observe: Observe | None
    plan: Plan
    mesh: Mesh
    given: Any  # the initial progress of all bodies, from a `Carry`, or None
    like: Carry  # of one body, with a leading axis, as a pytree of shapes and dtypes

    @classmethod
    def of(cls, batch: Batch, observe: Observe | None, plan: Plan, mesh: Mesh, given: Any) -> "Computation":
        method, _, mapped, shared = batch
        one = jax.tree.map(lambda x: x[:1], (mapped, given))
        like = eqx.filter_eval_shape(_begun, method, *one, shared, jax.ShapeDtypeStruct((), jnp.int32), 1)
        return cls(batch, observe, plan, mesh, given, like)

    def begin(self, group: int) -> Progress:
        rows, (method, _, mapped, shared) = self.rows(group), self.batch
        mapped, given = jax.tree.map(lambda x: x[rows], (mapped, self.given))
        found = _begun(method, mapped, given, shared, jnp.int32(self.plan.begin), self.plan.chunk)
        carried = jax.tree.map(np.asarray, found.progress)
        return Progress(carried, carried, np.full(len(rows), self.plan.saves, np.int32), series=self._series(group))

    def restored(self, group: int, arrays: Arrays) -> Progress:
        """A group from its checkpoint."""
        steps, series = int(arrays["steps"]), self._series(group)
        like = self.like.progress
        trees = {"begun": like, "carried": like if steps else None, "series": series}
        found = jax.tree.unflatten(jax.tree.structure(trees), [arrays[name] for name in named(trees)])
        rows = self.rows(group) - self.plan.bodies_of(group).start
        begun, carried = jax.tree.map(lambda x: x[rows], (found["begun"], found["carried"]))
        seen = {name.removeprefix(_SEEN): values for name, values in arrays.items() if name.startswith(_SEEN)}
        taken = steps, (seen,) if seen else (), found["series"], int(arrays["span"])
        return Progress(begun, carried if steps else begun, arrays["first_bad"][rows], *taken)

    def carry(self, groups: dict[int, Progress]) -> Carry | None:
        """The carry of all bodies at the end of the run; None if other processes hold some of them."""
        plan = self.plan
        if len(groups) < plan.groups:
            return None
        own = [jax.tree.map(lambda x, g=g: x[: plan.bodies_in(g)], groups[g].carried) for g in range(plan.groups)]
        index = np.full(plan.bodies, plan.begin + (plan.saves - 1) * plan.save_every, np.int32)
        return Carry(jnp.asarray(index), jax.tree.map(lambda *x: jnp.concatenate(x), *own), self.like.kind)

    def tables(self, span: int) -> Any:
        """The inputs that all bodies share in a span, computed once for all groups."""
        mapped, plan = jax.tree.map(lambda x: x[:1], self.batch.mapped), self.plan
        first, steps = jnp.int32(plan.first_step(span)), plan.intervals * plan.save_every
        return shared_tables(self.batch.method, as_adjoint(None), mapped, self.batch.shared, first, steps)

    def compute(self, part: Part, before: Progress, steps: int, tables: Any) -> Progress:
        """The group after a leg of about `steps` steps in a part; waits for the result."""
        method, _, mapped, shared = self.batch
        plan, rows, every = self.plan, self.rows(part.group), self.plan.save_every
        stop = min(next_stop(before.steps, steps, iteration(method, every), every), plan.steps(part.span))
        # From NumPy arrays, because for arrays on a mesh JAX would compile the program again.
        begun, first_bad, carried = jax.tree.map(jnp.asarray, (before.begun, before.first_bad, before.carried))
        mapped, given = jax.tree.map(lambda x: x[rows], (mapped, self.given))
        first, exist = plan.first_step(part.span), jnp.asarray(np.arange(plan.group) < plan.bodies_in(part.group))
        # At the end of a part alone, so that legs change no result.
        judged = first - plan.begin + stop if stop == plan.steps(part.span) else 0
        leg = Leg(jnp.int32(before.steps), jnp.int32(stop), jnp.int32(judged), carried, given)
        observe = Values(self.observe.observable) if isinstance(self.observe, Series) else self.observe
        where = exist, jnp.int32(first), plan, self.mesh, tables, leg
        found = _compute(method, observe, mapped, shared, begun, first_bad, *where)
        seen, carried, first_bad = jax.tree.map(np.asarray, found)
        # The previous part writes the initial state of a part.
        new = slice(before.steps // every + 1 if before.steps or part.span else 0, stop // every + 1)
        combined = isinstance(self.observe, Statistic) and not isinstance(self.observe, Series)
        real = slice(None) if combined else slice(plan.bodies_in(part.group))
        piece = {name: values[real, new].copy() for name, values in seen.items()}
        pieces = (*before.seen, piece) if new.stop > new.start else before.seen
        after = before._replace(carried=carried, first_bad=first_bad, steps=stop, seen=pieces)
        if stop < plan.steps(part.span) or not isinstance(self.observe, Series):
            return after
        # A complete part writes the statistic over all times up to its end instead of its values.
        like, seen, saves = value_leaves(self.batch, self.observe), after.all_seen(), plan.saves_of(part.span)
        values = jax.tree.unflatten(jax.tree.structure(like), [seen[name] for name in named(like)])
        good = np.arange(saves.start, saves.stop)[None] < first_bad[real, None]
        found, series = jax.tree.map(np.asarray, _combined(self.observe, after.series, values, good))
        return after._replace(seen=(named(found),), series=series)

    def _series(self, group: int) -> Any:
        """The initial carry of a statistic over times for a group; None without such a statistic."""
        if not isinstance(self.observe, Series):
            return None
        carried = self.observe.begun(self.plan.bodies_in(group), value_leaves(self.batch, self.observe))
        return jax.tree.map(np.asarray, carried)

    def rows(self, group: int) -> np.ndarray:
        """The bodies of a group; the last group is padded with copies, so that one compiled program serves all."""
        first = group * self.plan.group
        return np.minimum(np.arange(first, first + self.plan.group), self.plan.bodies - 1)


@eqx.filter_jit
def _combined(observe: Series, carried: Any, values: Any, good: Array) -> tuple[Any, Any]:
    """The sums (1, 1, ...) of a group over all times up to the end of a span, and the carry for the next span."""
    carried = observe.taken(carried, values, good)
    sums = observe.sums(carried, jnp.ones(len(good), bool))
    return jax.tree.map(lambda x: x[None, None], sums), carried


@partial(tuned_jit, bodies=bodies_in)
def _compute(
    method: Method,
    observe: Observe | None,
    mapped: Any,
    shared: Any,
    begun: Any,
    first_bad: Array,
    real: Array,
    first: Array,
    plan: Plan,
    mesh: Mesh,
    tables: Any,
    leg: Leg,
) -> tuple[dict[str, Array], Any, Array]:
    """The values that a span writes, valid within the leg; the progress at the end of the leg; and `first_bad`.

    One program serves all spans and legs, so the results do not depend on the boundaries of legs.
    """
    counted = real & (first_bad == plan.saves)
    every, last = plan.save_every, plan.intervals
    run = method, as_adjoint(None), mapped, shared, first, last, every, False, plan.chunk
    path = run_ensemble(*run, observe, mesh, counted, tables, leg, begins=begun)
    local = jnp.where(path.ok, path.first_bad, jnp.minimum(path.first_bad, last))
    found = jnp.where(local <= last, (first - plan.begin) // every + local, plan.saves)
    seen = jax.tree.map(lambda x: x[None], path.states) if isinstance(observe, Statistic) else path.states
    return named(seen), path.carry.progress, jnp.minimum(first_bad, found)


@tuned_jit
def _begun(method: Method, mapped: Any, given: Any, shared: Any, first: Array, chunk: int) -> Carry:
    def begun(own: Any) -> Carry:
        mapped, given = own
        body, torque, start, dt, t0 = eqx.combine(mapped, shared)
        system = method.system(body, torque, start, t0, dt)
        if given is not None:
            check_carried(given, system, method)
        progress = method.begin(system, start, time_of(t0, dt, first)) if given is None else given
        return Carry(first, progress, system.kind)

    return jax.lax.map(begun, (mapped, given), batch_size=chunk)
