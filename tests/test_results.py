"""`path.result` says why a run failed, in every driver that returns a path."""

from functools import partial

import jax
import jax.numpy as jnp
import pytest
from cases import BUILDS, equal_moments, quick

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


def test_a_path_prints_in_two_lines():
    """Its times, whether it is ok, why not, and the shapes; inside a program and in a tree of axes, its parts."""
    body, run = moments("JACOBI[EA]"), {"dt": 1e-3, "steps": 40}
    path = ml.integrate("JACOBI[EA]", body, TOP, FAST, **run)
    shapes = "RigidState(momentum=f64[41,3], attitude=f64[41,4])"
    assert repr(path) == f"Path: 41 saved states at times 0 to 0.04; ok\n{shapes}"
    assert "successful" in str(path.result)
    failed = ml.integrate("JACOBI[EA]", body, TOP, FAST, dt=1.0, steps=40)
    assert repr(failed).startswith(
        "Path: 41 saved states at times 0 to 40; states[:1] ok. A step turned the body further"
    )
    states = jax.tree.map(lambda x: jnp.stack([x, x, x]), FAST)
    states = ml.RigidState(states.momentum * jnp.array([[1.0], [100.0], [1.0]]), states.attitude)
    many = ml.ensemble("JACOBI[EA]", body, TOP, states, dt=1e-3, steps=4)
    assert repr(many).startswith("Path: end at 0.004; 2 of 3 ok. A step turned the body further")
    assert repr(many).count("A step turned") == 1
    density = ml.densities.Spin(body.moments, reference=50.0, floor=1.0)
    adaptive = ml.integrate_adaptive("JACOBI[EA]", body, TOP, FAST, density=density, **run)
    assert repr(adaptive).startswith("AdaptivePath: 41 saved states at times 0 to 0.0")
    texts = []
    jax.make_jaxpr(lambda s: texts.append(repr(ml.integrate("JACOBI[EA]", body, TOP, s, **run))) or s.momentum)(FAST)
    assert "times=f64[41]" in texts[0]
    assert "ok=0" in repr(jax.tree.map(lambda x: 0, path))
