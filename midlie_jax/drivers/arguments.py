"""Checks of the arguments that all drivers share, before anything is traced."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import (
    LEAST_ULPS,
    as_count,
    as_floats,
    as_number,
    described,
    in_wider,
    require,
    require_finite,
    same_dtype,
    shown,
)
from .._math.components import is_traced
from .._xla.structure import once, once_for_numbers
from ..integrators.base import Method
from ..model.baths.base import HeatBath
from ..model.bodies import principal_of
from ..model.compatibility import body_named, check_batch, check_body, check_custom, check_state, check_torque
from ..model.orbits.base import orbits_in
from ..model.torques import Torque
from ..model.torques.by_step import check_steps
from ..model.torques.reads_body import without_bath

LAST_STEP = 2**31 - 1  # the largest step index: steps are counted in 32 bits


def as_method(method: Any) -> Method:
    """The argument itself if it is a method, or the method of that name; otherwise raises a ValueError."""
    if isinstance(method, str):
        from ..integrators import registry  # at the first name: the drivers know no particular method

        return registry.method(method)
    if not isinstance(method, Method):
        raise ValueError(f"method must be a name or come from midlie_jax.method(name), got {described(method)}.")
    return method


def check_system(
    method: Method,
    body: Any,
    torque: Any,
    start: Any,
    *,
    batch: int = 0,
    bath: str | None = None,
    of_one: Callable[[], tuple[Torque, Any]] | None = None,
) -> Method:
    """The method, fitted to the body; raises unless method, body, torque and initial state match.

    The state has `batch` leading axes, and the body as many or none. `bath` is the reason why no heat bath is possible
    here, if none is. `of_one` returns the torque on the first body of a batch and its state.
    """
    once(_check_structure, method, body, torque, start, batch, bath)
    if isinstance(torque, Torque):
        torque_of_one, one = (torque, start) if start.own_axes or of_one is None else of_one()
        torque_of_one.check(one)
    for name, value in (("body", body), ("start", start), ("torque", torque)):
        for leaf in jax.tree.leaves(value):
            if eqx.is_inexact_array(leaf) or isinstance(leaf, np.floating):
                require_finite(name, leaf)
    method.check(body, torque, start, batch)
    return once_for_numbers(type(method).fitted, method, body)


def _check_structure(method: Method, body: Any, torque: Any, start: Any, batch: int, bath: str | None) -> None:
    torque, heat = without_bath(torque)
    check_state("start", start)
    check_body(body, start)
    check_moves(method, body, start)
    check_torque(torque)
    check_bath(method, heat, bath)
    if heat is not None:
        heat.check_kind(start, body) if batch else heat.check_on(start, body)
    check_batch("start", body, start, batch)
    check_custom("start", body, start)
    for leaf in jax.tree.leaves(start):
        if leaf.dtype != start.momentum.dtype:
            raise ValueError(
                f"all of start must have one dtype, got {leaf.dtype} and {start.momentum.dtype}; cast one of them."
            )
    same_dtype("start.momentum", start.momentum, body=body, torque=torque, bath=heat)


def check_moves(method: Method, body: Any, start: Any) -> None:
    if not method.moves(principal_of(body)):
        raise ValueError(
            f"method {method.name!r} moves {method.bodies.__name__}, but body is {body_named(body)}; "
            "choose another method from midlie_jax.methods()."
        )
    if start.several and not method.several:
        raise ValueError(
            f"method {method.name!r} moves one body, but start is a {type(start).__name__}; take a flight with a "
            "scheme, such as JACOBI[EA], or GBS12."
        )


def check_bath(method: Method, bath: HeatBath | None, refused: str | None = None) -> None:
    """Raises if there is a heat bath and the method has no stage for it, or the reverse; `refused` as `bath` above."""
    if refused is not None and method.random:
        raise ValueError(f"{refused}; take a scheme without a bath, such as EA, not {method.name!r}.")
    if bath is not None and not method.random:
        raise ValueError(
            f"method must have a stage for the bath, a {type(bath).__name__}, got {method.name!r}; take a scheme with "
            f"one, such as {bath.methods}."
        )
    if bath is None and method.random:
        raise ValueError(
            f"method {method.name!r} has a stage for a heat bath, but bath is None; pass bath={method.bodies.bath}, or "
            "take a scheme without the stage, such as EA."
        )


def as_scalar(name: str, value: Any, dtype: Any) -> Array:
    """A finite number () in the dtype of the run."""
    given = as_floats(name, value)
    if given.ndim:
        raise ValueError(f"{name} must be a scalar, got shape {given.shape}; map over a batch with jax.vmap.")
    array = given.astype(dtype)
    _require_held(name, array, given)  # after the cast, because a narrower dtype may overflow to infinity
    return array


def as_argument(name: str, value: Any, dtype: Any) -> Any:
    """`as_scalar` for a program that is called at once; a Python number becomes a NumPy array, which is faster."""
    if isinstance(value, bool) or not isinstance(value, float | int):
        return as_scalar(name, value, dtype)
    array = as_number(name, value, dtype)
    _require_held(name, array, value)
    return array


def _require_held(name: str, array: Any, value: Any) -> None:
    """Raises unless a number cast to the dtype of the run is finite, and zero only if it was zero before."""
    if is_traced(array, value):
        return
    number, held = float(value), float(array)
    if np.isfinite(held) and (held or not number):
        return
    if np.isfinite(number):
        must = "not be zero" if not held else "be finite"
        cure = in_wider(array.dtype, "take other units")
        raise ValueError(f"{name} must {must} in {array.dtype}, got {number:.3g}; {cure}")
    require_finite(name, array)


def check_clock(t0: Any, dt: Any, first: Any = 0, steps: int = 0) -> None:
    """Raises unless the times t0 + n dt of a run are finite and distinct in the dtype of dt; traced times pass.

    With a step below `LEAST_ULPS` units in the last place of t0 a torque that depends on time would stand still, and
    then jump. Times are computed from the index, so the number of steps is not limited.
    """
    if is_traced(t0, dt, first):
        return
    dtype, last = np.asarray(dt).dtype, float(first) + steps
    t0, dt = (np.asarray(x, np.float64) for x in (t0, dt))
    limits, away, step = np.finfo(dtype), float(abs(t0).max()), abs(dt)
    shortest, longest = (float(step), float(step)) if step.ndim == 0 else (float(step.min()), float(step.max()))
    far = away + max(abs(last), abs(float(first))) * longest
    if far <= float(limits.max) and shortest >= LEAST_ULPS * float(limits.eps) * away:
        return  # the ordinary case; the check takes a few microseconds
    with np.errstate(over="ignore", invalid="ignore"):
        ends = [(t0 + n * dt).astype(dtype) for n in (last, float(first))]
    for end in ends:
        problem, cure = f"must be finite in {dtype}", in_wider(dtype, "choose a larger unit of time, or fewer steps")
        require("t0 + (first_step + steps) dt", end, np.isfinite, problem, cure)
    least, steps_of_all = np.broadcast_arrays(LEAST_ULPS * np.spacing(abs(t0).astype(dtype)), step)
    slow = steps_of_all < least
    if slow.any():
        raise ValueError(
            f"dt must be at least {LEAST_ULPS} units in the last place of t0, {least[slow][0]:.3g} in {dtype}, got "
            f"{steps_of_all[slow][0]:.3g}; {in_wider(dtype, 'count time from the start, with a small t0')}"
        )


def check_times(method: Method, torque: Any, t0: Any, dt: Any, first: Any, steps: int) -> None:
    """Raises like `check_clock`, or if the run needs the torque at times outside a table in it."""
    check_clock(t0, dt, first, steps)
    check_steps(torque, dt)
    if not orbits_in(torque) or is_traced(t0, dt, first):
        return
    before, after = method.asks
    t0, dt, first = (np.asarray(x, np.float64) for x in (t0, dt, first))
    ends = t0 + (first + before) * dt, t0 + (first + steps - 1 + after) * dt
    check_span("torque", torque, *ends)


def check_span(name: str, tree: Any, begin: Any, end: Any) -> None:
    for orbit in orbits_in(tree):
        span = orbit.span
        if span is None or is_traced(span):
            continue
        first, last = (np.asarray(x, np.float64) for x in span)
        low, high = np.min(np.minimum(begin, end)), np.max(np.maximum(begin, end))
        slack = 16 * np.finfo(np.asarray(span[0]).dtype).eps * max(np.abs(first).max(), np.abs(last).max())
        if low < first.max() - slack or high > last.min() + slack:
            raise ValueError(
                f"{name} holds a {type(orbit).__name__} from t = {first.max():.12g} to {last.min():.12g}, but the run "
                f"needs times from {low:.12g} to {high:.12g}; change t0, dt or steps, or make the table longer."
            )


def check_step(method: Method, dt: Any) -> None:
    """Raises if a step that is not traced is zero or not finite in the dtype of the run, or negative in a heat bath."""
    if is_traced(dt):
        return
    if not np.all(np.isfinite(dt) & (np.asarray(dt) != 0)):
        raise ValueError(f"dt must be finite and not zero, got {dt}.")
    if method.random and np.any(np.asarray(dt) < 0):
        raise ValueError(f"dt must be positive in a heat bath, which has no way back in time, got {dt}.")


def as_saving(save_every: Any, steps: int) -> int | None:
    """The steps between two saved states; None for the end alone. Raises a ValueError unless it divides `steps`."""
    if save_every is None:
        return None
    every = as_count("save_every", save_every)
    if steps % every:
        raise ValueError(f"steps ({steps}) must be divisible by save_every ({every}); change one of them.")
    return every


def as_first_step(first_step: Any, steps: int) -> Any:
    """The index of the first step, (); raises a ValueError if it is no integer, or the last index exceeds 32 bits."""
    if isinstance(first_step, (bool, np.bool_)) or not isinstance(first_step, (int, np.integer, np.ndarray, Array)):
        raise ValueError(f"first_step must be an integer, got {shown(first_step)}.")
    if not is_traced(first_step) and np.size(first_step) == 1 and not counts(np.asarray(first_step), steps):
        raise ValueError(
            f"first_step ({first_step}) and steps ({steps}) count beyond {LAST_STEP}; start a new run from the last "
            "state, with its time as t0 and first_step 0."
        )
    if isinstance(first_step, int):
        return np.asarray(first_step, np.int32)
    index = jnp.asarray(first_step)
    if index.ndim or not jnp.issubdtype(index.dtype, jnp.integer):
        raise ValueError(f"first_step must be one integer, got {index.dtype}{list(index.shape)}.")
    return index.astype(jnp.int32) if index.dtype.itemsize < 4 else index


def counts(first_step: Any, steps: int | Array) -> Any:
    """Whether every step index of the run fits 32 bits."""
    above_least = True if jnp.issubdtype(first_step.dtype, jnp.unsignedinteger) else first_step > -LAST_STEP
    return (first_step <= LAST_STEP - steps) & above_least
