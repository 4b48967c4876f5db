"""Runs many bodies in chunks that fit the cache, spread over the devices of a mesh; used by `ensemble`.

With `jax.vmap` of `integrate`, each step would fetch a batch larger than the cache from memory. An accelerator uses one
chunk, because launching a kernel for each step and chunk would take longer. Devices do not communicate during steps.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from .._xla import budgets
from .._xla.compiler import tuned_jit
from .._xla.mesh import is_spread, row_of
from .._xla.platform import cores, on_cpu
from .._xla.structure import remember, structure_of
from ..integrators.base import Method, Progress
from . import shared_inputs
from .derivatives import Adjoint, Reversible
from .integrate import run_of_body
from .observe import Observe, Statistic
from .path import Path, end_alone
from .shared_inputs import Rows, SharedInputs
from .steps import Leg

_nothing_shared: dict[Any, None] = {}  # keyed by the structure of arguments


def bodies_in(method: Method, run: Any, mapped: Any, *others: Any, **named: Any) -> int:
    return mapped[2].momentum.shape[0]


@partial(tuned_jit, bodies=bodies_in)
def run_ensemble(
    method: Method,
    adjoint: Adjoint,
    mapped: Any,
    shared: Any,
    first: Array,
    intervals: int,
    save_every: int | Array,
    at_end: bool,
    chunk: int,
    observe: Observe | None = None,
    mesh: Mesh | None = None,
    counted: Array | None = None,
    tables: Rows | None = None,
    leg: Leg | None = None,
    guarded: bool = False,
    begins: Progress | None = None,
) -> Path[Any]:
    """`ensemble` without the checks; arguments as for `ensemble`, `Batch` and `run_of_body`.

    A statistic may count the bodies in `counted` (n,), by default all. `tables` are from `shared_tables`, and `begins`
    is the initial progress of each body, from a `Carry`, or None.
    """
    *_, dt, t0 = mapped
    own_times = dt is not None or t0 is not None
    inputs = None if tables is None else _inputs_of_all(method, mapped, shared)
    count = mapped[2].momentum.shape[0]
    may_count = jnp.ones(count, bool) if counted is None else counted

    fixed = save_every if isinstance(save_every, int) else None

    def run_of_one(own: Any, shared: Any, first: Array, given: Any, rows: Any, ends: Any) -> Path[Any]:
        (mapped, progresses, begins), every = own, given if fixed is None else fixed
        own_leg = None if leg is None else Leg(*ends, *progresses)
        run = method, adjoint, eqx.combine(mapped, shared), first, intervals, every
        path = run_of_body(*run, inputs, rows, observe, own_leg, guarded, begins)
        return end_alone(path) if at_end else path

    out_axes: Any = Path(0 if own_times else None, 0, 0, 0, 0, 0)  # pyright: ignore[reportArgumentType]
    run_of_bodies = jax.vmap(run_of_one, in_axes=(0, None, None, None, None, None), out_axes=out_axes)
    ends, progresses = (None, None) if leg is None else (leg[:3], leg[3:])
    mapped = mapped, progresses, begins

    def run_of_chunk(counted: Array, mapped: Any, *common: Any) -> Path[Any]:
        path = run_of_bodies(mapped, *common)
        return path._replace(states=_parts(observe, path, counted)) if isinstance(observe, Statistic) else path

    def run_of_chunks(counted: Array, mapped: Any, *common: Any) -> Path[Any]:
        """The run, from `counted` (chunks, bodies) and rows of bodies; results per body have one leading axis again."""
        if len(counted) == 1:
            path = run_of_chunk(counted[0], mapped, *common)
            whole = jax.tree.map(lambda x: x[None], path.states) if isinstance(observe, Statistic) else path.states
            return path._replace(states=whole)

        def join(parts: Any) -> Any:
            return jax.tree.map(lambda x: x.reshape(counted.size, *x.shape[2:]), parts)

        rows = jax.tree.map(lambda x: x.reshape(*counted.shape, *x.shape[1:]), mapped)
        path = jax.lax.map(lambda chunk: run_of_chunk(*chunk, *common), (counted, rows))
        times = join(path.times) if own_times else path.times[0]
        seen = path.states if isinstance(observe, Statistic) else join(path.states)
        return Path(times, seen, *map(join, path[2:]))

    if is_spread(mapped):  # every device keeps its own bodies
        chunk, mesh = count, None
    # The last chunks are padded with copies of the last body, so that one compiled program serves all chunks.
    chunks, size = _cut(count, chunk, None if mesh is None else mesh.size)
    if chunks * size > count:
        rows_of_all = jnp.minimum(jnp.arange(chunks * size), count - 1)
        mapped = jax.tree.map(lambda x: x[rows_of_all], mapped)
        may_count = may_count[rows_of_all] & (jnp.arange(chunks * size) < count)
    arrays, others = eqx.partition(shared, eqx.is_array)

    def run(counted: Array, mapped: Any, arrays: Any, *common: Any) -> Path[Any]:
        return run_of_chunks(counted, mapped, eqx.combine(arrays, others), *common)

    if mesh is not None:
        run = _on_mesh(run, mesh, own_times)
    given = save_every if fixed is None else None
    path = run(may_count.reshape(chunks, size), mapped, arrays, first, given, tables, ends)
    if isinstance(observe, Statistic):
        parts = path.states
        if mesh is not None:  # every device merges the parts of all chunks, in the same order
            everywhere = NamedSharding(Mesh(mesh.devices, mesh.axis_names), PartitionSpec())
            parts = jax.lax.with_sharding_constraint(parts, everywhere)
        interval = shared[3] * jnp.asarray(save_every, shared[3].dtype)  # a statistic needs one dt
        path = path._replace(states=observe.result(observe.merged(parts), interval))
    if chunks * size == count:
        return path
    cut = partial(jax.tree.map, lambda x: x[:count])
    times = cut(path.times) if own_times else path.times
    seen = path.states if isinstance(observe, Statistic) else cut(path.states)
    return Path(times, seen, *map(cut, path[2:]))


def _on_mesh(run: Any, mesh: Mesh, own_times: bool) -> Any:
    """`run` on chunks that are spread over a mesh: each device runs its own chunks."""
    each, all_ = PartitionSpec(mesh.axis_names), PartitionSpec()
    out: Any = Path(each if own_times else all_, *[each] * 5)  # pyright: ignore[reportArgumentType]
    mesh = Mesh(mesh.devices, mesh.axis_names)  # for any types of its axes
    # The specifications say what varies from device to device, so JAX need not check it. The check would fail for the
    # step that was traced before the bodies were spread, to prepare the shared inputs.
    return jax.shard_map(
        run, mesh=mesh, in_specs=(each, each, all_, all_, all_, all_, all_), out_specs=out, check_vma=False
    )


def _parts(observe: Statistic, path: Path[Any], counted: Array) -> Any:
    """The parts (k, ...) of a statistic at the saved times of a chunk; of a statistic over times one part."""
    values = jax.tree.map(lambda x: x if path.times.ndim else x[:, None], path.states)
    saved = jax.tree.leaves(values)[0].shape[1]
    good = counted[:, None] & (jnp.arange(saved, dtype=jnp.int32)[None] < path.first_bad[:, None])
    parts = observe.parts(values, good)
    return parts if path.times.ndim else jax.tree.map(lambda x: x[0], parts)


def shared_tables(method: Method, adjoint: Adjoint, mapped: Any, shared: Any, first: Any, steps: int) -> Rows | None:
    """The prepared inputs of at least all steps of the run; None if nothing is worth preparing.

    A separate program computes them, because XLA rounds some of them differently in a program for several devices.
    """
    decision = structure_of((method, adjoint, mapped, shared))
    if decision is not None and decision in _nothing_shared:
        return None
    tables = _shared_tables(method, adjoint, mapped, shared, first, steps)
    if decision is not None and tables is None:
        remember(_nothing_shared, decision, None)
    return tables or None


@tuned_jit
def _shared_tables(
    method: Method, adjoint: Adjoint, mapped: Any, shared: Any, first: Array, steps: int
) -> Rows | tuple[()] | None:
    """`shared_tables`: None if nothing is shared, () if the tables would be too large."""
    # A backward step needs other inputs than a forward step.
    inputs = None if isinstance(adjoint, Reversible) else _inputs_of_all(method, mapped, shared)
    if inputs is None:
        return None
    body, torque, start, dt, t0 = eqx.combine(jax.tree.map(row_of, mapped), shared)
    system, first = method.system(body, torque, start, t0, dt), first.astype(jnp.int32)
    row = jax.eval_shape(partial(inputs.rows, system, t0, dt), first)
    if steps * sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(row)) > budgets.PREPARED_BYTES:
        return ()
    indices = first + jnp.arange(steps + -steps % budgets.PREPARED_ROWS, dtype=jnp.int32)
    table = inputs.table(system, t0, dt, indices)
    return jax.tree.map(lambda x: x[:steps], table)


def _inputs_of_all(method: Method, mapped: Any, shared: Any) -> SharedInputs | None:
    """The step of a run, split into what all bodies share and the rest; None if they share nothing."""
    arguments = eqx.combine(jax.tree.map(row_of, mapped), shared)
    structure = jax.tree.structure(arguments)
    own = structure.unflatten([part is not None for part in structure.flatten_up_to(mapped)])
    return shared_inputs.find(method, arguments, own)


def chunk_size(count: int, start: Any = None) -> int:
    """The default number of bodies moved at once, of `count`; all on an accelerator, which needs long loops.

    On one core the states of a chunk should fit the first-level cache, and be numerous enough to hide the overhead of
    starting a loop. XLA spreads only long loops over several cores.
    """
    if not on_cpu():
        return count
    numbers = sum(leaf.size // max(leaf.shape[0], 1) for leaf in jax.tree.leaves(start))
    large = numbers > budgets.LARGE_STATE
    chunk = min(budgets.LARGE_CHUNK, max(1, budgets.CHUNK_NUMBERS // numbers)) if large else budgets.CHUNK
    return chunk if cores() == 1 else 32 * chunk


def even_size(count: int, parts: int) -> int:
    """The size of equal parts that hold `count`; a multiple of `budgets.VECTOR` for several parts larger than it."""
    size = -(-count // parts)
    return size if parts == 1 or size <= budgets.VECTOR else -(-size // budgets.VECTOR) * budgets.VECTOR


def _cut(count: int, chunk: int, devices: int | None) -> tuple[int, int]:
    """The number of chunks, a multiple of the number of devices, and their size; together they may exceed `count`.

    Without a mesh there are as few chunks as possible, or up to a third more if all chunks are then full, which saves a
    copy. On a mesh the size, and therefore the bits, do not depend on the number of devices if there is work for all.
    """
    if devices is None:
        if count <= chunk:
            return 1, count
        most = chunk if chunk <= budgets.VECTOR else chunk - chunk % budgets.VECTOR
        least = -(-count // most)
        chunks = next((n for n in range(least, least + least // 3 + 1) if count % (n * budgets.VECTOR) == 0), least)
        return chunks, even_size(count, chunks)
    size = min(chunk, -(-count // devices))
    return devices * -(-count // (devices * size)), size
