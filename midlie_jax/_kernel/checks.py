"""Input checks: a ValueError that names the argument, what was wrong and the cure, before anything is traced.

Shapes and dtypes are always known. Values are looked at only when they are concrete: inside jit, vmap or grad
nothing can be read, and failures come back as flags instead (`Path.ok`).
"""

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from operator import index
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .components import is_traced

FLOATS = ("float32", "float64")


def as_floats(name: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    """`value` as an array of float32 or float64 whose last axes are `shape`; leading axes are a batch.

    Integers become JAX's default float, as in NumPy's own functions.
    """
    try:
        # A Python integer as a Python float, which fits either dtype.
        array = jnp.asarray(float(value) if type(value) is int else value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers, got {described(value)}.") from error
    if jnp.issubdtype(array.dtype, jnp.integer):
        array = array.astype(jnp.result_type(float))
    if array.dtype.name not in FLOATS:
        raise ValueError(f"{name} must be float32 or float64, got {array.dtype}; cast it with .astype(jnp.float32).")
    if shape is not None and array.shape[max(array.ndim - len(shape), 0) :] != shape:
        raise ValueError(f"{name} must have shape {shape} (leading batch axes allowed), got {array.shape}.")
    return array


def as_function_of_time(name: str, value: Any) -> Array | Callable[[Any], Array]:
    """A vector (3,) that is finite, or a function of time that returns one."""
    if callable(value):
        return cast(Callable[[Any], Array], value)
    array = as_floats(name, value, (3,))
    require_finite(name, array)
    return array


def require_function(name: str, value: Any, arguments: str) -> None:
    if not callable(value):
        raise ValueError(f"{name} must be a function of ({arguments}), got {described(value)}.")


def as_count(name: str, value: Any) -> int:
    """`value` as a Python int of at least 1: a Python or NumPy integer, but no boolean and no traced number."""
    try:
        count = 0 if isinstance(value, (bool, np.bool_, Array)) else index(value)
    except TypeError:
        count = 0
    if count < 1:
        raise ValueError(f"{name} must be a positive Python int, got {shown(value)}.")
    return count


def require(name: str, value: Any, holds: Callable[[np.ndarray], Any], what: str, cure: str) -> None:
    """Raises unless `holds(value)` for every entry of the batch; a traced value passes unread."""
    if is_traced(value):
        return
    numbers = np.asarray(value)
    if not np.all(holds(numbers)):
        raise ValueError(f"{name} {what}, got {shown(numbers)}; {cure}")


def require_finite(name: str, value: Any) -> None:
    require(name, value, np.isfinite, "must be finite", "NaN or infinity came in from the caller.")


def is_unit(vectors: np.ndarray) -> Any:
    """Whether vectors are of length 1, to a thousandth: what rounding leaves in any dtype and file."""
    return np.abs(np.linalg.norm(np.asarray(vectors, np.float64), axis=-1) - 1) < 1e-3


def same_batch(**arrays: tuple[Array, int]) -> None:
    """Raises unless the leading axes agree, of arrays given with the number of their own axes."""
    leading = {name: array.shape[: array.ndim - own] for name, (array, own) in arrays.items()}
    if len(set(leading.values())) > 1:
        shapes = " and ".join(f"{name} {array.shape}" for name, (array, _) in arrays.items())
        raise ValueError(f"{shapes} must have the same leading axes, one entry a body; repeat what all bodies share.")


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


def unknown(kind: str, name: Any, known: Iterable[str], *, more: Iterable[str] = (), note: str = "") -> ValueError:
    """The error for a name that is not among those known: the nearest of these and `more`, and all that are known."""
    known = list(known)
    folded = {choice.casefold(): choice for choice in (*more, *reversed(known))}
    close = get_close_matches(str(name).casefold(), folded, n=1)
    choose = f"did you mean {folded[close[0]]!r}? Choose" if close else "choose"
    return ValueError(f"unknown {kind} {name!r}; {choose} from {', '.join(known)}. {note}".rstrip())


def described(value: Any) -> str:
    """What a value is, in a message: its type, and of an array its shape."""
    if isinstance(value, (jax.Array, np.ndarray)):
        return f"an array of shape {value.shape}"
    return type(value).__name__


def shown(value: Any) -> str:
    """A value in a message, short."""
    if is_traced(value):
        return described(value)
    if isinstance(value, (jax.Array, np.ndarray)):
        return np.array2string(np.asarray(value), threshold=12, precision=6)
    return repr(value)
