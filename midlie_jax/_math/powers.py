"""Powers of two from the bits of a number: a few operations on integers, whereas `frexp` and `exp2` take dozens."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

_BITS: dict[str, tuple[Any, int, int]] = {"float64": (jnp.int64, 52, 1023), "float32": (jnp.int32, 23, 127)}


def exponent(x: Array) -> Array:
    """The integer n with 2^n <= x < 2^(n + 1), for a normal x > 0; for zero the least exponent."""
    integer, digits, bias = _BITS[str(x.dtype)]
    return (jax.lax.bitcast_convert_type(jax.lax.stop_gradient(x), integer) >> digits) - bias


def power(n: Array, dtype: Any) -> Array:
    """2^n for an n returned by `exponent`; zero for the least exponent."""
    _, digits, bias = _BITS[str(dtype)]
    return jax.lax.bitcast_convert_type((n + bias) << digits, dtype)


def bounded(n: Array, dtype: Any) -> Array:
    """2^n, or the nearest power of two that is a normal number."""
    bias = _BITS[str(dtype)][2]
    return power(jnp.clip(n, 1 - bias, bias), dtype)


def unit(x: Array) -> tuple[Array, Array]:
    """The largest power of two that is at most x > 0, and its inverse; for zero, zero and a large number."""
    _, _, bias = _BITS[str(x.dtype)]
    n = jnp.minimum(exponent(x), bias - 1)  # the inverse of the largest power of two is not a normal number
    return power(n, x.dtype), power(-n, x.dtype)
