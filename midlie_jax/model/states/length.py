"""Correction of the length of a vector, which rounding changes from step to step."""

import jax.numpy as jnp
from jax import Array


def length_correction(square: Array, no_step: Array) -> Array:
    """The c for which (1 + c) v has length 1 if |v|^2 = square, by one Newton step; zero where `no_step` is True."""
    return jnp.where(no_step, jnp.zeros_like(square), 0.5 - 0.5 * square)
