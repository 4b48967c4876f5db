"""Fits to published rates, and to noisy copies of them: estimates and intervals against the published numbers."""

import re
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import photometry_scene
import pytest
from cases import benchmark, quick
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.parameters import Moments

published = benchmark("fits")
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
    data, step = published.brick_data(copies[7]), published.BRICK_STEP
    alone = ml.fit(published.free, published.brick_guess(), data, method=METHOD, dt=step)
    np.testing.assert_allclose(alone.coordinates, many.coordinates[7], rtol=1e-7)
    np.testing.assert_allclose(alone.intervals, many.intervals[7], rtol=1e-6)
    text = str(alone)
    assert all(f"{value:.10g}" in text for value in [*alone.coordinates, *alone.intervals.ravel()])


@pytest.mark.sample(0)
def test_intervals_hold_the_truth_as_often_as_they_say_and_the_covariance_is_that_of_the_scatter():
    """In 90 to 99 of 100 copies with noise of 1e-3 of the angular velocity; a variance is known to 14 %."""
    many, _ = resampled()
    assert np.all(many.ok)
    truth = np.concatenate([published.BRICK, published.BRICK_RATES[0]])
    low, high = np.moveaxis(np.asarray(many.intervals), -1, 0)
    inside = np.sum((low <= truth) & (truth <= high), axis=0)
    assert np.all((inside >= 90) & (inside <= 99)), inside
    assert 0.9 < np.mean(many.rms) < 1.0  # less than 1, because the parameters take 5 of 39 degrees of freedom
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
    flagged = ml.fit(published.free, whole, data, method=METHOD, dt=0.125, require_rank=False)
    assert not flagged.ok
    assert flagged.rank == 5
    assert flagged.condition == np.inf
    assert flagged.confounded == [["moments[0]", "moments[1]", "moments[2]"]]
    assert re.search(message, str(flagged))
    ratio, interval = flagged.derived(lambda v: v["moments"][:2] / v["moments"][2])
    np.testing.assert_allclose(ratio, published.BRICK[:2] / published.BRICK[2], rtol=1e-6)
    assert np.all(np.isfinite(interval))
    assert np.all(np.isinf(flagged.derived(lambda v: v["moments"][0])[1]))


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


THROWN = 1e-3 * np.array([[2.0, 0.1, 0.0], [0.1, 3.1, 0.2], [0.0, 0.2, 4.0]])  # kg m^2, arXiv 2503.13137


def thrown(wheel):
    """Times at 500 Hz and rates by SciPy: a wheel on axis 3 accelerates to the momentum `wheel` in 0.2 s."""

    def slope(change):
        def at(t, rates):
            momentum = THROWN @ rates + [0.0, 0.0, min(5 * t, 1.0) * wheel]
            return np.linalg.solve(THROWN, -np.cross(rates, momentum) - [0.0, 0.0, change])

        return at

    times, near = np.arange(401) / 500, {"rtol": 1e-11, "atol": 1e-12, "method": "DOP853"}
    first = solve_ivp(slope(5 * wheel), (0.0, 0.2), [2.0, 1.5, 3.0], t_eval=times[:101], **near).y
    second = solve_ivp(slope(0.0), (0.2, 0.8), first[:, -1], t_eval=times[100:], **near).y
    return times, np.hstack([first, second[:, 1:]]).T + 0.005 * np.random.default_rng(1).standard_normal((401, 3))


@pytest.mark.sample(0)
def test_a_throw_with_a_wheel_has_an_absolute_inertia():
    wheel = 8e-3
    times, rates = thrown(wheel)
    spins = ml.spacecraft.ReactionWheels(lambda t: jnp.array([0.0, 0.0, wheel]) * jnp.minimum(5 * t, 1.0))

    def model(values):
        body = ml.TensorBody(values["inertia"])
        return body, spins, ml.MomentumState(body.momentum(values["rate"]))

    guess = {"inertia": fitting.InertiaTensor(np.diag([2.5e-3, 3e-3, 3.5e-3])), "rate": fitting.Free(rates[0])}
    data = fitting.Rates(times, rates, 0.005)
    result = ml.fit(model, guess, data, dt=0.004, absolute_sigma=True)
    assert result.ok
    truth, (low, high) = [*THROWN[np.triu_indices(3)], 2.0, 1.5, 3.0], result.intervals.T
    assert np.all((low < truth) & (truth < high))
    assert np.all((high - low)[[0, 3, 5]] < 0.005 * np.diag(THROWN))


def test_a_light_curve_is_that_of_numpy_and_scipy():
    """Of a tumbling ellipsoid, from its 20,000 facets; up to one constant, and without the noise."""
    t = np.linspace(1.0, 60.0, 40)
    sun, observer = photometry_scene.directions(t)
    start = ml.RigidState(photometry_scene.MOMENTUM, photometry_scene.ATTITUDE)
    path = ml.free_motion(ml.RigidBody(photometry_scene.MOMENTS), start, t)

    def magnitude(state, sun, observer):
        light = ml.asteroids.EllipsoidBrightness(photometry_scene.SEMI_AXES, sun, observer, magnitude=True)
        return light(0.0, state)

    offset = jax.vmap(magnitude)(path.states, sun, observer) - photometry_scene.magnitudes(t, sun, observer)
    np.testing.assert_allclose(offset, offset.mean(), rtol=0, atol=3e-5)
