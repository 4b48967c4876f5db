"""Initial states that are not finite: such a body fails, but the gradients of the other bodies stay finite.

The reverse derivative of a shared parameter is a sum over all bodies, and NaN for a body whose initial state contains
NaN. Such a body therefore runs from the initial state of another body; its verdict says that it failed, and its saved
values are replaced by NaN. A run without derivatives contains none of this, which would slow down short runs.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._xla.internals import make_primitive
from .._xla.mesh import row_of
from .._xla.per_row import in_rows

T = TypeVar("T")


def finite_start(start: T, good: Array, torque: Any, t: Array, others: Any) -> T:
    """The initial state; in a differentiated run, unless it is `good`, the first good state of a batch, or ones.

    The torque, bound to its body, is traced at the time t, so that a run also counts as differentiated if a function
    closes over a parameter. `others` are all other inputs of the run.
    """
    read = [] if torque is None else jax.closure_convert(lambda t, state: torque(t, state), t, start)[1]
    read = [x for x in jax.tree.leaves((read, others)) if eqx.is_inexact_array(x)]
    leaves, structure = jax.tree.flatten(start)
    return structure.unflatten(_chosen(_starts_of_another, leaves, good, read))


def nan_unless(good: Array, tree: T) -> T:
    """The tree; in a differentiated run, NaN replaces its floating-point numbers unless `good`."""
    numbers, rest = eqx.partition(tree, eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten(numbers)
    return eqx.combine(structure.unflatten(_chosen(_nan, leaves, good, [])), rest)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _chosen(others: Callable[..., Iterable[Array]], leaves: list[Array], good: Array, read: list[Array]) -> list[Array]:
    """The leaves; in a derivative by one of the arguments, `others` unless `good`."""
    return in_rows(leaves, [good])


@_chosen.defjvp
def _chosen_jvp(others: Any, primals: Any, tangents: Any) -> tuple[list[Array], list[Array]]:
    leaves, good, _ = primals
    chosen = [jnp.where(good, x, other) for x, other in zip(leaves, others(good, leaves), strict=True)]
    return chosen, [jnp.where(good, x, jnp.zeros_like(x)) for x in tangents[0]]


def _starts_of_another(good: Array, leaves: list[Array]) -> Iterable[Array]:
    return _other.bind(good, *jax.lax.stop_gradient(leaves))


def _nan(good: Array, leaves: list[Array]) -> Iterable[Array]:
    return (jnp.full_like(x, jnp.nan) for x in leaves)


def _ones(good: Array, *leaves: Array) -> list[Array]:
    return [jnp.ones_like(x) for x in leaves]


def _batch(values: Any, axes: Any) -> tuple[list[Array], list[None]]:
    (good, *leaves), (of_good, *of_leaves) = values, axes
    if of_good is None:  # no array has rows
        return _other.bind(*values), [None] * len(leaves)
    good = jnp.moveaxis(good, of_good, 0)
    first = jnp.argmax(good)

    def other(x: Array, axis: int | None) -> Array:
        other_start = x if axis is None else row_of(jnp.moveaxis(x, axis, 0), first)
        return jnp.where(row_of(good, first), other_start, 1)

    return [other(*pair) for pair in zip(leaves, of_leaves, strict=True)], [None] * len(leaves)


_other = make_primitive(
    "start_of_another",
    default=_ones,
    on_cpu=_ones,
    batch=_batch,
    outputs=lambda types: types[1:],
)
