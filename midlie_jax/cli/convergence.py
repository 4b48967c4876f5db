"""Measures methods over a ladder of step sizes: errors at the end of a scene and their cost, for table and chart.

All methods are timed in turn, so a temporary slowdown of the machine widens the spread of all times instead of
distorting one. Only the first steps of a run are timed, the same number on every rung.
"""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..advice.program import Program
from ..advice.timing import Stopwatch
from ..integrators.base import Method
from ..integrators.registry import method as find_method
from ..model import so3
from ..model.bodies import RigidBody, SymmetricRotor
from ..model.free_body import FreeBody
from ..model.states import AxisState, FreeState, RigidState
from ..model.torques import HeavyTop, UniformGravity
from . import chosen
from .oracle import DIGITS, exact_motion
from .scenes import Scene

COPIES = 256  # bodies in a timed batch: with so many, the cost of starting a loop is negligible
LEVELS = 5  # rungs of the ladder by default
_LEAST_ROUNDS, _MOST_ROUNDS, _SECONDS = 5, 11, 5.0  # of timings; after these seconds no further round starts
_COARSEST = {"P1": 500}  # steps on the first rung in the paper's figure; other scenes use twice the step of the scene
_ROMBERG = 4  # number of extrapolated runs if no exact end is known
_MOST_RADIANS = 1e4  # of a rotation whose exact end is computed, in about ten seconds
SOURCE = f"Taylor series in {DIGITS} digits"
_REFERENCE = "LIEMID[EA]"  # the method that is extrapolated
_OF_HIGH_ORDER = "GBS12"  # the reference for translating bodies, whose forces may read the velocity, and for axes


class Reference(NamedTuple):
    """The end of a scene against which errors are measured."""

    momentum: np.ndarray  # body frame, (3,); for an axis, in space
    attitude: np.ndarray  # rotation matrix, body to space, (3, 3); or the axis, (3,)
    source: str  # the method of computation
    uncertainty: float  # estimate of the error of momentum and attitude, relative to their norms
    position: np.ndarray | None = None  # of a translating body, (3,)


class Row(NamedTuple):
    """One method at one step size."""

    method: str
    dt: float
    steps: int
    momentum_error: float = math.nan  # |Pi - Pi_reference| at the end, body frame
    attitude_error: float = math.nan  # |R - R_reference| at the end, Frobenius norm
    momentum_slope: float = math.nan  # order of accuracy from the previous rung to this one
    attitude_slope: float = math.nan
    evaluations: int = 0  # torque evaluations of the run
    seconds: float = math.nan  # median time of the run for one body in a batch of `COPIES`, by `timing.cost_clock`
    ok: bool = False  # whether every solve converged and every number is finite
    failure: str = ""  # the error that stopped the method
    spread: float = math.nan  # half the distance between the quartiles of the timings, relative to the median
    position_error: float = math.nan  # of a translating body


def ladder(scene: Scene, coarsest: int | None = None, levels: int = LEVELS) -> list[int]:
    """Numbers of steps, each twice the previous; by default as in the paper's figure, or from twice a scene's step."""
    if coarsest is None:
        coarsest = _COARSEST.get(scene.name, max(1, scene.steps // 2))
    if coarsest < 1 or levels < 1:
        raise ValueError(f"steps and levels must be positive, got {coarsest} and {levels}.")
    if math.log2(coarsest) + levels > 31:
        raise ValueError(f"{levels} levels from {coarsest} steps exceed the largest number of steps, 2^31; use fewer.")
    return [coarsest * 2**level for level in range(levels)]


def survey(
    scene: Scene,
    methods: Sequence[str | Method],
    rungs: Sequence[int],
    reference: Reference,
    report: Callable[[Row], None] = lambda row: None,
) -> tuple[list[Row], int]:
    """A row for each method and rung, in that order, and the number of rounds in which all were timed.

    `report` is called with each row before it is timed. If a method raises an error, its rows have the error in
    `failure`.
    """
    rows, runs = list[Row](), dict[int, Callable[[], Any]]()
    for method in chosen.methods(methods, scene.body):
        program, failure, before = None, "", Row(method.name, math.nan, 0)
        for steps in rungs:
            row = Row(method.name, scene.duration / steps, steps, failure=failure)
            try:
                if not failure:
                    program = program or _program(method, scene, rungs[0], COPIES)
                    row = _measured(program, scene, row, before, reference)
                    runs[len(rows)] = partial(program.run, row.dt, rungs[0])
            except Exception as error:  # the other methods are measured even if one raises an error
                reason = f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"
                failure = reason if program is None else ""  # a method that does not compile fails on all rungs
                row = row._replace(failure=reason)
            before = row
            rows.append(row)
            report(row)
    watches, rounds, began = {i: Stopwatch() for i in runs}, 0, time.perf_counter()
    while rounds < _LEAST_ROUNDS or (rounds < _MOST_ROUNDS and time.perf_counter() - began < _SECONDS):
        for i, run in runs.items():
            watches[i].time(run)
        rounds += 1
    for i, watch in watches.items():
        timing = watch.timing()
        seconds = timing.seconds * (rows[i].steps // rungs[0]) / COPIES
        rows[i] = rows[i]._replace(seconds=seconds, spread=timing.spread)
    return rows, rounds


def _measured(program: Program, scene: Scene, row: Row, before: Row, reference: Reference) -> Row:
    """The row with its errors; `before` is the row of the rung before."""
    state, ok = _end(program, row.dt, row.steps)
    momentum = float(np.linalg.norm(state.momentum - reference.momentum))
    attitude = float(np.linalg.norm(_pose(state) - reference.attitude))
    place = reference.position
    return row._replace(
        momentum_error=momentum,
        attitude_error=attitude,
        momentum_slope=_slope(before.momentum_error, momentum),
        attitude_slope=_slope(before.attitude_error, attitude),
        evaluations=0 if scene.torque is None else program.method.evaluations * row.steps,
        ok=ok,
        position_error=math.nan if place is None else float(np.linalg.norm(state.position - place)),
    )


def find_reference(scene: Scene, finest: int) -> Reference:
    """The end of a scene: by Taylor series for a free body or a heavy top, otherwise by extrapolation."""
    other = _extrapolated if isinstance(scene.body, RigidBody) else _much_finer
    return _exact(scene) or other(scene, finest)


def _program(method: Method, scene: Scene, coarsest: int, copies: int) -> Program:
    starts = jax.tree.map(lambda leaf: jnp.tile(leaf, (copies, 1)), scene.start)
    unroll = method.unroll if coarsest % method.unroll == 0 else 1
    return Program(method, scene.body, scene.torque, starts, unroll=unroll)


def _end(program: Program, dt: float, steps: int) -> tuple[Any, bool]:
    states, ok = program.run(dt, steps)
    return jax.tree.map(lambda leaf: np.asarray(leaf[0]), states), bool(jnp.all(ok))


def _pose(state: Any) -> np.ndarray:
    """The rotation matrix of a state, or its axis."""
    return np.asarray(so3.to_matrix(jnp.asarray(state.attitude)) if hasattr(state, "attitude") else state.axis)


def _slope(coarse: float, fine: float) -> float:
    return math.log2(coarse / fine) if coarse > 0 and fine > 0 else math.nan


def _exact(scene: Scene) -> Reference | None:
    """The exact end, with a parabola for a body in free fall; an axis moves as if all moments were equal."""
    body, torque, start, position, source = scene.body, scene.torque, scene.start, None, SOURCE
    if isinstance(body, SymmetricRotor) and isinstance(start, AxisState):
        moments, start = np.full(3, float(body.moment)), start.with_attitude()
    elif isinstance(body, RigidBody) and isinstance(start, RigidState):
        moments = np.asarray(body.moments)
    elif isinstance(body, FreeBody) and isinstance(body.body, RigidBody) and isinstance(start, FreeState):
        if not (torque is None or isinstance(torque, UniformGravity)):
            return None
        t, g = scene.duration, np.zeros(3) if torque is None else np.asarray(torque.acceleration, np.float64)
        x, p = (np.asarray(v, np.float64) for v in (start.position, start.linear))
        position, source = x + p / float(body.mass) * t + g * t**2 / 2, f"{SOURCE}, and the parabola"
        moments, torque, start = np.asarray(body.body.moments), None, start.turning
    else:
        return None
    ends = exact_ends(moments, torque, [start], scene.duration)
    if ends is None:
        return None
    end = RigidState(*(jnp.asarray(numbers[0]) for numbers in ends))
    end = AxisState.of(end) if isinstance(body, SymmetricRotor) else end
    return Reference(np.asarray(end.momentum), _pose(end), source, 1e-14, position)


def exact_ends(
    moments: np.ndarray, torque: Any, starts: Sequence[RigidState], duration: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Momenta (n, 3) and attitudes (n, 4) at the end; None if the torque or a very long motion prevents it."""
    if not (torque is None or isinstance(torque, HeavyTop)):
        return None
    weight, axis = (0.0, (0.0, 0.0, 1.0)) if torque is None else (float(torque.mgl), torque.axis)
    fastest = max(float(np.linalg.norm(np.asarray(start.momentum) / moments)) for start in starts)
    if (fastest + math.sqrt(abs(weight) / np.min(moments))) * abs(duration) > _MOST_RADIANS:
        return None
    ends = [exact_motion(moments, s.momentum, s.attitude, [duration], weight=weight, axis=axis) for s in starts]
    momenta, attitudes = zip(*ends, strict=True)
    return np.concatenate(momenta), np.concatenate(attitudes)


def _ends(method: str, scene: Scene, counts: Sequence[int]) -> list[Any]:
    """The ends of a scene by a method with these numbers of steps."""
    program, ends = _program(find_method(method), scene, counts[0], copies=1), list[Any]()
    for steps in counts:
        state, ok = _end(program, scene.duration / steps, steps)
        if not ok:
            raise ValueError(
                f"no reference for scene {scene.name!r}: {method} failed with {steps} steps; check the torque for NaN."
            )
        ends.append(state)
    return ends


def _extrapolated(scene: Scene, finest: int) -> Reference:
    """Romberg's extrapolation of a symmetric method, whose error has only even powers of the step."""
    counts = [finest * 2**k for k in range(1, _ROMBERG + 1)]
    row: list[np.ndarray] = []
    uncertainty = math.inf
    for state in _ends(_REFERENCE, scene, counts):
        above, row = row, [np.concatenate([state.momentum, state.attitude])]
        for power, coarse in enumerate(above, start=1):
            row.append(row[-1] + (row[-1] - coarse) / (4**power - 1))
        if above:
            change = np.abs(row[-1] - above[-1])
            uncertainty = float(max(change[:3].max() / np.linalg.norm(row[-1][:3]), change[3:].max()))
    momentum, attitude = row[-1][:3], row[-1][3:]
    matrix = np.asarray(so3.to_matrix(jnp.asarray(attitude / np.linalg.norm(attitude))))
    return Reference(momentum, matrix, f"extrapolation of {_REFERENCE} from up to {counts[-1]} steps", uncertainty)


def _much_finer(scene: Scene, finest: int) -> Reference:
    """The end by a method of high order with twice as many steps; four times as many change it little."""
    coarse, fine = _ends(_OF_HIGH_ORDER, scene, (2 * finest, 4 * finest))
    momentum = np.abs(fine.momentum - coarse.momentum).max() / np.linalg.norm(fine.momentum)
    uncertainty = float(max(momentum, np.abs(_pose(fine) - _pose(coarse)).max()))
    source, position = f"solution by {_OF_HIGH_ORDER} in {4 * finest} steps", getattr(fine, "position", None)
    return Reference(fine.momentum, _pose(fine), source, uncertainty, position)
