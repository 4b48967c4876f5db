"""Computes the parts of a run in sequence, while a thread writes the earlier parts."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax

from .pace import Pace
from .parts import Computation, Progress
from .plan import Part
from .sink import Begun, Sink

_AHEAD = 2  # the most unfinished writes; with more, the computation waits for the first


def compute_and_write(
    computation: Computation,
    parts: Iterable[Part],
    groups: dict[int, Progress],
    sink: Sink,
    written: Callable[[int], Any],
) -> None:
    """Computes and writes the parts in sequence; calls `written` in this thread with the body-steps of each write.

    The progress of a long part is stored repeatedly, see `pace.py`. After an error nothing more is written. After an
    interruption (ctrl-C) everything computed so far is written.
    """
    plan, pace, stopped = computation.plan, Pace(), False
    waiting: deque[Future[int]] = deque()
    new: tuple[Part, Progress, int] | None = None  # computed, but not yet passed to the writer

    def write(part: Part, progress: Progress, since: int) -> int:
        nonlocal stopped
        if stopped:
            return 0
        try:
            real, seen = slice(plan.bodies_in(part.group)), progress.all_seen()
            if progress.steps == plan.steps(part.span):
                state = {name: x[real] for name, x in progress.state().items()}
                sink.write(part, seen, state, progress.first_bad[real])
            else:
                carried = [x[real] for x in jax.tree.leaves(progress.carried)]
                sink.keep(part, Begun(progress.steps, seen, carried, progress.first_bad[real]))
        except Exception:  # `result()` raises it in the main thread; until then nothing more may be written
            stopped = True
            raise
        return plan.bodies_in(part.group) * (progress.steps - since)

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
