"""Vectors and quaternions as tuples of scalars: the arithmetic that every step is written in.

XLA fuses a step written on scalars into one loop over the batch; the same step written on (3,) arrays with
stacking and matrix products runs 10 to 40 times slower on a CPU. So the arrays of the public interface are
taken apart once (`unpack`), the step is done here, and the arrays are put together again (`pack`).

`Vector` is (x, y, z), `Quaternion` is (w, x, y, z). Every entry is a scalar, or under `vmap` one (batch,) array.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

Vector = tuple[Array, Array, Array]
Quaternion = tuple[Array, Array, Array, Array]


def unpack(array: Array) -> tuple[Array, ...]:
    """The entries of the last axis, as a tuple."""
    return tuple(array[..., i] for i in range(array.shape[-1]))


def pack(entries: tuple[Array, ...]) -> Array:
    """The inverse of `unpack`."""
    return jnp.stack(entries, axis=-1)


def add(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(c: Array | float, a: Vector) -> Vector:
    return (c * a[0], c * a[1], c * a[2])


def times(a: Vector, b: Vector) -> Vector:
    """Entry by entry: a diagonal matrix on a vector."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


def dot(a: Vector, b: Vector) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def conjugate(q: Quaternion) -> Quaternion:
    return (q[0], -q[1], -q[2], -q[3])


def rotate(q: Quaternion, v: Vector) -> Vector:
    """q v q* for a unit quaternion q."""
    u = (q[1], q[2], q[3])
    t = scale(2, cross(u, v))
    return add(add(v, scale(q[0], t)), cross(u, t))


def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """q* v q for a unit quaternion q."""
    return rotate(conjugate(q), v)


def normalize_once(q: Quaternion) -> Quaternion:
    """One Newton step towards |q| = 1: exact on (1, 0, 0, 0), and the norm's error is squared.

    Applied to the rotation of one step, it leaves rounding alone to accumulate over many.
    """
    square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    factor = 1.5 - 0.5 * square
    return (factor * q[0], factor * q[1], factor * q[2], factor * q[3])


def largest(a: Vector) -> Array:
    """The largest magnitude among three numbers; NaN where one is NaN."""
    return jnp.maximum(jnp.maximum(jnp.abs(a[0]), jnp.abs(a[1])), jnp.abs(a[2]))


def solve3(columns: tuple[Vector, Vector, Vector], right: Vector, reciprocal: Callable[[Array], Array]) -> Vector:
    """Solves a 3x3 system, given by its columns, by Cramer's rule with the given way to take 1/x."""
    a, b, c = columns
    bc = cross(b, c)
    inverse = reciprocal(dot(a, bc))
    return inverse * dot(right, bc), inverse * dot(right, cross(c, a)), inverse * dot(right, cross(a, b))


def exact_reciprocal(x: Array) -> Array:
    return 1 / x


# Bits of 1/x are nearly these minus the bits of x; relative error 12 %, squared by each Newton step below.
_RECIPROCAL_BITS = {"float64": (jnp.int64, 0x7FDE623822FC16E6, 3), "float32": (jnp.int32, 0x7EF311C7, 2)}


def rough_reciprocal(x: Array) -> Array:
    """1/x to a relative 4e-8 (float64) or 2e-4 (float32), without a division: for Newton steps, not for results.

    XLA counts a division as too dear to repeat, and then cuts the step's one loop wherever the quotient is used
    twice. This is cheap enough to be fused. Wrong (but finite) at zero and near overflow.
    """
    integer, magic, steps = _RECIPROCAL_BITS[str(x.dtype)]
    bits = jax.lax.bitcast_convert_type(jnp.abs(x), integer)
    guess = jnp.copysign(jax.lax.bitcast_convert_type(jnp.asarray(magic, integer) - bits, x.dtype), x)
    for _ in range(steps):
        guess = guess * (2 - x * guess)
    return guess


def polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    """Horner's rule, lowest coefficient first."""
    result = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        result = result * x + coefficient
    return result


def epsilon(x: Array) -> float:
    return float(jnp.finfo(x.dtype).eps)


def is_traced(*values: object) -> bool:
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))
