"""Fits: parameters that stay physical, residuals and their derivatives, and estimates against what is known."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS, quick, turn
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.estimate import Spectrum, confounded
from midlie_jax.fitting.instruments import Attitudes, Directions, Positions, Rates
from midlie_jax.fitting.parameters import Free, Layout, Moments, Positive, UnitQuaternion
from midlie_jax.fitting.problem import Data, jacobian_of

METHOD = "RK4"  # compiles in a fifth of the time of the others; nothing here depends on the method


# One forced motion in which every parameter can be determined.
TRUTH = {
    "moments": jnp.array([1.0, 2.0, 2.5]),
    "weight": jnp.array(2.0),
    "rate": jnp.array([1.0, 0.4, -0.5]),
    "attitude": jnp.asarray(turn(0.5, -0.3, 0.8)),
    "bias": jnp.array([0.02, -0.01, 0.03]),
}
SUN = np.array([0.6, 0.0, 0.8])
MARKERS = np.array([[0.3, 0.1, -0.2], [-0.1, 0.4, 0.2]])
TIMES = np.array([0.03, 0.11, 0.11, 0.27, 0.4, 0.53, 0.68, 0.8, 0.99, 1.13, 1.2])  # between the steps, and on them
DT = 0.1


def top(values):
    body = ml.RigidBody(values["moments"])
    start = ml.RigidState(body.momentum(values["rate"]), values["attitude"])
    return body, ml.torques.HeavyTop(values["weight"], AXIS), start


def guess(**changes):
    start = {
        "moments": Moments([1.1, 2.1, 2.4]),
        "weight": Positive(1.8),
        "rate": Free([0.95, 0.45, -0.55]),
        "attitude": UnitQuaternion(turn(0.45, -0.25, 0.75)),
        "bias": Free([0.0, 0.0, 0.0]),
    }
    return start | changes


@cache
def true_states():
    return quick(lambda v: ml.fitting.states_at(METHOD, *top(v), TIMES, dt=DT))(TRUTH)


def measured(noise=0.0, seed=0):
    """What perfect or noisy instruments show of the true motion, by SciPy's rotations."""
    rng = np.random.default_rng(seed)
    states = true_states().states
    rotations = Rotation.from_quat(np.asarray(states.attitude), scalar_first=True)
    n = len(TIMES)
    rates = np.asarray(states.momentum) / np.asarray(TRUTH["moments"]) + np.asarray(TRUTH["bias"])
    turned = rotations * Rotation.from_rotvec(noise * rng.standard_normal((n, 3)))
    attitudes = turned.as_quat(scalar_first=True) * rng.choice([-1, 1], (n, 1))
    directions = rotations.inv().apply(SUN) * rng.uniform(0.5, 2.0, (n, 1))
    positions = np.stack([rotations.apply(marker) for marker in MARKERS], axis=1) + np.array([1.0, 2.0, 3.0])
    rates = rates + noise * rng.standard_normal(rates.shape)
    positions = positions + noise * rng.standard_normal(positions.shape)
    rates[3, 1], attitudes[5, 2], directions[2, 0], positions[4, 1, 2] = np.nan, np.nan, np.nan, np.nan
    sigma = noise or 1.0
    return (
        Rates(TIMES, rates, sigma, bias="bias"),
        Attitudes(TIMES, attitudes, sigma),
        Directions(TIMES, directions, sigma, reference=SUN),
        Positions(TIMES, positions, sigma, markers=MARKERS, origin=[1.0, 2.0, 3.0]),
    )


@pytest.mark.sample(0)
def test_states_between_steps_are_those_of_the_motion_and_have_the_order_of_the_method():
    """A free body by JACOBI: the flight is exact, so each time has the digits of the closed form."""
    body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidState([1.0, 0.8, -1.3], turn(0.5, -0.3, 0.8))
    found = quick(lambda s: ml.fitting.states_at("JACOBI[EA]", body, None, s, TIMES, dt=DT))(start)
    truth = ml.free_motion(body, start, TIMES)
    assert found.ok
    np.testing.assert_allclose(found.states.momentum, truth.states.momentum, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.states.attitude, truth.states.attitude, rtol=0, atol=1e-13)
    runs = [quick(lambda v, h=h: ml.fitting.states_at(METHOD, *top(v), TIMES, dt=h))(TRUTH) for h in (0.08, 0.04, 2e-3)]
    coarse, fine = (np.abs(run.states.momentum - runs[2].states.momentum).max() for run in runs[:2])
    assert 12 < coarse / fine < 20


@pytest.mark.sample(0)
def test_residuals_are_zero_at_the_truth():
    """Whatever the sign of a quaternion and the length of a direction; missing values count zero."""
    for measurement in measured():
        assert 1 <= np.sum(~np.asarray(measurement.present)) <= 4
        found = measurement.residuals(TRUTH, top(TRUTH)[0], true_states().states)
        np.testing.assert_allclose(found, 0, atol=1e-13)


def test_residuals_are_angles_and_lengths_over_sigma():
    body, _, start = top(TRUTH)
    states = jax.tree.map(lambda x: jnp.stack([x, x]), start)
    attitude = Rotation.from_quat(np.asarray(start.attitude), scalar_first=True)
    times, angle = [0.0, 1.0], np.array([0.4, -0.2, 0.9])
    turned = (attitude * Rotation.from_rotvec(angle)).as_quat(scalar_first=True)
    found = Attitudes(times, np.stack([turned, -turned]), 0.5).residuals(TRUTH, body, states)
    np.testing.assert_allclose(found.reshape(2, 3), np.stack([-angle, -angle]) / 0.5, rtol=1e-13)
    for size in (1e-8, 1e-4, 0.3, 2.0):
        # Turned by `size` about an axis perpendicular to the direction.
        seen = attitude.inv().apply(SUN)
        axis = np.cross(seen, [1.0, 0.0, 0.0])
        moved = Rotation.from_rotvec(size * axis / np.linalg.norm(axis)).apply(seen)
        residuals = Directions(times, np.stack([moved, 3 * moved]), 0.5, reference=SUN).residuals(TRUTH, body, states)
        np.testing.assert_allclose(np.linalg.norm(residuals.reshape(2, 2), axis=1), size / 0.5, rtol=1e-7)
    place = attitude.apply(MARKERS[0]) + np.array([0.3, 0.0, 0.0])
    found = Positions(times, np.stack([place, place]), 0.1, markers=MARKERS[0]).residuals(TRUTH, body, states)
    np.testing.assert_allclose(found.reshape(2, 3), [[-3, 0, 0]] * 2, atol=1e-13)
    rates = np.asarray(TRUTH["rate"]) + np.array([0.0, 0.2, 0.0])
    found = Rates(times, np.stack([rates, rates]), [0.1, 0.4, 0.1]).residuals(TRUTH, body, states)
    np.testing.assert_allclose(found.reshape(2, 3), [[0, -0.5, 0]] * 2, atol=1e-13)


@pytest.mark.sample(0)
def test_the_jacobian_equals_differences():
    """With respect to every unknown: the parameters, and with several segments the states at their starts."""
    plan = fitting.prepare(top, guess(), measured(), method=METHOD, dt=DT, segments=3)
    problem, data = plan.problem, Data(Layout(guess()), measured())
    vector = data.layout.start()
    data = quick(problem.anchored)(data, vector)
    vector = jnp.concatenate([vector, 0.01 * jnp.arange(1.0, 13.0)])
    _, ok, jacobian = quick(lambda v: jacobian_of(v, data, problem))(vector)
    assert ok
    sizes, factors = jnp.array([2.0, 1.0, -1.0, -2.0]) * 1e-3, jnp.array([-1.0, 8.0, -8.0, 1.0]) / 12e-3
    moved = vector[None, None] + sizes[:, None, None] * jnp.eye(vector.size)[None]
    values = quick(jax.vmap(jax.vmap(lambda v: problem.residuals(v, data)[0])))(moved)
    differences = jnp.einsum("s,sur->ru", factors, values)
    np.testing.assert_allclose(jacobian, differences, rtol=0, atol=1e-7 * np.abs(jacobian).max())


@pytest.mark.sample(0)
def test_all_parameters_are_found_from_all_instruments():
    """Without noise: the moments with their scale, for the torque is known up to the weight and sets no scale alone."""
    known = guess(moments=Moments([1.1, 2.1, 2.4], scale="fixed"))
    del known["weight"]
    known_truth = TRUTH["moments"] * 5.6 / 5.5

    def with_weight(values):
        return top(values | {"weight": TRUTH["weight"] * 5.6 / 5.5})

    result = ml.fit(with_weight, known, measured(), method=METHOD, dt=DT)
    assert result.ok
    assert not result.confounded
    assert result.rank == 11
    np.testing.assert_allclose(result.values["moments"], known_truth, rtol=1e-7)
    for name in ("rate", "bias"):
        np.testing.assert_allclose(result.values[name], TRUTH[name], rtol=0, atol=1e-7)
    apart = ml.so3.multiply(ml.so3.conjugate(TRUTH["attitude"]), result.values["attitude"])
    assert np.linalg.norm(ml.so3.log(apart)) < 1e-7


def test_groups_do_not_depend_on_the_vectors_that_span_the_null_space():
    """a + b, and c + d, and e without any effect."""
    columns = np.random.default_rng(0).standard_normal((20, 3))
    jacobian = np.stack(
        [columns[:, 0], 2 * columns[:, 0], columns[:, 1], -columns[:, 1], 0 * columns[:, 2], columns[:, 2]]
    )
    spectrum = Spectrum.of(jnp.asarray(jacobian.T))
    assert spectrum.rank == 3
    assert confounded(spectrum, list("abcdef")) == [["a", "b"], ["c", "d"], ["e"]]
    # a, b and c by one factor, though a changes the residuals by a hundredth of what b and c do.
    x, y, _ = columns.T
    spectrum = Spectrum.of(jnp.asarray(np.stack([0.01 * x, y - 0.01 * x, -y], axis=1)))
    assert confounded(spectrum, list("abc")) == [["a", "b", "c"]]
    assert confounded(spectrum, list("abc"), np.array([100.0, 1.0, 1.0])) == [["b", "c"]]


@pytest.mark.sample(0)
def test_float32_times_between_steps_are_told_from_those_on_the_grid_in_long_runs():
    """After 6000 steps a float32 still has the time to a thousandth of a step: half a step is not rounding."""
    body, rate, dt = ml.RigidBody(jnp.ones(3, "float32")), jnp.array([0.0, 0.0, 1.0], "float32"), 0.01
    start = ml.RigidState(rate, jnp.array([1.0, 0.0, 0.0, 0.0], "float32"))
    times = [10.0, 60.0, 60.005]
    found = fitting.states_at(METHOD, body, None, start, times, dt=dt)
    angles = 2 * np.arctan2(found.states.attitude[:, 3], found.states.attitude[:, 0])
    assert found.ok
    np.testing.assert_allclose(np.cos(angles - np.array(times)), 1, rtol=0, atol=1e-7)
