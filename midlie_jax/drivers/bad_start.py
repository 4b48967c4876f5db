"""Starts that are not finite: such a body fails, and must not make the gradient of the others NaN.

Where bodies share a parameter, its reverse derivative is a sum over all of them. The derivative of a body that starts
with NaN is NaN, also if its cotangent is zero. So such a body runs from the start of another one, its verdict says that
it failed, and NaN takes the place of what it saves. The derivative of that choice is zero. A run without derivatives
contains nothing of this: the choices would take a tenth of the time of short runs.
"""

from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._xla.internals import make_primitive
from .._xla.per_row import in_rows

T = TypeVar("T")


def finite_start(start: T, good: Array, torque: Any, t: Array, others: Any) -> T:
    """The start; in a run that is differentiated, that of another body unless it is `good`.

    It is the first good one along the axis of `jax.vmap`; without one, ones.

    Args:
        start, good: the start, and whether it is finite, ().
        torque, t: the torque, bound to its body, or None, and the time at which it is traced. So a run counts as
            differentiated also where the torque is a function that closes over a parameter.
        others: what else the run reads; a derivative with respect to any of it counts.
    """
    read = [] if torque is None else jax.closure_convert(lambda t, state: torque(t, state), t, start)[1]
    read = [x for x in jax.tree.leaves((read, others)) if eqx.is_inexact_array(x)]
    leaves, structure = jax.tree.flatten(start)
    return structure.unflatten(_start(leaves, good, read))


def nan_unless(good: Array, tree: T) -> T:
    """The tree; in a run that is differentiated with NaN in place of its floating-point numbers unless `good`."""
    numbers, rest = eqx.partition(tree, eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten(numbers)
    return eqx.combine(structure.unflatten(_saved(leaves, good)), rest)


@jax.custom_jvp
def _start(leaves: list[Array], good: Array, read: list[Array]) -> list[Array]:
    del read
    return in_rows(leaves, [good])


@_start.defjvp
def _start_jvp(primals: Any, tangents: Any) -> tuple[list[Array], list[Array]]:
    leaves, good, _ = primals
    others = _other.bind(good, *jax.lax.stop_gradient(leaves))
    chosen = [jnp.where(good, x, other) for x, other in zip(leaves, others, strict=True)]
    return chosen, [jnp.where(good, x, jnp.zeros_like(x)) for x in tangents[0]]


@jax.custom_jvp
def _saved(leaves: list[Array], good: Array) -> list[Array]:
    return in_rows(leaves, [good])


@_saved.defjvp
def _saved_jvp(primals: Any, tangents: Any) -> tuple[list[Array], list[Array]]:
    leaves, good = primals
    saved = [jnp.where(good, x, jnp.full_like(x, jnp.nan)) for x in leaves]
    return saved, [jnp.where(good, x, jnp.zeros_like(x)) for x in tangents[0]]


def _ones(good: Array, *leaves: Array) -> list[Array]:
    del good
    return [jnp.ones_like(x) for x in leaves]


def _batch(values: Any, axes: Any) -> tuple[list[Array], list[None]]:
    (good, *leaves), (of_good, *of_leaves) = values, axes
    if of_good is None:  # then no array has rows
        return _other.bind(*values), [None] * len(leaves)
    good = jnp.moveaxis(good, of_good, 0)
    first = jnp.argmax(good)

    def other(x: Array, axis: int | None) -> Array:
        row = x if axis is None else jnp.moveaxis(x, axis, 0)[first]
        return jnp.where(good[first], row, 1)

    return [other(*pair) for pair in zip(leaves, of_leaves, strict=True)], [None] * len(leaves)


def _no_derivative(*arguments: Any, **parameters: Any) -> Any:
    raise AssertionError("the start of another body has no derivative")


_other = make_primitive(
    "start_of_another",
    default=_ones,
    on_cpu=_ones,
    jvp=_no_derivative,
    transpose=_no_derivative,
    batch=_batch,
    outputs=lambda types: types[1:],
)
