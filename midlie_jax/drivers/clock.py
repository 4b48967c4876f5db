"""The time of a step, computed from its index, for the drivers with a constant step."""

import jax.numpy as jnp
from jax import Array

_EXACT_BITS = 24  # a float32 represents every integer of up to 24 bits exactly


def ends_of_step(n: Array, clock: tuple[Array, Array]) -> tuple[Array, Array, None]:
    """The times at both ends of step n, from clock = (t0, dt)."""
    return time_of(*clock, n), time_of(*clock, n + 1), None


def ends_of_step_back(n: Array, clock: tuple[Array, Array]) -> tuple[Array, Array, None]:
    return time_of(*clock, n + 1), time_of(*clock, n), None


def time_of(t0: Array, dt: Array, n: Array) -> Array:
    """t0 + n dt in the dtype of the run, for every 32-bit index n; a float32 sum of many dt would lose whole steps.

    The index is split into two parts of its own sign, which float32 represents exactly; parts of different signs would
    cancel. The power of two is an integer, because with a long step its float would be infinite.
    """
    high = jnp.where(n < 0, -(-n >> _EXACT_BITS), n >> _EXACT_BITS)
    high = high << _EXACT_BITS
    low = n - high
    return t0 + (high.astype(dt.dtype) * dt + low.astype(dt.dtype) * dt)
