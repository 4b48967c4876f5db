"""The variables of a file: their dimensions, types, units and frames, for a reader who does not know this package."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..drivers.ensemble import Batch
from ..drivers.observe import Observe, Statistic, observe_state
from .names import named
from .plan import Plan

BODY, GROUP, TIME = "body", "group", "time"  # names of dimensions
COORDINATES = {"axis": ["1", "2", "3"], "space_axis": ["x", "y", "z"], "quaternion": ["w", "x", "y", "z"]}


class Variable(NamedTuple):
    """One array of the file.

    Attributes:
        dims: names of its dimensions.
        shape: its whole shape.
        dtype: the dtype of its numbers.
        attributes: long_name, units and frame where they are known.
    """

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: dict[str, str]


def seen_leaves(batch: Batch, observe: Observe | None) -> Any:
    """What a run writes at one time, as a pytree of shapes and dtypes: for one body, or for a part of a statistic."""
    mapped = jax.tree.map(lambda x: x[0], batch.mapped)
    body, torque, start, _, t0 = eqx.combine(mapped, batch.shared)
    seen = eqx.filter_eval_shape(observe_state, observe, t0, start, body, torque)
    if not isinstance(observe, Statistic):
        return seen
    values = jax.tree.map(lambda x: jax.ShapeDtypeStruct((1, *x.shape), x.dtype), seen)
    return eqx.filter_eval_shape(observe.part, values, jax.ShapeDtypeStruct((1,), jnp.bool_))


def seen_variables(seen: Any, observe: Observe | None, plan: Plan) -> dict[str, Variable]:
    """The variables that a run writes, by name: (body, time, ...), or for a statistic (group, time, ...)."""
    first = (GROUP, plan.groups) if isinstance(observe, Statistic) else (BODY, plan.bodies)
    known = seen.described() if observe is None else {}
    found: dict[str, Variable] = {}
    for name, leaf in named(seen).items():
        dims, attributes = known.get(name, ((), {"long_name": name}))
        dims = dims or own_dims(name, leaf.shape)
        shape = (first[1], plan.saves, *leaf.shape)
        found[name] = Variable((first[0], TIME, *dims), shape, np.dtype(leaf.dtype), attributes)
    return found


def state_variables(batch: Batch) -> dict[str, Variable]:
    """The variables with the states of all bodies from which a run goes on."""
    start = batch.mapped[2]
    return {
        name: Variable((BODY, *own_dims(name, leaf.shape[1:])), leaf.shape, np.dtype(leaf.dtype), {})
        for name, leaf in named(start).items()
    }


def own_dims(name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Names for the dimensions of an array about which nothing is known."""
    return tuple(f"{name}_{i + 1}" for i in range(len(shape)))
