"""Torque fields and orbits: each field against its potential, sums, damping, Kepler's ellipse against SciPy."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, METHODS, each, epsilon, equal_moments, turn
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax.integrators.splitting import Splitting
from midlie_jax.integrators.system import System
from midlie_jax.model import orbits, so3, torques

MOMENTUM, ATTITUDE = jnp.array([1.0, 0.8, -1.3]), jnp.asarray(turn(0.5, -0.3, 0.8))
STATE = ml.RigidState(MOMENTUM, ATTITUDE)
BODY = ml.RigidBody(jnp.array([1.0, 2.0, 2.5]))
PLACE, ALONG, MU = jnp.array([1.2, -0.3, 0.7]), jnp.array([0.1, 0.9, 0.4]), 1.7

FIELDS = {
    "top": torques.HeavyTop(2.0),
    "generic top": torques.HeavyTop(-1.5, (0.48, -0.6, 0.64)),
    "dipole": torques.DipoleInField(jnp.array([0.3, -0.5, 0.4]), jnp.array([0.0, 0.0, 1.6])),
    "gradient": ml.spacecraft.GravityGradient(BODY.moments, orbits.CircularOrbit(PLACE, ALONG, MU), MU),
    "gradient on an ellipse": ml.spacecraft.GravityGradient(BODY.moments, orbits.KeplerOrbit(PLACE, ALONG, MU), MU),
}
FIELDS["sum"] = FIELDS["generic top"] + FIELDS["dipole"]
FIELDS["sum of three"] = FIELDS["sum"] + FIELDS["gradient"]


@pytest.mark.parametrize("name", ["top", "sum"])
def test_a_direction_is_enough(name):
    """The fields along the vertical give a `DirectionState` what they give the full state; autodiff too."""
    field, direction = FIELDS[name], ml.DirectionState(MOMENTUM, so3.to_matrix(ATTITUDE)[2])
    slack = 8 * epsilon("float64")
    np.testing.assert_allclose(field(0.0, direction), field(0.0, STATE), atol=slack)
    np.testing.assert_allclose(torques.FromPotential(field.potential)(0.0, direction), field(0.0, STATE), atol=slack)
    np.testing.assert_allclose(field.potential(0.0, direction), field.potential(0.0, STATE), atol=slack)


def test_fields_by_their_formulas():
    r = Rotation.from_quat(np.asarray(ATTITUDE), scalar_first=True).as_matrix()
    slack = 16 * epsilon("float64")
    np.testing.assert_allclose(FIELDS["top"](0.0, STATE), 2.0 * np.cross(r[2], [0, 0, 1]), atol=slack)
    dipole = np.cross([0.3, -0.5, 0.4], r.T @ [0, 0, 1.6])
    np.testing.assert_allclose(FIELDS["dipole"](0.0, STATE), dipole, atol=slack)
    place = np.asarray(PLACE)
    u, distance = r.T @ place / np.linalg.norm(place), np.linalg.norm(place)
    gradient = 3 * MU / distance**3 * np.cross(u, np.asarray(BODY.moments) * u)
    np.testing.assert_allclose(FIELDS["gradient"](0.0, STATE), gradient, atol=slack)
    np.testing.assert_allclose(FIELDS["sum"](0.0, STATE), FIELDS["generic top"](0.0, STATE) + dipole, atol=slack)
    prescribed = torques.Prescribed(lambda t: jnp.array([1.0, 2.0, 3.0]) * t)
    np.testing.assert_array_equal(prescribed(0.5, STATE), [0.5, 1.0, 1.5])
    both = FIELDS["top"] + (lambda t, state: jnp.ones(3))
    np.testing.assert_allclose(both(0.0, STATE), FIELDS["top"](0.0, STATE) + 1, atol=slack)
    assert not both.velocity_dependent
    assert (both + torques.VelocityDependent(lambda t, state: -state.momentum)).velocity_dependent


# ---- damping ----


def pendulum(t, state):
    """Reads the attitude alone, though it is handed the whole state."""
    dipole = jax.jit(lambda t, state: FIELDS["dipole"](t, state))
    return jax.lax.cond(t > 1, lambda t, state: FIELDS["top"](t, state), dipole, t, state)


READERS = [
    (FIELDS["sum"], False),
    (pendulum, False),
    (lambda t, state: jnp.ones_like(state.momentum), False),
    (lambda t, state: pendulum(t, state) - state.momentum, True),
    (FIELDS["top"] + (lambda t, state: jnp.cross(state.momentum, jnp.ones(3))), True),
    (torques.VelocityDependent(pendulum), True),
]


@pytest.mark.parametrize(("torque", "reads"), READERS)
def test_a_run_sees_whether_a_torque_reads_the_momentum(torque, reads):
    assert System.of(BODY, torque, STATE, jnp.array(0.5)).reads_momentum == reads


DRAG, LEVELS = 0.3, 4


@cache
def damped_truth():
    def rate(t, y):
        r = Rotation.from_quat(y[3:], scalar_first=True).as_matrix()
        velocity, w, u = y[:3] / np.asarray(BODY.moments), y[3], y[4:]
        torque = 2.0 * np.cross(r[2], (0.48, 0.6, 0.64)) - DRAG * y[:3] * (1 + np.sin(t))
        turning = np.concatenate([[-u @ velocity], w * velocity + np.cross(u, velocity)]) / 2
        return np.concatenate([np.cross(y[:3], velocity) + torque, turning])

    return solve_ivp(rate, (0, 1), np.concatenate([MOMENTUM, ATTITUDE]), "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


# A scheme with force gradients takes no such torque, and the order of Runge-Kutta methods is as high as ever.
DAMPED = [
    *(m.name for m in METHODS if isinstance(m, Splitting) and not m.scheme.gradients and not equal_moments(m)),
    *(m.name for m in METHODS if not isinstance(m, Splitting) and m.order <= 2),
]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", each(DAMPED, few=["JACOBI[EA]", "LIEMID[E1]", "SW"]))
def test_damped_top_keeps_the_order_up_to_two(name):
    drag = torques.VelocityDependent(lambda t, state: -DRAG * state.momentum * (1 + jnp.sin(t)))
    torque = torques.HeavyTop(2.0, (0.48, 0.6, 0.64)) + drag

    @jax.jit
    @jax.vmap
    def motion(dt):
        return ml.integrate(name, BODY, torque, STATE, dt=dt, steps=16 << LEVELS - 1)

    states, errors = motion(jnp.asarray(1 / (16 << np.arange(LEVELS)))).states, []
    for level in range(LEVELS):
        end = np.concatenate([states.momentum[level, 16 << level], states.attitude[level, 16 << level]])
        gaps = np.abs(end - damped_truth())
        errors.append([gaps[:3].max(), gaps[3:].max()])
    slopes = np.log2(np.divide(errors[-2], errors[-1]))
    assert np.all(np.abs(slopes - min(2, ml.method(name).order)) < 0.1), (slopes, errors)


# ---- orbits ----


@pytest.mark.parametrize("dtype", DTYPES)
def test_orbits_agree_and_keep_the_dtype(dtype):
    place, along = jnp.asarray(PLACE, dtype), jnp.asarray(ALONG, dtype)
    circle = orbits.CircularOrbit(place, along, jnp.asarray(MU, dtype))
    velocity = circle.across * circle.rate
    ellipse = orbits.KeplerOrbit(place, velocity, jnp.asarray(MU, dtype))
    for t in jnp.asarray([0.0, 0.7, -3.0], dtype):
        assert circle(t).dtype == ellipse(t).dtype == dtype
        np.testing.assert_allclose(circle(t), ellipse(t), atol=32 * epsilon(dtype))
