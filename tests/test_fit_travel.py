"""Fits of bodies that travel: markers on a thrown body, and an accelerometer in it."""

from itertools import cycle

import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, torque_classes, turn
from scipy.spatial.transform import Rotation

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


GUESS = {
    "moments": fitting.Moments([1.1, 1.9, 2.5], scale="fixed"),
    "drag": fitting.Positive(0.05),
    "speed": fitting.Free([5.8, 0.1, 4.2]),
}


@pytest.mark.sample(0)
def test_drag_speed_and_moments_are_found():
    body, torque, start = thrown({name: jnp.asarray(value) for name, value in TRUTH.items()})
    path = quick(lambda: ml.integrate("JACOBI[EA]", body, torque, start, dt=1 / 400, steps=400, save_every=20))()
    frames = ml.so3.to_matrix(path.states.attitude)
    seen = jnp.einsum("nij,mj->nmi", frames, jnp.asarray(MARKERS)) + path.states.position[:, None]
    found = ml.fit(thrown, GUESS, fitting.Positions(TIMES, seen, 1e-3, markers=MARKERS), method="RK4", dt=1 / 50)
    assert found.ok
    for name, value in TRUTH.items():
        # Of the step of the fit, which is four times that of the truth.
        np.testing.assert_allclose(np.asarray(found.values[name]), value, atol=4e-3, rtol=4e-3)


def test_what_cannot_be_meant_is_refused():
    values = np.zeros((len(TIMES), 3))
    of_body = fitting.Positions(TIMES, values, 0.1, markers=[0.0, 0, 0], origin=[0.0, 0, 1])
    twice, staying = (fitting.Accelerations(TIMES, values, 0.1, lever=LEVER, gravity=g) for g in (GRAVITY, None))

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
        (stays, staying, "must have gravity="),
        (pulled, staying, "must have gravity="),
    ):
        with pytest.raises(ValueError, match=message):
            ml.fit(model, GUESS, [seen], method="JACOBI[EA]", dt=1 / 100)


class Harmonic(ml.torques.Torque):
    """Gravity inside a homogeneous ball, as a field of the user's own that does not read the body."""

    @property
    def gravitational(self):
        return True

    def __call__(self, t, state):
        return ml.torques.Wrench(jnp.zeros(3), -0.02 * MASS * state.position)


MASS, MU, RADIUS, J2, POLE, FAR = 3.0, 40.0, 2.0, 0.1, np.array([0.6, 0.0, 0.8]), np.array([8.0, -6.0, 5.0])
POINT, OBLATE = ml.torques.PointMass(MU), ml.torques.Oblateness(MU, RADIUS, J2, POLE)
FIELDS = {
    "own": (Harmonic(), lambda x: 0.01 * x @ x),
    "sum": (POINT + (OBLATE + ml.torques.Drag([0.0, 0, 0], 0.3, 1.2)), lambda x: oblate(x) - MU / np.linalg.norm(x)),
    "point mass without gradient": (ml.torques.PointMass(MU, gradient=False), lambda x: -MU / np.linalg.norm(x)),
    "oblate without gradient": (
        ml.torques.Oblateness(MU, RADIUS, J2, POLE, gradient=False) + ml.torques.UniformGravity(GRAVITY),
        lambda x: oblate(x) - np.dot(GRAVITY, x),
    ),
    "solar tide": (
        ml.asteroids.SolarTide(lambda t: jnp.asarray(FAR), MU),
        lambda x: MU / 2 / np.linalg.norm(FAR) ** 3 * (x @ x - 3 * (FAR @ x) ** 2 / (FAR @ FAR)),
    ),
}
BODIES = {
    "moments": ml.RigidBody([1.0, 2.0, 2.5]),
    "tensor": ml.TensorBody([[1.0, 0.1, 0.2], [0.1, 2.0, -0.1], [0.2, -0.1, 2.5]]),
}


def oblate(x):
    r = np.linalg.norm(x)
    return MU * J2 * RADIUS**2 / (2 * r**3) * (3 * (POLE @ x / r) ** 2 - 1)


def slope(potential, x, h=2e-2):
    """The field: minus the potential's derivative, by differences of sixth order."""
    weights = ((1, 45), (2, -9), (3, 1))
    sums = [sum(w * (potential(x - k * e) - potential(x + k * e)) for k, w in weights) for e in h * np.eye(3)]
    return np.array(sums) / 60 / h


@pytest.mark.sample(2)
@pytest.mark.parametrize(("name", "kind"), list(zip(FIELDS, cycle(BODIES), strict=False)))
def test_an_accelerometer_feels_how_gravity_changes_along_its_lever(name, kind):
    """R^T (a - g) + ..., where the field g at the instrument is that by differences of its potential there."""
    torque, potential = FIELDS[name]
    body, lever = ml.FreeBody(BODIES[kind], MASS), np.array([0.1, -0.05, 0.08])
    state = ml.FreeState([0.3, -0.5, 0.4], turn(0.5, -0.3, 0.8), [1.0, 2.0, -1.0], [4.0, -3.0, 5.0])
    seen = fitting.Accelerations([0.0], np.zeros((1, 3)), 1.0, lever=lever).of_run(torque)
    found = quick(lambda s: seen.expected(jnp.zeros(()), s, body, {}))(state)

    acting = ml.torques.Wrench.of(ml.torques.on_body(torque, body)(jnp.zeros(()), state))
    rates = np.asarray(body.velocity(state.momentum))
    change = np.asarray(body.velocity(jnp.cross(state.momentum, rates) + acting.torque))
    frame = Rotation.from_quat(np.asarray(state.attitude), scalar_first=True)
    gravity = slope(potential, np.asarray(state.position) + frame.apply(lever))
    wanted = frame.inv().apply(np.asarray(acting.force) / MASS - gravity)
    wanted = wanted + np.cross(change, lever) + np.cross(rates, np.cross(rates, lever))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-9)


def test_every_field_of_gravity_is_among_those_of_the_test():
    """All that declare themselves as gravity; coupled bodies have no accelerometers."""
    declared = {
        name for name, cls in torque_classes().items() if cls.gravitational is not ml.torques.Torque.gravitational
    }
    tested = {type(term).__name__ for torque, _ in FIELDS.values() for term in ml.torques.terms_of(torque)}
    assert declared - tested == {"Sum", "OnEach", "MutualGravity"}
