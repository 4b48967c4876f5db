"""Rotations: unit quaternions (w, x, y, z) and rotation vectors, in arrays of any leading batch shape.

The lowest layer of the package: it knows no bodies and no time. All functions are smooth to second order at
and near rotation zero and rotation pi, in float32 and float64. `exp(v)` turns by |v| radians about v; as a
map, attitude q takes body components to space components, `rotate(q, v_body) = v_space`.
"""

from collections.abc import Callable
from math import factorial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._kernel import components as cp

# Below these arguments the series are exact to rounding with the terms kept, derivatives included.
_SERIES_TERMS = 12
_SMALL_ANGLE_SQUARED = 1.0  # for sin(a)/a and its like, as functions of a^2
_SMALL_TANGENT_SQUARED = 0.04  # for atan(z)/z, as a function of z^2
_BERNOULLI = (1 / 6, 1 / 30, 1 / 42, 1 / 30, 5 / 66, 691 / 2730, 7 / 6, 3617 / 510, 43867 / 798, 174611 / 330)


def _even(series: tuple[float, ...], x: Array, closed_form: Callable[[Array], Array]) -> Array:
    """A function analytic in x >= 0: its series for small x, `closed_form(sqrt(x))` elsewhere."""
    small = x < _SMALL_ANGLE_SQUARED
    angle = jnp.sqrt(jnp.where(small, jnp.ones_like(x), x))
    return jnp.where(small, cp.polynomial(series, jnp.where(small, x, jnp.zeros_like(x))), closed_form(angle))


def _series(shift: int) -> tuple[float, ...]:
    """sum over n of (-x)^n / (2n + shift)!"""
    return tuple((-1) ** n / factorial(2 * n + shift) for n in range(_SERIES_TERMS))


def _sinc(x: Array) -> Array:
    """sin(a)/a at a^2 = x."""
    return _even(_series(1), x, lambda a: jnp.sin(a) / a)


def _cosine(x: Array) -> Array:
    """cos(a) at a^2 = x."""
    return _even(_series(0), x, jnp.cos)


def _versine(x: Array) -> Array:
    """(1 - cos a)/a^2 at a^2 = x."""
    return _even(_series(2), x, lambda a: 2 * (jnp.sin(a / 2) / a) ** 2)


def _remainder(x: Array) -> Array:
    """(a - sin a)/a^3 at a^2 = x."""
    return _even(_series(3), x, lambda a: (a - jnp.sin(a)) / a**3)


def _cotangent(x: Array) -> Array:
    """(1 - (a/2) cot(a/2))/a^2 at a^2 = x."""
    series = tuple(b / factorial(2 * n + 2) for n, b in enumerate(_BERNOULLI))
    return _even(series, x, lambda a: (1 - (a / 2) * jnp.cos(a / 2) / jnp.sin(a / 2)) / (a * a))


def exp(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 4"]:
    """The unit quaternion that turns by |vector| radians about vector."""
    v = cp.vector(vector)
    quarter = cp.dot(v, v) / 4
    s = _sinc(quarter) / 2
    return cp.pack((_cosine(quarter), s * v[0], s * v[1], s * v[2]))


def log(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3"]:
    """The rotation vector of a unit quaternion, of length at most pi; q and -q give the same."""
    w, *rest = cp.quaternion(quaternion)
    u = (rest[0], rest[1], rest[2])
    sign = jnp.where(w < 0, -jnp.ones_like(w), jnp.ones_like(w))
    w = sign * w
    square = cp.dot(u, u)
    small = square < _SMALL_TANGENT_SQUARED * w * w
    safe_w = jnp.where(small, w, jnp.ones_like(w))
    safe_square = jnp.where(small, jnp.ones_like(square), square)
    series = tuple((-1) ** n / (2 * n + 1) for n in range(2 * _SERIES_TERMS))
    near = cp.polynomial(series, jnp.where(small, square, jnp.zeros_like(square)) / safe_w**2) / safe_w
    norm = jnp.sqrt(safe_square)
    factor = 2 * sign * jnp.where(small, near, jnp.arctan2(norm, w) / norm)
    return cp.pack((factor * u[0], factor * u[1], factor * u[2]))


def multiply(left: Float[Array, "*#batch 4"], right: Float[Array, "*#batch 4"]) -> Float[Array, "*#batch 4"]:
    """The rotation `right` followed by `left` (as matrices, left @ right)."""
    return cp.pack(cp.multiply(cp.quaternion(left), cp.quaternion(right)))


def conjugate(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """The inverse of a unit quaternion."""
    return cp.pack(cp.conjugate(cp.quaternion(quaternion)))


def rotate(quaternion: Float[Array, "*#batch 4"], vector: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """The vector turned: body components in, space components out, for an attitude."""
    return cp.pack(cp.rotate(cp.quaternion(quaternion), cp.vector(vector)))


def to_matrix(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """The rotation matrix of a unit quaternion."""
    w, x, y, z = cp.quaternion(quaternion)
    rows = (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
    return jnp.stack([cp.pack(row) for row in rows], axis=-2)


def from_matrix(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """The unit quaternion, w >= 0, of a rotation matrix (Shepperd 1978: the best conditioned of four formulas)."""
    (a, b, c), (d, e, f), (g, h, i) = (cp.vector(matrix[..., row, :]) for row in range(3))
    # Row k holds 4 q_k q, so its own entry k is 4 q_k^2; the largest is at least 1.
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


def slerp(
    start: Float[Array, "*#batch 4"], end: Float[Array, "*#batch 4"], share: Float[Array, "*#batch"] | float
) -> Float[Array, "*#batch 4"]:
    """Between two unit quaternions, at constant angular velocity and the short way round; `share` is 0 at the start."""
    x, y, z = cp.vector(log(multiply(conjugate(start), end)))
    share = jnp.asarray(share, x.dtype)
    return multiply(start, exp(cp.pack((share * x, share * y, share * z))))


def from_xyzw(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """A quaternion with the scalar last, as SciPy and ROS write it, in the order of this package."""
    return jnp.roll(quaternion, 1, axis=-1)


def to_xyzw(quaternion: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """The inverse of `from_xyzw`."""
    return jnp.roll(quaternion, -1, axis=-1)


def to_scipy(quaternion: Float[Array, "*batch 4"]) -> Any:
    """The same rotations as a `scipy.spatial.transform.Rotation`, for Euler angles and the rest of what it can do.

    Of concrete arrays, with at most one batch axis. `Rotation.as_quat(scalar_first=True)` leads back.

    Raises:
        ImportError: SciPy is missing.
    """
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.asarray(quaternion), scalar_first=True)


def dexp(vector: Float[Array, "*#batch 3"], rate: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """The angular velocity, in space, of exp(vector) when vector changes at `rate`.

    d/dt exp(v) = skew(dexp(v, v')) exp(v); in the body it is dexp(-v, v'). Hairer, Lubich & Wanner, III.4.
    """
    v, r = cp.vector(vector), cp.vector(rate)
    x = cp.dot(v, v)
    first = cp.cross(v, r)
    second = cp.cross(v, first)
    return cp.pack(cp.add(r, cp.add(cp.scale(_versine(x), first), cp.scale(_remainder(x), second))))


def dexp_inverse(vector: Float[Array, "*#batch 3"], velocity: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """The inverse of `dexp` in its second argument; singular at |vector| = 2 pi."""
    v, r = cp.vector(vector), cp.vector(velocity)
    first = cp.cross(v, r)
    second = cp.cross(v, first)
    return cp.pack(cp.add(r, cp.add(cp.scale(-0.5, first), cp.scale(_cotangent(cp.dot(v, v)), second))))
