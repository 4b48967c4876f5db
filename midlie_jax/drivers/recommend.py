"""Which method and step for this body, this torque and this error: tried out on the very motion, not looked up.

Each candidate is compiled once, with the number of steps as an argument, and runs over a ladder of steps, each half the
one before: down from a guess until it misses the tolerance, and up until a halving of the step changes next to nothing.
The end that changed least is what all are judged by, and the quickest within the tolerance wins. A candidate that is
slower already than one that has passed is not followed any further.
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

from .._kernel import components as cp
from .._kernel.checks import described, shown
from ..methods.registry import DEFAULT, ENTRIES, exact_flight
from ..methods.registry import method as find_method
from ..methods.runge_kutta import RungeKutta
from ..methods.schemes import SCHEMES
from ..methods.system import System
from ..model import so3
from ..model.bodies import RigidBody, TensorBody, principal_of
from ..model.observables import angular_velocity
from ..model.states import RigidState
from ..model.torques import TorqueLike
from .arguments import as_scalar, check_system
from .program import Program
from .timing import timed

_COPIES = 16  # bodies moved side by side: time is that of one among many
_SAFETY = 0.9  # of the step that the errors on both sides of the tolerance would allow
_FIRST_TURN = 0.5  # radians a step, by the guess
_SETTLED = 4  # the end is known once a halving of the step changes it by less than this share of the tolerance
_SLOWER = 1.5  # times the quickest that passed, at which a candidate is given up
_SHORT = 0.01  # seconds of runs that are timed again, five times at most
_LONGEST = 1.0  # seconds of a run beyond which no finer step is tried
_MOST_STEPS = 2**30
_LEAST = 64  # units of eps: a smaller tolerance is lost in rounding
_ROUNDING = 1e4  # units of eps below which a change that no longer falls is rounding
_STIFF = 5  # times the rate of the motion itself, above which a rate of the linearised equations is called stiff


class Trial(NamedTuple):
    """A method at one step.

    Attributes:
        method: its name.
        dt: step.
        steps: how many.
        error: of the attitude at the end, Frobenius norm of the difference of rotation matrices.
        seconds: processor time for one body among many, for the whole motion, compiling not counted.
        ok: whether every number could be trusted (see `Path.ok`).
    """

    method: str
    dt: float
    steps: int
    error: float
    seconds: float
    ok: bool


class Recommendation(NamedTuple):
    """What to use.

    Attributes:
        method: its name, for `integrate` and `ensemble`.
        dt, steps: the step, and how many make the duration.
        error: of the attitude at the end of the duration, measured; Frobenius norm.
        seconds: processor time for one body among many, for the whole motion, measured.
        duration: how long the motion was followed.
        note: what keeps the step from being larger, if not the error; "" otherwise.
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
    body: RigidBody | TensorBody,
    torque: TorqueLike | None,
    start: RigidState,
    tolerance: float,
    *,
    duration: float,
    symplectic: bool = True,
    progress: bool | None = None,
) -> Recommendation:
    """The quickest of our methods, and its step, for an error of attitude at the end of a motion.

    Runs each candidate on the motion, for the whole duration, in some seconds of compiling and more where the motion is
    long. A recommendation is for that duration: errors grow with time. The time a method takes is that of this machine.

    Args:
        body, torque, start: as for `integrate`.
        tolerance: of the attitude at the end, Frobenius norm of the difference of rotation matrices; at most 1.
        duration: how long the motion is followed, from time 0; not zero, negative for one back in time.
        symplectic: only methods that are, and so also keep the energy over long runs; False admits Runge and Kutta's.
        progress: whether to tell on stderr what is being tried; by default on a terminal.

    Raises:
        ValueError: arguments as for `integrate`; a tolerance that is not positive, or too small to be told from
            rounding; no candidate reached it (the message says if the torque is stiff, or not finite).
    """
    if not isinstance(start, RigidState):
        raise ValueError(f"start must be a midlie_jax.RigidState, whose attitude is judged, got {described(start)}.")
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
        raise ValueError("duration must not be zero.")
    check_system(find_method(DEFAULT), body, torque, start)
    names = candidates(body, torque, symplectic, reads_momentum=_reads_momentum(body, torque, start))
    guess = max(1, math.ceil(abs(span) * _speed(body, start) / _FIRST_TURN))
    runs: dict[str, dict[int, _Run]] = {}
    made: dict[str, _Candidate] = {}
    say = _teller(progress, len(names))
    for name in names:
        say(name)
        made[name] = _Candidate(name, body, torque, start, span)
        best = _quickest(runs, tolerance)
        runs[name] = dict(_ladder(made[name], guess, tolerance, best * _SLOWER))
    judge = min((end for ladder in runs.values() for end in _settled(ladder)), default=None, key=lambda end: end[0])
    if judge is None or judge[0] > tolerance / 3:
        raise ValueError(_why_none(body, torque, start, span, tolerance, runs, judge))
    tried = {name: [_trial(name, span, n, run, judge[1]) for n, run in sorted(runs[name].items())] for name in names}
    fits = sorted(fit for trials in tried.values() for fit in _fit(trials, tolerance))
    say("")
    for _, name, steps in fits:
        found = _confirmed(made[name], steps, judge[1], tolerance)
        if found is not None:
            every = (*(trial for trials in tried.values() for trial in trials), found)
            note = _limit(body, torque, start, tried[name], found)
            return Recommendation(found.method, found.dt, found.steps, found.error, found.seconds, span, note, every)
    raise ValueError(_why_none(body, torque, start, span, tolerance, runs, judge))


def candidates(
    body: RigidBody | TensorBody, torque: TorqueLike | None, symplectic: bool = True, reads_momentum: bool = False
) -> list[str]:
    """The methods that `recommend` tries: on the exact flight of the body, those of high order first."""
    flight = exact_flight(principal_of(body).moments)
    schemes = [scheme for scheme in SCHEMES.values() if scheme.leading]
    if torque is None or reads_momentum:  # a torque of the momentum lowers every scheme to order 2
        schemes = [min(schemes, key=lambda scheme: scheme.evaluations)]
    names = [f"{flight.name}[{scheme.name}]" for scheme in sorted(schemes, key=lambda scheme: -scheme.order)]
    general = [entry.method.name for entry in ENTRIES.values() if isinstance(entry.method, RungeKutta)]
    return names if symplectic else [*names, *general]


def _reads_momentum(body: Any, torque: Any, start: RigidState) -> bool:
    return System.of(body, torque, start, jnp.zeros((), start.momentum.dtype)).reads_momentum


class _Run(NamedTuple):
    """Where a run ended: the rotation matrix (3, 3); whether all was well; seconds for one body."""

    end: np.ndarray
    ok: bool
    seconds: float


class _Candidate:
    """A method on a motion, and how long its runs take."""

    def __init__(self, name: str, body: Any, torque: Any, start: RigidState, span: float):
        self.name, self.span = name, span
        starts = jax.tree.map(lambda x: jnp.tile(x, (_COPIES, 1)), start)
        self.program = Program(find_method(name), body, torque, starts)
        self.dtype = start.momentum.dtype
        # What a call costs that takes no step is no part of a longer run.
        self.idle = 0.0
        self.idle = min(self.run(0).seconds for _ in range(3))

    def whole(self, steps: int) -> int:
        """The next number of steps that the loop can do."""
        return self.program.whole(steps)

    def run(self, steps: int) -> _Run:
        """A run of the whole motion in so many steps."""
        step = self.span / max(steps, 1)
        (states, ok), timing = timed(lambda: self.program.run(step, steps), least=1, longest=_SHORT)
        end = np.asarray(so3.to_matrix(states.attitude[0]), np.float64)
        seconds = max(timing.seconds / _COPIES - self.idle, 0.0)
        return _Run(end, bool(np.all(ok)) and bool(np.all(np.isfinite(end))), seconds)


def _ladder(candidate: _Candidate, guess: int, tolerance: float, patience: float) -> Iterator[tuple[int, _Run]]:
    """Runs by number of steps: coarser until one misses the tolerance, and finer until the end has settled."""
    steps = candidate.whole(guess)
    run = candidate.run(steps)
    yield steps, run
    coarse, finer = steps, run
    while finer.ok and coarse > candidate.program.unroll:
        coarse = candidate.whole(coarse // 2)
        before, finer = finer, candidate.run(coarse)
        yield coarse, finer
        if not finer.ok or _apart(before, finer) > 2 * tolerance:
            break
    change, rounding = math.inf, _ROUNDING * float(np.finfo(candidate.dtype).eps)
    while run.seconds <= min(patience, _LONGEST / _COPIES) and 2 * steps <= _MOST_STEPS:
        steps = candidate.whole(2 * steps)
        before, run, last = run, candidate.run(steps), change
        change = _apart(before, run)
        yield steps, run
        if change < tolerance / _SETTLED or last / 1.5 < change < rounding:
            return


def _apart(one: _Run, other: _Run) -> float:
    """How far two ends are apart; infinity where one of them is none."""
    return float(np.linalg.norm(one.end - other.end)) if one.ok and other.ok else math.inf


def _settled(ladder: dict[int, _Run]) -> Iterator[tuple[float, np.ndarray]]:
    """Ends, each with what the last halving of the step changed."""
    runs = [run for _, run in sorted(ladder.items())]
    for coarse, fine in pairwise(runs):
        change = _apart(coarse, fine)
        if math.isfinite(change):
            yield change, fine.end


def _quickest(runs: dict[str, dict[int, _Run]], tolerance: float) -> float:
    """The seconds of the quickest run so far that its own ladder says is within the tolerance; infinity if none is."""
    found = [math.inf]
    for ladder in runs.values():
        ordered = [run for _, run in sorted(ladder.items())]
        found += [run.seconds for run in ordered if _apart(run, ordered[-1]) < tolerance]
    return min(found)


def _trial(name: str, span: float, steps: int, run: _Run, end: np.ndarray) -> Trial:
    error = float(np.linalg.norm(run.end - end)) if run.ok else math.inf
    return Trial(name, span / steps, steps, error, run.seconds, run.ok)


def _fit(trials: Sequence[Trial], tolerance: float) -> list[tuple[float, str, int]]:
    """(seconds, method, steps) from the trials on both sides of the tolerance; nothing if it was not reached."""
    fine = next((t for t in trials if t.ok and t.error <= tolerance), None)
    if fine is None:
        return []
    coarser = [t for t in trials if t.steps < fine.steps and t.ok]
    steps = fine.steps
    if coarser and 0 < fine.error < coarser[-1].error < 1:
        coarse = coarser[-1]
        slope = math.log(coarse.error / fine.error) / math.log(fine.steps / coarse.steps)
        steps = min(steps, math.ceil(coarse.steps * (coarse.error / tolerance) ** (1 / slope) / _SAFETY))
    return [(fine.seconds * steps / fine.steps, fine.method, steps)]


def _confirmed(candidate: _Candidate, steps: int, end: np.ndarray, tolerance: float) -> Trial | None:
    """The run with so many steps, or a few more, that is within the tolerance; None if there is none near."""
    for _ in range(6):
        steps = candidate.whole(steps)
        found = _trial(candidate.name, candidate.span, steps, candidate.run(steps), end)
        if found.error <= tolerance:
            return found
        steps = math.ceil(steps * 1.15)
    return None


def _limit(body: Any, torque: Any, start: RigidState, trials: Sequence[Trial], found: Trial) -> str:
    """What keeps the step from being larger, where a larger one fails rather than being inaccurate."""
    failed = [t for t in trials if t.steps < found.steps and not t.ok]
    if not failed or failed[-1].steps < found.steps / 4:
        return ""
    fastest, own = _rates(body, torque, start)
    if fastest * abs(failed[-1].dt) > 1 and fastest > _STIFF * own:
        return f"the torque is stiff: larger steps are unstable. {_stiffness(fastest, own)}"
    return "larger steps turn the body further than the flight's series reach."


def _why_none(
    body: Any,
    torque: Any,
    start: RigidState,
    span: float,
    tolerance: float,
    runs: dict[str, dict[int, _Run]],
    judge: tuple[float, np.ndarray] | None,
) -> str:
    """Why there is nothing to recommend."""
    finest = max(max(ladder) for ladder in runs.values())
    tried = f"with up to {finest} steps of {span / finest:.1e}"
    fastest, own = _rates(body, torque, start)
    if not math.isfinite(fastest):
        return "the torque or its derivative is not finite at the start; check it for a division by zero."
    if fastest > _STIFF * own and not all(run.ok for ladder in runs.values() for run in ladder.values()):
        return f"the torque is stiff: no method reached {tolerance:.1e} {tried}. {_stiffness(fastest, own)}"
    if judge is None:
        return f"every run failed, {tried}; check the torque for NaN along the way."
    return (
        f"no recommendation for a tolerance of {tolerance:.1e}: {tried}, halving the step still changes the end by "
        f"{judge[0]:.1e}. Use a larger tolerance, a shorter duration (a chaotic motion forgets its start), or float64."
    )


def _stiffness(fastest: float, own: float) -> str:
    return (
        f"Its fastest rate at the start is {fastest:.1e} per unit of time, that of the motion itself {own:.1e}. An "
        "implicit solver of diffrax takes such a torque: Kvaerno5() with a midlie_jax.RigidBodyTerm(body, torque)."
    )


def _speed(body: Any, start: RigidState) -> float:
    """|Omega| at the start."""
    return float(np.linalg.norm(np.asarray(angular_velocity(body, start), np.float64)))


def _rates(body: Any, torque: Any, start: RigidState) -> tuple[float, float]:
    """The fastest rate of the equations of motion linearised at the start, and that at which the motion itself changes.

    The one is the largest modulus of an eigenvalue; the other |Omega|, or the root of its rate of change.
    """
    leaves, structure = jax.tree.flatten(start)
    one, zero = jnp.ones((), start.momentum.dtype), jnp.zeros((), start.momentum.dtype)
    # Bodies given by a tensor have the same eigenvalues in their principal axes.
    system = System.of(body, torque, start, zero)

    def rates(flat: Array) -> Array:
        state = jax.tree.unflatten(structure, (flat[:3], flat[3:]))
        motion = system.motion(state)
        rate = system.rates(motion, one, system.force(zero, motion))
        return jnp.concatenate([cp.pack(system.vector_in_user_axes(rate.momentum)), cp.pack(rate.pose)])

    flat = jnp.concatenate(leaves)
    rate, slope = (np.asarray(f(flat), np.float64) for f in (jax.jit(rates), jax.jit(jax.jacfwd(rates))))
    if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(rate))):
        return math.inf, math.inf
    change = np.asarray(body.velocity(jnp.asarray(rate[:3], start.momentum.dtype)), np.float64)
    own = max(_speed(body, start), float(np.linalg.norm(change)) ** 0.5)
    return float(np.abs(np.linalg.eigvals(slope)).max()), own


def _teller(progress: bool | None, count: int) -> Callable[[str], None]:
    """A function that tells which candidate is tried, over its last line; with "" it wipes it."""
    if not (sys.stderr.isatty() if progress is None else progress):
        return lambda name: None
    done = 0

    def say(name: str) -> None:
        nonlocal done
        done += 1
        text = f"recommend: {name} ({done} of {count})" if name else ""
        print(f"\r{text:<60}", end="" if name else "\r", file=sys.stderr, flush=True)

    return say
