"""What a fit doubts: misfits, outliers, correlations, rows far apart, other conventions; and how it searches."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import LEVEL, tumbled, turn
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.asteroids import EllipsoidBrightness, Photometry
from midlie_jax.fitting.checks import check_conventions
from midlie_jax.fitting.loss import as_loss
from midlie_jax.fitting.noise import aliases_of, doubts, explained, remainders_of, within_sigmas
from midlie_jax.fitting.parameters import Layout

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
ROWS = 60


def motion(rng):
    """Times, attitudes, rates and the usual speed of a free body with random moments."""
    a, b = rng.uniform(0.5, 1.0, 2)
    moments = np.array([a, b, rng.uniform(abs(a - b) + 0.02, a + b - 0.02)])
    momentum = rng.standard_normal(3) * moments * 10.0 ** rng.uniform(-3, 1)
    speed = np.linalg.norm(momentum / moments)
    times = rng.uniform(0.01, 2.0) / speed * np.arange(ROWS)  # radians between two rows
    first = Rotation.random(random_state=int(rng.integers(1e9))).as_quat(scalar_first=True)
    rates, turned = tumbled(moments, momentum / moments, times, first)
    return times, turned.as_quat(scalar_first=True), rates, speed


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


# ---- searches over ranges, robust losses and photometry ----

ZERO, NORTH = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0]


def light(values, sun, observer):
    return EllipsoidBrightness(jnp.append(values["axes"], 0.85), sun, observer)


def still(_):
    return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.RigidState([0.0, 0.0, 1.0], ZERO)


def wave(t, state, body, values):
    return values["height"] * jnp.sin(values["frequency"] * t + values["phase"])


def waves():
    """16 periods with 10 % noise: there is a minimum for each miscounted period."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 50, 200))
    return fitting.Observed(t, np.sin(2 * t + 0.4) + 0.1 * rng.standard_normal(200), 0.1, wave)


def of_wave(x, t, seen):
    return (x[0] * np.sin(x[1] * t + x[2]) - seen) / 0.1


FIRST = {"height": fitting.Positive(0.9), "frequency": fitting.Positive(2.3), "phase": fitting.Periodic(0.0)}
FREE = {"method": "free_motion", "absolute_sigma": True}


@pytest.mark.sample(0)
def test_all_minima_are_those_that_scipy_finds():
    search = {"starts": 256, "ranges": {"frequency": (1.6, 2.6), "phase": "all"}}
    found = ml.fit(still, FIRST, waves(), **FREE, **search)
    t, seen = (np.asarray(x) for x in (waves().times, waves().values))
    one = ml.fit(still, FIRST, waves(), **FREE)
    assert not one.minima
    assert one.rms > 3
    assert found.ok
    np.testing.assert_allclose([found.values["frequency"], found.values["height"]], [2, 1], atol=0.03)
    assert len(found.minima) > 5
    for minimum in found.minima[:5]:
        x = np.array([minimum.values[name] for name in ("height", "frequency", "phase")], float)
        best = least_squares(lambda x: of_wave(x, t, seen), x, xtol=1e-12)
        np.testing.assert_allclose(minimum.chi_squared, 2 * best.cost, rtol=1e-5)
    assert not np.any(np.diff([minimum.chi_squared for minimum in found.minima]) < 0)
    assert f"best of {len(found.minima)} minima" in str(found)


@pytest.mark.sample(0)
def test_a_wrong_minimum_that_looks_like_noise_is_doubted():
    """Between two nights one period more can be counted, and outliers hide that residuals are correlated."""
    t = np.concatenate([np.linspace(start, start + 4.0, 200) for start in (0, 30)])
    values = np.sin(2 * t + 0.4) + 0.16 * np.random.default_rng(0).standard_normal(400)
    values[::40] += 5
    seen, guess = fitting.Observed(t, values, 0.16, wave), {**FIRST, "phase": fitting.Periodic(-0.02)}
    wrong, right = (
        ml.fit(still, guess, seen, **FREE, starts=starts, ranges={"frequency": limits}, loss="cauchy")
        for starts, limits in ((8, (2.2, 2.22)), (32, (1.9, 2.22)))
    )
    assert wrong.ok
    assert abs(wrong.values["frequency"] - 2) > 0.2
    assert "wrong minimum; give more starts" in " ".join(wrong.doubts)
    assert "doubtful" in str(wrong)
    assert right.ok
    np.testing.assert_allclose(right.values["frequency"], 2, atol=0.003)
    assert not right.doubts


@pytest.mark.sample(0)
@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_a_robust_loss_is_the_one_of_scipy(loss):
    """SciPy's losses count 1/2 rho(f^2), with f in units of the scale; the minimum is the same."""
    t, seen = (np.array(x) for x in (waves().times, waves().values))
    seen[[5, 60, 110, 170]] += [1.5, -2.0, 3.0, 1.0]
    guess = {"height": fitting.Positive(0.9), "frequency": fitting.Positive(2.02), "phase": fitting.Periodic(0.3)}
    found = ml.fit(still, guess, fitting.Observed(t, seen, 0.1, wave), loss=loss, **FREE)
    exact = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-12}
    scale, first = as_loss(loss).scale, [0.9, 2.02, 0.3]
    best = least_squares(lambda x: of_wave(x, t, seen), first, loss=loss, f_scale=scale, **exact)
    values = [found.values[name] for name in ("height", "frequency", "phase")]
    np.testing.assert_allclose(values, best.x, rtol=1e-5)
    assert found.ok
    assert 0.9 < found.rms < 1.15
    np.testing.assert_array_equal(found.outliers[0], [5, 60, 110, 170])
    assert not found.doubts
    plain = ml.fit(still, guess, fitting.Observed(t, seen, 0.1, wave), **FREE)
    assert not plain.ok
    assert "off by" in str(plain.doubts)


@pytest.mark.sample(0)
@pytest.mark.parametrize("loss", [None, "huber"])
def test_zero_points_that_are_eliminated_are_those_of_a_joint_fit(loss):
    """As if they were unknowns of the search; times are those at which the light left."""
    t = np.arange(0.0, 12.0, 0.25)
    seen = 2 * np.sin(t) + np.where(t < 5, 15.0, 17.0) + 0.02 * np.random.default_rng(3).standard_normal(len(t))
    seen[[7, 30]] += [0.3, -0.5]
    night = np.where(t < 5, "a", "b")

    def shown(values, sun, observer):
        return lambda t, state: 10 ** (-0.4 * values["height"] * jnp.sin(t))

    def joint(t, state, body, values):
        return values["height"] * jnp.sin(t) + jnp.where(t < 5, values["zeros"][0], values["zeros"][1])

    given = {"sun": NORTH, "observer": NORTH, "night": night, "light_time": 0.3 + 0.01 * t}
    guess = {"height": fitting.Positive(1.5)}
    short = ml.fit(still, guess, Photometry(t + given["light_time"], seen, 0.02, shown, **given), loss=loss, **FREE)
    both = guess | {"zeros": fitting.Free([15.0, 17.0])}  # a fit keeps its guess, so that one must not change
    long = ml.fit(still, both, fitting.Observed(t, seen, 0.02, joint), loss=loss, **FREE)
    np.testing.assert_allclose(short.values["height"], long.values["height"], rtol=1e-7)
    np.testing.assert_allclose(short.covariance[0, 0], long.covariance[0, 0], rtol=1e-5 if loss is None else 1e-2)
    np.testing.assert_allclose(short.zero_points()[0], long.values["zeros"], rtol=1e-7)
    assert short.dof == long.dof


@pytest.mark.sample(0)
def test_the_closed_form_fits_times_before_the_initial_state():
    t = np.arange(-5.0, 6.0)
    body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidState([0.5, 0.6, 2.0], ZERO)
    seen = ml.free_motion(body, start, t).states.attitude
    guess = {"momentum": fitting.Free([0.45, 0.65, 2.1])}

    def free(values):
        return body, None, ml.RigidState(values["momentum"], ZERO)

    found = ml.fit(free, guess, fitting.Attitudes(t, seen, 1e-3), method="free_motion")
    np.testing.assert_allclose(found.values["momentum"], start.momentum, rtol=1e-8)


@pytest.mark.parametrize(
    ("parameter", "limits"),
    [
        (fitting.Free([2.0, -1.0]), 0.1), (fitting.Positive(2.0), (1.0, 4.0)), (fitting.Periodic(0.0, 2.0), "all"),
        (fitting.Moments([0.5, 0.9, 1.0], scale="fixed"), 0.3), (fitting.Moments([0.5, 0.9, 1.0]), 0.3),
        (fitting.UnitVector(NORTH), "all"), (fitting.UnitVector(NORTH), 0.2), (fitting.UnitQuaternion(ZERO), "all"),
        (fitting.UnitQuaternion(ZERO), 0.5), (fitting.InertiaTensor(np.diag([0.5, 0.9, 1.0]), scale="fixed"), 0.2),
    ],
)  # fmt: skip
def test_starts_are_values_in_their_range(parameter, limits):
    found = parameter.draw("x", np.random.default_rng(0), 200, limits)
    anchored = Layout({"x": parameter}).placed({"x": jnp.asarray(found[0])}).guess["x"]
    np.testing.assert_allclose(anchored.value(anchored.vector()), found[0], rtol=1e-12, atol=1e-12)
    if isinstance(parameter, fitting.Positive):
        assert 1 <= found.min() < 1.1 < 3.9 < found.max() <= 4
    elif isinstance(parameter, fitting.UnitVector):
        angles = np.arccos(found @ np.array(NORTH))
        share = 0.5 if limits == "all" else 0.25  # of the area within half the angle
        assert np.mean(angles < (np.pi if limits == "all" else 0.2) / 2) == pytest.approx(share, abs=0.1)
    elif isinstance(parameter, fitting.UnitQuaternion):
        assert limits == "all" or np.all(2 * np.arccos(found[:, 0]) < 0.5)
    if found.shape[1:] in ((3,), (4,)) and not isinstance(parameter, fitting.Moments):
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    elif isinstance(parameter, fitting.Moments) and parameter.scale == "fixed":
        np.testing.assert_allclose(found.sum(axis=1), 2.4)


BAD = [
    ({"ranges": {"period": 0.3}}, "ranges must name parameters of the guess .frequency, height"),
    ({"ranges": {"height": "all"}}, 'Only UnitVector, UnitQuaternion and Periodic allow "all"'),
    ({"ranges": {"height": (2.0, 1.0)}}, "range of height must be"),
    ({"ranges": {"height": (-2.0, -1.0)}}, "must hold possible values of Positive"),
    ({"loss": "square"}, "loss must be None"),
    ({"method": "RK4"}, "dt must be a positive finite number, got None"),
    ({"segments": 3}, 'segments must be 1 for "free_motion"'),
]


def test_what_is_wrong_is_said():
    for changes, message in BAD:
        with pytest.raises(ValueError, match=message):
            ml.fit(still, FIRST, waves(), **{"method": "free_motion", **changes})
    t = np.arange(4.0)
    given = {"sun": NORTH, "observer": NORTH}
    for changes, message in (
        ({"night": [1, 2]}, r"night must have shape \(4,\)"),
        ({"sun": [1.0, 2.0, 3.0]}, "sun must be unit vectors"),
        ({"observer": np.ones((3, 3))}, r"observer must have shape \(3,\) or \(4, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            Photometry(t, t, 0.1, light, **(given | changes))
    with pytest.raises(ValueError, match="torque must be None"):
        ml.fit(lambda v: (still(v)[0], ml.torques.Damping(0.1), still(v)[2]), FIRST, waves(), method="free_motion")
