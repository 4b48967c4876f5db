"""The law of paths: any two ways to compute the same thing agree.

To the bit where the documentation promises it, otherwise to rounding. `make test` runs the cheapest scenes that have
every public state and torque, `make test-rest` one path of every scene and a part of the product of some scenes and all
paths, and `make test-full` the product.
"""

import zlib
from functools import cache, partial
from itertools import chain, product
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import path_scenes
import pytest
from cases import DTYPES, REAL, epsilon, torque_classes, whole
from path_scenes import BODIES, CHEAPEST, DT, IN_TURN, SCENES, T0, cast, starts_of

import midlie_jax as ml
from midlie_jax._xla import compiler
from midlie_jax.drivers.arguments import as_method
from midlie_jax.drivers.clock import time_of
from midlie_jax.integrators.registry import entries
from midlie_jax.model.torques.reads_body import ReadsBody, without_bath

STEPS = 66
# Units in the last place of the largest number of a state. A method that solves equations stops a few units away from
# the solution.
ALLOWED, SOLVED = 16 * STEPS, 256 * STEPS


class Case(NamedTuple):
    """A scene in a dtype, with several bodies that differ in their initial states and random keys."""

    name: str
    dtype: str

    @property
    def scene(self) -> path_scenes.Scene:
        return SCENES[self.name]

    @property
    def body(self) -> Any:
        return cast(self.scene.body, self.dtype)

    def starts(self, count: int = BODIES) -> Any:
        return cast(starts_of(self.scene.start, count), self.dtype)

    def keys(self, count: int = BODIES) -> Any:
        """The same key for the same body, whatever their number."""
        return jax.vmap(partial(jax.random.fold_in, jax.random.key(7)))(jnp.arange(count))

    def torque(self, key: Any) -> Any:
        return cast(self.scene.torque(key) if self.scene.random else self.scene.torque, self.dtype)

    @property
    def torque_axes(self) -> Any:
        """Only the keys of random torques have a row for each body."""

        def axis(leaf: Any) -> int | None:
            return 0 if eqx.is_array(leaf) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else None

        torque, bath = without_bath(jax.tree.map(axis, self.torque(self.keys())))
        return torque if bath is None else (torque, bath)

    def start(self, row: int) -> Any:
        return jax.tree.map(lambda x: x[row], self.starts(row + 1))

    def run(self, row: int = 0, *, start: Any = None, **options: Any) -> ml.Path:
        torque = self.torque(self.keys(row + 1)[row])
        return integrate(self.scene.method, self.body, torque, self.start(row) if start is None else start, **options)

    def together(self, count: int, **options: Any) -> ml.Path:
        torque, bath = without_bath(self.torque(self.keys(count)))
        given = {"dt": DT, "t0": T0, "steps": STEPS, "save_every": None, "torque_axes": self.torque_axes, **options}
        start = given.pop("start", self.starts(count))
        return ml.ensemble(self.scene.method, self.body, torque, start, bath=bath, **given)

    @property
    def allowed(self) -> float:
        return (SOLVED if as_method(self.scene.method).solves else ALLOWED) * epsilon(self.dtype)


def integrate(method: str, body: Any, torque: Any, start: Any, **options: Any) -> ml.Path:
    torque, bath = without_bath(torque)
    run = {"dt": DT, "t0": T0, "steps": STEPS, "save_every": 1, **options}
    return ml.integrate(method, body, torque, start, bath=bath, **run)


@cache
def reference(case: Case, row: int = 0, first_step: int = 0) -> Any:
    """The states of a body after 0 to `STEPS` steps, each saved."""
    path = case.run(row, first_step=first_step)
    assert bool(path.ok)
    return jax.tree.map(np.asarray, path.states)


def at(states: Any, index: Any) -> Any:
    return jax.tree.map(lambda x: np.asarray(x)[index], states)


def agree(found: Any, expected: Any, allowed: float) -> None:
    """Every array of a state within the allowed relative error of its size; to the bit if this is 0."""
    for x, y in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        x, y = np.asarray(x), np.asarray(y)
        assert x.dtype == y.dtype
        assert np.all(np.isfinite(x))
        if allowed == 0:
            np.testing.assert_array_equal(x, y)
        else:
            np.testing.assert_allclose(x, y, rtol=0, atol=allowed * max(1.0, float(np.abs(y).max(initial=0.0))))


# ---- paths: each gives pairs of states that must agree ----


def every(save_every: int) -> Any:
    def pairs(case: Case, tmp_path: Any) -> Any:
        steps = STEPS // save_every * save_every
        path = case.run(steps=steps, save_every=save_every)
        assert path.ok
        yield path.states, at(reference(case), slice(0, steps + 1, save_every))

    return pairs


def at_the_end(case: Case, tmp_path: Any) -> Any:
    for steps in (1, 2, 3, STEPS):
        path = case.run(steps=steps, save_every=None)
        assert path.ok
        yield path.states, at(reference(case), steps)


def few(case: Case, tmp_path: Any) -> Any:
    for steps in (1, 2, 3):
        yield case.run(steps=steps).states, at(reference(case), slice(0, steps + 1))


def continued(case: Case, tmp_path: Any) -> Any:
    """From a saved state, with the index of its step."""
    for first in (1, 33, 64):
        start = jax.tree.map(lambda x, first=first: jnp.asarray(x[first]), reference(case))
        end = case.run(start=start, first_step=first, steps=STEPS - first, save_every=None)
        yield end.states, at(reference(case), STEPS)


def scanned(case: Case, tmp_path: Any) -> Any:
    """The user's own `lax.scan` over single steps."""

    def step(torque: Any, state: Any, n: Any) -> tuple[Any, None]:
        path = integrate(case.scene.method, case.body, torque, state, steps=1, save_every=None, first_step=n)
        return path.states, None

    @eqx.filter_jit
    def run(start: Any, torque: Any) -> Any:
        return jax.lax.scan(partial(step, torque), start, jnp.arange(STEPS, dtype=jnp.int32))[0]

    yield run(case.start(0), case.torque(case.keys()[0])), at(reference(case), STEPS)


def carried(case: Case, tmp_path: Any) -> Any:
    """From the carry of a path, one body and several."""
    for first in (1, 33, 64):
        before = case.run(steps=first, save_every=None)
        end = case.run(start=before.carry, steps=STEPS - first, save_every=None)
        yield end.states, at(reference(case), STEPS)
        assert int(end.carry.index) == STEPS
    before = case.run(steps=33, save_every=33)
    yield at(case.run(start=before.carry, steps=33, save_every=1).states, -1), at(reference(case), STEPS)
    before = case.together(BODIES, steps=33)
    yield case.together(BODIES, start=before.carry, steps=STEPS - 33).states, case.together(BODIES).states


def stepped(case: Case, tmp_path: Any) -> Any:
    """`ml.stepper` in the user's `lax.scan`, and with a number of steps that is known, or traced."""

    @eqx.filter_jit
    def run(start: Any, torque: Any, count: Any) -> Any:
        torque, bath = without_bath(torque)
        one = ml.stepper(case.scene.method, case.body, torque, start, dt=DT, t0=T0, bath=bath)
        by_scan = jax.lax.scan(lambda carry, _: (one.step(carry), None), one.init(), length=STEPS)[0]
        ends = by_scan, one.advance(one.init(), STEPS), one.advance(one.init(), count)
        return [(one.state(end), one.ok(end), one.time(end)) for end in ends]

    for state, ok, time in run(case.start(0), case.torque(case.keys()[0]), jnp.asarray(STEPS, jnp.int32)):
        assert ok
        np.testing.assert_allclose(time, T0 + STEPS * DT, rtol=1e-6)
        yield state, at(reference(case), STEPS)


def jitted(case: Case, tmp_path: Any) -> Any:
    run = eqx.filter_jit(partial(integrate, case.scene.method, save_every=None))
    yield run(case.body, case.torque(case.keys()[1]), case.start(1)).states, at(reference(case, 1), STEPS)


def mapped(case: Case, tmp_path: Any, jit: Any = lambda f: f) -> Any:
    def run(start: Any, key: Any) -> ml.Path:
        return integrate(case.scene.method, case.body, case.torque(key), start, save_every=None)

    ends = jit(jax.vmap(run))(case.starts(), case.keys()).states
    for row in range(BODIES):
        yield at(ends, row), at(reference(case, row), STEPS)


def ensembles(count: int, **options: Any) -> Any:
    def pairs(case: Case, tmp_path: Any) -> Any:
        path = case.together(count, **options)
        assert path.ok.all()
        saved = options.get("save_every")
        index = STEPS if saved is None else slice(0, STEPS + 1, saved)
        for row in {*range(min(count, BODIES)), count - 1}:
            yield at(path.states, row), at(reference(case, row), index)

    return pairs


def simulated(case: Case, tmp_path: Any) -> Any:
    """In one part, in several, and in two runs of which the second starts from the carry of the first."""

    def run(name: str, start: Any, steps: int, **cut: Any) -> ml.simulation.Simulation[Any]:
        given = {"dt": DT, "t0": T0, "steps": steps, "save_every": 22, "progress": False, "chunk": 2, **cut}
        (torque, given["bath"]), given["torque_axes"] = without_bath(case.torque(case.keys())), case.torque_axes
        return ml.simulate(case.scene.method, case.body, torque, start, out=tmp_path / f"{name}.zarr", **given)

    one = run("one", case.starts(), STEPS).states()
    several = run("several", case.starts(), STEPS, group=2, span=2)
    second = run("second", run("first", case.starts(), 22, group=2).carry, STEPS - 22, group=2)
    allowed = case.allowed if isinstance(case.scene.body, ml.TensorBody) else 0.0
    agree(several.states(), one, allowed)
    agree(second.states(), jax.tree.map(lambda x: x[:, 1:], one), allowed)
    for row in range(BODIES):
        yield at(one, row), at(reference(case, row), slice(0, STEPS + 1, 22))


def solved(case: Case, tmp_path: Any) -> Any:
    """`LieSolver` with constant steps."""
    term = ml.diffrax.RigidBodyTerm(case.body, case.torque(case.keys()[0]))
    times = jnp.asarray(T0 + DT * np.arange(STEPS + 1), case.dtype)
    solver, steps = ml.diffrax.LieSolver(case.scene.method), diffrax.StepTo(ts=times)
    span, start = (times[0], times[-1], None), case.start(0)
    solution = diffrax.diffeqsolve(term, solver, *span, start, stepsize_controller=steps, max_steps=STEPS)
    assert solution.ys is not None
    yield at(solution.ys, -1), at(reference(case), STEPS)


PATHS = {
    "at the end": at_the_end,
    **{f"every {n}": every(n) for n in (2, 32, 33, STEPS)},
    "few steps": few,
    "continued": continued,
    "carry": carried,
    "stepper": stepped,
    "scan": scanned,
    "jit": jitted,
    "vmap": mapped,
    "jit(vmap)": partial(mapped, jit=jax.jit),
    "ensemble of 1": ensembles(1),
    "ensemble of 3": ensembles(3, save_every=33, chunk=2),
    "ensemble of 257": ensembles(257, chunk=64),
    "simulate": simulated,
    "LieSolver": solved,
}


def in_bath(name: str) -> str:
    return f"bath {name}, {IN_TURN[name]}"


# One kind of scene each for all paths.
ANCHORS = [
    *("method JACOBI[EA]", in_bath("kT(t)"), "method GBS12", "state free, JACOBI[SRKN14a]"),
    *("state five axes, SYMMETRIC[EA]", in_bath("two"), in_bath("sum"), in_bath("spins")),
    *("state compensated, JACOBI[EA]", "torque GravityGradient, table", "method SW", "state particles, Verlet"),
]
# Paths that are promised to the bit; a run from a saved state, without a carry, agrees to rounding.
BITS = ["at the end", *(name for name in PATHS if name.startswith("every")), "few steps", "carry"]


def dtype_of(name: str) -> str:
    """One of the two dtypes, by turns, so that all paths of a scene have one reference."""
    return DTYPES[zlib.crc32(name.encode()) % 2]


def solvable(pairs: Any) -> list[tuple[str, str]]:
    """Without those that diffrax cannot solve: with noise, of spins, and of states that `LieSolver` refuses."""
    refused = {
        n for n, s in SCENES.items() if s.random or isinstance(s.start, ml.spins.SpinState | ml.CompensatedState)
    }
    return [(name, path) for name, path in dict.fromkeys(pairs) if path != "LieSolver" or name not in refused]


# The cheapest scenes with the end alone; one path of every scene, by turns, of torques those that no sum has; every
# fifth pair of anchors and paths, which has each of them several times. `make test-full` runs the others.
TURNED = [n for n in SCENES if not n.startswith("torque") or n.removeprefix("torque ") in path_scenes.ALONE]
PAIRS = [*product(ANCHORS, PATHS)]
BY_TURNS = [(name, [*PATHS][turn % len(PATHS)]) for turn, name in enumerate(TURNED)]
OFTEN = solvable([*((name, "at the end") for name in CHEAPEST), *BY_TURNS, *PAIRS[::5]])
SELDOM = solvable(pair for pair in [*PAIRS, *product(SCENES, ["at the end", "continued"])] if pair not in OFTEN)


def test_every_public_kind_has_a_scene():
    """A new method is in the law by being registered; a new torque or state must be added to `path_scenes.py`."""
    torques = set().union(*(path_scenes.classes_in(scene.torque) for scene in SCENES.values() if not scene.random))
    assert {*torque_classes()} <= torques
    assert {type(scene.start).__name__ for scene in SCENES.values()} == path_scenes.public_states()
    assert {*entries()} <= {scene.method for scene in SCENES.values()}
    assert {*ANCHORS} <= {*SCENES}
    assert {type(SCENES[name].start).__name__ for name in CHEAPEST} == path_scenes.public_states()


@pytest.mark.sample(len(CHEAPEST))
@pytest.mark.parametrize(("name", "path"), [*OFTEN, *whole(*SELDOM)])
def test_a_path_agrees_with_a_run_that_saves_every_step(name, path, tmp_path):
    case = Case(name, dtype_of(name))
    for found, expected in PATHS[path](case, tmp_path):
        agree(found, expected, case.allowed)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("name", "paths"),
    [
        (in_bath("kT(t)"), ["every 33"]),
        (ANCHORS[0], BITS),
        *((name, BITS[turn % 2 :: 2]) for turn, name in enumerate(ANCHORS[1:6])),
        *whole(*((name, BITS) for name in ANCHORS[6:])),
    ],
)
def test_saved_states_and_continued_runs_have_the_same_bits(name, paths, monkeypatch, tmp_path):
    """In the code that users get. The sums of GBS methods are rounded once or twice, as the compiler likes."""
    monkeypatch.setattr(compiler, "compiler_options", lambda bodies: REAL)
    reference.cache_clear()
    case = Case(name, "float64")
    for found, expected in chain.from_iterable(PATHS[path](case, tmp_path) for path in paths):
        agree(found, expected, case.allowed if name == "method GBS12" else 0.0)
    reference.cache_clear()


@pytest.mark.sample(8)
@pytest.mark.parametrize("name", dict.fromkeys([*path_scenes.STILL, *path_scenes.FASTEST]))
def test_a_step_of_no_length_is_the_identity(name):
    """To the bit, for the motion in principal axes. The force is the one at the start."""
    case = Case(name, dtype_of(name))
    method = as_method(case.scene.method).fitted(case.body)

    @eqx.filter_jit
    def step(start: Any, torque: Any, t0: Any, dt: Any, h: Any) -> Any:
        system = method.system(case.body, torque, start, t0, dt)
        before = method.begin(system, start, t0)
        n = jnp.asarray(5, jnp.int32)
        end = time_of(t0, dt, n + 1)
        return before, method.advance(system.at_step(n), (), lambda _: (end, end, None), h, before)[0]

    t0, dt = (jnp.asarray(x, case.dtype) for x in (T0, DT))
    before, after = step(case.start(0), case.torque(case.keys()[0]), t0, dt, jnp.zeros_like(dt))
    agree(after.motion, before.motion, 0.0)
    assert after.ok


# ---- derivatives ----


def along(vectors: Any, directions: Any) -> Any:
    return (vectors * directions).sum(axis=-1, keepdims=True) * directions


def numbers_of(case: Case) -> tuple[Any, Any, Any]:
    """The real numbers of initial state and torque, a random direction among them, and weights of the final state.

    Spins stay unit vectors to first order. How a compensated number is split into parts is no smooth function.
    """
    start = case.start(0)
    given = eqx.partition((start, case.torque(case.keys()[0])), eqx.is_inexact_array)
    rng = np.random.default_rng(5)

    def normal(tree: Any) -> Any:
        return jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape), x.dtype), tree)

    direction, weights = normal(given[0]), normal(start)
    if isinstance(start, ml.spins.SpinState):
        across = direction[0].spin - along(direction[0].spin, start.spin)
        direction = eqx.tree_at(lambda d: d[0].spin, direction, across)
    if isinstance(start, ml.CompensatedState):
        low = partial(eqx.tree_at, lambda state: (state.low_momentum, state.low_attitude))
        direction = low(direction[0], (jnp.zeros(3), jnp.zeros(4))), direction[1]
        weights = low(weights, (weights.momentum, weights.attitude))
    return given, direction, weights


def ends_of(how: str, case: Case, start: Any, torque: Any, adjoint: Any) -> Any:
    options = {"steps": 24, "dt": 2 * DT}
    if how == "ensemble":
        many = jax.tree.map(lambda x: jnp.stack([x, x]), start)
        torque, bath = without_bath(torque)
        options |= {"t0": T0, "adjoint": adjoint, "torque_axes": None, "bath": bath}
        path = ml.ensemble(case.scene.method, case.body, torque, many, **options)
        return jax.tree.map(lambda x: x[1], path.states)
    every = {"saved": 4, "end": None}[how]
    path = integrate(case.scene.method, case.body, torque, start, **options, save_every=every, adjoint=adjoint)
    return path.states if every is None else jax.tree.map(lambda x: x[-1], path.states)


ADJOINTS = {
    "checkpoints": ml.adjoints.Checkpointed(),
    "few checkpoints": ml.adjoints.Checkpointed(every=4),
    "reversible": ml.adjoints.Reversible(),
    "forward": ml.adjoints.Forward(),
}
WAYS = [*product(("end", "saved", "ensemble"), ADJOINTS)]
# The derivative of each of these is that of all of its kind.
SMOOTH = [
    *("method JACOBI[EA]", in_bath("kT(t)"), "state two, JACOBI[SRKN6b]", "method LIEMID[EA]", "method GBS12"),
    *("state free, JACOBI[EA]", "method PGBS12", "torque MutualGravity, many", "state axis, SYMMETRIC[EA]"),
    *("torque GravityGradient, table", "method LIEMID[I]", "torque Sunlight", "state compensated, JACOBI[EA]"),
    *("state lattice, SUBLATTICES[EA]", "state free axis, SYMMETRIC[SRKN6b]", in_bath("tensor(t)"), in_bath("sum")),
    *("method spherical midpoint", "torque PairForces", "bath field, BROWNIAN"),
]


@cache
def difference(name: str) -> float:
    """The derivative along the direction by central differences of runs with the number of steps as an argument."""
    case = Case(name, "float64")
    (numbers, others), direction, weights = numbers_of(case)

    def value(e: float) -> float:
        moved = jax.tree.map(lambda x, d: x + e * d, numbers, direction)
        end = ends_of("end", case, *eqx.combine(moved, others), None)
        return float(sum(jnp.sum(x * w) for x, w in zip(*map(jax.tree.leaves, (end, weights)), strict=True)))

    e = 1e-5
    return (8 * (value(e) - value(-e)) - (value(2 * e) - value(-2 * e))) / (12 * e)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("name", "way"), [*zip(SMOOTH, WAYS * 2, strict=False), *whole(*product(SMOOTH[:1], WAYS[1:]))]
)
def test_derivatives_agree(name, way):
    """Reverse and forward, with each adjoint, and differences; and the value is that without a derivative."""
    how, adjoint = way
    case = Case(name, "float64")
    method = as_method(case.scene.method)
    if adjoint == "reversible" and (case.scene.random or not method.symmetric):
        adjoint = "checkpoints"
    (numbers, others), direction, weights = numbers_of(case)

    def loss(numbers: Any) -> Any:
        end = ends_of(how, case, *eqx.combine(numbers, others), ADJOINTS[adjoint])
        return sum(jnp.sum(x * w) for x, w in zip(*map(jax.tree.leaves, (end, weights)), strict=True))

    plain = loss(numbers)
    if adjoint == "forward":
        value, slope = jax.jit(lambda x, d: jax.jvp(loss, (x,), (d,)))(numbers, direction)
    else:
        value, gradient = jax.jit(jax.value_and_grad(loss))(numbers)
        slope = sum(jnp.sum(x * d) for x, d in zip(*map(jax.tree.leaves, (gradient, direction)), strict=True))
    np.testing.assert_allclose(value, plain, rtol=case.allowed, atol=case.allowed)
    np.testing.assert_allclose(slope, difference(name), rtol=1e-7, atol=1e-7)


# ---- what is observed ----

OBSERVED = {
    "rigid": [
        *(ml.observe.angular_velocity, ml.observe.energy, ml.observe.spatial_momentum),
        *(ml.observe.Axis(), ml.observe.EulerAngles("ZXZ")),
    ],
    "free": [ml.observe.position, ml.observe.linear_velocity, ml.observe.energy],
}
STATISTICS = {
    "mean": ml.observe.Mean(ml.observe.Axis()),
    "histogram": ml.observe.Histogram(lambda t, state: state.momentum[2], [-1.0, -0.6, -0.5, 0.0, 1.0]),
}


@pytest.mark.sample(1)
@pytest.mark.parametrize(("state", "driver"), [("rigid", "integrate"), ("free", "ensemble"), ("rigid", "jit")])
def test_observables_are_those_of_the_saved_states(state, driver):
    body, start = path_scenes.STATES[state]
    torque = ml.torques.HeavyTop(0.9) if state == "rigid" else ml.torques.PointMass(1.2)
    observe = {str(n): one for n, one in enumerate(OBSERVED[state])}
    if driver == "ensemble":
        run = partial(ml.ensemble, "JACOBI[EA]", body, torque, starts_of(start, BODIES), dt=DT, steps=12, save_every=4)
    else:
        run = partial(ml.integrate, "JACOBI[EA]", body, torque, start, dt=DT, steps=12, save_every=4)
    call = jax.jit(run) if driver == "jit" else run
    path, seen = call(), run(observe=observe)
    for one, found in zip(observe.values(), seen.states.values(), strict=True):
        of_all = jax.vmap(lambda t, state, one=one: ml.observe.as_observable("observe", one).of(t, state, body, torque))
        of_all = jax.vmap(of_all, (None, 0)) if driver == "ensemble" else of_all
        agree(found, of_all(path.times, path.states), 1e-13)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("name", "chunk", "save_every"), [("mean", 2, None), ("histogram", 1, 33), ("mean", 5, 1), ("histogram", 2, None)]
)
def test_statistics_are_those_of_the_saved_states(name, chunk, save_every):
    """Of five bodies in chunks; the end alone, and saved states."""
    body, start = path_scenes.STATES["rigid"]
    run = partial(ml.ensemble, "JACOBI[EA]", body, ml.torques.HeavyTop(0.9), starts_of(start, 5), dt=DT, steps=STEPS)
    states = run(save_every=STEPS if save_every is None else save_every).states
    states = jax.tree.map(lambda x: x[:, -1], states) if save_every is None else states
    found = run(save_every=save_every, observe=STATISTICS[name], chunk=chunk).states
    if name == "histogram":
        numbers = np.asarray(states.momentum[..., 2])
        count = np.apply_along_axis(lambda x: np.histogram(x, [-1.0, -0.6, -0.5, 0.0, 1.0])[0], 0, numbers)
        np.testing.assert_array_equal(found, count.T if save_every is not None else count)
    else:
        axes = np.asarray(ml.so3.to_matrix(states.attitude))[..., 2]
        away = axes - axes.mean(0)
        covariance = np.einsum("n...i,n...j->...ij", away, away) / (len(axes) - 1)
        np.testing.assert_allclose(found.mean, axes.mean(0), rtol=0, atol=1e-13)
        np.testing.assert_allclose(found.covariance, covariance, rtol=0, atol=1e-13)


# ---- the physics of every torque, in its cheapest form ----


def has_potential(torque: Any) -> bool:
    """Whether all terms state a potential of their own, and none reads the velocity."""
    base, reads = ml.torques.Torque, ml.torques.BodyTorque

    def own(term: Any) -> bool:
        if not isinstance(term, base) or ml.torques.velocity_dependent(term):
            return False
        if isinstance(term, ReadsBody):
            return type(term).potential_at is not reads.potential_at
        return type(term).potential is not base.potential

    return torque is not None and all(map(own, ml.torques.terms_of(torque)))


# The sums over pairs of five bodies take long to compile, and are those of two; a torque does not depend on the orbit.
AGAIN = {
    f"torque {n}" for n in ("MutualGravity, many", "GravityGradient, Kepler", "GravityGradient, table", "PairForces")
}
CONSERVATIVE = [n for n in SCENES if n.startswith("torque") and n not in AGAIN and has_potential(SCENES[n].torque)]


@pytest.mark.parametrize("name", CONSERVATIVE)
def test_a_torque_is_minus_the_slope_of_its_potential(name):
    """For spins across each spin, because no field along a spin acts on it."""
    scene = SCENES[name]
    body, torque, start = (cast(x, "float64") for x in (scene.body, scene.torque, scene.start))
    torque = ml.torques.on_body(torque, body)

    @jax.jit
    def both(t: Any) -> Any:
        return torque(t, start), ml.torques.FromPotential(torque.potential)(t, start)

    for found, expected in zip(*map(jax.tree.leaves, both(jnp.asarray(0.4))), strict=True):
        if isinstance(start, ml.spins.SpinState):
            found, expected = (x - along(x, np.asarray(start.spin)) for x in (found, expected))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * max(1.0, float(np.abs(expected).max())))
