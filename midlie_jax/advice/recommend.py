"""`recommend`: the fastest method and step for a body, a torque and a tolerance, measured on the motion itself.

Each candidate is compiled once, with the number of steps as an argument, and run over a ladder of steps in which each
step is half the previous one. From a guess the ladder goes to larger steps until a run misses the tolerance, and to
smaller steps until halving the step changes the result by a small part of the tolerance. The result that changed least
is the reference for all errors, and the fastest candidate within the tolerance is recommended, with a step that `check`
calls sane. A candidate that is already slower than another one within the tolerance gets no smaller steps.
"""

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import described, shown
from ..drivers.arguments import as_scalar, check_system
from ..methods.registry import ENTRIES, exact_flight
from ..methods.registry import method as find_method
from ..methods.runge_kutta import RungeKutta
from ..methods.schemes import SCHEMES
from ..methods.system import System
from ..model import so3
from ..model.bodies import Body, RigidBody, principal_of
from ..model.rotor import Rotor
from ..model.state import AnyState
from ..model.torques import TorqueLike
from .check import check
from .facts import Facts
from .program import Program
from .timing import timed
from .trials import MOST_STEPS

_COPIES = 16  # copies of the body in each run: the time of a run is divided by this number
_SAFETY = 0.9  # fraction of the step that interpolation between two errors gives for the tolerance
_FIRST_TURN = 0.5  # radians by which the body turns per step of the first guess
_CONVERGED = 4  # converged: halving the step changes the end by less than the tolerance over this number
_SLOWER = 1.5  # a candidate is dropped once it takes this many times as long as the fastest within the tolerance
_SHORT = 0.01  # a run is timed again, up to five times, until its timings take this many seconds in total
_LONGEST = 1.0  # seconds; after a run of all copies that took longer, no smaller step is tried
_MOST_STEPS = 2**30
_LEAST = 64  # smallest tolerance, in units of eps: rounding hides smaller errors
_ROUNDING = 1e4  # in units of eps: a change below this that no longer decreases is rounding
_STIFF = 5  # a rate of the linearised equations is stiff if it exceeds the rate of the motion by this factor


class Trial(NamedTuple):
    """A method at one step.

    Attributes:
        method: its name.
        dt: step.
        steps: number of steps.
        error: error of the attitude at the end, Frobenius norm of the difference of rotation matrices.
        seconds: processor time of the whole motion for one body in a batch, without compiling.
        ok: whether every solve succeeded and every number is finite (see `Path.ok`).
    """

    method: str
    dt: float
    steps: int
    error: float
    seconds: float
    ok: bool


class Recommendation(NamedTuple):
    """The recommended method and step.

    Attributes:
        method: its name, for `integrate` and `ensemble`.
        dt, steps: the step, and the number of steps in the duration.
        error: measured error of the attitude at the end of the duration, Frobenius norm.
        seconds: measured processor time of the whole motion for one body in a batch.
        duration: duration of the motion.
        note: what limits the step, if it is not the error: the method's reach, a stiff torque, or `midlie_jax.check`;
            "" otherwise.
        tried: all runs.
    """

    method: str
    dt: float
    steps: int
    error: float
    seconds: float
    duration: float
    note: str
    tried: tuple[Trial, ...]


def recommend(
    body: Body,
    torque: TorqueLike | None,
    start: AnyState,
    *,
    tolerance: float,
    duration: float,
    t0: float | Array = 0.0,
    length: float | None = None,
    symplectic: bool = True,
    progress: bool | Callable[[int], Any] | None = None,
) -> Recommendation:
    """The fastest method of this package, and its step, for a given error at the end of a motion.

    The error is that of the attitude, or of the axis of an `AxisState`; for a body that travels, together with that of
    the position in units of `length`.

    Each candidate runs the motion for the whole duration. Compiling takes some seconds; long motions take longer. The
    recommendation holds for this duration, because errors grow with time, and for this machine, because times are
    measured on it.

    Args:
        body, torque, start: as for `integrate`.
        tolerance: largest error at the end, at most 1: the Frobenius norm of the difference of rotation matrices, or
            the length of the difference of two axes; for a body that travels, the root of the sum of the squares of
            this and of the error of the position over `length`.
        duration: duration of the motion; not zero, negative to integrate back in time.
        t0: the time of the start, ().
        length: for a body that travels, the error of the position that counts as 1; None otherwise.
        symplectic: True to try only symplectic methods, which also keep the energy over long runs; False to try
            Runge-Kutta methods, too.
        progress: whether to print the candidate being tried to stderr; by default only if that is a terminal. Or a
            function that is called with 1 after each candidate.

    Raises:
        ValueError: an argument is invalid, as for `integrate`; the tolerance is not positive, or not above rounding; or
            no candidate reached the tolerance (the message names a torque that is stiff or not finite).
    """
    if getattr(start, "several", False):
        raise ValueError(
            "recommend is for one body; of coupled bodies compare runs with dt and dt/2, first by JACOBI[SRKN6b]."
        )
    body_that_turns = principal_of(body).turning if isinstance(body, Body) else body
    if not isinstance(body_that_turns, RigidBody | Rotor):
        raise ValueError(f"recommend is for bodies that turn, got body {described(body)}.")
    if not hasattr(start, "attitude") and not hasattr(start, "axis"):
        raise ValueError(
            f"start must be a state with an attitude or an axis, such as midlie_jax.RigidState, got {described(start)}."
        )
    if (start.rotation is None) != (length is None):
        raise ValueError(
            "length is the error of the position that counts as 1: give it for a body that travels, and for no other; "
            f"start is a {type(start).__name__}."
        )
    try:
        tolerance = float(tolerance)
    except (TypeError, ValueError) as error:
        raise ValueError(f"tolerance must be a number, got {shown(tolerance)}.") from error
    least = _LEAST * float(jnp.finfo(start.momentum.dtype).eps)
    if not least <= tolerance <= 1:
        raise ValueError(
            f"tolerance must be at least {least:.0e}, to be told from rounding in {start.momentum.dtype}, and at most "
            f"1, got {tolerance!r}."
        )
    span = float(as_scalar("duration", duration, start.momentum.dtype))
    if span == 0:
        raise ValueError("duration must not be zero; give the time for which the motion is to be integrated.")
    t0 = as_scalar("t0", t0, start.momentum.dtype)
    refused = "recommend compares single motions, of which a heat bath makes another every time"
    check_system(find_method(_exact_method(body)), body, torque, start, bath=refused)
    names = candidates(body, torque, symplectic, reads_momentum=_reads_momentum(body, torque, start))
    guess = max(1, math.ceil(abs(span) * _speed(body, start) / _FIRST_TURN))
    runs: dict[str, dict[int, _Run]] = {}
    compiled: dict[str, _Candidate] = {}
    print_progress = _progress_printer(progress, len(names))
    for name in names:
        print_progress(name)
        compiled[name] = _Candidate(name, body, torque, start, span, t0, length)
        fastest = _fastest_seconds(runs, tolerance)
        runs[name] = dict(_ladder(compiled[name], guess, tolerance, fastest * _SLOWER))
        if callable(progress):
            progress(1)
    reference = min((end for ladder in runs.values() for end in _ends(ladder)), default=None, key=lambda end: end[0])
    if reference is None or reference[0] > tolerance / 3:
        raise ValueError(_why_none(body, torque, start, t0, span, tolerance, runs, reference))
    exact = reference[1]
    tried = {name: [_trial(name, span, n, run, exact) for n, run in sorted(runs[name].items())] for name in names}
    fits = sorted(fit for trials in tried.values() for fit in _fit(trials, tolerance))
    print_progress("")
    for _, name, steps in fits:
        longest = abs(check(name, body, torque, start, dt=span / steps, steps=min(steps, MOST_STEPS), t0=t0).suggested)
        fewest = math.ceil(abs(span) / longest) if longest > 0 else steps
        best = _confirmed(compiled[name], max(steps, fewest), exact, tolerance)
        if best is not None:
            every = (*(trial for trials in tried.values() for trial in trials), best)
            note = _limit(body, torque, start, t0, tried[name], best)
            if fewest > steps and not note:
                note = "a larger step is accurate enough here, but `check` does not call it sane."
            return Recommendation(best.method, best.dt, best.steps, best.error, best.seconds, span, note, every)
    raise ValueError(_why_none(body, torque, start, t0, span, tolerance, runs, reference))


def candidates(
    body: Body, torque: TorqueLike | None, symplectic: bool = True, reads_momentum: bool = False
) -> list[str]:
    """The methods that `recommend` tries: schemes with the body's exact flight, from high order to low; others last.

    Args:
        reads_momentum: whether the torque depends on the momentum.
    """
    flight = exact_flight(body)
    schemes = [scheme for scheme in SCHEMES.values() if scheme.leading]
    if torque is None or reads_momentum:  # every scheme has order 2 for a torque that depends on the momentum
        schemes = [min(schemes, key=lambda scheme: scheme.evaluations)]
    names = [f"{flight.name}[{scheme.name}]" for scheme in sorted(schemes, key=lambda scheme: -scheme.order)]
    # Runge-Kutta methods with a projection are as accurate and cost more.
    general = [m.name for m in (e.method for e in ENTRIES.values()) if isinstance(m, RungeKutta) and not m.projects]
    return names if symplectic else [*names, *general]


def _reads_momentum(body: Any, torque: Any, start: AnyState) -> bool:
    return System.of(body, torque, start, jnp.zeros((), start.momentum.dtype)).reads_momentum


def _exact_method(body: Body) -> str:
    return f"{exact_flight(body).name}[EA]"


def _place(states: Any, length: float | None) -> np.ndarray:
    """What is compared of the first of several states: its rotation matrix or axis, and position over `length`."""
    orientation = so3.to_matrix(states.attitude[0]) if hasattr(states, "attitude") else states.axis[0]
    parts = [np.ravel(np.asarray(orientation, np.float64))]
    if length is not None:
        parts.append(np.asarray(states.position[0], np.float64) / length)
    return np.concatenate(parts)


class _Run(NamedTuple):
    """The result of a run: the place at the end, (k,); whether all copies are ok; seconds for one body."""

    end: np.ndarray
    ok: bool
    seconds: float


class _Candidate:
    """A method compiled for the motion; runs and times it."""

    def __init__(
        self, name: str, body: Any, torque: Any, start: AnyState, span: float, t0: Array, length: float | None
    ):
        self.name, self.span, self.length = name, span, length
        starts = jax.tree.map(lambda x: jnp.tile(x, (_COPIES, 1)), start)
        self.program = Program(find_method(name), body, torque, starts, t0=t0)
        self.dtype = start.momentum.dtype
        # The time of a call with no steps, which is subtracted from the time of every run.
        self.idle = 0.0
        self.idle = min(self.run(0).seconds for _ in range(3))

    def whole(self, steps: int) -> int:
        """The least number of steps that the loop can take and that is not below `steps`."""
        return self.program.whole(steps)

    def run(self, steps: int) -> _Run:
        """A run of the whole motion in `steps` steps."""
        step = self.span / max(steps, 1)
        (states, ok), timing = timed(lambda: self.program.run(step, steps), least=1, longest=_SHORT)
        end = _place(states, self.length)
        seconds = max(timing.seconds / _COPIES - self.idle, 0.0)
        return _Run(end, bool(np.all(ok)) and bool(np.all(np.isfinite(end))), seconds)


def _ladder(candidate: _Candidate, guess: int, tolerance: float, patience: float) -> Iterator[tuple[int, _Run]]:
    """Runs, with their numbers of steps: fewer until a run misses the tolerance, then more until the end has converged.

    Args:
        patience: if a run takes longer than these seconds, no runs with more steps are tried.
    """
    steps = candidate.whole(guess)
    run = candidate.run(steps)
    yield steps, run
    coarse_steps, coarse_run = steps, run
    while coarse_run.ok and coarse_steps > candidate.program.unroll:
        coarse_steps = candidate.whole(coarse_steps // 2)
        before, coarse_run = coarse_run, candidate.run(coarse_steps)
        yield coarse_steps, coarse_run
        if not coarse_run.ok or _distance(before, coarse_run) > 2 * tolerance:
            break
    change, rounding = math.inf, _ROUNDING * float(np.finfo(candidate.dtype).eps)
    while run.seconds <= min(patience, _LONGEST / _COPIES) and 2 * steps <= _MOST_STEPS:
        steps = candidate.whole(2 * steps)
        before, run, last = run, candidate.run(steps), change
        change = _distance(before, run)
        yield steps, run
        if change < tolerance / _CONVERGED or last / 1.5 < change < rounding:
            return


def _distance(first: _Run, second: _Run) -> float:
    """The length of the difference of the ends of two runs; infinity if one of them failed."""
    return float(np.linalg.norm(first.end - second.end)) if first.ok and second.ok else math.inf


def _ends(ladder: dict[int, _Run]) -> Iterator[tuple[float, np.ndarray]]:
    """The ends of the runs, each with its change by the last halving of the step."""
    runs = [run for _, run in sorted(ladder.items())]
    for coarse, refined in pairwise(runs):
        change = _distance(coarse, refined)
        if math.isfinite(change):
            yield change, refined.end


def _fastest_seconds(runs: dict[str, dict[int, _Run]], tolerance: float) -> float:
    """Seconds of the fastest run so far whose end is within the tolerance of its ladder's last; infinity if none is."""
    seconds = [math.inf]
    for ladder in runs.values():
        ordered = [run for _, run in sorted(ladder.items())]
        seconds += [run.seconds for run in ordered if _distance(run, ordered[-1]) < tolerance]
    return min(seconds)


def _trial(name: str, span: float, steps: int, run: _Run, exact: np.ndarray) -> Trial:
    error = float(np.linalg.norm(run.end - exact)) if run.ok else math.inf
    return Trial(name, span / steps, steps, error, run.seconds, run.ok)


def _fit(trials: Sequence[Trial], tolerance: float) -> list[tuple[float, str, int]]:
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


def _confirmed(candidate: _Candidate, steps: int, exact: np.ndarray, tolerance: float) -> Trial | None:
    """The first trial within the tolerance, with `steps` steps or up to about twice as many; None if there is none."""
    for _ in range(6):
        steps = candidate.whole(steps)
        trial = _trial(candidate.name, candidate.span, steps, candidate.run(steps), exact)
        if trial.error <= tolerance:
            return trial
        steps = math.ceil(steps * 1.15)
    return None


def _limit(body: Any, torque: Any, start: AnyState, t0: Array, trials: Sequence[Trial], best: Trial) -> str:
    """What limits the step, if a larger step made a run fail rather than inaccurate; "" otherwise."""
    failed = [t for t in trials if t.steps < best.steps and not t.ok]
    if not failed or failed[-1].steps < best.steps / 4:
        return ""
    largest_rate, motion_rate = _rates(body, torque, start, t0)
    if largest_rate * abs(failed[-1].dt) > 1 and largest_rate > _STIFF * motion_rate:
        return f"the torque is stiff: larger steps are unstable. {_stiffness(largest_rate, motion_rate)}"
    return "larger steps turn the body beyond the reach of the flight's series."


def _why_none(
    body: Any,
    torque: Any,
    start: AnyState,
    t0: Array,
    span: float,
    tolerance: float,
    runs: dict[str, dict[int, _Run]],
    reference: tuple[float, np.ndarray] | None,
) -> str:
    """The message if there is nothing to recommend."""
    most = max(max(ladder) for ladder in runs.values())
    tried = f"with up to {most} steps of {span / most:.1e}"
    largest_rate, motion_rate = _rates(body, torque, start, t0)
    if not math.isfinite(largest_rate):
        return "the torque or its derivative is not finite at the start; check it for a division by zero."
    if largest_rate > _STIFF * motion_rate and not all(run.ok for ladder in runs.values() for run in ladder.values()):
        return (
            f"the torque is stiff: no method reached {tolerance:.1e} {tried}. {_stiffness(largest_rate, motion_rate)}"
        )
    if reference is None:
        return f"every run failed, {tried}; check the torque for NaN during the motion."
    return (
        f"no recommendation for a tolerance of {tolerance:.1e}: {tried}, halving the step still changes the end by "
        f"{reference[0]:.1e}. Use a larger tolerance, a shorter duration (a chaotic motion amplifies every error), "
        "or float64."
    )


def _stiffness(largest_rate: float, motion_rate: float) -> str:
    return (
        f"Its largest rate at the start is {largest_rate:.1e} per unit of time, while the rate of the motion is "
        f"{motion_rate:.1e}. Use an implicit solver of diffrax: Kvaerno5() with midlie_jax.RigidBodyTerm(body, torque)."
    )


def _speed(body: Any, start: Any) -> float:
    """|Omega| at the start; for a `Rotor`, that of its axis."""
    return float(np.linalg.norm(np.asarray(body.turning.velocity(start.momentum), np.float64)))


def _rates(body: Any, torque: Any, start: AnyState, t0: Array) -> tuple[float, float]:
    """The largest rate of the torque linearised at the start, and the rate of the motion itself.

    The rate of the motion is the larger of |Omega| and the square root of |d Omega/dt|.
    """
    method = find_method(_exact_method(body))
    facts = jax.tree.map(np.asarray, jax.jit(lambda: Facts.of(method, body, torque, start, t0))())
    largest = float(np.max(np.abs(facts.rates)))
    return largest, max(_speed(body, start), float(facts.acceleration) ** 0.5) if math.isfinite(largest) else math.inf


def _progress_printer(progress: Any, count: int) -> Callable[[str], None]:
    """A function that prints the name of the candidate being tried over its last line; the name "" erases the line."""
    if callable(progress) or not (sys.stderr.isatty() if progress is None else progress):
        return lambda name: None
    done = 0

    def print_progress(name: str) -> None:
        nonlocal done
        done += 1
        text = f"recommend: {name} ({done} of {count})" if name else ""
        print(f"\r{text:<60}", end="" if name else "\r", file=sys.stderr, flush=True)

    return print_progress
