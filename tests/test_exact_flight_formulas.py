"""The formulas of docs/reports/exact-flight.md on one body, against `JACOBI`."""

import jax.numpy as jnp
import numpy as np

import midlie_jax as ml

MOMENTS, y, h, i = np.array([1.0, 2.0, 2.5]), np.array([1.0, 0.8, -1.3]), 0.5, 1


def flight():
    """The momentum after the time h, and the rotation, by the steps of the page; the identities on the way hold."""
    j, k = (i + 1) % 3, (i + 2) % 3
    second, third = (lambda x: np.roll(x, -1)), (lambda x: np.roll(x, -2))  # x_m and x_n for every l

    a = 1 / third(MOMENTS) - 1 / second(MOMENTS)  # step 1
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
    half = (V * M + F * Z) * np.exp(0.5j * h * p / MOMENTS[i])  # step 7
    increment = np.append(half.real * (p**2 + new @ y), half.real * x + half.imag * p * (y + new))
    increment /= np.linalg.norm(increment)

    assert np.isclose(abs(F) ** 2, V, rtol=1e-13)
    assert np.isclose(abs(Z) ** 2, V * M**2, rtol=1e-13)
    assert np.isclose(Z, S * D * A * np.conj(C) / (p**2 - y[i] ** 2), rtol=1e-13)
    return new, increment


def test_the_flight_of_the_package_is_that_of_the_formulas():
    start = ml.RigidState(jnp.asarray(y), jnp.array([1.0, 0.0, 0.0, 0.0]))
    path = ml.integrate("JACOBI[E1]", ml.RigidBody(MOMENTS), None, start, dt=h, steps=1)
    momentum, increment = flight()
    np.testing.assert_allclose(path.states.momentum[1], momentum, rtol=0, atol=1e-14)
    np.testing.assert_allclose(path.states.attitude[1], increment, rtol=0, atol=1e-14)
