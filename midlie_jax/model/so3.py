"""Rotations: unit quaternions (w, x, y, z) and rotation vectors, as arrays with any leading batch axes.

This module depends on no other part of the model. All functions are smooth to second order at and near rotations by
zero and by pi, in float32 and float64. `exp(v)` is the rotation by |v| radians about v. An attitude q takes body
components to space components: `rotate(q, v_body) = v_space`.
"""

from collections.abc import Callable
from functools import partial
from math import factorial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._math import components as cp
from .._math.euler import angles_of, as_sequence

# With these numbers of terms, the series and their derivatives are exact to rounding below these arguments.
_SERIES_TERMS = 12
_SMALL_ANGLE_SQUARED = 1.0  # for sin(a)/a and similar functions of a^2
_SMALL_TANGENT_SQUARED = 0.04  # for atan(z)/z as a function of z^2
_BERNOULLI = (1 / 6, 1 / 30, 1 / 42, 1 / 30, 5 / 66, 691 / 2730, 7 / 6, 3617 / 510, 43867 / 798, 174611 / 330)


def _even(series: tuple[float, ...], closed_form: Callable[[Array], Array], x: Array) -> Array:
    use_series = x < _SMALL_ANGLE_SQUARED
    angle = jnp.sqrt(jnp.where(use_series, jnp.ones_like(x), x))
    return jnp.where(use_series, cp.polynomial(series, jnp.where(use_series, x, jnp.zeros_like(x))), closed_form(angle))


def _series(shift: int) -> tuple[float, ...]:
    return tuple((-1) ** n / factorial(2 * n + shift) for n in range(_SERIES_TERMS))


# Functions of x = a^2; `_cotangent` is (1 - (a/2) cot(a/2))/a^2.
_cosine = partial(_even, _series(0), jnp.cos)
_sinc = partial(_even, _series(1), lambda a: jnp.sin(a) / a)
_versine = partial(_even, _series(2), lambda a: 2 * (jnp.sin(a / 2) / a) ** 2)  # (1 - cos a)/a^2
_remainder = partial(_even, _series(3), lambda a: (a - jnp.sin(a)) / a**3)
_cotangent = partial(
    _even,
    tuple(b / factorial(2 * n + 2) for n, b in enumerate(_BERNOULLI)),
    lambda a: (1 - (a / 2) * jnp.cos(a / 2) / jnp.sin(a / 2)) / (a * a),
)


def exp(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 4"]:
    """The unit quaternion (..., 4) of the rotation by |vector| radians about `vector` (..., 3).

    Examples:
        >>> ml.so3.exp(jnp.array([0.0, 0.0, np.pi / 2])).round(4)  # a quarter about z
        Array([0.7071, 0.    , 0.    , 0.7071], dtype=float64)
    """
    v = cp.vector(vector)
    quarter = cp.dot(v, v) / 4
    s = _sinc(quarter) / 2
    return cp.pack((_cosine(quarter), s * v[0], s * v[1], s * v[2]))


def log(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3"]:
    """The rotation vector (..., 3) of a unit quaternion, of length at most pi radians; the same for q and -q.

    Examples:
        >>> ml.so3.log(jnp.array([np.cos(0.15), np.sin(0.15), 0.0, 0.0])).round(6)  # by 0.3 rad about x
        Array([0.3, 0. , 0. ], dtype=float64)
    """
    w, *rest = cp.quaternion(quaternion)
    u = (rest[0], rest[1], rest[2])
    sign = jnp.where(w < 0, -jnp.ones_like(w), jnp.ones_like(w))
    w = sign * w
    square = cp.dot(u, u)
    use_series = square < _SMALL_TANGENT_SQUARED * w * w
    safe_w = jnp.where(use_series, w, jnp.ones_like(w))
    safe_square = jnp.where(use_series, jnp.ones_like(square), square)
    series = tuple((-1) ** n / (2 * n + 1) for n in range(2 * _SERIES_TERMS))
    series_factor = cp.polynomial(series, jnp.where(use_series, square, jnp.zeros_like(square)) / safe_w**2) / safe_w
    norm = jnp.sqrt(safe_square)
    factor = 2 * sign * jnp.where(use_series, series_factor, jnp.arctan2(norm, w) / norm)
    return cp.pack((factor * u[0], factor * u[1], factor * u[2]))


def multiply(left: Float[Array, "*#batch 4"], right: Float[Array, "*#batch 4"]) -> Float[Array, "*#batch 4"]:
    """The rotation `right` followed by `left` (as matrices, left @ right).

    Examples:
        >>> ml.so3.multiply(jnp.array([0.8, 0.6, 0.0, 0.0]), jnp.array([0.8, 0.0, 0.6, 0.0])).round(4)
        Array([0.64, 0.48, 0.48, 0.36], dtype=float64)
    """
    return cp.pack(cp.multiply(cp.quaternion(left), cp.quaternion(right)))


def conjugate(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """The inverse of a unit quaternion.

    Examples:
        >>> ml.so3.conjugate(jnp.array([0.8, 0.6, 0.0, 0.0]))
        Array([ 0.8, -0.6, -0. , -0. ], dtype=float64)
    """
    return cp.pack(cp.conjugate(cp.quaternion(quaternion)))


def rotate(quaternion: Float[Array, "*#batch 4"], vector: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """The rotated vector. An attitude takes body components to space components.

    Examples:
        >>> ml.so3.rotate(jnp.array([0.8, 0.6, 0.0, 0.0]), jnp.array([0.0, 1.0, 0.0])).round(4)
        Array([0.  , 0.28, 0.96], dtype=float64)
    """
    return cp.pack(cp.rotate(cp.quaternion(quaternion), cp.vector(vector)))


def to_matrix(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """The rotation matrix (..., 3, 3) of a unit quaternion.

    Examples:
        >>> ml.so3.to_matrix(jnp.array([0.8, 0.6, 0.0, 0.0]))[1].round(4)
        Array([ 0.  ,  0.28, -0.96], dtype=float64)
    """
    w, x, y, z = cp.quaternion(quaternion)
    rows = (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
    return jnp.stack([cp.pack(row) for row in rows], axis=-2)


def from_matrix(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """The unit quaternion, w >= 0, of a rotation matrix.

    It uses the best conditioned of Shepperd's four formulas (S. W. Shepperd, J. Guid. Control 1 (1978) 223).

    Examples:
        >>> quarter = jnp.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # about x
        >>> ml.so3.from_matrix(quarter).round(4)
        Array([0.7071, 0.7071, 0.    , 0.    ], dtype=float64)
    """
    (a, b, c), (d, e, f), (g, h, i) = (cp.vector(matrix[..., row, :]) for row in range(3))
    # Row k is 4 q_k q, so its entry k is 4 q_k^2. The largest of these four entries is at least 1.
    candidates = (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
    )
    best, diagonal = candidates[0], candidates[0][0]
    for k in (1, 2, 3):
        larger = candidates[k][k] > diagonal
        diagonal = jnp.where(larger, candidates[k][k], diagonal)
        best = tuple(jnp.where(larger, new, old) for new, old in zip(candidates[k], best, strict=True))
    sign = jnp.where(best[0] < 0, -jnp.ones_like(a), jnp.ones_like(a))
    factor = sign / (2 * jnp.sqrt(diagonal))
    return cp.pack((factor * best[0], factor * best[1], factor * best[2], factor * best[3]))


def to_euler(quaternion: Float[Array, "*batch 4"], sequence: str) -> Float[Array, "*batch 3"]:
    """The Euler angles a, b, c of a rotation R_i(a) R_j(b) R_k(c), radians; differentiable away from the singularity.

    `sequence` is three axes without equal neighbours, "ZYX" or "321" for yaw, pitch and roll; otherwise a ValueError is
    raised. The rotations are about axes of the body, each after the earlier ones (SciPy: capital letters). a and c are
    between -pi and pi; b is between -pi/2 and pi/2, or 0 and pi if the first and the last axis are equal. Where the
    first and the last axis of rotation are parallel, c is 0.

    Examples:
        >>> yaw, pitch, roll = ml.so3.to_euler(ml.so3.exp(jnp.array([0.0, 0.0, 0.3])), "ZYX")
        >>> round(float(yaw), 6)
        0.3
    """
    r = jnp.moveaxis(to_matrix(quaternion), (-2, -1), (0, 1))
    return cp.pack(angles_of(r, as_sequence("sequence", sequence), jnp)[:3])


def from_euler(angles: Float[Array, "*batch 3"], sequence: str) -> Float[Array, "*batch 4"]:
    """The unit quaternion of three Euler angles (..., 3), radians: the inverse of `to_euler`.

    Examples:
        >>> ml.so3.from_euler(jnp.array([np.pi / 2, 0.0, 0.0]), "ZXZ").round(4)
        Array([0.7071, 0.    , 0.    , 0.7071], dtype=float64)
    """
    parts = zip(cp.vector(jnp.asarray(angles)), as_sequence("sequence", sequence), strict=True)
    turns = [exp(cp.pack(tuple(x if letter == axis else jnp.zeros_like(x) for axis in "XYZ"))) for x, letter in parts]
    return multiply(multiply(turns[0], turns[1]), turns[2])


def slerp(
    start: Float[Array, "*#batch 4"], end: Float[Array, "*#batch 4"], share: Float[Array, "*#batch"] | float
) -> Float[Array, "*#batch 4"]:
    """The rotation between two unit quaternions, at constant angular velocity along the shorter arc.

    `share` is the fraction of the arc: 0 gives `start`, 1 gives `end` (or its negative, the same rotation).

    Examples:
        >>> turned = ml.so3.exp(jnp.array([0.0, 0.0, 1.0]))
        >>> ml.so3.log(ml.so3.slerp(jnp.array([1.0, 0.0, 0.0, 0.0]), turned, 0.25)).round(6)  # a quarter of the way
        Array([0.  , 0.  , 0.25], dtype=float64)
    """
    x, y, z = cp.vector(log(multiply(conjugate(start), end)))
    share = jnp.asarray(share, x.dtype)
    return multiply(start, exp(cp.pack((share * x, share * y, share * z))))


def from_xyzw(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """The quaternion (w, x, y, z), scalar first, from (x, y, z, w), the order of SciPy and ROS.

    Examples:
        >>> ml.so3.from_xyzw(jnp.array([0.1, 0.2, 0.3, 0.9]))
        Array([0.9, 0.1, 0.2, 0.3], dtype=float64)
    """
    return jnp.roll(quaternion, 1, axis=-1)


def to_xyzw(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """The quaternion (x, y, z, w) from (w, x, y, z): the inverse of `from_xyzw`.

    Examples:
        >>> ml.so3.to_xyzw(jnp.array([0.9, 0.1, 0.2, 0.3]))
        Array([0.1, 0.2, 0.3, 0.9], dtype=float64)
    """
    return jnp.roll(quaternion, -1, axis=-1)


def to_scipy(quaternion: Float[Array, "*batch 4"]) -> Any:
    """The same rotations as a `scipy.spatial.transform.Rotation`, whose `as_quat(scalar_first=True)` is the inverse.

    The quaternions must be concrete, with at most one batch axis. Raises an ImportError without SciPy.

    Examples:
        >>> yaw, pitch, roll = ml.so3.to_scipy(ml.so3.exp(jnp.array([0.0, 0.0, 0.3]))).as_euler("ZYX")
        >>> round(float(yaw), 6)
        0.3
    """
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.asarray(quaternion), scalar_first=True)


def dexp(vector: Float[Array, "*#batch 3"], rate: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """The angular velocity, in the space frame, of the rotation exp(vector) when `vector` changes at `rate`.

    The angular velocity in the body frame is dexp(-vector, rate). Hairer, Lubich & Wanner, Geometric Numerical
    Integration, III.4.

    Examples:
        >>> ml.so3.dexp(jnp.array([0.0, 0.0, 0.5]), jnp.array([0.0, 0.0, 2.0]))  # about one axis it is the rate itself
        Array([0., 0., 2.], dtype=float64)
    """
    v, r = cp.vector(vector), cp.vector(rate)
    x = cp.dot(v, v)
    first = cp.cross(v, r)
    second = cp.cross(v, first)
    return cp.pack(cp.add(r, cp.add(cp.scale(_versine(x), first), cp.scale(_remainder(x), second))))


def dexp_inverse(vector: Float[Array, "*#batch 3"], velocity: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """The inverse of `dexp` in its second argument; singular at |vector| = 2 pi.

    Examples:
        >>> ml.so3.dexp_inverse(jnp.array([0.0, 0.0, 0.5]), jnp.array([0.0, 0.0, 2.0]))  # about one axis
        Array([0., 0., 2.], dtype=float64)
    """
    v, r = cp.vector(vector), cp.vector(velocity)
    first = cp.cross(v, r)
    second = cp.cross(v, first)
    return cp.pack(cp.add(r, cp.add(cp.scale(-0.5, first), cp.scale(_cotangent(cp.dot(v, v)), second))))
