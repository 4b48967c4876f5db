"""The derivative of the exact flights in closed form, against the derivatives of their formulas, and its integrals."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax._math.weierstrass import moment_functions, sigma_functions
from midlie_jax.integrators import flights
from midlie_jax.integrators.flights import jacobi
from midlie_jax.integrators.flights.exact import ExactFlight, Known, carry
from midlie_jax.integrators.flights.jacobi import lag
from midlie_jax.model.kind import Kind
from midlie_jax.model.states.rigid import Rotation

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


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev, jax.hessian])
def test_constants_that_follow_the_moments_have_their_derivatives(derivative):
    """For the bodies with three different moments; where two are the largest, their order defines a derivative."""
    for moments in jnp.array([*MOMENTS[:1], *MOMENTS[5:], SEPARATRIX[0], [3.0, 1.0, 2.5], [2.0, 2.9, 1.1]]):

        def constants(m, tied):
            inertia = flights.Inertia.of(ml.RigidBody(m, physical=False))
            return jnp.stack(jax.tree.leaves(inertia.tied() if tied else inertia))

        ours, reference = (derivative(partial(constants, tied=tied))(moments) for tied in (True, False))
        np.testing.assert_allclose(ours, reference, atol=1e-13 * float(jnp.max(jnp.abs(reference))), rtol=0)


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
    increment, change, *_ = fly(flights.Inertia.of(ml.RigidBody(moments)), h, cp.vector(momentum))
    return jnp.stack([*increment, *change])


SCALES = jnp.array([1.0, 1e-3, 1e-9, 0.0])  # of the momentum: turns from a radian to none
ANY_AXIS = jnp.array([MOMENTS[1], [5.0, 1.0, 5.0], [1.0, 5.0, 5.0]]), jnp.array(MOMENTA[:3])


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("flight", "other", "cases"),
    [
        (flights.Jacobi().fly, flights.Jacobi().formula, CASES),
        (flights.Symmetric().fly, flights.Jacobi().fly, ANY_AXIS),
    ],
    ids=["jacobi", "symmetric"],
)
def test_the_derivative_is_that_of_the_formulas(flight, other, cases):
    """In moments, which may become unequal, time and momentum; `formula` is the flight without its own rule."""

    def derivative(mode, fly, scale, moments, momentum):
        return mode(partial(in_parts, fly), (0, 1, 2))(moments, jnp.asarray(1.0), scale * momentum)

    ours, others = (
        quick(jax.vmap(jax.vmap(partial(derivative, mode, fly), (None, 0, 0)), (0, None, None)))(SCALES, *cases)
        for mode, fly in ((jax.jacrev, flight), (jax.jacfwd, other))
    )
    for found, exact in zip(ours, others, strict=True):
        for one, truth in zip(found, exact, strict=True):  # of each scale
            np.testing.assert_allclose(one, truth, rtol=0, atol=1e-13 * float(jnp.abs(truth).max()))


@pytest.mark.sample(0)
@pytest.mark.parametrize("flight", EXACT, ids=lambda flight: flight.name)
def test_carrying_a_pose_is_flying_and_turning(flight):
    """In value and derivative, also where both are known, and in the second derivative by the momentum."""
    moments, momentum, attitude = jnp.array(MOMENTS[1]), jnp.array(MOMENTA[1]), ml.so3.exp(jnp.array([0.3, -0.5, 0.9]))
    h, no_step = jnp.asarray(0.2), jnp.asarray(False)
    increment, _, parts = flight.fly(flights.Inertia.of(ml.RigidBody(moments)), h, cp.vector(momentum))
    known = Known(increment, parts, Rotation.act(cp.quaternion(attitude), increment, no_step))

    def apart(moments, h, momentum, attitude):
        increment, change, _ = flight.fly(flights.Inertia.of(ml.RigidBody(moments)), h, cp.vector(momentum))
        return jnp.stack([*change, *Rotation.act(cp.quaternion(attitude), increment, no_step)])

    def together(moments, h, momentum, attitude, known=None):
        inertia, pose = flights.Inertia.of(ml.RigidBody(moments)), cp.quaternion(attitude)
        kind = Kind(ml.RigidState, ml.RigidState.leaves)
        flown, end = carry(flight, kind, inertia, h, cp.vector(momentum), known, pose, no_step)
        return jnp.stack([*flown.change, *end])

    where = moments, h, momentum, attitude
    for function in (together, partial(together, known=known)):
        np.testing.assert_allclose(function(*where), apart(*where), rtol=0, atol=1e-15)
        ours, other = (quick(jax.jacrev(f, (0, 1, 2, 3)))(*where) for f in (function, apart))
        jax.tree.map(partial(np.testing.assert_allclose, rtol=0, atol=4e-15), ours, other)
        ours, other = (quick(jax.jacfwd(jax.jacrev(f, 2), 2))(*where) for f in (function, apart))
        np.testing.assert_allclose(ours, other, rtol=0, atol=1e-14)
