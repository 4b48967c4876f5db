"""Fits to published rates, and to noisy copies of them: estimates and intervals against the published numbers."""

from functools import cache

import jax
import numpy as np
import pytest
from cases import benchmark, quick

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.parameters import Moments

published = benchmark("laboratory.published_fits")
METHOD = published.METHOD


@cache
def resampled():
    """The estimates from 100 noisy copies of the rates, in one vmapped call, and the copies."""
    noise = np.random.default_rng(15).standard_normal((100, *published.BRICK_RATES.shape))
    copies = published.BRICK_RATES + published.NOISE * noise
    guess = published.brick_guess()
    plan = fitting.prepare(published.free, guess, published.brick_data(), method=METHOD, dt=published.BRICK_STEP)
    return quick(jax.vmap(lambda rates: fitting.fit_arrays(plan, guess, published.brick_data(rates))))(copies), copies


@pytest.mark.sample(0)
def test_the_brick_has_the_published_inertia():
    result = published.fitted_brick()
    assert result.ok
    np.testing.assert_allclose(result.values["moments"] / published.BRICK, 1, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(result.values["rate"]), [10, 20, 30], rtol=0, atol=1e-8)
    ratio, interval = result.derived(lambda v: v["moments"][0] / v["moments"][2])
    assert abs(ratio - published.BRICK[0] / published.BRICK[2]) < 1e-9
    assert interval[0] < ratio < interval[1]
    # One noisy copy alone is fitted as among the hundred.
    many, copies = resampled()
    alone = ml.fit(
        published.free, published.brick_guess(), published.brick_data(copies[7]), method=METHOD, dt=published.BRICK_STEP
    )
    np.testing.assert_allclose(alone.coordinates, many.coordinates[7], rtol=1e-7)
    np.testing.assert_allclose(alone.intervals, many.intervals[7], rtol=1e-6)
    text = str(alone)
    assert all(f"{value:.10g}" in text for value in [*alone.coordinates, *alone.intervals.ravel()])


@pytest.mark.sample(0)
def test_intervals_hold_the_truth_as_often_as_they_say():
    """Each of the published numbers, in 90 to 99 of 100 copies with noise of 1e-3 of the angular velocity."""
    many, _ = resampled()
    assert np.all(many.ok)
    truth = np.concatenate([published.BRICK, published.BRICK_RATES[0]])
    low, high = np.moveaxis(np.asarray(many.intervals), -1, 0)
    inside = np.sum((low <= truth) & (truth <= high), axis=0)
    assert np.all((inside >= 90) & (inside <= 99)), inside
    assert 0.9 < np.mean(many.rms) < 1.0  # less than 1, because the parameters take 5 of 39 degrees of freedom


@pytest.mark.sample(0)
def test_the_covariance_is_that_of_the_scatter():
    """Of 100 copies a variance is known to 14 %."""
    many, _ = resampled()
    scatter = np.cov(np.asarray(many.coordinates).T)
    predicted = np.mean(many.covariance, axis=0)
    np.testing.assert_allclose(np.diagonal(scatter) / np.diagonal(predicted), 1, rtol=0, atol=0.42)
    sizes = np.sqrt(np.diagonal(predicted))
    correlations = (matrix / np.outer(sizes, sizes) for matrix in (scatter, predicted))
    np.testing.assert_allclose(*correlations, rtol=0, atol=0.42)


@pytest.mark.sample(0)
def test_a_free_body_gives_ratios_of_moments_only():
    """The fit says so, or flags it; and the ratios are found all the same."""
    whole = published.brick_guess() | {"moments": Moments(published.BRICK)}
    data = published.brick_data()
    message = r"moments\[0\], moments\[1\], moments\[2\] cannot be told apart\. .*ratios.*scale=\"fixed\""
    with pytest.raises(ValueError, match=message):
        ml.fit(published.free, whole, data, method=METHOD, dt=0.125)
    flagged = ml.fit(published.free, whole, data, method=METHOD, dt=0.125, require_rank=False)
    assert not flagged.ok
    assert flagged.rank == 5
    assert flagged.condition == np.inf
    assert flagged.confounded == [["moments[0]", "moments[1]", "moments[2]"]]
    assert "moments[0], moments[1], moments[2] cannot be told apart" in str(flagged)
    unknown = [name for name, (low, high) in zip(flagged.names, flagged.intervals, strict=True) if high - low == np.inf]
    assert unknown == ["moments[0]", "moments[1]", "moments[2]"]
    ratio, interval = flagged.derived(lambda v: v["moments"][:2] / v["moments"][2])
    np.testing.assert_allclose(ratio, published.BRICK[:2] / published.BRICK[2], rtol=1e-6)
    assert np.all(np.isfinite(interval))
    _, interval = flagged.derived(lambda v: v["moments"][0])
    assert np.all(np.isinf(interval))


@pytest.mark.sample(0)
def test_the_satellite_has_the_published_ratios_of_moments():
    """From its rates at the start and after five orbits, within the intervals of what is known of them."""
    result = published.fitted_satellite()
    assert result.ok
    assert result.rank == 5
    truth = published.SATELLITE[:2] / published.SATELLITE[2]
    found, interval = result.derived(published.ratios)
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-9)
    assert np.all((interval[:, 0] <= truth) & (truth <= interval[:, 1]))
    assert np.all(np.ptp(interval, axis=1) < 1e-9)
    np.testing.assert_allclose(result.values["rate"], published.SATELLITE_RATES[0], rtol=0, atol=1e-15)


@pytest.mark.full
def test_a_gravity_gradient_gives_ratios_of_moments_only():
    """Its torque grows with the moments. The first matters little to the residuals and is named all the same."""
    result = published.satellite_without_scale()
    assert result.rank == 2
    assert result.confounded == [["moments[0]", "moments[1]", "moments[2]"]]
    truth = published.SATELLITE[:2] / published.SATELLITE[2]
    np.testing.assert_allclose(result.derived(published.ratios)[0], truth, rtol=0, atol=1e-9)
