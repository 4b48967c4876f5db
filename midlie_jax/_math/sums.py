"""Accurate sums of many numbers in float32."""

import jax.numpy as jnp
from jax import Array

_ROWS = 64  # numbers that are added in sequence


def total(x: Array, axis: int = 0) -> Array:
    """The sum along an axis, in blocks of 64 numbers, then of 64 sums, and so on.

    There are 64 rounding errors for each power of 64 in the number of terms, instead of one per term. Neighbours along
    the axis are in different blocks, so all blocks are added side by side.
    """
    x = jnp.moveaxis(x, axis, 0)
    while len(x) > 1:
        rows = min(len(x), _ROWS)
        width = -(-len(x) // rows)
        x = jnp.pad(x, [(0, rows * width - len(x))] + [(0, 0)] * (x.ndim - 1))
        x = jnp.sum(x.reshape(rows, width, *x.shape[1:]), axis=0)
    return x[0] if len(x) else jnp.sum(x, axis=0)
