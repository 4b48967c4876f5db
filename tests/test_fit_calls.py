"""Calls of `fit`: sigmas, starts, other solvers, progress, what is refused, and how a fit says that it failed."""

import re
import sys
from functools import partial
from itertools import cycle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS, quick, torque_classes, turn
from scipy.spatial.transform import Rotation
from test_fitting import MARKERS, SUN, TENSOR, TIMES, TRUTH, top, true_states

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

    def rooted(values):
        return still({"rate": jnp.sqrt(values["square"] - 0.9) * jnp.ones(3)})

    data = Rates(np.arange(5.0), np.sqrt(0.2) * np.ones((5, 3)), 1e-3)
    many = try_fit(data, rooted, {"square": Free([1.1])}, solver=diverging, starts=4)
    assert many.ok
    np.testing.assert_allclose(many.coordinates, 1.1)


def speed(t, state, body, values):
    return jnp.sqrt(state.momentum @ state.momentum)


TIMED, SHOWN = np.arange(5.0), np.full(5, 0.4)


def shown(**changes):
    good = {"times": TIMED, "values": SHOWN, "sigma": 0.1, "function": speed}
    return try_fit(fitting.Observed(**good | changes), guess=GUESS)


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
    (lambda: try_fit(spin(values=np.rad2deg(spin().values)), guess=GUESS), "np.deg2rad"),
    (lambda: try_fit(spin(times=1e9 * TIMED)), "after 4e\\+09 steps"),
    (lambda: try_fit(spin(), solver=lambda x: x), "solver must be a function of"),
    (lambda: try_fit(spin(), first_span=np.nan), "first_span must be a positive finite"),
    (lambda: try_fit(spin(), solver=lambda *x: x, first_span=1.0), "first_span must be None"),
    (lambda: fitting.states_at("RK4", *still({"rate": jnp.ones(3)}), [1.0, 0.0], dt=1.0), "ascend"),
    (lambda: shown(function=3.0), "function must be a function of"),
    (lambda: shown(function=lambda t, state: 0.0), r"must be a function of \(t, state, body, values\)"),
    (lambda: shown(function=lambda t, s, b, v: s.momentum), r"return shape \(\), .*, got \(3,\)"),
    (lambda: shown(values=SHOWN[:, None]), r"return shape \(1,\).*, got \(\)"),
    (lambda: shown(function=lambda *x: speed(*x).astype("float32")), "return float64, .*, got float32"),
    (lambda: shown(function=lambda t, s, b, v: v["fast"]), "of the guess, got 'fast', which is not"),
    (lambda: shown(values=SHOWN[:4]), "one row for each time"),
    (lambda: shown(clock="late"), r"'late', which is not in the guess; add it: .*Free\(0.0\)"),
]


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


# ---- what a function of the user or an accelerometer sees, of one body, of two, and of one that travels ----

LEVER, GRAVITY = np.array([0.2, -0.1, 0.3]), np.array([0.0, 0.0, -9.81])
HEAVY = ml.torques.HeavyTop(TRUTH["weight"], AXIS)


def gyroscope(t, state, body, values):
    return body.velocity(state.momentum) + values["bias"]


def accelerometer(t, state, body, values):
    """Off the centre: by Euler's equations with the torque that the model has, too."""
    rates = body.velocity(state.momentum)
    change = body.velocity(jnp.cross(state.momentum, rates) + HEAVY(t, state))
    turning = jnp.cross(change, jnp.asarray(LEVER)) + jnp.cross(rates, jnp.cross(rates, jnp.asarray(LEVER)))
    return turning - ml.so3.rotate(ml.so3.conjugate(state.attitude), jnp.asarray(GRAVITY)) + values["bias"]


BUILT_IN = {
    gyroscope: partial(fitting.Rates, bias="bias"),
    accelerometer: partial(fitting.Accelerations, lever=LEVER, gravity=GRAVITY, bias="bias"),
}


@pytest.mark.parametrize("function", BUILT_IN)
def test_an_instrument_written_with_it_has_the_same_residuals(function):
    """With noise of one sigma; missing values count zero in both."""
    seen, body, sigma = true_states().states, top(TRUTH)[0], 1e-3
    values = np.asarray(jax.vmap(lambda t, s: function(t, s, body, TRUTH))(jnp.asarray(TIMES), seen))
    values = values + sigma * np.random.default_rng(0).standard_normal(values.shape)
    values[3, ..., 1] = np.nan
    known, general = BUILT_IN[function](TIMES, values, sigma), fitting.Observed(TIMES, values, sigma, function)
    found = [m.of_run(HEAVY).residuals(TRUTH, body, seen) for m in (known, general)]
    assert 0.3 < np.std(found[0]) < 3
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=2e-12)


@pytest.mark.sample(0)
def test_it_sees_all_bodies_of_a_coupled_state_and_one_of_them_in_of_body():
    """The distance of two masses on a spring tells its strength; and the position of one of them does."""
    body = ml.FreeBody(ml.RigidBody(jnp.ones((2, 3))), jnp.array([2.0, 3.0]))

    def model(values):
        def spring(t, state):
            pull = values["spring"] * (state.position[1] - state.position[0])
            return ml.torques.Wrench(jnp.zeros_like(state.momentum), jnp.stack([pull, -pull]))

        zeros, attitudes = jnp.zeros((2, 3)), jnp.tile(jnp.eye(4)[0], (2, 1))
        return body, spring, ml.CoupledState(zeros, attitudes, zeros, jnp.array([[0.0, 0, 0], [1.0, 0, 0]]))

    times, strength = np.arange(0.1, 0.61, 0.05), 1.7
    apart = np.cos(np.sqrt(strength * (1 / 2 + 1 / 3)) * times)
    distance = fitting.Observed(times, apart, 0.01, lambda t, s, b, v: jnp.linalg.norm(s.position[1] - s.position[0]))
    place = fitting.Observed(times, 3 / 5 * (1 - apart)[:, None], 0.01, lambda t, s, b, v: s.position[:1])
    for seen in (distance, fitting.OfBody(0, place)):
        found = ml.fit(model, {"spring": fitting.Positive(1.5)}, seen, method="JACOBI[SRKN6b]", dt=0.05)
        assert found.ok
        np.testing.assert_allclose(found.values["spring"], strength, rtol=1e-6)


def test_a_function_that_holds_arrays_is_mapped_over_with_them():
    """Three factors, each with its own residuals (factor |Omega| - value) / sigma, of the dtype of the values."""
    dtype = "float32"

    def scaled(factor, t, state, body, values):
        return factor * speed(t, state, body, values) + 0 * t

    def residuals(factor):
        function = jax.tree_util.Partial(scaled, factor)
        seen = fitting.Observed(np.arange(5.0, dtype=dtype), values, 0.1, function)
        return seen.residuals({}, ml.RigidBody(jnp.ones(3, dtype)), states)

    values = np.array([0.4, np.nan, 0.6, 0.5, 0.5], dtype)
    states = ml.MomentumState(jnp.tile(jnp.array([0.3, 0.0, 0.4], dtype), (5, 1)))
    found = jax.vmap(residuals)(jnp.array([1.0, 2.0, 3.0], dtype))
    assert found.dtype == dtype
    wanted = 10 * (np.array([[0.5], [1.0], [1.5]]) - [0.4, 0, 0.6, 0.5, 0.5]) * [1, 0, 1, 1, 1]
    np.testing.assert_allclose(found, wanted, atol=1e-5)


# ---- bodies that travel: markers on a thrown body, and an accelerometer in it ----

THROWN = {"drag": 0.08, "moments": np.array([1.0, 2.0, 2.5]), "speed": np.array([6.0, 0.0, 4.0])}
POINTS = np.array([[0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.4]])
FLIGHT = np.arange(0.0, 1.01, 0.05)


def thrown(values):
    body = ml.FreeBody(ml.RigidBody(values["moments"]), 3.0)
    torque = ml.torques.UniformGravity(GRAVITY) + ml.torques.Drag([0.0, 0, 0], values["drag"], 1.2)
    momentum = body.momentum(jnp.array([1.0, 2.0, 0.5]))
    start = ml.FreeState(momentum, turn(0.5, -0.3, 0.8), 3.0 * values["speed"], jnp.zeros(3))
    return body, torque, start


NEAR = {
    "moments": fitting.Moments([1.1, 1.9, 2.5], scale="fixed"),
    "drag": fitting.Positive(0.05),
    "speed": fitting.Free([5.8, 0.1, 4.2]),
}


@pytest.mark.sample(0)
def test_drag_speed_and_moments_are_found():
    body, torque, start = thrown({name: jnp.asarray(value) for name, value in THROWN.items()})
    path = quick(lambda: ml.integrate("JACOBI[EA]", body, torque, start, dt=1 / 400, steps=400, save_every=20))()
    frames = ml.so3.to_matrix(path.states.attitude)
    seen = jnp.einsum("nij,mj->nmi", frames, jnp.asarray(POINTS)) + path.states.position[:, None]
    found = ml.fit(thrown, NEAR, fitting.Positions(FLIGHT, seen, 1e-3, markers=POINTS), method="RK4", dt=1 / 50)
    assert found.ok
    for name, value in THROWN.items():
        # Of the step of the fit, which is four times that of the truth.
        np.testing.assert_allclose(np.asarray(found.values[name]), value, atol=4e-3, rtol=4e-3)


def test_what_cannot_be_meant_is_refused():
    values = np.zeros((len(FLIGHT), 3))
    of_body = fitting.Positions(FLIGHT, values, 0.1, markers=[0.0, 0, 0], origin=[0.0, 0, 1])
    twice, staying = (fitting.Accelerations(FLIGHT, values, 0.1, lever=LEVER, gravity=g) for g in (GRAVITY, None))

    def stays(values):
        body, _, start = thrown(values)
        return body.body, None, start.turning

    def pulled(values):
        """By a force that may be gravity, or not."""
        body, torque, start = thrown(values)
        return body, lambda t, state: torque.on(body)(t, state), start

    for model, seen, message in (
        (thrown, of_body, "leave origin out"),
        (thrown, twice, "leave gravity out"),
        (stays, staying, "must have gravity="),
        (pulled, staying, "must have gravity="),
    ):
        with pytest.raises(ValueError, match=message):
            ml.fit(model, NEAR, [seen], method="JACOBI[EA]", dt=1 / 100)


class Harmonic(ml.torques.Torque):
    """Gravity inside a homogeneous ball, as a field of the user's own that does not read the body."""

    @property
    def gravitational(self):
        return True

    def __call__(self, t, state):
        return ml.torques.Wrench(jnp.zeros(3), -0.02 * MASS * state.position)


MASS, MU, RADIUS, J2, POLE, FAR = 3.0, 40.0, 2.0, 0.1, np.array([0.6, 0.0, 0.8]), np.array([8.0, -6.0, 5.0])
POINT, OBLATE = ml.torques.PointMass(MU), ml.torques.Oblateness(MU, RADIUS, J2, POLE)
FIELDS = {
    "own": (Harmonic(), lambda x: 0.01 * x @ x),
    "sum": (POINT + (OBLATE + ml.torques.Drag([0.0, 0, 0], 0.3, 1.2)), lambda x: oblate(x) - MU / np.linalg.norm(x)),
    "point mass without gradient": (ml.torques.PointMass(MU, gradient=False), lambda x: -MU / np.linalg.norm(x)),
    "oblate without gradient": (
        ml.torques.Oblateness(MU, RADIUS, J2, POLE, gradient=False) + ml.torques.UniformGravity(GRAVITY),
        lambda x: oblate(x) - np.dot(GRAVITY, x),
    ),
    "solar tide": (
        ml.asteroids.SolarTide(lambda t: jnp.asarray(FAR), MU),
        lambda x: MU / 2 / np.linalg.norm(FAR) ** 3 * (x @ x - 3 * (FAR @ x) ** 2 / (FAR @ FAR)),
    ),
}
BODIES = {
    "moments": ml.RigidBody([1.0, 2.0, 2.5]),
    "tensor": ml.TensorBody([[1.0, 0.1, 0.2], [0.1, 2.0, -0.1], [0.2, -0.1, 2.5]]),
}


def oblate(x):
    r = np.linalg.norm(x)
    return MU * J2 * RADIUS**2 / (2 * r**3) * (3 * (POLE @ x / r) ** 2 - 1)


def slope(potential, x, h=2e-2):
    """The field: minus the potential's derivative, by differences of sixth order."""
    weights = ((1, 45), (2, -9), (3, 1))
    sums = [sum(w * (potential(x - k * e) - potential(x + k * e)) for k, w in weights) for e in h * np.eye(3)]
    return np.array(sums) / 60 / h


@pytest.mark.sample(2)
@pytest.mark.parametrize(("name", "kind"), list(zip(FIELDS, cycle(BODIES), strict=False)))
def test_an_accelerometer_feels_how_gravity_changes_along_its_lever(name, kind):
    """R^T (a - g) + ..., where the field g at the instrument is that by differences of its potential there."""
    torque, potential = FIELDS[name]
    body, lever = ml.FreeBody(BODIES[kind], MASS), np.array([0.1, -0.05, 0.08])
    state = ml.FreeState([0.3, -0.5, 0.4], turn(0.5, -0.3, 0.8), [1.0, 2.0, -1.0], [4.0, -3.0, 5.0])
    seen = fitting.Accelerations([0.0], np.zeros((1, 3)), 1.0, lever=lever).of_run(torque)
    found = quick(lambda s: seen.expected(jnp.zeros(()), s, body, {}))(state)

    acting = ml.torques.Wrench.of(ml.torques.on_body(torque, body)(jnp.zeros(()), state))
    rates = np.asarray(body.velocity(state.momentum))
    change = np.asarray(body.velocity(jnp.cross(state.momentum, rates) + acting.torque))
    frame = Rotation.from_quat(np.asarray(state.attitude), scalar_first=True)
    gravity = slope(potential, np.asarray(state.position) + frame.apply(lever))
    wanted = frame.inv().apply(np.asarray(acting.force) / MASS - gravity)
    wanted = wanted + np.cross(change, lever) + np.cross(rates, np.cross(rates, lever))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-9)


def test_every_field_of_gravity_is_among_those_of_the_test():
    """All that declare themselves as gravity; coupled bodies have no accelerometers."""
    declared = {
        name for name, cls in torque_classes().items() if cls.gravitational is not ml.torques.Torque.gravitational
    }
    tested = {type(term).__name__ for torque, _ in FIELDS.values() for term in ml.torques.terms_of(torque)}
    assert declared - tested == {"Sum", "OnEach", "MutualGravity"}
