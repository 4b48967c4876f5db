"""`ensemble`: the driver for many bodies, which are moved in chunks that fit the cache.

`jax.vmap` of `integrate` is the same computation. But there each step passes over the whole batch, and a batch larger
than the cache is fetched from memory at every step; chunks avoid this. XLA distributes each pass over the cores. On an
accelerator there is one chunk, because a launch for each step and chunk would take longer than the memory does.

With a mesh the chunks are spread over its devices. No device needs anything from another one while it takes its steps.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, PartitionSpec

from .._kernel.checks import as_count, as_floats, described, require_finite
from .._kernel.platform import on_cpu
from .._kernel.width import wide_jit
from ..methods.base import Method
from ..methods.system import System
from ..model.bodies import Body, RigidBody, principal_of
from ..model.compatibility import check_state
from ..model.state import AnyState
from ..model.torques import TorqueLike
from . import shared_inputs
from .adjoints import Adjoint, Reversible, as_adjoint
from .arguments import as_first_step, as_method, check_saving, check_step, check_system
from .integrate import Path, run_of_body
from .observe import Observe, Statistic, as_observe
from .rows import count_rows, torque_rows
from .timing import cores

_CHUNK = 256  # bodies moved at once on one core
_LARGEST_TABLE = 2**26  # bytes of inputs that all bodies share; more are computed anew in every chunk


def ensemble(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState,
    *,
    dt: float | Array,
    steps: int,
    save_every: int | None = None,
    t0: float | Array = 0.0,
    first_step: int | Array = 0,
    torque_axes: Any = None,
    chunk: int | None = None,
    adjoint: Adjoint | None = None,
    mesh: Mesh | None = None,
    observe: Any = None,
) -> Path:
    """Integrates n bodies; the results are those of `integrate` for each body, up to a few units in the last place.

    Can be jitted and differentiated. Compiled once for each method, torque function and shape. What a torque computes
    from the time and from parameters that all bodies share, such as the place on an orbit, is computed once for all.

    Args:
        method, steps, first_step: as for `integrate`.
        body: one body for all, or a `RigidBody` with moments (n, 3), or a `TensorBody` with a tensor (n, 3, 3).
        torque: as for `integrate`. A parameter may have an additional leading axis (n,), as in `HeavyTop(weights)` with
            weights (n,): then each body has its own row. All bodies share the other parameters.
        start: with a leading axis (n,): momentum (n, 3), attitude (n, 4).
        dt, t0: (), or (n,) with one value for each body.
        save_every: save the state every `save_every` steps, the start first, as `integrate` does; `None` returns only
            the state at the end and needs memory only for that.
        torque_axes: which parameters of the torque have one row for each body. Needed only where shapes do not tell:
            with three bodies, (3,) may be one vector for all or one number for each. 0 if all parameters have rows, or
            a tree like the torque's with leaves 0 and None, like the `in_axes` of `jax.vmap`. To get such a tree, use
            `jax.tree.map(lambda leaf: 0, torque)`.
        chunk: number of bodies that are moved at once; by default the number that is fastest on this machine.
        adjoint: as for `integrate`. With `Reversible()` every body computes all inputs of its torque itself.
        mesh: devices over which the bodies are spread, along all axes of the mesh; `jax.make_mesh((4,), ("bodies",))`
            makes one of four devices. The results are the same, bit for bit, on meshes of any size, if `chunk` is the
            same and at most a share of each device.
        observe: what the path holds in place of the states: a function of (t, state) of one body, an observable of
            `midlie_jax.observe`, or a dict of these; or a statistic of these over all bodies that can be trusted at
            that time, such as `midlie_jax.observe.Mean(f)`, which needs one `dt` and `t0` for all.

    Returns:
        The path, with `ok` and `first_bad` (n,). With `save_every`: `times` (k,), or (n, k) if `dt` or `t0` is (n,),
        and `states` with leading axes (n, k). Without: `times` (), or (n,), `states` with a leading axis (n,), and
        `first_bad` 0 for a body that failed, else 1. With `observe`, `states` holds what was observed, with the same
        leading axes; a statistic has no axis (n,).

    Raises:
        ValueError: as for `integrate`, or the leading axes differ; the message names the argument and the cure.
    """
    steps = as_count("steps", steps)
    chunk = chunk if chunk is None else as_count("chunk", chunk)
    save_every = save_every if save_every is None else as_count("save_every", save_every)
    check_saving(steps, save_every or steps)
    first = as_first_step(first_step, steps)
    check_state("start", start)
    dtype, count = start.momentum.dtype, start.momentum.shape[0] if start.momentum.ndim else 0
    method = check_system(as_method(method), body, torque, start, batch=1)
    if count == 0:
        raise ValueError(f"start holds no bodies: its momentum has shape {start.momentum.shape}; give one row a body.")
    dt, t0 = (_scalar_or_row(name, value, count, dtype) for name, value in (("dt", dt), ("t0", t0)))
    check_step(dt)
    principal = principal_of(body)
    own_body = isinstance(principal, RigidBody) and principal.moments.ndim == 2
    rows = (
        jax.tree.map(lambda _: own_body, body),
        torque_rows(torque, torque_axes, body, own_body, start, count),
        jax.tree.map(lambda _: True, start),
        dt.ndim == 1,
        t0.ndim == 1,
    )
    arguments = (body, torque, start, dt, t0)
    count_rows(("body", "torque", "start", "dt", "t0"), arguments, rows, count)
    mapped, shared = eqx.partition(arguments, rows)
    observe = as_observe(observe)
    if isinstance(observe, Statistic) and (dt.ndim or t0.ndim):
        raise ValueError("a statistic combines bodies at the same times; give one dt and one t0 for all bodies.")
    if not isinstance(mesh, Mesh | None):
        raise ValueError(f"mesh must be a jax.sharding.Mesh, for example from jax.make_mesh, got {described(mesh)}.")
    size = chunk or chunk_size(count if mesh is None else -(-count // mesh.size))
    adjoint = as_adjoint(adjoint)
    path, _ = run_ensemble(method, adjoint, mapped, shared, first, steps, save_every, size, observe, mesh)
    if isinstance(observe, Statistic):
        path = path._replace(states=observe.merged(path.states))
    return path


def _scalar_or_row(name: str, value: Any, count: int, dtype: Any) -> Array:
    array = as_floats(name, value).astype(dtype)
    require_finite(name, array)
    if array.ndim > 1:
        raise ValueError(f"{name} must be a scalar, or one number a body, ({count},), got shape {array.shape}.")
    return array


@wide_jit
def run_ensemble(
    method: Method,
    adjoint: Adjoint,
    mapped: Any,
    shared: Any,
    first: Array,
    steps: int,
    save_every: int | None,
    chunk: int,
    observe: Observe | None = None,
    mesh: Mesh | None = None,
) -> tuple[Path, AnyState]:
    """`ensemble` without the checks: the path of all bodies, and their states at its end.

    Of a statistic the path holds the parts of all chunks, with a leading axis of chunks, which are not yet merged.

    Args:
        method, adjoint, first, steps, save_every, chunk, observe, mesh: as for `ensemble`; `method` fitted.
        mapped: body, torque, start, dt and t0, with None for each leaf without a leading axis (n,).
        shared: the same, with None for each leaf that has the axis.
    """
    *_, dt, t0 = mapped
    own_times = dt is not None or t0 is not None
    # A step that is taken backwards needs other inputs than a step forwards.
    reversible = isinstance(adjoint, Reversible)
    inputs, rows = (None, None) if reversible else _inputs_of_all(method, mapped, shared, first, steps)
    count = mapped[2].momentum.shape[0]

    def run_of_one(mapped: Any, shared: Any, first: Array, rows: Any) -> tuple[Path, AnyState]:
        body, torque, start, dt, t0 = eqx.combine(mapped, shared)
        every = save_every or steps
        path, end = run_of_body(
            method, adjoint, body, torque, start, dt, t0, first, steps, every, inputs, rows, observe
        )
        if save_every is not None:
            return path, end
        last = jax.tree.map(lambda x: x[-1], path.states)
        return Path(path.times[-1], last, path.ok, path.ok.astype(jnp.int32)), end

    out_axes: Any = (Path(0 if own_times else None, 0, 0, 0), 0)  # pyright: ignore[reportArgumentType]
    run_of_bodies = jax.vmap(run_of_one, in_axes=(0, None, None, None), out_axes=out_axes)

    def run_of_chunk(indices: Array, mapped: Any, *common: Any) -> tuple[Path, AnyState]:
        path, end = run_of_bodies(mapped, *common)
        if isinstance(observe, Statistic):
            path = path._replace(states=_parts(observe, path, indices < count))
        return path, end

    def run_of_chunks(indices: Array, mapped: Any, *common: Any) -> tuple[Path, AnyState]:
        """Of `indices` (chunks, bodies) and rows of bodies; what belongs to a body has one leading axis again."""
        if len(indices) == 1:
            path, end = run_of_chunk(indices[0], mapped, *common)
            whole = jax.tree.map(lambda x: x[None], path.states) if isinstance(observe, Statistic) else path.states
            return path._replace(states=whole), end

        def join(parts: Any) -> Any:
            return jax.tree.map(lambda x: x.reshape(indices.size, *x.shape[2:]), parts)

        rows = jax.tree.map(lambda x: x.reshape(*indices.shape, *x.shape[1:]), mapped)
        path, end = jax.lax.map(lambda chunk: run_of_chunk(*chunk, *common), (indices, rows))
        times = join(path.times) if own_times else path.times[0]
        seen = path.states if isinstance(observe, Statistic) else join(path.states)
        return Path(times, seen, join(path.ok), join(path.first_bad)), join(end)

    # The last chunks are filled with copies of the last body, so that one compiled program serves all chunks.
    indices = jnp.asarray(_indices(count, chunk, 1 if mesh is None else mesh.size))
    if indices.size > count:
        mapped = jax.tree.map(lambda x: x[jnp.minimum(indices.ravel(), count - 1)], mapped)
    arrays, others = eqx.partition(shared, eqx.is_array)

    def run(indices: Array, mapped: Any, arrays: Any, first: Array, rows: Any) -> tuple[Path, AnyState]:
        return run_of_chunks(indices, mapped, eqx.combine(arrays, others), first, rows)

    if mesh is not None:
        run = _on_mesh(run, mesh, own_times)
    path, end = run(indices, mapped, arrays, first, rows)
    if indices.size == count:
        return path, end
    cut = partial(jax.tree.map, lambda x: x[:count])
    times = cut(path.times) if own_times else path.times
    seen = path.states if isinstance(observe, Statistic) else cut(path.states)
    return Path(times, seen, cut(path.ok), cut(path.first_bad)), cut(end)


def _on_mesh(run: Any, mesh: Mesh, own_times: bool) -> Any:
    """`run` on chunks that are spread over a mesh, each device with its own."""
    each, all_ = PartitionSpec(mesh.axis_names), PartitionSpec()
    out: Any = (Path(each if own_times else all_, each, each, each), each)  # pyright: ignore[reportArgumentType]
    mesh = Mesh(mesh.devices, mesh.axis_names)  # whatever the types of its axes
    # What varies from device to device is known here. JAX need not check it, and the step that was traced to prepare
    # the shared inputs, before the bodies were spread, could not pass that check.
    return jax.shard_map(run, mesh=mesh, in_specs=(each, each, all_, all_, all_), out_specs=out, check_vma=False)


def _parts(observe: Statistic, path: Path, real: Array) -> Any:
    """The parts (k, ...) of a statistic at the saved times, from the observed values (bodies, k, ...) of a chunk.

    Args:
        real: (bodies,), False for copies that only fill the chunk.
    """
    values = jax.tree.map(lambda x: x if path.times.ndim else x[:, None], path.states)
    saved = jax.tree.leaves(values)[0].shape[1]
    good = real[:, None] & (jnp.arange(saved) < path.first_bad[:, None])
    parts = jax.vmap(observe.part, in_axes=1)(values, good)
    return parts if path.times.ndim else jax.tree.map(lambda x: x[0], parts)


def _inputs_of_all(method: Method, mapped: Any, shared: Any, first: Array, steps: int) -> tuple[Any, Any]:
    """The inputs that all bodies share, and their rows for the steps before the run and in it; or None and None."""
    body, torque, start, dt, t0 = arguments = eqx.combine(jax.tree.map(lambda x: x[0], mapped), shared)
    structure = jax.tree.structure(arguments)
    own = structure.unflatten([part is not None for part in structure.flatten_up_to(mapped)])
    inputs = shared_inputs.find(method, arguments, own)
    if inputs is None:
        return None, None
    system, first = System.of(body, torque, start, t0), first.astype(jnp.int32)

    row = jax.eval_shape(partial(inputs.rows, system, t0, dt, dt), first)
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(row))
    if size * steps > _LARGEST_TABLE:
        return None, None
    # The first row is that of the steps of length zero before the run; the last block is filled up.
    padded = -(-(steps + 1) // shared_inputs.BLOCK) * shared_inputs.BLOCK
    indices = first - 1 + jnp.arange(padded, dtype=jnp.int32)
    lengths = jnp.where(jnp.arange(padded) == 0, 0 * dt, dt)
    table = inputs.table(system, t0, dt, lengths, indices)
    return inputs, (
        jax.tree.map(lambda x: x[jnp.array([0, 0])], table),
        jax.tree.map(lambda x: x[1 : steps + 1], table),
    )


def chunk_size(count: int) -> int:
    """How many of `count` bodies are moved at once by default: all on an accelerator, which wants long loops.

    On a CPU a step reads and writes the state of each body once; it keeps what is between in registers. On one core the
    state of the chunk should therefore fit the first-level cache, and be large enough to hide the cost of starting a
    loop. XLA spreads a loop over several cores only if it is long.
    """
    if not on_cpu():
        return count
    return _CHUNK if cores() == 1 else 32 * _CHUNK


def _indices(count: int, chunk: int, devices: int) -> np.ndarray:
    """The bodies of all chunks, (chunks, bodies), as many chunks for each device; from `count` on they are copies.

    Without a mesh there is the least number of chunks, or up to a quarter more if all are then full, because that saves
    a copy. On several devices all chunks have the size `chunk` if there is work for all devices, so that the compiled
    program of a chunk, and its bits, do not depend on the number of devices.
    """
    if devices == 1:
        least = -(-count // chunk)
        chunks = next((n for n in range(least, least + least // 4 + 1) if count % n == 0), least)
        size = -(-count // chunks)
    else:
        size = min(chunk, -(-count // devices))
        chunks = devices * -(-count // (devices * size))
    return np.arange(chunks * size).reshape(chunks, size)
