"""A kind of body and state from outside the package, `travelling.py`, through every driver."""

from functools import partial
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, whole
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


def end(method, steps, weight=2.0, **options):
    method = ml.method(Travel(), method) if method in ("EA", "CHIN4A", "SRKN6b") else method
    force = pull(weight)
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


@pytest.mark.sample(0)
@pytest.mark.parametrize(("method", "order"), [("EA", 2), ("RK4", 4), *whole(("CHIN4A", 4), ("SRKN6b", 6))])
def test_methods_have_their_order(method, order, truth):
    steps = 16
    paths = [quick(partial(end, method, n))() for n in (steps, 2 * steps)]
    coarse, fine = (error(jax.tree.map(lambda x: x[-1], path.states), truth) for path in paths)
    assert all(path.ok for path in paths)
    assert fine < 1e-3
    assert np.log2(coarse / fine) > order - 0.7


@pytest.mark.sample(0)
def test_other_drivers_give_the_run_of_one_and_it_has_a_gradient(tmp_path):
    many, method = jax.tree.map(lambda x: jnp.stack([x, x, x]), START), ml.method(Travel(), "EA")
    run, shared = {"dt": 0.01, "steps": 64, "save_every": 32}, {"torque_axes": None}
    one = quick(lambda: ml.integrate(method, BODY, pull(), START, **run))()
    path = ml.ensemble(method, BODY, pull(), many, **shared, **run)
    saved = ml.simulate(method, BODY, pull(), many, out=tmp_path / "run.zarr", progress=False, **shared, **run)
    for x, y, z in zip(*map(jax.tree.leaves, (path.states, one.states, saved.states())), strict=True):
        np.testing.assert_allclose(x, np.broadcast_to(y, x.shape), atol=1e-13)
        np.testing.assert_allclose(x, z, atol=1e-13)
    varied = ml.integrate_variable_step(method, BODY, pull(), START, density=lambda t, s: 1.0, dt=0.01, steps=64)
    for x, y in zip(*map(jax.tree.leaves, (varied.states, one.states)), strict=True):
        np.testing.assert_allclose(x[-1], y[-1], atol=1e-11)
    assert ml.check(method, BODY, pull(), START, dt=0.01, steps=100).sane
    slope, place = 1e-4, lambda weight: end("EA", 16, weight, adjoint=ml.adjoints.Reversible()).states.position[-1, 0]
    found, run = float(quick(jax.grad(place))(2.0)), quick(place)
    assert found == pytest.approx(float(run(2 + slope) - run(2 - slope)) / (2 * slope), rel=1e-6)


@pytest.mark.sample(0)
def test_diffrax_takes_it(truth):
    """With controlled steps; as diffrax's own solver of the same term."""
    near = diffrax.PIDController(rtol=0, atol=1e-5, norm=ml.diffrax.RotationNorm())
    solver, term = (
        ml.diffrax.LieSolver(ml.method(Travel(), "EA"), dense="cubic"),
        ml.diffrax.RigidBodyTerm(BODY, pull()),
    )
    exact = diffrax.PIDController(rtol=1e-10, atol=1e-10)
    for used, control, bound in ((solver, near, 2e-3), (diffrax.Tsit5(), exact, 1e-7)):
        found = diffrax.diffeqsolve(term, used, 0.0, SPAN, 0.01, START, stepsize_controller=control).ys
        assert error(jax.tree.map(lambda x: x[-1], found), truth) < bound


def test_increments_are_added_and_found_again():
    """Those of an attitude are rotation vectors."""
    increment = jnp.arange(12.0) / 100
    np.testing.assert_allclose(START.plus(increment).minus(START), increment, atol=1e-15)
    assert START.described() == ml.FreeState.described()


def test_wrong_forces_are_refused_with_what_is_wanted():
    travel, run = ml.method(Travel(), "EA"), {"dt": 0.01, "steps": 1}
    several = jnp.zeros(3), jnp.zeros(3)
    for method, body, torque, message in (
        (travel, BODY, lambda t, s: several, "must return a midlie_jax.torques.Wrench"),
        (travel, BODY, lambda t, s: Momenta(jnp.zeros(3), jnp.zeros(2)), r"must return float64\[3\].*got float64\[2\]"),
        (travel, ml.RigidBody(BODY.moments), None, "belongs to a Traveller"),
        ("JACOBI[EA]", BODY, None, "moves RigidBody, but body is Traveller"),
    ):
        with pytest.raises(ValueError, match=message):
            ml.integrate(method, body, torque, START, **run)


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
