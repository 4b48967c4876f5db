"""Many bodies at once: a batch cut into chunks that stay in the cache, on all the cores that there are.

`jax.vmap` of `integrate` is the same computation. What this adds is the cut: a step passes over the whole batch, and
a batch larger than the cache would be fetched from memory at every step. XLA spreads each pass over the cores.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .bodies import Particles, RigidBody, State
from .checks import require_finite
from .integrate import Path, integrate
from .methods import method as find_method
from .stepper import Method
from .torques import TorqueLike

# Bodies a chunk: few enough for the cache, enough to drown the cost of starting a loop and to share among cores.
CHUNK = 8192


def ensemble(
    method: Method | str,
    body: RigidBody | Particles,
    torque: TorqueLike | None,
    start: State,
    *,
    dt: float | Array,
    steps: int,
    save_every: int | None = None,
    t0: float | Array = 0.0,
    first_step: int = 0,
    torque_axes: Any = None,
    chunk: int = CHUNK,
) -> Path:
    """Integrates n bodies, each as `integrate` would alone, to a few units in the last place.

    It can be jitted and differentiated, and is compiled once for each method, torque function and shape.

    Args:
        method, steps, t0, first_step: as for `integrate`; t0 may be (n,).
        body: one for all, or a `RigidBody` with moments (n, 3).
        torque: one for all, or one whose leaves have a leading axis (n,) where `torque_axes` says so.
        start: with a leading axis (n,): momentum (n, 3), attitude (n, 4).
        dt: (), or a step for each, (n,).
        save_every: keep every so many steps, the start first, as `integrate` does; `None` keeps the end alone, and
            memory for it alone.
        torque_axes: None for a torque shared by all, 0 for one a body, or a prefix of the torque's tree with these, as
            for the `in_axes` of `jax.vmap`.
        chunk: bodies in the cache at once.

    Returns:
        The path; `times` (k,), or (n, k) where `dt` or `t0` differ, `states` with leading axes (n, k), `ok` (n,); k = 1
        if only the end is kept.

    Raises:
        ValueError: as `integrate`, or where the sizes of the batch differ; the message names the argument and the cure.
    """
    method = find_method(method) if isinstance(method, str) else method
    if not isinstance(start, State):
        raise ValueError(f"start must be a state such as midlie_jax.RigidState, got {type(start).__name__}.")
    if start.momentum.ndim != 2:
        raise ValueError(
            f"start.momentum must be (n, {start.momentum.shape[-1]}), got {start.momentum.shape}; stack the states of "
            "the bodies with jax.tree.map(lambda *x: jnp.stack(x), *states), or use midlie_jax.integrate for one."
        )
    if isinstance(chunk, bool) or not isinstance(chunk, int) or chunk < 1:
        raise ValueError(f"chunk must be a positive Python int, got {chunk!r}.")
    dtype, count = start.momentum.dtype, start.momentum.shape[0]
    dt, t0 = jnp.asarray(dt, dtype), jnp.asarray(t0, dtype)
    for name, array in (("dt", dt), ("t0", t0)):
        require_finite(name, array)
        if array.ndim > 1:
            raise ValueError(f"{name} must be one for all, or ({count},), got {array.shape}.")
    moments = body.moments if isinstance(body, RigidBody) and body.moments.ndim == 2 else None
    axes = (None if moments is None else 0, torque_axes, 0, 0 if dt.ndim else None, 0 if t0.ndim else None)
    sizes = {"body.moments": moments, "dt": dt, "t0": t0}
    for name, array in sizes.items():
        if array is not None and array.ndim and array.shape[0] != count:
            raise ValueError(f"{name} has {array.shape[0]} rows, but start.momentum has {count}; give one a body.")
    return _run(method, body, torque, start, dt, t0, first_step, steps, save_every, axes, chunk)


@eqx.filter_jit
def _run(
    method: Method,
    body: Any,
    torque: Any,
    start: State,
    dt: Array,
    t0: Array,
    first_step: int,
    steps: int,
    save_every: int | None,
    axes: tuple[Any, ...],
    chunk: int,
) -> Path:
    def alone(body: Any, torque: Any, start: State, dt: Array, t0: Array) -> Path:
        every = steps if save_every is None else save_every
        path = integrate(
            method, body, torque, start, dt=dt, t0=t0, steps=steps, save_every=every, first_step=first_step
        )
        if save_every is not None:
            return path
        return Path(path.times[1:], jax.tree.map(lambda x: x[1:], path.states), path.ok)

    each_time = 0 in axes[3:]
    many = jax.vmap(alone, axes, Path(0 if each_time else None, 0, 0))  # pyright: ignore[reportArgumentType]
    count = start.momentum.shape[0]
    chunks = _chunks(count, chunk)
    if chunks == 1:
        return many(body, torque, start, dt, t0)
    size = -(-count // chunks)
    mapped, shared = _split((body, torque, start, dt, t0), axes)
    # The last chunk is filled with copies of the last body, so that one program serves all.
    rows = jnp.minimum(jnp.arange(chunks * size), count - 1).reshape(chunks, size)

    def one(rows: Array) -> Path:
        return many(*eqx.combine(jax.tree.map(lambda x: x[rows], mapped), shared))

    def join(parts: Array) -> Array:
        return parts.reshape(chunks * size, *parts.shape[2:])[:count]

    times, states, ok = jax.lax.map(one, rows)
    return Path(join(times) if each_time else times[0], jax.tree.map(join, states), join(ok))


def _chunks(count: int, chunk: int) -> int:
    """How many chunks: as few as will do, or a few more if all are then full and the result needs no copy."""
    least = -(-count // chunk)
    return next((n for n in range(least, least + least // 4 + 1) if count % n == 0), least)


def _split(arguments: tuple[Any, ...], axes: tuple[Any, ...]) -> tuple[Any, Any]:
    """The leaves that have one row a body, and the rest."""
    spread = tuple(
        jax.tree.map(lambda axis, part: jax.tree.map(lambda _: axis == 0, part), axis, argument, is_leaf=_none)
        for axis, argument in zip(axes, arguments, strict=True)
    )
    return eqx.partition(arguments, spread)


def _none(value: Any) -> bool:
    return value is None
