"""`ensemble`: the driver for many bodies, which are moved in chunks that fit the cache.

`jax.vmap` of `integrate` is the same computation. But there each step passes over the whole batch, and a batch larger
than the cache is fetched from memory at every step; chunks avoid this. XLA distributes each pass over the cores. On an
accelerator there is one chunk, because a launch for each step and chunk would take longer than the memory does.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel.checks import as_count, as_floats, require_finite
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
from .integrate import Path, path_of_body
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

    Returns:
        The path, with `ok` and `first_bad` (n,). With `save_every`: `times` (k,), or (n, k) if `dt` or `t0` is (n,),
        and `states` with leading axes (n, k). Without: `times` (), or (n,), `states` with a leading axis (n,), and
        `first_bad` 0 for a body that failed, else 1.

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
    return _run(method, as_adjoint(adjoint), mapped, shared, first, steps, save_every, chunk or chunk_size(count))


def _scalar_or_row(name: str, value: Any, count: int, dtype: Any) -> Array:
    array = as_floats(name, value).astype(dtype)
    require_finite(name, array)
    if array.ndim > 1:
        raise ValueError(f"{name} must be a scalar, or one number a body, ({count},), got shape {array.shape}.")
    return array


@wide_jit
def _run(
    method: Method,
    adjoint: Adjoint,
    mapped: Any,
    shared: Any,
    first: Array,
    steps: int,
    save_every: int | None,
    chunk: int,
) -> Path:
    """The path of all bodies.

    Args:
        mapped: body, torque, start, dt and t0, with None for each leaf without a leading axis (n,).
        shared: the same, with None for each leaf that has the axis.
    """
    *_, dt, t0 = mapped
    own_times = dt is not None or t0 is not None
    # A step that is taken backwards needs other inputs than a step forwards.
    reversible = isinstance(adjoint, Reversible)
    inputs, rows = (None, None) if reversible else _inputs_of_all(method, mapped, shared, first, steps)

    def path_of_one(mapped: Any) -> Path:
        body, torque, start, dt, t0 = eqx.combine(mapped, shared)
        every = save_every or steps
        path = path_of_body(method, adjoint, body, torque, start, dt, t0, first, steps, every, inputs, rows)
        if save_every is not None:
            return path
        return Path(path.times[-1], jax.tree.map(lambda x: x[-1], path.states), path.ok, path.ok.astype(jnp.int32))

    out_axes: Any = Path(0 if own_times else None, 0, 0, 0)  # pyright: ignore[reportArgumentType]
    path_of_chunk = jax.vmap(path_of_one, out_axes=out_axes)
    count = mapped[2].momentum.shape[0]
    chunks = _chunks(count, chunk)
    if chunks == 1:
        return path_of_chunk(mapped)
    size = -(-count // chunks)
    # The last chunk is filled with copies of the last body, so that one compiled program serves all chunks.
    indices = jnp.minimum(jnp.arange(chunks * size), count - 1).reshape(chunks, size)

    def join(parts: Array) -> Array:
        return parts.reshape(chunks * size, *parts.shape[2:])[:count]

    path = jax.lax.map(lambda chunk: path_of_chunk(jax.tree.map(lambda x: x[chunk], mapped)), indices)
    times = join(path.times) if own_times else path.times[0]
    return Path(times, jax.tree.map(join, path.states), join(path.ok), join(path.first_bad))


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


def _chunks(count: int, chunk: int) -> int:
    """The least number of chunks, or up to a quarter more if all are then full, because that saves a copy."""
    least = -(-count // chunk)
    return next((n for n in range(least, least + least // 4 + 1) if count % n == 0), least)
