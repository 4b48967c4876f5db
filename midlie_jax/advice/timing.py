"""Timing of runs: the clocks, the median and the spread for all tables and charts of times.

On the CPU the time of a run is the processor time of this process, the sum over its threads. Wall time would include
the time of other programs, a factor of two or more on a busy machine; on one core of a quiet machine the two agree.
XLA passes a batch of hundreds of bodies from thread to thread, which takes time with several cores, so charts are
measured on one core (`one_core`). Work on an accelerator takes no processor time, so runs there use the wall clock.
"""

import contextlib
import math
import os
import statistics
import time
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple

from .._xla.platform import cores, on_cpu

_BUSY = 0.85  # the machine was busy if this process got a smaller share of its core


class Clock(NamedTuple):
    """A clock: the kind of time, for charts and tables, and a function that reads it in seconds."""

    name: str
    read: Callable[[], float]


def _clock(of_processor: bool) -> Clock:
    return Clock("processor time", time.process_time) if of_processor else Clock("wall time", time.perf_counter)


def cost_clock() -> Clock:
    """The clock for the cost of a run: processor time of all threads; wall time on an accelerator."""
    return _clock(on_cpu())


def user_clock() -> Clock:
    """The clock for the waiting time of a user on a quiet machine: processor time on one core, wall time otherwise."""
    return _clock(on_cpu() and cores() == 1)


class Timing(NamedTuple):
    """The median of several timings of the same work, and half the distance between the quartiles, relative to it."""

    seconds: float
    spread: float


class Stopwatch:
    """Collects timings of the same work; other work may run in between."""

    def __init__(self, clock: Clock | None = None):
        self.clock = clock or cost_clock()
        self.laps: list[float] = []

    def time(self, run: Callable[[], Any]) -> Any:
        """The result of `run`, whose time is recorded; `run` must wait for its result (`jax.block_until_ready`)."""
        began = self.clock.read()
        result = run()
        self.laps.append(self.clock.read() - began)
        return result

    def timing(self) -> Timing:
        middle = statistics.median(self.laps)
        if len(self.laps) < 2 or not middle > 0:
            return Timing(middle, math.nan)
        low, _, high = statistics.quantiles(self.laps, n=4, method="inclusive")
        return Timing(middle, (high - low) / (2 * middle))


def timed(run: Callable[[], Any], **options: Any) -> tuple[Any, Timing]:
    """The last result of several consecutive runs, and their timing; options as for `timed_in_turn`."""
    return timed_in_turn([run], **options)[0]


def timed_in_turn(
    runs: Sequence[Callable[[], Any]],
    *,
    least: int = 2,
    most: int = 5,
    longest: float = math.inf,
    clock: Clock | None = None,
) -> list[tuple[Any, Timing]]:
    """The last result and the timing of each of several runs, which alternate and wait for their results.

    A temporary slowdown of the machine then affects all of them. For three or more rounds the first is not counted,
    because it loads the cache for the others. There are `least` to `most` rounds, none after `longest` seconds of the
    slowest run.
    """
    watches = [Stopwatch(clock) for _ in runs]
    while True:
        results = [watch.time(run) for watch, run in zip(watches, runs, strict=True)]
        count = len(watches[0].laps)
        if count >= least and (count >= most or max(sum(watch.laps) for watch in watches) > longest):
            for watch in watches:
                watch.laps = watch.laps[1:] if count > 2 else watch.laps
            return [(result, watch.timing()) for result, watch in zip(results, watches, strict=True)]


def spread_in_words(spreads: Sequence[float]) -> str:
    """The median and the largest of the spreads as text, for a chart or below a table."""
    known = [spread for spread in spreads if math.isfinite(spread)]
    if not known:
        return "of unknown spread"
    return f"spread ±{statistics.median(known):.0%} typically, ±{max(known):.0%} at most"


class Load:
    """The share of the machine that this process got since the object was created."""

    def __init__(self) -> None:
        self._wall, self._processor = time.perf_counter(), time.process_time()

    def warning(self) -> str:
        """A warning for the user if the machine was busy, else "".

        It is judged by the fraction of time in which the process had its core; on several cores, by the reported load.
        """
        share = 1.0
        if cores() == 1 and on_cpu():
            share = (time.process_time() - self._processor) / max(time.perf_counter() - self._wall, 1e-9)
        else:
            with contextlib.suppress(AttributeError, OSError):
                share = (os.cpu_count() or 1) / max(os.getloadavg()[0], os.cpu_count() or 1)
        if share > _BUSY:
            return ""
        return (
            f"The machine was busy: this process had {share:.0%} of the requested processor time. Only differences "
            "much larger than the spread are meaningful; measure again on a quiet machine."
        )


def pin() -> None:
    """Restricts the process to one core, for comparable times; call it before JAX starts, which counts the cores."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


@contextlib.contextmanager
def one_core() -> Generator[None]:
    """Restricts the process to one core, like `pin`, and undoes the restriction at the end."""
    before = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    pin()
    try:
        yield
    finally:
        if before is not None:
            os.sched_setaffinity(0, before)
