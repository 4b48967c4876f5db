"""Complete elliptic integrals, the amplitude and its inverse, by arithmetic-geometric means with a fixed number of steps.

All take the complement m1 = 1 - m of the parameter, which keeps its digits near m = 1. They can be differentiated, and
work element by element.

NIST Digital Library of Mathematical Functions, 19.8 and 22.20; R. Bulirsch, "Numerical calculation of elliptic integrals
and elliptic functions III", Numer. Math. 13 (1969) 305.
"""

from math import pi

import jax.numpy as jnp
from jax import Array

_STEPS = 10  # enough for m1 down to 1e-60


def complete(m1: Array, p: Array) -> Array:
    """The integral of 1 / ((cos^2 + p sin^2) sqrt(cos^2 + m1 sin^2)) over a quarter turn: K for p = 1, for 1 - n Pi(n, m).

    Args:
        m1: above 0.
        p: above 0.
    """
    kc = jnp.sqrt(m1)
    a, p = jnp.ones_like(kc), jnp.sqrt(p)
    b, e, m = 1 / p, kc, jnp.ones_like(kc)
    for _ in range(_STEPS):
        g = e / p
        a, b = a + b / p, 2 * (b + a * g)
        p, m = p + g, m + kc
        kc = 2 * jnp.sqrt(e)
        e = kc * m
    return pi / 2 * (b + a * m) / (m * (m + p))


def amplitude(m1: Array, fraction: Array) -> Array:
    """am(4 K fraction), the angle whose sine is sn; over one period, for a fraction from -1/2 to 1/2, it is odd."""
    ratios = []
    a, b = jnp.ones_like(m1), jnp.sqrt(m1)
    for _ in range(_STEPS):
        a, b, c = (a + b) / 2, jnp.sqrt(a * b), (a - b) / 2
        ratios.append(c / a)
    angle = 2 * pi * fraction * 2**_STEPS
    for ratio in reversed(ratios):
        angle = (angle + jnp.arcsin(ratio * jnp.sin(angle))) / 2
    return angle


def fraction_of(m1: Array, angle: Array) -> Array:
    """The inverse of `amplitude`: F(angle) / 4 K, for an angle of any size."""
    a, b = jnp.ones_like(m1), jnp.sqrt(m1)
    for _ in range(_STEPS):
        s, c = jnp.sin(angle), jnp.cos(angle)
        # The next angle has (tan next - angle) = b/a tan(angle), on the branch of the angle itself.
        angle = 2 * angle + jnp.arctan2((b - a) * s * c, a * c * c + b * s * s)
        a, b = (a + b) / 2, jnp.sqrt(a * b)
    return angle / (2 * pi * 2**_STEPS)
