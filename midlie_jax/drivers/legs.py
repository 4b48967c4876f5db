"""A leg: part of the steps of a run, between two stops; one program computes every leg.

`simulate` stores the progress of a run so often that at most half a minute of work can be lost. The number of steps in
this time depends on the machine, but results must not; it is therefore an argument of the program. A leg begins with
the progress at the end of the previous leg, because progress made again from a state may differ in the last bit.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from .._xla import budgets
from .._xla.platform import on_cpu
from ..integrators.base import Method, Progress
from .stepper import OneStep


class Leg(NamedTuple):
    """A leg from the step `begin`, 0 or the end of another leg, to the stop `end`.

    Attributes:
        judged: (), the steps of the whole run up to the end of the leg if a gain of energy is judged there, else 0.
        carried: the progress of each body at the beginning of the leg.
        given: the progress at the beginning of the whole run if it is from a `Carry`, else None.
    """

    begin: Array
    end: Array
    judged: Array
    carried: Progress
    given: Progress | None


def iteration(method: Method, save_every: int) -> int:
    """The steps between two stops; a leg can end after each iteration and at each saved state."""
    iterations = 1 if on_cpu() else -(-budgets.DEVICE_STEPS // method.unroll)
    return min(iterations * method.unroll, save_every)


def next_stop(begin: int, steps: int, iteration: int, save_every: int) -> int:
    """The first stop at least `steps` steps, and at least one, after the stop `begin`."""
    intervals, within = divmod(begin + max(steps, 1), save_every)
    return intervals * save_every + min(-(-within // iteration) * iteration, save_every)


def in_leg(
    leg: Leg, one: OneStep, first: Array, before: Array, save_every: int, rows: Any, progress: Progress
) -> Progress:
    """The progress after the steps both of the leg and of the interval of `save_every` steps after `before`."""
    begin, end = jnp.clip(leg.begin - before, 0, save_every), jnp.clip(leg.end - before, 0, save_every)
    size = iteration(one.method, save_every)
    whole, rest = divmod(save_every, size)
    progress = one.loop(progress, first, end // size - begin // size, size, rows, before + begin)
    if rest:  # the last iteration is shorter
        ends_here = (begin < save_every) & (end == save_every)
        progress = one.loop(progress, first, ends_here.astype(jnp.int32), rest, rows, before + whole * size)
    return progress
