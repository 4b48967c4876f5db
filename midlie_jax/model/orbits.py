"""Orbits about a point mass, and a magnetic field along an orbit: inputs of torques and step densities."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, require_finite
from .._math import components as cp

_KEPLER_ITERATIONS = 8
_SMOOTH_ITERATIONS = 2  # only the last iterations are differentiated


class Orbit(eqx.Module):
    """A position in space as a function of time: `orbit(t) -> (..., 3)`."""

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        raise NotImplementedError(f"{type(self).__name__} must define __call__(t).")


class CircularOrbit(Orbit):
    """A circular orbit about the origin.

    Attributes:
        position: the position at t = 0, (3,), length.
        across: the position a quarter of a turn later, (3,), length.
        rate: angular velocity sqrt(mu/r^3), (), radians per unit of time.

    Args:
        position: as above.
        direction: the direction of motion at t = 0, (3,); only its part perpendicular to `position` counts.
        mu: gravitational parameter, (), length^3/time^2.

    Raises:
        ValueError: position or direction not of shape (..., 3) or not finite.
    """

    position: Float[Array, "*batch 3"]
    across: Float[Array, "*batch 3"]
    rate: Float[Array, "*batch"]

    def __init__(self, position: Any, direction: Any, mu: Any):
        self.position = as_floats("position", position, (3,))
        direction = as_floats("direction", direction, (3,))
        require_finite("position", self.position)
        require_finite("direction", direction)
        square = jnp.sum(self.position**2, axis=-1, keepdims=True)
        along = direction - self.position * (jnp.sum(direction * self.position, axis=-1, keepdims=True) / square)
        self.across = along * jnp.sqrt(square / jnp.sum(along**2, axis=-1, keepdims=True))
        self.rate = jnp.sqrt(as_floats("mu", mu) / square[..., 0] ** 1.5)

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        angle = self.rate * t
        c, s = jnp.cos(angle), jnp.sin(angle)
        return cp.pack(cp.add(cp.scale(c, cp.vector(self.position)), cp.scale(s, cp.vector(self.across))))


class KeplerOrbit(Orbit):
    """An elliptic orbit about a focus at the origin, from a position and a velocity.

    Computed from Lagrange's f and g functions; the change of eccentric anomaly comes from a fixed number of Newton
    steps on Kepler's equation (Bate, Mueller & White, Fundamentals of Astrodynamics, chapter 4). The position and its
    first three derivatives are exact to rounding for eccentricities up to 0.8.

    Attributes:
        position: the position at t = 0, (3,), length.
        velocity: the velocity at t = 0, (3,), length/time.
        mu: gravitational parameter, (), length^3/time^2.

    Raises:
        ValueError: position or velocity not of shape (..., 3) or not finite. A hyperbolic orbit raises nothing: its
            positions are NaN, so `path.ok` is False.
    """

    position: Float[Array, "*batch 3"]
    velocity: Float[Array, "*batch 3"]
    mu: Float[Array, "*batch"]

    def __init__(self, position: Any, velocity: Any, mu: Any):
        self.position = as_floats("position", position, (3,))
        self.velocity = as_floats("velocity", velocity, (3,))
        self.mu = as_floats("mu", mu)
        require_finite("position", self.position)
        require_finite("velocity", self.velocity)

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        position, velocity = cp.vector(self.position), cp.vector(self.velocity)
        radius = jnp.sqrt(cp.dot(position, position))
        inverse_axis = 2 / radius - cp.dot(velocity, velocity) / self.mu
        axis = 1 / inverse_axis
        motion = jnp.sqrt(self.mu * inverse_axis**3)
        sine_part = cp.dot(position, velocity) / jnp.sqrt(self.mu * axis)  # e sin E0
        cosine_part = 1 - radius * inverse_axis  # e cos E0
        # Whole turns do not change the position. With the turns removed, a fixed number of iterations is enough at any
        # time.
        turns = jnp.round(motion * t / (2 * jnp.pi))
        mean = motion * t - 2 * jnp.pi * turns
        equation = (mean, sine_part, cosine_part)
        # A differentiated Newton step from the root doubles the number of correct Taylor coefficients: from 1, the root
        # itself, to 2 and then to 4, which includes the first three derivatives. The earlier steps need no derivatives.
        constants = jax.lax.stop_gradient(equation)
        change = constants[0]
        for n in range(_KEPLER_ITERATIONS):
            change = _newton(change, *(constants if n < _KEPLER_ITERATIONS - _SMOOTH_ITERATIONS else equation))
        versine, s = 2 * jnp.sin(change / 2) ** 2, jnp.sin(change)
        f = 1 - versine * axis / radius
        g = (mean - change + s) / motion
        return cp.pack(cp.add(cp.scale(f, position), cp.scale(g, velocity)))


class DipoleField(eqx.Module):
    """The field of a magnetic dipole at the origin, along an orbit: B = (mu_0 / 4 pi r^3) (3 (m . e) e - m), e = r/|r|.

    A first approximation to the Earth's field has a moment m of 7.7e22 A m^2 along the geomagnetic axis, towards the
    south, for orbits in metres (J. R. Wertz, Spacecraft Attitude Determination and Control (1978), appendix H).

    Attributes:
        orbit: the position in the space frame, `orbit(t) -> (3,)`, length.
        moment: dipole moment m in the space frame, (3,).
        constant: mu_0 / 4 pi in the units of the problem, (); 1e-7 T m/A in SI units.

    Raises:
        ValueError: moment not of shape (..., 3), or moment or constant not finite.
    """

    orbit: Callable[[Any], Array]
    moment: Float[Array, "*batch 3"]
    constant: Float[Array, "*batch"]

    def __init__(self, orbit: Callable[[Any], Array], moment: Any, constant: Any = 1e-7):
        self.orbit = orbit
        self.moment = as_floats("moment", moment, (3,))
        self.constant = as_floats("constant", constant)
        require_finite("moment", self.moment)
        require_finite("constant", self.constant)

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        position, moment = cp.vector(self.orbit(t)), cp.vector(self.moment)
        square = cp.dot(position, position)
        inverse = 1 / jnp.sqrt(square)
        e = cp.scale(inverse, position)
        field = cp.subtract(cp.scale(3 * cp.dot(moment, e), e), moment)
        return cp.pack(cp.scale(self.constant * inverse / square, field))


def _newton(change: Array, mean: Array, sine_part: Array, cosine_part: Array) -> Array:
    """One Newton step on Kepler's equation for the change of eccentric anomaly since t = 0."""
    s, c = jnp.sin(change), jnp.cos(change)
    residual = change - cosine_part * s + sine_part * (1 - c) - mean
    return change - residual / (1 - cosine_part * c + sine_part * s)
