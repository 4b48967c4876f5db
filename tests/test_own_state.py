"""A kind of body and state from outside the package, `travelling.py`, through every driver.

It falls in a uniform field, is drawn to the origin the more the further its axis is turned there, and has gravity on
its axis: neither its place nor its attitude moves by itself.
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import numbers, quick, whole
from on_rail import OnRail, OnRailState, Slide
from scipy.integrate import solve_ivp
from travelling import Travel, Traveller, Travelling

import midlie_jax as ml
from midlie_jax.cli.scenes import Scene, perturbed
from midlie_jax.model.free_body import Momenta

BODY = Traveller(jnp.array([1.0, 2.0, 2.5]), jnp.array(3.0))
START = Travelling(
    jnp.array([1.0, 0.8, -1.3]),
    ml.so3.exp(jnp.array([0.3, -0.2, 0.1])),
    jnp.array([3.0, 6, 9]),
    jnp.array([0.5, 0.2, 2]),
)
SPAN = 0.64


def potential(weight, t, state):
    frame = ml.so3.to_matrix(state.attitude)
    return 29.43 * state.position[2] + weight * frame[2, 2] + 0.5 * jnp.sum(state.position**2) * frame[0, 1]


def pull(weight=2.0):
    return ml.torques.FromPotential(jax.tree_util.Partial(potential, jnp.asarray(weight)))


def end(method, steps, weight=2.0, torque=True, **options):
    method = ml.method(Travel(), method) if method in ("EA", "CHIN4A", "SRKN6b") else method
    force = pull(weight) if torque else None
    return ml.integrate(method, BODY, force, START, dt=SPAN / steps, steps=steps, save_every=steps, **options)


@pytest.fixture(scope="module")
def truth():
    """The end of the motion by SciPy on the 13 numbers; the force by the package's derivative of the potential."""

    @jax.jit
    def rate(y):
        state = Travelling(y[:3], y[3:7], y[7:10], y[10:])
        force = pull()(0.0, state)
        velocity = BODY.velocity(Momenta(state.momentum, state.linear))
        quaternion = ml.so3.multiply(state.attitude, jnp.concatenate([jnp.zeros(1), velocity.angular])) / 2
        turning = jnp.cross(state.momentum, velocity.angular) + force.torque
        return jnp.concatenate([turning, quaternion, force.force, velocity.linear])

    y0 = np.concatenate(jax.tree.leaves(START))
    return solve_ivp(lambda t, y: rate(y), (0, SPAN), y0, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def error(state, truth):
    return float(np.max(np.abs(np.concatenate([np.asarray(x).reshape(-1) for x in jax.tree.leaves(state)]) - truth)))


def test_it_takes_twenty_lines():
    text = Path(__file__).with_name("travelling.py").read_text()
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 20
    page = (Path(__file__).parent.parent / "docs" / "extending.md").read_text()
    assert text.split("import midlie_jax as ml\n", 1)[1].strip() in page


def test_a_free_one_moves_as_two_bodies_would():
    path = numbers(quick(partial(end, "EA", 16, torque=False))())
    alone = ml.integrate(
        "JACOBI[EA]",
        ml.RigidBody(BODY.moments),
        None,
        ml.RigidState(START.momentum, START.attitude),
        dt=SPAN / 16,
        steps=16,
    )
    np.testing.assert_allclose(path.states.attitude[-1], alone.states.attitude[-1], atol=1e-14)
    np.testing.assert_allclose(path.states.position[-1], START.position + SPAN / 3 * START.linear, atol=1e-14)
    np.testing.assert_array_equal(path.states.linear[-1], START.linear)


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("method", "order"), [("EA", 2), *whole(("CHIN4A", 4), ("SRKN6b", 6)), ("RK4", 4), *whole(("GBS12", 12))]
)
def test_methods_have_their_order(method, order, truth):
    steps = 2 if method == "GBS12" else 16
    paths = [quick(partial(end, method, n))() for n in (steps, 2 * steps)]
    coarse, fine = (error(jax.tree.map(lambda x: x[-1], path.states), truth) for path in paths)
    assert all(path.ok for path in paths)
    assert fine < 1e-3
    assert np.log2(coarse / fine) > order - 0.7


@pytest.mark.sample(0)
def test_the_energy_is_kept_by_a_symplectic_method():
    path = quick(
        lambda: ml.integrate(ml.method(Travel(), "EA"), BODY, pull(), START, dt=0.01, steps=400, save_every=10)
    )()
    energies = np.asarray(ml.observe.energy(BODY, pull(), path))
    assert path.ok
    assert np.ptp(energies) < 3e-3 * np.ptp(np.asarray(ml.observe.kinetic_energy(BODY, path.states)))


@pytest.mark.sample(0)
def test_ensemble_simulate_and_a_split_run_give_the_run_of_one(tmp_path):
    many = jax.tree.map(lambda x: jnp.stack([x, x, x]), START)
    run = {"dt": 0.01, "steps": 64, "save_every": 32}
    method = ml.method(Travel(), "EA")
    one = quick(lambda: ml.integrate(method, BODY, pull(), START, **run))()
    path = ml.ensemble(method, BODY, pull(), many, torque_axes=None, **run)
    for x, y in zip(jax.tree.leaves(path.states), jax.tree.leaves(one.states), strict=True):
        np.testing.assert_allclose(x, np.broadcast_to(y, x.shape), atol=1e-13)
    saved = ml.simulate(method, BODY, pull(), many, out=tmp_path / "run.zarr", torque_axes=None, progress=False, **run)
    assert saved.ok.all()
    for x, y in zip(jax.tree.leaves(saved.states()), jax.tree.leaves(path.states), strict=True):
        np.testing.assert_allclose(x, y, atol=1e-13)
    middle = jax.tree.map(lambda x: x[:, 1], path.states)
    rest = ml.ensemble(method, BODY, pull(), middle, torque_axes=None, first_step=32, dt=0.01, steps=32)
    for x, y in zip(jax.tree.leaves(rest.states), jax.tree.leaves(path.states), strict=True):
        np.testing.assert_array_equal(x, y[:, -1])


@pytest.mark.sample(0)
def test_adaptive_steps_follow_a_density(truth):
    path = ml.integrate_variable_step(
        ml.method(Travel(), "EA"),
        BODY,
        pull(),
        START,
        density=lambda t, s: 1 + 0.1 * jnp.sum(s.position**2),
        dt=0.02,
        t1=SPAN,
        steps=100,
    )
    assert path.ok
    assert error(jax.tree.map(lambda x: x[-1], path.states), truth) < 1e-2


@pytest.mark.sample(0)
@pytest.mark.parametrize("dense", ["cubic", *whole("step")])
def test_diffrax_takes_it(dense, truth):
    """Constant and controlled steps, dense output, and diffrax's own solver of the same term."""
    term = ml.diffrax.RigidBodyTerm(BODY, pull())
    times = jnp.array([SPAN / 3, SPAN])
    control = diffrax.PIDController(rtol=0, atol=1e-5, norm=ml.diffrax.RotationNorm())
    ours = diffrax.diffeqsolve(
        term,
        ml.diffrax.LieSolver(ml.method(Travel(), "EA"), dense=dense),
        0.0,
        SPAN,
        0.01,
        START,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=control,
    )
    control = diffrax.PIDController(rtol=1e-10, atol=1e-10)
    theirs = diffrax.diffeqsolve(
        term, diffrax.Tsit5(), 0.0, SPAN, 0.01, START, saveat=diffrax.SaveAt(ts=times), stepsize_controller=control
    )
    for k in (0, 1):
        a, b = (jax.tree.map(lambda x, k=k: x[k], s.ys) for s in (ours, theirs))
        assert error(a, np.concatenate(jax.tree.leaves(b))) < 2e-3
    assert error(jax.tree.map(lambda x: x[-1], theirs.ys), truth) < 1e-7


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    "adjoint",
    [ml.adjoints.Reversible(), *whole(ml.adjoints.Checkpointed(), ml.adjoints.Forward())],
    ids=lambda x: type(x).__name__,
)
def test_gradients(adjoint):
    def place(weight):
        return end("EA", 16, weight, adjoint=adjoint).states.position[-1, 0]

    derivative = jax.jacfwd if isinstance(adjoint, ml.adjoints.Forward) else jax.grad
    found, h = float(quick(derivative(place))(2.0)), 1e-4
    run = quick(place)
    assert found == pytest.approx(float(run(2 + h) - run(2 - h)) / (2 * h), rel=1e-6)
    assert abs(found) > 1e-5


@pytest.mark.sample(0)
def test_check_judges_its_step():
    method = ml.method(Travel(), "EA")
    found = ml.check(method, BODY, pull(), START, dt=0.01, steps=100)
    assert found.solved
    assert found.turn > 0
    # A spring of the strength |R_01| at most pulls the mass 3 to the origin.
    assert 0.1 < found.rate < 20
    assert not ml.check(method, BODY, pull(), START, dt=5.0, steps=100).sane


def test_increments_are_added_and_found_again():
    """Those of an attitude are rotation vectors."""
    increment = jnp.arange(12.0) / 100
    np.testing.assert_allclose(START.plus(increment).minus(START), increment, atol=1e-15)
    assert START.described() == ml.FreeState.described()


def test_what_is_for_rigid_bodies_alone_says_so():
    fitted = ml.fitting.Rates(jnp.linspace(0.1, 0.6, 6), jnp.ones((6, 3)), 0.1)
    with pytest.raises(ValueError, match="Rates must be of a rigid body, got a Traveller from the model"):
        ml.fit(
            lambda values: (BODY, pull(values["w"]), START),
            {"w": ml.fitting.Free(2.0)},
            [fitted],
            dt=0.02,
            method="RK4",
        )
    with pytest.raises(ValueError, match="recommend supports rotating bodies, got body Traveller"):
        ml.recommend(BODY, pull(), START, tolerance=1e-3, duration=1.0)


def test_wrong_forces_are_refused_with_what_is_wanted():
    def several(t, state):
        return jnp.zeros(3), jnp.zeros(3)

    def short(t, state):
        return Momenta(jnp.zeros(3), jnp.zeros(2))

    wanted = "must return a midlie_jax.torques.Wrench", r"must return float64\[3\].*got float64\[2\]"
    for torque, message in zip((several, short), wanted, strict=True):
        with pytest.raises(ValueError, match=message):
            ml.integrate(ml.method(Travel(), "EA"), BODY, torque, START, dt=0.01, steps=1)
    with pytest.raises(ValueError, match="belongs to a Traveller"):
        ml.integrate(ml.method(Travel(), "EA"), ml.RigidBody(BODY.moments), None, START, dt=0.01, steps=1)
    with pytest.raises(ValueError, match="moves RigidBody, but body is Traveller"):
        ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.01, steps=1)


class Constants(NamedTuple):
    moment: jax.Array

    def velocity(self, momentum):
        return jax.tree.map(lambda p: p / self.moment, momentum)

    def commutator(self, force):
        return jax.tree.map(jnp.zeros_like, force)

    def square_of_turn(self, h, momentum):
        return (h * momentum[0] / self.moment) ** 2

    def nutation(self, momentum):
        return jnp.zeros_like(momentum[0])


class Wheel(ml.base.Body):
    moment: jax.Array

    def inertia(self):
        return Constants(self.moment)


class Spinning(ml.flights.Flight):
    name, order, symplectic, body, per_loop = "SPINNING", None, True, Wheel, 2

    def __call__(self, inertia, h, momentum):
        (rate,) = inertia.velocity(momentum)
        return (h * rate,), (jnp.zeros_like(h),), jnp.array(True)


def test_an_angle_swings_as_a_pendulum():
    class Pendulum(ml.base.State):
        momentum: jax.Array
        angle: jax.Array
        body = Wheel
        leaves = (ml.base.Leaf,)

    wheel, start = Wheel(jnp.array(0.5)), Pendulum(jnp.array([0.4]), jnp.array([1.2]))
    weight = ml.torques.FromPotential(lambda t, state: -2.0 * jnp.cos(state.angle[0]))
    exact = solve_ivp(lambda t, y: [-2 * np.sin(y[1]), 2 * y[0]], (0, 1), [0.4, 1.2], "DOP853", rtol=1e-12, atol=1e-13)
    for method, within in ((ml.method(Spinning(), "SRKN6b"), 1e-6), ("RK4", 1e-5)):
        path = quick(lambda m=method: ml.integrate(m, wheel, weight, start, dt=0.025, steps=40, save_every=40))()
        found = np.concatenate([path.states.momentum[-1], path.states.angle[-1]])
        np.testing.assert_allclose(found, exact.y[:, -1], atol=within)
        assert path.ok
    many = jax.tree.map(lambda x: jnp.stack([x, 2 * x]), start)
    increment = jnp.array([[0.1, 0.2], [0.3, 0.4]])
    np.testing.assert_allclose(many.plus(increment).minus(many), increment, atol=1e-15)


RAIL = OnRail(jnp.array([1.0, 2.0, 2.5]), jnp.array(0.7))
ON_RAIL = OnRailState(jnp.array([1.0, 0.8, -1.3, 0.3]), jnp.array([1.0, 0.0, 0.0, 0.0, 0.5]))


def spring(stiffness=4.0):
    """A spring, and a field that grows along the rail and acts on the axis e3."""

    def energy(stiffness, t, state):
        x, height = state.pose[4], ml.so3.to_matrix(state.pose[:4])[2, 2]
        return stiffness * x**2 / 2 - (1.5 + 0.8 * x) * height

    return ml.torques.FromPotential(jax.tree_util.Partial(energy, jnp.asarray(stiffness)))


@pytest.mark.sample(0)
def test_one_leaf_holds_a_rotation_and_a_distance():
    @jax.jit
    def rate(y):
        state = OnRailState(y[:4], y[4:])
        force, velocity = spring()(0.0, state), RAIL.velocity(state.momentum)
        quaternion = ml.so3.multiply(state.pose[:4], jnp.concatenate([jnp.zeros(1), velocity[:3]])) / 2
        turning = jnp.cross(state.momentum[:3], velocity[:3]) + force[:3]
        return jnp.concatenate([turning, force[3:], quaternion, velocity[3:]])

    y0 = np.concatenate(jax.tree.leaves(ON_RAIL))
    exact = solve_ivp(lambda t, y: rate(y), (0, 0.5), y0, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    method = ml.method(Slide(), "EA")

    def errors(steps):
        path = quick(lambda: ml.integrate(method, RAIL, spring(), ON_RAIL, dt=0.5 / steps, steps=steps))()
        assert path.ok
        np.testing.assert_allclose(ml.observe.energy(RAIL, spring(), path), -0.33771429, atol=1e-3)
        return error(jax.tree.map(lambda x: x[-1], path.states), exact)

    assert np.log2(errors(16) / errors(32)) == pytest.approx(2, abs=0.1)
    bodies = OnRail(jnp.stack([RAIL.moments, 2 * RAIL.moments]), jnp.array([0.7, 0.9]))
    many = jax.tree.map(lambda x: jnp.stack([x, x]), ON_RAIL)
    path = ml.ensemble(method, bodies, spring([4.0, 5.0]), many, dt=0.02, steps=16)
    second = jax.tree.map(lambda x: x[1], bodies)
    one = quick(lambda: ml.integrate(method, second, spring(5.0), ON_RAIL, dt=0.02, steps=16))()
    for x, y in zip(jax.tree.leaves(path.states), jax.tree.leaves(one.states), strict=True):
        np.testing.assert_allclose(x[1], y[-1], atol=1e-13)


def test_wrong_shapes_of_a_custom_kind_are_named():
    class Short(ml.base.State):
        momentum: jax.Array
        attitude: jax.Array
        linear: jax.Array
        position: jax.Array
        body = Traveller
        leaves = ml.FreeState.leaves

    travel, slide = ml.method(Travel(), "EA"), ml.method(Slide(), "EA")
    short = Short(START.momentum, START.attitude, jnp.ones(1), jnp.ones(1))
    rows = Traveller(jnp.ones((3, 3)), jnp.ones(3))
    several = jax.tree.map(lambda x: jnp.stack([x, x, x]), START)
    run = {"dt": 0.01, "steps": 1}
    with pytest.raises(ValueError, match=r"start\.linear must have shape \(3,\), got \(1,\)\. Put variables other"):
        ml.integrate(travel, BODY, None, short, **run)
    message = r"velocity of Traveller must be 6 scalars.*got 6 numbers of shape \(3,\)\..*property Traveller\.batch"
    with pytest.raises(ValueError, match=message):
        ml.ensemble(travel, rows, None, several, **run)
    with pytest.raises(ValueError, match=r"rate of OnRail must be 4 scalars like the pose.*got 5 numbers\. Define"):
        ml.integrate(slide, RAIL, None, OnRailState(ON_RAIL.momentum, jnp.array([1.0, 0, 0, 0])), **run)
    with pytest.raises(ValueError, match=r"start\.momentum must be an array, got list; use jnp\.array"):
        ml.integrate(slide, RAIL, None, OnRailState([1.0, 0.8, -1.3, 0.3], ON_RAIL.pose), **run)
    scene = Scene("rail", "a body on a rail", RAIL, None, ON_RAIL, 0.01, 1.0, "this test", "any")
    with pytest.raises(ValueError, match=r"a kind of midlie_jax, got OnRailState; call midlie_jax\.integrate"):
        perturbed(scene, 2, 0.01)


class NumbersOnRail(OnRail):
    @property
    def batch(self):
        return ()


@pytest.mark.sample(0)
def test_a_body_may_hold_python_numbers_instead_of_arrays():
    method, run = ml.method(Slide(), "EA"), {"dt": 0.01, "steps": 4}
    path = ml.integrate(method, NumbersOnRail([1.0, 2.0, 2.5], 0.7), None, ON_RAIL, **run)
    np.testing.assert_allclose(
        path.states.pose, ml.integrate(method, RAIL, None, ON_RAIL, **run).states.pose, atol=1e-15
    )


def test_a_custom_state_with_two_leaves_translates():
    """Under the names of its fields, which observables do not know."""

    class Thrown(ml.base.State):
        momentum: jax.Array
        turned: jax.Array
        push: jax.Array
        place: jax.Array
        body = ml.FreeBody
        leaves = ml.FreeState.leaves

    arrays = jnp.array([1.0, 2.0, 3.0]), jnp.array([0.8, 0.6, 0.0, 0.0]), jnp.array([4.0, 5.0, 6.0]), jnp.arange(3.0)
    own, free = Thrown(*arrays), ml.FreeState(*arrays)
    body = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.5]), 2.0)
    for quantity in (ml.observe.linear_momentum, ml.observe.position, lambda s: ml.observe.linear_velocity(body, s)):
        np.testing.assert_array_equal(quantity(own), quantity(free))
