"""Complete elliptic integrals, the amplitude and its inverse, by arithmetic-geometric means in a fixed number of steps.

All functions accept the complement m1 = 1 - m of the parameter, which keeps its digits near m = 1. They are
differentiable and work elementwise.

NIST Digital Library of Mathematical Functions, 19.8 and 22.20; R. Bulirsch, "Numerical calculation of elliptic
integrals and elliptic functions III", Numer. Math. 13 (1969) 305.
"""

from math import pi
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

_STEPS = 10  # enough for m1 down to 1e-60


def complete(m1: Array, p: Array) -> Array:
    """The integral of 1 / ((cos^2 + p sin^2) sqrt(cos^2 + m1 sin^2)) over a quarter turn.

    It is K for p = 1, and Pi(n, m) for p = 1 - n.

    Args:
        m1: above 0.
        p: above 0.
    """
    kc = jnp.sqrt(m1)
    p = jnp.sqrt(p)
    one = jnp.ones_like(kc * p)

    def step(carry: Any, _: None) -> tuple[Any, None]:
        a, b, p, m, kc, e = carry
        g = e / p
        a, b = a + b / p, 2 * (b + a * g)
        p, m = p + g, m + kc
        kc = 2 * jnp.sqrt(e)
        return (a, b, p, m, kc, kc * m), None

    # A loop, because XLA repeats values that are used twice in an unrolled expression.
    start = one, one / p, one * p, one, one * kc, one * kc
    (a, b, p, m, _, _), _ = jax.lax.scan(step, start, length=_STEPS)
    return pi / 2 * (b + a * m) / (m * (m + p))


def amplitude(m1: Array, fraction: Array) -> Array:
    """am(4 K fraction), the angle whose sine is sn; over one period, for a fraction from -1/2 to 1/2, it is odd."""

    def down(carry: Any, _: None) -> tuple[Any, Array]:
        a, b = carry
        mean = (a + b) / 2
        return (mean, jnp.sqrt(a * b)), (a - b) / (2 * mean)

    def up(angle: Array, ratio: Array) -> tuple[Array, None]:
        return (angle + jnp.arcsin(ratio * jnp.sin(angle))) / 2, None

    _, ratios = jax.lax.scan(down, (jnp.ones_like(m1), jnp.sqrt(m1)), length=_STEPS)
    last = 2 * pi * 2**_STEPS * fraction * jnp.ones_like(m1)
    return jax.lax.scan(up, last, ratios, reverse=True)[0]


def fraction_of(m1: Array, angle: Array) -> Array:
    """The inverse of `amplitude`: F(angle) / 4 K, for any angle."""

    def step(carry: Any, _: None) -> tuple[Any, None]:
        a, b, angle = carry
        s, c = jnp.sin(angle), jnp.cos(angle)
        # The next angle has tan(next - angle) = b/a tan(angle), on the branch of the angle.
        angle = 2 * angle + jnp.arctan2((b - a) * s * c, a * c * c + b * s * s)
        return ((a + b) / 2, jnp.sqrt(a * b), angle), None

    start = jnp.ones_like(m1), jnp.sqrt(m1), angle * jnp.ones_like(m1)
    return jax.lax.scan(step, start, length=_STEPS)[0][2] / (2 * pi * 2**_STEPS)
