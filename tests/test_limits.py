"""That steps fail where the limits of `integrators/limits.py` say, on maps of `cli/stability.py`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import RIGID_FLIGHTS, quick, whole

import midlie_jax as ml
from midlie_jax.cli import stability
from midlie_jax.integrators import limits
from midlie_jax.integrators.runge_kutta import DOP853, GBS12, RK4
from midlie_jax.integrators.schemes import SCHEMES
from midlie_jax.model.inertia import Inertia
from midlie_jax.model.torques import DipoleInField, FromPotential

OMEGA = 2.0  # of small oscillations of the needle
MOMENTS = np.array([1.0, 1.0, 1.2])
NEEDLE = DipoleInField(jnp.array([0.0, 0.0, OMEGA**2]), jnp.array([0.0, 0.0, 1.0]))


def tilted(angle):
    return ml.so3.exp(jnp.array([angle, 0.0, 0.0]))


def runs(name, torque, momenta, dt, number, attitude, moments=MOMENTS):
    """`stability.runs` of one body with several momenta, each with all steps; (momenta, steps)."""
    rows = np.repeat(np.atleast_2d(momenta), len(dt), axis=0)
    count = len(rows)
    starts = ml.RigidState(jnp.asarray(rows), jnp.tile(attitude, (count, 1)))
    steps, ones = jnp.asarray(np.tile(dt, count // len(dt))), jnp.ones(count)
    bodies = jnp.tile(jnp.asarray(moments), (count, 1))
    found = stability.runs(ml.method(name), torque, bodies, starts, ones, steps, number)
    return [x.reshape(-1, len(dt)) for x in found]


def top_limit(gyration, frequency):
    """The largest stable step of kick and flight for a hanging top that spins about its axis of symmetry.

    With I1 = I2, the tilt z = x + i y of the axis obeys z'' = i a z' - omega^2 z. Here a = Pi3 / I1 is the frequency of
    the free nutation, `gyration`, and omega^2 = m g l / I1 the squared frequency of the top without spin. A flight
    multiplies z' by e = exp(i a h) and adds (e - 1) / (i a) times z' to z. A kick subtracts h omega^2 z from z'. The
    step has the determinant e and the trace 1 + e + i (e - 1) h omega^2 / a. Its eigenvalues, divided by exp(i phi)
    with phi = a h / 2, have the product 1 and the sum

        2 cos phi - 2 b sin phi = 2 sqrt(1 + b^2) cos(phi + arctan b),    b = h omega^2 / a

    They have the modulus 1 as long as this sum is between -2 and 2, that is while phi + 2 arctan b <= pi. Without spin
    this limit is h omega = 2, and in a weak field it is the step resonance a h = 2 pi.
    """
    a, omega = np.broadcast_arrays(np.asarray(gyration, float), np.asarray(frequency, float))
    low, high = np.zeros(a.shape), 2 / omega  # phi + 2 arctan b increases with h, and is at least pi at h omega = 2
    for _ in range(60):
        h = (low + high) / 2
        inside = a * h / 2 + 2 * np.arctan2(h * omega**2, a) <= np.pi
        low, high = np.where(inside, h, low), np.where(inside, high, h)
    return low


def first(dt, holds):
    """The first step for which something holds."""
    assert np.any(holds)
    assert not holds[0]
    return dt[np.argmax(holds)]


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["SYMMETRIC[EA]", *whole("JACOBI[EA]", "LIEMID[EA]")])
def test_a_needle_is_stable_up_to_the_limit_of_verlet_and_a_spinning_one_up_to_that_of_the_top(name):
    gyrations = OMEGA * np.array([0.0, 0.5, 1.0])
    dt = np.linspace(0.85, 1.15, 61) * 2 / OMEGA
    momenta = MOMENTS[0] * np.outer(gyrations, [0, 0, 1])
    if name == "JACOBI[EA]":
        momenta = momenta[:1]  # its reach ends before
    worst, failed, _ = runs(name, NEEDLE, momenta, dt, 400, tilted(1e-4))
    found = [first(dt, (row > 1e-6) | bad) for row, bad in zip(worst, failed, strict=True)]
    assert found[0] == pytest.approx(2 / OMEGA, rel=0.01)
    np.testing.assert_allclose(found, top_limit(gyrations, OMEGA)[: len(found)], rtol=0.01)
    assert ml.method(name).stability_limit(1j) / OMEGA == pytest.approx(found[0], rel=0.01)


def test_limits_of_schemes_and_tables_are_the_known_ones():
    assert limits.oscillator_limit(SCHEMES["EA"]) == pytest.approx(2, abs=2e-3)
    assert limits.oscillator_limit(SCHEMES["CHIN4A"]) == pytest.approx(
        2 * 3**0.5, abs=2e-3
    )  # trace 2 - x^2 + x^4/12 ..
    assert limits.runge_kutta_limit(RK4.formula, 1j) == pytest.approx(8**0.5, abs=2e-3)
    assert limits.runge_kutta_limit(RK4.formula, -1 + 0j) == pytest.approx(2.785, abs=2e-3)
    assert limits.runge_kutta_limit(DOP853.formula, -1 + 0j) > limits.runge_kutta_limit(RK4.formula, -1 + 0j)
    assert limits.runge_kutta_limit(GBS12.formula, 1 + 0j) == np.inf
    assert limits.decay_limit(SCHEMES["EA*"]) == pytest.approx(2, abs=2e-3)
    assert top_limit(100.0, 0.1) == pytest.approx(2 * np.pi / 100, rel=1e-3)  # a step resonance of the nutation


@pytest.mark.parametrize("name", ["DMV[EA]", *whole("JACOBI[EA]", "LIEMID[EA]", "LIEMID[I]", "DLM[EA]", "AKW", "NMB")])
def test_a_spin_about_a_principal_axis_fails_at_the_reach(name):
    """Without a torque, on a map of a few steps; of DMV[EA], whose flights are of half a step, at twice the limit."""
    method, moments = ml.method(name), np.array([1.0, 2.0, 2.5])
    speed = 3.0
    dt = np.linspace(0.8, 1.2, 81) * method.reach / speed
    _, failed, blown = runs(name, None, np.diag(moments * speed), dt, 4, tilted(0.3), moments)
    for row in failed | blown:
        assert first(dt, row) == pytest.approx(method.reach / speed, rel=0.05)
    if name == "DMV[EA]":
        assert method.reach / speed == 2 / speed


# DMV4 and DMV6 reach further than DMV, whose limit they are given.
REACHING = [f for f in RIGID_FLIGHTS if not f.name.startswith("DMV")]


@pytest.mark.sample(2)
@pytest.mark.parametrize("moments", [(1.0, 1.0, 0.4), *whole(((1.0, 1.0, 1.7),), ((1.0, 2.0, 2.5),))])
@pytest.mark.parametrize("flight", REACHING, ids=lambda flight: flight.name)
def test_a_flight_is_ok_up_to_its_reach_and_not_beyond(flight, moments):
    if flight.equal_moments and moments[0] != moments[1]:
        return
    inertia = Inertia.of(ml.RigidBody(jnp.array(moments)))
    directions = jnp.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.6, 0.62]], float)
    turns = flight.reach * jnp.linspace(0.5, 1.5, 101)

    def ok(direction, turn):
        momentum = tuple(direction * jnp.array(moments))
        return flight(inertia, turn / flight.turn_rate(inertia, momentum), momentum)[2]

    found = np.asarray(quick(jax.vmap(jax.vmap(ok, (None, 0)), (0, None)))(directions, turns))
    reached = np.array([turns[np.argmin(row)] for row in found]) / flight.reach
    np.testing.assert_allclose(reached[:3], 1, atol=0.03)
    # About other axes the flights that solve, and DLM, which turns about the axes in turn, reach somewhat other turns.
    np.testing.assert_allclose(reached[3], 1, atol=0.2)


@pytest.mark.parametrize("name", ["LIEMID[I]", *whole("SW", "AKW")])
def test_an_implicit_step_follows_the_torque_up_to_the_fold_of_its_equation(name):
    """A needle at rest next to the inverted position falls; beyond the fold the solution climbs over the top.

    A step of a rotation about one axis under the torque -k sin x moves by 2 w with 2 I w = h (p + (h/2) T(x + w)). The
    derivative by w of the difference of both sides, 2 I + (h^2 / 2) k cos(x + w), is positive at every angle as long as
    h omega < 2. Beyond, the solution folds into three near the inverted position.
    """
    dt = np.linspace(0.9, 1.1, 41) * 2 / OMEGA
    start = ml.RigidState(jnp.zeros(3), tilted(np.pi - 1e-4))

    def momentum(h):
        path = ml.integrate(name, ml.RigidBody(jnp.asarray(MOMENTS)), NEEDLE, start, dt=h, steps=1)
        return path.states.momentum[-1, 0]

    pushed = float(NEEDLE(0.0, start)[0])
    against = np.sign(np.asarray(quick(jax.vmap(momentum))(jnp.asarray(dt)))) != np.sign(pushed)
    assert first(dt, against) == pytest.approx(2 / OMEGA, rel=0.01)


@pytest.mark.sample(0)
def test_kicks_resonate_with_a_spin_at_steps_of_pi_over_k():
    """In a field with the second, fourth and sixth harmonic of the angle of the spin: one peak of the error for each.

    And within the width: beyond it, the error falls below a third of that of the peak.
    """
    speed, weak = 1.0, 2e-5

    def potential(t, state):
        del t
        x, y = ml.so3.to_matrix(state.attitude)[:2, 0]
        z = jax.lax.complex(x, y)
        return weak * jnp.real(z**2 + z**4 + z**6)

    orders = np.array([1, 2, 3])
    peaks = limits.resonance(speed, orders)
    near = np.linspace(0.9, 1.1, 81)
    dt = np.concatenate([near * peak for peak in peaks])
    attitude = ml.so3.exp(jnp.array([0.0, 0.0, 0.3]))
    worst, failed, _ = runs("SYMMETRIC[EA*]", FromPotential(potential), [0, 0, speed], dt, 1500, attitude, np.ones(3))
    assert not np.any(failed)
    for k, peak, errors in zip(orders, peaks, worst[0].reshape(3, -1), strict=True):
        at = near[np.argmax(errors)] * peak
        assert at == pytest.approx(peak, rel=0.03)
        field = 2 * k * weak**0.5  # of small oscillations in the harmonic 2 k alone
        width = limits.resonance_half_width(field, k)
        outside = np.abs(np.pi / (k * near * peak) - speed) > 2 * width
        assert np.max(errors[outside]) < np.max(errors) / 2
        assert np.max(errors) > width / 2  # a change of the spin by the width changes its energy by twice as much
