"""The exact flights: their formulas on one body, as docs/reports/exact-flight.md has them, and their derivative."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax.integrators import flights

# Any body, symmetric ones about each axis, a ball, a flat and a slender one, and the separatrix.
MOMENTS = [
    *([1.0, 2.0, 2.6], [5.0, 5.0, 1.0], [1.0, 2.0, 2.0], [2.0, 3.0, 2.0]),
    *([2.0, 2.0, 2.0], [1.0, 1.5, 2.5], [1, 0.9, 0.11]),
]
MOMENTA = [
    *([0.5, 0.9, 0.4], [2.0, -1.0, 0.7], [0.3, 0.9, -0.8], [0.9, 0.4, 0.3]),
    *([1.0, -1.2, 1.5], [0.4, 0.6, 1.3], [0.5, 0.4, 0.07]),
]
SEPARATRIX = [1.0, 2.0, 3.0], [0.6 / 3**0.5, 0.3, 0.6]
CASES = jnp.array([*MOMENTS, SEPARATRIX[0]]), jnp.array([*MOMENTA, SEPARATRIX[1]])


def in_parts(fly, moments, h, momentum):
    increment, change, *_ = fly(flights.Inertia.of(ml.RigidBody(moments)), h, cp.vector(momentum))
    return jnp.stack([*increment, *change])


SCALES = jnp.array([1.0, 1e-3, 1e-9, 0.0])  # of the momentum: turns from a radian to none
ANY_AXIS = jnp.array([MOMENTS[1], [5.0, 1.0, 5.0], [1.0, 5.0, 5.0]]), jnp.array(MOMENTA[:3])


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("flight", "other", "cases"),
    [
        (flights.Symmetric().fly, flights.Jacobi().fly, ANY_AXIS),
        (flights.Jacobi().fly, flights.Jacobi().formula, CASES),
    ],
    ids=["symmetric", "jacobi"],
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


BODY, y, h, i = np.array([1.0, 2.0, 2.5]), np.array([1.0, 0.8, -1.3]), 0.5, 1


def formulas():
    """The momentum after the time h, and the rotation, by the steps of the page; the identities on the way hold."""
    j, k = (i + 1) % 3, (i + 2) % 3
    second, third = (lambda x: np.roll(x, -1)), (lambda x: np.roll(x, -2))  # x_m and x_n for every l

    a = 1 / third(BODY) - 1 / second(BODY)  # step 1
    shares = second(a) * third(a) * y**2
    e = shares.mean() - shares  # step 2
    p, K = np.sqrt(y @ y), a[k] * y[j] ** 2 - a[j] * y[k] ** 2
    g2, g3 = 2 * e @ e, 4 * np.prod(e)

    c = {2: g2 / 20, 3: g3 / 28}  # step 8
    for n in range(4, 40):
        c[n] = 3 / ((2 * n + 1) * (n - 3)) * sum(c[m] * c[n - m] for m in range(2, n - 1))
    S = h * np.exp(-sum(c[n] * h ** (2 * n) / (2 * n * (2 * n - 1)) for n in c))
    wp_h = h**-2 + sum(c[n] * h ** (2 * n - 2) for n in c)
    wp_v = e[i] + a[j] * a[k] * p**2  # step 4
    taylor = [wp_v, 2j * a[j] * a[k] * p * K]  # of wp(v - t) in powers of t
    for n in range(40):
        square = sum(taylor[m] * taylor[n - m] for m in range(n + 1))
        taylor.append((6 * square - (g2 / 2 if n == 0 else 0)) / ((n + 1) * (n + 2)))
    F = np.exp(-sum(b * h ** (n + 2) / ((n + 1) * (n + 2)) for n, b in enumerate(taylor)))

    E = S * np.sqrt(wp_h - e)  # step 3
    D = E[0] ** 2 - a[1] * a[2] * S**2 * y[0] ** 2
    N = y * second(E) * third(E) + a * S * second(y) * third(y) * E
    new = N / D  # the momentum r
    V, M = S**2 * (wp_h - wp_v), D * p**2 + y @ N  # steps 5 and 6
    Z = D * p**2 * E.sum() + (y * N) @ E - M * E[i] + 1j * p * S * (K * D + a[k] * y[j] * N[j] - a[j] * y[k] * N[k])
    A = (np.prod(a * y) * S**3 + np.prod(E)) / (S * D) + (a[i] * np.prod(new) + 1j * p * K) / (
        new[j] ** 2 + new[k] ** 2
    )
    x = np.cross(new, y)
    C = (new @ y - y[i] * new[i]) * (p**2 + new @ y) + x[i] ** 2 - 1j * p * x[i] * (y[i] + new[i])
    half = (V * M + F * Z) * np.exp(0.5j * h * p / BODY[i])  # step 7
    increment = np.append(half.real * (p**2 + new @ y), half.real * x + half.imag * p * (y + new))
    increment /= np.linalg.norm(increment)

    assert np.isclose(abs(F) ** 2, V, rtol=1e-13)
    assert np.isclose(abs(Z) ** 2, V * M**2, rtol=1e-13)
    assert np.isclose(Z, S * D * A * np.conj(C) / (p**2 - y[i] ** 2), rtol=1e-13)
    return new, increment


def test_the_flight_of_the_package_is_that_of_the_formulas():
    start = ml.RigidState(jnp.asarray(y), jnp.array([1.0, 0.0, 0.0, 0.0]))
    path = ml.integrate("JACOBI[E1]", ml.RigidBody(BODY), None, start, dt=h, steps=1)
    momentum, increment = formulas()
    np.testing.assert_allclose(path.states.momentum[1], momentum, rtol=0, atol=1e-14)
    np.testing.assert_allclose(path.states.attitude[1], increment, rtol=0, atol=1e-14)
