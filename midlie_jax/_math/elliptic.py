"""Jacobi's elliptic functions at long arguments by doubling, with the angle of an elliptic integral of the third kind.

All formulas hold for every parameter 0 <= m <= 1. It is passed with its complement m1 = 1 - m, because 1 - m would lose
the digits of m1 near m = 1. On the real axis dn >= |cn|, so all quotients below by dn are small.

With z = x + y and a characteristic -n <= 0, the integral G(u) of 1 / (1 + n sn^2 u) has the addition theorem

    G(z) - G(x) - G(y) = -(1/k) arctan(n k sn x sn y sn z / (1 + n (1 - cn x cn y cn z))),    n k = root

where root = sqrt((1 + n) n (n + m)). The denominator is at least 1, so half the angle has no jumps.

NIST Digital Library of Mathematical Functions, 19.8, 19.11, 22.6, 22.8 and 22.20; R. Bulirsch, Numer. Math. 13 (1969)
305.
"""

from math import pi
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from . import components as cp

Complex = tuple[Array, Array]  # a positive multiple of the cosine and the sine of an angle


class Point(NamedTuple):
    """sn, cn and dn at one argument, and 1 / dn."""

    sn: Array
    cn: Array
    dn: Array
    per_dn: Array


class Modulus(NamedTuple):
    """The parameter m and its complement m1 = 1 - m, which is 0 or at least `smallest_complement`."""

    m: Array
    m1: Array

    def point(self, sn: Array, cn: Array) -> Point:
        """The point with these sn and cn, up to a common factor near 1.

        At m1 = 0, where cn and dn decay to zero, cn has a small lower bound, so that no power of 1 / dn overflows.
        """
        factor = cp.inverse_root(sn * sn + cn * cn)
        sn, cn = factor * sn, factor * cn
        smallest = jnp.asarray(smallest_complement(cn) ** 0.5, cn.dtype)
        cn = jnp.where((self.m1 == 0) & (jnp.abs(cn) < smallest), smallest, cn)
        square = self.m1 + self.m * cn * cn
        per_dn = cp.inverse_root(square)
        return Point(sn, cn, square * per_dn, per_dn)

    def doubled(self, p: Point) -> Point:
        ratio, slope = p.cn * p.per_dn, p.sn * p.per_dn
        return self.point(2 * p.sn * ratio, p.cn * p.cn - self.m1 * slope * slope)


def smallest_complement(like: Array) -> float:
    """The smallest m1 > 0: neither it nor its inverse leaves the range of normal numbers."""
    return 16 * float(jnp.finfo(like.dtype).tiny)


def half_angle_of(above: Array, below: Array) -> Complex:
    """Half of arctan(above / below) in the addition theorem of the module docstring, with below at least 1."""
    square = above * above + below * below
    return cp.fast_root(square) + below, above


def product(a: Complex, b: Complex) -> Complex:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def normalised(a: Complex) -> Complex:
    factor = cp.inverse_root(a[0] * a[0] + a[1] * a[1])
    return factor * a[0], factor * a[1]


_STEPS = 10  # enough for m1 down to 1e-60


def complete(m1: Array, p: Array) -> Array:
    """The integral of 1 / ((cos^2 + p sin^2) sqrt(cos^2 + m1 sin^2)) over a quarter turn, for m1 > 0 and p > 0: K for
    p = 1, and Pi(n, m) for p = 1 - n.
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
