"""`path.result` says why a run failed, in every driver that returns a path."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import pytest
from cases import BUILDS, DTYPES, equal_moments, quick

import midlie_jax as ml
from midlie_jax import RESULTS

TOP = ml.torques.HeavyTop(20.0)
FAST = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.05, 0.0, 0.0])))


def nan_later(t, state):
    return jnp.where(t > 0.025, jnp.nan, 0.0) * jnp.ones_like(state.momentum)


def moments(name):
    return ml.RigidBody([5.0, 5.0, 1.0] if equal_moments(name) else [5.0, 4.0, 1.5])


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", [m for m in BUILDS if issubclass(ml.RigidBody, ml.method(m).bodies)])
def test_a_step_that_is_too_long_and_a_number_that_is_not_finite_are_told_apart(name):
    """However many steps follow before a state is saved, by when all numbers may be anything."""
    too_far = 1.5 * ml.method(name).reach / 30

    def results(dt, torque):
        run = partial(ml.integrate, name, moments(name), torque, dt=dt, steps=40)
        return [quick(lambda s, every=every: run(s, save_every=every).result)(FAST) for every in (1, 40)]

    assert all(result == RESULTS.successful for result in results(1e-3, TOP))
    solves = ml.method(name).solves > 0
    for result in results(too_far, TOP):
        assert (result == RESULTS.beyond_reach) | (solves & (result == RESULTS.not_solved))
    for result in results(1e-3, nan_later):  # which a solve for the torque meets itself
        assert (result == RESULTS.not_finite) | (solves & (result == RESULTS.not_solved))


def test_each_body_of_a_batch_has_its_own():
    states = jax.tree.map(lambda x: jnp.stack([x, x, x]), FAST)
    states = ml.RigidState(states.momentum * jnp.array([[1.0], [100.0], [1.0]]), states.attitude)
    many = ml.ensemble("JACOBI[EA]", moments("JACOBI[EA]"), TOP, states, dt=1e-3, steps=4, chunk=2)
    assert (many.result == RESULTS.successful).tolist() == many.ok.tolist() == [True, False, True]
    assert (many.result == RESULTS.beyond_reach).tolist() == [False, True, False]


@pytest.mark.sample(0)
def test_other_drivers_have_reasons_of_their_own():
    body = moments("SYMMETRIC[EA]")
    count = jax.jit(lambda first: ml.integrate("SYMMETRIC[EA]", body, None, FAST, dt=1e-3, steps=4, first_step=first))
    assert count(2**31 - 2).result == RESULTS.too_many_steps
    far = ml.free_motion(body, FAST, [0.0, 1e20])
    assert far.result == RESULTS.phase_lost
    assert "nearer to the start" in str(far.result)
    run = partial(ml.integrate_adaptive, "SYMMETRIC[EA]", body, None, FAST, dt=1e-3)
    assert run(density=lambda t, s: jnp.ones_like(t), steps=4, t1=1.0).result == RESULTS.end_not_reached
    jump = run(density=lambda t, s: jnp.where(t < 2.5e-3, 1.0, 9.0).astype(t.dtype), steps=8)
    assert jump.result == RESULTS.density_lost
    assert jump.first_bad < 9


AXIS = ml.AxisState([0.1, 0.2, 0.3], [0.0, 0.0, 1.0])
FREE = ml.FreeState([0.1, 0.2, 0.3], [1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
PAIR = jax.tree.map(lambda x: jnp.stack([x, x]), FREE)
MASS = ml.ParticleState([0.1, 0.2], [0.0, 0.0])
# How a body is made of traced numbers, a start, numbers of possible bodies, and of impossible ones.
MADE = {
    "rigid": (ml.RigidBody, FAST, [[1, 1, 2.0], [1, 2.0000001, 1], [2.5, 2, 3]], [[1, 1, 5], [-1, 1, 1], [1, 1, 0]]),
    "any moments": (lambda m: ml.RigidBody(m, physical=False), FAST, [[1.0, 1, 5]], [[-1, 1, 1.0], [1, 1, jnp.nan]]),
    "tensor": (lambda m: ml.TensorBody(jnp.diag(m)), FAST, [[1, 2.0, 3]], [[1, 1.0, 5], [1, -1, 1]]),
    "rotor": (ml.Rotor, AXIS, [1.0], [-1.0, 0.0, jnp.inf]),
    "rotor with both": (lambda m: ml.Rotor(m[0], m[1]), AXIS, [[1, 0.0], [1, 2.0000001]], [[1, 2.1], [1, -0.1]]),
    "free": (lambda m: ml.FreeBody(ml.RigidBody([1.0, 2, 2.5]), m), FREE, [1.0], [-1.0, 0.0]),
    "free rotor": (lambda m: ml.FreeBody(ml.RigidBody(m), 1.0), FREE, [[1, 2, 2.5]], [[1, 1, 5.0]]),
    "coupled": (
        lambda m: ml.FreeBody(ml.RigidBody(jnp.array([[1, 1, 1], [1, 2, 2]], m.dtype) * m[:, None]), m),
        ml.CoupledState.of_bodies(PAIR),
        [[1.0, 2]],
        [[1.0, -2], [0, 1]],
    ),
    "particles": (ml.Particles, MASS, [[1.0, 2]], [[1.0, -2]]),
    "mass matrix": (ml.Particles, MASS, [[[1, 0.5], [0.5, 1.0]]], [[[1, 2], [2, 1.0]]]),
}


def mover(start):
    name = type(start).__name__
    return "Verlet" if name == "ParticleState" else "SYMMETRIC[EA]" if name == "AxisState" else "JACOBI[EA]"


@pytest.mark.sample(3)
@pytest.mark.parametrize(("kind", "dtype"), [(kind, DTYPES[i % 2]) for i, kind in enumerate(MADE)])
def test_a_body_that_cannot_be_is_found_under_a_trace(kind, dtype):
    make, start, good, bad = MADE[kind]
    start = jax.tree.map(lambda x: x.astype(dtype), start)
    numbers = jnp.asarray([*good, *bad], dtype)
    dt = jnp.asarray(1e-3, dtype)

    def run(numbers):
        body = jax.tree.map(lambda x: x.astype(dtype), make(numbers))
        return ml.integrate(mover(start), body, None, start, dt=dt, steps=2)._replace(states=None)

    path = quick(jax.vmap(run))(numbers)
    wanted = [True] * len(good) + [False] * len(bad)
    assert path.ok.tolist() == (path.result == RESULTS.successful).tolist() == wanted
    assert (path.result != RESULTS.impossible_body).tolist() == wanted


DRIVERS = {
    "ensemble": lambda body, start: ml.ensemble(
        "JACOBI[EA]", body, None, jax.tree.map(lambda x: x[None], start), dt=1e-3, steps=2
    ),
    "adaptive": lambda body, start: ml.integrate_adaptive(
        "JACOBI[EA]", body, None, start, dt=1e-3, steps=2, density=lambda t, s: jnp.ones_like(t)
    ),
    "free motion": lambda body, start: ml.free_motion(body, start, [0.0, 1.0]),
}


@pytest.mark.sample(1)
@pytest.mark.parametrize("driver", DRIVERS)
def test_every_driver_finds_a_body_that_cannot_be(driver):
    def run(numbers):
        path = DRIVERS[driver](ml.RigidBody(numbers), FAST)
        return jax.tree.map(jnp.ravel, (path.ok, path.result == RESULTS.impossible_body))

    run = quick(run)
    assert run(jnp.array([5.0, 4.0, 1.5])) == (True, False)
    assert run(jnp.array([5.0, 1.0, 1.5])) == (False, True)


@pytest.mark.sample(0)
def test_diffrax_ends_at_a_body_that_cannot_be():
    @quick
    @jax.vmap
    def run(numbers):
        term, controller = ml.RigidBodyTerm(ml.RigidBody(numbers)), diffrax.PIDController(1e-3, 1e-3)
        options = {"stepsize_controller": controller, "throw": False, "max_steps": 64}
        return diffrax.diffeqsolve(term, ml.LieSolver(), 0.0, 0.1, 0.01, FAST, **options).result

    found = run(jnp.array([[5.0, 4.0, 1.5], [5.0, 1.0, 1.5]]))
    assert (found == diffrax.RESULTS.successful).tolist() == [True, False]
    assert (found == diffrax.RESULTS.nonlinear_divergence).tolist() == [False, True]
