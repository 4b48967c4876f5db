"""Fits: parameters that stay physical, residuals and their derivatives, and estimates against what is known."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS, quick, tumbled, turn
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.estimate import complaint
from midlie_jax.fitting.instruments import Attitudes, Directions, Positions, Rates
from midlie_jax.fitting.parameters import Free, InertiaTensor, Layout, Moments, Positive, UnitQuaternion, UnitVector
from midlie_jax.fitting.problem import Data, jacobian_of

METHOD = "RK4"  # compiles in a fifth of the time of the others; nothing here depends on the method


# A forced motion in which every parameter can be determined.
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


def measured():
    """What perfect instruments show of the true motion, by SciPy's rotations; each misses one value."""
    rng, n, states = np.random.default_rng(0), len(TIMES), true_states().states
    rotations = Rotation.from_quat(np.asarray(states.attitude), scalar_first=True)
    rates = np.asarray(states.momentum) / np.asarray(TRUTH["moments"]) + np.asarray(TRUTH["bias"])
    attitudes = rotations.as_quat(scalar_first=True) * rng.choice([-1, 1], (n, 1))
    directions = rotations.inv().apply(SUN) * rng.uniform(0.5, 2.0, (n, 1))
    positions = np.stack([rotations.apply(marker) for marker in MARKERS], axis=1) + np.array([1.0, 2.0, 3.0])
    rates[3, 1], attitudes[5, 2], directions[2, 0], positions[4, 1, 2] = np.nan, np.nan, np.nan, np.nan
    return (
        Rates(TIMES, rates, 1.0, bias="bias"),
        Attitudes(TIMES, attitudes, 1.0),
        Directions(TIMES, directions, 1.0, reference=SUN),
        Positions(TIMES, positions, 1.0, markers=MARKERS, origin=[1.0, 2.0, 3.0]),
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
    plan = fitting.prepare(top, guess(), measured(), method=METHOD, dt=DT, segments=2)
    problem, data = plan.problem, Data(Layout(guess()), measured())
    vector = data.layout.start()
    data = quick(problem.anchored)(data, vector)
    vector = jnp.concatenate([vector, 0.01 * jnp.arange(1.0, 7.0)])
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


# ---- parameters ----

TENSOR = np.array([[3.0, 0.2, -0.1], [0.2, 2.5, 0.3], [-0.1, 0.3, 1.8]])
PARAMETERS = {
    "moments": Moments([1.0, 2.0, 2.5]),
    "tensor up to a factor": InertiaTensor(TENSOR, scale="fixed"),
    "quaternion": UnitQuaternion(turn(0.4, -1.0, 0.3)),
    "ratios": Moments([1.0, 2.0, 2.5], scale="fixed"),
    "tensor": InertiaTensor(TENSOR),
    "positive": Positive([0.3, 20.0]),
    "free": Free([[0.5, -2.0], [0.0, 7.0]]),
    "direction": UnitVector([0.6, 0.0, -0.8]),
}


def of_a_body(tensor):
    """Whether a tensor is the inertia of masses: the second moments are positive definite."""
    return np.all(np.linalg.eigvalsh(np.trace(tensor) / 2 * np.eye(3) - tensor) > 0)


PHYSICAL = {
    Moments: lambda value: of_a_body(np.diag(value)),
    InertiaTensor: of_a_body,
    Positive: lambda value: np.all(value > 0),
    Free: lambda value: np.all(np.isfinite(value)),
    UnitVector: lambda value: abs(np.linalg.norm(value) - 1) < 1e-12,
    UnitQuaternion: lambda value: abs(np.linalg.norm(value) - 1) < 1e-12,
}


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", PARAMETERS)
def test_a_parameter_is_one_to_one_onto_physical_values(name):
    parameter = PARAMETERS[name]
    np.testing.assert_allclose(parameter.value(parameter.vector()), parameter.initial, rtol=1e-13, atol=1e-14)
    assert len(parameter.unconstrained_labels()) == parameter.vector().size
    assert len(parameter.labels()) == parameter.coordinates(parameter.initial).size
    vectors = np.random.default_rng(1).uniform(-1.7, 1.7, (20, *parameter.vector().shape))
    for vector, value in zip(vectors, quick(jax.vmap(parameter.value))(jnp.asarray(vectors)), strict=True):
        assert PHYSICAL[type(parameter)](np.asarray(value))
        if getattr(parameter, "scale", "") == "fixed":
            np.testing.assert_allclose(*(np.sum(x if x.ndim == 1 else np.diag(x)) for x in (value, parameter.initial)))
        if isinstance(parameter, UnitVector):  # the angle from the guess is the length of the vector
            cosine = np.dot(np.asarray(value), np.asarray(parameter.initial))
            np.testing.assert_allclose(cosine, np.cos(np.linalg.norm(vector)), rtol=0, atol=1e-12)
            continue
        again = eqx.tree_at(lambda p: p.initial, parameter, value).vector()
        found = parameter.coordinates(value) if isinstance(parameter, UnitQuaternion) else again
        np.testing.assert_allclose(found, vector, rtol=1e-11, atol=1e-11)
    # Far from the guess, moments that cannot be told from those of a flat body may fail the inequality by rounding.
    if isinstance(parameter, (Moments, InertiaTensor)):
        for value in np.asarray(quick(jax.vmap(parameter.value))(jnp.asarray(7 * vectors))):
            moments = value if value.ndim == 1 else np.linalg.eigvalsh(value)
            assert np.all(moments > 0)
            assert 2 * moments.max() <= moments.sum() * (1 + 1e-14)


def test_a_direction_changes_at_first_by_the_angle_and_perpendicular_to_the_guess():
    """At the guess, where an optimiser starts, and a little beside it, where the series end."""
    direction, slope = PARAMETERS["direction"], quick(jax.jacfwd(PARAMETERS["direction"].value))
    for at in (np.zeros(2), np.array([0.99e-4, 0.0]), np.array([1.01e-4, 0.0])):
        slopes = np.asarray(slope(jnp.asarray(at)))
        np.testing.assert_allclose(slopes.T @ slopes, np.eye(2), rtol=0, atol=1e-8)
        np.testing.assert_allclose(np.asarray(direction.initial) @ slopes, [-np.sin(at[0]), 0], rtol=0, atol=1e-9)
    assert direction.unconstrained_labels() == ["[1]", "[0]"]


# ---- fits that are hard or at a limit: near the separatrix, float32, flat bodies, tiny sigmas ----

HALVES = np.arange(0.0, 12.1, 0.5)


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

    wanted = [(1, 0)] * 2 + [(0, 1)] * 2 + [(1, 1)] * 4
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


MOMENTS, RATE = np.array([1.0, 2.0, 2.5]), np.array([0.5, 0.3, 0.4])


def fitted(moments, sigma, noise=0.0, dtype="float64"):
    """From a guess that is 5 % off, as the fit in float32 and float64 or of a flat body."""
    rates, _ = tumbled(moments, RATE, HALVES)
    rates = rates + noise * np.random.default_rng(0).standard_normal(rates.shape)
    off = moments * [1.05, 1.0, 0.94]
    guess = {
        "moments": Moments(jnp.asarray(off * moments.sum() / off.sum(), dtype), scale="fixed"),
        "rate": Free(jnp.asarray(RATE * [1.02, 0.98, 1.02], dtype)),
    }
    data = Rates(jnp.asarray(HALVES, dtype), jnp.asarray(rates, dtype), sigma)
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
def test_limits_are_named_or_reached():
    """Sigmas below rounding do not keep the optimiser going. A flat body, I3 = I1 + I2, is named by the result."""
    result = fitted(MOMENTS, 1e-16)
    assert result.ok
    np.testing.assert_allclose(result.values["moments"] / MOMENTS, 1, rtol=0, atol=1e-6)  # the error of the step
    flat = np.array([1.0, 2.0, 3.0])
    result = fitted(flat, 1e-3)
    assert result.flat == ["moments"]
    assert "moments: the data hardly tell this body from a flat one" in str(result)
    np.testing.assert_allclose(result.values["moments"] / result.values["moments"][2], flat / 3, rtol=0, atol=1e-3)


# ---- what cannot be told ----

SHORT, FIELD = np.arange(0.0, 6.01, 0.25), np.array([0.6, 0.0, 0.8])


@pytest.mark.sample(0)
def test_an_attitude_that_cannot_be_told_is_named_with_what_can_be_fixed():
    def pointing(values):
        body = ml.RigidBody(MOMENTS)
        return body, None, ml.RigidState(body.momentum(values["rate"]), values["attitude"])

    guess = {"rate": Free(RATE), "attitude": UnitQuaternion(turn(0.5, -0.3, 0.8))}
    seen = tumbled(MOMENTS, RATE, SHORT, turn(0.5, -0.3, 0.8))[1].inv().apply(FIELD)
    with pytest.raises(ValueError, match=r"attitude.*cannot be told apart.*DirectionState whose direction is a Unit"):
        ml.fit(pointing, guess, Directions(SHORT, seen, 0.01, reference=FIELD), method=METHOD, dt=0.25)
    unseen = complaint([["attitude.x"], ["attitude.y"], ["attitude.z"]], Layout(guess).named())
    assert "attitude.x has no effect" in unseen
    assert unseen.count("Fix attitude: make it a known quaternion inside the model") == 1


@pytest.mark.sample(0)
def test_degrees_are_told_from_radians_beside_a_bias_that_is_not_known():
    """By how much the rates change, in which a bias does not count."""
    guess = {"moments": Moments(MOMENTS, scale="fixed"), "rate": Free(RATE), "drift": Free([0.0, 0.0, 0.0])}
    rates = tumbled(MOMENTS, RATE, SHORT)[0]
    with pytest.raises(ValueError, match=r"np\.deg2rad"):
        fitting.prepare(free, guess, Rates(SHORT, np.rad2deg(rates), 1.0, bias="drift"), dt=0.1)
    fitting.prepare(free, guess, Rates(SHORT, rates + 30.0, 1.0, bias="drift"), dt=0.1)
