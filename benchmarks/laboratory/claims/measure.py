"""`Bench`: measures every property of a method that a claim is about, with one compiled program and the drift test's.

The motions are, in every measurement the same for all methods:
- `TOPS` heavy tops about the scene `asymmetric-top`, whose motion is chaotic, with a step of .05 over the long run. A
  method for bodies with two equal moments has the moments (1, 3, 3); gravity then acts across the axis of symmetry.
- `TOPS` free bodies with different moments, .2 to .5 radians a step.
- The fast top P1 of the paper's figure, with h = .005 to T = 10, against the closed form."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from midlie_jax.advice.program import Program
from midlie_jax.cli import chosen
from midlie_jax.cli.oracle import exact_motion
from midlie_jax.cli.scenes import perturbed, scene
from midlie_jax.integrators.base import Method
from midlie_jax.integrators.registry import method as find_method
from midlie_jax.integrators.splitting import Splitting
from midlie_jax.integrators.system import System
from midlie_jax.model import so3
from midlie_jax.model.bodies import RigidBody
from midlie_jax.model.states import RigidState
from midlie_jax.model.torques import HeavyTop, Torque

from ..free_bodies import free_bodies, spatial_momentum
from ..runner import Rows, Runner
from . import structure
from .drift import Drift, drift

# ---- the work of a step, counted in its trace ----
#
# The torque that is traced leaves a mark, the cube root, which nothing else in the package uses. The mark's derivative
# is a mark again, so a directional derivative of the torque, of which Newton's method needs three, counts, too.

_MARK = "cbrt"


class Work(NamedTuple):
    """Attributes:
    evaluations: torque evaluations of a step after the first, with directional derivatives.
    explicit: whether no evaluation is part of the iteration of a solve.
    """

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

    def __call__(self, t: Any, state: RigidState) -> Array:
        del t
        return _mark(state.attitude[1:])

    def potential(self, t: Any, state: RigidState) -> Array:
        del t
        return state.attitude[0]


def work(method: Method) -> Work:
    """The work of a step of a rigid body with two equal moments, under a torque that depends on the attitude."""
    body = RigidBody(jnp.array([2.0, 2.0, 3.0]))
    start = RigidState(jnp.ones(3), jnp.full(4, 0.5))
    fitted = method.fitted(body)

    def step(start: RigidState, h: Array) -> Any:
        system = System.of(body, _MarkedTorque(), start, jnp.zeros_like(h))
        motion = system.motion(start)
        force = motion.momentum if fitted.keeps_force(system) else None
        return fitted.step(system, jnp.zeros_like(h), h, h, motion, force)

    outside, inside = _marks(jax.make_jaxpr(step)(start, jnp.asarray(0.1)).jaxpr, solving=False)
    return Work(outside + inside, inside == 0)


def _marks(jaxpr: Any, solving: bool) -> tuple[int, int]:
    """The marks outside and inside of solves, which are `custom_root` calls; a mark in a loop counts for each turn.

    In jax 0.10 such a call is a function with a custom derivative; in 0.12 it is a primitive that keeps its
    parts in `_prim`.
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
        method: its name.
        order: the slope of the error over the step, on the tops; NaN if no two errors show it.
        accuracy: the error on the tops with h = 1/32, relative in the momentum and in radians, root mean square.
        accuracy_p1: the same on P1 at T = 10 with h = .005.
        symplectic: the defects on T*SO(3) of one step of the top, for `DEFECT_STEPS`.
        area: the defects of area on the momentum sphere of one free step, for `DEFECT_STEPS`.
        momentum: largest change of the spatial momentum of the free bodies over the long run, relative.
        reversal: how far from the start 64 steps of .1 forward and back end.
        energy: energy errors of the tops over the long run, relative, (samples, tops).
        drift: the drift test.
        work: torque evaluations a step, and whether all are explicit.
        solves: equations solved by iteration in a step.
        flights: flights a step, each of which rounds; at least one.
        steps: steps of the long run.
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


class Bench:
    """Measures methods; holds the exact ends of the motions, each of which is computed once."""

    def __init__(self, steps: int = STEPS):
        """Takes the number of steps of the long run, of which `SAMPLES` states are kept."""
        self.samples = min(SAMPLES, steps)
        self.every = steps // self.samples
        self.steps = self.every * self.samples
        self._ends: dict[bool, RigidState] = {}
        self._programs: dict[bool, Program] = {}
        p1 = scene("P1")
        self._p1 = perturbed(p1, ROWS, 1e-3, seed=0)
        self._p1_dt = p1.duration / _P1_STEPS
        motions = [
            exact_motion(p1.body.moments, p, q, [p1.duration], weight=20.0)
            for p, q in zip(self._p1.momentum, self._p1.attitude, strict=True)
        ]
        momenta, attitudes = (np.concatenate(part) for part in zip(*motions, strict=True))
        self._p1_end = RigidState(jnp.asarray(momenta), jnp.asarray(attitudes))

    def measure(self, method: str | Method, done: Callable[[str], None] = lambda part: None) -> Measured:
        """Everything about one method; `done` is called with the name of each finished part."""
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
        return Measured(
            method=method.name,
            order=order,
            accuracy=accuracy,
            accuracy_p1=accuracy_p1,
            symplectic=symplectic,
            area=area,
            momentum=momentum,
            reversal=reversal,
            energy=energy,
            drift=drifted,
            work=work(method),
            solves=method.solves,
            flights=method.scheme.flights if isinstance(method, Splitting) else 1,
            steps=self.steps,
            ok=all(ok) and drifted.ok,
        )

    def _exact_end(self, equal: bool) -> RigidState:
        """The tops at the end of the ladder, by a method of order 6 with 1024 steps."""
        if equal not in self._ends:
            ends = self._reference(equal).run(_TIME / 1024, 1024)[0]
            self._ends[equal] = jax.tree.map(lambda x: x[:ROWS], ends)
        return self._ends[equal]

    def _reference(self, equal: bool) -> Program:
        """A method of order 6 on the tops, and on copies of them that are displaced by `_APART`."""
        if equal not in self._programs:
            starts = _tops()
            displaced = RigidState(starts.momentum * (1 + _APART), starts.attitude)
            both = jax.tree.map(lambda *x: jnp.concatenate(x), starts, displaced)
            body = RigidBody(jnp.asarray(_EQUAL if equal else _ANY))
            self._programs[equal] = Program(find_method(_REFERENCE), body, scene("asymmetric-top").torque, both)
        return self._programs[equal]

    def chaos(self) -> str:
        """The sentence that shows that the motion of the tops is chaotic: how fast neighbours part."""
        parted = []
        for time in _PARTING:
            ends = self._reference(False).run(1 / 32, round(32 * time))[0]
            one, other = (jax.tree.map(lambda x, half=half: x[half], ends) for half in (slice(ROWS), slice(ROWS, None)))
            parted.append(f"{_error(other, one):.0e} at t = {time}")
        return f"copies whose momenta differ by {_APART:.0e} are apart by {', '.join(parted)}."

    def _order(self, runs: "_Runs", equal: bool) -> tuple[float, float]:
        """The order, from the smallest two steps whose errors are above rounding; and the error to compare."""
        exact, errors = self._exact_end(equal), []
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
    """One method's compiled program, and the runs that need no exact motion."""

    def __init__(self, method: Method, equal: bool):
        self.moments = np.array(_EQUAL if equal else _ANY)
        bodies, momentum, attitude, _ = free_bodies(equal, float, count=TOPS, seed=4)
        self.free = bodies[:TOPS], momentum[:TOPS], attitude[:TOPS]
        every_body = np.concatenate([self.moments[None], bodies[:TOPS], [[5.0, 5.0, 1.0]]])
        self.runner = Runner(method, RigidBody(jnp.asarray(every_body)), _BLOCK)
        self.weight = float(scene("asymmetric-top").torque.mgl)  # pyright: ignore

    def rows(self, moments: Any, weight: Any, start: RigidState, dt: Any) -> Rows:
        full = [jnp.broadcast_to(jnp.asarray(x, float), (ROWS,)) for x in (weight, dt)]
        return Rows(RigidBody(jnp.broadcast_to(jnp.asarray(moments), (ROWS, 3))), HeavyTop(full[0]), start, full[1])

    def tops(self, dt: float, steps: int) -> Any:
        return self.runner.run(self.rows(self.moments, self.weight, _tops(), dt), steps)

    def long_run(self) -> Rows:
        """`TOPS` tops, then as many free bodies."""
        moments, momentum, attitude = self.free
        start = jax.tree.map(lambda x: x[:TOPS], _tops())
        both = RigidState(
            jnp.concatenate([start.momentum, jnp.asarray(momentum)]),
            jnp.concatenate([start.attitude, jnp.asarray(attitude)]),
        )
        halves = [np.repeat(pair, TOPS) for pair in ((self.weight, 0.0), (_LONG_STEP, _FREE_STEP))]
        tiled = np.tile(self.moments, (TOPS, 1))
        return self.rows(np.concatenate([tiled, moments]), halves[0], both, halves[1])

    def defects(self, ok: list[bool]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The symplectic defects of steps of a top, and the defects of area of free steps, for `DEFECT_STEPS`."""
        start, attitude = np.array([1.0, 0.8, -1.3]), np.array([0.8, 0.3, -0.4, 0.33])
        near = structure.neighbours(start, attitude / np.linalg.norm(attitude))
        count = len(near.momentum)
        moments = self.moments
        many = [(weight, h) for weight in (self.weight, 0.0) for h in DEFECT_STEPS]
        weights, steps = (np.repeat(column, count) for column in zip(*many, strict=True))
        starts = jax.tree.map(lambda x: np.tile(x, (len(many), 1)), near)
        ends: list[RigidState] = []
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
            matrix, after = structure.derivative(end), np.asarray(end.momentum[0])
            measure = structure.symplectic_defect if weight else structure.area_defect
            found.append(measure(matrix, start, after))
        return tuple(found[: len(DEFECT_STEPS)]), tuple(found[len(DEFECT_STEPS) :])

    def reversal(self, ok: list[bool]) -> float:
        rows = self.rows(self.moments, self.weight, _tops(), _BACK_STEP)
        there, fine = self.runner.run(rows, _THERE)
        back, good = self.runner.run(rows._replace(start=there, dt=-rows.dt), _THERE)
        ok.append(bool(jnp.all(fine & good)))
        return _error(back, rows.start)


def _tops() -> RigidState:
    return perturbed(scene("asymmetric-top"), ROWS, 0.1, seed=1)


def _error(found: RigidState, exact: RigidState) -> float:
    """The root mean square over the rows of the errors of momentum, relative, and of attitude, in radians."""
    momentum = np.linalg.norm(found.momentum - exact.momentum, axis=1) / np.linalg.norm(exact.momentum, axis=1)
    turn = np.asarray(so3.log(so3.multiply(so3.conjugate(exact.attitude), found.attitude)))
    return float(np.sqrt(np.mean(momentum**2 + np.sum(turn**2, axis=1))))
