"""Vectors and quaternions as tuples of scalars: the arithmetic that every step is written in.

XLA fuses a step written on scalars into one loop over the batch; the same step written on (3,) arrays with
stacking and matrix products runs 10 to 40 times slower on a CPU. So the arrays of the public interface are
taken apart once (`vector`, `quaternion`), the step is done here, and the arrays are put together again (`pack`).

`Vector` is (x, y, z), `Quaternion` is (w, x, y, z). Every entry is a scalar, or under `vmap` one (batch,) array.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

Vector = tuple[Array, Array, Array]
Quaternion = tuple[Array, Array, Array, Array]
Columns = tuple[Vector, Vector, Vector]  # of a 3x3 matrix


def vector(array: Array) -> Vector:
    """The three entries of the last axis."""
    return array[..., 0], array[..., 1], array[..., 2]


def quaternion(array: Array) -> Quaternion:
    """The four entries of the last axis."""
    return array[..., 0], array[..., 1], array[..., 2], array[..., 3]


def pack(entries: tuple[Array, ...]) -> Array:
    """One array of the entries, along a new last axis: the inverse of `vector` and of `quaternion`."""
    return jnp.stack(entries, axis=-1)


def add(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(c: Array | float | int, a: Vector) -> Vector:
    return (c * a[0], c * a[1], c * a[2])


def times(a: Vector, b: Vector) -> Vector:
    """Entry by entry: a diagonal matrix on a vector."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


def dot(a: Vector, b: Vector) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def norm(a: Vector) -> Array:
    """|a|, with the derivative zero at zero."""
    square = dot(a, a)
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, jnp.ones_like(square))), jnp.zeros_like(square))


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


def square(q: Quaternion) -> Quaternion:
    """q q: the same rotation twice."""
    double = 2 * q[0]
    return (q[0] * q[0] - q[1] * q[1] - q[2] * q[2] - q[3] * q[3], double * q[1], double * q[2], double * q[3])


def rotation_change(q: Quaternion, v: Vector) -> Vector:
    """q v q* - v for a quaternion q whose length is 1 but for rounding, which to first order does not count."""
    u = (q[1], q[2], q[3])
    t = scale(2, cross(u, v))
    change = add(scale(q[0], t), cross(u, t))
    return add(change, scale(missing(q), change))


def missing(q: Quaternion) -> Array:
    """1 - |q|^2, which is 0 but for rounding, without the cancellation of a sum of squares that is nearly 1."""
    return (1 - q[0]) * (1 + q[0]) - dot((q[1], q[2], q[3]), (q[1], q[2], q[3]))


def rotate(q: Quaternion, v: Vector) -> Vector:
    """q v q* for a unit quaternion q."""
    return add(v, rotation_change(q, v))


def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """q* v q for a unit quaternion q."""
    return rotate(conjugate(q), v)


def multiply_about(q: Quaternion, axis: int, cosine: Array, sine: Array) -> Quaternion:
    """q (cosine + sine e_axis): half of the products of `multiply`."""
    j, k = (axis + 1) % 3 + 1, (axis + 2) % 3 + 1
    result = [cosine * part for part in q]
    result[0] = result[0] - sine * q[axis + 1]
    result[axis + 1] = result[axis + 1] + sine * q[0]
    result[j] = result[j] + sine * q[k]
    result[k] = result[k] - sine * q[j]
    return (result[0], result[1], result[2], result[3])


def rotate_back_about(axis: int, cosine: Array, sine: Array, v: Vector) -> Vector:
    """v seen from a frame turned by (cosine + sine e_axis) as a unit quaternion."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    double = 2 * sine
    result = list(v)
    result[j] = v[j] + double * (cosine * v[k] - sine * v[j])
    result[k] = v[k] - double * (cosine * v[j] + sine * v[k])
    return (result[0], result[1], result[2])


def rotation_change_about(axis: int, cosine: Array, sine: Array, v: Vector) -> Vector:
    """What `rotate_back_about` adds to v, for a vector that is turned at every step, perhaps always by the same angle.

    By three shears, which keep areas whatever the rounding of their coefficients. A rotation matrix that is wrong in
    its last place would change the length of v by the same share at every step.
    """
    j, k = (axis + 1) % 3, (axis + 2) % 3
    tangent, double = sine * reciprocal(cosine), 2 * sine * cosine
    first = tangent * v[k]
    result = [0 * part for part in v]
    # Each shear takes up what those before it have added as a term of its own, which a sum with v would round off.
    result[k] = -double * v[j] - double * first
    result[j] = 2 * first + tangent * result[k]
    return (result[0], result[1], result[2])


# Multiplied by these, as integers, the bits of a float32 become numbers that depend on the significand alone (the
# factors are multiples of 2^9, which drops sign and exponent) and differ much where it differs little.
_SHUFFLES = tuple(np.uint32(n << 9 & 0xFFFFFFFF).view(np.int32) for n in (0x9E3779B1, 0x85EBCA77))
_MIX = np.uint32(0x85EBCA6B).view(np.int32)  # this and the two above: of MurmurHash3 and xxHash, A. Appleby, Y. Collet
_EXPONENT = np.int32(0x7F800000)


def accumulate(x: Any, change: Any, t: Array) -> Any:
    """x + change, of numbers or tuples of numbers, where x takes up a small change at every step, this one at time t.

    In float32 the last place is rounded up or down at random, with the probability that makes the mean right
    (stochastic rounding; Croci et al., R. Soc. Open Sci. 9 (2022) 211631). A slow motion changes x by nearly the same
    amount at every step, and rounding to the nearest would err in the same direction thousands of times in a row. The
    bits of the change and of the time are the source of chance, so that equal arguments give equal results. The time is
    mixed in because equal changes, those of a constant torque for one, would otherwise always be rounded the same way.
    A change of zero changes nothing.

    float64 needs no such help: above 1e-6 radians a step, successive changes differ by more than the last place of x.
    """
    return jax.tree.map(lambda x, change: _accumulate(x, change, t), x, change)


def _accumulate(x: Array, change: Array, t: Array) -> Array:
    if x.dtype != "float32":
        return x + change
    shuffled = (
        jax.lax.bitcast_convert_type(y.astype(x.dtype), jnp.int32) * factor
        for y, factor in zip((change, t), _SHUFFLES, strict=True)
    )
    bits = sum(shuffled)
    # In a steady motion the bits grow evenly, and might keep step with what is rounded but for their upper half.
    mixed = (bits ^ jax.lax.shift_right_logical(bits, np.int32(16))) * _MIX
    chance = mixed.astype(x.dtype) * 2.0**-55  # within half a unit in the last place of a number from 1 to 2
    chance = jnp.where(change == 0, jnp.zeros_like(chance), chance)
    power = jax.lax.bitcast_convert_type(jax.lax.bitcast_convert_type(x, jnp.int32) & _EXPONENT, x.dtype)
    return x + (change + chance * power)


def largest(a: Vector) -> Array:
    """The largest magnitude among three numbers; NaN where one is NaN."""
    return jnp.maximum(jnp.maximum(jnp.abs(a[0]), jnp.abs(a[1])), jnp.abs(a[2]))


class Inverse3(NamedTuple):
    """The inverse of a 3x3 matrix: the rows of its adjugate, and one over its determinant."""

    rows: tuple[Vector, Vector, Vector]
    factor: Array

    @classmethod
    def of(cls, columns: Columns, exact: bool = True) -> "Inverse3":
        """Unless exact, to five digits: enough for an iteration that corrects itself."""
        a, b, c = columns
        rows = cross(b, c), cross(c, a), cross(a, b)
        determinant = dot(a, rows[0])
        return cls(rows, reciprocal(determinant) if exact else rough_reciprocal(determinant))

    def times(self, right: Vector) -> Vector:
        a, b, c = self.rows
        return self.factor * dot(a, right), self.factor * dot(b, right), self.factor * dot(c, right)


# The bits of 1/x are nearly these less the bits of x: a guess with a relative error of 5 %.
_RECIPROCAL = {"float64": (jnp.int64, 0x7FDE623822FC16E6, 2), "float32": (jnp.int32, 0x7EF311C7, 1)}


def rough_reciprocal(x: Array) -> Array:
    """1/x to five digits, in the way of `reciprocal`. Not to be differentiated."""
    integer, magic, _ = _RECIPROCAL[str(x.dtype)]
    bits = jax.lax.bitcast_convert_type(jnp.abs(x), integer)
    guess = jnp.copysign(jax.lax.bitcast_convert_type(jnp.asarray(magic, integer) - bits, x.dtype), x)
    # 1/x = guess (1 + e) (1 + e^2) ... with e = 1 - x guess: two factors wait less for each other than Newton's steps.
    error = 1 - x * guess
    guess = guess + guess * error
    return guess + guess * (error * error)


@jax.custom_jvp
def reciprocal(x: Array) -> Array:
    """1/x to a unit or two in the last place, without a division. Wrong at zero and near under- and overflow.

    XLA counts a division as too dear to repeat, and will not fuse it where its result is used more than once; one
    division would cut the step's single loop into hundreds.
    """
    guess = rough_reciprocal(x)
    for _ in range(_RECIPROCAL[str(x.dtype)][2]):
        guess = guess + guess * (1 - x * guess)
    return guess


@reciprocal.defjvp
def _reciprocal_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    result = reciprocal(*primals)
    return result, -result * result * tangents[0]


_ROOT = {"float64": (jnp.int64, 0x5FE6EB50C7B537A9, 4), "float32": (jnp.int32, 0x5F375A86, 3)}


@jax.custom_jvp
def inverse_root(x: Array) -> Array:
    """1/sqrt(x) to a unit or two in the last place for normal x > 0, in the same way and for the same reason."""
    integer, magic, steps = _ROOT[str(x.dtype)]
    bits = jax.lax.bitcast_convert_type(x, integer)
    guess = jax.lax.bitcast_convert_type(jnp.asarray(magic, integer) - (bits >> 1), x.dtype)
    for _ in range(steps):
        guess = guess + guess * (0.5 - 0.5 * x * guess * guess)  # as a correction, so that 1 has the root 1
    return guess


@inverse_root.defjvp
def _inverse_root_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    result = inverse_root(*primals)
    return result, -0.5 * result * result * result * tangents[0]


def polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    """Lowest coefficient first, by Estrin's rule: as many operations as Horner's, but not each waiting for the last."""
    terms: list[Any] = list(coefficients)
    while len(terms) > 1:
        pairs = zip(terms[0::2], terms[1::2], strict=False)
        terms, odd = [a + b * x for a, b in pairs], terms[-1:] if len(terms) % 2 else []
        terms += odd
        x = x * x if len(terms) > 1 else x
    return terms[0]


def epsilon(x: Array) -> float:
    return float(jnp.finfo(x.dtype).eps)


def is_traced(*values: object) -> bool:
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
