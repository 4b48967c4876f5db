"""The variables of a file with dimensions, types, units and frames, for readers without this package."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..drivers.ensemble import Batch
from ..drivers.observe import Observe, Statistic, observe_state
from ..drivers.observe.series import Series
from .names import named
from .plan import Plan

BODY, GROUP, TIME, SPAN = "body", "group", "time", "span"  # names of dimensions
# Under these names a checkpoint holds the progress of each body, and the carry of a statistic over times.
CARRIED, SERIES = "carried", "series"
COORDINATES = {"axis": ["1", "2", "3"], "space_axis": ["x", "y", "z"], "quaternion": ["w", "x", "y", "z"]}


class Variable(NamedTuple):
    """One array of the file.

    Attributes:
        dims: names of its dimensions.
        shape: its whole shape.
        dtype: the dtype of its numbers.
        attributes: long_name, units and frame, if available.
    """

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: dict[str, str]


def seen_leaves(batch: Batch, observe: Observe | None) -> Any:
    """The values that a run writes at one time, as shapes and dtypes: for one body, or for a part of a statistic.

    For a statistic over times, the values that it writes at the end of a span.
    """
    seen = value_leaves(batch, observe)
    if not isinstance(observe, Statistic):
        return seen
    axes = (1, 1) if isinstance(observe, Series) else (1,)
    values = jax.tree.map(lambda x: jax.ShapeDtypeStruct((*axes, *x.shape), x.dtype), seen)
    return eqx.filter_eval_shape(observe.part, values, jax.ShapeDtypeStruct(axes, jnp.bool_))


def bytes_of(leaves: Any) -> int:
    """The bytes of a pytree of shapes and dtypes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(leaves))


def carried_leaves(batch: Batch, observe: Series, bodies: int) -> Any:
    """The carry of a statistic over times for this many bodies, as a pytree of shapes and dtypes."""
    return eqx.filter_eval_shape(observe.begun, bodies, value_leaves(batch, observe))


def value_leaves(batch: Batch, observe: Observe | None) -> Any:
    """The observed values of one body at one time, as a pytree of shapes and dtypes."""
    mapped = jax.tree.map(lambda x: x[0], batch.mapped)
    body, torque, start, _, t0 = eqx.combine(mapped, batch.shared)
    return eqx.filter_eval_shape(observe_state, observe, t0, start, body, torque)


def seen_variables(seen: Any, observe: Observe | None, plan: Plan) -> dict[str, Variable]:
    """The variables that a run writes, by name: (body, time, ...), or for a statistic (group, time, ...).

    For a statistic over times (group, span, ...): its value at the end of each span.
    """
    times = (SPAN, plan.spans) if isinstance(observe, Series) else (TIME, plan.saves)
    first = (GROUP, plan.groups) if isinstance(observe, Statistic) else (BODY, plan.bodies)
    known = seen.described() if observe is None else {}
    found: dict[str, Variable] = {}
    for name, leaf in named(seen).items():
        dims, attributes = known.get(name, ((), {"long_name": name}))
        dims = dims or own_dims(name, leaf.shape)
        shape = (first[1], times[1], *leaf.shape)
        found[name] = Variable((first[0], times[0], *dims), shape, np.dtype(leaf.dtype), attributes)
    return found


def kept_variables(carried: Any, batch: Batch, observe: Observe | None) -> dict[str, Variable]:
    """The variables of a checkpoint: the progress of all bodies, and the carry of a statistic.

    Args:
        carried: the progress of some bodies, as a pytree of shapes and dtypes.
    """
    arrays = eqx.filter_eval_shape(packed, carried)
    if isinstance(observe, Series):
        arrays |= named({SERIES: carried_leaves(batch, observe, batch.bodies)})
    return {
        name: Variable(
            (BODY, *own_dims(name, leaf.shape[1:])), (batch.bodies, *leaf.shape[1:]), np.dtype(leaf.dtype), {}
        )
        for name, leaf in arrays.items()
    }


def packed(carried: Any) -> dict[str, Any]:
    """The arrays (bodies, ...) of a progress as one array (bodies, numbers) per dtype, by name."""
    leaves = jax.tree.leaves(carried)
    numpy = np if all(isinstance(x, np.ndarray) for x in leaves) else jnp
    return {
        f"{CARRIED}_{dtype}": numpy.concatenate([x.reshape(len(x), -1) for x in leaves if x.dtype == dtype], axis=1)
        for dtype in sorted({x.dtype for x in leaves}, key=str)
    }


def unpacked(like: Any, arrays: dict[str, np.ndarray]) -> Any:
    """The progress from its arrays as made by `packed`; `like` has its structure, shapes and dtypes."""
    leaves, structure = jax.tree.flatten(like)
    begin = dict.fromkeys(arrays, 0)
    found: list[np.ndarray] = []
    for leaf in leaves:
        name, size = f"{CARRIED}_{leaf.dtype}", int(np.prod(leaf.shape[1:]))
        values = arrays[name][:, begin[name] : begin[name] + size]
        found.append(np.ascontiguousarray(values).reshape(len(values), *leaf.shape[1:]))
        begin[name] += size
    return jax.tree.unflatten(structure, found)


def own_dims(name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Names for the dimensions of an array without known meaning."""
    return tuple(f"{name}_{i + 1}" for i in range(len(shape)))
