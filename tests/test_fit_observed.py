"""`Observed`: instruments written with it, the distance of two bodies, and what is refused."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS
from test_fitting import METHOD, TIMES, TRUTH, top, true_states

import midlie_jax as ml
from midlie_jax import fitting

LEVER, GRAVITY = np.array([0.2, -0.1, 0.3]), np.array([0.0, 0.0, -9.81])
HEAVY = ml.torques.HeavyTop(TRUTH["weight"], AXIS)


def gyroscope(t, state, body, values):
    return body.velocity(state.momentum) + values["bias"]


def accelerometer(t, state, body, values):
    """Off the centre: by Euler's equations with the torque that the model has, too."""
    rates = body.velocity(state.momentum)
    change = body.velocity(jnp.cross(state.momentum, rates) + HEAVY(t, state))
    turning = jnp.cross(change, jnp.asarray(LEVER)) + jnp.cross(rates, jnp.cross(rates, jnp.asarray(LEVER)))
    return turning - ml.so3.rotate(ml.so3.conjugate(state.attitude), jnp.asarray(GRAVITY)) + values["bias"]


BUILT_IN = {
    gyroscope: partial(fitting.Rates, bias="bias"),
    accelerometer: partial(fitting.Accelerations, lever=LEVER, gravity=GRAVITY, bias="bias"),
}


@pytest.mark.parametrize("function", BUILT_IN)
def test_an_instrument_written_with_it_has_the_same_residuals(function):
    """With noise of one sigma; missing values count zero in both."""
    seen, body, sigma = true_states().states, top(TRUTH)[0], 1e-3
    values = np.asarray(jax.vmap(lambda t, s: function(t, s, body, TRUTH))(jnp.asarray(TIMES), seen))
    values = values + sigma * np.random.default_rng(0).standard_normal(values.shape)
    values[3, ..., 1] = np.nan
    known, general = BUILT_IN[function](TIMES, values, sigma), fitting.Observed(TIMES, values, sigma, function)
    found = [m.of_run(HEAVY).residuals(TRUTH, body, seen) for m in (known, general)]
    assert 0.3 < np.std(found[0]) < 3
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=2e-12)


@pytest.mark.sample(0)
def test_it_sees_all_bodies_of_a_coupled_state_and_one_of_them_in_of_body():
    """The distance of two masses on a spring tells its strength; and the position of one of them does."""
    masses = jnp.array([2.0, 3.0])
    body = ml.FreeBody(ml.RigidBody(jnp.ones((2, 3))), masses)

    def model(values):
        def spring(t, state):
            pull = values["spring"] * (state.position[1] - state.position[0])
            return ml.torques.Wrench(jnp.zeros_like(state.momentum), jnp.stack([pull, -pull]))

        zeros = jnp.zeros((2, 3))
        places = jnp.stack([zeros[0], jnp.array([1.0, 0.0, 0.0])])
        attitudes = jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1))
        return body, spring, ml.CoupledState(zeros, attitudes, zeros, places)

    def distance(t, state, body, values):
        return jnp.linalg.norm(state.position[1] - state.position[0])

    def place(t, state, body, values):
        return state.position[:1]

    times, strength = np.arange(0.1, 0.61, 0.05), 1.7
    frequency = np.sqrt(strength * (1 / 2 + 1 / 3))
    apart = np.cos(frequency * times)
    guess = {"spring": fitting.Positive(1.5)}
    for seen in (
        fitting.Observed(times, apart, 0.01, distance),
        fitting.OfBody(0, fitting.Observed(times, 3 / 5 * (1 - apart)[:, None], 0.01, place)),
    ):
        found = ml.fit(model, guess, seen, method="JACOBI[SRKN6b]", dt=0.05)
        assert found.ok
        np.testing.assert_allclose(found.values["spring"], strength, rtol=1e-6)


def still(values):
    return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["rate"])


def speed(t, state, body, values):
    return jnp.sqrt(state.momentum @ state.momentum)


SHOWN = np.full(5, 0.4)
WRONG = [
    ({"function": 3.0}, "function must be a function of"),
    ({"function": lambda t, state: 0.0}, r"must be a function of \(t, state, body, values\)"),
    ({"function": lambda t, s, b, v: s.momentum}, r"return shape \(\), .*, got \(3,\)"),
    ({"values": SHOWN[:, None]}, r"return shape \(1,\).*, got \(\)"),
    ({"function": lambda *x: speed(*x).astype("float32")}, "return float64, .*, got float32"),
    ({"function": lambda t, s, b, v: v["fast"]}, "of the guess, got 'fast', which is not"),
    ({"values": SHOWN[:4]}, "one row for each time"),
    ({"clock": "late"}, r"'late', which is not in the guess; add it: .*Free\(0.0\)"),
]


def test_what_is_wrong_is_said_before_anything_is_traced():
    good = {"times": np.arange(5.0), "values": SHOWN, "sigma": 0.1, "function": speed}

    def prepare(**changes):
        guess = {"rate": fitting.Free([0.1, 0.2, 0.3])}
        fitting.prepare(still, guess, fitting.Observed(**good | changes), dt=1.0, method=METHOD)

    for changes, message in WRONG:
        with pytest.raises(ValueError, match=message):
            prepare(**changes)


def test_a_function_that_holds_arrays_is_mapped_over_with_them():
    """Three factors, each with its own residuals (factor |Omega| - value) / sigma, of the dtype of the values."""
    dtype = "float32"

    def scaled(factor, t, state, body, values):
        return factor * speed(t, state, body, values) + 0 * t

    def residuals(factor):
        function = jax.tree_util.Partial(scaled, factor)
        seen = fitting.Observed(np.arange(5.0, dtype=dtype), values, 0.1, function)
        return seen.residuals({}, ml.RigidBody(jnp.ones(3, dtype)), states)

    values = np.array([0.4, np.nan, 0.6, 0.5, 0.5], dtype)
    states = ml.MomentumState(jnp.tile(jnp.array([0.3, 0.0, 0.4], dtype), (5, 1)))
    found = jax.vmap(residuals)(jnp.array([1.0, 2.0, 3.0], dtype))
    assert found.dtype == dtype
    wanted = 10 * (np.array([[0.5], [1.0], [1.5]]) - [0.4, 0, 0.6, 0.5, 0.5]) * [1, 0, 1, 1, 1]
    np.testing.assert_allclose(found, wanted, atol=1e-5)
