"""Statistics of time: autocorrelations beside sums in Python loops, and spectra beside those of SciPy."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import get_window, welch
from simulated import ATTITUDES, BODIES, MOMENTA, MOMENTS, WEIGHTS, simulated

import midlie_jax as ml

BODY, TORQUE = ml.RigidBody(jnp.asarray(MOMENTS)), ml.torques.HeavyTop(jnp.asarray(WEIGHTS))
START = ml.RigidState(jnp.asarray(MOMENTA), jnp.asarray(ATTITUDES))
RUN = {"dt": 0.05, "steps": 120, "save_every": 2}  # 61 saved values
SAVES, INTERVAL, LAGS = 61, 0.1, 15


def momentum(t, state):
    return state.momentum


def speed(t, state):
    return jnp.sum(state.momentum**2)


EVERYTHING = {"vector": momentum, "number": speed, "matrix": lambda t, s: s.momentum[:2, None] * s.attitude[None]}


def ensemble(observe, start=START, **options):
    return ml.ensemble("SYMMETRIC[EA]", BODY, TORQUE, start, observe=observe, **{**RUN, **options})


def correlated(x, lags, first_bad, *, centred=False, normalised=False):
    """Correlation, error and number of bodies, from values (n, k, m), product by product."""
    counted = [body[:count] for body, count in zip(x, first_bad, strict=True)]
    mean = np.concatenate(counted).mean(axis=0) if centred else 0.0
    s, terms = np.zeros((2, lags + 1, len(x)))
    for i, body in enumerate(counted):
        for lag in range(lags + 1):
            for t in range(len(body) - lag):
                s[lag, i] += np.dot(body[t] - mean, body[t + lag] - mean)
                terms[lag, i] += 1
    value, number = s.sum(axis=1) / terms.sum(axis=1), (terms > 0).sum(axis=1)
    away = (s - value[:, None] * terms) / terms.sum(axis=1)[:, None]
    if normalised:
        away = (away - (value / value[0])[:, None] * away[0]) / value[0]
        value = value / value[0]
    return value, np.sqrt(number / (number - 1) * (away**2).sum(axis=1)), number


def drawn(bodies=6, times=80, components=2, seed=0):
    """Values whose mean is far from zero, of bodies that differ; and how many of each count."""
    random = np.random.default_rng(seed)
    x = random.normal(size=(bodies, times, components)) + random.normal(size=(bodies, 1, components)) + 3.0
    first_bad = random.integers(LAGS, times, size=bodies)
    first_bad[:3] = times, 0, LAGS // 2
    x[np.arange(times)[None] >= first_bad[:, None]] = np.nan
    return x, first_bad


@pytest.mark.sample(1)
@pytest.mark.parametrize(("centred", "normalised"), [(True, True), (False, True), (False, False)])
def test_an_autocorrelation_is_the_mean_of_all_products(centred, normalised):
    """Values from `first_bad` on do not count, though they are no numbers."""
    x, first_bad = drawn()
    options = {"centred": centred, "normalised": normalised}
    found = ml.observe.autocorrelation(x, LAGS, interval=INTERVAL, first_bad=first_bad, **options)
    value, error, number = correlated(x, LAGS, first_bad, **options)
    np.testing.assert_allclose(found.correlation, value, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(found.error, error, rtol=1e-11, atol=1e-14)
    np.testing.assert_array_equal(found.number, number)
    np.testing.assert_allclose(found.lag, INTERVAL * np.arange(LAGS + 1), rtol=1e-15)


def in_dtype(dtype, observe, chunk=7):
    body, torque, start = jax.tree.map(lambda x: x.astype(dtype), (BODY, TORQUE, START))
    return ml.ensemble("SYMMETRIC[EA]", body, torque, start, observe=observe, chunk=chunk, **RUN)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("dtype", "centred"), [("float64", False), ("float32", True)])
def test_an_ensemble_observes_what_its_values_have(centred, dtype):
    """In a pytree of numbers, vectors and matrices, in chunks; `times` stay those of the values."""
    run = partial(in_dtype, dtype)
    values = run(EVERYTHING)
    path = run(ml.observe.Autocorrelation(EVERYTHING, LAGS, centred=centred))
    np.testing.assert_array_equal(path.times, values.times)
    close = {"rtol": 1e-11, "atol": 1e-13} if dtype == "float64" else {"rtol": 1e-5, "atol": 1e-5}
    for name, x in values.states.items():
        x = np.asarray(x, np.float64).reshape(BODIES, SAVES, -1)
        value, error, number = correlated(x, LAGS, [SAVES] * BODIES, centred=centred)
        found = jax.tree.map(np.asarray, path.states[name])
        assert found.correlation.dtype == found.error.dtype == found.lag.dtype == dtype
        scale = np.abs(value).max()
        np.testing.assert_allclose(found.correlation / scale, value / scale, **close, err_msg=name)
        np.testing.assert_allclose(found.error / scale, error / scale, **close, err_msg=name)
        np.testing.assert_array_equal(found.number, number)
        np.testing.assert_allclose(found.lag, INTERVAL * np.arange(LAGS + 1), rtol=1e-6)


WINDOWS = [(20, "hann", None, True), (21, "hann", 0, False), (21, "boxcar", 19, True), (20, ("kaiser", 8.0), 7, True)]


@pytest.mark.sample(1)
@pytest.mark.parametrize(("segment", "window", "overlap", "detrend"), WINDOWS)
def test_a_spectrum_is_that_of_scipy(window, overlap, detrend, segment):
    """Averaged over bodies, summed over components."""
    x, _ = drawn()
    x = np.nan_to_num(x)
    numbers = window if isinstance(window, str) else get_window(window, segment)
    found = ml.observe.spectrum(x, segment, interval=INTERVAL, window=numbers, overlap=overlap, detrend=detrend)
    options = {"window": window, "noverlap": overlap, "detrend": "constant" if detrend else False}
    frequency, density = welch(x, 1 / INTERVAL, nperseg=segment, axis=1, **options)
    density = density.sum(axis=-1)
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-14)
    np.testing.assert_allclose(found.density, density.mean(axis=0), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(found.error, density.std(axis=0, ddof=1) / np.sqrt(len(x)), rtol=1e-10, atol=1e-14)
    assert set(found.number.tolist()) == {len(x)}


STATISTICS = {
    "centred": ml.observe.Autocorrelation(momentum, LAGS, centred=True, normalised=True),
    "overlapping": ml.observe.Spectrum(momentum, 12, overlap=11, window="boxcar"),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", STATISTICS)
def test_blocks_of_values_and_groups_of_bodies_are_one_series(name):
    """However a run is cut, in time and among the bodies; blocks may be shorter than what is carried."""
    x, first_bad = drawn()
    good = jnp.asarray(np.arange(x.shape[1])[None] < first_bad[:, None])
    statistic, values = STATISTICS[name], jnp.asarray(x)

    @jax.jit
    def cut(values, good):
        parts = []
        for rows in (slice(0, 2), slice(2, 6)):
            carried, end = statistic.begun(len(x[rows]), jax.ShapeDtypeStruct(x.shape[2:], x.dtype)), 0
            for size in (5, 41, 34):
                block = slice(end, end := end + size)
                carried = statistic.taken(carried, values[rows, block], good[rows, block])
            parts.append(statistic.sums(carried, jnp.ones(len(x[rows]), bool)))
        merged = statistic.merged(jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts))
        return statistic.result(merged, jnp.asarray(INTERVAL))

    whole = jax.jit(lambda *given: statistic.of_bodies(*given))(values, good, jnp.asarray(INTERVAL))
    for found, expected in zip(cut(values, good), whole, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-14)


@pytest.mark.sample(0)
def test_sums_in_float32_keep_their_digits():
    """Of a million values whose mean is far from zero."""
    x = (10 + np.random.default_rng(1).normal(size=(2, 500_000))).astype(np.float32)
    exact, count = x.astype(np.float64), x.shape[1]
    for centred, values, close in ((False, exact, {"rtol": 3e-7}), (True, exact - exact.mean(), {"atol": 1e-6})):
        lagged = [np.mean(values[:, : count - lag] * values[:, lag:]) for lag in range(3)]
        found = ml.observe.autocorrelation(x, 2, centred=centred).correlation
        np.testing.assert_allclose(found, lagged, **close)
    _, density = welch(exact, nperseg=100, axis=1)
    found = ml.observe.spectrum(x, 100, interval=1.0)
    np.testing.assert_allclose(found.density[1:], density.mean(axis=0)[1:], rtol=1e-5)


@pytest.mark.sample(0)
def test_a_susceptibility_is_the_transform_of_the_decay_of_each_body():
    """chi = -(1/kT) times the integral of C' exp(i omega t), interval by interval, and its spread over the bodies."""
    x, first_bad = drawn(bodies=7)
    found = ml.observe.Susceptibility(momentum, LAGS, kT=0.7)
    values, good = jnp.asarray(x), jnp.asarray(np.arange(x.shape[1])[None] < first_bad[:, None])
    found = jax.jit(lambda *given: found.of_bodies(*given))(values, good, jnp.asarray(INTERVAL))
    frequency, responses = np.pi * np.arange(LAGS + 1) / (LAGS * INTERVAL), []
    for body, count in zip(x, first_bad, strict=True):
        if count > LAGS:
            products = [[np.dot(body[t], body[t + lag]) for t in range(count - lag)] for lag in range(LAGS + 1)]
            slope = np.diff([np.mean(each) for each in products]) / INTERVAL
            times = INTERVAL * (np.arange(LAGS)[:, None] + np.linspace(0, 1, 2001)) * np.ones((LAGS, 1))
            waves = np.trapezoid(np.exp(1j * frequency[:, None, None] * times), times, axis=-1)
            responses.append(-(waves @ slope) / 0.7)
    mean, count = np.mean(responses, 0), len(responses)
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-14)
    np.testing.assert_allclose(found.real, mean.real, atol=1e-5)
    np.testing.assert_allclose(found.imag, mean.imag, atol=1e-5)
    np.testing.assert_allclose(found.real_error, np.std(np.real(responses), 0, ddof=1) / np.sqrt(count), atol=1e-5)
    np.testing.assert_allclose(found.imag_error, np.std(np.imag(responses), 0, ddof=1) / np.sqrt(count), atol=1e-5)
    np.testing.assert_array_equal(found.number, count)


SEVERAL = {
    "over times": {
        "response": ml.observe.Susceptibility(momentum, 9, kT=2.0),
        "spectrum": ml.observe.Spectrum(speed, 10),
        "all": ml.observe.Autocorrelation(EVERYTHING, 5, centred=True),
    },
    "at each time": {"mean": ml.observe.Mean(EVERYTHING), "bins": ml.observe.Histogram(speed, [0.0, 1.0, 2.0])},
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", SEVERAL)
def test_several_statistics_of_one_run_are_those_of_several_runs(tmp_path, kind):
    """In memory, and in files with several groups and spans."""
    together = ensemble(SEVERAL[kind]).states
    file = simulated(tmp_path / "several.zarr", span=8, observe=SEVERAL[kind]).open()
    for name, statistic in SEVERAL[kind].items():
        alone = ensemble(statistic).states
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-13), together[name], alone)
        found = simulated(tmp_path / f"{name}.zarr", span=8, observe=statistic).open()
        for variable in {*found.data_vars} - {"first_bad", "parameter_body_moments", "parameter_torque_mgl"}:
            kept = file[name if variable == "observed" else f"{name}_{variable}"]
            np.testing.assert_allclose(kept, found[variable], rtol=1e-12, atol=1e-13)


def test_what_a_statistic_of_time_cannot_be_is_named():
    spectrum, correlation = (partial(kind, momentum) for kind in (ml.observe.Spectrum, ml.observe.Autocorrelation))
    free = ml.RigidBody([1.0, 2.0, 2.5]), None, ml.MomentumState([0.3, 1.0, -0.2])
    varied = partial(ml.integrate_variable_step, "JACOBI[EA]", *free, density=lambda t, s: 1.0 + 0.0 * t, dt=0.1)
    cases = {
        "lags must be a positive Python int": lambda: correlation(-1),
        "segment must be at least 2": lambda: spectrum(1),
        r"overlap \(8\) must be less than segment \(8\)": lambda: spectrum(8, overlap=8),
        r"window must be one number for each value of a segment, \(8,\)": lambda: spectrum(8, window=np.ones(7)),
        r"lags \(61\) must be less than the number of saved values \(61\)": lambda: ensemble(correlation(61)),
        r"segment \(62\) must be at most the number of saved values \(61\)": lambda: ensemble(spectrum(62)),
        "give one dt and one t0 for all": lambda: ensemble(spectrum(21), dt=jnp.full(BODIES, 0.05)),
        "values must be .bodies, times.": lambda: ml.observe.spectrum(np.ones(9), 4, interval=1.0),
        "interval must be finite and not zero": lambda: ml.observe.spectrum(np.ones((1, 9)), 4, interval=0.0),
        "first_bad must be one integer": lambda: ml.observe.autocorrelation(np.ones((2, 9)), 4, first_bad=[3]),
        "kT must be positive": lambda: ml.observe.Susceptibility(momentum, 4, kT=0.0),
        "only statistics or none, but 'b' is an observable": lambda: ensemble({"a": spectrum(8), "b": speed}),
        "only a is over times": lambda: ensemble({"a": spectrum(8), "b": ml.observe.Mean(speed)}),
        "these steps differ": lambda: varied(steps=9, observe=spectrum(8)),
    }
    for message, call in cases.items():
        with pytest.raises(ValueError, match=message):
            call()
