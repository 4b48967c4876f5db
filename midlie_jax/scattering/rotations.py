"""Distributions on the sphere and on SO(3). An attitude is a unit quaternion (w, x, y, z), body to space."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import is_unit, require
from .._math import components as cp
from .._xla.fusion import split
from ..model import so3
from .base import Distribution, as_numbers, as_positive
from .numbers import Normal


def _direction(key: Array, size: int, dtype: Any) -> Array:
    """A uniform point of the unit sphere in `size` dimensions: normal numbers have no preferred direction."""
    normal = jax.random.normal(key, (size,), dtype)
    square = normal[0] * normal[0]
    for n in range(1, size):  # in sequence, because the compiler chooses the order of a sum over an axis
        square = square + normal[n] * normal[n]
    return normal / jnp.sqrt(square).reshape(1)


class Sphere(Distribution):
    """A vector (3,) of fixed length, whose direction is uniform on the sphere S^2.

    Args:
        radius: the length, a positive number.

    Raises:
        ValueError: the radius is not a single positive number.

    Examples:
        >>> momenta = ml.scatter(jax.random.key(0), 1000, momentum=ml.distributions.Sphere(50.0))["momentum"]
        >>> jnp.linalg.norm(momenta, axis=-1)[:3].round(6)
        Array([50., 50., 50.], dtype=float64)
    """

    radius: np.ndarray

    def __init__(self, radius: Any = 1.0):
        self.radius = as_positive("radius", radius)
        if self.radius.ndim:
            raise ValueError(f"radius must be a single number, got shape {self.radius.shape}; scale the drawn vectors.")

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del body
        return jnp.asarray(self.radius).reshape(1) * _direction(key, 3, dtype)


class Rotation(Distribution):
    """An attitude, uniform on SO(3): a uniform point of the sphere of unit quaternions (4,), of either sign.

    K. Shoemake, Uniform random rotations, Graphics Gems III (1992) 124; G. Marsaglia, Ann. Math. Stat. 43 (1972) 645.

    Examples:
        >>> ml.scatter(jax.random.key(0), 1000, attitude=ml.distributions.Rotation())["attitude"].shape
        (1000, 4)
    """

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del body
        return _direction(key, 4, dtype)


class RotationNear(Distribution):
    """An attitude (4,) near a mean attitude: mean * exp(error) with a normal rotation vector `error` in the body frame.

    This is the error model of attitude filters (F. L. Markley, J. Guid. Control Dyn. 26 (2003) 311). Errors beyond pi
    wrap around, so use deviations well below one radian.

    Attributes:
        attitude: the mean, a unit quaternion (4,).
        error: the distribution of the rotation vector.

    Args:
        attitude: unit quaternion (w, x, y, z).
        deviation: standard deviation of the rotation vector in radians, one number or (3,) for the axes of the body.
        covariance: (3, 3) of the rotation vector, in place of the deviation.

    Raises:
        ValueError: the attitude is not a unit quaternion (4,), or as for `Normal`.

    Examples:
        >>> near = ml.distributions.RotationNear([1.0, 0.0, 0.0, 0.0], deviation=0.01)  # radians
        >>> ml.scatter(jax.random.key(0), 1000, attitude=near)["attitude"].shape
        (1000, 4)
    """

    attitude: np.ndarray
    error: Normal

    def __init__(self, attitude: Any, deviation: Any = None, *, covariance: Any = None):
        given = as_numbers("attitude", attitude)
        if given.shape != (4,):
            raise ValueError(f"attitude must be one quaternion (4,), got shape {given.shape}; scatter one mean only.")
        require("attitude", given, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its length.")
        self.attitude = given / np.linalg.norm(given)
        self.error = Normal(np.zeros(3), deviation, covariance=covariance)
        if self.error.mean.shape != (3,):
            raise ValueError(f"deviation must be one number or (3,), got shape {self.error.mean.shape}.")

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        # In one loop XLA would draw the vector again for each component of the quaternion.
        error = split(cp.vector(self.error.draw(key, body, dtype)))
        turn = split(cp.quaternion(so3.exp(cp.pack(error))))
        return cp.pack(cp.multiply(cp.quaternion(jnp.asarray(self.attitude)), turn))
