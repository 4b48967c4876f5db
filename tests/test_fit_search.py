"""Searches over ranges, robust losses and photometry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.asteroids import EllipsoidBrightness, Photometry
from midlie_jax.fitting.loss import as_loss
from midlie_jax.fitting.parameters import Layout

ZERO, NORTH = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0]


def light(values, sun, observer):
    return EllipsoidBrightness(jnp.append(values["axes"], 0.85), sun, observer)


def still(values):
    del values
    return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.RigidState([0.0, 0.0, 1.0], ZERO)


def wave(t, state, body, values):
    return values["height"] * jnp.sin(values["frequency"] * t + values["phase"])


def waves():
    """16 periods with 10 % noise: there is a minimum for each miscounted period."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 50, 200))
    return fitting.Observed(t, np.sin(2 * t + 0.4) + 0.1 * rng.standard_normal(200), 0.1, wave)


def of_wave(x, t, seen):
    """The residuals of `waves`."""
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


@pytest.mark.parametrize("loss", [fitting.Huber(1.5), fitting.Cauchy(2.0)])
def test_losses_have_their_inverse_and_derivative(loss):
    r = jnp.array([-30.0, -1.0, 0.0, 1e-9, 0.3, 4.0])
    np.testing.assert_allclose(loss.residuals(loss.counted(r)), r, rtol=1e-9, atol=1e-12)
    slopes = jax.vmap(jax.grad(lambda x: loss.counted(x) ** 2))(r)
    np.testing.assert_allclose(slopes, 2 * loss.weight(r) * r, rtol=1e-9, atol=1e-12)
    normal = jnp.asarray(np.random.default_rng(0).standard_normal(100_000))
    assert jnp.mean(loss.judged(normal) ** 2) == pytest.approx(1, abs=0.02)


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


WRONG = [
    ({"ranges": {"period": 0.3}}, "ranges must name parameters of the guess .frequency, height"),
    ({"ranges": {"height": "all"}}, 'Only UnitVector, UnitQuaternion and Periodic allow "all"'),
    ({"ranges": {"height": (2.0, 1.0)}}, "range of height must be"),
    ({"ranges": {"height": (-2.0, -1.0)}}, "must hold possible values of Positive"),
    ({"loss": "square"}, "loss must be None"),
    ({"method": "RK4"}, "dt must be a positive finite number, got None"),
    ({"segments": 3}, 'segments must be 1 for "free_motion"'),
]


def test_what_is_wrong_is_said():
    for changes, message in WRONG:
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
