"""Derivatives with respect to values shared by all rows of a batch, summed over the rows only once.

Under `jax.vmap`, a loop over steps reads a shared weight as one number. Its reverse derivative then sums the cotangents
of all rows in every step, in a separate pass over the batch, for which XLA repeats much of the step. Such a gradient
takes 2 times longer than the gradient of a weight per row. Here the loop still reads one number, but its tangent comes
from a copy of the weight with one entry per row, which only the derivative reads. The loop then adds up cotangents row
by row, and the sum over the rows is taken where the copy was made, before the loop.
"""

from collections.abc import Sequence
from typing import Any, TypeVar

import jax.numpy as jnp
from jax import Array

from .internals import make_primitive

T = TypeVar("T")


def in_rows(arrays: Sequence[Array], like: Sequence[Array]) -> list[Array]:
    """The arrays with their values unchanged; under `jax.vmap` each has rows if one of the arrays or of `like` has."""
    return _in_rows.bind(*arrays, *like, count=len(arrays)) if arrays else []


def with_tangents_of(copies: Sequence[Array], arrays: Sequence[Array]) -> list[Array]:
    """The arrays with their values unchanged; derivatives are taken with respect to the copies, which are not read."""
    return _with_tangents.bind(*arrays, *copies) if arrays else []


def _batched(values: Sequence[Array], axes: Sequence[int | None]) -> list[Array]:
    pairs = list(zip(values, axes, strict=True))
    size = next(value.shape[axis] for value, axis in pairs if axis is not None)
    return [jnp.broadcast_to(v, (size, *v.shape)) if a is None else jnp.moveaxis(v, a, 0) for v, a in pairs]


def _first(*values: Array, count: int) -> list[Array]:
    return list(values[:count])


def _batch_in_rows(values: Any, axes: Any, *, count: int) -> tuple[list[Array], list[int]]:
    return _in_rows.bind(*_batched(values, axes), count=count), [0] * count


def _jvp_in_rows(primals: Any, tangents: Any, *, count: int) -> tuple[list[Array], list[Any]]:
    return _in_rows.bind(*primals, count=count), list(tangents[:count])


def _first_half(*values: Array) -> list[Array]:
    return list(values[: len(values) // 2])


def _batch_with_tangents(values: Any, axes: Any) -> tuple[list[Array], list[int]]:
    return _with_tangents.bind(*_batched(values, axes)), [0] * (len(values) // 2)


def _jvp_with_tangents(primals: Any, tangents: Any) -> tuple[list[Array], list[Any]]:
    return _with_tangents.bind(*primals), list(tangents[len(primals) // 2 :])


def _no_transpose(cotangents: Any, *primals: Any, **parameters: Any) -> Any:
    raise AssertionError("tangents do not pass through this primitive")


_in_rows = make_primitive(
    "in_rows",
    default=_first,
    on_cpu=_first,
    jvp=_jvp_in_rows,
    transpose=_no_transpose,
    batch=_batch_in_rows,
    outputs=lambda types, count: types[:count],
)
_with_tangents = make_primitive(
    "with_tangents",
    default=_first_half,
    on_cpu=_first_half,
    jvp=_jvp_with_tangents,
    transpose=_no_transpose,
    batch=_batch_with_tangents,
    outputs=lambda types: types[: len(types) // 2],
)
