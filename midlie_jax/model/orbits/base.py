"""The interface of an orbit: a position as a function of time, and the times for which it is known."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float


class Orbit(eqx.Module):
    """A position in space as a function of time: `orbit(t) -> (..., 3)`, length, for one time or several.

    Examples:
        >>> class Line(ml.orbits.Orbit):  # an orbit of your own
        ...     speed: float
        ...     def __call__(self, t):
        ...         return jnp.stack([self.speed * t, 7000.0 + 0 * t, 0 * t], axis=-1)
        >>> Line(7.5)(jnp.array([0.0, 10.0])).shape, Line(7.5).velocity_at(10.0)
        ((2, 3), Array([7.5, 0. , 0. ], dtype=float64))
    """

    @property
    def span(self) -> tuple[Any, Any] | None:
        """The first and the last time at which the position is known, or None for an orbit without such limits."""
        return None

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        raise NotImplementedError(f"{type(self).__name__} must define __call__(t).")

    def velocity_at(self, t: Any) -> Float[Array, "*batch 3"]:
        """The velocity at time t, (..., 3), length/time: the exact derivative of the position.

        A torque that reads a velocity takes it as a function: `midlie_jax.torques.Drag(...,
        velocity=orbit.velocity_at)`.
        """
        t = jnp.asarray(t, jnp.result_type(float, t))
        return jax.jvp(self, (t,), (jnp.ones_like(t),))[1]


def orbits_in(tree: Any) -> list[Orbit]:
    """All orbits in a torque or a density, at any depth."""
    leaves = jax.tree.leaves(tree, is_leaf=lambda x: isinstance(x, Orbit))
    return [leaf for leaf in leaves if isinstance(leaf, Orbit)]
