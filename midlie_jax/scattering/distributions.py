"""`midlie_jax.distributions`: the distributions for `midlie_jax.scatter`.

Each is checked on construction and holds no random state: the key of `scatter` determines all draws. A subclass of
`Distribution` with a method `draw(key, body, dtype)` is also a distribution. An attitude is a unit quaternion
(w, x, y, z), body to space.
"""

from abc import abstractmethod
from collections.abc import Mapping
from math import prod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import described, is_unit, require, require_finite, shown
from .._math import components as cp
from .._xla.fusion import split
from ..model import so3

_ROUNDED = 1e-6  # allowed error of correlations, because numbers may have been rounded to float32


class Distribution(eqx.Module):
    """The distribution of one quantity over the bodies; its arrays are cast to the dtype of the result.

    Raises:
        ValueError: for every distribution: arguments that are not of the described shape and range, or not finite.

    Examples:
        >>> moments = ml.distributions.LogNormal([5.0, 5.0, 1.0], 0.1)  # a distribution
        >>> ml.scatter(jax.random.key(0), 100, moments=moments)["moments"].shape
        (100, 3)
    """

    @abstractmethod
    def draw(self, key: Array, body: Array, dtype: Any) -> Any:
        """The value of one body: an array, or a tree of arrays, in `dtype`, without the axis of bodies.

        This method is mapped over blocks of bodies, with a typed key and the index of each body, and compiled. XLA may
        round a long loop differently for another number of threads; `RotationNear` shows how to divide the loop.
        """

    def check_bodies(self, name: str, indices: np.ndarray) -> None:
        """Raises a ValueError if one of these bodies has no value; `name` is the name of the quantity."""


class Normal(Distribution):
    """Normal numbers, either independent with a `deviation` each, or one vector with a covariance matrix.

    Args:
        mean: numbers of any shape, the shape of a draw; with a covariance a vector (d,).
        deviation: standard deviations of at least 0, in the unit of the mean; a single number holds for all.
        covariance: (d, d), symmetric positive semi-definite, in place of the deviation.

    Examples:
        >>> normal = ml.distributions.Normal([0.0, 0.0, 50.0], deviation=[0.1, 0.1, 1.0])
        >>> ml.scatter(jax.random.key(0), 1000, momentum=normal)["momentum"].shape
        (1000, 3)
    """

    mean: np.ndarray
    deviation: np.ndarray | None
    root: np.ndarray | None

    def __init__(self, mean: Any, deviation: Any = None, *, covariance: Any = None):
        self.mean, self.deviation, self.root = _as_numbers("mean", mean), None, None
        if (deviation is None) == (covariance is None):
            got = "neither" if deviation is None else "both"
            raise ValueError(f"deviation or covariance must be given, got {got}; pass one of the two.")
        if covariance is None:
            self.mean, self.deviation = _broadcast(mean=self.mean, deviation=_as_spread("deviation", deviation))
            return
        if self.mean.ndim != 1:
            raise ValueError(f"mean must be a vector (d,) with a covariance, got {self.mean.shape}; or use Joint.")
        self.root = _covariance_root(covariance, self.mean.size)

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        standard = jax.random.normal(key, self.mean.shape, dtype)
        if self.deviation is not None:
            return jnp.asarray(self.mean) + self.deviation * standard
        assert self.root is not None
        # Summed column by column, because a matrix product adds in an order that depends on the number of rows.
        total = jnp.asarray(self.mean)
        for column in range(self.mean.size):
            total = total + self.root[:, column] * standard[column]
        return total


class LogNormal(Distribution):
    """Positive numbers whose logarithms are normal: masses, moments, coefficients.

    Args:
        median: positive numbers of any shape; half of all draws are larger.
        deviation: relative standard deviations, that is standard deviation over mean, of at least 0; a single number
            holds for all. The mean is median * sqrt(1 + deviation^2).

    Examples:
        >>> mass = ml.distributions.LogNormal(3.0, 0.2)
        >>> ml.scatter(jax.random.key(0), 1000, mass=mass)["mass"].shape
        (1000,)
    """

    median: np.ndarray
    log_deviation: np.ndarray

    def __init__(self, median: Any, deviation: Any):
        spread = np.asarray(np.sqrt(np.log1p(_as_spread("deviation", deviation) ** 2)))
        self.median, self.log_deviation = _broadcast(median=_as_positive("median", median), deviation=spread)

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        return jnp.asarray(self.median) * jnp.exp(self.log_deviation * jax.random.normal(key, self.median.shape, dtype))


class Uniform(Distribution):
    """Numbers between two bounds, independent and each uniform.

    Args:
        low, high: numbers of any shape, low <= high; a single number holds for all. By rounding, `high` can be drawn.

    Examples:
        >>> ml.scatter(jax.random.key(0), 1000, weight=ml.distributions.Uniform(15.0, 25.0))["weight"].shape
        (1000,)
    """

    low: np.ndarray
    width: np.ndarray

    def __init__(self, low: Any, high: Any):
        self.low, top = _broadcast(low=_as_numbers("low", low), high=_as_numbers("high", high))
        if np.any(self.low > top):
            raise ValueError(f"low must not exceed high, got low {low} and high {high}; exchange them.")
        self.width = np.asarray(top - self.low)

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        return jnp.asarray(self.low) + self.width * jax.random.uniform(key, self.low.shape, dtype)


class Joint(Distribution):
    """Several jointly normal quantities; a draw is a dictionary with the names and shapes of the mean.

    Args:
        mean: a dictionary of names and means, each of any shape.
        covariance: (d, d), symmetric positive semi-definite, of all d numbers in the order of `mean`.

    Examples:
        >>> both = ml.distributions.Joint({"mass": 3.0, "drag": 1.2}, covariance=[[0.04, 0.01], [0.01, 0.09]])
        >>> ml.scatter(jax.random.key(0), 1000, numbers=both)["numbers"]["drag"].shape
        (1000,)
    """

    normal: Normal
    names: tuple[str, ...] = eqx.field(static=True)
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def __init__(self, mean: Any, covariance: Any):
        if not isinstance(mean, Mapping) or not mean:
            raise ValueError("mean must be a dictionary of names and means, as {'mass': 2.0, 'offset': [0.0, 0.1]}.")
        means = {name: _as_numbers(f"mean[{name!r}]", value) for name, value in mean.items()}
        self.names, self.shapes = tuple(means), tuple(value.shape for value in means.values())
        self.normal = Normal(np.concatenate([value.reshape(-1) for value in means.values()]), covariance=covariance)

    def draw(self, key: Array, body: Array, dtype: Any) -> dict[str, Array]:
        ends = np.cumsum([prod(shape) for shape in self.shapes])
        parts = jnp.split(self.normal.draw(key, body, dtype), ends[:-1])
        return {name: part.reshape(s) for name, part, s in zip(self.names, parts, self.shapes, strict=True)}


def _direction(key: Array, size: int, dtype: Any) -> Array:
    """A uniform point of the unit sphere in `size` dimensions: normal numbers have no preferred direction."""
    normal = jax.random.normal(key, (size,), dtype)
    square = normal[0] * normal[0]
    for n in range(1, size):  # in sequence, because the compiler chooses the order of a sum over an axis
        square = square + normal[n] * normal[n]
    return normal / jnp.sqrt(square).reshape(1)


class Sphere(Distribution):
    """A vector (3,) of fixed length, a positive number, whose direction is uniform on the sphere S^2.

    Examples:
        >>> momenta = ml.scatter(jax.random.key(0), 1000, momentum=ml.distributions.Sphere(50.0))["momentum"]
        >>> jnp.linalg.norm(momenta, axis=-1)[:3].round(6)
        Array([50., 50., 50.], dtype=float64)
    """

    radius: np.ndarray

    def __init__(self, radius: Any = 1.0):
        self.radius = _as_positive("radius", radius)
        if self.radius.ndim:
            raise ValueError(f"radius must be a single number, got shape {self.radius.shape}; scale the drawn vectors.")

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        return jnp.asarray(self.radius).reshape(1) * _direction(key, 3, dtype)


class Rotation(Distribution):
    """An attitude, uniform on SO(3): a uniform point of the sphere of unit quaternions (4,), of either sign.

    K. Shoemake, Uniform random rotations, Graphics Gems III (1992) 124; G. Marsaglia, Ann. Math. Stat. 43 (1972) 645.

    Examples:
        >>> ml.scatter(jax.random.key(0), 1000, attitude=ml.distributions.Rotation())["attitude"].shape
        (1000, 4)
    """

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        return _direction(key, 4, dtype)


class RotationNear(Distribution):
    """An attitude (4,) near a mean attitude: mean * exp(error) with a normal rotation vector `error` in the body frame.

    This is the error model of attitude filters (F. L. Markley, J. Guid. Control Dyn. 26 (2003) 311). Errors beyond pi
    wrap around, so use deviations well below one radian.

    Args:
        attitude: unit quaternion (w, x, y, z).
        deviation: standard deviation of the rotation vector in radians, one number or (3,) for the axes of the body.
        covariance: (3, 3) of the rotation vector, in place of the deviation.

    Examples:
        >>> near = ml.distributions.RotationNear([1.0, 0.0, 0.0, 0.0], deviation=0.01)  # radians
        >>> ml.scatter(jax.random.key(0), 1000, attitude=near)["attitude"].shape
        (1000, 4)
    """

    attitude: np.ndarray
    error: Normal

    def __init__(self, attitude: Any, deviation: Any = None, *, covariance: Any = None):
        given = _as_numbers("attitude", attitude)
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


class _Table(Distribution):
    values: np.ndarray

    def __init__(self, values: Any):
        self.values = _as_numbers("values", values)
        if not self.values.ndim or not len(self.values):
            raise ValueError(f"values must have at least one row along its first axis, got shape {self.values.shape}.")


class Rows(_Table):
    """A row of measured data (m, ...), drawn with replacement and with equal probabilities: the bootstrap.

    Correlated quantities must be columns of one array; otherwise their rows are drawn independently. Raises a
    ValueError for values without rows, or that are not finite numbers.

    Examples:
        >>> measured = np.array([[1.0, 0.1], [2.0, 0.3], [3.0, 0.2]])  # correlated columns
        >>> ml.scatter(jax.random.key(0), 1000, sizes=ml.distributions.Rows(measured))["sizes"].shape
        (1000, 2)
    """

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        return jnp.asarray(self.values)[jax.random.randint(key, (), 0, len(self.values))]


class Each(_Table):
    """Row k of values (m, ...) for body k; nothing is drawn. Use it for values that are given, or drawn elsewhere.

    Raises a ValueError as `Rows` does; `midlie_jax.scatter` raises it for a body beyond the last row.

    Examples:
        >>> known = ml.distributions.Each([[1.0, 2.0, 2.5], [3.0, 3.0, 1.0]])
        >>> ml.scatter(jax.random.key(0), 2, moments=known)["moments"]
        Array([[1. , 2. , 2.5],
               [3. , 3. , 1. ]], dtype=float64)
    """

    def check_bodies(self, name: str, indices: np.ndarray) -> None:
        if indices.size and indices.max() >= len(self.values):
            raise ValueError(
                f"{name} must have one row per body, got {len(self.values)} rows and body {indices.max()} (from "
                "0 on). Add rows, or use Rows to draw at random."
            )

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        return jnp.asarray(self.values)[body]


class Key(Distribution):
    """A random key for each body, such as the `key` of `midlie_jax.baths.Langevin`.

    Examples:
        >>> ml.scatter(jax.random.key(0), 100, bath=ml.distributions.Key())["bath"].shape
        (100,)
    """

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        return key


def _as_numbers(name: str, value: Any) -> np.ndarray:
    if cp.is_traced(value):
        raise ValueError(f"{name} is traced; make distributions outside jit, vmap and grad.")
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "fiu":
            raise TypeError
        numbers = given.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of real numbers, got {described(value)}.") from error
    require_finite(name, numbers)
    return numbers


def _as_spread(name: str, value: Any) -> np.ndarray:
    numbers = _as_numbers(name, value)
    require(name, numbers, lambda x: x >= 0, "must not be negative", "pass the standard deviation, not its negative.")
    return numbers


def _as_positive(name: str, value: Any) -> np.ndarray:
    numbers = _as_numbers(name, value)
    require(name, numbers, lambda x: x > 0, "must be positive", "use Normal for numbers of either sign.")
    return numbers


def _broadcast(**arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    try:
        return tuple(np.array(x) for x in np.broadcast_arrays(*arrays.values()))
    except ValueError as error:
        shapes = " and ".join(f"{name} {x.shape}" for name, x in arrays.items())
        raise ValueError(f"{shapes} do not fit together; give both one shape, or one as a single number.") from error


def _covariance_root(covariance: Any, size: int) -> np.ndarray:
    """A matrix S with S S^T = covariance, (size, size): deviations times the positive root of the correlations.

    Relative to the covariance itself, rounding errors would destroy its small entries. Cholesky's method fails for a
    semi-definite matrix, and a root from eigenvectors alone has program-dependent signs.
    """
    matrix = _as_numbers("covariance", covariance)
    if matrix.shape != (size, size):
        raise ValueError(f"covariance must have shape ({size}, {size}), as the mean has numbers, got {matrix.shape}.")
    deviations = np.sqrt(np.abs(np.diagonal(matrix)))
    unit = np.where(deviations > 0, deviations, 1)  # the unit of each number
    correlations = matrix / unit[:, None] / unit  # 0 for a number that does not vary
    if np.any(np.abs(correlations - correlations.T) > _ROUNDED):
        raise ValueError(f"covariance must be symmetric, got {shown(matrix)}; pass (C + C.T) / 2.")
    correlations = (correlations + correlations.T) / 2
    values, vectors = np.linalg.eigh(correlations)
    if values.min(initial=0.0) < -_ROUNDED * values.max(initial=0.0) or np.any(matrix[deviations == 0]):
        raise ValueError(
            f"covariance must be positive semi-definite, got the variances {shown(np.diagonal(matrix))} and the "
            f"correlations {shown(correlations)} with the eigenvalue {values[0]:.3g}; check their signs."
        )
    return deviations[:, None] * ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T)
