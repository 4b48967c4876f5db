"""Calls of `fit`: sigmas, starts, other solvers, progress, what is refused, and how a fit says that it failed."""

import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_fitting import MARKERS, SUN, TENSOR

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting import Result
from midlie_jax.fitting.instruments import Attitudes, Directions, Positions, Rates
from midlie_jax.fitting.parameters import Free, InertiaTensor, Moments, UnitQuaternion


def still(values):
    return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["rate"])


def spin(sigma=0.1, n=5, **changes):
    rates = np.tile([0.1, 0.2, 0.3], (n, 1)) + 0.01 * np.random.default_rng(0).standard_normal((n, 3))
    return Rates(**({"times": np.arange(float(n)), "values": rates, "sigma": sigma} | changes))


@pytest.mark.sample(0)
def test_sigmas_are_relative_unless_they_are_said_to_be_absolute():
    """The mean of n numbers: its deviation is s / sqrt(n), by the scatter with Student's t, or by the given sigma."""
    relative, absolute = (try_fit(spin(), absolute_sigma=known) for known in (False, True))
    assert relative.result is Result.of(int(relative.estimate.result)) is Result.FITTED
    rates = np.asarray(spin().values)
    scatter = np.sqrt(np.sum((rates - rates.mean(axis=0)) ** 2) / 12)
    np.testing.assert_allclose(relative.coordinates, rates.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(np.ptp(relative.intervals, axis=1), 2 * 2.178812829663 * scatter / np.sqrt(5), rtol=1e-7)
    np.testing.assert_allclose(np.ptp(absolute.intervals, axis=1), 2 * 1.959963984540 * 0.1 / np.sqrt(5), rtol=1e-7)
    assert relative.dof == relative.estimate.dof == 12
    np.testing.assert_allclose(relative.residuals()[0], (relative.coordinates - rates) / 0.1, atol=1e-9)


@pytest.mark.sample(0)
def test_a_solver_of_optax_can_take_the_place_of_levenberg_and_marquardt():
    import optax
    import optimistix as optx

    def solver(residuals, start, max_steps):
        adam = optx.OptaxMinimiser(optax.adam(0.05), rtol=1e-7, atol=1e-7)
        found = optx.least_squares(lambda x, _: residuals(x), adam, start, max_steps=max_steps, throw=False)
        return found.value, found.stats["num_steps"], found.result == optx.RESULTS.successful

    with jax.numpy_dtype_promotion("standard"):  # optax mixes float and int32
        found = try_fit(spin(), solver=solver, max_steps=5000)
    assert found.ok
    assert found.steps > 10
    np.testing.assert_allclose(found.coordinates, np.asarray(spin().values).mean(axis=0), rtol=1e-3)


def rooted(values):
    """A ball whose rate is not a number if the parameter is below 0.9."""
    return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(jnp.sqrt(values["square"] - 0.9) * jnp.ones(3))


def test_what_a_solver_returns_is_checked():
    for solver, message in (
        (lambda residuals, x, most: (x[:1], 1, True), r"got shapes \(1,\), \(\), \(\)"),
        (lambda residuals, x, most: (x, 1), r"got shapes \(3,\), \(\);"),
        (lambda residuals, x, most: x, r"got an array of shape \(3,\)"),
    ):
        with pytest.raises(ValueError, match=rf"solver must return \(optimum, steps, converged\).*{message}"):
            try_fit(spin(), solver=solver)


@pytest.mark.sample(0)
def test_a_solver_that_ends_at_no_number_has_failed():
    """Whatever it returns as its verdict; and among several starts another one counts."""
    found = try_fit(spin(), solver=lambda residuals, x, most: (x * jnp.nan, 1, True))
    assert found.result is Result.RUN_FAILED
    assert "the model refuses the values at the end of the search: momentum must be finite" in found.message
    assert "NOT ok" in str(found)

    def diverging(residuals, x, most):
        """Stays near the optimum, and from everywhere else goes where the model gives NaN."""
        return jnp.where(jnp.sum(residuals(x) ** 2) < 100.0, x, x - 1e4), 1, True

    data = Rates(np.arange(5.0), np.sqrt(0.2) * np.ones((5, 3)), 1e-3)
    many = try_fit(data, rooted, {"square": Free([1.1])}, solver=diverging, starts=4)
    assert many.ok
    np.testing.assert_allclose(many.coordinates, 1.1)


TIMED = np.arange(5.0)
WRONG = [
    (lambda: spin(values=np.full((5, 3), np.nan)), "NaN in every row"),
    (lambda: spin(values=np.full((5, 3), np.inf)), "must be finite, or NaN where missing"),
    (lambda: spin(times=TIMED[:4]), "one row for each time"),
    (lambda: spin(sigma=0.0), "sigma must be positive"),
    (lambda: spin(sigma=np.ones((4, 1))), "sigma must broadcast"),
    (lambda: Attitudes(TIMED, np.ones((5, 4)), 0.1), "must be unit quaternions"),
    (lambda: Directions(TIMED, np.zeros((5, 3)), 0.1, reference=SUN), "must not be zero"),
    (lambda: Directions(TIMED, np.ones((5, 3)), 0.1, reference=[1.0]), "reference must"),
    (lambda: Positions(TIMED, np.ones(5), 0.1, markers=SUN), r"\(n, m, 3\)"),
    (lambda: Positions(TIMED, np.ones((5, 3)), 0.1, markers=MARKERS), "markers must have"),
    (lambda: Moments([1.0, 2.0, 3.5]), "strict triangle"),
    (lambda: Moments([1.0, 2.0, 2.5], scale="known"), "'free' or 'fixed'"),
    (lambda: InertiaTensor(TENSOR + np.eye(3, k=1)), "must be symmetric"),
    (lambda: UnitQuaternion([1.0, 1.0, 0.0, 0.0]), "unit quaternion"),
    (lambda: try_fit(spin(), t0=1.0), "before the start at t0 = 1"),
    (lambda: try_fit(spin(n=1)), r"more numbers than the 3 unknowns .*, got 3; give at least 4"),
    (lambda: try_fit(spin(), guess={}), "guess must hold a parameter, got none"),
    (lambda: try_fit(spin(), guess={"rate": jnp.zeros(3)}), "wrap it"),
    (lambda: try_fit(spin(bias="drift")), "'drift', which is not in the guess"),
    (lambda: try_fit(fitting.OfBody(0, spin(bias="drift"))), "bias of Rates .* got 'drift'"),
    (lambda: try_fit(Attitudes(TIMED, np.eye(4)[[0] * 5], 0.1)), "return a RigidState"),
    (lambda: try_fit(spin(), segments=9), "segments must not be too many for the steps, got 9"),
    (lambda: try_fit(spin(), starts=0), "starts must be"),
    (lambda: try_fit(spin(), model=lambda: None), "model must take the values"),
    (lambda: try_fit(in_degrees(), guess={"rate": Free([0.1, 0.2, 0.3])}), "np.deg2rad"),
    (lambda: try_fit(spin(times=1e9 * TIMED)), "after 4e\\+09 steps"),
    (lambda: try_fit(spin(), solver=lambda x: x), "solver must be a function of"),
    (lambda: try_fit(spin(), first_span=np.nan), "first_span must be a positive finite"),
    (lambda: try_fit(spin(), solver=lambda *x: x, first_span=1.0), "first_span must be None"),
    (lambda: fitting.states_at("RK4", *still({"rate": jnp.ones(3)}), [1.0, 0.0], dt=1.0), "ascend"),
]


def in_degrees():
    return spin(values=np.rad2deg(spin().values))


def try_fit(measurements, model=still, guess=None, **changes):
    start = {"rate": Free([0.0, 0.0, 0.0])} if guess is None else guess
    return ml.fit(model, start, measurements, **({"dt": 1.0, "method": "RK4"} | changes))


def test_what_is_wrong_is_said_before_anything_is_traced(monkeypatch):
    monkeypatch.setattr(sys.modules[ml.fit.__module__], "solved", None)
    for act, message in WRONG:
        with pytest.raises(ValueError, match=message):
            act()


@pytest.mark.sample(0)
def test_segments_starts_and_spans_end_at_the_same_estimate():
    """They are ways to the optimum, which is the mean of the rates."""
    for options in ({"segments": 2, "starts": 2}, {"first_span": 1.5}):
        found = try_fit(spin(), **options)
        assert found.ok
        np.testing.assert_allclose(found.coordinates, np.asarray(spin().values).mean(axis=0), rtol=1e-7)


# ---- how a fit says that it failed: why, at which time, and what would do ----


def test_a_fit_that_needs_more_steps_says_how_many_it_took(capfd):
    found = try_fit(spin(), max_steps=1, progress=True)
    assert "fit: step 1, loss" in capfd.readouterr().err
    assert not found.ok
    assert found.result is Result.NOT_CONVERGED
    assert "did not converge in 1 steps" in found.message
    assert found.message in str(found)


@pytest.mark.sample(0)
def test_a_failed_run_says_when_and_which_step_would_do():
    """Three radians in a step are too many; the step that the message names gives a fit."""
    fast = spin(values=np.asarray(spin().values) + np.array([0.0, 0.0, 3.0]))
    near = {"rate": Free([0.1, 0.2, 3.3])}
    found = try_fit(fast, guess=near)
    assert found.result is Result.RUN_FAILED
    assert "failed after t = 0:" in found.message
    assert "turns 3.31 radians in a step" in found.message
    enough = float(re.search(r"dt = ([\d.e-]+) would do", found.message)[1])
    assert try_fit(fast, guess=near, dt=enough).ok


GUESS = {"rate": Free([0.1, 0.2, 0.3])}


def blind(values):
    """A start that does not depend on the last number."""
    return still({"rate": values["rate"] * np.array([1.0, 1.0, 0.0])})


def test_what_is_not_determined_is_named_and_nothing_is_lost():
    flat = spin(values=np.asarray(spin().values) * [1.0, 1.0, 0.0])
    found = try_fit(flat, blind, GUESS, require_rank=False)
    assert found.result is Result.UNDETERMINED
    assert "rate[2] has no effect" in found.message
    with pytest.raises(ValueError, match="determine all 3 unknowns for draws, got a rank of 2"):
        found.draws(10)
    with pytest.raises(fitting.UndeterminedError, match=r"rate\[2\] has no effect.*rms") as raised:
        try_fit(flat, blind, GUESS)
    np.testing.assert_array_equal(raised.value.result.coordinates, found.coordinates)
    assert raised.value.result.rms == found.rms


@pytest.mark.sample(1)
@pytest.mark.parametrize("absolute", [True, False])
def test_a_misfit_is_reported_before_what_is_not_determined(absolute):
    """The third rate is 0.3, and the model says zero: no error, but a result with the values and the rms."""
    found = try_fit(spin(sigma=0.02), blind, GUESS, absolute_sigma=absolute)
    assert found.result is Result.MISFIT
    assert not found.ok
    assert f"{found.rms:.3g}" in found.message
    assert "rate[2] has no effect" in found.message
    np.testing.assert_allclose(found.values["rate"][:2], np.asarray(spin().values)[:, :2].mean(axis=0), rtol=1e-6)
    # Without `absolute_sigma` sigmas count up to a factor, so that residuals that exceed them are no misfit.
    known = try_fit(spin(sigma=1e-3), absolute_sigma=absolute)
    assert known.dof == 12
    assert known.rms > 5
    assert known.ok != absolute
    assert ("times the sigmas" in known.message) == absolute


def test_draws_scatter_as_the_covariance_says():
    """Mean and covariance of 20,000 draws, each to five of its standard deviations."""
    found, n = try_fit(spin()), 20_000
    rates = np.asarray(found.draws(n, seed=1)["rate"])
    deviations = np.sqrt(np.diagonal(found.covariance))
    off = (rates - np.asarray(found.values["rate"])) / deviations
    assert rates.shape == (n, 3)
    assert np.all(np.abs(off.mean(axis=0)) < 5 / np.sqrt(n))
    correlations = found.covariance / np.outer(deviations, deviations)
    assert np.all(np.abs(off.T @ off / n - correlations) < 5 * np.sqrt((1 + correlations**2) / n))
    np.testing.assert_array_equal(found.draws(5, seed=1)["rate"], found.draws(5, seed=1)["rate"])
