"""How a fit says that it failed: why, at which time, and what would do."""

import re

import numpy as np
import pytest
from test_fit_calls import spin, still

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting import Free, Result


def fitted(measurements, guess=(0.0, 0.0, 0.0), **options):
    return ml.fit(still, {"rate": Free(guess)}, measurements, **({"method": "RK4", "dt": 1.0} | options))


def test_a_fit_that_succeeds_says_so():
    found = fitted(spin())
    assert found.ok
    assert found.result is Result.FITTED
    assert Result.of(int(found.estimate.result)) is Result.FITTED
    assert found.estimate.dof == found.estimate.residuals.size - found.estimate.vector.size


def test_a_fit_that_needs_more_steps_says_how_many_it_took():
    found = fitted(spin(), max_steps=1)
    assert not found.ok
    assert found.result is Result.NOT_CONVERGED
    assert "did not converge in 1 steps" in found.message
    assert found.message in str(found)


def test_a_failed_run_says_when_and_which_step_would_do():
    """Three radians in a step are too many; the step that the message names gives a fit."""
    fast = spin(values=np.asarray(spin().values) + np.array([0.0, 0.0, 3.0]))
    found = fitted(fast, guess=[0.1, 0.2, 3.3])
    assert found.result is Result.RUN_FAILED
    assert "failed after t = 0:" in found.message
    assert "turns 3.31 radians in a step" in found.message
    enough = float(re.search(r"dt = ([\d.e-]+) would do", found.message)[1])
    assert fitted(fast, guess=[0.1, 0.2, 3.3], dt=enough).ok


def blind(values):
    """A start that does not depend on the last number."""
    return still({"rate": values["rate"] * np.array([1.0, 1.0, 0.0])})


def test_what_is_not_determined_is_named_and_nothing_is_lost():
    flat = spin(values=np.asarray(spin().values) * [1.0, 1.0, 0.0])
    guess, options = {"rate": Free([0.1, 0.2, 0.3])}, {"method": "RK4", "dt": 1.0}
    found = ml.fit(blind, guess, flat, require_rank=False, **options)
    assert found.result is Result.UNDETERMINED
    assert "rate[2] has no effect" in found.message
    with pytest.raises(ValueError, match="determine all 3 unknowns for draws, got a rank of 2"):
        found.draws(10)
    with pytest.raises(fitting.UndeterminedError, match=r"rate\[2\] has no effect.*rms") as raised:
        ml.fit(blind, guess, flat, **options)
    np.testing.assert_array_equal(raised.value.result.coordinates, found.coordinates)
    assert raised.value.result.rms == found.rms


@pytest.mark.parametrize("absolute", [True, False])
def test_a_misfit_is_reported_before_what_is_not_determined(absolute):
    """The third rate is 0.3, and the model says zero: no error, but a result with the values and the rms."""
    guess, options = {"rate": Free([0.1, 0.2, 0.3])}, {"method": "RK4", "dt": 1.0}
    found = ml.fit(blind, guess, spin(sigma=0.02), absolute_sigma=absolute, **options)
    assert found.result is Result.MISFIT
    assert not found.ok
    assert f"{found.rms:.3g}" in found.message
    assert "rate[2] has no effect" in found.message
    np.testing.assert_allclose(found.values["rate"][:2], np.asarray(spin().values)[:, :2].mean(axis=0), rtol=1e-6)


def test_draws_scatter_as_the_covariance_says():
    """Mean and covariance of 20,000 draws, each to five of its standard deviations."""
    found, n = fitted(spin()), 20_000
    rates = np.asarray(found.draws(n, seed=1)["rate"])
    deviations = np.sqrt(np.diagonal(found.covariance))
    off = (rates - np.asarray(found.values["rate"])) / deviations
    assert rates.shape == (n, 3)
    assert np.all(np.abs(off.mean(axis=0)) < 5 / np.sqrt(n))
    correlations = found.covariance / np.outer(deviations, deviations)
    assert np.all(np.abs(off.T @ off / n - correlations) < 5 * np.sqrt((1 + correlations**2) / n))
    np.testing.assert_array_equal(found.draws(5, seed=1)["rate"], found.draws(5, seed=1)["rate"])


def test_known_sigmas_that_the_residuals_exceed_are_a_misfit():
    """Without `absolute_sigma` they count up to a factor, so that nothing is wrong."""
    found = fitted(spin(sigma=1e-3), absolute_sigma=True)
    assert found.rms > 5
    assert found.result is Result.MISFIT
    assert not found.ok
    assert "times the sigmas" in found.message
    assert fitted(spin(sigma=1e-3)).ok
    assert fitted(spin(sigma=0.01), absolute_sigma=True).ok
