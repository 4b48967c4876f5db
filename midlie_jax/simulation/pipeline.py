"""Computes the parts of a run in sequence, while a thread writes the earlier parts.

A long part of a run is computed in legs (`drivers/steps.py`) of a few seconds each. A checkpoint of the progress is
written after some of the legs. Only the elapsed time decides when, and the numbers do not depend on it.
"""

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, TypeVar

import jax
import numpy as np

from .parts import Computation, Progress
from .plan import Part
from .store import Memory

R = TypeVar("R")
_AHEAD = 2  # the most unfinished writes; with more, the computation waits for the first
# A kill loses the work since the last complete write: 15 s plus the time of the next write. It loses at most half a
# minute if no leg takes longer than planned, and no write takes longer than 15 s.
LEG = 5.0  # seconds planned for a leg
KEPT = 10.0  # seconds after which a checkpoint is written, at the end of a leg


class Pace:
    """The speed of the last leg of a run, and the time of its last checkpoint."""

    def __init__(self) -> None:
        self._began = self._kept = time.perf_counter()
        self._seconds = 0.0  # per step of a group; 0 while unknown

    def begin(self) -> int:
        """Called at the beginning of a leg; returns its number of steps, at first one."""
        self._began = time.perf_counter()
        return max(1, int(LEG / self._seconds)) if self._seconds else 1

    def end(self, steps: int) -> None:
        """Called at the end of a leg of `steps` steps; the first one also compiles, so the second is short as well."""
        self._seconds = (time.perf_counter() - self._began) / steps

    def due(self) -> bool:
        return time.perf_counter() - self._kept >= KEPT

    def kept(self) -> None:
        """Called when a checkpoint is being written."""
        self._kept = time.perf_counter()


def compute_and_write(
    computation: Computation,
    parts: Iterable[Part],
    groups: dict[int, Progress],
    file: Memory,
    written: Callable[[int], Any],
) -> None:
    """Computes and writes the parts in sequence; calls `written` in this thread with the body-steps of each write.

    After an error nothing more is written. After an interruption (ctrl-C) everything computed so far is written.
    """
    plan, pace, stopped = computation.plan, Pace(), False
    waiting: deque[Future[int]] = deque()
    new: tuple[Part, Progress, int] | None = None  # computed, but not yet passed to the writer

    def write(part: Part, progress: Progress, since: int) -> int:
        nonlocal stopped
        if stopped:
            return 0
        bodies, steps = plan.bodies_in(part.group), progress.steps
        try:
            if steps == plan.steps(part.span):
                file.write(part, progress.all_seen(), progress.first_bad[:bodies])
                progress = progress.after()
            file.keep(part.group, progress.stored(bodies))
        except Exception:  # `result()` raises it in the main thread; until then nothing more may be written
            stopped = True
            raise
        return bodies * (steps - since)

    with ThreadPoolExecutor(1, "writer") as writer:
        span, tables = None, None
        try:
            for part in parts:
                if part.span != span:
                    span, tables = part.span, computation.tables(part.span)
                progress, steps = groups[part.group], plan.steps(part.span)
                since = progress.steps
                while progress.steps < steps:
                    before = progress.steps
                    progress = computation.compute(part, progress, pace.begin(), tables)
                    pace.end(progress.steps - before)
                    new = part, progress, since
                    if progress.steps == steps or pace.due():
                        waiting.append(writer.submit(write, *new))
                        since, new = progress.steps, None
                        pace.kept()
                    while waiting and (waiting[0].done() or len(waiting) >= _AHEAD):
                        written(waiting.popleft().result())
                groups[part.group] = progress.after()
            while waiting:
                written(waiting.popleft().result())
        except KeyboardInterrupt:
            if new is not None:
                writer.submit(write, *new)
            raise


@contextmanager
def reported(progress: bool | Callable[[int], Any] | None, total: int, done: int) -> Generator[Callable[[int], Any]]:
    """A function that accepts the number of written body-steps; the first process shows a bar that begins at `done`."""
    if callable(progress):
        yield progress
        return
    if progress is False or jax.process_index() or find_spec("tqdm") is None:
        yield lambda work: None
        return
    from tqdm import tqdm

    shown: dict[str, Any] = {"unit": "body-steps", "unit_scale": True, "leave": False}
    shown["disable"] = None if progress is None else False  # None: unless stderr is a terminal
    with tqdm(total=total, initial=done, dynamic_ncols=True, **shown) as bar:
        yield bar.update


def all_succeed(work: Callable[[], R]) -> R:
    """The result of `work`, when all processes have theirs; raises in all if it raises in one, so that none waits."""
    if jax.process_count() == 1:
        return work()
    from jax.experimental.multihost_utils import process_allgather

    try:
        result = work()
    except Exception:
        process_allgather(np.array(True))  # informs the other processes
        raise
    failed = np.flatnonzero(process_allgather(np.array(False)))
    if failed.size:
        raise RuntimeError(f"process {failed[0]} of this run failed; its own message says why.")
    return result
