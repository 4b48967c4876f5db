"""`CompensatedState`: the motion of a `RigidState`, with the rounding of its changes and not of its sums."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import RIGID_FLIGHTS, each, epsilon, quick, real, setup, suited, swing, whole
from laboratory.runner import TURNS, free_bodies, spatial_momentum

import midlie_jax as ml

BODIES, STEPS = 16, 10_000
EXACT = [flight for flight in RIGID_FLIGHTS if flight.order is None]


def forced(name, kind, state, first, dtype):
    """32 steps under gravity and a torque that turns with time, with every eighth state."""
    s = jax.tree.map(lambda x: jnp.asarray(x.astype(np.float32), dtype), setup())
    torque = ml.torques.HeavyTop(s.weight) + jax.tree_util.Partial(swing, s.strength)
    start = kind(s.momentum, s.attitude) if state is None else state
    body = ml.RigidBody(suited(name, s.moments))
    return ml.integrate(name, body, torque, start, dt=s.dt, t0=s.t0, steps=32, save_every=8, first_step=first)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=["JACOBI[CHIN4A]", "LIEMID[I]", "NMB"]))
def test_it_moves_like_a_rigid_state_and_a_split_run_equals_the_whole(name):
    """In float32 like one in float64, to a few units in the last place; and split to the bit, low parts included."""
    run = quick(partial(forced, name, ml.CompensatedState, dtype=np.float32))
    path, truth = run(None, np.int32(0)), quick(partial(forced, name, ml.RigidState, dtype=float))(None, np.int32(0))
    assert path.ok
    for x, y in ((path.states.momentum, truth.states.momentum), (path.states.attitude, truth.states.attitude)):
        error = np.abs(np.asarray(x, float) - y) / np.linalg.norm(y, axis=-1, keepdims=True)
        assert error.max() <= 4 * epsilon("float32")
    assert np.all(np.any(path.states.low_momentum[1:], axis=1) | np.any(path.states.low_attitude[1:], axis=1))
    rest = run(jax.tree.map(lambda x: x[2], path.states), np.int32(16))
    for x, y in zip(jax.tree.leaves(rest.states), jax.tree.leaves(path.states), strict=True):
        np.testing.assert_array_equal(x[:3], y[2:])


def momentum_errors(flight, kind):
    """Of the spatial momentum of free bodies in float32, relative: the root mean square for each of `TURNS`."""
    moments, momentum, attitude, dt = free_bodies(flight.equal_moments, "float32", count=BODIES, seed=6)

    def run(moments, momentum, attitude, dt):
        method, body = ml.method(flight, "E1"), ml.RigidBody(moments)
        return ml.integrate(method, body, None, kind(momentum, attitude), dt=dt, steps=STEPS, save_every=STEPS)

    path = real(jax.vmap(run))(moments, momentum, attitude, dt)
    assert path.ok.all()
    momentum, attitude = np.asarray(path.states.momentum, float), np.asarray(path.states.attitude, float)
    if kind is ml.CompensatedState:
        momentum = momentum + np.asarray(path.states.low_momentum)
        attitude = attitude + np.asarray(path.states.low_attitude)
    space = spatial_momentum(attitude, momentum)
    error = np.linalg.norm(space[:, 1] - space[:, 0], axis=-1) / np.linalg.norm(space[:, 0], axis=-1)
    return np.sqrt(np.mean(error.reshape(len(TURNS), BODIES) ** 2, axis=1))


@pytest.mark.sample(0)
@pytest.mark.parametrize("flight", [EXACT[0], *whole(*EXACT[1:])], ids=lambda flight: flight.name)
def test_its_rounding_is_that_of_the_changes(flight):
    """In proportion to the turn of a step, where that of a `RigidState` does not depend on the turn."""
    unit = epsilon("float32") * STEPS**0.5
    assert np.all(momentum_errors(flight, ml.CompensatedState) <= 4 * unit * TURNS)
    assert np.all(momentum_errors(flight, ml.RigidState) >= 0.2 * unit)


def start_of(kind):
    return kind(jnp.array([1.0, 0.8, -1.3]), ml.so3.exp(jnp.array([0.5, -0.3, 0.8])))


def test_invalid_low_parts_are_refused():
    start = start_of(ml.RigidState)
    with pytest.raises(ValueError, match=r"low_momentum must have shape \(3,\)"):
        ml.CompensatedState(start.momentum, start.attitude, jnp.zeros(4))
    with pytest.raises(ValueError, match=r"low_attitude.*NaN"):
        ml.CompensatedState(start.momentum, start.attitude, low_attitude=jnp.full(4, jnp.nan))
    with pytest.raises(ValueError, match="must have the same leading axes"):
        ml.CompensatedState(start.momentum, start.attitude, jnp.zeros((2, 3)))


def test_diffrax_refuses_it():
    term = ml.diffrax.RigidBodyTerm(ml.RigidBody([1.0, 2.0, 2.5]), None)
    with pytest.raises(ValueError, match="use a RigidState"):
        diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, 1.0, 0.1, start_of(ml.CompensatedState))
