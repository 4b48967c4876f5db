"""The steps of a run with a constant step: `OneStep`, and `Leg`, the part of the steps between two stops.

`simulate` stores the progress of a run so often that at most half a minute of work can be lost. The number of steps in
this time depends on the machine, but results must not; it is therefore an argument of the program. A leg begins with
the progress at the end of the previous leg, because progress made again from a state may differ in the last bit.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from .._xla import budgets
from .._xla.mesh import NONE, Axes
from .._xla.platform import on_cpu
from ..integrators.base import Method, Progress
from ..integrators.system import System
from .clock import ends_of_step, ends_of_step_back
from .shared_inputs import SharedInputs


class OneStep(NamedTuple):
    """The steps of a run with a constant step `dt`; `t0` is the time of step 0."""

    method: Method
    system: System
    t0: Array
    dt: Array
    shared: SharedInputs | None = None
    axes: Axes = NONE

    @property
    def unroll(self) -> int:
        """Steps per iteration of a loop; one if the torque contains a loop, so that it is compiled once."""
        return 1 if self.system.placement.is_compiled_once else self.method.unroll

    def take(self, progress: Progress, step: tuple[Array, Any]) -> Progress:
        """The progress after a step, from its index and its prepared inputs."""
        n, row = step
        if self.shared is not None:
            return self.shared.advance(self.system, self.t0, self.dt, progress, n, row)
        ends = partial(ends_of_step, n)
        return self.method.advance(self.system.at_step(n), (self.t0, self.dt), ends, self.dt, progress, self.axes)[0]

    def take_back(self, progress: Progress, step: tuple[Array, Any]) -> tuple[Progress, Any]:
        """The progress before a step, and intermediate results for `take_again`."""
        method, ends = self.method, partial(ends_of_step_back, step[0])
        run = self.system, (self.t0, self.dt), ends, -self.dt, progress, self.axes, method.step_back
        progress, (_, known) = method.advance(*run)
        return progress, known

    def take_again(self, progress: Progress, step: tuple[Array, Any], known: Any) -> Progress:
        """`take` for the derivative alone, after `take_back`."""
        if self.shared is not None:
            return self.take(progress, step)
        again, ends = partial(self.method.step_again, known=known), partial(ends_of_step, step[0])
        return self.method.advance(self.system, (self.t0, self.dt), ends, self.dt, progress, self.axes, again)[0]

    def loop(
        self, progress: Progress, first: Array, iterations: Array, size: int = 1, rows: Any = None, skip: Any = 0
    ) -> Progress:
        """The progress after several iterations of `size` steps each; `iterations` is an argument of the compiled
        program.

        `first` is the index of the step that belongs to the first of `rows`; `skip` is the number of steps before.
        """

        def take(progress: Progress, number: Array) -> tuple[Progress, None]:
            row = jax.tree.map(lambda x: x[number], rows)
            return self.take(progress, (first + number, row)), None

        def iteration(i: Array, progress: Progress) -> Progress:
            begin = skip + i * size
            if size > self.unroll:
                numbers = begin + jnp.arange(size, dtype=jnp.int32)
                return jax.lax.scan(take, progress, numbers, unroll=self.unroll)[0]
            for k in range(size):
                progress, _ = take(progress, begin + k)
            return progress

        return jax.lax.fori_loop(0, iterations, iteration, progress)

    def counted(self, progress: Progress, first: Array, count: Array, rows: Any = None, skip: Any = 0) -> Progress:
        """The progress after a traced number of steps; arguments as for `loop`."""
        whole = count // self.unroll
        progress = self.loop(progress, first, whole, self.unroll, rows, skip)
        taken = whole * self.unroll
        return progress if self.unroll == 1 else self.loop(progress, first, count - taken, 1, rows, skip + taken)


class Leg(NamedTuple):
    begin: Array  # the step where the leg begins: 0 or the end of another leg
    end: Array
    judged: Array  # (), the steps of the whole run up to `end` if a gain of energy is judged there, else 0
    carried: Progress  # of each body at the beginning of the leg
    given: Progress | None  # at the beginning of the whole run if it is from a `Carry`


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
