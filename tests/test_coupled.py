"""Laws of bodies that act on each other, over all flights, schemes and dtypes: few, number by number, and many."""

import re
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import travel_cases
from cases import DTYPES, benchmark, epsilon, loop_bodies, quick, real, whole
from coupled_cases import ALL, DT, FEW, FIELD, KINDS, STEPS, forced, integrate, run, start, truth
from travel_cases import at, gap, stacked

import midlie_jax as ml
from midlie_jax.integrators.splitting import Splitting
from midlie_jax.model.states import Coupled

CASES = [*FEW, *whole(*(case for case in ALL if case not in FEW))]
BY_TURNS = [(*case, DTYPES[(n + 1) % 2]) for n, case in enumerate(FEW)]
BY_TURNS += whole(*((*case, dtype) for case in ALL for dtype in DTYPES if (*case, dtype) not in BY_TURNS))


roundings = partial(travel_cases.roundings, steps=STEPS)


@cache
def paths(kind, name, dtype):
    return run(kind, name, stacked(*[start(kind, dtype)] * len(DT)), DT)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name"), CASES)
def test_order(kind, name):
    order, found, exact = ml.method(name).order, paths(kind, name, "float64"), truth(kind, 0.5)
    assert np.all(found.ok)
    errors = [np.linalg.norm(at(found.states, level, 8 << level).minus(exact)) for level in range(4)]
    if order > 8:  # whose errors are those of rounding
        assert min(errors) < 1e-11
        return
    slope = np.log2(errors[1] / errors[2])
    assert slope > order - 0.35 or errors[2] < 1e-12, (slope, errors)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name", "dtype"), BY_TURNS)
def test_symmetric_methods_come_back_and_a_step_of_no_length_changes_no_bit(kind, name, dtype):
    found = paths(kind, name, dtype)
    for leaf in jax.tree.leaves(found.states):
        np.testing.assert_array_equal(leaf[-1], np.broadcast_to(leaf[-1, :1], leaf[-1].shape))
    if not ml.method(name).symmetric:
        return
    dt = -np.array(DT)
    back = run(kind, name, jax.tree.map(lambda x: jnp.asarray(x[:, -1]), found.states), dt, np.full(len(dt), -STEPS))
    missed = gap(at(back.states, 2, -1), at(found.states, 2, 0))
    assert missed <= 4 * roundings(name) * epsilon(dtype), missed / epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name", "dtype"), BY_TURNS)
def test_the_momenta_of_all_together_are_kept(kind, name, dtype):
    """Linear and angular, to rounding by every splitting; the others keep them as well as they are accurate.

    So does a splitting whose forces are those at displaced places: they have a moment about the places themselves.
    """
    states, method = at(paths(kind, name, dtype).states, 1), ml.method(name)
    exact = isinstance(method, Splitting) and not method.scheme.displaced
    limit = 8 * roundings(name) * epsilon(dtype) if exact else 1e-3
    spin = np.asarray(ml.observe.spatial_momentum(states), np.float64)
    assert np.abs(spin - spin[0]).max() <= limit * np.abs(spin[0]).max()
    if KINDS[kind].travels:
        linear = np.asarray(ml.observe.linear_momentum(states), np.float64)
        assert np.abs(linear - linear[0]).max() <= limit * np.abs(np.asarray(states.linear[0])).max()


SOME = [case for case in FEW if case[1] != "JACOBI[CHIN4A]"][:6]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name"), [*SOME, *whole(*(case for case in ALL if case not in SOME))])
def test_bodies_in_another_order_move_alike(kind, name):
    order = np.roll(np.arange(KINDS[kind].count), 1)
    body = jax.tree.map(lambda x: x[order], KINDS[kind].body())
    state = type(start(kind)).of_bodies(jax.tree.map(lambda x: x[order], start(kind).of_body(slice(None))))
    moved = quick(lambda s: ml.integrate(name, body, forced(jnp.asarray(FIELD)), s, dt=DT[1], steps=STEPS))(state)
    there = at(paths(kind, name, "float64").states, 1)
    assert gap(moved.states, jax.tree.map(lambda x: x[:, order], there)) < 100 * roundings(name) * epsilon("float64")


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name"), [*SOME, *whole(*(case for case in ALL if case not in SOME))])
def test_the_whole_can_be_moved_and_turned(kind, name):
    """The motion of all bodies, moved and turned in space, is the motion moved and turned."""
    turn = ml.so3.exp(jnp.array([0.4, -0.9, 0.3]))
    shift = jnp.array([2.0, -1.0, 0.5])

    def turned(vectors):
        return ml.so3.rotate(jnp.broadcast_to(turn, (*vectors.shape[:-1], 4)), vectors)

    def moved(s):
        names = ("axis", "linear", "momentum") if KINDS[kind].axes else ("linear",)
        parts = {name: getattr(s, name) for name in s.described()}
        parts |= {name: turned(parts[name]) for name in names if name in parts}
        if "attitude" in parts:
            attitude = parts["attitude"]
            parts["attitude"] = ml.so3.multiply(jnp.broadcast_to(turn, attitude.shape), attitude)
        if "position" in parts:
            parts["position"] = turned(parts["position"]) + jnp.broadcast_to(shift, parts["position"].shape)
        return type(s)(**parts)

    found = quick(lambda s: integrate(kind, name, s, DT[1]))(moved(start(kind)))
    expected = moved(at(paths(kind, name, "float64").states, 1))
    limit = 100 * roundings(name) * epsilon("float64") if ml.method(name).keeps_momentum else 1e-4
    assert gap(found.states, expected) < limit


ALONE = ["JACOBI[EA]", *whole(*(name for kind, name in ALL if kind == "five" and name != "JACOBI[EA]"))]


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ALONE)
@pytest.mark.parametrize("kind", ["five", "two"])
def test_bodies_without_coupling_move_each_as_alone(kind, name):
    """Bit for bit without a torque, as an ensemble; under a field on each to rounding, as XLA compiles both apart."""
    body, state = KINDS[kind].body(), start(kind)
    options = {"dt": 1 / 32, "steps": STEPS}

    def both(torque):
        each = None if torque is None else ml.torques.OnEach(torque)
        replicas = jax.tree.map(lambda x: jnp.stack([x] * 8), state)
        found = ml.ensemble(name, body, each, replicas, **options).states
        alone = ml.ensemble(name, body, torque, state.of_body(slice(None)), torque_axes=None, **options).states
        return at(found, 3), alone

    found, alone = both(None)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True):
        np.testing.assert_array_equal(a, b)
    found, alone = both(ml.torques.PointMass(3.0) + ml.torques.HeavyTop(2.0))
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=100 * roundings(name) * epsilon("float64"))


SYMPLECTIC = [name for kind, name in ALL if kind == "two" and isinstance(ml.method(name), Splitting)]
FEW_SYMPLECTIC = ["JACOBI[EA]", "LIEMID[EA]", "DLM[EA]", "JACOBI[CHIN4A]"]


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", [*FEW_SYMPLECTIC, *whole(*(n for n in SYMPLECTIC if n not in FEW_SYMPLECTIC))])
def test_the_defect_on_the_phase_space_of_two_bodies(name):
    """M^T W1 M = W0 on 24 dimensions, to rounding where the flight is symplectic."""
    canonical = benchmark("claims").canonical
    state, h = start("two"), jnp.asarray(0.1)

    def end(increment):
        return integrate("two", name, state.plus(increment), h, steps=1).states

    def form(momenta):
        """Of each body, for directions (change of Pi, turn, change of p, of x)."""
        blocks = np.zeros((24, 24))
        for i, momentum in enumerate(momenta):
            block = np.zeros((12, 12))
            block[:6, :6] = canonical(momentum)[np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])]
            block[9:, 6:9], block[6:9, 9:] = np.eye(3), -np.eye(3)
            blocks[12 * i : 12 * (i + 1), 12 * i : 12 * (i + 1)] = block
        return blocks

    after = jax.tree.map(lambda x: x[-1], quick(end)(jnp.zeros(24)))
    matrix = np.asarray(quick(jax.jacfwd(lambda x: jax.tree.map(lambda y: y[-1], end(x)).minus(after)))(jnp.zeros(24)))
    defect = np.abs(matrix.T @ form(after.momentum) @ matrix - form(state.momentum)).max()
    assert (defect < 1e-12) == ml.method(name).symplectic, defect
    assert defect < 1e-2


BATCH = 517


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    "torque", [None, ml.asteroids.MutualGravity(1.0), ml.asteroids.MutualGravity(1.0, degree=4)], ids=["V", "2", "4"]
)
def test_a_step_of_two_bodies_is_four_loops(torque):
    """The kick and the flights of both; what the function reads; the function; the kick.

    The function is long, so an iteration of the loop over steps holds one step, with one copy of it.
    """
    one = partial(integrate, "two", "JACOBI[EA]", dt=0.01, torque=torque, steps=8, save_every=8)
    text = real(jax.vmap(one)).lower(stacked(*[start("two")] * BATCH)).compile().as_text()
    loops = max(len(re.findall(rf"\[{BATCH}\].* fusion\(", body)) for body in loop_bodies(text))
    assert loops == 4


@pytest.mark.sample(0)
@pytest.mark.parametrize("own_times", [False, True])
def test_the_function_of_many_bodies_is_compiled_apart_once_a_step(own_times):
    """In a branch of a conditional, also of replicas with times of their own: a select would be fused with the step."""

    def one(state, dt):
        return integrate("five", "JACOBI[SRKN6b]", state, dt, steps=8, save_every=8)

    states, dt = stacked(*[start("five")] * 3), jnp.full(3, 0.01)
    mapped = jax.vmap(one, in_axes=(0, 0 if own_times else None))
    text = quick(mapped).lower(states, dt if own_times else dt[0]).compile().as_text()
    calls = re.findall(r"= .* conditional\(", text)
    assert len(calls) == 2  # before the first step, and in the loop over the stages of a step


@pytest.mark.parametrize("name", ["LIEMID[EA]"])
def test_a_flight_of_many_bodies_is_not_repeated(name):
    """For each of its numbers, or where a step asks whether all succeeded: such programs do not end compiling."""
    body, one = ml.FreeBody(ml.RigidBody([1.0, 1.2, 1.5]), 1.0), start("five")
    many = type(one)(*(jnp.tile(x, (4, 1)) for x in jax.tree.leaves(one)))
    run = real(lambda s: ml.integrate(name, body, None, s, dt=0.01, steps=8, save_every=8))
    text = run.lower(many).compile().as_text()
    assert max(len(re.findall(r"\[20\].* fusion\(", loop)) for loop in loop_bodies(text)) < 12


class Directions(Coupled, ml.DirectionState):
    """A kind of coupled bodies that the package does not have."""


@pytest.mark.parametrize("count", [2, 5])
def test_any_kind_of_state_can_be_coupled(count):
    """A few bodies as scalars, more side by side; without a coupling each moves as it would alone."""
    body, field = ml.RigidBody([1.0, 2.0, 2.5]), ml.torques.FromPotential(lambda t, s: jnp.sum(s.direction[..., 2]))
    momenta = jnp.outer(1 + 0.1 * jnp.arange(float(count)), jnp.array([1.0, 0.8, -1.3]))
    together = Directions(momenta, jnp.tile(jnp.array([0.0, 0.6, 0.8]), (count, 1)))

    def end(state):
        path = quick(lambda: ml.integrate("JACOBI[EA]", body, field, state, dt=0.01, steps=20, save_every=20))()
        assert path.ok
        return jax.tree.map(lambda x: x[-1], path.states)

    own = end(together.of_body(1))
    assert type(own) is ml.DirectionState
    np.testing.assert_allclose(end(together).of_body(1).minus(own), np.zeros(5), atol=1e-14)
    assert list(Directions.described()["direction"][0]) == ["member", "axis"]
