"""Derivatives with respect to values shared by all rows of a batch, summed over the rows only once.

Under `jax.vmap`, a loop over steps reads a shared weight as one number. Its reverse derivative then sums the cotangents
of all rows in every step, in a separate pass over the batch, for which XLA repeats much of the step; the gradient takes
2 times longer. Here its tangent comes from a copy of the weight with one entry per row, which only the derivative
reads. The sum over the rows is then taken where the copy was made, before the loop.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax import Array

from .internals import make_primitive


def in_rows(arrays: Sequence[Array], like: Sequence[Array]) -> list[Array]:
    """The arrays with their values unchanged; under `jax.vmap` each has rows if one of the arrays or of `like` has."""
    return _of_rows.bind(*arrays, *like, count=len(arrays), moved=0) if arrays else []


def with_tangents_of(copies: Sequence[Array], arrays: Sequence[Array]) -> list[Array]:
    """The arrays with their values unchanged; derivatives are taken with respect to the copies, which are not read."""
    return _of_rows.bind(*arrays, *copies, count=len(arrays), moved=len(arrays)) if arrays else []


def _first(*values: Array, count: int, moved: int) -> list[Array]:
    return list(values[:count])


def _batch(values: Any, axes: Any, *, count: int, moved: int) -> tuple[list[Array], list[int]]:
    """The axis of rows is first; values without rows are repeated."""
    pairs = list(zip(values, axes, strict=True))
    size = next(value.shape[axis] for value, axis in pairs if axis is not None)
    rows = [jnp.broadcast_to(v, (size, *v.shape)) if a is None else jnp.moveaxis(v, a, 0) for v, a in pairs]
    return _of_rows.bind(*rows, count=count, moved=moved), [0] * count


def _jvp(primals: Any, tangents: Any, *, count: int, moved: int) -> tuple[list[Array], list[Any]]:
    return _of_rows.bind(*primals, count=count, moved=moved), list(tangents[moved : moved + count])


# The first `count` values, with the tangents of the values `moved` places later.
_of_rows = make_primitive(
    "of_rows",
    default=_first,
    on_cpu=_first,
    jvp=_jvp,
    batch=_batch,
    outputs=lambda types, count, moved: types[:count],
)
