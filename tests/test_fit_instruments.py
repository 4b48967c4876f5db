"""What instruments add to what they measure: biases, hard iron, clocks; and what a single direction cannot tell."""

from functools import cache

import numpy as np
import pytest
from cases import tumbled, turn
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.estimate import complaint
from midlie_jax.fitting.parameters import Layout

METHOD = "RK4"  # compiles in a fifth of the time of the others; nothing here depends on the method
MOMENTS, RATE, LATE = np.array([1.0, 2.0, 2.5]), np.array([0.5, 0.3, 0.4]), 0.037
IRON, STRENGTH, DRIFT = np.array([12.0, -5.0, 8.0]), 45.0, np.array([0.02, -0.01, 0.03])
FIELD = np.array([0.6, 0.0, 0.8])
TIMES = np.arange(0.0, 6.01, 0.25)


@cache
def field_seen(times=tuple(TIMES - LATE)):
    """The field in the body frame, by the closed form; the magnetometer's clock is ahead by LATE."""
    return tumbled(MOMENTS, RATE, np.array(times), turn(0.5, -0.3, 0.8))[1].inv().apply(FIELD)


@cache
def rates_seen():
    return tumbled(MOMENTS, RATE, TIMES)[0] + DRIFT


def tumbling(values):
    body = ml.RigidBody(values["moments"])
    return body, None, ml.DirectionState(body.momentum(values["rate"]), values["field"])


@pytest.mark.sample(0)
def test_hard_iron_the_bias_of_a_gyroscope_and_a_late_clock_are_found_together():
    """The field is measured in its own unit and before the start, too: the first row is LATE earlier."""
    compass = STRENGTH * field_seen() + IRON
    guess = {
        "moments": fitting.Moments([1.05, 2.0, 2.45], scale="fixed"),
        "rate": fitting.Free(RATE + 0.02),
        "field": fitting.UnitVector(Rotation.from_rotvec([0.05, -0.04, 0.02]).apply(field_seen((0.0,))[0])),
        "drift": fitting.Free([0.0, 0.0, 0.0]),
        "iron": fitting.Free([0.0, 0.0, 0.0]),
        "late": fitting.Free(0.0),
    }
    up = [0.0, 0.0, 1.0]  # the direction that a DirectionState follows
    seen = fitting.Directions(TIMES, compass, 0.01, reference=up, bias="iron", clock="late")
    both = [fitting.Rates(TIMES, rates_seen(), 0.01, bias="drift"), seen]
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

    guess = {"rate": fitting.Free(RATE), "attitude": fitting.UnitQuaternion(turn(0.5, -0.3, 0.8))}
    one = fitting.Directions(TIMES, field_seen(), 0.01, reference=FIELD)
    with pytest.raises(ValueError, match=r"attitude.*cannot be told apart.*DirectionState whose direction is a Unit"):
        ml.fit(pointing, guess, one, method=METHOD, dt=0.25)
    unseen = complaint([["attitude.x"], ["attitude.y"], ["attitude.z"]], Layout(guess).named())
    assert "attitude.x has no effect" in unseen
    assert unseen.count("Fix attitude: make it a known quaternion inside the model") == 1


@pytest.mark.sample(0)
def test_degrees_are_told_from_radians_beside_a_bias_that_is_not_known():
    """By how much the rates change, in which a bias does not count."""
    guess = {"moments": fitting.Moments(MOMENTS, scale="fixed"), "rate": fitting.Free(RATE)}
    guess |= {"field": fitting.UnitVector(FIELD), "drift": fitting.Free([0.0, 0.0, 0.0])}
    degrees = fitting.Rates(TIMES, np.rad2deg(rates_seen()), 1.0, bias="drift")
    with pytest.raises(ValueError, match=r"np\.deg2rad"):
        fitting.prepare(tumbling, guess, degrees, dt=0.1)
    large = fitting.Rates(TIMES, rates_seen() + 30.0, 1.0, bias="drift")
    fitting.prepare(tumbling, guess, large, dt=0.1)
