"""The derivative of the exact flights in closed form, against the derivatives of their formulas, and its integrals."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax._kernel import components as cp
from midlie_jax._kernel.weierstrass import moment_functions, sigma_functions
from midlie_jax.methods import flights
from midlie_jax.methods.flights import jacobi
from midlie_jax.methods.flights.exact import ExactFlight
from midlie_jax.methods.flights.jacobi_momentum import lag
from midlie_jax.methods.flights.symmetric_tangent import Turning

# Any body, symmetric ones about each axis, a ball, a flat and a slender one, and the separatrix.
MOMENTS = [
    [1.0, 2.0, 2.6],
    [5.0, 5.0, 1.0],
    [1.0, 2.0, 2.0],
    [2.0, 3.0, 2.0],
    [2.0, 2.0, 2.0],
    [1.0, 1.5, 2.5],
    [1, 0.9, 0.11],
]
MOMENTA = [
    [0.5, 0.9, 0.4],
    [2.0, -1.0, 0.7],
    [0.3, 0.9, -0.8],
    [0.9, 0.4, 0.3],
    [1.0, -1.2, 1.5],
    [0.4, 0.6, 1.3],
    [0.5, 0.4, 0.07],
]
SEPARATRIX = [1.0, 2.0, 3.0], [0.6 / 3**0.5, 0.3, 0.6]
CASES = jnp.array([*MOMENTS, SEPARATRIX[0]]), jnp.array([*MOMENTA, SEPARATRIX[1]])


EXACT = [flight for flight in flights.FLIGHTS.values() if isinstance(flight, ExactFlight)]


def integrals(moments, momentum, h):
    """The integral of (h - t) Pi_1 Pi_2 Pi_3, in units of the largest moment, by a general integrator."""
    a, b, c = np.max(moments) / moments
    x = momentum / np.max(moments)

    def rates(t, y):
        p, q, r, _ = y
        return (c - b) * q * r, (a - c) * r * p, (b - a) * p * q, (h - t) * p * q * r

    return solve_ivp(rates, (0, h), [*x, 0.0], method="DOP853", rtol=1e-13, atol=1e-16).y[3, -1]


@pytest.mark.parametrize("h", [0.2, 1.0])
def test_the_lag_is_the_integral_that_it_is_said_to_be(h):
    def found(moments, momentum):
        return lag(flights.Inertia.of(ml.RigidBody(moments)), jnp.asarray(h), cp.vector(momentum), jacobi.LARGEST_TURN)

    exact = [integrals(*map(np.asarray, case), h) for case in zip(*CASES, strict=True)]
    np.testing.assert_allclose(quick(jax.vmap(found))(*CASES), exact, rtol=2e-14, atol=1e-16)


@pytest.mark.parametrize("h", [0.2, 1.0])
def test_the_lag_of_a_symmetric_body(h):
    moments, momentum = np.array(MOMENTS[1]), np.array(MOMENTA[1])
    a, _, c = moments.max() / moments
    per_unit = jnp.asarray(1 / moments.max())
    ours = Turning.of(jnp.asarray(h), jnp.asarray(c - a), per_unit, cp.vector(jnp.asarray(momentum))).lag()
    np.testing.assert_allclose(ours, integrals(moments, momentum, h), rtol=2e-14)


def test_moment_functions_give_the_first_moment():
    """Of wp' about the middle, by Gauss's rule, with wp from its differential equation."""
    roots = np.array([0.2, 0.05, -0.25])
    g2, g3 = 2 * roots @ roots, 4 * roots.prod()
    p = 0.3  # above all roots, so wp has this value at a real place
    slope = -np.sqrt(4 * np.prod(p - roots))

    def rates(t, y):
        return y[1], 6 * y[0] ** 2 - g2 / 2

    times, weights = np.polynomial.legendre.leggauss(20)
    slopes = [solve_ivp(rates, (0, t), [p, slope], method="DOP853", rtol=1e-13, atol=1e-15).y[1, -1] for t in times]
    a, b, c = moment_functions(jnp.asarray(g2), jnp.asarray(g3), 1.0)
    s, w, _ = sigma_functions(jnp.asarray(g2), jnp.asarray(g3), 1.0)
    found = (a * (p * p - g2 / 12) + b * (2 * g2 * p + 3 * g3) + c * (18 * g3 * p + g2**2)) / (w - s * s * p) ** 2
    np.testing.assert_allclose(found, np.sum(weights * times * np.array(slopes)), rtol=1e-12)


def in_parts(fly, moments, h, momentum):
    increment, change = fly(flights.Inertia.of(ml.RigidBody(moments)), h, cp.vector(momentum))
    return jnp.stack([*increment, *change])


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-9, 0.0])
def test_the_derivative_of_jacobi_is_that_of_its_formulas(scale):
    """In moments, time and momentum, for turns from a radian to none; `formula` is the flight without its own rule."""

    def derivative(fly, moments, momentum):
        return jax.jacfwd(partial(in_parts, fly), (0, 1, 2))(moments, jnp.asarray(1.0), scale * momentum)

    ours, formulas = (
        quick(jax.vmap(partial(derivative, fly)))(*CASES) for fly in (flights.Jacobi().fly, flights.Jacobi().formula)
    )
    for one, other in zip(ours, formulas, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * float(jnp.abs(other).max()))


@pytest.mark.parametrize("flight", EXACT, ids=lambda flight: flight.name)
def test_a_flight_with_a_known_increment_has_the_derivative_of_the_flight(flight):
    moments, momentum = jnp.array(MOMENTS[1]), jnp.array(MOMENTA[1])
    start = flights.Inertia.of(ml.RigidBody(moments)), jnp.asarray(0.2), cp.vector(momentum)
    known, change, _ = flight(*start)
    np.testing.assert_allclose(cp.pack(flight.again(*start, known)[1]), cp.pack(change), atol=1e-15)

    def again(inertia, h, momentum):
        return flight.again(inertia, h, momentum, known)

    ours, whole = (
        quick(jax.jacrev(partial(in_parts, fly), (0, 1, 2)))(moments, start[1], momentum)
        for fly in (again, lambda *arguments: flight(*arguments)[:2])
    )
    for one, other in zip(ours, whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-15)
