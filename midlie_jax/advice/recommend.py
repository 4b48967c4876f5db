"""`recommend`: the fastest method and step for a body, a torque and a tolerance, measured on the motion itself.

Each candidate is run over a ladder of steps, each half the previous one. From a guess the ladder goes to larger steps
until a run misses the tolerance, then to smaller steps until halving the step changes the result by a small part of the
tolerance, or until another candidate is faster. The result that changed least is the reference for all errors. The
recommendation is the fastest candidate within the tolerance, with a step that `check` confirms as sane.
"""

import math
from collections.abc import Callable, Collection, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import described, progress_line, require, require_numbers, shown
from .._math import components as cp
from ..drivers.arguments import as_scalar, check_clock, check_system
from ..integrators.base import Method
from ..integrators.registry import ENTRIES, exact_flight
from ..integrators.registry import method as find_method
from ..integrators.runge_kutta import RungeKutta
from ..integrators.schemes import SCHEMES
from ..integrators.system import System
from ..model import so3
from ..model.bodies import Body, RigidBody, SymmetricRotor, principal_of
from ..model.compatibility import order_cure
from ..model.state import AnyState
from ..model.states import DirectionState, RigidState
from ..model.torques import TorqueLike, on_body
from .check import check
from .program import Program
from .timing import timed
from .trials import MOST_STEPS, Facts

_FIRST_TURN = 0.5  # rotation of the body per step of the first guess, radians
_SLOWER = 1.5  # a candidate is dropped once it is this many times slower than the fastest within the tolerance
_LEAST = 64  # smallest tolerance, in units of eps: rounding hides smaller errors
_WORTH = 0.9  # share of the run time below which another state is mentioned
_ATTITUDES = 6  # random attitudes at which a state with one direction must give the same torque
_TOLERANCE = 1e3  # in units of eps: a torque whose terms cancel has large rounding errors
_COPIES = 16  # copies of the body in each run; the time of a run is divided by this number
_SAFETY = 0.9  # fraction of the interpolated step for the tolerance
_CONVERGED = 4  # converged: halving the step changes the end by less than the tolerance divided by this number
_SHORT = 0.01  # a run is timed again, up to five times, until its timings take this many seconds in total
_LONGEST = 1.0  # seconds; after a longer run of all copies, no smaller step is tried
_MOST_OF_LADDER = 2**30  # steps
_ROUNDING = 1e4  # in units of eps: a change below this that no longer decreases is rounding
_STIFF = 5  # a rate of the linearised equations is stiff if it exceeds the rate of the motion by this factor


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
    """A run: its steps; the configuration at the end, (k,); whether all copies are ok; seconds for one body."""

    steps: int
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


class Recommendation(NamedTuple):
    """The recommended method and step.

    Attributes:
        method: its name, for `integrate` and `ensemble`.
        dt, steps: the step, and the number of steps in the duration.
        error: measured error of the attitude at the end of the duration, Frobenius norm.
        seconds: measured processor time of the whole motion for one body in a batch.
        duration: duration of the motion.
        note: the limit of the step, if it is not the error: the reach of the method, a stiff torque, or
            `midlie_jax.check`. For a Runge-Kutta method, also whether a `DirectionState` is faster because the torque
            reads one space direction only. "" otherwise.
        tried: all runs.

    Examples:
        >>> body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidState([0.2, 0.1, 2.5], [1.0, 0.0, 0.0, 0.0])
        >>> found = ml.recommend(body, None, start, tolerance=1e-3, duration=10.0)
        >>> path = ml.integrate(found.method, body, None, start, dt=found.dt, steps=found.steps)
        >>> bool(path.ok)
        True
    """

    method: str
    dt: float
    steps: int
    error: float
    seconds: float
    duration: float
    note: str
    tried: tuple[Trial, ...]

    def __str__(self) -> str:
        """The recommendation in a line, and the note."""
        found = f"{self.method}, dt {self.dt:.6g}, {self.steps} steps: error {self.error:.2g}"
        spent = f"{1e6 * self.seconds:.3g} us a body; the best of {len(self.tried)} runs"
        return "\n".join(filter(None, (f"{found}, {spent}", self.note)))


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

    Each candidate runs the motion for the whole duration. Compiling takes some seconds; long motions take longer. The
    recommendation holds for this duration, because errors grow with time, and for this machine, because times are
    measured on it.

    Args:
        body, torque, start: as for `integrate`.
        tolerance: largest error at the end, at most 1: the Frobenius norm of the difference of rotation matrices, or
            the length of the difference of two axes; for a body that translates, the root of the sum of the squares of
            this and of the error of the position over `length`.
        duration: duration of the motion; not zero, negative to integrate back in time.
        t0: the time of the start, ().
        length: for a body that translates, the error of the position that counts as 1, positive; None otherwise.
        symplectic: True to try only symplectic methods, which also conserve the energy over long runs; False to try
            Runge-Kutta methods as well.
        progress: whether to print the candidate being tried to stderr; by default only if that is a terminal. Or a
            function that is called with 1 after each candidate.

    Raises:
        ValueError: an argument is invalid, as for `integrate`, or is traced; the tolerance is not positive, or not
            above rounding; or no candidate reached the tolerance (the message names a torque that is stiff or not
            finite).

    Examples:
        >>> body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidState([0.2, 0.1, 2.5], [1.0, 0.0, 0.0, 0.0])
        >>> found = ml.recommend(body, None, start, tolerance=1e-3, duration=10.0)
        >>> found.method, found.error <= 1e-3  # a free body needs only the flight, which is exact
        ('JACOBI[EA]', True)
    """
    require_numbers("recommend", body, torque, start, tolerance, duration, t0, length)
    if getattr(start, "several", False):
        raise ValueError("start must be of one body for recommend. For coupled bodies compare runs with dt and dt/2.")
    body_that_turns = principal_of(body).turning if isinstance(body, Body) else body
    if not isinstance(body_that_turns, RigidBody | SymmetricRotor):
        raise ValueError(f"recommend supports rotating bodies, got body {described(body)}{order_cure(body)}.")
    if not hasattr(start, "attitude") and not hasattr(start, "axis"):
        raise ValueError(
            f"start must be a state with an attitude or an axis, such as midlie_jax.RigidState, got {described(start)}."
        )
    if (start.kind.rotation is None) != (length is None):
        raise ValueError(
            f"length must be given if and only if the body translates, got a {type(start).__name__}. It is the "
            "position error that counts as 1."
        )
    if length is not None:
        length = float(as_scalar("length", length, start.momentum.dtype))
        cure = "it is the error of the position that counts as 1."
        require("length", length, lambda x: x > 0, "must be positive", cure)
    try:
        tolerance = float(tolerance)
    except (TypeError, ValueError) as error:
        raise ValueError(f"tolerance must be a number, got {shown(tolerance)}.") from error
    least = _LEAST * float(jnp.finfo(start.momentum.dtype).eps)
    if not least <= tolerance <= 1:
        raise ValueError(
            f"tolerance must be at least {least:.0e}, above rounding in {start.momentum.dtype}, and "
            f"at most 1, got {tolerance!r}."
        )
    span = float(as_scalar("duration", duration, start.momentum.dtype))
    if span == 0:
        raise ValueError("duration must not be zero; give the duration of the motion.")
    t0 = as_scalar("t0", t0, start.momentum.dtype)
    refused = "recommend needs a deterministic run, and a heat bath is random"
    check_system(_exact_method(body), body, torque, start, bath=refused)
    system = System.of(body, torque, start, jnp.zeros((), start.momentum.dtype))
    names = candidates(body, torque, symplectic, reads_momentum=system.reads_momentum)
    case = Case(body, torque, start, t0, span, length)
    guess = max(1, math.ceil(abs(span) * _speed(case) / _FIRST_TURN))
    check_clock(t0, np.asarray(span / guess, start.momentum.dtype))
    compiled: dict[str, Candidate] = {}
    show = progress_line(progress)
    for n, name in enumerate(names, 1):
        show(f"recommend: {name} ({n} of {len(names)})")
        candidate = Candidate(name, case)
        # The fastest run so far that is within the tolerance of the last end of its ladder.
        ladders = [other.ladder() for other in compiled.values()]
        near = [run.seconds for runs in ladders for run in runs if distance(run, runs[-1]) < tolerance]
        candidate.climb(guess, tolerance, _SLOWER * min(near, default=math.inf))
        compiled[name] = candidate
        if callable(progress):
            progress(1)
    show("")
    ends = [end for candidate in compiled.values() for end in candidate.ends()]
    change, exact = min(ends, default=(math.inf, np.zeros(0)), key=lambda end: end[0])
    if change > tolerance / 3:
        raise ValueError(_why_none(case, tolerance, compiled.values(), change))
    tried = {name: [c.trial(run, exact) for run in c.ladder()] for name, c in compiled.items()}
    for _, name, steps in sorted(fit for trials in tried.values() for fit in fits_of(trials, tolerance)):
        longest = abs(check(name, body, torque, start, dt=span / steps, steps=min(steps, MOST_STEPS), t0=t0).suggested)
        fewest = math.ceil(abs(span) / longest) if longest > 0 else steps
        best = compiled[name].confirmed(max(steps, fewest), exact, tolerance)
        if best is not None:
            every = (*(trial for trials in tried.values() for trial in trials), best)
            note = _limit_of_step(case, tried[name], best)
            if fewest > steps and not note:
                note = "a larger step is accurate enough here, but `check` does not confirm it as sane."
            less = one_direction(case) if isinstance(find_method(name), RungeKutta) else None
            if less is not None:
                seconds = Candidate(name, case._replace(start=less)).run(best.steps).seconds
                if 0 < seconds < _WORTH * best.seconds:  # zero if the run is below the noise of the clock
                    note += (
                        " the torque reads one space direction only; without the attitude, on a "
                        f"midlie_jax.DirectionState, the same run is {best.seconds / seconds:.1f} times faster."
                    )
            return Recommendation(*best[:5], span, note.lstrip(), every)
    raise ValueError(_why_none(case, tolerance, compiled.values(), change))


class Candidate:
    """A method compiled for the motion, and its runs."""

    def __init__(self, name: str, case: Case):
        self.name, self.case = name, case
        starts = jax.tree.map(lambda x: jnp.tile(x, (_COPIES, 1)), case.start)
        self.program = Program(find_method(name), case.body, case.torque, starts, t0=case.t0)
        # The time of a call without steps, which is subtracted from the time of every run.
        self.idle = 0.0
        self.idle = min(self.run(0).seconds for _ in range(3))
        self.runs: list[Run] = []

    def run(self, steps: int) -> Run:
        step = self.case.span / max(steps, 1)
        (states, ok), timing = timed(lambda: self.program.run(step, steps), least=1, longest=_SHORT)
        end = _place(states, self.case.length)
        seconds = max(timing.seconds / _COPIES - self.idle, 0.0)
        return Run(steps, end, bool(np.all(ok)) and bool(np.all(np.isfinite(end))), seconds)

    def _added(self, steps: int) -> Run:
        """A further run with the smallest possible number of steps that is at least `steps`."""
        self.runs.append(self.run(self.program.whole(steps)))
        return self.runs[-1]

    def climb(self, guess: int, tolerance: float, patience: float) -> None:
        """Runs with fewer steps than `guess` until one misses the tolerance, then with more until the end has
        converged.

        If a run takes longer than `patience` seconds, no runs with more steps are tried.
        """
        run = coarse = self._added(guess)
        while coarse.ok and coarse.steps > self.program.unroll:
            before, coarse = coarse, self._added(coarse.steps // 2)
            if distance(before, coarse) > 2 * tolerance:
                break
        change, rounding = math.inf, _ROUNDING * float(np.finfo(self.case.start.momentum.dtype).eps)
        while run.seconds <= min(patience, _LONGEST / _COPIES) and 2 * run.steps <= _MOST_OF_LADDER:
            before, last, run = run, change, self._added(2 * run.steps)
            change = distance(before, run)
            if change < tolerance / _CONVERGED or last / 1.5 < change < rounding:
                return

    def ladder(self) -> list[Run]:
        return sorted(self.runs, key=lambda run: run.steps)

    def ends(self) -> list[tuple[float, np.ndarray]]:
        """The ends of the runs, each with its change by the last halving of the step."""
        changes = [(distance(coarse, refined), refined.end) for coarse, refined in pairwise(self.ladder())]
        return [(change, end) for change, end in changes if math.isfinite(change)]

    def trial(self, run: Run, exact: np.ndarray) -> Trial:
        error = float(np.linalg.norm(run.end - exact)) if run.ok else math.inf
        return Trial(self.name, self.case.span / run.steps, run.steps, error, run.seconds, run.ok)

    def confirmed(self, steps: int, exact: np.ndarray, tolerance: float) -> Trial | None:
        """The first trial within the tolerance, with `steps` steps or up to about twice as many; None without one."""
        for _ in range(6):
            steps = self.program.whole(steps)
            trial = self.trial(self.run(steps), exact)
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


def candidates(
    body: Body, torque: TorqueLike | None, symplectic: bool = True, reads_momentum: bool = False
) -> list[str]:
    """The methods for `recommend`: schemes with the exact flight of the body, from high order to low; then others."""
    flight = exact_flight(body)
    schemes = [scheme for scheme in SCHEMES.values() if scheme.leading]
    if torque is None or reads_momentum:  # every scheme has order 2 for a torque that depends on the momentum
        schemes = [min(schemes, key=lambda scheme: scheme.evaluations)]
    names = [f"{flight.name}[{scheme.name}]" for scheme in sorted(schemes, key=lambda scheme: -scheme.order)]
    # Runge-Kutta methods with a projection have the same accuracy and cost more.
    general = [m.name for m in (e.method for e in ENTRIES.values()) if isinstance(m, RungeKutta) and not m.projects]
    return names if symplectic else [*names, *general]


def _limit_of_step(case: Case, trials: Sequence[Trial], best: Trial) -> str:
    """The limit of the step, if a larger step made a run fail rather than inaccurate; "" otherwise."""
    failed = [t for t in trials if t.steps < best.steps and not t.ok]
    if not failed or failed[-1].steps < best.steps / 4:
        return ""
    rate, stiff = _stiffness(case)
    if stiff and rate * abs(failed[-1].dt) > 1:
        return f"the torque is stiff: larger steps are unstable. {stiff}"
    return "larger steps rotate the body beyond the reach of the flight's series."


def _why_none(case: Case, tolerance: float, candidates: Collection[Candidate], change: float) -> str:
    """Why there is no recommendation; `change` is the least change of the end by halving a step."""
    runs = [run for candidate in candidates for run in candidate.runs]
    most, failed = max(run.steps for run in runs), not all(run.ok for run in runs)
    tried = f"with up to {most} steps of {case.span / most:.1e}"
    rate, stiff = _stiffness(case)
    if not math.isfinite(rate):
        return "the torque or its derivative is not finite at the start; check it for a division by zero."
    if stiff and failed:
        return f"the torque is stiff: no method reached {tolerance:.1e} {tried}. {stiff}"
    if math.isinf(change):
        return f"every run failed, {tried}; check the torque for NaN during the motion."
    return (
        f"no recommendation for a tolerance of {tolerance:.1e}: {tried}, halving the step still changes the end by "
        f"{change:.1e}. Use a larger tolerance, a shorter duration (if the motion is chaotic), or float64."
    )


def _speed(case: Case) -> float:
    """|Omega| at the start; for a `SymmetricRotor`, the angular speed of its axis."""
    return float(np.linalg.norm(np.asarray(case.body.turning.velocity(case.start.momentum), np.float64)))


def _stiffness(case: Case) -> tuple[float, str]:
    """The largest rate of the torque linearised at the start, and a message if it is stiff; "" otherwise.

    The rate of the motion itself is the larger of |Omega| and the square root of |d Omega/dt|.
    """
    body, torque, start, t0, *_ = case
    method = _exact_method(body)
    facts = jax.tree.map(np.asarray, jax.jit(lambda: Facts.of(method, body, torque, start, t0))())
    rate, own = float(np.max(np.abs(facts.rates))), max(_speed(case), float(facts.acceleration) ** 0.5)
    if not math.isfinite(rate) or not rate > _STIFF * own:
        return rate, ""
    return rate, (
        f"Its largest rate at the start is {rate:.1e} per unit of time, while the rate of the motion is {own:.1e}. Use "
        "an implicit solver of diffrax: Kvaerno5() with midlie_jax.diffrax.RigidBodyTerm(body, torque)."
    )


def _exact_method(body: Body) -> Method:
    return find_method(f"{exact_flight(body).name}[EA]")


def one_direction(case: Case) -> DirectionState | None:
    """The start as a `DirectionState` with the same motion of the momentum; None if unknown, or if it has no attitude.

    The torque is called on a `DirectionState` that records the space directions it reads. Let them all be the same, d.
    If at random attitudes R and several times the torque is the same with R^T d as with R, it reads d alone.
    """
    body, torque, start, t0, span, _ = case
    if torque is None or type(start) is not RigidState:
        return None
    function, dtype, asked = on_body(torque, body), start.momentum.dtype, list[Any]()
    least = _TOLERANCE * jnp.finfo(dtype).eps

    class Asked(DirectionState):
        """A state that records the directions that a torque reads."""

        def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
            asked.append(vector)
            return super().seen_from_body(vector)

        def vertical(self) -> cp.Vector:
            asked.append((0.0, 0.0, 1.0))
            return super().vertical()

    try:
        function(t0, Asked(start.momentum, so3.to_matrix(start.attitude)[2]))
        if not asked or cp.is_traced(asked):
            return None
        vectors = np.array([[float(x) for x in vector] for vector in asked])
        vectors = vectors[np.any(vectors != 0, axis=1)]
        vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        if not len(vectors) or not np.all(np.abs(vectors - vectors[0]) <= least):
            return None
        d = jnp.asarray(vectors[0], dtype)
        turns = np.random.default_rng(0).normal(size=(_ATTITUDES, 4))
        attitudes = [start.attitude, *(jnp.asarray(q / np.linalg.norm(q), dtype) for q in turns)]
        seen = [DirectionState(start.momentum, so3.rotate(so3.conjugate(attitude), d)) for attitude in attitudes]
        for n, attitude in enumerate(attitudes):
            t = t0 + jnp.asarray(span * n / _ATTITUDES, dtype)
            whole = np.asarray(function(t, RigidState(start.momentum, attitude)))
            found = np.asarray(function(t, seen[n]))
            if not np.max(np.abs(found - whole)) <= least * np.max(np.abs(whole)):
                return None
        return seen[0]
    except (AttributeError, TypeError, ValueError, NotImplementedError):  # a `DirectionState` lacks what it reads
        return None
