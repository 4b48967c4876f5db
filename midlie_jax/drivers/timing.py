"""How runs are timed: the clocks, the statistic and its spread that all tables and charts of times share.

On the CPU a run is charged the processor time of this process. Wall time would also count what other programs take
of the machine: a factor of two and more where it is busy. On one core the two agree while the machine is quiet. On
several cores processor time adds up the threads, so it is what a run costs, not how long it takes. XLA moves a
batch of hundreds of bodies on one thread at a time, hands it from thread to thread where there are several cores, and
pays for that; so charts are measured on one core (`one_core`). An accelerator's work is no processor's: it is timed
by the wall clock.
"""

import contextlib
import math
import os
import statistics
import time
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple

import jax

_BUSY = 0.85  # share of its core below which a process was not alone on it


class Clock(NamedTuple):
    """Attributes:
    name: what it counts, as charts and tables say it.
    read: seconds since some moment.
    """

    name: str
    read: Callable[[], float]


def _processor() -> Clock:
    return Clock("processor time", time.process_time)


def _wall() -> Clock:
    return Clock("wall time", time.perf_counter)


def cost_clock() -> Clock:
    """What a run costs: processor time, all threads added up; wall time where an accelerator does the work."""
    return _processor() if jax.default_backend() == "cpu" else _wall()


def user_clock() -> Clock:
    """How long a user waits for a run on a quiet machine: processor time on one core, wall time elsewhere."""
    return cost_clock() if cores() == 1 else _wall()


class Timing(NamedTuple):
    """Several timings of the same work.

    Attributes:
        seconds: their median.
        spread: half the distance between their quartiles, relative to the median; NaN for one timing.
    """

    seconds: float
    spread: float

    def scaled(self, factor: float) -> "Timing":
        """The same for so many times the work."""
        return self._replace(seconds=self.seconds * factor)


class Stopwatch:
    """Collects timings of the same work, which may lie far apart."""

    def __init__(self, clock: Clock | None = None):
        self.clock = clock or cost_clock()
        self.laps: list[float] = []

    def time(self, run: Callable[[], Any]) -> Any:
        """The result of `run`, which must wait for it (`jax.block_until_ready`)."""
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


def timed(
    run: Callable[[], Any],
    *,
    least: int = 2,
    most: int = 5,
    longest: float = math.inf,
    clock: Clock | None = None,
) -> tuple[Any, Timing]:
    """The last result of a few runs in a row, and their timing. Where there are three or more, the first is left out:
    it fetches what the others find in the cache.

    Args:
        run: waits for its result.
        least: runs, whatever they take; one has no spread.
        most: runs at most.
        longest: seconds after which no further run begins.
        clock: `cost_clock()` unless told.
    """
    watch = Stopwatch(clock)
    while True:
        result = watch.time(run)
        count = len(watch.laps)
        if count >= least and (count >= most or sum(watch.laps) > longest):
            watch.laps = watch.laps[1:] if count > 2 else watch.laps
            return result, watch.timing()


def spread_in_words(spreads: Sequence[float]) -> str:
    """The middle and the largest of some spreads, for a chart or below a table."""
    known = [spread for spread in spreads if math.isfinite(spread)]
    if not known:
        return "of unknown spread"
    return f"spread ±{statistics.median(known):.0%} typically, ±{max(known):.0%} at most"


class Load:
    """How much of the machine this process got since this was made."""

    def __init__(self) -> None:
        self._wall, self._processor = time.perf_counter(), time.process_time()

    def share(self) -> float:
        """The part of the time in which the process had its core; on several cores, what load the system reports."""
        if cores() == 1 and jax.default_backend() == "cpu":
            return (time.process_time() - self._processor) / max(time.perf_counter() - self._wall, 1e-9)
        try:
            return (os.cpu_count() or 1) / max(os.getloadavg()[0], os.cpu_count() or 1)
        except (AttributeError, OSError):
            return 1.0

    def warning(self) -> str:
        """A sentence for the user if the machine was busy, else nothing."""
        share = self.share()
        if share > _BUSY:
            return ""
        return (
            f"The machine was busy: this process had {share:.0%} of the processor time that it asked for. Differences "
            "between times that are not much larger than their spread mean nothing; measure again on a quiet machine."
        )


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pin() -> None:
    """Leaves the process one core, so that all that is measured has the same; before JAX starts, which counts them."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


@contextlib.contextmanager
def one_core() -> Generator[None]:
    """Pins the process as `pin` does, and lets it go again."""
    before = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    pin()
    try:
        yield
    finally:
        if before is not None:
            os.sched_setaffinity(0, before)
