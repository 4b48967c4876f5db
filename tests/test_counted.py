"""A call costs a call: one program serves every number of steps, and a second call traces nothing."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import CLASSES, OTHER, REAL, cast, integrate, rows, setup

import midlie_jax as ml
from midlie_jax._xla import compiler
from midlie_jax.drivers.adjoints import Checkpointed, Reversible
from midlie_jax.drivers.integrate import count_as_argument

START = setup(moments=[2.0, 2.4, 2.5], first_step=3)  # physical also with two of them equal
MANY = rows(START, setup(**OTHER), setup(moments=[2.0, 3.0, 1.5], dt=1 / 40))
BODY = ml.RigidBody([1.0, 2.0, 2.5])
STATE = ml.RigidState(jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))
STATES = jax.tree.map(lambda x: jnp.stack([x, x]), STATE)


CHOSEN = [(name, ("float32", "float64")[n % 2], (80, 81)[n // 2 % 2]) for n, name in enumerate(CLASSES)]


@pytest.fixture
def as_for_users(monkeypatch):
    """Programs of their own, compiled as users get them; `conftest.py` has others compiled in a hurry."""
    monkeypatch.setattr(compiler, "compiler_options", lambda bodies: REAL)


@pytest.mark.parametrize(
    ("every", "steps", "adjoint", "free"),
    [
        (1, 1, Checkpointed(), True),  # the state at the end alone
        (5000, 5000, Checkpointed(), True),
        (32, 64, Checkpointed(), True),
        (31, 62, Checkpointed(), False),  # few steps between saved states
        (64, 64, Reversible(), False),  # which is checked with all numbers
        (64, 64, Checkpointed(every=8), False),
    ],
)
def test_which_numbers_of_steps_are_an_argument(every, steps, adjoint, free):
    assert isinstance(count_as_argument(every, steps, adjoint), np.ndarray) == free
    inside = []
    jax.jit(lambda: inside.append(count_as_argument(every, steps, adjoint)))()
    assert inside == [every]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype", "steps"), CHOSEN)
def test_the_bits_are_those_of_a_fixed_number(name, dtype, steps, as_for_users):
    """For one and for several bodies, an even and an odd number of steps, and states saved on the way.

    The step of GBS12 is so long that what of it is rounded once, as one multiplication and addition, depends on what is
    around it and on the processor: only the last digits agree.
    """
    for start, mapped in ((START, lambda f: f), (MANY, jax.vmap)):
        given = jax.tree.map(jnp.asarray, cast(start, dtype))
        fixed = mapped(partial(integrate, name, steps=steps, save_every=steps // 4 if steps == 80 else 27))(given)
        alone = mapped(partial(integrate, name, steps=steps, save_every=None))(given)
        axis = given.dt.ndim
        last = jax.tree.map(lambda x, axis=axis: jnp.take(x, -1, axis), fixed.states)
        loose = 32 * np.finfo(dtype).eps if name == "GBS12" else 0.0
        same = partial(np.testing.assert_allclose, rtol=0, atol=loose)
        jax.tree.map(same, alone.states, last)
        if steps == 80:
            half = mapped(partial(integrate, name, steps=steps, save_every=40))(given)
            second = jax.tree.map(lambda x, axis=axis: jnp.take(x, jnp.array([0, 2, 4]), axis), fixed.states)
            jax.tree.map(same, half.states, second)
        assert np.all(alone.ok)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "shared"), [("JACOBI[EA]", True), ("GBS12", True), ("JACOBI[EA]", False)])
def test_an_orbit_gives_the_same_bits(name, shared, as_for_users):
    """An orbit that all bodies share has prepared inputs; an orbit for each body has none."""
    phase = 0.3 if shared else jnp.array([0.3, 0.7])
    places = jnp.stack([jnp.cos(jnp.asarray(phase)), jnp.sin(jnp.asarray(phase)), 0 * jnp.asarray(phase)], -1)
    speeds = jnp.stack([-places[..., 1], places[..., 0], places[..., 2]], -1)
    torque = ml.spacecraft.GravityGradient(None, ml.orbits.KeplerOrbit(places, speeds, 1.0), 1.0)
    body = ml.RigidBody([5.0, 5.0, 1.0] if name.startswith("SYMMETRIC") else [1.0, 2.0, 2.5])
    run = partial(ml.ensemble, name, body, torque, STATES, dt=0.02)
    for steps, fixed, every in ((81, 27, None), (80, 20, 40)):
        few, many = run(steps=steps, save_every=fixed).states, run(steps=steps, save_every=every).states
        chosen = slice(None, None, 2) if every else -1
        jax.tree.map(lambda x, y, chosen=chosen: np.testing.assert_array_equal(x, y[:, chosen]), many, few)


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
    "vmap": lambda f, x, dt, t0, n: jax.vmap(
        lambda x: ml.integrate("JACOBI[EA]", BODY, f, x, dt=dt, t0=t0, steps=n, save_every=None)
    )(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), x)),
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
