"""Distributions of numbers and vectors: normal, log-normal, uniform, and correlated quantities."""

from collections.abc import Mapping
from math import prod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .base import Distribution, as_numbers, as_positive, as_spread, broadcast, covariance_root


class Normal(Distribution):
    """Normal numbers, either independent with a `deviation` each, or one vector with a covariance matrix.

    Attributes:
        mean: numbers of any shape, the shape of a draw.
        deviation: standard deviations, of the shape of `mean`; None with a covariance.
        root: a matrix S with S S^T = covariance, (d, d); None with deviations.

    Args:
        mean: numbers of any shape; with a covariance a vector (d,).
        deviation: standard deviations of at least 0, in the unit of the mean; a single number holds for all.
        covariance: (d, d), symmetric positive semi-definite, in place of the deviation.

    Raises:
        ValueError: both or neither of deviation and covariance; shapes that do not fit; a negative deviation; a
            covariance that is not symmetric positive semi-definite; or numbers that are not finite.

    Examples:
        >>> normal = ml.distributions.Normal([0.0, 0.0, 50.0], deviation=[0.1, 0.1, 1.0])
        >>> ml.scatter(jax.random.key(0), 1000, momentum=normal)["momentum"].shape
        (1000, 3)
    """

    mean: np.ndarray
    deviation: np.ndarray | None
    root: np.ndarray | None

    def __init__(self, mean: Any, deviation: Any = None, *, covariance: Any = None):
        self.mean, self.deviation, self.root = as_numbers("mean", mean), None, None
        if (deviation is None) == (covariance is None):
            got = "neither" if deviation is None else "both"
            raise ValueError(f"deviation or covariance must be given, got {got}; pass one of the two.")
        if covariance is None:
            self.mean, self.deviation = broadcast(mean=self.mean, deviation=as_spread("deviation", deviation))
            return
        if self.mean.ndim != 1:
            raise ValueError(
                f"mean must be a vector (d,) with a covariance, got shape {self.mean.shape}; for several "
                "quantities use Joint."
            )
        self.root = covariance_root(covariance, self.mean.size, "the mean")

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del body
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

    Attributes:
        median: numbers of any shape, the shape of a draw.
        log_deviation: standard deviations of the natural logarithm.

    Args:
        median: positive numbers of any shape; half of all draws are larger.
        deviation: relative standard deviations, that is standard deviation over mean, of at least 0; a single number
            holds for all. The mean is median * sqrt(1 + deviation^2).

    Raises:
        ValueError: a median that is not positive, a negative deviation, shapes that do not fit, or numbers that are not
            finite.

    Examples:
        >>> mass = ml.distributions.LogNormal(3.0, 0.2)  # half of all masses above 3, and 20 % of deviation
        >>> ml.scatter(jax.random.key(0), 1000, mass=mass)["mass"].shape
        (1000,)
    """

    median: np.ndarray
    log_deviation: np.ndarray

    def __init__(self, median: Any, deviation: Any):
        spread = np.asarray(np.sqrt(np.log1p(as_spread("deviation", deviation) ** 2)))
        self.median, self.log_deviation = broadcast(median=as_positive("median", median), deviation=spread)

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del body
        return jnp.asarray(self.median) * jnp.exp(self.log_deviation * jax.random.normal(key, self.median.shape, dtype))


class Uniform(Distribution):
    """Numbers between two bounds, independent and each uniform.

    Attributes:
        low, width: the lower bounds, and the upper bounds minus the lower ones, in the shape of a draw.

    Args:
        low, high: numbers of any shape, low <= high; a single number holds for all. By rounding, `high` itself can be
            drawn.

    Raises:
        ValueError: low exceeds high, shapes that do not fit, or numbers that are not finite.

    Examples:
        >>> weight = ml.distributions.Uniform(15.0, 25.0)
        >>> ml.scatter(jax.random.key(0), 1000, weight=weight)["weight"].shape
        (1000,)
    """

    low: np.ndarray
    width: np.ndarray

    def __init__(self, low: Any, high: Any):
        self.low, top = broadcast(low=as_numbers("low", low), high=as_numbers("high", high))
        if np.any(self.low > top):
            raise ValueError(f"low must not exceed high, got low {low} and high {high}; exchange them.")
        self.width = np.asarray(top - self.low)

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del body
        return jnp.asarray(self.low) + self.width * jax.random.uniform(key, self.low.shape, dtype)


class Joint(Distribution):
    """Several jointly normal quantities, with the correlations of one covariance matrix.

    A draw is a dictionary with the names and shapes of the mean.

    Attributes:
        normal: the distribution of all numbers, in the order of `mean`, arrays row by row.
        names, shapes: of the quantities.

    Args:
        mean: a dictionary of names and means, each of any shape.
        covariance: (d, d), symmetric positive semi-definite, of all d numbers in the order of `mean`.

    Raises:
        ValueError: the mean is not a dictionary or is empty, or as for `Normal`.

    Examples:
        >>> both = ml.distributions.Joint({"mass": 3.0, "drag": 1.2}, covariance=[[0.04, 0.01], [0.01, 0.09]])
        >>> drawn = ml.scatter(jax.random.key(0), 1000, numbers=both)["numbers"]
        >>> drawn["mass"].shape, drawn["drag"].shape
        ((1000,), (1000,))
    """

    normal: Normal
    names: tuple[str, ...] = eqx.field(static=True)
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def __init__(self, mean: Any, covariance: Any):
        if not isinstance(mean, Mapping) or not mean:
            raise ValueError(
                "mean must be a dictionary of names and means, such as {'mass': 2.0, 'offset': [0.0, 0.1]}."
            )
        means = {name: as_numbers(f"mean[{name!r}]", value) for name, value in mean.items()}
        self.names, self.shapes = tuple(means), tuple(value.shape for value in means.values())
        self.normal = Normal(np.concatenate([value.reshape(-1) for value in means.values()]), covariance=covariance)

    def draw(self, key: Array, body: Array, dtype: Any) -> dict[str, Array]:
        ends = np.cumsum([prod(shape) for shape in self.shapes])
        parts = jnp.split(self.normal.draw(key, body, dtype), ends[:-1])
        return {name: part.reshape(s) for name, part, s in zip(self.names, parts, self.shapes, strict=True)}
