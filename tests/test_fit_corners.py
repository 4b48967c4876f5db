"""Fits that are hard or at a limit: near the separatrix, full tensors, float32, flat bodies, tiny sigmas, biases."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, tumbled, turn
from scipy.spatial.transform import Rotation
from test_fit_parameters import TENSOR

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.estimate import complaint
from midlie_jax.fitting.instruments import Directions, Rates
from midlie_jax.fitting.parameters import Free, InertiaTensor, Layout, Moments, UnitQuaternion, UnitVector

METHOD = "RK4"  # compiles in a fifth of the time of the others; nothing here depends on the method
TIMES = np.arange(0.0, 12.1, 0.5)


def free(values):
    body = ml.RigidBody(values["moments"])
    return body, None, ml.MomentumState(body.momentum(values["rate"]))


@pytest.mark.sample(0)
def test_starts_five_percent_off_converge_near_the_separatrix():
    """Moments, rates, and both, off by 5 %, mapped over: with the guess the body turns over early or late."""
    moments, rate, sigma = np.array([1.0, 2.0, 2.6]), np.array([0.03, 1.0, 0.03]), 1e-3
    times = np.arange(0.0, 100.1, 0.5)
    rng = np.random.default_rng(3)
    clean, _ = tumbled(moments, rate, times)
    assert np.sum(np.diff(np.sign(clean[:, 1])) != 0) >= 4  # it turns over
    data = Rates(times, clean + sigma * rng.standard_normal(clean.shape), sigma)

    def off(wanted):
        return 1 + wanted * rng.choice([-0.05, 0.05], 3)

    wanted = [(1, 0)] * 4 + [(0, 1)] * 4 + [(1, 1)] * 4
    guesses = [
        {"moments": Moments(moments * off(first), scale="fixed"), "rate": Free(rate * off(second))}
        for first, second in wanted
    ]
    plan = fitting.prepare(free, guesses[0], data, method=METHOD, dt=0.125, segments=20)
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *guesses)
    found = quick(jax.vmap(lambda g: fitting.fit_arrays(plan, g, data)))(stacked)
    assert np.all(found.ok)
    ratios = np.asarray(found.values["moments"] / found.values["moments"][:, 2:])
    np.testing.assert_allclose(ratios, np.broadcast_to(moments / moments[2], ratios.shape), rtol=2e-3)
    np.testing.assert_allclose(found.rms, found.rms[0], rtol=1e-8)
    assert 0.9 < found.rms[0] < 1.1


@pytest.mark.sample(0)
def test_a_full_tensor_and_an_attitude_are_found_from_a_direction_that_changes():
    """A gyroscope and a sensor of a direction that moves in space; the tensor up to its factor."""
    attitude, rate = turn(0.5, -0.3, 0.8), np.array([0.5, 0.3, 0.4])

    def tumbling(values):
        body = ml.TensorBody(values["tensor"])
        return body, None, ml.RigidState(body.momentum(values["rate"]), values["attitude"])

    # The truth in the principal frame, in closed form, turned to the frame of the tensor by NumPy.
    moments, axes = np.linalg.eigh(TENSOR)
    axes = axes * np.linalg.det(axes)
    given = Rotation.from_quat(attitude, scalar_first=True)
    principal = (given * Rotation.from_matrix(axes)).as_quat(scalar_first=True)
    rates, turned = tumbled(moments, axes.T @ rate, TIMES, principal)
    rates, turned = rates @ axes.T, turned * Rotation.from_matrix(axes.T)
    reference = np.stack([np.cos(0.3 * TIMES), np.sin(0.3 * TIMES), 0.5 + 0 * TIMES], axis=1)

    guess = {
        "tensor": InertiaTensor(TENSOR * (1 + 0.05 * np.diag([1.0, -1.0, 0.5])), scale="fixed"),
        "rate": Free(rate * [1.02, 0.98, 1.02]),
        "attitude": UnitQuaternion(turn(0.45, -0.25, 0.75)),
    }
    data = [Rates(TIMES, rates, 1e-3), Directions(TIMES, turned.inv().apply(reference), 1e-3, reference=reference)]
    result = ml.fit(tumbling, guess, data, method=METHOD, dt=0.0625)
    assert result.ok
    assert result.rank == 11
    tensor = np.asarray(result.values["tensor"])
    np.testing.assert_allclose(tensor / np.trace(tensor), TENSOR / np.trace(TENSOR), rtol=0, atol=1e-7)
    np.testing.assert_allclose(result.values["rate"], rate, rtol=0, atol=1e-6)
    apart = ml.so3.multiply(ml.so3.conjugate(jnp.asarray(attitude)), result.values["attitude"])
    assert np.linalg.norm(ml.so3.log(apart)) < 1e-6


MOMENTS, RATE = np.array([1.0, 2.0, 2.5]), np.array([0.5, 0.3, 0.4])


def fitted(moments, sigma, noise=0.0, dtype="float64"):
    """From a guess that is 5 % off, as the fit in float32 and float64 or of a flat body."""
    rates, _ = tumbled(moments, RATE, TIMES)
    rates = rates + noise * np.random.default_rng(0).standard_normal(rates.shape)
    off = moments * [1.05, 1.0, 0.94]
    guess = {
        "moments": Moments(jnp.asarray(off * moments.sum() / off.sum(), dtype), scale="fixed"),
        "rate": Free(jnp.asarray(RATE * [1.02, 0.98, 1.02], dtype)),
    }
    data = Rates(jnp.asarray(TIMES, dtype), jnp.asarray(rates, dtype), sigma)
    return ml.fit(free, guess, data, method=METHOD, dt=0.125)


@pytest.mark.sample(0)
def test_a_fit_in_float32_is_that_in_float64():
    """To a tenth of a standard deviation; all that it returns is float32."""
    single, double = (fitted(MOMENTS, 1e-3, noise=1e-3, dtype=dtype) for dtype in ("float32", "float64"))
    assert single.ok
    assert double.ok
    floats = [leaf for leaf in jax.tree.leaves(single.estimate) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert {leaf.dtype.name for leaf in floats} == {"float32"}
    deviations = np.sqrt(np.diagonal(double.covariance))
    assert np.all(np.abs(single.coordinates - double.coordinates) < 0.1 * deviations)
    np.testing.assert_allclose(np.sqrt(np.diagonal(single.covariance)), deviations, rtol=0.01)
    assert not double.flat


@pytest.mark.sample(0)
def test_sigmas_below_what_rounding_leaves_do_not_keep_the_optimiser_going():
    result = fitted(MOMENTS, 1e-16)
    assert result.ok
    np.testing.assert_allclose(result.values["moments"] / MOMENTS, 1, rtol=0, atol=1e-6)  # the error of the step


@pytest.mark.sample(0)
def test_a_flat_body_is_a_limit_that_the_result_names():
    """I3 = I1 + I2: the moments come near, the fit may not converge, and the result says why."""
    flat = np.array([1.0, 2.0, 3.0])
    result = fitted(flat, 1e-3)
    assert result.flat == ["moments"]
    assert "moments: the data hardly tell this body from a flat one" in str(result)
    np.testing.assert_allclose(result.values["moments"] / result.values["moments"][2], flat / 3, rtol=0, atol=1e-3)


@pytest.mark.sample(0)
def test_multiple_shooting_from_a_direction_finds_the_weight():
    """Its segments start at increments of zero of momentum and direction."""
    times = jnp.linspace(0.05, 1.0, 20)

    def top(values):
        start = ml.DirectionState(jnp.array([0.3, 0.1, 2.0]), jnp.array([0.0, 0.6, 0.8]))
        return ml.RigidBody(jnp.array([2.0, 2.0, 1.0])), ml.torques.HeavyTop(values["weight"]), start

    path = ml.integrate(METHOD, *top({"weight": jnp.array(3.0)}), dt=0.05, steps=20)
    data = [Rates(times, np.asarray(path.states.momentum)[1:] / [2.0, 2.0, 1.0], 1e-3)]
    found = ml.fit(top, {"weight": Free(2.5)}, data, dt=0.05, method=METHOD, segments=2, absolute_sigma=True)
    assert found.ok
    assert float(found.values["weight"]) == pytest.approx(3.0, abs=1e-5)


# ---- what instruments add: biases, hard iron, clocks; and what a single direction cannot tell ----

LATE, SHORT = 0.037, np.arange(0.0, 6.01, 0.25)
IRON, STRENGTH, DRIFT = np.array([12.0, -5.0, 8.0]), 45.0, np.array([0.02, -0.01, 0.03])
FIELD = np.array([0.6, 0.0, 0.8])


@cache
def field_seen(times=tuple(SHORT - LATE)):
    """The field in the body frame, by the closed form; the magnetometer's clock is ahead by LATE."""
    return tumbled(MOMENTS, RATE, np.array(times), turn(0.5, -0.3, 0.8))[1].inv().apply(FIELD)


@cache
def rates_seen():
    return tumbled(MOMENTS, RATE, SHORT)[0] + DRIFT


def tumbling(values):
    body = ml.RigidBody(values["moments"])
    return body, None, ml.DirectionState(body.momentum(values["rate"]), values["field"])


@pytest.mark.sample(0)
def test_hard_iron_the_bias_of_a_gyroscope_and_a_late_clock_are_found_together():
    """The field is measured in its own unit and before the start, too: the first row is LATE earlier."""
    compass = STRENGTH * field_seen() + IRON
    guess = {
        "moments": Moments([1.05, 2.0, 2.45], scale="fixed"),
        "rate": Free(RATE + 0.02),
        "field": UnitVector(Rotation.from_rotvec([0.05, -0.04, 0.02]).apply(field_seen((0.0,))[0])),
        "drift": Free([0.0, 0.0, 0.0]),
        "iron": Free([0.0, 0.0, 0.0]),
        "late": Free(0.0),
    }
    up = [0.0, 0.0, 1.0]  # the direction that a DirectionState follows
    seen = Directions(SHORT, compass, 0.01, reference=up, bias="iron", clock="late")
    both = [Rates(SHORT, rates_seen(), 0.01, bias="drift"), seen]
    found = ml.fit(tumbling, guess, both, method=METHOD, dt=0.0625)
    assert found.ok
    np.testing.assert_allclose(found.values["late"], LATE, rtol=0, atol=1e-5)
    # A field's strength does not matter to its direction: the iron is found in the unit of the field.
    np.testing.assert_allclose(found.values["iron"], IRON, rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.values["drift"], DRIFT, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.values["field"], field_seen((0.0,))[0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.values["moments"], MOMENTS, rtol=0, atol=1e-4)
    assert len(found.names) == 3 + 3 + 3 + 3 + 3 + 1


@pytest.mark.sample(0)
def test_an_attitude_that_cannot_be_told_is_named_with_what_can_be_fixed():
    def pointing(values):
        body = ml.RigidBody(MOMENTS)
        return body, None, ml.RigidState(body.momentum(values["rate"]), values["attitude"])

    guess = {"rate": Free(RATE), "attitude": UnitQuaternion(turn(0.5, -0.3, 0.8))}
    one = Directions(SHORT, field_seen(), 0.01, reference=FIELD)
    with pytest.raises(ValueError, match=r"attitude.*cannot be told apart.*DirectionState whose direction is a Unit"):
        ml.fit(pointing, guess, one, method=METHOD, dt=0.25)
    unseen = complaint([["attitude.x"], ["attitude.y"], ["attitude.z"]], Layout(guess).named())
    assert "attitude.x has no effect" in unseen
    assert unseen.count("Fix attitude: make it a known quaternion inside the model") == 1


@pytest.mark.sample(0)
def test_degrees_are_told_from_radians_beside_a_bias_that_is_not_known():
    """By how much the rates change, in which a bias does not count."""
    guess = {"moments": Moments(MOMENTS, scale="fixed"), "rate": Free(RATE)}
    guess |= {"field": UnitVector(FIELD), "drift": Free([0.0, 0.0, 0.0])}
    degrees = Rates(SHORT, np.rad2deg(rates_seen()), 1.0, bias="drift")
    with pytest.raises(ValueError, match=r"np\.deg2rad"):
        fitting.prepare(tumbling, guess, degrees, dt=0.1)
    large = Rates(SHORT, rates_seen() + 30.0, 1.0, bias="drift")
    fitting.prepare(tumbling, guess, large, dt=0.1)
