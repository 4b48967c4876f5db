"""Numbers of bodies: the forms of a mass of `Particles` with the shapes that each fits, and moments of a flat body."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import require, require_finite
from .._math import components as cp
from .._math.components import is_traced


def is_positive(numbers: np.ndarray) -> Any:
    return np.isfinite(numbers) & (numbers > 0)


def all_positive(numbers: Array) -> Array:
    numbers = jax.lax.stop_gradient(numbers)
    return jnp.all(jnp.isfinite(numbers) & (numbers > 0))


def is_matrix(mass: Array) -> bool:
    return mass.ndim == 2 and mass.shape[0] == mass.shape[1]


def checked(mass: Array) -> Array:
    """The mass as stored by `Particles`: a matrix as its Cholesky factor, any other form unchanged."""
    if mass.ndim > 2 or (mass.ndim == 2 and not is_matrix(mass) and 1 not in mass.shape):
        raise ValueError(f"mass must be a scalar, (n,), (n, 1), (1, n) or (n, n), got {mass.shape}; use jax.vmap.")
    if not is_matrix(mass):
        require("mass", mass, is_positive, "must be positive and finite", "give every coordinate a positive mass.")
        return mass
    require_finite("mass", mass)
    require("mass", mass, lambda m: np.allclose(m, m.T, rtol=1e-6), "must be symmetric", "pass (M + M.T) / 2.")
    factor = jnp.linalg.cholesky(mass)
    if not cp.is_traced(factor) and not np.all(np.isfinite(factor)):
        raise ValueError("mass must be positive definite: its Cholesky factorisation failed.")
    return factor


def check_fits(mass: Array, name: str, shape: tuple[int, ...]) -> None:
    """Raises unless the mass, as stored by `Particles`, belongs to one array of this shape and name in one way only."""
    form, values = mass.shape, f"{name} of shape {shape}"
    if is_matrix(mass):
        if shape != form[:1] and (form != (1, 1) or shape[:1] != (1,)):
            raise ValueError(
                f"body.mass must have one row per coordinate if it is a matrix, got {form} for {values}. Flatten the "
                "state to one axis."
            )
        return
    if not _broadcasts(form, shape):
        cure = f"give one mass (), or one for each coordinate {shape}"
        if len(shape) > 1:
            column, row = (shape[-2], 1), (1, shape[-1])
            cure = f"give one mass (), one for each particle, which is a row, {column}, or one for each column {row}"
        raise ValueError(f"body.mass {form} does not fit {values}; {cure}.")
    if len(form) == 1 and form[0] > 1 and form[0] in shape[:-1]:
        raise ValueError(
            f"body.mass must be a column or a row for {values}, got {form}. Write mass[:, None] for one mass per "
            "particle, or mass[None, :]."
        )


def _broadcasts(form: tuple[int, ...], shape: tuple[int, ...]) -> bool:
    return len(form) <= len(shape) and all(m in (1, n) for m, n in zip(form[::-1], shape[::-1], strict=False))


_MOST = 1e-3  # the largest violation relative to the sum of the moments, for any number of digits


def made_flat(moments: Array, tolerance: float) -> Array:
    """Moments (..., 3), with the largest lowered to the sum of the other two if rounding explains the excess.

    The last digit that all have bounds the rounding of each. Violations up to the tolerance change nothing.
    """
    if is_traced(moments):
        return moments
    rows = np.array(moments).reshape(-1, 3)
    total = rows.sum(axis=1)
    excess = 2 * rows.max(axis=1) - total
    changed = False
    for i in np.flatnonzero((excess > tolerance * total) & (excess <= _MOST * total)):
        row = rows[i]
        if excess[i] <= 1.5 * 1.001 * min(map(_last_digit, row)):
            largest = int(np.argmax(row))
            row[largest] = 0
            row[largest] = row.sum()
            changed = True
    return jnp.asarray(rows.reshape(moments.shape)) if changed else moments


def _last_digit(number: np.floating) -> float:
    """One unit in the last digit of the shortest decimal representation of a number."""
    mantissa, _, exponent = np.format_float_scientific(number, trim="-").partition("e")
    return 10.0 ** (int(exponent) - len(mantissa.partition(".")[2]))
