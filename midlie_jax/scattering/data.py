"""Distributions from data: a random row of an array, or the row of the body; and random keys."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .base import Distribution, as_numbers


def _as_table(values: Any) -> np.ndarray:
    table = as_numbers("values", values)
    if not table.ndim or not len(table):
        raise ValueError(f"values must have at least one row along its first axis, got shape {table.shape}.")
    return table


class Rows(Distribution):
    """A row of measured data, drawn with replacement and with equal probabilities: the bootstrap.

    Correlated quantities must be columns of one array; otherwise their rows are drawn independently.

    Args:
        values: (m, ...), m rows of any shape.

    Raises:
        ValueError: the values have no rows, or are not finite numbers.

    Examples:
        >>> measured = np.array([[1.0, 0.1], [2.0, 0.3], [3.0, 0.2]])  # correlated columns
        >>> ml.scatter(jax.random.key(0), 1000, sizes=ml.distributions.Rows(measured))["sizes"].shape
        (1000, 2)
    """

    values: np.ndarray

    def __init__(self, values: Any):
        self.values = _as_table(values)

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del body, dtype
        return jnp.asarray(self.values)[jax.random.randint(key, (), 0, len(self.values))]


class Each(Distribution):
    """Row k for body k; nothing is drawn. Use it for given values, or for values drawn by another program.

    Args:
        values: (m, ...), one row for each body.

    Raises:
        ValueError: the values have no rows, or are not finite numbers. `midlie_jax.scatter` raises it for a body beyond
            the last row.

    Examples:
        >>> known = ml.distributions.Each([[1.0, 2.0, 2.5], [3.0, 3.0, 1.0]])
        >>> ml.scatter(jax.random.key(0), 2, moments=known)["moments"]
        Array([[1. , 2. , 2.5],
               [3. , 3. , 1. ]], dtype=float64)
    """

    values: np.ndarray

    def __init__(self, values: Any):
        self.values = _as_table(values)

    def check_bodies(self, name: str, indices: np.ndarray) -> None:
        if indices.size and indices.max() >= len(self.values):
            raise ValueError(
                f"{name} must have one row per body, got {len(self.values)} rows and body {indices.max()} (from "
                "0 on). Add rows, or use Rows to draw at random."
            )

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del key, dtype
        return jnp.asarray(self.values)[body]


class Key(Distribution):
    """A random key for each body, such as the `key` of `midlie_jax.baths.Langevin`.

    Examples:
        >>> drawn = ml.scatter(jax.random.key(0), 100, bath=ml.distributions.Key())
        >>> drawn["bath"].shape  # for the `key` of a heat bath, one for each body
        (100,)
    """

    def draw(self, key: Array, body: Array, dtype: Any) -> Array:
        del body, dtype
        return key
