"""The interface of an orbit: a position as a function of time, and the times at which it is known."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._math import components as cp
from ..._math.powers import bounded, exponent
from .. import so3

# Kilometres in place of metres, in the orbit or in mu, change v^2 r / mu by 1e9.
_LEAST_RATIO, _LARGEST_RATIO = 1e-5, 1e7


class Timed(eqx.Module):
    """A vector as a function of time, which may have limits; the drivers check them before a run."""

    @property
    def span(self) -> tuple[Any, Any] | None:
        """The first and the last time at which the vector is known; None without limits."""
        return None


class Orbit(Timed):
    """A position in space as a function of time: `orbit(t) -> (..., 3)`, length, for one time or several.

    Examples:
        >>> class Line(ml.orbits.Orbit):  # a custom orbit
        ...     speed: float
        ...     def __call__(self, t):
        ...         return jnp.stack([self.speed * t, 7000.0 + 0 * t, 0 * t], axis=-1)
        >>> Line(7.5)(jnp.array([0.0, 10.0])).shape, Line(7.5).velocity_at(10.0)
        ((2, 3), Array([7.5, 0. , 0. ], dtype=float64))
    """

    def known(self) -> tuple[Any, Any] | None:
        """Positions and velocities (..., 3) known without a time, for the check of units; or None."""
        return None

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        raise NotImplementedError(f"{type(self).__name__} must define __call__(t).")

    def velocity_at(self, t: Any) -> Float[Array, "*batch 3"]:
        """The velocity at time t, (..., 3), length/time: the exact derivative of the position.

        Torques accept it as a function: `midlie_jax.torques.Drag(..., velocity=orbit.velocity_at)`.
        """
        t = jnp.asarray(t, jnp.result_type(float, t))
        return jax.jvp(self, (t,), (jnp.ones_like(t),))[1]

    def lvlh(self, t: Any) -> Float[Array, "*batch 4"]:
        """The local frame LVLH of CCSDS at time t, as the quaternion from its components to space, (..., 4).

        z points to the origin of the orbit (nadir), y against the orbital angular momentum, and x completes the frame;
        on a circle x is the direction of flight. `midlie_jax.spacecraft.PDControl` accepts it as a target.

        Examples:
            >>> orbit = ml.orbits.CircularOrbit([7e6, 0.0, 0.0], [0.0, 1.0, 0.0], 3.986e14)
            >>> ml.so3.rotate(orbit.lvlh(0.0), jnp.array([1.0, 0.0, 0.0])).round(6)  # the direction of flight
            Array([0., 1., 0.], dtype=float64)
        """
        position, velocity = self(t), self.velocity_at(t)
        normal = jnp.cross(position, velocity)
        down, left = (-x / jnp.linalg.norm(x, axis=-1, keepdims=True) for x in (position, normal))
        return so3.from_matrix(jnp.stack([jnp.cross(left, down), left, down], axis=-1))


def check_units(orbit: Any, mu: Any, fastest: float = _LARGEST_RATIO, cure: str = "pass lambda t: orbit(t)") -> None:
    rows = orbit.known() if isinstance(orbit, Orbit) else None
    if rows is None or cp.is_traced(rows, mu):
        return
    r, v = (np.linalg.norm(np.asarray(x, np.float64), axis=-1) for x in rows)
    ratios, mu = v * v * r, np.asarray(mu, np.float64)
    least, largest = float(ratios.min() / mu.max()), float(ratios.max() / mu.min())
    if 0 < largest < _LEAST_RATIO or least > fastest:
        raise ValueError(
            f"orbit and mu must be in the same units, got speed^2 distance / mu from {least:.2g} to {largest:.2g}. "
            f"Convert one, or {cure}."
        )


def orbits_in(tree: Any) -> list[Timed]:
    leaves = jax.tree.leaves(tree, is_leaf=lambda x: isinstance(x, Timed))
    return [leaf for leaf in leaves if isinstance(leaf, Timed)]


class Units(NamedTuple):
    """Constant units of length and time in which a position has the size 1 to 2 and mu, times `of_mu`, is 1 to 4.

    In float32 and SI units, the square of the Sun's mu is infinite. Powers of two do not change a result.
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
