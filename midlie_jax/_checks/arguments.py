"""Input checks: a ValueError that names the argument, the problem and the remedy, before tracing.

Shapes and dtypes are always checked. Values are checked only if they are concrete. Inside jit, vmap or grad they cannot
be read, and failures are reported as flags instead (`Path.ok`).
"""

import inspect
import sys
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from operator import index
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math.components import is_traced

FLOATS = ("float32", "float64")
_TOO_LARGE = "{name} must be finite, got an integer that is too large; check its units and write it as a float."
LEAST_ULPS = 4  # the smallest step of a clock, in units in the last place of its time
_NAMED = 8  # the largest number of rows that a message names


def as_floats(name: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    """`value` as an array of float32 or float64 whose last axes have the sizes `shape`; leading axes are a batch.

    Integers become JAX's default float type. Raises a ValueError for anything else.
    """
    try:
        # A Python integer becomes a Python float: a weak type, which works with float32 and float64.
        with np.errstate(over="ignore"):  # an error below is more specific than the warning
            array = jnp.asarray(float(value) if type(value) is int else value)
    except OverflowError as error:
        raise ValueError(_TOO_LARGE.format(name=name)) from error
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers, got {described(value)}.") from error
    if jnp.issubdtype(array.dtype, jnp.integer):
        array = array.astype(jnp.result_type(float))
    if array.dtype.name not in FLOATS:
        raise ValueError(f"{name} must be float32 or float64, got {array.dtype}; cast it with .astype(jnp.float32).")
    if array.dtype == np.float32 and not isinstance(value, Array) and getattr(value, "dtype", None) != np.float32:
        _require_held(name, value, array)
    if shape is not None and array.shape[max(array.ndim - len(shape), 0) :] != shape:
        raise ValueError(f"{name} must have shape {shape} (leading batch axes allowed), got {array.shape}.")
    return array


def as_finite(name: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    array = as_floats(name, value, shape)
    require_finite(name, array)
    return array


def as_positive(
    name: str, value: Any, shape: tuple[int, ...] | None = None, *, cure: str = "check its units."
) -> Array:
    array = as_floats(name, value, shape)
    require(name, array, lambda x: np.isfinite(x) & (x > 0), "must be positive and finite", cure)
    return array


def as_not_negative(name: str, value: Any, *, cure: str = "check its units.") -> Array:
    array = as_floats(name, value)
    require(name, array, lambda x: np.isfinite(x) & (x >= 0), "must be finite and not negative", cure)
    return array


def _require_held(name: str, value: Any, array: Array) -> None:
    """Raises if the largest of the numbers becomes infinite in float32, or is below all normal numbers."""
    if is_traced(array):
        return
    largest, limits = float(np.max(np.abs(np.asarray(value, np.float64)), initial=0.0)), np.finfo(np.float32)
    if 0 < largest < float(limits.tiny) or float(limits.max) < largest < np.inf:
        raise ValueError(
            f"{name} must be 0, or between {limits.tiny:.0e} and {limits.max:.0e} in float32, got "
            f"{largest:.3g}; {in_wider(np.float32, 'use other units')}"
        )


def as_weak(vector: Any) -> Array:
    """A concrete vector with a weak dtype, like a Python number, which adopts the dtype of a state."""
    with jax.ensure_compile_time_eval():  # so that its numbers are also concrete while a program is traced
        return jnp.stack([jnp.asarray(float(x)) for x in np.asarray(vector)])


def as_number(name: str, value: float | int, dtype: Any) -> np.ndarray:
    """A Python number as a NumPy array (); infinite if it is beyond the dtype."""
    try:
        with np.errstate(over="ignore"):
            return np.asarray(value, dtype)
    except OverflowError as error:
        raise ValueError(_TOO_LARGE.format(name=name)) from error


def is_key(value: Any) -> bool:
    return isinstance(value, Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key)


def as_function_of_time(name: str, value: Any) -> Array | Callable[[Any], Array]:
    if callable(value):
        require_function(name, value, "t")
        return cast(Callable[[Any], Array], value)
    return as_finite(name, value, (3,))


def vector_at(name: str, value: Any, t: Any) -> Array:
    """The vector (..., 3), or the value of a function of time; a ValueError if that is not a vector."""
    if not callable(value):
        return value
    vector: Any = value(t)
    if getattr(vector, "shape", ())[-1:] != (3,):  # of two components, JAX would read the last twice
        raise ValueError(
            f"{name} is a function of time, which must return an array (3,), got {described(vector)}; "
            "use jnp.array([x, y, z]) or jnp.stack([x, y, z])."
        )
    return vector


def require_function(name: str, value: Any, arguments: str) -> None:
    """Raises unless the value can be called with this number of arguments, which the message lists."""
    if not callable(value):
        raise ValueError(f"{name} must be a function of ({arguments}), got {described(value)}.")
    other = other_arguments(value, arguments.count(",") + 1)
    if other is not None:
        raise ValueError(f"{name} must be a function of ({arguments}), got one of ({', '.join(other)}).")


def other_arguments(function: Callable[..., Any], count: int) -> list[str] | None:
    """The argument names of a function that cannot be called with this many; None if it can, or if unknown."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # a function that is not written in Python
        return None
    try:
        signature.bind(*[None] * count)
    except TypeError:
        return list(signature.parameters)
    return None


def as_count(name: str, value: Any) -> int:
    """`value`, a Python or NumPy integer of at least 1, as a Python int; raises for a boolean or a JAX array."""
    try:
        count = 0 if isinstance(value, (bool, np.bool_, Array)) else index(value)
    except TypeError:
        count = 0
    if count < 1:
        raise ValueError(f"{name} must be a positive Python int, got {shown(value)}.")
    return count


def require(name: str, value: Any, holds: Callable[[np.ndarray], Any], problem: str, cure: str) -> None:
    """Raises "{name} {problem}, got {value}; {cure}" unless the value is traced or all of `holds(value)` are true."""
    if is_traced(value):
        return
    numbers = np.asarray(value)
    if not np.all(holds(numbers)):
        raise ValueError(f"{name} {problem}, got {shown(numbers)}; {cure}")


def in_wider(dtype: Any, cure: str = "") -> str:
    """Remedy for numbers that the dtype cannot hold: for float32 also float64, otherwise the given one."""
    if np.dtype(dtype) == np.float64:
        return f"{cure}."
    return f'{cure}{", or " if cure else ""}use float64: jax.config.update("jax_enable_x64", True).'


def cure_of(value: Any, cure: str) -> str:
    """Remedy for numbers: also float64, if they are infinite, or all zero, in float32."""
    if is_traced(value):
        return f"{cure}."
    numbers = np.asarray(value)  # NumPy's, because within jax.jit the numbers of a concrete JAX array would be traced
    lost = numbers.dtype == np.float32 and (np.isinf(numbers).any() or not numbers.any())
    return in_wider(np.float32, cure) if lost else f"{cure}."


def require_rows(name: str, value: Any, holds: Callable[[np.ndarray], Any], problem: str, cure: str) -> None:
    """`require` for vectors (..., n), or for their leading axes; for a batch the message names the wrong rows."""
    if is_traced(value):
        return
    numbers = np.asarray(value)
    held = np.asarray(holds(numbers))
    wrong = ~(held.all(-1) if held.ndim == numbers.ndim else held)
    if numbers.ndim < 2 or not wrong.any():
        require(name, value, holds, problem, cure)
        return
    rows = np.argwhere(wrong)
    named = ", ".join(str(tuple(row.tolist()) if len(row) > 1 else row.item()) for row in rows[:_NAMED])
    raise ValueError(
        f"{name} {problem}, in {len(rows)} of {wrong.size} rows: {named}{', ...' if len(rows) > _NAMED else ''}; the "
        f"first of these is {shown(numbers[tuple(rows[0])])}; {cure}"
    )


def require_numbers(caller: str, *values: Any) -> None:
    """Raises if a leaf of the values is traced, or if every new array would be."""
    traced = is_traced(*values)
    if traced or is_traced(jnp.zeros(())):
        what = "an argument is traced" if traced else "it is called within a function that is traced"
        raise ValueError(f"{caller} needs concrete numbers, but {what}; call it outside jit, vmap and grad.")


def require_finite(name: str, value: Any) -> None:
    if is_traced(value) or np.isfinite(np.asarray(value)).all():
        return
    require(name, value, np.isfinite, "must be finite", cure_of(value, "find the source of the NaN or infinity"))


def require_resolved(name: str, times: Any, dtype: Any, start: Any = None) -> None:
    """Raises if the dtype cannot distinguish the times (and the time `start`).

    Half of the intervals between two different times must be at least `LEAST_ULPS` units in the last place of the later
    time.
    """
    if is_traced(times, start):
        return
    numbers = np.asarray(times, np.float64)
    numbers = np.sort(numbers if start is None else np.append(numbers, float(start)))
    gaps = np.diff(numbers)
    gaps, ends = gaps[gaps > 0], np.maximum(np.abs(numbers[1:]), np.abs(numbers[:-1]))[gaps > 0]
    if not gaps.size or not np.isfinite(ends).all():
        return
    least = np.spacing(ends.astype(dtype)).astype(np.float64)
    if np.median(gaps / least) < LEAST_ULPS:
        raise ValueError(
            f"{name} must be at least {LEAST_ULPS} units in the last place apart, {LEAST_ULPS * least.max():.3g} in "
            f"{np.dtype(dtype)} at t = {ends.max():.9g}, got {np.median(gaps):.3g}; "
            f"{in_wider(dtype, 'count time from the start')}"
        )


def is_unit(vectors: np.ndarray) -> Any:
    """Whether vectors have length 1 to 1e-3, a tolerance for numbers rounded to float32 or read from a file."""
    return np.abs(np.linalg.norm(np.asarray(vectors, np.float64), axis=-1) - 1) < 1e-3


def same_batch(shapes: dict[str, tuple[int, ...]], trailing: int) -> None:
    """Raises unless the shapes of all arrays have the same axes before the last `trailing` ones."""
    if len({shape[: len(shape) - trailing] for shape in shapes.values()}) > 1:
        named = " and ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ValueError(f"{named} must have the same leading axes, one entry per body; repeat shared values.")


def same_dtype(reference_name: str, reference: Any, **others: Any) -> None:
    """Raises unless every floating-point leaf of `others` has the dtype of `reference` or is weakly typed."""
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
    """The error for a name that is not in `known`; it suggests the nearest name, also of `more`, and lists `known`."""
    known = list(known)
    by_folded_name = {choice.casefold(): choice for choice in (*more, *reversed(known))}
    nearest = get_close_matches(str(name).casefold(), by_folded_name, n=1)
    hint = f"did you mean {by_folded_name[nearest[0]]!r}? Choose" if nearest else "choose"
    return ValueError(f"unknown {kind} {name!r}; {hint} from {', '.join(known)}. {note}".rstrip())


def progress_line(progress: Any) -> Callable[[str], None]:
    """A function that writes a text over the last line of stderr; nothing if `progress` is False or a function, or None
    without a terminal.
    """
    shown = not callable(progress) and (sys.stderr.isatty() if progress is None else progress)
    return lambda text: print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True) if shown else None


def described(value: Any) -> str:
    """Text for messages: the shape of an array, the type of any other value."""
    if isinstance(value, (jax.Array, np.ndarray)):
        return f"an array of shape {value.shape}"
    return type(value).__name__


def shown(value: Any) -> str:
    """Text for messages: the value, shortened; for a traced value its shape."""
    if is_traced(value):
        return described(value)
    if isinstance(value, (jax.Array, np.ndarray)):
        return np.array2string(np.asarray(value), threshold=12, precision=6)
    return repr(value)
