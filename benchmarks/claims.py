"""The claims of the paper and of the package on trial: figures, verdicts, a page and a picture.

    python benchmarks/claims.py [--methods NAME ... | --all] [--steps N] [--page FILE] [--out FILE]

Measures order, symplectic defect, spatial momentum, reversal, energy over long runs, a published drift test and the
work of a step, and holds the claims against the figures. By default the methods of the paper and one with each flight
and each scheme of `midlie methods`, in under five minutes on two cores. `make claims` writes docs/reports/claims.md.
"""

import argparse
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, chart, compact, link, part, put, save, table
from harness import cells as cells_of
from jax import Array
from laboratory.runner import Rows, Runner, free_bodies, spatial_momentum

import midlie_jax as ml
from midlie_jax._xla.platform import cores
from midlie_jax.advice.program import Program
from midlie_jax.cli import chosen
from midlie_jax.cli.options import MOST_STEPS, OWN, file, whole
from midlie_jax.cli.oracle import exact_motion
from midlie_jax.cli.scenes import perturbed, scene
from midlie_jax.cli.tables import progress_bar, require, show_table
from midlie_jax.integrators.base import Method
from midlie_jax.integrators.flights import FLIGHTS
from midlie_jax.integrators.registry import ENTRIES
from midlie_jax.integrators.registry import method as find_method
from midlie_jax.integrators.runge_kutta import RK4
from midlie_jax.integrators.schemes import SCHEMES
from midlie_jax.integrators.splitting import Splitting
from midlie_jax.integrators.system import System
from midlie_jax.model.torques import Torque

jax.config.update("jax_enable_x64", True)

# ---- how far one step is from symplectic on T*SO(3), and from preserving area on the momentum sphere ----
# The derivative of the step comes from steps that start at neighbouring states, so that any compiled method can be
# measured as it is. A stencil of eight points has an error below rounding; what is left is about 1e-13.
#
# Directions at a state are pairs (turn, change of Pi), with the turn in the body frame. The canonical form of T*SO(3)
# is then, up to its sign, w((a, x), (b, y)) = a . y - b . x + Pi . (a x b). A map is symplectic if M^T W1 M = W0, where
# M is its derivative and W0, W1 are the form at both ends (Hairer, Lubich, Wanner, Geometric Numerical Integration,
# VII.5).

_DELTA = 1 / 32
_PLACES = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280]) / _DELTA


def canonical(momentum: Any) -> np.ndarray:
    zero, one = np.zeros((3, 3)), np.eye(3)
    x, y, z = np.asarray(momentum)
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[-hat, one], [-one, zero]])


def neighbours(momentum: Any, attitude: Any) -> ml.RigidState:
    changes = [np.zeros(6), *(_DELTA * place * axis for axis in np.eye(6) for place in _PLACES)]
    turns, pushes = np.split(np.array(changes), 2, axis=1)
    start = jnp.broadcast_to(jnp.asarray(attitude, float), (len(turns), 4))
    return ml.RigidState(jnp.asarray(momentum + pushes), ml.so3.multiply(start, ml.so3.exp(jnp.asarray(turns))))


def derivative(ends: ml.RigidState) -> np.ndarray:
    momentum = np.asarray(ends.momentum)
    seen = np.asarray(ml.so3.log(ml.so3.multiply(ml.so3.conjugate(ends.attitude[:1]), ends.attitude)))
    change = np.concatenate([seen, momentum], axis=1)[1:].reshape(6, len(_PLACES), 6)
    return np.einsum("p,jpi->ij", _WEIGHTS, change)


def symplectic_defect(matrix: np.ndarray, before: Any, after: Any) -> float:
    """The largest entry of |M^T W1 M - W0|, for the momenta before and after the step."""
    return float(np.abs(matrix.T @ canonical(after) @ matrix - canonical(before)).max())


def area_defect(matrix: np.ndarray, before: Any, after: Any) -> float:
    """|area of the image / area - 1| on the momentum sphere, for a step of a free body."""
    block = matrix[3:, 3:]
    cofactors = np.stack([np.cross(block[1], block[2]), np.cross(block[2], block[0]), np.cross(block[0], block[1])])
    start, end = (np.asarray(p) / np.linalg.norm(p) for p in (before, after))
    return abs(float(end @ cofactors @ start) - 1)


# ---- the drift test of Bou-Rabee, Ortolan and Saccon: mean energy errors over the eighths of a run to T = 1e4 ----
# A method that is reversible but not symplectic may show a drift here. The runs are copies of the scene `drift-test`
# whose momenta differ by rounding: where the motion by a method becomes chaotic, they part ways, and their spread tells
# how far a late mean is one draw of many.

COPIES, EIGHTHS = 8, 8
_AGREE = 0.1


class Drift(NamedTuple):
    """Mean and largest energy errors E - E(0) of each eighth, (copies, 8); the first copy is the scene itself."""

    eighths: np.ndarray
    largest: np.ndarray
    ok: bool

    @property
    def mean(self) -> np.ndarray:
        return self.eighths.mean(axis=0)

    @property
    def spread(self) -> np.ndarray:
        return self.eighths.std(axis=0)

    @property
    def together(self) -> int:
        """The last eighth up to which the copies agree to a tenth."""
        apart = np.flatnonzero(self.spread > _AGREE * np.abs(self.mean))
        return int(apart[0]) - 1 if len(apart) else EIGHTHS - 1


def drift(method: Method) -> Drift:
    test = scene("drift-test")
    momentum = np.asarray(test.start.momentum)
    momenta = momentum + 1e-14 * np.random.default_rng(0).standard_normal((COPIES, 3))
    momenta[0] = momentum
    fitted = method.fitted(test.body)

    def run(momentum: Any) -> Any:
        start = ml.RigidState(momentum, test.start.attitude)
        path = ml.integrate(fitted, test.body, test.torque, start, dt=test.dt, steps=test.steps)
        energies = ml.observe.energy(test.body, test.torque, path.states)
        errors = (energies[1:] - energies[0]).reshape(EIGHTHS, -1)
        return errors.mean(-1), jnp.abs(errors).max(-1), path.ok

    eighths, largest, ok = jax.jit(jax.vmap(run))(jnp.asarray(momenta))
    return Drift(np.asarray(eighths), np.asarray(largest), bool(np.all(ok)))


# ---- the work of a step, counted in its trace ----
# The torque that is traced leaves a mark, the cube root, which nothing else in the package uses. The mark's derivative
# is a mark again, so a directional derivative of the torque, of which Newton's method needs three, counts, too.

_MARK = "cbrt"


class Work(NamedTuple):
    """Torque evaluations of a step after the first, with directional derivatives; whether none is part of a solve."""

    evaluations: int
    explicit: bool


@jax.custom_jvp
def _mark(x: Array) -> Array:
    return jax.lax.cbrt(x)


@_mark.defjvp
def _mark_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    return _mark(*primals), jax.lax.cbrt(tangents[0])


class _MarkedTorque(Torque):
    """A torque that depends on the attitude. Its potential is there for methods that keep the energy."""

    def __call__(self, t: Any, state: ml.RigidState) -> Array:
        del t
        return _mark(state.attitude[1:])

    def potential(self, t: Any, state: ml.RigidState) -> Array:
        del t
        return state.attitude[0]


def work(method: Method) -> Work:
    body = ml.RigidBody(jnp.array([2.0, 2.0, 3.0]))
    start = ml.RigidState(jnp.ones(3), jnp.full(4, 0.5))
    fitted = method.fitted(body)

    def step(start: ml.RigidState, h: Array) -> Any:
        system = System.of(body, _MarkedTorque(), start, jnp.zeros_like(h))
        motion = system.motion(start)
        force = motion.momentum if fitted.keeps_force(system) else None
        return fitted.step(system, jnp.zeros_like(h), h, h, motion, force)

    outside, inside = _marks(jax.make_jaxpr(step)(start, jnp.asarray(0.1)).jaxpr, solving=False)
    return Work(outside + inside, inside == 0)


def _marks(jaxpr: Any, solving: bool) -> tuple[int, int]:
    """The marks outside and inside of solves, which are `custom_root` calls; a mark in a loop counts for each turn.

    In jax 0.12 such a call is a primitive that keeps its parts in `_prim`; before, a function with a custom derivative.
    """
    outside = inside = 0
    for equation in jaxpr.eqns:
        name = equation.primitive.name
        if name == _MARK:
            outside, inside = outside + (not solving), inside + solving
        root = equation.params.get("_prim")
        for value in (*equation.params.values(), *getattr(root, "params", {}).values()):
            body = getattr(value, "jaxpr", value)
            if not hasattr(body, "eqns"):
                continue
            # The mark is a function with a custom derivative, like a solve, but does nothing else.
            own = name == "custom_jvp_call" and [e.primitive.name for e in body.eqns] != [_MARK]
            within = solving or own or root is not None
            found = _marks(body, within)
            turns = equation.params.get("length", 1)
            if name == "while" and sum(found):
                raise ValueError("a loop of unknown length evaluates the torque; its evaluations cannot be counted.")
            outside, inside = outside + turns * found[0], inside + turns * found[1]
    return outside, inside


# ---- every property of a method that a claim is about, by one compiled program and the drift test's ----
# The motions are the same for all methods: `TOPS` heavy tops about the scene `asymmetric-top`, whose motion is chaotic,
# with a step of 0.05 over the long run (a method for two equal moments has the moments (1, 3, 3), and gravity acts
# across the axis of symmetry); `TOPS` free bodies with different moments, 0.2 to 0.5 radians a step; and the fast top
# P1 of the paper's figure, with h = 0.005 to T = 10, against the closed form.

STEPS = 1_000_000
TOPS, ROWS = 16, 32  # tops and free bodies of the long run; rows of every call of the program
SAMPLES = 4000  # states of the long run that are kept
_BLOCK = 200  # of them in a call of the program
DEFECT_STEPS = (0.4, 0.2, 0.1)  # h of the steps whose derivative is measured
_TIME, _LADDER = 2.0, (2, 4, 8, 16, 32, 64, 128)  # duration and steps of the runs that measure the order
_ACCURACY = 64  # the rung on which methods are compared
_ROUNDING = 5e-13  # errors below this show rounding rather than the order
_THERE, _BACK_STEP = 64, 0.1  # the run that is reversed
_LONG_STEP, _FREE_STEP = 0.05, 0.5
_P1_STEPS = 2000
_REFERENCE = "JACOBI[SRKN14a]"
_APART, _PARTING = 1e-9, (50, 100, 200, 400)  # how far apart neighbours start, and times at which they are compared
_EQUAL, _ANY = (1.0, 3.0, 3.0), (1.0, 2.0, 3.0)


class Measured(NamedTuple):
    """What was measured of one method.

    Attributes:
        order, accuracy: on the tops, the slope of the error over the step, and the error with h = 1/32, as `_error`.
        accuracy_p1: the same on P1 at T = 10 with h = .005.
        symplectic, area: the defects of one step of the top, and of one free step, for `DEFECT_STEPS`.
        momentum: largest change of the spatial momentum of the free bodies over the long run, relative.
        reversal: how far from the start 64 steps of .1 forward and back end.
        energy: energy errors of the tops over the long run, relative, (samples, tops).
        flights: flights a step, each of which rounds; at least one.
        ok: whether no step failed.
    """

    method: str
    order: float
    accuracy: float
    accuracy_p1: float
    symplectic: tuple[float, ...]
    area: tuple[float, ...]
    momentum: float
    reversal: float
    energy: np.ndarray
    drift: Drift
    work: Work
    solves: int
    flights: int
    steps: int
    ok: bool


@cache
def _reference(equal: bool) -> Program:
    """A method of order 6 on the tops, and on copies of them that are displaced by `_APART`."""
    starts = _tops()
    displaced = ml.RigidState(starts.momentum * (1 + _APART), starts.attitude)
    both = jax.tree.map(lambda *x: jnp.concatenate(x), starts, displaced)
    body = ml.RigidBody(jnp.asarray(_EQUAL if equal else _ANY))
    return Program(find_method(_REFERENCE), body, scene("asymmetric-top").torque, both)


@cache
def _exact_end(equal: bool) -> ml.RigidState:
    return jax.tree.map(lambda x: x[:ROWS], _reference(equal).run(_TIME / 1024, 1024)[0])


class Bench:
    def __init__(self, steps: int = STEPS):
        """Takes the number of steps of the long run, of which `SAMPLES` states are kept."""
        self.samples = min(SAMPLES, steps)
        self.every = steps // self.samples
        self.steps = self.every * self.samples
        p1 = scene("P1")
        self._p1 = perturbed(p1, ROWS, 1e-3, seed=0)
        self._p1_dt = p1.duration / _P1_STEPS
        motions = [
            exact_motion(p1.body.moments, p, q, [p1.duration], weight=20.0)
            for p, q in zip(self._p1.momentum, self._p1.attitude, strict=True)
        ]
        momenta, attitudes = (np.concatenate(part) for part in zip(*motions, strict=True))
        self._p1_end = ml.RigidState(jnp.asarray(momenta), jnp.asarray(attitudes))

    def measure(self, method: str | Method, done: Callable[[str], None] = lambda part: None) -> Measured:
        (method,) = chosen.methods([method])
        equal = isinstance(method, Splitting) and method.flight.equal_moments
        runs = _Runs(method, equal)
        ok: list[bool] = []
        order, accuracy = self._order(runs, equal)
        accuracy_p1 = self._on_p1(runs, ok)
        done("order")
        symplectic, area = runs.defects(ok)
        reversal = runs.reversal(ok)
        done("structure")
        energy, momentum = self._long(runs, ok)
        done("long run")
        drifted = drift(method)
        done("drift test")
        flights = method.scheme.flights if isinstance(method, Splitting) else 1
        figures = (order, accuracy, accuracy_p1, symplectic, area, momentum, reversal, energy, drifted, work(method))
        return Measured(method.name, *figures, method.solves, flights, self.steps, all(ok) and drifted.ok)

    def chaos(self) -> str:
        parted = []
        for time in _PARTING:
            ends = _reference(False).run(1 / 32, round(32 * time))[0]
            one, other = (jax.tree.map(lambda x, half=half: x[half], ends) for half in (slice(ROWS), slice(ROWS, None)))
            parted.append(f"{_error(other, one):.0e} at t = {time}")
        return f"copies whose momenta differ by {_APART:.0e} are apart by {', '.join(parted)}."

    def _order(self, runs: "_Runs", equal: bool) -> tuple[float, float]:
        """The order, from the smallest two steps whose errors are above rounding; and the error to compare."""
        exact, errors = _exact_end(equal), []
        for count in _LADDER:
            end, ok = runs.tops(_TIME / count, count)
            errors.append(_error(end, exact) if bool(jnp.all(ok)) else np.nan)
        clear = [i for i, e in enumerate(errors) if e > _ROUNDING and i and errors[i - 1] > 0]
        order = float(np.log2(errors[clear[-1] - 1] / errors[clear[-1]])) if clear else np.nan
        return order, errors[_LADDER.index(_ACCURACY)]

    def _on_p1(self, runs: "_Runs", ok: list[bool]) -> float:
        rows = runs.rows(np.tile(scene("P1").body.moments, (ROWS, 1)), 20.0, self._p1, self._p1_dt)
        end, fine = runs.runner.run(rows, _P1_STEPS)
        ok.append(bool(jnp.all(fine)))
        return _error(end, self._p1_end)

    def _long(self, runs: "_Runs", ok: list[bool]) -> tuple[np.ndarray, float]:
        """The energy errors of the tops, (samples, tops), and the largest change of the momentum of the free bodies."""
        rows = runs.long_run()
        state, fine = rows.start, jnp.ones(ROWS, bool)
        found = [jax.tree.map(lambda x: np.asarray(x)[:, None], rows.start)]
        for first in range(0, self.samples, _BLOCK):
            count = min(_BLOCK, self.samples - first)
            states, good = runs.runner.path(rows._replace(start=state), self.every, count, first * self.every)
            state, fine = jax.tree.map(lambda x: x[:, -1], states), fine & good
            found.append(jax.tree.map(np.asarray, states))
        ok.append(bool(jnp.all(fine)))
        whole = jax.tree.map(lambda *x: np.concatenate(x, axis=1).swapaxes(0, 1), *found)
        momentum, attitude = whole.momentum, whole.attitude
        tops, free = rows.energy(momentum, attitude)[:, :TOPS], spatial_momentum(attitude[:, TOPS:], momentum[:, TOPS:])
        change = np.linalg.norm(free - free[0], axis=-1) / np.linalg.norm(free[0], axis=-1)
        return (tops[1:] - tops[0]) / np.abs(tops[0]), float(change.max())


class _Runs:
    def __init__(self, method: Method, equal: bool):
        self.moments = np.array(_EQUAL if equal else _ANY)
        bodies, momentum, attitude, _ = free_bodies(equal, float, count=TOPS, seed=4)
        self.free = bodies[:TOPS], momentum[:TOPS], attitude[:TOPS]
        every_body = np.concatenate([self.moments[None], bodies[:TOPS], [[5.0, 5.0, 1.0]]])
        self.runner = Runner(method, ml.RigidBody(jnp.asarray(every_body)), _BLOCK)
        self.weight = float(scene("asymmetric-top").torque.mgl)  # pyright: ignore

    def rows(self, moments: Any, weight: Any, start: ml.RigidState, dt: Any) -> Rows:
        full = [jnp.broadcast_to(jnp.asarray(x, float), (ROWS,)) for x in (weight, dt)]
        return Rows(
            ml.RigidBody(jnp.broadcast_to(jnp.asarray(moments), (ROWS, 3))),
            ml.torques.HeavyTop(full[0]),
            start,
            full[1],
        )

    def tops(self, dt: float, steps: int) -> Any:
        return self.runner.run(self.rows(self.moments, self.weight, _tops(), dt), steps)

    def long_run(self) -> Rows:
        moments, momentum, attitude = self.free
        start = jax.tree.map(lambda x: x[:TOPS], _tops())
        both = ml.RigidState(
            jnp.concatenate([start.momentum, jnp.asarray(momentum)]),
            jnp.concatenate([start.attitude, jnp.asarray(attitude)]),
        )
        halves = [np.repeat(pair, TOPS) for pair in ((self.weight, 0.0), (_LONG_STEP, _FREE_STEP))]
        tiled = np.tile(self.moments, (TOPS, 1))
        return self.rows(np.concatenate([tiled, moments]), halves[0], both, halves[1])

    def defects(self, ok: list[bool]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The symplectic defects of steps of a top, and the defects of area of free steps, for `DEFECT_STEPS`."""
        start, attitude = np.array([1.0, 0.8, -1.3]), np.array([0.8, 0.3, -0.4, 0.33])
        near = neighbours(start, attitude / np.linalg.norm(attitude))
        count = len(near.momentum)
        moments = self.moments
        many = [(weight, h) for weight in (self.weight, 0.0) for h in DEFECT_STEPS]
        weights, steps = (np.repeat(column, count) for column in zip(*many, strict=True))
        starts = jax.tree.map(lambda x: np.tile(x, (len(many), 1)), near)
        ends: list[ml.RigidState] = []
        for first in range(0, len(weights), ROWS):
            index = np.minimum(np.arange(first, first + ROWS), len(weights) - 1)
            begin = jax.tree.map(lambda x, index=index: jnp.asarray(x[index]), starts)
            end, fine = self.runner.run(self.rows(moments, weights[index], begin, steps[index]), 1)
            ok.append(bool(jnp.all(fine)))
            ends.append(end)
        whole = jax.tree.map(lambda *x: jnp.concatenate(x)[: len(weights)], *ends)
        found = []
        for i, (weight, _) in enumerate(many):
            end = jax.tree.map(lambda x, i=i: x[i * count : (i + 1) * count], whole)
            matrix, after = derivative(end), np.asarray(end.momentum[0])
            measure = symplectic_defect if weight else area_defect
            found.append(measure(matrix, start, after))
        return tuple(found[: len(DEFECT_STEPS)]), tuple(found[len(DEFECT_STEPS) :])

    def reversal(self, ok: list[bool]) -> float:
        rows = self.rows(self.moments, self.weight, _tops(), _BACK_STEP)
        there, fine = self.runner.run(rows, _THERE)
        back, good = self.runner.run(rows._replace(start=there, dt=-rows.dt), _THERE)
        ok.append(bool(jnp.all(fine & good)))
        return _error(back, rows.start)


def _tops() -> ml.RigidState:
    return perturbed(scene("asymmetric-top"), ROWS, 0.1, seed=1)


def _error(found: ml.RigidState, exact: ml.RigidState) -> float:
    momentum = np.linalg.norm(found.momentum - exact.momentum, axis=1) / np.linalg.norm(exact.momentum, axis=1)
    turn = np.asarray(ml.so3.log(ml.so3.multiply(ml.so3.conjugate(exact.attitude), found.attitude)))
    return float(np.sqrt(np.mean(momentum**2 + np.sum(turn**2, axis=1))))


# ---- the verdicts: what the paper and the registry claim about a method, against what was measured ----
# The paper claims of its alternating method, LIEMID[EA], that it is explicit in the forcing, conserves momentum, is
# symplectic, is of second order, and is the best second-order integrator of its kind. Tried as well: the energy of a
# symplectic method has no trend.

DECLARED = ("order", "momentum", "energy", "symplectic", "area", "symmetric", "no trend", "no drift", "evaluations")
RANK = "rank"
_EPSILON = float(np.finfo(float).eps)
_DEFECT = 1e-11  # of one step; differences leave 1e-13
_WALK = 4.0  # rounding as a random walk: times eps and the root of the number of flights
_PARTS = 2.3  # the sizes of the tops' kinetic and potential energies, which are rounded, over their energy, at most
_RETURN = 8.0  # rounding of a run and its way back, times eps and the number of flights
_FLIGHTS_BACK = 128
_TREND = 0.2  # of the oscillation in the first eighth of a run
_ORDER = 0.25
_SIZE = 0.1  # relative difference from a published drift

# Means of the energy error over the first and the last eighth of the drift test (Bou-Rabee, Ortolan & Saccon).
PUBLISHED_DRIFTS = {
    "LIEMID[EA]": (-6.0e-4, 4.4e-3),
    "AKW": (-6.7e-3, -2.7e-2),
    "SW": (2.6e-3, 2.2e-2),
    "NMB": (-2.6e-3, -1.7e-2),
    "JACOBI[EA]": (-1.05e-3, -1.05e-3),
}


class Verdict(NamedTuple):
    """A claim about a method, in words. `key` is what is declared, of `DECLARED`, or `RANK` if it needs rivals."""

    method: str
    claim: str
    measured: str
    holds: bool
    key: str = ""


def rounding(found: Measured) -> float:
    return _WALK * _EPSILON * (found.steps * max(1, found.flights)) ** 0.5


def has_order(found: Measured, order: int) -> bool:
    return found.order > order - _ORDER


def keeps_momentum(found: Measured) -> bool:
    return found.momentum <= rounding(found)


def keeps_energy(found: Measured) -> bool:
    return largest_energy(found) <= _PARTS * rounding(found)


def is_symplectic(found: Measured) -> bool:
    return max(found.symplectic) <= _DEFECT


def keeps_area(found: Measured) -> bool:
    return max(found.area) <= _DEFECT


def comes_back(found: Measured) -> bool:
    return found.reversal <= _RETURN * _FLIGHTS_BACK * max(1.0, found.flights / 2) * _EPSILON


def shifts(found: Measured) -> np.ndarray:
    """How far the mean energy error of the tops moves from the first eighth of the long run to each, (8,): relative,
    root mean square over the tops."""
    means = np.stack([part.mean(axis=0) for part in np.array_split(found.energy, EIGHTHS)])
    return np.sqrt(np.mean((means - means[0]) ** 2, axis=1))


def largest_energy(found: Measured) -> float:
    return float(np.max(np.abs(found.energy)))


def trend(found: Measured) -> tuple[float, float]:
    first = np.array_split(found.energy, EIGHTHS)[0]
    return float(shifts(found)[-1]), float(np.sqrt(np.mean(first**2)))


def has_no_trend(found: Measured) -> bool:
    shift, oscillation = trend(found)
    return shift <= max(_TREND * oscillation, rounding(found))


def drift_shift(found: Measured) -> float:
    return float(found.drift.eighths[0, -1] - found.drift.eighths[0, 0])


def has_no_drift(found: Measured) -> bool:
    return abs(drift_shift(found)) <= max(_TREND * float(found.drift.largest[0, 0]), rounding(found))


def is_published_drift(found: Drift, first: float, last: float) -> bool:
    """Whether the mean energy errors of the first and the last eighth have the sign and the size that were published.

    Both to a tenth. Where the copies part ways before the end, the last mean is one draw of many: then the published
    figure must be within two standard deviations of the copies, and of the sign of the last mean on which they agree.
    """
    near = [abs(found.mean[i] - x) <= max(_SIZE * abs(x), 2 * found.spread[i]) for i, x in ((0, first), (-1, last))]
    return all(near) and bool(np.sign(found.mean[found.together]) == np.sign(last))


def is_alternating(method: Method) -> bool:
    """Whether the method is the paper's alternating method, cut at either place."""
    entry = ENTRIES.get(method.name)
    return bool(entry and entry.paper) and isinstance(method, Splitting) and method.order == 2


def of_its_kind(method: Method, found: Measured) -> bool:
    return method.order == 2 and found.work.explicit and found.work.evaluations == 1 and keeps_momentum(found)


def of_the_paper(method: Method, found: Measured) -> bool:
    del found
    entry = ENTRIES.get(method.name)
    return method.order == 2 and bool(entry and entry.paper)


def ranked(
    one: Measured, methods: Sequence[Method], all_found: Sequence[Measured], kind: Callable[[Method, Measured], bool]
) -> tuple[str, bool] | None:
    """The best rival at the same step on the tops and on P1, in words; and whether `one` is the best on both.

    Rivals are the other methods of the kind, but not the paper's alternating method cut at another place; on the tops
    also not those for two equal moments, which were measured on other tops. None if there is no rival.
    """
    pairs = [(m, f) for m, f in zip(methods, all_found, strict=True) if kind(m, f) and not is_alternating(m)]
    every = [f for _, f in pairs]
    same = [f for m, f in pairs if not (isinstance(m, Splitting) and m.flight.equal_moments)]
    if not same:
        return None
    words, best = [], True
    for where, error, rivals in (("asymmetric top", "accuracy", same), ("P1", "accuracy_p1", every)):
        rival = min(rivals, key=lambda f: getattr(f, error) if getattr(f, error) > 0 else np.inf)
        ratio = getattr(one, error) / getattr(rival, error)
        best = best and bool(ratio <= 1)
        words.append(f"{where}: error {getattr(one, error):.1e}, {rival.method} {getattr(rival, error):.1e}")
    return "; ".join(words), best


def registry_verdicts(method: Method, found: Measured) -> list[Verdict]:
    gradients = isinstance(method, Splitting) and any(method.scheme.gradients) and not method.scheme.displaced
    claims = [
        (DECLARED[0], f"order {method.order}", f"{found.order:.2f}", has_order(found, method.order), True),
        (DECLARED[1], "momentum", f"{found.momentum:.1e}", keeps_momentum(found), method.keeps_momentum),
        (DECLARED[2], "energy", f"{largest_energy(found):.1e}", keeps_energy(found), method.keeps_energy),
        (DECLARED[3], "symplectic", _defects(found.symplectic), is_symplectic(found), method.symplectic),
        (DECLARED[4], "area", _defects(found.area), keeps_area(found), method.symplectic),
        (DECLARED[5], "symmetric", f"{found.reversal:.1e}", comes_back(found), method.symmetric),
        (DECLARED[6], "no trend on the top", _trend_words(found), has_no_trend(found), method.symplectic),
        (DECLARED[7], "no drift", _drift_words(found), has_no_drift(found), method.symplectic),
        (
            DECLARED[8],
            f"{method.evaluations} torque evaluations",
            f"{found.work.evaluations}",
            found.work.evaluations == method.evaluations,
            not gradients,  # a gradient is a derivative of the torque, which the registry does not count
        ),
    ]
    return [Verdict(found.method, claim, words, ok, key) for key, claim, words, ok, claimed in claims if claimed]


def paper_verdicts(methods: Sequence[Method], all_found: Sequence[Measured]) -> list[Verdict]:
    verdicts: list[Verdict] = []
    for method, found in zip(methods, all_found, strict=True):
        if not is_alternating(method):
            continue
        explicit = f"{found.work.evaluations} evaluation per step, outside the {found.solves} solves"
        claims = [
            ("explicit in the forcing", explicit, found.work.explicit),
            ("conserves momentum", f"spatial momentum moves by {found.momentum:.1e}", keeps_momentum(found)),
            ("second order", f"order {found.order:.2f}", has_order(found, 2)),
            ("symplectic on T*SO(3)", f"defect {_defects(found.symplectic)}", is_symplectic(found)),
            ("preserves area on the momentum sphere", f"defect {_defects(found.area)}", keeps_area(found)),
            ("as of a symplectic method, no trend of the energy: top", _trend_words(found), has_no_trend(found)),
            ("as of a symplectic method, no trend of the energy: drift test", _drift_words(found), has_no_drift(found)),
        ]
        verdicts += [Verdict(found.method, claim, words, ok) for claim, words, ok in claims]
        for claim, kind in (
            ("best of the paper's second-order methods", of_the_paper),
            ("best second-order integrator of its kind", of_its_kind),
        ):
            rank = ranked(found, methods, all_found, kind)
            verdicts += [] if rank is None else [Verdict(found.method, claim, *rank, RANK)]
    return verdicts


def published_verdicts(all_found: Sequence[Measured]) -> list[Verdict]:
    verdicts: list[Verdict] = []
    for found in all_found:
        if found.method in PUBLISHED_DRIFTS:
            first, last = PUBLISHED_DRIFTS[found.method]
            drift = found.drift
            words = f"{drift.mean[0]:.2e} -> {drift.mean[-1]:.2e}"
            if drift.together < len(drift.mean) - 1:
                words += f" ± {drift.spread[-1]:.0e}; the copies agree up to eighth {drift.together + 1}, "
                words += f"{drift.mean[drift.together]:.2e}"
            claim, holds = f"drift {first:.2e} -> {last:.2e}", is_published_drift(drift, first, last)
            verdicts.append(Verdict(found.method, claim, words, holds))
    return verdicts


def _trend_words(found: Measured) -> str:
    shift, oscillation = trend(found)
    return f"mean moves by {shift:.1e}, oscillation {oscillation:.1e}"


def _drift_words(found: Measured) -> str:
    drifts = found.drift.eighths[0]
    return f"{drifts[0]:.1e} -> {drifts[-1]:.1e}"


def _defects(defects: Sequence[float]) -> str:
    if max(defects) <= _DEFECT:
        return f"{defects[-1]:.0e}"
    order = f", order {np.log2(defects[-2] / defects[-1]):.1f}" if defects[-1] > _DEFECT else ""
    return f"{defects[-1]:.1e} at h = 0.1{order}"


_STAGES = 4  # parts of `Bench.measure` that are reported
_DRAWN = (*PUBLISHED_DRIFTS, "LIEMID[I]", "SLIEMID[EA]", RK4.name)


def claims(options: argparse.Namespace) -> None:
    require("tqdm", *(["matplotlib"] if options.out else []))
    methods = _methods(options)
    bench = Bench(options.steps) if options.steps else Bench()
    found = _measured(bench, methods)
    show_table(list(HEADS), [cells(one) for one in found])
    for title, verdicts in (
        ("The paper's claims", paper_verdicts(methods, found)),
        ("The published drift", published_verdicts(found)),
    ):
        if verdicts:
            print(f"\n{title}\n")
            show_table(["method", "claim", "verdict", "measured"], [_cells(verdict) for verdict in verdicts])
    print(f"\n{summary(methods, found)}")
    if options.out:
        drawn = [one for one in found if one.method in _DRAWN] or found
        draw(drawn, options.out)
        print(f"wrote {options.out}")
    if options.page:
        write_page(
            Path(options.page),
            methods,
            found,
            command=_command(options),
            given={chosen.method(name).name: name for name in options.methods or ()},
            chaos=bench.chaos(),
            picture=os.path.relpath(options.out, Path(options.page).parent) if options.out else None,
        )
        print(f"wrote {options.page}")


def _command(options: argparse.Namespace) -> str:
    words = ["python", "benchmarks/claims.py", *(["--all"] if options.all else [])]
    words += ["--methods", *map(shlex.quote, options.methods)] if options.methods else []
    words += ["--steps", str(options.steps)] if options.steps else []
    words += ["--out", options.out] if options.out else []
    return " ".join([*words, "--page", options.page])


def _cells(verdict: Verdict) -> list[str]:
    return [verdict.method, verdict.claim, word(verdict), verdict.measured]


def _methods(options: argparse.Namespace) -> list[Method]:
    if options.methods:
        return chosen.methods(options.methods)
    rigid = {name: entry for name, entry in ENTRIES.items() if issubclass(ml.RigidBody, entry.method.bodies)}
    if options.all:
        pairs = [
            find_method(f, s)
            for f in FLIGHTS.values()
            if f.body is ml.RigidBody
            for s in SCHEMES.values()
            if not s.random
        ]
        return [*{method.name: method for method in (*(e.method for e in rigid.values()), *pairs)}.values()]
    seen: set[str] = set()
    found: list[Method] = []
    for entry in rigid.values():
        method = entry.method
        new = method is RK4 or method.keeps_energy
        if isinstance(method, Splitting):
            parts = {f"flight {method.flight.name}", f"scheme {method.scheme.name}"}
            new = not parts <= seen
            seen |= parts
        if new or entry.paper:
            found.append(method)
    return found


def _measured(bench: Bench, methods: list[Method]) -> list[Measured]:
    with progress_bar(_STAGES * len(methods), "part") as bar, ThreadPoolExecutor(min(2, cores())) as pool:
        # The alternating method first: what all methods share is computed with it, before others start.
        first = next((i for i, method in enumerate(methods) if is_alternating(method)), 0)

        def one(method: Method) -> Measured:
            def done(part: str) -> None:
                bar.set_description(f"{method.name}: {part}")
                bar.update()

            return bench.measure(method, done)

        found = {first: one(methods[first])}
        rest = [i for i in range(len(methods)) if i != first]
        found |= dict(zip(rest, pool.map(one, [methods[i] for i in rest]), strict=True))
    return [found[i] for i in range(len(methods))]


# ---- the tables, for the terminal, for docs/reports/claims.md and for its data files ----

HEADS = (
    *("method", "order", "defect, h=0.1", "area, h=0.1", "R Pi", "reversal", "top: shift", "top: osc."),
    *("drift: first", "last", "ev.", "solves", "error, top", "error, P1", "ok"),
)

TRIED = ("method", "claim", "measured", "verdict", "command")
SHOWN = (0, 1, 2, 4, 5, 8, 9, 13)  # the columns of `HEADS` on the page; the data file has all


def cells(found: Measured) -> list[str]:
    shift, oscillation = trend(found)
    drifts = found.drift.eighths[0]
    return [
        found.method,
        f"{found.order:.2f}",
        f"{found.symplectic[-1]:.0e}",
        f"{found.area[-1]:.0e}",
        f"{found.momentum:.0e}",
        f"{found.reversal:.0e}",
        f"{shift:.1e}",
        f"{oscillation:.1e}",
        f"{drifts[0]:.1e}",
        f"{drifts[-1]:.1e}",
        str(found.work.evaluations) + ("" if found.work.explicit else " implicit"),
        str(found.solves),
        f"{found.accuracy:.1e}",
        f"{found.accuracy_p1:.1e}",
        "yes" if found.ok else "NO",
    ]


def word(verdict: Verdict) -> str:
    return "holds" if verdict.holds else "FALLS"


def summary(methods: Sequence[Method], all_found: Sequence[Measured]) -> str:
    verdicts = [v for m, f in zip(methods, all_found, strict=True) for v in registry_verdicts(m, f)]
    falls = [v for v in verdicts if not v.holds]
    text = f"{len(verdicts) - len(falls)} of {len(verdicts)} declarations of the registry hold."
    return text + "".join(f"\n{v.method}: {v.claim} FALLS, measured {v.measured}." for v in falls)


def write_page(
    file: Path,
    methods: Sequence[Method],
    all_found: Sequence[Measured],
    *,
    command: str,
    given: Mapping[str, str],
    chaos: str,
    picture: str | None,
) -> None:
    """Writes what was measured into docs/reports/claims.md, or another page, and the data files beside it.

    `given` says how the command calls a method, by its name, where it does not call it so.
    """

    def alone(method: str) -> str:
        return f"python benchmarks/claims.py --methods '{given.get(method, method)}'"

    def tried(verdicts: Sequence[Verdict]) -> list[str]:
        rows = [
            [f"`{v.method}`", v.claim, v.measured, word(v), f"`{command if v.key == RANK else alone(v.method)}`"]
            for v in verdicts
        ]
        return table(TRIED, rows)

    paper = paper_verdicts(methods, all_found)
    claims, drifts = tried(paper), tried(published_verdicts(all_found))
    figures = table(HEADS, [[f"`{row[0]}`", *row[1:]] for row in map(cells, all_found)])
    data = {"claims": claims, "drifts": drifts, "figures": figures, "declared": _declared(methods, all_found)}
    for name, lines in data.items():
        save(f"claims-{name}", lines, file.parent / "tables")
    sections = {
        "claims outcome": [outcome(paper)],
        "claims chaos": [f"The motion of the tops is chaotic: {chaos}"],
        "claims verdicts": [*_of_first_method(claims), "", link("claims-claims")],
        "claims drifts": [*part(drifts, columns=range(4)), "", link("claims-drifts")],
        "claims values": [*part(figures, columns=SHOWN), "", link("claims-figures")],
        "claims declared": [summary(methods, all_found), "", link("claims-declared")],
    }
    if file.resolve() == REPORTS / "claims.md":
        for mark, lines in sections.items():
            put("reports/claims.md", mark, lines)
        return
    drawn = [f"![Energy over the two long runs]({picture})", ""] if picture else []
    text = [line for lines in sections.values() for line in (*map(compact, lines), "")]
    file.write_text("\n".join(["# The claims", "", f"Written by `{command}`.", "", *text, *drawn]))


def outcome(verdicts: Sequence[Verdict]) -> str:
    groups: dict[str, list[str]] = {}
    for method in dict.fromkeys(v.method for v in verdicts):
        own = [v for v in verdicts if v.method == method]
        falls = [v.claim for v in own if not v.holds]
        text = f"{len(own) - len(falls)} of {len(own)} claims hold."
        text += f" These do not:\n{'; '.join(falls)}." if falls else ""
        groups.setdefault(text, []).append(f"`{method}`")
    return "\n".join(f"For {' and '.join(methods)}, {text}" for text, methods in groups.items())


def _of_first_method(lines: Sequence[str]) -> list[str]:
    first = cells_of(lines[2])[0] if len(lines) > 2 else ""
    return part(lines, lambda row: row[0] == first, range(1, 4))


def _declared(methods: Sequence[Method], all_found: Sequence[Measured]) -> list[str]:
    rows: list[list[str]] = []
    for method, found in zip(methods, all_found, strict=True):
        words = {v.key: word(v) for v in registry_verdicts(method, found)}
        rows.append([f"`{found.method}`", *(words.get(key, "-") for key in DECLARED)])
    return table(["method", *DECLARED], rows)


# ---- the picture: the mean energy error over the two long runs, for each method ----

_COLOURS = (
    *("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00"),
    *("#56B4E9", "#000000", "#A03060", "#1B3A6B", "#662506"),
)
MOST = len(_COLOURS)


def draw(all_found: Sequence[Measured], path: str) -> None:
    shown, middles = all_found[:MOST], np.arange(EIGHTHS) + 0.5

    def lines(time: Any, values: Sequence[Any]) -> list[Line]:
        look: Any = {"linewidth": 2, "marker": "o", "markersize": 4}
        rows = zip(shown, values, _COLOURS, strict=False)
        return [Line(found.method, time, value, colour, "-", True, look) for found, value, colour in rows]

    drifts = lines(10 / EIGHTHS * middles, [found.drift.eighths[0] for found in shown])
    time = 0.05 * all_found[0].steps / 1000 / EIGHTHS * middles
    tops = lines(time[1:], [shifts(found)[1:] for found in shown])
    across = "time [1000 units of time]"
    shift = "mean energy error relative to the first eighth [initial energy]"
    panels = [
        Panel("Drift test, h = 0.25", across, "mean energy error [unit of energy]", drifts),
        Panel("Chaotic heavy tops, h = 0.05", across, shift, tops, {"yscale": "log"}),
    ]
    title = "JACOBI[EA] and SLIEMID[EA] have no energy trend in either test"
    right = f"right, {all_found[0].steps:.0e} steps and the root mean square over the tops."
    note = f"Means over eighths of the run; {right}"
    chart(Path(path), [panels], (14.0, 6.2), title, note, bottom=0.11, wspace=0.2)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--methods", nargs="+", metavar="NAME", help=f"only these methods{OWN}")
    which.add_argument("--all", action="store_true", help="every method, and every flight with every scheme: hours")
    parser.add_argument("--steps", type=whole(8, MOST_STEPS), metavar="N", help="steps of the long run (default: 1e6)")
    parser.add_argument("--page", type=file(".md"), metavar="FILE", help="write figures and verdicts as Markdown")
    parser.add_argument("--out", type=file(".png"), metavar="FILE", help="draw the energy over the long runs, as a PNG")
    options = parser.parse_args(arguments)
    try:
        claims(options)
    except (ValueError, ImportError, OSError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
