"""What a fit doubts: misfits, outliers, correlations, rows that are far apart, attitudes in another convention."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import LEVEL, tumbled, turn
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.checks import check_conventions
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


@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", KINDS)
def test_what_a_model_leaves_of_the_signal_is_a_misfit(kind):
    """The whole wave or half of it; noise smaller than the wave is noise, also of small angles."""
    measurement, noise = KINDS[kind](0.5), np.random.default_rng(0).standard_normal((N, 3))
    assert is_explained(measurement, 0.05 * WAVE)
    assert is_explained(measurement, 0.05 * noise)
    assert is_explained(measurement, 0 * noise)
    assert not is_explained(measurement, 0.5 * WAVE)
    assert not is_explained(measurement, 0.25 * WAVE)
    if kind in ("Attitudes", "Directions"):
        assert not is_explained(KINDS[kind](0.05), 0.05 * WAVE)
        assert is_explained(KINDS[kind](0.05), 0.05 * noise)


def test_chi_squared_is_that_of_a_chance_of_one_in_a_million_with_sigmas_to_a_tenth():
    for dof in (3.0, 100.0, 10_000.0):
        limit = jnp.asarray(1.21 * chi2.isf(1e-6, dof))
        assert bool(within_sigmas(0.99 * limit, jnp.asarray(dof)))
        assert not bool(within_sigmas(1.08 * limit, jnp.asarray(dof)))


def rates(residuals):
    return [fitting.Rates(np.arange(float(len(residuals))), np.ones((len(residuals), 3)), 1.0)]


def test_all_outliers_are_named_and_white_noise_raises_no_doubt():
    rng = np.random.default_rng(0)
    for n in (12, 40, 400):
        for _ in range(30):
            residuals = rng.standard_normal((n, 3))
            assert not doubts([residuals], rates(residuals))
    wrong = np.arange(20, 400, 38)[:10]
    residuals[wrong, 1] += 50
    (doubt,) = doubts([0.01 * residuals], rates(residuals))
    assert doubt.rows == tuple(wrong)
    assert "10 values are off by" in doubt.text
    assert all(f" {row}," in doubt.text + "," for row in wrong)


@pytest.mark.parametrize("r", [0.5, 0.9])
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


# ---- attitudes in another convention are named where there are rates, and right ones never are ----

CONJUGATED = np.array([1.0, -1, -1, -1])
WRONG = {
    "conjugated": lambda q: q * CONJUGATED,
    "scalar-last": lambda q: q[:, [1, 2, 3, 0]],
    "conjugated and scalar-last": lambda q: (q * CONJUGATED)[:, [1, 2, 3, 0]],
}
ROWS, FINE = 60, 1200


def motion(rng):
    """Times, attitudes, rates and the usual speed of a free body with random moments, by many small rotations."""
    a, b = rng.uniform(0.5, 1.0, 2)
    moments = np.array([a, b, rng.uniform(abs(a - b) + 0.02, a + b - 0.02)])
    momentum = rng.standard_normal(3) * moments * 10.0 ** rng.uniform(-3, 1)
    speed = np.linalg.norm(momentum / moments)
    h = rng.uniform(0.01, 2.0) * ROWS / FINE / speed  # radians between two rows
    turned, rates, frames = Rotation.random(random_state=int(rng.integers(1e9))), [], []
    for _ in range(FINE):
        half = momentum + h / 2 * np.cross(momentum, momentum / moments)
        frames.append(turned.as_quat(scalar_first=True))
        rates.append(momentum / moments)
        turned = turned * Rotation.from_rotvec(h * half / moments)
        momentum = momentum + h * np.cross(half, half / moments)
    every = FINE // ROWS
    return h * every * np.arange(ROWS), np.array(frames)[::every], np.array(rates)[::every], speed


def message(measurements, values):
    try:
        check_conventions(measurements, values)
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", range(6))
def test_right_attitudes_are_never_named_and_wrong_ones_never_by_another_name(seed):
    """With noise of any size, missing rows, outliers, sparse rows, signs that jump and an unknown bias."""
    rng = np.random.default_rng(seed)
    times, attitudes, rates, speed = motion(rng)
    noise = Rotation.from_rotvec(10.0 ** rng.uniform(-6, 0) * rng.standard_normal((ROWS, 3)))
    attitudes = (Rotation.from_quat(attitudes, scalar_first=True) * noise).as_quat(scalar_first=True)
    attitudes = attitudes * rng.choice([-1, 1], (ROWS, 1))
    attitudes[rng.random(ROWS) < 0.05] = [0.5, -0.5, 0.5, 0.5]
    attitudes[rng.random(ROWS) < rng.choice([0, 0.5])] = np.nan
    rates = rates + 10.0 ** rng.uniform(-6, 0.5) * speed * rng.standard_normal((ROWS, 3))
    bias = "bias" if seed % 3 == 0 else None
    rates = rates + (speed * rng.standard_normal(3) if bias else 0)
    rates[rng.random(ROWS) < rng.choice([0, 0.3])] = np.nan
    kept = np.sort(rng.permutation(ROWS)[: rng.choice([12, 30, ROWS])])
    gyroscope, values = fitting.Rates(times[kept], rates[kept], 1.0, bias=bias), {"bias": jnp.zeros(3)}
    check_conventions([fitting.Attitudes(times, attitudes, 1.0), gyroscope], values)
    for name, read in WRONG.items():
        said = message([fitting.Attitudes(times, read(attitudes), 1.0), gyroscope], values)
        assert not said or f"these are {name}, " in said


@pytest.mark.parametrize(("name", "body"), list(zip(WRONG, (None, 1, None), strict=True)))
def test_another_convention_is_named_with_its_cure(name, body):
    """The cure is run as the message writes it; of several bodies, each is tested by its own rates."""
    rng = np.random.default_rng(3)
    times, attitudes, rates, _ = motion(rng)
    dense = np.stack([np.interp(np.linspace(0, times[-1], 300), times, x) for x in rates.T], axis=1)
    gyroscope = fitting.Rates(np.linspace(0, times[-1], 300), dense, 1.0)

    def check(values):
        both = [fitting.Attitudes(times, values, 1.0), gyroscope]
        other = [fitting.Rates(times, -rates, 1.0)]
        check_conventions(both if body is None else [fitting.OfBody(body, m) for m in both] + other, {})

    check(attitudes)
    wrong = WRONG[name](attitudes)
    with pytest.raises(ValueError, match=f"these are {name}, ") as raised:
        check(wrong)
    cure = str(raised.value).split("Pass ")[1].rstrip(".")
    check(eval(cure, {"np": np, "midlie_jax": ml, "values": wrong}))


@pytest.mark.sample(0)
def test_without_rates_a_fit_to_another_convention_is_not_ok():
    body, times = ml.RigidBody([1.0, 2.0, 2.5]), np.arange(0.0, 12.01, 0.5)
    rate = jnp.array([0.5, 0.3, 0.4])
    _, turned = tumbled(np.asarray(body.moments), rate, times, LEVEL)
    values = WRONG["conjugated"](turned.as_quat(scalar_first=True))

    def model(v):
        return body, None, ml.RigidState(body.momentum(v["rate"]), v["attitude"])

    guess = {"rate": fitting.Free(1.02 * rate), "attitude": fitting.UnitQuaternion(values[0])}
    found = ml.fit(model, guess, fitting.Attitudes(times, values, 1e-3), method="RK4", dt=0.25)
    assert not found.ok
    assert found.rms > 100
    assert "quaternions are (w, x, y, z) from body to space" in found.message
