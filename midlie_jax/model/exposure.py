"""The exact effect of a heat bath on a body in a given time: friction and thermal noise.

In principal axes dPi = -G I^-1 Pi dt + sqrt(2 kT G) dW, with the friction G. After the time h the solution is

    Pi -> exp(-G I^-1 h) Pi + sqrt(kT) S xi,    S S^T = I - exp(-G I^-1 h) I exp(-I^-1 G h)

with standard normal numbers xi. It preserves the Maxwell distribution, of mean 0 and covariance kT I, for every h. The
same holds for the linear momentum with the mass in place of I.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._math.normals import normals
from . import so3
from .bodies import Body, SymmetricRotor
from .free_body import FreeBody, Momenta

ROUNDED = 1e-5  # largest magnitude of a negative eigenvalue of a tensor due to rounding, relative to its largest one
_SHORT = 1e-3  # below, (1 - exp(-x))/x uses the first terms of its series


class Exposure(NamedTuple):
    """The effect of a bath on one vector in a given time: a change by -lost vector + spread noise.

    `lost` is 1 - exp(-G I^-1 h), three numbers of a diagonal matrix or three rows, or None without friction. `spread`
    is the matrix S in the same form, for kT = 1 unless it includes the temperature.
    """

    lost: Any
    spread: Any

    def change(self, root: Any, vector: cp.Vector, noise: cp.Vector) -> cp.Vector:
        """The change of the vector; `root` is the factor sqrt(kT) of the spread, or None."""
        pushed = product(self.spread, noise)
        pushed = pushed if root is None else cp.scale(root, pushed)
        return pushed if self.lost is None else cp.subtract(pushed, product(self.lost, vector))


class InBody(NamedTuple):
    """An `Exposure` of a space-frame vector whose matrices are in the body frame."""

    own: Exposure


class InSpace(NamedTuple):
    """Noise in the space frame on a body; `thin` is whether its moment about the axis of symmetry is zero."""

    own: Exposure
    thin: Array | bool


class PreparedBath(NamedTuple):
    """A heat bath, prepared for the steps of a run.

    `root` is the function of time sqrt(kT), or None if the exposures include the temperature. `exposures` is the effect
    of the bath by the coefficient of the stage, in the form of the momentum, or a function of time that returns it; or
    what a method makes of the frictions. `member` is the index among coupled bodies: all indices (N,), or one.
    """

    root: Callable[[Any], Array] | None
    key: tuple[Array, ...]
    exposures: Any
    member: Any
    step: Array | None = None

    @classmethod
    def of(cls, key: tuple[Array, ...], exposures: Any, root: Any, start: Any) -> "PreparedBath":
        count = start.momentum.shape[-2] if start.several else 0
        return cls(root, key, exposures, jnp.arange(count, dtype=jnp.int32) if count else 0)

    def at(self, t: Array) -> Any:
        found = self.exposures(t) if callable(self.exposures) else self.exposures
        i = self.member
        return jax.tree.map(lambda x: x[i] if jnp.ndim(x) else x, found) if isinstance(i, int) else found

    def noise(self, stage: int, like: Any) -> Any:
        assert self.step is not None
        leaves, structure = jax.tree.flatten(like)
        drawn = normals(self.key, (self.step, stage, self.member), len(leaves), leaves[0].dtype)
        return structure.unflatten(drawn)


def root_of(square: Array) -> Array:
    """The square root, whose derivative at zero is defined as zero; NaN for a negative number."""
    zero = square == 0
    return jnp.where(zero, jnp.zeros_like(square), jnp.sqrt(jnp.where(zero, jnp.ones_like(square), square)))


def exposures(body: Body, frame: Any, friction: Array, linear_friction: Array | None, time: Array, root: Any) -> Any:
    """The effect of a bath on a body in principal axes in a time, in the form of its momentum.

    `frame` is the quaternion from principal components to the user's, or None. The frictions are numbers (), (..., 3)
    or tensors (..., 3, 3) in the user's frame. `root` is sqrt(kT), a factor of every spread; or None.
    """
    turning: Any = body.turning
    if isinstance(turning, SymmetricRotor):
        moments = turning.moment, turning.moment, turning.known_along
    else:
        moments = cp.vector(turning.moments)
    angular = _exposure(in_principal_axes(friction, frame), moments, time, root)
    if not isinstance(body, FreeBody):
        return angular
    assert linear_friction is not None
    mass: cp.Vector = body.mass, body.mass, body.mass
    linear = _exposure(in_principal_axes(linear_friction, frame), mass, time, root)
    return Momenta(angular, linear if linear_friction.ndim == 0 else InBody(linear))


def kicks(body: Body, diffusion: Array, linear_diffusion: Array | None, time: Array) -> Any:
    turning: Any = body.turning
    angular: Any = _kick(diffusion, time)
    if isinstance(turning, SymmetricRotor):
        angular = InSpace(angular, turning.known_along == 0)
    elif diffusion.ndim:
        angular = InSpace(angular, False)
    if not isinstance(body, FreeBody):
        return angular
    assert linear_diffusion is not None
    return Momenta(angular, _kick(linear_diffusion, time))


def _kick(diffusion: Array, time: Array) -> Exposure:
    if diffusion.shape[-2:] == (3, 3):
        return Exposure(None, rows(symmetric_root(2 * time * diffusion)))
    each = cp.vector(diffusion) if diffusion.ndim else (diffusion,) * 3
    return Exposure(None, tuple(root_of(2 * time * d) for d in each))


def in_principal_axes(friction: Array, frame: Any) -> Array:
    if frame is None or friction.shape[-2:] != (3, 3):
        return friction
    axes = so3.to_matrix(cp.pack(frame))
    return jnp.swapaxes(axes, -1, -2) @ friction @ axes


def _exposure(friction: Array, moments: cp.Vector, time: Array, root: Any) -> Exposure:
    if friction.shape[-2:] == (3, 3):
        # From the eigenvectors of the symmetric matrix I^-1/2 G I^-1/2.
        roots = jnp.sqrt(cp.pack(moments))
        masses = roots[..., :, None] * roots[..., None, :]
        scaled = jnp.broadcast_to(friction, jnp.broadcast_shapes(friction.shape, masses.shape)) / masses
        lost, spread = _functions(scaled, time)
        lost, spread = roots[..., :, None] * lost / roots[..., None, :], roots[..., :, None] * spread
        spread = spread if root is None else root * spread
        return Exposure(rows(lost), rows(spread))
    each = cp.vector(friction) if friction.ndim else (friction,) * 3
    pairs = [_of_number(g, moment, time) for g, moment in zip(each, moments, strict=True)]
    spread = tuple(s if root is None else root * s for _, s in pairs)
    return Exposure(tuple(k for k, _ in pairs), spread)


def _of_number(friction: Array, moment: Array, time: Array) -> tuple[Array, Array]:
    thin = moment == 0
    rate = jnp.where(thin, jnp.zeros_like(moment), friction / jnp.where(thin, jnp.ones_like(moment), moment))
    return -jnp.expm1(-rate * time), cp.root(moment) * root_of(-jnp.expm1(-2 * rate * time))


@jax.custom_jvp
def _functions(matrix: Array, time: Array) -> tuple[Array, Array]:
    """1 - exp(-A t) and sqrt(1 - exp(-2 A t)) of symmetric matrices A, (..., 3, 3), with no negative eigenvalue.

    The derivative is finite, unlike eigenvectors: in their basis, the entries of dA times the divided differences of
    the function (Higham, Functions of Matrices, theorem 3.11).
    """
    values, vectors = _eigen(matrix)
    lost, spread = _of_values(values, time)
    return _from_values(vectors, lost), _from_values(vectors, spread)


@_functions.defjvp
def _functions_jvp(primals: Any, tangents: Any) -> Any:
    (matrix, time), (d_matrix, d_time) = primals, tangents
    values, vectors = _eigen(matrix)
    lost, spread = _of_values(values, time)
    change = jnp.swapaxes(vectors, -1, -2) @ _symmetric(d_matrix) @ vectors
    a, b = values[..., :, None], values[..., None, :]
    slopes, squares = _divided(a, b, time), 2 * _divided(2 * a, 2 * b, time)
    own = jnp.eye(3, dtype=values.dtype)
    d_lost = slopes * change + own * (d_time * values * jnp.exp(-values * time))[..., None]
    d_spread = _over(squares, spread[..., :, None] + spread[..., None, :]) * change
    d_spread = d_spread + own * _over(d_time * values * jnp.exp(-2 * values * time), spread)[..., None]
    tangent = tuple(vectors @ d @ jnp.swapaxes(vectors, -1, -2) for d in (d_lost, d_spread))
    return (_from_values(vectors, lost), _from_values(vectors, spread)), tangent


@jax.custom_jvp
def symmetric_root(matrix: Array) -> Array:
    values, vectors = _eigen(matrix)
    return _from_values(vectors, root_of(values))


@symmetric_root.defjvp
def _symmetric_root_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    values, vectors = _eigen(primals[0])
    roots, turned = root_of(values), jnp.swapaxes(vectors, -1, -2)
    slope = _over(turned @ _symmetric(tangents[0]) @ vectors, roots[..., :, None] + roots[..., None, :])
    return _from_values(vectors, roots), vectors @ slope @ turned


def _symmetric(matrix: Array) -> Array:
    """The symmetric part, on which alone the eigenvectors of JAX depend."""
    return (matrix + jnp.swapaxes(matrix, -1, -2)) / 2


def _eigen(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues and eigenvectors of symmetric matrices; NaN for a negative eigenvalue that is not due to rounding."""
    values, vectors = jnp.linalg.eigh(matrix)
    least = -ROUNDED * jnp.max(jnp.abs(values), axis=-1, keepdims=True)
    return jnp.where(values < least, jnp.nan, jnp.maximum(values, 0)), vectors


def _of_values(values: Array, time: Array) -> tuple[Array, Array]:
    return -jnp.expm1(-values * time), root_of(-jnp.expm1(-2 * values * time))


def _from_values(vectors: Array, values: Array) -> Array:
    return (vectors * values[..., None, :]) @ jnp.swapaxes(vectors, -1, -2)


def _divided(a: Array, b: Array, time: Array) -> Array:
    """(exp(-b t) - exp(-a t)) / (a - b), and t exp(-a t) where both agree."""
    gap = jnp.abs(a - b) * time
    short = gap < _SHORT
    safe = jnp.where(short, jnp.ones_like(gap), gap)
    mean = jnp.where(short, 1 - gap / 2 * (1 - gap / 3 * (1 - gap / 4)), -jnp.expm1(-safe) / safe)
    return time * jnp.exp(-jnp.minimum(a, b) * time) * mean


def _over(a: Array, b: Array) -> Array:
    zero = b == 0
    return jnp.where(zero, jnp.zeros_like(a * b), a / jnp.where(zero, jnp.ones_like(b), b))


def rows(matrix: Array) -> Any:
    return tuple(cp.vector(matrix[..., i, :]) for i in range(3))


def product(matrix: Any, vector: cp.Vector) -> cp.Vector:
    if isinstance(matrix[0], tuple):
        x, y, z = (cp.dot(row, vector) for row in matrix)
        return x, y, z
    return cp.times(matrix, vector)
