"""`ensemble`: the driver for many bodies; checks its arguments and runs the bodies in chunks (`chunks.py`)."""

from typing import Any, NamedTuple, Unpack, overload

import equinox as eqx
import jax
from jax import Array
from jax.sharding import Mesh

from .._checks.arguments import as_count, as_floats, described, require_finite
from .._xla import budgets
from .._xla.internals import bodies_at_once
from .._xla.mesh import row_of
from .._xla.structure import once
from ..integrators.base import Method
from ..model.baths.base import HeatBath
from ..model.bodies import Body
from ..model.compatibility import check_state
from ..model.orbits.base import orbits_in
from ..model.state import AnyState, StateT
from ..model.torques import TorqueLike
from ..model.torques.by_step import is_by_step
from ..model.torques.reads_body import with_bath, without_bath
from .arguments import as_argument, as_first_step, as_method, as_saving, check_step, check_system, check_times
from .chunks import chunk_size, run_ensemble, shared_tables
from .derivatives import Adjoint, as_adjoint
from .integrate import count_as_argument
from .observe import Observe, Statistic, as_observe
from .path import Path
from .rows import AUTO, count_rows, torque_rows
from .stepper import Carry, ConstantStep, carried_on


class _Options(ConstantStep, total=False):
    torque_axes: Any
    chunk: int | None
    mesh: Mesh | None


@overload  # the return type follows `start` and `observe`
def ensemble(
    method: Method | str, body: Body, torque: TorqueLike | None, start: StateT, **options: Unpack[_Options]
) -> Path[StateT]: ...
@overload
def ensemble(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState | Carry,
    *,
    observe: Any = ...,
    **options: Unpack[_Options],
) -> Path[Any]: ...
def ensemble(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: StateT | Carry,
    *,
    dt: float | Array,
    steps: int,
    save_every: int | None = None,
    t0: float | Array = 0.0,
    first_step: int | Array = 0,
    torque_axes: Any = "auto",
    chunk: int | None = None,
    adjoint: Adjoint | None = None,
    mesh: Mesh | None = None,
    observe: Any = None,
    bath: HeatBath | None = None,
) -> Path[StateT]:
    """Integrates n bodies; each result agrees with `integrate` up to a few units in the last place.

    Can be jitted and differentiated. Compiled as often as `integrate`. Values that a torque computes from the time and
    from shared parameters, such as the position on an orbit, are computed once for all bodies.

    Args:
        method, steps, first_step: as for `integrate`.
        body: one body for all, or a `RigidBody` with moments (n, 3), or a `TensorBody` with a tensor (n, 3, 3).
        torque: as for `integrate`. A parameter may have an additional leading axis (n,), as in `HeavyTop(weights)` with
            weights (n,): each body then has its own row. All bodies share the other parameters.
        start: with a leading axis (n,): momentum (n, 3), attitude (n, 4).
        dt, t0: (), or (n,) with one value for each body.
        save_every: as for `integrate`. None needs memory only for the final states.
        torque_axes: which parameters of the torque have one row per body. By default "auto": the choice for which the
            torque acts on one body. If the shapes allow several readings, as (3,) does with three bodies, a ValueError
            shows what to write. None: all bodies share every parameter. 0: every parameter has rows. A list of names,
            such as ["weight"] or ["terms[1].field"]: these have rows. A tree like the torque's with leaves 0 and None
            works like the `in_axes` of `jax.vmap`.
        chunk: number of bodies moved at once; by default the number that is fastest on this machine.
        adjoint: as for `integrate`. With `Reversible()` every body computes all inputs of its torque itself.
        mesh: devices over which the bodies are spread, along all axes of the mesh; `jax.make_mesh((4,), ("bodies",))`
            makes one of four devices. Results are bitwise equal on meshes of any size, if `chunk` is the same and no
            larger than the number of bodies per device.
        observe: as for `integrate`; or a statistic that combines an observable over all bodies with trustworthy values
            at a time, such as `midlie_jax.observe.Mean(f)`. A statistic needs one `dt` and `t0` for all bodies.
        bath: as for `integrate`, with one key per body, `jax.random.split(key, n)`. Its other parameters may have rows
            too. `torque_axes` names them `"bath.kT"` and so on; a tree of axes becomes a pair, for torque and bath.

    Returns:
        The path, with `ok` and `first_bad` (n,). With `save_every`: `times` (k,), or (n, k) if `dt` or `t0` is (n,),
        and `states` with leading axes (n, k). Without: `times` (), or (n,), `states` with a leading axis (n,), and
        `first_bad` 0 for a body that failed, else 1. With `observe`, `states` holds the observed values, with the same
        leading axes. A statistic lacks the axis (n,), and a statistic of time also lacks the axis (k,).

    Raises:
        ValueError: as for `integrate`, or the leading axes differ; the message names the argument and the remedy.

    Examples:
        >>> momentum = jnp.stack([jnp.zeros(4), jnp.zeros(4), jnp.linspace(40.0, 50.0, 4)], axis=-1)
        >>> start = ml.RigidState(momentum, jnp.tile(ml.so3.exp(jnp.array([0.3, 0.0, 0.0])), (4, 1)))
        >>> ends = ml.ensemble("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> ends.states.attitude.shape, bool(ends.ok.all())
        ((4, 4), True)
    """
    steps = as_count("steps", steps)
    chunk = chunk if chunk is None else as_count("chunk", chunk)
    save_every = as_saving(save_every, steps)
    torque = with_bath(torque, bath)
    state, first, carried = carried_on(start, first_step)
    first = as_first_step(first, steps)
    batch = as_batch(method, body, torque, state, dt, t0, torque_axes)
    check_times_of_batch(batch, first, steps)
    observe = as_observe(observe)
    check_spread(batch, observe, mesh)
    if isinstance(observe, Statistic):
        observe.check(save_every and 1 + steps // save_every)
    size = chunk or chunk_size(batch.bodies if mesh is None else -(-batch.bodies // mesh.size), batch.mapped[2])
    adjoint, intervals = as_adjoint(adjoint), 1 if save_every is None else steps // save_every
    every = count_as_argument(steps // intervals, steps, adjoint)
    run = batch.method, adjoint, batch.mapped, batch.shared, first
    prepared = steps if isinstance(every, int) else budgets.PREPARED_STEPS
    while prepared < steps:  # one program then serves up to 4 times more steps
        prepared *= 4
    tables = shared_tables(*run, prepared)
    guarded = carried is None and not bodies_at_once()
    saving = intervals, every, save_every is None, size, observe, mesh
    return run_ensemble(*run, *saving, tables=tables, guarded=guarded, begins=carried)


class Batch(NamedTuple):
    """The checked bodies of an ensemble, and the method fitted to them."""

    method: Method
    bodies: int
    mapped: Any  # body, torque, start, dt and t0, with None for the leaves that all bodies share
    shared: Any  # the same, with None for the leaves that have rows


def as_batch(
    method: Method | str,
    body: Any,
    torque: Any,
    start: Any,
    dt: Any,
    t0: Any,
    torque_axes: Any = AUTO,
    bath: str | None = None,
) -> Batch:
    """The checked arguments of `ensemble`; `bath` is the reason why no heat bath is possible here, if none is."""
    once(check_state, "start", start)
    dtype, count = start.momentum.dtype, start.momentum.shape[0] if start.momentum.ndim else 0

    def of_one() -> tuple[Any, Any]:
        marks = once(_rows_of_torque, body, torque, start, torque_axes)
        return jax.tree.map(lambda x, own: row_of(x) if own else x, torque, marks), jax.tree.map(row_of, start)

    method = check_system(as_method(method), body, torque, start, batch=1, bath=bath, of_one=of_one)
    if count == 0:
        raise ValueError(
            f"start holds no bodies: its momentum has shape {start.momentum.shape}; give it one row for each body."
        )
    dt, t0 = (_scalar_or_row(name, value, count, dtype) for name, value in (("dt", dt), ("t0", t0)))
    check_step(method, dt)
    arguments = (body, torque, start, dt, t0)
    marks = jax.tree.unflatten(jax.tree.structure(arguments), once(_with_rows, arguments, torque_axes))
    return Batch(method, count, *eqx.partition(arguments, marks))


def _rows_of_torque(body: Any, torque: Any, start: Any, torque_axes: Any) -> Any:
    return torque_rows(torque, torque_axes, body, bool(start.kind.batch_of(body)), start, start.momentum.shape[0])


def _with_rows(arguments: Any, torque_axes: Any) -> list[bool]:
    body, torque, start, dt, t0 = arguments
    own_body, count = bool(start.kind.batch_of(body)), start.momentum.shape[0]
    rows = (
        jax.tree.map(lambda _: own_body, body),
        once(_rows_of_torque, body, torque, start, torque_axes),
        jax.tree.map(lambda _: True, start),
        dt.ndim == 1,
        t0.ndim == 1,
    )
    _, bath = without_bath(torque)
    if bath is not None and isinstance(torque_axes, str) and torque_axes == AUTO and not all(rows[1].bath.keys):
        if all(key.shape == (count,) for key in bath.keys):  # a key per body, but other parameters are wrong
            one = jax.tree.map(lambda x: x[0] if x.shape[:1] == (count,) else x, bath)
            one.check_on(jax.tree.map(lambda x: x[0], start), jax.tree.map(lambda x: x[0], body) if own_body else body)
        shape = next((key.shape for key in bath.keys if key.shape != (count,)), (count,))
        same = ", which would all get the same noise" if shape == () else ""
        raise ValueError(
            f"bath.key must have one key for each of {count} bodies, got {shape or 'one key'}{same}; pass "
            f"jax.random.split(key, {count}), or name the parameters with rows in torque_axes to share the noise."
        )
    count_rows(("body", "torque", "start", "dt", "t0"), arguments, rows, count)
    return jax.tree.leaves(rows)


def check_times_of_batch(batch: Batch, first: Any, steps: int) -> None:
    (_, torque, _, *own), (_, shared_torque, _, *shared) = batch.mapped, batch.shared
    torques = torque, shared_torque
    torque = eqx.combine(*torques) if orbits_in(torques) or is_by_step(torques) else None
    dt, t0 = (one if one is not None else other for one, other in zip(own, shared, strict=True))
    check_times(batch.method, torque, t0, dt, first, steps)


def check_spread(batch: Batch, observe: Observe | None, mesh: Any) -> None:
    if not isinstance(mesh, Mesh | None):
        raise ValueError(f"mesh must be a jax.sharding.Mesh, for example from jax.make_mesh, got {described(mesh)}.")
    *_, dt, t0 = batch.mapped
    if isinstance(observe, Statistic) and (dt is not None or t0 is not None):
        raise ValueError("a statistic combines bodies at the same times; give one dt and one t0 for all bodies.")


def _scalar_or_row(name: str, value: Any, count: int, dtype: Any) -> Any:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return as_argument(name, value, dtype)
    array = as_floats(name, value).astype(dtype)
    require_finite(name, array)
    if array.ndim > 1:
        raise ValueError(f"{name} must be a scalar, or one number a body, ({count},), got shape {array.shape}.")
    return array
