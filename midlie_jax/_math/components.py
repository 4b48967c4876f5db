"""Vectors and quaternions as tuples of scalars: the arithmetic of every step.

XLA fuses a step written on scalars into one loop over the batch; the same step written on (3,) arrays runs 10 to 40
times slower on a CPU. `Vector` is (x, y, z), `Quaternion` is (w, x, y, z); under `vmap` a component becomes a (batch,)
array.
"""

import operator
from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._xla.internals import Tracer

Vector = tuple[Array, Array, Array]
Quaternion = tuple[Array, Array, Array, Array]
Columns = tuple[Vector, Vector, Vector]  # the columns of a 3x3 matrix


def vector(array: Array) -> Vector:
    """The components of an array (..., 3)."""
    return array[..., 0], array[..., 1], array[..., 2]


def quaternion(array: Array) -> Quaternion:
    """The components of an array (..., 4)."""
    return array[..., 0], array[..., 1], array[..., 2], array[..., 3]


def pack(entries: tuple[Array, ...]) -> Array:
    """Components as one array, along a new last axis: the inverse of `vector` and of `quaternion`."""
    return jnp.stack(entries, axis=-1)


def _is_components(leaf: Any) -> bool:
    return type(leaf) is tuple and bool(leaf) and not isinstance(leaf[0], tuple)


def packed(tree: Any) -> Any:
    """A tree with each vector and quaternion as one array; other leaves are unchanged."""
    return wrapped(tree, pack)


def unpacked(tree: Any) -> Any:
    """A tree with each array as its components along the last axis: the inverse of `packed`."""
    return jax.tree.map(lambda x: tuple(x[..., i] for i in range(x.shape[-1])), tree)


def wrapped(tree: Any, wrap: Callable[[Any], Any]) -> Any:
    """A tree with `wrap(leaf)` in place of each vector and quaternion."""
    return jax.tree.map(lambda x: wrap(x) if _is_components(x) else x, tree, is_leaf=_is_components)


def flat(tree: Any) -> Array:
    """All numbers of a tree as one array."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])


def of_flat(numbers: Array, like: Any) -> Any:
    """The inverse of `flat`: a tree with these numbers and the structure and shapes of `like`."""
    leaves, structure = jax.tree.flatten(like)
    ends = np.cumsum([np.size(leaf) for leaf in leaves])
    pairs = zip(leaves, ends, strict=True)
    return structure.unflatten([numbers[end - np.size(leaf) : end].reshape(jnp.shape(leaf)) for leaf, end in pairs])


def add(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(c: Array | float | int, a: Vector) -> Vector:
    return (c * a[0], c * a[1], c * a[2])


def times(a: Vector, b: Vector) -> Vector:
    """The product of each pair of components: a diagonal matrix times a vector."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


def others(a: Vector) -> Vector:
    """The products of the two other components."""
    return a[1] * a[2], a[2] * a[0], a[0] * a[1]


def dot(a: Vector, b: Vector) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def where(mask: Array, a: Vector, b: Vector) -> Vector:
    return jnp.where(mask, a[0], b[0]), jnp.where(mask, a[1], b[1]), jnp.where(mask, a[2], b[2])


def norm(a: Vector) -> Array:
    """|a|, whose derivative at a = 0 is defined as zero."""
    return root(dot(a, a))


def root(square: Array) -> Array:
    """The square root, whose derivative at zero is defined as zero."""
    nonzero = square > 0
    return jnp.where(nonzero, jnp.sqrt(jnp.where(nonzero, square, jnp.ones_like(square))), jnp.zeros_like(square))


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


def columns(q: Quaternion) -> Columns:
    """The columns of the rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z),
    )


def square(q: Quaternion) -> Quaternion:
    """q q, the rotation q applied twice."""
    double = 2 * q[0]
    return (q[0] * q[0] - q[1] * q[1] - q[2] * q[2] - q[3] * q[3], double * q[1], double * q[2], double * q[3])


def rotation_change(q: Quaternion, v: Vector) -> Vector:
    """q v q* - v for a unit quaternion q; a rounding error in the length of q is corrected to first order."""
    change = unit_rotation_change(q, v)
    return add(change, scale(norm_defect(q), change))


def unit_rotation_change(q: Quaternion, v: Vector) -> Vector:
    """q v q* - v for a unit quaternion q, without correction of its length; shorter, if no error accumulates."""
    u = (q[1], q[2], q[3])
    t = scale(2, cross(u, v))
    return add(scale(q[0], t), cross(u, t))


def norm_defect(q: Quaternion) -> Array:
    """1 - |q|^2 for a quaternion of length 1 up to rounding; (1 - w) (1 + w) avoids the cancellation in 1 - w^2."""
    return (1 - q[0]) * (1 + q[0]) - dot((q[1], q[2], q[3]), (q[1], q[2], q[3]))


def rotate(q: Quaternion, v: Vector) -> Vector:
    """q v q* for a unit quaternion q."""
    return add(v, rotation_change(q, v))


def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """q* v q for a unit quaternion q."""
    return rotate(conjugate(q), v)


def multiply_about(q: Quaternion, axis: int, cosine: Array, sine: Array) -> Quaternion:
    """The product q (cosine + sine e_axis), with half as many multiplications as `multiply`."""
    j, k = (axis + 1) % 3 + 1, (axis + 2) % 3 + 1
    result = [cosine * part for part in q]
    result[0] = result[0] - sine * q[axis + 1]
    result[axis + 1] = result[axis + 1] + sine * q[0]
    result[j] = result[j] + sine * q[k]
    result[k] = result[k] - sine * q[j]
    return (result[0], result[1], result[2], result[3])


def rotate_back_about(axis: int, cosine: Array, sine: Array, v: Vector) -> Vector:
    """q* v q for the unit quaternion q = cosine + sine e_axis: v in components of the rotated frame."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    double = 2 * sine
    result = list(v)
    result[j] = v[j] + double * (cosine * v[k] - sine * v[j])
    result[k] = v[k] - double * (cosine * v[j] + sine * v[k])
    return (result[0], result[1], result[2])


def rotation_change_about(axis: int, cosine: Array, sine: Array, v: Vector) -> Vector:
    """rotate_back_about(axis, cosine, sine, v) - v, for a vector that rotates at every step by a similar angle.

    It is a product of three shears, which preserve areas even though their coefficients are rounded. A rotation matrix
    with rounded entries would change the length of v by the same factor at every step.
    """
    j, k = (axis + 1) % 3, (axis + 2) % 3
    tangent, double = sine * reciprocal(cosine), 2 * sine * cosine
    first = tangent * v[k]
    result = [0 * part for part in v]
    # The changes by earlier shears are separate terms; adding them to v first would round them.
    result[k] = -double * v[j] - double * first
    result[j] = 2 * first + tangent * result[k]
    return (result[0], result[1], result[2])


def tree_add(x: Any, change: Any) -> Any:
    return jax.tree.map(operator.add, x, change)


def compensated(x: Any, low: Any, change: Any) -> tuple[Any, Any]:
    """x + low + change for tuples of numbers, rounded to nearest, and the rounding errors: the next low parts.

    If |low| is at most half a unit in the last place of x, a change of zero changes neither. Each rounding error takes
    six additions (D. E. Knuth, The Art of Computer Programming 2, section 4.2.2).
    """

    def two_sum(x: Array, change: Array) -> tuple[Array, Array]:
        total = x + change
        added = total - x
        return total, (x - (total - added)) + (change - added)

    pairs = [two_sum(a, b + c) for a, b, c in zip(x, low, change, strict=True)]
    return tuple(total for total, _ in pairs), tuple(error for _, error in pairs)


def all_finite(tree: Any, axes: int = 0) -> Array:
    """Whether all numbers of a pytree are finite, for each index along the first `axes` axes of its arrays."""
    leaves = (jnp.isfinite(jax.lax.stop_gradient(leaf)) for leaf in jax.tree.leaves(tree))
    return reduce(jnp.logical_and, (jnp.all(leaf, axis=tuple(range(axes, leaf.ndim))) for leaf in leaves))


def largest(a: Vector) -> Array:
    """The largest magnitude of the three components; NaN if any component is NaN."""
    return jnp.maximum(jnp.maximum(jnp.abs(a[0]), jnp.abs(a[1])), jnp.abs(a[2]))


class Inverse3(NamedTuple):
    """The inverse of a 3x3 matrix: the rows of its adjugate, and the reciprocal of its determinant."""

    rows: tuple[Vector, Vector, Vector]
    factor: Array

    @classmethod
    def of(cls, columns: Columns, exact: bool = True) -> "Inverse3":
        """The inverse; with `exact` False it has five correct digits, enough for an iteration that corrects itself."""
        a, b, c = columns
        rows = cross(b, c), cross(c, a), cross(a, b)
        determinant = dot(a, rows[0])
        return cls(rows, reciprocal(determinant) if exact else rough_reciprocal(determinant))

    def times(self, right: Vector) -> Vector:
        """The inverse matrix times a vector."""
        a, b, c = self.rows
        return self.factor * dot(a, right), self.factor * dot(b, right), self.factor * dot(c, right)


# (integer dtype, constant, Newton steps). The bits of 1/x are approximately the constant minus the bits of x, read as
# integers: a first guess with a relative error of 5 %.
_RECIPROCAL = {"float64": (jnp.int64, 0x7FDE623822FC16E6, 2), "float32": (jnp.int32, 0x7EF311C7, 1)}


def rough_reciprocal(x: Array) -> Array:
    """1/x to five digits, computed like `reciprocal`. It must not be differentiated."""
    integer, magic, _ = _RECIPROCAL[str(x.dtype)]
    bits = jax.lax.bitcast_convert_type(jnp.abs(x), integer)
    guess = jnp.copysign(jax.lax.bitcast_convert_type(jnp.asarray(magic, integer) - bits, x.dtype), x)
    # 1/x = guess (1 + e) (1 + e^2) ... with e = 1 - x guess. Unlike in two Newton steps, e^2 does not depend on the
    # first factor.
    error = 1 - x * guess
    guess = guess + guess * error
    return guess + guess * (error * error)


@jax.custom_jvp
def reciprocal(x: Array) -> Array:
    """1/x to one or two units in the last place. Wrong at zero and near underflow and overflow.

    XLA does not fuse a division whose result is used more than once: it would split the loop of a step into hundreds.
    """
    guess = rough_reciprocal(x)
    for _ in range(_RECIPROCAL[str(x.dtype)][2]):
        guess = guess + guess * (1 - x * guess)
    return guess


@reciprocal.defjvp
def _reciprocal_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    result = reciprocal(*primals)
    return result, -result * result * tangents[0]


# (integer dtype, constant, Newton steps): the bits of 1/sqrt(x) are approximately the constant minus half the bits of
# x.
_ROOT = {"float64": (jnp.int64, 0x5FE6EB50C7B537A9, 4), "float32": (jnp.int32, 0x5F375A86, 3)}


@jax.custom_jvp
def inverse_root(x: Array) -> Array:
    """1/sqrt(x) to one or two units in the last place for normal x > 0; like `reciprocal`, it avoids a division."""
    integer, magic, steps = _ROOT[str(x.dtype)]
    bits = jax.lax.bitcast_convert_type(x, integer)
    guess = jax.lax.bitcast_convert_type(jnp.asarray(magic, integer) - (bits >> 1), x.dtype)
    for _ in range(steps):
        guess = guess + guess * (0.5 - 0.5 * x * guess * guess)  # a small correction, so that x = 1 gives exactly 1
    return guess


@inverse_root.defjvp
def _inverse_root_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    result = inverse_root(*primals)
    return result, -0.5 * result * result * result * tangents[0]


def fast_root(x: Array) -> Array:
    """The square root of a normal x > 0 by `inverse_root`."""
    return x * inverse_root(x)


def cayley(turn: Vector) -> Quaternion:
    """(1 - w^/2)^-1 (1 + w^/2) as a unit quaternion, for the vector w."""
    x, y, z = scale(0.5, turn)
    factor = inverse_root(1 + x * x + y * y + z * z)
    return factor, factor * x, factor * y, factor * z


def normalised(q: Quaternion) -> Quaternion:
    """q / |q|, for a quaternion of any nonzero length."""
    factor = inverse_root(q[0] * q[0] + dot(q[1:], q[1:]))
    return factor * q[0], factor * q[1], factor * q[2], factor * q[3]


def polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    """The polynomial with these coefficients, lowest first, by Estrin's scheme."""
    terms: list[Any] = list(coefficients)
    while len(terms) > 1:
        pairs = zip(terms[0::2], terms[1::2], strict=False)
        terms, odd = [a + b * x for a, b in pairs], terms[-1:] if len(terms) % 2 else []
        terms += odd
        x = x * x if len(terms) > 1 else x
    return terms[0]


def epsilon(x: Array) -> float:
    """The spacing of the array's dtype at 1."""
    return float(jnp.finfo(x.dtype).eps)


def is_traced(*values: object) -> bool:
    """Whether any leaf of the values is a tracer, without concrete numbers."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
