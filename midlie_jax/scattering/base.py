"""The interface of distributions, and the checks of their arguments."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import numpy as np
from jax import Array

from .._checks.arguments import described, require, require_finite, shown
from .._math.components import is_traced

_ROUNDED = 1e-6  # allowed error of correlations, because numbers may have been rounded to float32


class Distribution(eqx.Module):
    """The distribution of one quantity over the bodies.

    Its arrays are the parameters. `midlie_jax.scatter` casts them to the dtype of the result before it draws.

    Examples:
        >>> moments = ml.distributions.LogNormal([5.0, 5.0, 1.0], 0.1)  # a distribution
        >>> ml.scatter(jax.random.key(0), 100, moments=moments)["moments"].shape
        (100, 3)
    """

    @abstractmethod
    def draw(self, key: Array, body: Array, dtype: Any) -> Any:
        """The value of one body: an array, or a tree of arrays, without the axis of bodies.

        This method is mapped over blocks of bodies and compiled. XLA may round a long computation in one loop
        differently for another number of threads; `RotationNear` shows how to divide the loop.

        Args:
            key: the typed key of this quantity and body.
            body: index of the body, an integer ().
            dtype: the dtype of the result and of the parameters.
        """

    def check_bodies(self, name: str, indices: np.ndarray) -> None:
        """Raises a ValueError if one of these bodies has no value; `name` is the name of the quantity."""
        del name, indices


def as_numbers(name: str, value: Any) -> np.ndarray:
    """`value` as a finite float64 NumPy array, so that no digit depends on JAX's x64 setting.

    Raises:
        ValueError: it is not an array of finite numbers, or it is traced.
    """
    if is_traced(value):
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


def as_spread(name: str, value: Any) -> np.ndarray:
    numbers = as_numbers(name, value)
    require(name, numbers, lambda x: x >= 0, "must not be negative", "pass the standard deviation, not its negative.")
    return numbers


def as_positive(name: str, value: Any) -> np.ndarray:
    numbers = as_numbers(name, value)
    require(name, numbers, lambda x: x > 0, "must be positive", "use Normal for numbers of either sign.")
    return numbers


def broadcast(**arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """The arrays, each broadcast to their common shape.

    Raises:
        ValueError: there is no common shape.
    """
    try:
        return tuple(np.array(x) for x in np.broadcast_arrays(*arrays.values()))
    except ValueError as error:
        shapes = " and ".join(f"{name} {x.shape}" for name, x in arrays.items())
        raise ValueError(
            f"{shapes} do not fit together; give both one shape, or one of them as a single number."
        ) from error


def covariance_root(covariance: Any, size: int, of: str) -> np.ndarray:
    """A matrix S with S S^T = covariance, which must be (size, size): deviations times a root of the correlations.

    The covariance itself is not decomposed, because rounding errors relative to its largest entry would destroy the
    small entries if the quantities differ much in size. The root of the correlations is the symmetric positive
    semi-definite one, which is unique. Cholesky's method fails for a semi-definite matrix, and a root from eigenvectors
    alone has program-dependent signs.

    Raises:
        ValueError: the covariance has another shape, is not symmetric, or has a negative variance, a correlation beyond
            1, or correlations with a negative eigenvalue.
    """
    matrix = as_numbers("covariance", covariance)
    if matrix.shape != (size, size):
        raise ValueError(
            f"covariance must have shape ({size}, {size}), one row for each number of {of}, got {matrix.shape}."
        )
    deviations, correlations = _deviations_and_correlations(matrix)
    values, vectors = np.linalg.eigh(correlations)
    if values.min(initial=0.0) < -_ROUNDED * values.max(initial=0.0):
        raise ValueError(
            f"covariance must be positive semi-definite, but its correlations {shown(correlations)} have the "
            f"eigenvalue {values[0]:.3g}; check their signs."
        )
    return deviations[:, None] * ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T)


def _deviations_and_correlations(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (d,) and correlations (d, d); the correlations of a number that does not vary are 0.

    Raises:
        ValueError: the covariance has none, or they are not symmetric, as for `covariance_root`.
    """
    variances = np.diagonal(covariance)
    for k in np.flatnonzero(variances < 0):
        raise ValueError(
            f"covariance[{k}, {k}] is a variance and must not be negative, got {variances[k]:.3g}; pass the squares of "
            "the deviations."
        )
    deviations = np.sqrt(variances)
    unit = np.where(deviations > 0, deviations, 1)  # the unit of each number
    correlations = covariance / unit[:, None] / unit
    varies = (deviations > 0)[:, None] & (deviations > 0)
    for i, k in np.argwhere(~varies & (covariance != 0)):
        raise ValueError(
            f"covariance[{i}, {k}] is {covariance[i, k]:.3g}, but a variance is zero there, so it must be 0; pass 0."
        )
    if np.any(np.abs(correlations - correlations.T) > _ROUNDED):
        raise ValueError(
            f"covariance must be symmetric, got {shown(covariance)}; pass (C + C.T) / 2 if C differs by rounding."
        )
    for i, k in np.argwhere(np.abs(correlations) > 1 + _ROUNDED):
        raise ValueError(
            f"covariance[{i}, {k}] is {covariance[i, k]:.3g}, a correlation of "
            f"{correlations[i, k]:.3g}; it must not exceed the product of the two deviations."
        )
    return deviations, (correlations + correlations.T) / 2
