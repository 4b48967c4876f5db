"""A candidate of `recommend`, compiled and timed at a ladder of steps, and the evaluation of such runs."""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..integrators.registry import method as find_method
from ..model import so3
from ..model.state import AnyState
from .program import Program
from .timing import timed

_COPIES = 16  # copies of the body in each run; the time of a run is divided by this number
_SAFETY = 0.9  # fraction of the interpolated step for the tolerance
_CONVERGED = 4  # converged: halving the step changes the end by less than the tolerance divided by this number
_SHORT = 0.01  # a run is timed again, up to five times, until its timings take this many seconds in total
_LONGEST = 1.0  # seconds; after a longer run of all copies, no smaller step is tried
_MOST_STEPS = 2**30
_ROUNDING = 1e4  # in units of eps: a change below this that no longer decreases is rounding


class Trial(NamedTuple):
    """A method at one step `dt`: the number of steps; the error of the attitude at the end, Frobenius norm of the
    difference of rotation matrices; the processor time of the whole motion for one body in a batch, without
    compiling.
    """

    method: str
    dt: float
    steps: int
    error: float
    seconds: float
    ok: bool


class Run(NamedTuple):
    """The result of a run: the configuration at the end, (k,); whether all copies are ok; seconds for one body."""

    end: np.ndarray
    ok: bool
    seconds: float


class Case(NamedTuple):
    """The motion for which methods are compared, of the duration `span`; `length` is as in `recommend`."""

    body: Any
    torque: Any
    start: AnyState
    t0: Array
    span: float
    length: float | None


class Candidate:
    """A method compiled for the motion; `runs` has all its runs by their numbers of steps."""

    def __init__(self, name: str, case: Case):
        self.name, self.case = name, case
        starts = jax.tree.map(lambda x: jnp.tile(x, (_COPIES, 1)), case.start)
        self.program = Program(find_method(name), case.body, case.torque, starts, t0=case.t0)
        # The time of a call without steps, which is subtracted from the time of every run.
        self.idle = 0.0
        self.idle = min(self.run(0).seconds for _ in range(3))
        self.runs = dict[int, Run]()

    def run(self, steps: int) -> Run:
        step = self.case.span / max(steps, 1)
        (states, ok), timing = timed(lambda: self.program.run(step, steps), least=1, longest=_SHORT)
        end = _place(states, self.case.length)
        seconds = max(timing.seconds / _COPIES - self.idle, 0.0)
        return Run(end, bool(np.all(ok)) and bool(np.all(np.isfinite(end))), seconds)

    def _added(self, steps: int) -> tuple[int, Run]:
        """A further run with the smallest possible number of steps that is at least `steps`."""
        steps = self.program.whole(steps)
        self.runs[steps] = self.run(steps)
        return steps, self.runs[steps]

    def climb(self, guess: int, tolerance: float, patience: float) -> None:
        """Runs with fewer steps than `guess` until one misses the tolerance, then with more until the end has
        converged.

        If a run takes longer than `patience` seconds, no runs with more steps are tried.
        """
        steps, run = coarse_steps, coarse_run = self._added(guess)
        while coarse_run.ok and coarse_steps > self.program.unroll:
            before = coarse_run
            coarse_steps, coarse_run = self._added(coarse_steps // 2)
            if distance(before, coarse_run) > 2 * tolerance:
                break
        change, rounding = math.inf, _ROUNDING * float(np.finfo(self.case.start.momentum.dtype).eps)
        while run.seconds <= min(patience, _LONGEST / _COPIES) and 2 * steps <= _MOST_STEPS:
            before, last = run, change
            steps, run = self._added(2 * steps)
            change = distance(before, run)
            if change < tolerance / _CONVERGED or last / 1.5 < change < rounding:
                return

    def ladder(self) -> list[Run]:
        return [run for _, run in sorted(self.runs.items())]

    def ends(self) -> list[tuple[float, np.ndarray]]:
        """The ends of the runs, each with its change by the last halving of the step."""
        changes = [(distance(coarse, refined), refined.end) for coarse, refined in pairwise(self.ladder())]
        return [(change, end) for change, end in changes if math.isfinite(change)]

    def trial(self, steps: int, run: Run, exact: np.ndarray) -> Trial:
        error = float(np.linalg.norm(run.end - exact)) if run.ok else math.inf
        return Trial(self.name, self.case.span / steps, steps, error, run.seconds, run.ok)

    def trials(self, exact: np.ndarray) -> list[Trial]:
        return [self.trial(steps, run, exact) for steps, run in sorted(self.runs.items())]

    def confirmed(self, steps: int, exact: np.ndarray, tolerance: float) -> Trial | None:
        """The first trial within the tolerance, with `steps` steps or up to about twice as many; None without one."""
        for _ in range(6):
            steps = self.program.whole(steps)
            trial = self.trial(steps, self.run(steps), exact)
            if trial.error <= tolerance:
                return trial
            steps = math.ceil(steps * 1.15)
        return None


def _place(states: Any, length: float | None) -> np.ndarray:
    """The compared quantities of the first state: rotation matrix, axis or direction; position over `length`."""
    if hasattr(states, "attitude"):
        orientation = so3.to_matrix(states.attitude[0])
    else:
        orientation = states.axis[0] if hasattr(states, "axis") else states.direction[0]
    end = np.ravel(np.asarray(orientation, np.float64))
    return end if length is None else np.append(end, np.asarray(states.position[0], np.float64) / length)


def distance(first: Run, second: Run) -> float:
    """The length of the difference of the ends of two runs; infinity if one of them failed."""
    return float(np.linalg.norm(first.end - second.end)) if first.ok and second.ok else math.inf


def fits_of(trials: list[Trial], tolerance: float) -> list[tuple[float, str, int]]:
    """[(seconds, method, steps)] for the tolerance, interpolated between two trials; [] if no trial reached it."""
    within = next((t for t in trials if t.ok and t.error <= tolerance), None)
    if within is None:
        return []
    coarser = [t for t in trials if t.steps < within.steps and t.ok]
    steps = within.steps
    if coarser and 0 < within.error < coarser[-1].error < 1:
        coarse = coarser[-1]
        slope = math.log(coarse.error / within.error) / math.log(within.steps / coarse.steps)
        steps = min(steps, math.ceil(coarse.steps * (coarse.error / tolerance) ** (1 / slope) / _SAFETY))
    return [(within.seconds * steps / within.steps, within.method, steps)]
