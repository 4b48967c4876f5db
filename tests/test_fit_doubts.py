"""What a fit says of its residuals: noise or misfit, outliers, correlations; and of rows that are far apart."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import turn
from scipy.stats import chi2

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.noise import aliases_of, doubts, explained, remainders_of, within_sigmas

N = 200
TIMES = np.arange(float(N))
WAVE = np.stack([np.cos(0.2 * TIMES + k) for k in range(3)], axis=1)


def quaternions(angles):
    return np.asarray(ml.so3.exp(jnp.asarray(angles)))


# For each kind of measurement, one that shows a wave of this size about something constant.
KINDS = {
    "Rates": lambda size: fitting.Rates(TIMES, size * WAVE, 1.0),
    "Accelerations": lambda size: fitting.Accelerations(TIMES, size * WAVE, 1.0, lever=[0.0, 0, 0]),
    "Attitudes": lambda size: fitting.Attitudes(TIMES, quaternions(size * WAVE), 1.0),
    "Directions": lambda size: fitting.Directions(TIMES, [0, 0, 1] + size * WAVE, 1.0, reference=[0.0, 0, 1]),
    "Positions": lambda size: fitting.Positions(TIMES, 5 + size * WAVE, 1.0, markers=[0.0, 0, 0]),
    "Observed": lambda size: fitting.Observed(TIMES, 5 + size * WAVE, 1.0, lambda t, state, body, values: state),
    "OfBody": lambda size: fitting.OfBody(0, fitting.Rates(TIMES, size * WAVE, 1.0)),
}


def is_explained(measurement, residuals):
    seen = np.asarray(residuals)[:, : measurement.present.shape[-1]].reshape(measurement.present.shape)
    return bool(explained(remainders_of([measurement], jnp.asarray(seen.reshape(-1)), {})))


def test_every_kind_of_measurement_is_tested():
    kinds = {name for name, cls in vars(fitting).items() if isinstance(cls, type)}
    assert {n for n in kinds if issubclass(getattr(fitting, n), fitting.Measurement)} - {"Measurement"} == set(KINDS)


@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", KINDS)
def test_what_a_model_leaves_of_the_signal_is_a_misfit(kind):
    """The whole wave or half of it; a tenth is small, and noise smaller than the wave is noise."""
    measurement, noise = KINDS[kind](0.5), np.random.default_rng(0).standard_normal((N, 3))
    assert is_explained(measurement, 0.05 * WAVE)
    assert is_explained(measurement, 0.05 * noise)
    assert is_explained(measurement, 0 * noise)
    assert not is_explained(measurement, 0.5 * WAVE)
    assert not is_explained(measurement, 0.25 * WAVE)


@pytest.mark.parametrize("kind", ["Attitudes", "Directions"])
def test_a_small_motion_of_which_the_model_explains_nothing_is_a_misfit(kind):
    """A libration of three degrees: small relative to a radian, but noise is not correlated. Noise of this size is."""
    measurement, noise = KINDS[kind](0.05), np.random.default_rng(0).standard_normal((N, 3))
    assert not is_explained(measurement, 0.05 * WAVE)
    assert is_explained(measurement, 0.05 * noise)


def test_chi_squared_is_that_of_a_chance_of_one_in_a_million_with_sigmas_to_a_tenth():
    for dof in (3, 10, 100, 10_000):
        limit = 1.21 * chi2.isf(1e-6, dof)
        number = jnp.asarray(float(dof))
        assert bool(within_sigmas(jnp.asarray(0.99 * limit), number))
        assert not bool(within_sigmas(jnp.asarray(1.08 * limit), number))


def rates(residuals):
    return [fitting.Rates(np.arange(float(len(residuals))), np.ones((len(residuals), 3)), 1.0)]


def test_all_outliers_are_named():
    residuals = 0.01 * np.random.default_rng(0).standard_normal((400, 3))
    wrong = np.arange(20, 400, 38)[:10]
    residuals[wrong, 1] += 0.5
    (doubt,) = doubts([residuals], rates(residuals))
    assert doubt.rows == tuple(wrong)
    assert "10 values are off by" in doubt.text
    assert all(f" {row}," in doubt.text + "," for row in wrong)


def test_white_noise_raises_no_doubt():
    rng = np.random.default_rng(0)
    for n in (12, 40, 400):
        for _ in range(30):
            residuals = rng.standard_normal((n, 3))
            assert not doubts([residuals], rates(residuals))


@pytest.mark.parametrize("r", [0.5, 0.8, 0.9])
def test_correlated_residuals_tell_by_what_factor_the_intervals_are_too_narrow(r):
    """AR(1): the root of (1 + r) / (1 - r), the known factor of the deviation of a mean."""
    rng, factors = np.random.default_rng(1), []
    for _ in range(10):
        residuals = rng.standard_normal((2000, 3))
        for i in range(1, len(residuals)):
            residuals[i] += r * residuals[i - 1]
        (doubt,) = doubts([0.01 * residuals], rates(residuals))
        factors.append(float(doubt.text.split("a factor of about ")[1]))
    np.testing.assert_allclose(np.mean(factors), ((1 + r) / (1 - r)) ** 0.5, rtol=0.1)


BODY, BALL = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidBody([5.0, 5.0, 4.9])


def alias(gap, kinds=("Rates",), body=BODY, torque=None):
    """What is said of rows at this distance, of a body that turns at 1 radian per unit of time about axis 3."""
    times = gap * np.arange(10.0)
    made = {
        "Rates": lambda t: fitting.Rates(t, np.tile([0.0, 0, 1], (len(t), 1)), 1.0),
        "Attitudes": lambda t: fitting.Attitudes(t, np.tile(turn(0.5, -0.3, 0.8), (len(t), 1)), 1.0),
        "dense Rates": lambda t: fitting.Rates(t[-1] * np.arange(200) / 200, np.tile([0.0, 0, 1], (200, 1)), 1.0),
    }
    start = ml.RigidState(body.momentum(jnp.array([0.0, 0, 1])), turn(0.5, -0.3, 0.8))
    return aliases_of(lambda values: (body, torque, start), tuple(made[kind](times) for kind in kinds), {})


def test_rows_between_which_a_body_turns_far_are_named():
    assert alias(1.0) == alias(3.0, ("Attitudes",)) == ""
    assert "turns 9.9 times between rows" in alias(9.9 * 2 * np.pi)
    assert "turns 0.6 times between rows" in alias(0.6 * 2 * np.pi, ("Attitudes",))
    assert alias(0.6 * 2 * np.pi, ("Attitudes", "dense Rates")) == ""
    # The rates of a free body that is nearly a ball change slowly; under a torque they may change with the attitude.
    assert alias(3 * 2 * np.pi, body=BALL) == ""
    assert "turns 3 times" in alias(3 * 2 * np.pi, body=BALL, torque=ml.torques.HeavyTop(1.0))
    assert "turns 3 times" in alias(3 * 2 * np.pi, ("Attitudes",), body=BALL)


def test_speeds_that_no_free_body_has_are_not_taken_for_degrees():
    """Held, thrown and caught: the guess is the first row, and other rows are a hundred times as fast."""
    values = np.concatenate([0.05 * np.ones((10, 3)), 5 * np.ones((20, 3))])
    measured = fitting.Rates(np.arange(30.0), values, 0.1)
    guess = {"p": fitting.Free([0.05, 0.1, 0.125])}
    with pytest.raises(ValueError, match=r"one free motion, got speeds from 0.0866 to 8.66. Fit only the rows"):
        fitting.prepare(lambda v: (BODY, None, ml.MomentumState(v["p"])), guess, measured, dt=0.1)
