"""A call costs a call: one program serves every number of steps, and a second call traces nothing."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import pytest

import midlie_jax as ml

BODY = ml.RigidBody([1.0, 2.0, 2.5])
STATE = ml.RigidState(jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))


def calls_of(torque):
    """The torque as a function that counts how often it is called, and the count."""
    count = []

    def counting(t, state):
        count.append(None)
        return torque(t, state)

    return counting, count


def solved(torque, state, dt, t0, steps):
    term = ml.diffrax.RigidBodyTerm(BODY, torque)
    t0, dt = jnp.asarray(t0), jnp.asarray(dt)  # diffrax makes a program for each number of Python's
    return diffrax.diffeqsolve(term, ml.diffrax.LieSolver("JACOBI[EA]"), t0, t0 + steps * dt, dt, state, max_steps=None)


DRIVERS = {
    "integrate": lambda f, x, dt, t0, n: ml.integrate("JACOBI[EA]", BODY, f, x, dt=dt, t0=t0, steps=n, save_every=None),
    "ensemble": lambda f, x, dt, t0, n: ml.ensemble(
        "JACOBI[EA]", BODY, f, jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), x), dt=dt, t0=t0, steps=n
    ),
    "saving": lambda f, x, dt, t0, n: ml.integrate(
        "JACOBI[EA]", BODY, f, x, dt=dt, t0=t0, steps=2 * (32 + n), save_every=32 + n
    ),
    "LieSolver": solved,
}
FIXED = {
    "integrate_variable_step": lambda f, x, dt, t0: ml.integrate_variable_step(
        "JACOBI[EA]", BODY, f, x, density=ml.densities.Spin(BODY.moments, 1.0, 0.1), dt=dt, t0=t0, steps=4
    ),
    "saved often": lambda f, x, dt, t0: ml.integrate("JACOBI[EA]", BODY, f, x, dt=dt, t0=t0, steps=4),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("driver", DRIVERS)
def test_another_call_traces_nothing(driver):
    """With another start, step, first time and number of steps."""
    torque, count = calls_of(ml.torques.HeavyTop(2.0))
    DRIVERS[driver](torque, STATE, 0.01, 0.0, 7)
    before = len(count)
    assert before > 0
    other = ml.RigidState(2 * STATE.momentum, STATE.attitude)
    for dt, t0, steps in ((0.01, 0.0, 7), (0.02, 0.5, 7), (0.02, 0.5, 10), (-0.01, 1.0, 101)):
        DRIVERS[driver](torque, other, dt, t0, steps)
    assert len(count) == before


@pytest.mark.sample(1)
@pytest.mark.parametrize("driver", FIXED)
def test_a_second_call_with_as_many_steps_traces_nothing(driver):
    torque, count = calls_of(ml.torques.HeavyTop(2.0))
    FIXED[driver](torque, STATE, 0.01, 0.0)
    before = len(count)
    FIXED[driver](torque, ml.RigidState(2 * STATE.momentum, STATE.attitude), 0.02, 0.5)
    assert len(count) == before > 0


def test_numbers_are_looked_at_in_every_call():
    """Only what depends on structure is remembered."""
    run = partial(ml.integrate, "SYMMETRIC[EA]", torque=None, dt=0.01, steps=3)
    assert run(body=ml.RigidBody([5.0, 5.0, 1.0]), start=STATE).ok
    assert run(body=ml.RigidBody([5.0, 1.0, 5.0]), start=STATE).ok  # the flight is fitted anew
    with pytest.raises(ValueError, match="two equal moments"):
        run(body=ml.RigidBody([3.0, 2.0, 4.0]), start=STATE)
    nowhere = jax.tree.unflatten(jax.tree.structure(STATE), [jnp.nan * STATE.momentum, STATE.attitude])
    with pytest.raises(ValueError, match="start must be finite"):
        run(body=ml.RigidBody([5.0, 5.0, 1.0]), start=nowhere)
    with pytest.raises(ValueError, match="dt must be finite and not zero"):
        run(body=ml.RigidBody([5.0, 5.0, 1.0]), start=STATE, dt=0.0)
    with pytest.raises(ValueError, match="dt must be finite"):
        run(body=ml.RigidBody([5.0, 5.0, 1.0]), start=STATE, dt=1e400)
