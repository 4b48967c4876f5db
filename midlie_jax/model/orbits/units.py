"""Units of an orbit that are powers of two, in which no product of its numbers leaves the range of the dtype."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.powers import bounded, exponent


class Units(NamedTuple):
    """Units of length and time in which a position has the size 1 to 2 and mu is 1 to 4: constants without derivatives.

    In float32 and SI units, mu squared of the Sun is infinite, and XLA makes such products of quotients of quotients.
    Multiplication by a power of two is exact, so the units change no digit of a result.

    Attributes:
        length, per_length: the unit of length, and its inverse.
        per_time, per_speed: the inverse units of time and velocity.
        of_mu: what mu is multiplied by.
    """

    length: Array
    per_length: Array
    per_time: Array
    per_speed: Array
    of_mu: Array

    @classmethod
    def of(cls, position: cp.Vector, mu: Array) -> "Units":
        """The units for a position and a mu of one dtype."""
        n, of_mu = exponent(cp.largest(position)), exponent(mu)
        time = (3 * n - of_mu) // 2
        powers: Any = (n, -n, -time, time - n, 2 * time - 3 * n)
        return cls(*(bounded(jnp.asarray(power), mu.dtype) for power in powers))
