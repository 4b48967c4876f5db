"""`energy` of one state, of a path, and of many bodies with many states each, as `ensemble` returns them."""

from contextlib import suppress
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats
from .._xla.compiler import tuned_jit
from .._xla.structure import once
from ..model import observables
from ..model.bodies import Body
from ..model.compatibility import check_body, check_state, check_torque
from ..model.observables import axes_of_bodies
from ..model.state import AnyState, State
from ..model.torques import TorqueLike, on_body, potential_of
from .path import Path
from .rows import AUTO, torque_rows


def energy(
    body: Body,
    torque: TorqueLike | None,
    motion: AnyState | Path[AnyState],
    t: float | Array | None = None,
    *,
    torque_axes: Any = "auto",
) -> Float[Array, "*batch"]:
    """Kinetic plus potential energy.

    Args:
        body: one body for all states; or n bodies, whose states have the leading axes (n, times).
        torque: as for `integrate` or `ensemble`: None, or a torque with a potential, whose arrays may have one row per
            body.
        motion: any state, which may have leading batch axes (except for particles); or a `Path` of such states, which
            contains their times. For a run of `simulate` pass its `states()`.
        t: the time of the states, if the potential depends on time; its shape broadcasts to the batch.
        torque_axes: as for `ensemble`. By default no array has rows if there is one body and the torque fits it.

    Raises:
        ValueError: the torque has no potential; the potential depends on time and `t` is missing; `t` is given with a
            path; or the body, or a number of rows, does not match the state.

    Examples:
        >>> ml.observe.energy(body, torque, start).round(4)  # 50^2 / 2 + 20 cos 0.3
        Array(1269.1067, dtype=float64)
    """
    path, state = (None, motion) if isinstance(motion, State) else (motion, getattr(motion, "states", None))
    if not isinstance(state, State):
        return observables.energy(body, torque, motion, t)  # which raises
    if path is None and t is not None:
        t = as_floats("t", t).astype(state.momentum.dtype)
    if not state.own_axes:
        return _of_one(body, torque, motion, t)
    check_state("motion", state)
    check_body(body, state)
    check_torque(torque)
    own_body, batch = axes_of_bodies(body, state) == 1, state.batch
    rows = once(_rows, body, torque, state, own_body, path is not None and path.ok.ndim == 1, torque_axes)
    if not own_body and not any(jax.tree.leaves(rows)):
        return _of_one(body, torque, motion, t)
    if path is not None and t is not None:
        raise ValueError("a path has its own times; do not pass t.")
    times = t if path is None else path.times
    if times is not None:
        times = jnp.broadcast_to(as_floats("t", times).astype(state.momentum.dtype), batch)
    arguments = (body, torque)
    mapped, shared = eqx.partition(arguments, (jax.tree.map(lambda _: own_body, body), rows))
    return _of_bodies(mapped, shared, state, times)


# Compiled as one program, because evaluating a potential of many bodies operation by operation would take a second.
_of_one = tuned_jit(observables.energy)


@tuned_jit
def _of_bodies(mapped: Any, shared: Any, state: Any, times: Any) -> Array:
    def of_one(mapped: Any, state: Any, times: Any) -> Array:
        body, torque = eqx.combine(mapped, shared)
        return observables.energy(body, torque, state, times)

    return jax.vmap(of_one)(mapped, state, times)


def _rows(body: Body, torque: Any, state: Any, own_body: bool, of_bodies: bool, axes: Any) -> Any:
    """The torque's tree with True for each array with one row per body; `of_bodies`: there are several for sure."""
    shared = jax.tree.map(lambda _: False, torque)
    batch = state.batch
    axes_given = not (isinstance(axes, str) and axes == AUTO)
    if torque is None or not batch or not batch[0]:
        return shared
    starts = jax.tree.map(lambda x: x.reshape(batch[0], -1, *x.shape[len(batch) :])[:, 0], state)
    if not own_body and not of_bodies and not axes_given:
        potential, first = potential_of(on_body(torque, body)), jax.tree.map(lambda x: x[0], starts)
        with suppress(TypeError, ValueError, IndexError):  # unless the whole torque acts on one body
            found = jax.eval_shape(lambda: jnp.asarray(potential(jnp.zeros((), first.momentum.dtype), first)))
            if found.shape == ():
                return shared
    return torque_rows(torque, axes, body, own_body, starts, batch[0])
