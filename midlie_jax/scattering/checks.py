"""Checks of the parameters of distributions."""

from typing import Any

import numpy as np

from .._checks.arguments import described, require, require_finite, shown
from .._math.components import is_traced

_ROUNDED = 1e-6  # allowed error of correlations, because numbers may have been rounded to float32


def as_numbers(name: str, value: Any) -> np.ndarray:
    """`value` as a finite float64 NumPy array, so that no digit depends on JAX's x64 setting; else a ValueError."""
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
    """The arrays, each broadcast to their common shape; raises a ValueError if there is none."""
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
    variances = np.diagonal(matrix)
    for k in np.flatnonzero(variances < 0):
        raise ValueError(
            f"covariance[{k}, {k}] is a variance and must not be negative, got {variances[k]:.3g}; pass the squares of "
            "the deviations."
        )
    deviations = np.sqrt(variances)
    unit = np.where(deviations > 0, deviations, 1)  # the unit of each number
    correlations = matrix / unit[:, None] / unit  # 0 for a number that does not vary
    for i, k in np.argwhere(((deviations == 0)[:, None] | (deviations == 0)) & (matrix != 0)):
        raise ValueError(
            f"covariance[{i}, {k}] is {matrix[i, k]:.3g}, but a variance is zero there, so it must be 0; pass 0."
        )
    if np.any(np.abs(correlations - correlations.T) > _ROUNDED):
        raise ValueError(
            f"covariance must be symmetric, got {shown(matrix)}; pass (C + C.T) / 2 if C differs by rounding."
        )
    for i, k in np.argwhere(np.abs(correlations) > 1 + _ROUNDED):
        raise ValueError(
            f"covariance[{i}, {k}] is {matrix[i, k]:.3g}, a correlation of {correlations[i, k]:.3g}; it must not "
            "exceed the product of the two deviations."
        )
    correlations = (correlations + correlations.T) / 2
    values, vectors = np.linalg.eigh(correlations)
    if values.min(initial=0.0) < -_ROUNDED * values.max(initial=0.0):
        raise ValueError(
            f"covariance must be positive semi-definite, but its correlations {shown(correlations)} have the "
            f"eigenvalue {values[0]:.3g}; check their signs."
        )
    return deviations[:, None] * ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T)
