"""Jacobi's elliptic functions at long arguments by doubling, with the angle of an elliptic integral of the third kind.

`free_motion` begins with a short argument u and doubles it as often as needed. An error of the argument doubles with
it, so that the relative error of a long argument is that of the first one; this is what its rounding costs in any case.
All formulas hold for every parameter 0 <= m <= 1, which is passed with its complement m1 = 1 - m, because 1 - m would
lose the digits of m1 near m = 1. Neither periods nor an inverse function are needed, and m = 0 and m = 1 are not
special. On the real axis dn >= |cn|, so all quotients below by dn are small.

With z = x + y and a characteristic -n <= 0, the integral G(u) of 1 / (1 + n sn^2 u) has the addition theorem

    G(z) - G(x) - G(y) = -(1/k) arctan(n k sn x sn y sn z / (1 + n (1 - cn x cn y cn z))),    n k = root

where root = sqrt((1 + n) n (n + m)). The denominator is at least 1, so the arctangent never leaves its principal
branch, and half of the angle can be followed without a jump.

NIST Digital Library of Mathematical Functions, 19.11 and 22.6, 22.8.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

Complex = tuple[Array, Array]  # the cosine and the sine of an angle


class Point(NamedTuple):
    """sn, cn and dn at one argument."""

    sn: Array
    cn: Array
    dn: Array


class Modulus(NamedTuple):
    """The parameter m and its complement m1 = 1 - m."""

    m: Array
    m1: Array

    def point(self, sn: Array, cn: Array) -> Point:
        """The point with these sn and cn, both of which may have a common factor.

        At m1 = 0, where cn and dn decay for ever, cn stops at a small number, so that no quotient is 0 / 0.
        """
        length = jnp.hypot(sn, cn)
        sn, cn = sn / length, cn / length
        smallest = 4 * float(jnp.finfo(cn.dtype).tiny) ** 0.5
        cn = jnp.where((self.m1 == 0) & (jnp.abs(cn) < smallest), jnp.asarray(smallest, cn.dtype), cn)
        return Point(sn, cn, jnp.sqrt(self.m1 + self.m * cn * cn))

    def doubled(self, p: Point) -> Point:
        """The point at twice the argument."""
        ratio, slope = p.cn / p.dn, p.sn / p.dn
        return self.point(2 * p.sn * ratio, p.cn * p.cn - self.m1 * slope * slope)

    def sum(self, p: Point, q: Point) -> Point:
        """The point at the sum of the arguments of p and q, for a q that did not reach dn = 0."""
        a, b, ratio = p.cn / q.dn, p.dn / q.dn, q.cn / q.dn
        below = a * a + p.sn * p.sn
        sn = (p.sn * ratio + q.sn * a * b) / below
        cn = (a * ratio - p.sn * q.sn * b) / below
        return Point(sn, cn, (b - self.m * p.sn * q.sn * a * ratio) / below)


def half_addition_angle(n: Array, root: Array, x: Point, y: Point, z: Point) -> Complex:
    """The cosine and sine of half the arctangent in the addition theorem above; z is the sum of x and y."""
    above, below = root * x.sn * y.sn * z.sn, 1 + n * (1 - x.cn * y.cn * z.cn)
    along = jnp.hypot(above, below) + below
    length = jnp.hypot(along, above)
    return along / length, above / length


def product(a: Complex, b: Complex) -> Complex:
    """The cosine and sine of the sum of two angles; rounding errors of their length are not carried on."""
    x, y = a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]
    length = jnp.hypot(x, y)
    return x / length, y / length
