"""Attitudes in another convention are named where there are rates, and right ones never are."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import LEVEL, tumbled
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.checks import check_conventions
from midlie_jax.fitting.instruments import Attitudes, Rates

CONJUGATED = np.array([1.0, -1, -1, -1])
WRONG = {
    "conjugated": lambda q: q * CONJUGATED,
    "scalar-last": lambda q: q[:, [1, 2, 3, 0]],
    "conjugated and scalar-last": lambda q: (q * CONJUGATED)[:, [1, 2, 3, 0]],
}
N, FINE = 60, 1200


def motion(rng):
    """Times, attitudes, rates and the usual speed of a free body with random moments, by many small rotations."""
    a, b = rng.uniform(0.5, 1.0, 2)
    moments = np.array([a, b, rng.uniform(abs(a - b) + 0.02, a + b - 0.02)])
    momentum = rng.standard_normal(3) * moments * 10.0 ** rng.uniform(-3, 1)
    speed = np.linalg.norm(momentum / moments)
    h = rng.uniform(0.01, 2.0) * N / FINE / speed  # radians between two rows
    turned, rates, frames = Rotation.random(random_state=int(rng.integers(1e9))), [], []
    for _ in range(FINE):
        half = momentum + h / 2 * np.cross(momentum, momentum / moments)
        frames.append(turned.as_quat(scalar_first=True))
        rates.append(momentum / moments)
        turned = turned * Rotation.from_rotvec(h * half / moments)
        momentum = momentum + h * np.cross(half, half / moments)
    every = FINE // N
    return h * every * np.arange(N), np.array(frames)[::every], np.array(rates)[::every], speed


def message(measurements, values):
    try:
        check_conventions(measurements, values)
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.sample(5)
@pytest.mark.parametrize("seed", range(20))
def test_right_attitudes_are_never_named_and_wrong_ones_never_by_another_name(seed):
    """With noise of any size, missing rows, outliers, sparse rows, signs that jump and an unknown bias."""
    rng = np.random.default_rng(seed)
    times, attitudes, rates, speed = motion(rng)
    noise = Rotation.from_rotvec(10.0 ** rng.uniform(-6, 0) * rng.standard_normal((N, 3)))
    attitudes = (Rotation.from_quat(attitudes, scalar_first=True) * noise).as_quat(scalar_first=True)
    attitudes = attitudes * rng.choice([-1, 1], (N, 1))
    attitudes[rng.random(N) < 0.05] = [0.5, -0.5, 0.5, 0.5]
    attitudes[rng.random(N) < rng.choice([0, 0.5])] = np.nan
    rates = rates + 10.0 ** rng.uniform(-6, 0.5) * speed * rng.standard_normal((N, 3))
    bias = "bias" if seed % 3 == 0 else None
    rates = rates + (speed * rng.standard_normal(3) if bias else 0)
    rates[rng.random(N) < rng.choice([0, 0.3])] = np.nan
    kept = np.sort(rng.permutation(N)[: rng.choice([12, 30, N])])
    gyroscope, values = Rates(times[kept], rates[kept], 1.0, bias=bias), {"bias": jnp.zeros(3)}
    check_conventions([Attitudes(times, attitudes, 1.0), gyroscope], values)
    for name, read in WRONG.items():
        said = message([Attitudes(times, read(attitudes), 1.0), gyroscope], values)
        assert not said or f"these are {name}, " in said


@pytest.mark.parametrize("body", [None, 1])
@pytest.mark.parametrize("name", WRONG)
def test_another_convention_is_named_with_its_cure(name, body):
    """The cure is run as the message writes it; of several bodies, each is tested by its own rates."""
    rng = np.random.default_rng(3)
    times, attitudes, rates, _ = motion(rng)
    dense = np.stack([np.interp(np.linspace(0, times[-1], 300), times, x) for x in rates.T], axis=1)
    gyroscope = Rates(np.linspace(0, times[-1], 300), dense, 1.0)

    def check(values):
        both = [Attitudes(times, values, 1.0), gyroscope]
        other = [Rates(times, -rates, 1.0)]
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
    found = ml.fit(model, guess, Attitudes(times, values, 1e-3), method="RK4", dt=0.25)
    assert not found.ok
    assert found.rms > 100
    assert "quaternions are (w, x, y, z) from body to space" in found.message
