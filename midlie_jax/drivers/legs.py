"""A leg: some of the steps of a run, from one stop to another, computed by one program that serves every leg.

`simulate` stores the progress of a run often enough that at most half a minute of work can be lost. How many steps fit
in this time depends on the machine, but results must not. So the number of steps is an argument of the program, not a
part of it: all legs run the same compiled code. And a leg begins with the progress at the end of the previous leg, not
with a state, because progress made again from a state may differ in the last bit.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._xla.platform import on_cpu
from ..methods.base import Method, Progress
from ..methods.verdict import FINE

# About as many steps per iteration on an accelerator, where the host checks after each iteration whether to go on.
_LONG_ITERATION = 64


class Leg(NamedTuple):
    """Where a leg begins and ends, in steps from the start of the run.

    Attributes:
        begin: (), 0 or the end of another leg.
        end: (), a stop, see `next_stop`.
        carried: the progress of each body where the leg begins; its numbers are not read if `begin` is 0.
    """

    begin: Array
    end: Array
    carried: Progress


def iteration(method: Method, save_every: int) -> int:
    """The steps between two stops: after each iteration, and at each saved state, a leg can end."""
    iterations = 1 if on_cpu() else -(-_LONG_ITERATION // method.unroll)
    return min(iterations * method.unroll, save_every)


def next_stop(begin: int, steps: int, iteration: int, save_every: int) -> int:
    """The first stop at least `steps` steps, and at least one, after the stop `begin`."""
    intervals, within = divmod(begin + max(steps, 1), save_every)
    return intervals * save_every + min(-(-within // iteration) * iteration, save_every)


def nothing_carried(method: Method, mapped: Any, shared: Any, rows: int) -> Progress:
    """Progress of this many bodies whose numbers nobody reads: what the first leg of a run is given.

    Args:
        method, mapped, shared: as for `run_ensemble`.
        rows: the number of bodies.
    """

    def progress(arguments: Any) -> Progress:
        body, torque, start, dt, t0 = arguments
        system = method.system(body, torque, start, t0, dt)
        motion = system.motion(start)
        return Progress(motion, motion.momentum if method.keeps_force(system) else None, jnp.asarray(FINE))

    shapes = eqx.filter_eval_shape(progress, eqx.combine(jax.tree.map(lambda x: x[0], mapped), shared))
    return jax.tree.map(lambda x: jnp.zeros((rows, *x.shape), x.dtype), shapes)


def in_leg(
    leg: Leg,
    before: Array,
    save_every: int,
    method: Method,
    take: Callable[[Progress, Array], Progress],
    progress: Progress,
) -> Progress:
    """The progress after the steps that belong to both the leg and one interval between two saved states.

    Args:
        before: (), the number of steps before the interval.
        take: the progress after a step, from the progress before it and the number of the step in the interval.
        progress: the progress before these steps.
    """
    first, end = jnp.clip(leg.begin - before, 0, save_every), jnp.clip(leg.end - before, 0, save_every)
    size = iteration(method, save_every)
    iterations, rest = divmod(save_every, size)

    def some(begin: Array | int, count: int, progress: Progress) -> Progress:
        numbers = begin + jnp.arange(count, dtype=jnp.int32)
        return jax.lax.scan(lambda p, k: (take(p, k), None), progress, numbers, unroll=method.unroll)[0]

    progress = jax.lax.fori_loop(first // size, end // size, lambda i, p: some(i * size, size, p), progress)
    if rest:  # the last iteration is shorter
        ends_here = (first < save_every) & (end == save_every)
        progress = jax.lax.fori_loop(
            0, ends_here.astype(jnp.int32), lambda _, p: some(iterations * size, rest, p), progress
        )
    return progress
