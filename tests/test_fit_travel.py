"""Fits of bodies that travel: markers on a thrown body, and an accelerometer in it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, turn

import midlie_jax as ml
from midlie_jax import fitting

GRAVITY = [0.0, 0.0, -9.81]
TRUTH = {"drag": 0.08, "moments": np.array([1.0, 2.0, 2.5]), "speed": np.array([6.0, 0.0, 4.0])}
MARKERS = np.array([[0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.4]])
LEVER = np.array([0.2, -0.1, 0.3])
TIMES = np.arange(0.0, 1.01, 0.05)


def thrown(values):
    body = ml.FreeBody(ml.RigidBody(values["moments"]), 3.0)
    torque = ml.torques.UniformGravity(GRAVITY) + ml.torques.Drag([0.0, 0, 0], values["drag"], 1.2)
    momentum = body.momentum(jnp.array([1.0, 2.0, 0.5]))
    start = ml.FreeState(momentum, turn(0.5, -0.3, 0.8), 3.0 * values["speed"], jnp.zeros(3))
    return body, torque, start


def flown():
    body, torque, start = thrown({name: jnp.asarray(value) for name, value in TRUTH.items()})
    run = quick(lambda: ml.integrate("JACOBI[EA]", body, torque, start, dt=1 / 400, steps=400, save_every=20))
    return body, torque, run()


def seen_markers(path):
    frames = ml.so3.to_matrix(path.states.attitude)
    return np.asarray(jnp.einsum("nij,mj->nmi", frames, jnp.asarray(MARKERS)) + path.states.position[:, None])


def felt(body, path, h=1e-3):
    """The specific force at the lever, by differences of where the lever is in space."""
    _, torque, _ = flown()

    def place(state, dt):
        end = ml.integrate("JACOBI[SRKN6b]", body, torque, state, dt=dt, steps=1, save_every=1).states
        last = jax.tree.map(lambda x: x[-1], end)
        return last.position + ml.so3.rotate(last.attitude, jnp.asarray(LEVER))

    def one(state):
        ends = [place(state, k * h) for k in (-2, -1, 1, 2)]
        here = state.position + ml.so3.rotate(state.attitude, jnp.asarray(LEVER))
        second = (-ends[0] + 16 * ends[1] - 30 * here + 16 * ends[2] - ends[3]) / (12 * h * h)
        return ml.so3.rotate(ml.so3.conjugate(state.attitude), second - jnp.asarray(GRAVITY))

    return np.asarray(quick(jax.vmap(one))(path.states))


GUESS = {
    "moments": fitting.Moments([1.1, 1.9, 2.5], scale="fixed"),
    "drag": fitting.Positive(0.05),
    "speed": fitting.Free([5.8, 0.1, 4.2]),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("instrument", ["markers", "accelerometer"])
def test_drag_speed_and_moments_are_found(instrument):
    body, _, path = flown()
    if instrument == "markers":
        seen = [fitting.Positions(TIMES, seen_markers(path), 1e-3, markers=MARKERS)]
    else:
        seen = [fitting.Accelerations(TIMES, felt(body, path), 1e-2, lever=LEVER)]
    found = ml.fit(thrown, GUESS, seen, method="RK4", dt=1 / 50)
    assert found.ok
    for name, value in TRUTH.items():
        # Of the step of the fit, which is four times that of the truth.
        np.testing.assert_allclose(np.asarray(found.values[name]), value, atol=4e-3, rtol=4e-3)


def test_what_cannot_be_meant_is_refused():
    values = np.zeros((len(TIMES), 3))
    of_body = fitting.Positions(TIMES, values, 0.1, markers=[0.0, 0, 0], origin=[0.0, 0, 1])
    twice = fitting.Accelerations(TIMES, values, 0.1, lever=LEVER, gravity=GRAVITY)
    staying = fitting.Accelerations(TIMES, values, 0.1, lever=LEVER)

    def stays(values):
        body, _, start = thrown(values)
        return body.body, None, start.turning

    def pulled(values):
        """By a force that may be gravity, or not."""
        body, torque, start = thrown(values)
        return body, lambda t, state: torque.on(body)(t, state), start

    for model, seen, message in (
        (thrown, of_body, "leave origin out"),
        (thrown, twice, "leave gravity out"),
        (stays, staying, "need gravity="),
        (pulled, staying, "need gravity="),
    ):
        with pytest.raises(ValueError, match=message):
            ml.fit(model, GUESS, [seen], method="JACOBI[EA]", dt=1 / 100)
