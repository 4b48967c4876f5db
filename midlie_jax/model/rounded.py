"""Rounded moments of a flat body: their last digits may violate I1 + I2 >= I3."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math.components import is_traced

_MOST = 1e-3  # the largest violation relative to the sum of the moments, for any number of digits


def made_flat(moments: Array, tolerance: float) -> Array:
    """Moments (..., 3), with the largest lowered to the sum of the other two if rounding explains the excess.

    The numbers must be concrete; their common last digit bounds the rounding of each. Violations up to the tolerance,
    relative to the sum of the moments, change nothing.
    """
    if is_traced(moments):
        return moments
    rows = np.array(moments).reshape(-1, 3)
    total = rows.sum(axis=1)
    excess = 2 * rows.max(axis=1) - total
    changed = False
    for i in np.flatnonzero((excess > tolerance * total) & (excess <= _MOST * total)):
        row = rows[i]
        if excess[i] <= 1.5 * 1.001 * min(map(_last_digit, row)):
            largest = int(np.argmax(row))
            row[largest] = 0
            row[largest] = row.sum()
            changed = True
    return jnp.asarray(rows.reshape(moments.shape)) if changed else moments


def _last_digit(number: np.floating) -> float:
    """One unit in the last digit of the shortest decimal representation of a number."""
    mantissa, _, exponent = np.format_float_scientific(number, trim="-").partition("e")
    return 10.0 ** (int(exponent) - len(mantissa.partition(".")[2]))
