"""Power-of-two units of an orbit, in which no product leaves the range of the dtype."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.powers import bounded, exponent


class Units(NamedTuple):
    """Constant units of length and time in which a position has the size 1 to 2 and mu is 1 to 4, without derivatives.

    In float32 and SI units, the square of the Sun's mu is infinite, and XLA forms such products from nested quotients.
    Multiplication by a power of two is exact, so the units do not change a result.

    Attributes:
        length, per_length: the unit of length, and its inverse.
        per_time, per_speed: the inverse units of time and velocity.
        of_mu: factor of mu.
    """

    length: Array
    per_length: Array
    per_time: Array
    per_speed: Array
    of_mu: Array

    @classmethod
    def of(cls, position: cp.Vector, mu: Array) -> "Units":
        n, of_mu = exponent(cp.largest(position)), exponent(mu)
        time = (3 * n - of_mu) // 2
        powers: Any = (n, -n, -time, time - n, 2 * time - 3 * n)
        return cls(*(bounded(jnp.asarray(power), mu.dtype) for power in powers))
