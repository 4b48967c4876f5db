"""A verdict: an integer from each step, which shows whether the step can be trusted and, if not, why.

It is the index of the member of `midlie_jax.RESULTS` that the path of the run returns, from the first step that failed.
A flight without a solve may return a number instead, its share of the reach, at less cost: at most 1 is fine, NaN is
not finite. The largest share in a step counts.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

FINE, UNSOLVED, BEYOND, NOT_FINITE, UNCOUNTED, UNFOLLOWED, LOST, IMPOSSIBLE, UNSTABLE, UNREACHED = map(
    np.int8, range(10)
)


def verdict(solved: Array | bool, *within: tuple[Array, float]) -> Array:
    """The verdict of a step from the success of its solve, and sizes with their bounds; all are NaN if its start is."""
    good, beyond, number = jnp.asarray(solved), jnp.asarray(False), jnp.asarray(not within)
    for size, bound in within:
        good, beyond, number = good & (size <= bound), beyond | (size > bound), number | (size == size)
    return jnp.where(good, FINE, jnp.where(beyond, BEYOND, jnp.where(number, UNSOLVED, NOT_FINITE)))


def as_verdict(ok: Array | bool) -> Array:
    """The verdict of a flight or step that returns only whether it succeeded, or its share of the reach."""
    ok = jnp.asarray(ok)
    if jnp.issubdtype(ok.dtype, jnp.floating):
        return jnp.where(ok <= 1, FINE, jnp.where(ok > 1, BEYOND, NOT_FINITE))
    return jnp.where(ok, FINE, UNSOLVED) if ok.dtype == np.bool_ else ok


def earlier(first: Array | bool, second: Array | bool) -> Array:
    """The verdict of two consecutive parts of a run, the earlier part first."""
    if first is True:
        return jnp.asarray(second)
    if all(jnp.issubdtype(jnp.result_type(part), jnp.floating) for part in (first, second)):
        return jnp.maximum(first, second)  # NaN if one of them is NaN
    first = as_verdict(first)
    return jnp.where(first == FINE, as_verdict(second), first)


def of_all(ok: Array | bool) -> Array | bool:
    """The verdict of several bodies, (), from theirs, (N,): failed if any failed; for shares, the largest."""
    if isinstance(ok, bool) or not ok.ndim:
        return ok
    return jnp.all(ok) if ok.dtype == np.bool_ else jnp.max(ok)


def at_start(body: Any, finite: Array | bool = True, counted: Array | bool = True) -> Array:
    """The verdict before the first step; `counted`: whether 32 bits count the steps."""
    good = jnp.where(finite, jnp.where(counted, FINE, UNCOUNTED), NOT_FINITE)
    return jnp.where(body.is_possible(), good, IMPOSSIBLE)


def is_fine(verdict: Array | bool) -> Array:
    return as_verdict(verdict) == FINE
