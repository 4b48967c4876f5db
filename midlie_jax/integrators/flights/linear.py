"""The exact flight of particles: motion along straight lines."""

from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from ...model.bodies import Particles
from .base import Flight


class Linear(Flight):
    """u += h M^-1 p, the exact force-free motion of particles. The momentum is constant.

    Examples:
        >>> masses = ml.Particles([1.0, 2.0])
        >>> displacement, change, ok = ml.flights.Linear()(masses.inertia(), jnp.array(0.5), jnp.array([3.0, 4.0]))
        >>> displacement
        Array([1.5, 1. ], dtype=float64)
    """

    name: ClassVar[str] = "linear"
    use: ClassVar[str] = "particles: exact"
    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = Particles
    per_loop: ClassVar[int] = 64
    per_kernel: ClassVar[int] = 8

    def __call__(self, inertia: Particles, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
        return h * inertia.velocity(momentum), jnp.zeros_like(momentum), True
