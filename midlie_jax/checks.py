"""Input checks: a ValueError that names the argument, what was wrong and the cure, before anything is traced.

Shapes and dtypes are always known. Values are looked at only when they are concrete: inside jit, vmap or grad
nothing can be read, and failures come back as flags instead (`Path.ok`).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ._components import is_traced


def as_floats(name: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    """`value` as a floating array whose last axes are `shape`; leading axes are a batch."""
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers, got {type(value).__name__}.") from error
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise ValueError(f"{name} must be floating point, got {array.dtype}; write 1.0 rather than 1.")
    if shape is not None and array.shape[array.ndim - len(shape) :] != shape:
        raise ValueError(f"{name} must have shape {shape} (leading batch axes allowed), got {array.shape}.")
    return array


def require(name: str, value: Any, holds: Callable[[np.ndarray], Any], what: str, cure: str) -> None:
    """Raises unless `holds(value)` for every entry of the batch; a traced value passes unread."""
    if is_traced(value):
        return
    numbers = np.asarray(value)
    if not np.all(holds(numbers)):
        raise ValueError(f"{name} {what}, got {_shown(numbers)}; {cure}")


def require_finite(name: str, value: Any) -> None:
    require(name, value, np.isfinite, "must be finite", "NaN or infinity came in from the caller.")


def same_dtype(reference_name: str, reference: Any, **others: Any) -> None:
    """Raises unless every floating leaf of `others` has the dtype of `reference` (weakly typed scalars fit any)."""
    dtype = jnp.result_type(reference)
    for name, value in others.items():
        for leaf in jax.tree.leaves(value):
            if isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating):
                weak = isinstance(leaf, jax.Array) and leaf.weak_type
                if leaf.dtype != dtype and not weak:
                    raise ValueError(
                        f"{name} is {leaf.dtype} but {reference_name} is {dtype}; cast one, e.g. "
                        f"jax.tree.map(lambda x: x.astype(jnp.{dtype}), {name})."
                    )


def _shown(numbers: np.ndarray) -> str:
    return np.array2string(numbers, threshold=12, precision=6)
