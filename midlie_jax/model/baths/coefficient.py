"""Friction and diffusion of momentum: numbers, three numbers or tensors, or functions of time that return these."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import as_floats, require, require_finite, require_function, shown
from ..._math.components import is_traced
from ..bodies import is_symmetric, read_as_tensor
from ..exposure import ROUNDED


def as_coefficient(name: str, value: Any) -> Any:
    if callable(value):
        require_function(name, value, "t")
        return value
    numbers = as_floats(name, value)
    require_finite(name, numbers)
    if numbers.shape[-2:] != (3, 3) or is_traced(numbers):
        require(name, numbers, lambda x: x >= 0, "must not be negative", "check its sign.")
        return numbers
    tensor = np.asarray(numbers, np.float64)
    largest = np.abs(tensor).max(initial=0.0)
    if not is_symmetric(tensor):
        raise ValueError(
            f"{name} must be symmetric if it is a tensor, got {shown(tensor)}; pass (G + G.T) / 2; or, "
            f"{read_as_tensor(name)}."
        )
    least = float(np.linalg.eigvalsh(tensor).min(initial=0.0))
    if least < -ROUNDED * largest:
        raise ValueError(
            f"{name} must be positive semi-definite, but {shown(tensor)} has the eigenvalue {least:.3g}; check its "
            f"signs; or, {read_as_tensor(name)}."
        )
    return numbers


def at(value: Any, t: Array) -> Array:
    """The numbers at a time, in the dtype of the time; NaN if one is negative, or a tensor is not symmetric."""
    if not callable(value):
        return value.astype(t.dtype)
    found: Any = value(t)
    numbers = jnp.asarray(found).astype(t.dtype)
    if numbers.shape[-2:] != (3, 3):
        return jnp.where(numbers < 0, jnp.nan, numbers)
    off = jnp.abs(numbers - jnp.swapaxes(numbers, -1, -2))
    return jnp.where(jnp.any(off > ROUNDED * jnp.max(jnp.abs(numbers))), jnp.nan, numbers)


def shape_of(value: Any, dtype: Any) -> tuple[int, ...]:
    return jax.eval_shape(value, jax.ShapeDtypeStruct((), dtype)).shape if callable(value) else value.shape


def check_shape(name: str, shape: tuple[int, ...], state: Any) -> None:
    """Raises unless this is the shape of numbers for one body, or for these coupled bodies."""
    count = state.momentum.shape[-2] if state.several else None
    leading = shape[:-2] if shape[-2:] == (3, 3) else shape[:-1]
    if not (shape == () or (shape[-1] == 3 and leading in ((), (count,)))):
        wanted = "(), (3,) or (3, 3)" + ("" if count is None else f", or ({count}, 3) or ({count}, 3, 3)")
        raise ValueError(f"{name} of one run must be of shape {wanted}, got {shape}; more are for midlie_jax.ensemble.")


def check_travel(bath: str, name: str, value: Any, state: Any) -> None:
    """Raises unless the numbers for the translation are there if, and only if, the body translates."""
    kind = type(state).__name__
    if (state.kind.rotation is None) != (value is None):
        raise ValueError(
            f"a {kind} translates: give {bath} the {name}, or 0 for none."
            if state.kind.rotation is not None
            else f"a {kind} does not translate: leave out {name}."
        )
