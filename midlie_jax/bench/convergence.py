"""Every method over a ladder of step sizes: errors at the end of a scene, and what they cost. The charts' numbers.

`measure` yields a row as soon as it is known; `survey` also times each method again after all the others have had
their turn, so that a machine that was slow for a while is seen in the spread of all rather than in the time of one.

The step and the number of steps are arguments of the compiled program, so that one compilation serves the whole ladder
of a method. Timed are the first steps of a run, as many for every rung.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..drivers.program import Program
from ..drivers.timing import Stopwatch
from ..methods.base import Method
from ..methods.registry import method as find_method
from ..model import so3
from .closed_form import Numbering, exact_ends
from .scenes import Scene

COPIES = 256  # bodies moved side by side when a run is timed: enough to drown the cost of starting each loop
LEVELS = 5
_TIMINGS = 5  # runs of a rung that are timed in a row
_ROUNDS, _ROUND_SECONDS = 2, 5.0  # times that `survey` comes back to every method, unless that takes longer in all
_AGAIN = 3  # runs of a rung timed when it does: all rounds together outvote the first
_COARSEST = {"P1": 500}  # steps on the first rung where the paper's figure has them; elsewhere twice the scene's step
_ROMBERG = 4  # runs extrapolated where no closed form is known
_REFERENCE = "LIEMID[EA]"


class Reference(NamedTuple):
    """Where a scene truly ends.

    Attributes:
        momentum: body-frame angular momentum, (3,).
        attitude: rotation matrix, body to space, (3, 3).
        source: how it was found.
        uncertainty: what it may be wrong by, as far as is known, relative to the norms of both.
    """

    momentum: np.ndarray
    attitude: np.ndarray
    source: str
    uncertainty: float


class Row(NamedTuple):
    """One method at one step size.

    Attributes:
        method: its name.
        dt: step, in the scene's unit of time.
        steps: number of steps.
        momentum_error: |Pi - Pi_reference| at the end, body frame.
        attitude_error: |R - R_reference| at the end, Frobenius norm.
        momentum_slope, attitude_slope: order seen between this rung and the one before; NaN on the first.
        evaluations: torque evaluations of the run; 0 without torque.
        seconds: median time of the run for one body, moved in a batch of `COPIES`; compiling not counted. It is
            processor time, all threads added up, where the processor does the work (`timing.cost_clock`).
        ok: whether every solve converged and every number stayed finite.
        failure: what stopped the method; "" if nothing did.
        spread: half the distance between the quartiles of the timings, relative to the median.
    """

    method: str
    dt: float
    steps: int
    momentum_error: float = math.nan
    attitude_error: float = math.nan
    momentum_slope: float = math.nan
    attitude_slope: float = math.nan
    evaluations: int = 0
    seconds: float = math.nan
    ok: bool = False
    failure: str = ""
    spread: float = math.nan


def ladder(scene: Scene, coarsest: int | None = None, levels: int = LEVELS) -> list[int]:
    """Numbers of steps, each twice the one before.

    Args:
        scene: from `midlie_jax.bench.scenes.scene`.
        coarsest: steps on the first rung; without it, the paper's figure's or twice the scene's own step.
        levels: number of rungs.

    Raises:
        ValueError: a number is not positive, or the last rung has too many steps.
    """
    if coarsest is None:
        coarsest = _COARSEST.get(scene.name, max(1, scene.steps // 2))
    if coarsest < 1 or levels < 1:
        raise ValueError(f"steps and levels must be positive, got {coarsest} and {levels}.")
    if math.log2(coarsest) + levels > 31:
        raise ValueError(
            f"{levels} levels from {coarsest} steps end beyond the 2^31 that can be counted; ask for fewer."
        )
    return [coarsest * 2**level for level in range(levels)]


def measure(scene: Scene, methods: Sequence[str | Method], rungs: Sequence[int], reference: Reference) -> Iterator[Row]:
    """A row for each method and rung, in that order, each as soon as it is known.

    A method that raises gives rows that say so, and the next one is tried.

    Args:
        scene: from `midlie_jax.bench.scenes.scene`.
        methods: names, or methods made outside the package.
        rungs: from `ladder`.
        reference: from `find_reference`.
    """
    for method in map(_as_method, methods):
        yield from _Rungs(scene, method, rungs, reference).rows()


def survey(
    scene: Scene,
    methods: Sequence[str | Method],
    rungs: Sequence[int],
    reference: Reference,
    seen: Callable[[Row], None] = lambda row: None,
) -> tuple[list[Row], int]:
    """The rows of `measure`, their times from several rounds over all methods.

    Args:
        scene, methods, rungs, reference: as for `measure`.
        seen: told of each row when its errors are known; its time is that of the first round.

    Returns:
        The rows, and how many rounds there were: fewer where a round takes seconds.
    """
    trials = [_Rungs(scene, method, rungs, reference) for method in map(_as_method, methods)]
    for trial in trials:
        for row in trial.rows():
            seen(row)
    rounds, began = 1, time.perf_counter()
    for _ in range(_ROUNDS):
        if time.perf_counter() - began + sum(trial.again_seconds() for trial in trials) > _ROUND_SECONDS:
            break
        for trial in trials:
            trial.again()
        rounds += 1
    return [row for trial in trials for row in trial.timed_rows()], rounds


def _as_method(method: str | Method) -> Method:
    return find_method(method) if isinstance(method, str) else method


def find_reference(scene: Scene, finest: int) -> Reference:
    """The end of a scene: in closed form where one is known, else by extrapolation.

    Args:
        scene: from `midlie_jax.bench.scenes.scene`.
        finest: steps of the finest run to be judged; the extrapolation starts from twice as many.

    Raises:
        ValueError: the reference run failed.
        ImportError: a closed form needs mpmath.
    """
    closed = _closed_form(scene)
    return closed if closed is not None else _extrapolated(scene, finest)


def by_halving(scene: Scene, name: str, steps: int) -> Reference:
    """The end of a scene by twice `steps` steps of a method; it is in doubt by what the step's halving changed.

    Raises:
        ValueError: the run failed.
    """
    program = _program(find_method(name), scene, steps, copies=1)
    coarse, _ = _end(program, scene.duration / steps, steps)
    fine, ok = _end(program, scene.duration / (2 * steps), 2 * steps)
    doubt = float(np.linalg.norm(_matrix(fine.attitude) - _matrix(coarse.attitude)))
    if not ok or not math.isfinite(doubt):
        raise ValueError(f"no reference: {name} failed with {2 * steps} steps; check the torque for NaN.")
    return Reference(fine.momentum, _matrix(fine.attitude), f"{name} with {2 * steps} steps", doubt)


def _program(method: Method, scene: Scene, coarsest: int, copies: int) -> Program:
    """The method on copies of a scene, for any multiple of `coarsest` steps."""
    starts = jax.tree.map(lambda leaf: jnp.tile(leaf, (copies, 1)), scene.start)
    unroll = method.unroll if coarsest % method.unroll == 0 else 1
    return Program(method, scene.body, scene.torque, starts, unroll=unroll)


def _end(program: Program, dt: float, steps: int) -> tuple[Any, bool]:
    """The end of the first copy, in NumPy's arrays, and whether all went well."""
    states, ok = program.run(dt, steps)
    return jax.tree.map(lambda leaf: np.asarray(leaf[0]), states), bool(jnp.all(ok))


class _Rungs:
    """One method on one scene over a ladder, and a stopwatch for each rung."""

    def __init__(self, scene: Scene, method: Method, rungs: Sequence[int], reference: Reference):
        self.scene, self.method, self.rungs, self.reference = scene, method, rungs, reference
        self.program: Program | None = None
        self.watches = {steps: Stopwatch() for steps in rungs}
        self.found: list[Row] = []

    def rows(self) -> Iterator[Row]:
        """A row for each rung, each as soon as it is known."""
        failure = ""
        for steps in self.rungs:
            row = Row(self.method.name, self.scene.duration / steps, steps, failure=failure)
            try:
                if self.program is None and not failure:
                    self.program = _program(self.method, self.scene, self.rungs[0], COPIES)
                if self.program is not None:
                    row = self._row(self.program, row)
            except Exception as error:  # one broken method must not cost the user the others
                reason = f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"
                failure = reason if self.program is None else ""  # what does not compile does not on any rung
                row = row._replace(failure=reason)
            self.found.append(row)
            yield row

    def _row(self, program: Program, row: Row) -> Row:
        before = self.found[-1] if self.found else None
        state, ok = _end(program, row.dt, row.steps)
        self._time(program, row, _TIMINGS)
        momentum = float(np.linalg.norm(state.momentum - self.reference.momentum))
        attitude = float(np.linalg.norm(_matrix(state.attitude) - self.reference.attitude))
        evaluations = 0 if self.scene.torque is None else program.method.evaluations * row.steps
        return self._timed(
            row._replace(
                momentum_error=momentum,
                attitude_error=attitude,
                momentum_slope=_slope(before.momentum_error if before else math.nan, momentum),
                attitude_slope=_slope(before.attitude_error if before else math.nan, attitude),
                evaluations=evaluations,
                ok=ok,
            )
        )

    def _time(self, program: Program, row: Row, laps: int) -> None:
        """Times the first steps of a rung, as many as the coarsest rung has."""
        for _ in range(laps):
            self.watches[row.steps].time(lambda: program.run(row.dt, self.rungs[0]))

    def again(self) -> None:
        """Times what ran once more."""
        for row in self.found:
            if self.program is not None and not row.failure:
                self._time(self.program, row, _AGAIN)

    def again_seconds(self) -> float:
        """What that takes."""
        return sum((_AGAIN * self.watches[row.steps].timing().seconds for row in self.found if not row.failure), 0.0)

    def timed_rows(self) -> list[Row]:
        """The rows that `rows` gave, with the times of all laps so far."""
        return [row if row.failure else self._timed(row) for row in self.found]

    def _timed(self, row: Row) -> Row:
        whole = self.watches[row.steps].timing().scaled(row.steps // self.rungs[0] / COPIES)
        return row._replace(seconds=whole.seconds, spread=whole.spread)


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    return np.asarray(so3.to_matrix(jnp.asarray(quaternion)))


def _slope(coarse: float, fine: float) -> float:
    return math.log2(coarse / fine) if coarse > 0 and fine > 0 else math.nan


def _closed_form(scene: Scene) -> Reference | None:
    numbering = Numbering.of(scene)
    third = numbering.apply(scene)
    if third is None:
        return None
    start = np.concatenate([np.asarray(third.start.momentum), np.asarray(third.start.attitude)])
    found = exact_ends(third, [start])
    if found is None:
        return None
    momentum, attitude = numbering.undo(found.momenta[0], found.attitudes[0])
    return Reference(momentum, _matrix(attitude), found.source, 1e-14)


def _extrapolated(scene: Scene, finest: int) -> Reference:
    """Romberg's extrapolation of a symmetric method, whose error holds even powers of the step only."""
    program = _program(find_method(_REFERENCE), scene, finest, copies=1)
    row: list[np.ndarray] = []
    doubt, steps = math.inf, finest
    for _ in range(_ROMBERG):
        steps *= 2
        state, ok = _end(program, scene.duration / steps, steps)
        if not ok:
            raise ValueError(f"no reference for scene {scene.name!r}: {_REFERENCE} failed with {steps} steps.")
        above, row = row, [np.concatenate([state.momentum, state.attitude])]
        for power, coarse in enumerate(above, start=1):
            row.append(row[-1] + (row[-1] - coarse) / (4**power - 1))
        if above:
            change = np.abs(row[-1] - above[-1])
            doubt = float(max(change[:3].max() / np.linalg.norm(row[-1][:3]), change[3:].max()))
    momentum, attitude = row[-1][:3], row[-1][3:]
    matrix = _matrix(attitude / np.linalg.norm(attitude))
    return Reference(momentum, matrix, f"extrapolation of {_REFERENCE} from up to {steps} steps", doubt)
