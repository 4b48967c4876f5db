"""Kepler's equation in universal variables: one formula for ellipses, parabolas and hyperbolas, without branches.

Lengths are in units of the distance of the periapsis q, times in units of sqrt(q^3 / mu). With alpha = 1/a = 1 - e, the
universal variable s replaces the anomaly: dt = r ds. The functions U_k(s) = s^k c_k(alpha s^2) have Stumpff's c_k.
After the first guess there is no division, at which XLA would end a loop.

R. H. Battin, An Introduction to the Mathematics and Methods of Astrodynamics (1999), sections 4.5 and 4.6.
"""

from math import factorial
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from . import components as cp

_HALVINGS = 4
_TERMS = {"float64": 13, "float32": 8}  # for |alpha s^2| up to (2.5 x 2^4)^2: a hyperbola out to 1e17 distances
_BY_LOGARITHM = 1.5  # above this anomaly of a hyperbola the first guess is a logarithm


class Powers(NamedTuple):
    """U_0, U_1, U_2, U_3 at one s. Each is the derivative of the next; U_0 = 1 - alpha U_2."""

    u0: Array
    u1: Array
    u2: Array
    u3: Array


def powers(alpha: Array, s: Array) -> Powers:
    """The functions U_k at s: short series for s / 16, doubled four times.

    For negative alpha the relative error equals the error of s; on an ellipse it is a few eps of 1 / sqrt(alpha)^k.
    """
    short = s / 2**_HALVINGS
    square = short * short
    x = -alpha * square
    count = _TERMS[str(x.dtype)]
    c2 = cp.polynomial(tuple(1 / factorial(2 * k + 2) for k in range(count)), x)
    c3 = cp.polynomial(tuple(1 / factorial(2 * k + 3) for k in range(count)), x)
    u1, u2, u3 = short * (1 + x * c3), square * c2, short * square * c3
    u0 = 1 - alpha * u2
    for _ in range(_HALVINGS):
        u3 = 2 * (u3 + u1 * u2)
        u1, u2 = 2 * u0 * u1, 2 * u1 * u1
        u0 = 1 - alpha * u2
    return Powers(u0, u1, u2, u3)


class Place(NamedTuple):
    """A position on an orbit, the origin of s: the distance r, and sigma = r . v, both in the units of this module."""

    alpha: Array
    r: Array
    sigma: Array

    def time(self, u: Powers) -> Array:
        """The time from here, Kepler's equation: r U_1 + sigma U_2 + U_3."""
        return self.r * u.u1 + self.sigma * u.u2 + u.u3

    def slopes(self, u: Powers) -> tuple[Array, Array, Array]:
        """The first three derivatives of the time with respect to s; the first is the distance there."""
        rest = 1 - self.alpha * self.r
        first = self.r * u.u0 + self.sigma * u.u1 + u.u2
        return first, self.sigma * u.u0 + rest * u.u1, rest * u.u0 - self.alpha * self.sigma * u.u1

    def first_correction(self, u: Powers, time: Array) -> Array:
        """The change of s by a step of fourth order (Householder's), for an s that may be 15 % off."""
        first, second, third = self.slopes(u)
        lack = time - self.time(u)
        d = lack * cp.reciprocal(first)
        d = lack * cp.reciprocal(first + d * second / 2)
        return lack * cp.reciprocal(first + d * (second / 2 + d * third / 6))

    def last_correction(self, u: Powers, time: Array) -> Array:
        """The change of s by the reversed series of fourth order, for an s close to the root; also its derivatives up
        to the third, if s is the root without derivatives.
        """
        first, second, third = self.slopes(u)
        inverse = cp.reciprocal(first)
        d = (time - self.time(u)) * inverse
        a, b = second * inverse / 2, third * inverse / 6
        return d * (1 - d * (a - d * (2 * a * a - b)))


def moved(alpha: Array, u: Powers, d: Array) -> Powers:
    """The functions at s + d for a small d, by Taylor's series up to d^3."""
    half, sixth = d * d / 2, d * d * d / 6
    less = -alpha * u.u1  # dU_0/ds
    u0 = u.u0 + d * less - alpha * (half * u.u0 + sixth * less)
    u1 = u.u1 + d * u.u0 + half * less - alpha * sixth * u.u0
    u2 = u.u2 + d * u.u1 + half * u.u0 + sixth * less
    u3 = u.u3 + d * u.u2 + half * u.u1 + sixth * u.u0
    return Powers(u0, u1, u2, u3)


def first_guess(alpha: Array, eccentricity: Array, time: Array) -> Array:
    """s from the time since the periapsis, to 15 % for every eccentricity; for an ellipse within half a period.

    Near the periapsis, and on a parabola everywhere, time = s + e s^3 / 6. Far out on a hyperbola s is a logarithm.
    """
    duration = jnp.abs(time)
    x = eccentricity * duration * duration / 6
    # s = duration h with h + x h^3 = 1: a guess, and a Newton step.
    h = (1 + x + 2 * x / (1 + x)) ** (-1 / 3)
    square = x * h * h
    h = (1 + 2 * square * h) / (1 + 3 * square)
    s = duration * h
    small = jnp.finfo(s.dtype).tiny ** 0.25
    root = jnp.sqrt(jnp.maximum(-alpha, small))
    anomaly = root * s
    sine = (root * root * root * duration + anomaly) / jnp.maximum(eccentricity, small)
    far = (alpha < 0) & (anomaly > _BY_LOGARITHM)
    s = jnp.where(far, jnp.log(sine + jnp.sqrt(sine * sine + 1)) / root, s)
    return jnp.where(time < 0, -s, s)
