"""A circular orbit."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_positive, require_rows, shown
from ..._math import components as cp
from ..._math.powers import unit
from .base import Orbit
from .units import Units


class CircularOrbit(Orbit):
    """A circular orbit about the origin.

    Attributes:
        position: the position at t = 0, (3,), length.
        across: the position a quarter of a period later, (3,), length.
        rate: angular velocity sqrt(mu/r^3), (), radians per unit of time.

    Args:
        position: as above.
        direction: the direction of motion at t = 0, (3,); only its part perpendicular to `position` counts.
        mu: gravitational parameter, (), length^3/time^2.

    Raises:
        ValueError: position or direction not of shape (..., 3) or not finite, a position at the origin, a direction
            along the position, or mu not positive.

    Examples:
        >>> orbit = ml.orbits.CircularOrbit(position=[7000.0, 0.0, 0.0], direction=[0.0, 1.0, 0.0], mu=3.986e5)  # km, s
        >>> round(2 * np.pi / float(orbit.rate) / 60, 2)  # period in minutes
        97.14
        >>> orbit(jnp.array([0.0, 60.0, 120.0])).shape
        (3, 3)
    """

    position: Float[Array, "*batch 3"]
    across: Float[Array, "*batch 3"]
    rate: Float[Array, "*batch"]

    def __init__(self, position: Any, direction: Any, mu: Any):
        self.position = as_finite("position", position, (3,))
        direction = as_finite("direction", direction, (3,))
        mu = as_positive("mu", mu)
        require_rows(
            "position", self.position, lambda x: np.any(x != 0, axis=-1), "must not be the centre", "give the position."
        )
        dtype = jnp.result_type(self.position, mu)
        units = Units.of(cp.vector(self.position.astype(dtype)), mu.astype(dtype))
        place, direction = self.position * units.per_length[..., None], _scaled(direction)
        square = jnp.sum(place**2, axis=-1, keepdims=True)
        along = direction - place * (jnp.sum(direction * place, axis=-1, keepdims=True) / square)
        _require_across(direction, along)
        across = along * jnp.sqrt(square / jnp.sum(along**2, axis=-1, keepdims=True))
        self.across = across * units.length[..., None]
        self.rate = jnp.sqrt(units.of_mu * mu / square[..., 0] ** 1.5) * units.per_time

    def known(self) -> tuple[Array, Array]:
        return self.position, self.across * self.rate[..., None]

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        angle = self.rate * t
        c, s = jnp.cos(angle), jnp.sin(angle)
        return cp.pack(cp.add(cp.scale(c, cp.vector(self.position)), cp.scale(s, cp.vector(self.across))))


def _scaled(vector: Array) -> Array:
    """The vector (..., 3) divided by a power of two near its size; zero unchanged."""
    return vector * unit(jnp.max(jnp.abs(vector), axis=-1, keepdims=True))[1]


def _require_across(direction: Array, across: Array) -> None:
    if cp.is_traced(across):
        return
    least = 16 * jnp.finfo(across.dtype).eps * jnp.linalg.norm(direction, axis=-1)
    if not bool(jnp.all(jnp.linalg.norm(across, axis=-1) > least)):
        raise ValueError(
            f"direction must have a part perpendicular to position, got {shown(direction)}; give the "
            "direction of motion."
        )
