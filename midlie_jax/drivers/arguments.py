"""The arguments that every driver takes, checked in one place before anything is traced."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._kernel.checks import as_floats, described, require_finite, same_dtype, shown
from .._kernel.components import is_traced
from ..methods.base import Method
from ..methods.registry import method as find_method
from ..model.bodies import principal_of
from ..model.compatibility import check_batch, check_body, check_state, check_torque

LAST_STEP = 2**31 - 1  # steps are counted in 32 bits


def as_method(method: Any) -> Method:
    """The method, or that of the name; a ValueError for anything else."""
    found = find_method(method) if isinstance(method, str) else method
    if not isinstance(found, Method):
        raise ValueError(f"method must be a name or come from midlie_jax.method(name), got {described(method)}.")
    return found


def check_system(method: Method, body: Any, torque: Any, start: Any, *, batch: int = 0) -> Method:
    """Raises unless the four belong together, with `batch` leading axes of the state and as many or none of the body.

    Returns:
        The method, made for the body.
    """
    check_state("start", start)
    check_body(body, start)
    check_moves(method, body)
    check_torque(torque)
    check_batch("start", body, start, batch)
    for leaf in jax.tree.leaves(start):
        if leaf.dtype != start.momentum.dtype:
            raise ValueError(f"all of start must have one dtype, got {leaf.dtype} beside {start.momentum.dtype}.")
    same_dtype("start.momentum", start.momentum, body=body, torque=torque)
    for name, value in (("body", body), ("start", start), ("torque", torque)):
        for leaf in jax.tree.leaves(eqx.filter(value, eqx.is_inexact_array)):
            require_finite(name, leaf)
    return method.fitted(body)


def check_moves(method: Method, body: Any) -> None:
    """Raises unless the method moves such bodies."""
    if not isinstance(principal_of(body), method.bodies):
        raise ValueError(
            f"method {method.name!r} moves {method.bodies.__name__}, but body is {described(body)}; "
            "midlie_jax.methods() lists all."
        )


def as_scalar(name: str, value: Any, dtype: Any) -> Array:
    """A finite number () in the dtype of the run."""
    array = as_floats(name, value)
    if array.ndim:
        raise ValueError(f"{name} must be a scalar, got shape {array.shape}; map over a batch with jax.vmap.")
    array = array.astype(dtype)
    require_finite(name, array)  # in the dtype of the run, which may be narrower
    return array


def check_step(dt: Array) -> None:
    """Raises where a step is known to be zero, in the dtype of the run: time would stand still."""
    if not is_traced(dt) and not np.all(np.isfinite(dt) & (np.asarray(dt) != 0)):
        raise ValueError(f"dt must be finite and not zero, got {dt}.")


def check_saving(steps: int, save_every: int) -> None:
    """Raises unless whole intervals fit."""
    if steps % save_every:
        raise ValueError(f"steps ({steps}) must be divisible by save_every ({save_every}).")


def as_first_step(first_step: Any, steps: int) -> Array:
    """The index of the first step, (); a ValueError if it is no integer, or known to leave no room for `steps`."""
    if isinstance(first_step, (bool, np.bool_)) or not isinstance(first_step, (int, np.integer, np.ndarray, Array)):
        raise ValueError(f"first_step must be an integer, got {shown(first_step)}.")
    if not is_traced(first_step) and np.size(first_step) == 1 and not counts(np.asarray(first_step), steps):
        raise ValueError(
            f"first_step ({first_step}) and steps ({steps}) count beyond {LAST_STEP}; start again from the last state, "
            "with t0 its time and first_step 0."
        )
    index = jnp.asarray(first_step)
    if index.ndim or not jnp.issubdtype(index.dtype, jnp.integer):
        raise ValueError(f"first_step must be one integer, got {index.dtype}{list(index.shape)}.")
    return index.astype(jnp.int32) if index.dtype.itemsize < 4 else index


def counts(first_step: Any, steps: int) -> Any:
    """Whether 32 bits can count the steps."""
    below = True if jnp.issubdtype(first_step.dtype, jnp.unsignedinteger) else first_step > -LAST_STEP
    return (first_step <= LAST_STEP - steps) & below
