"""Every table of coefficients proved: its order, measured on a pendulum pair in extended precision, without JAX.

Then some with flights of rigid bodies: the lower of the two orders, or the scheme's where steps are composed.
"""

import numpy as np
import pytest
from cases import at, rows, run, setup, true_motion
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax import schemes

MASS = np.array([1.0, 1.7], np.longdouble)
PLACE, PUSH = np.array([0.7, -0.4], np.longdouble), np.array([0.3, 0.8], np.longdouble)


def force(u):
    """Minus the gradient of -cos u0 - cos u1 + sin(u0 - u1)/2, far from quadratic."""
    pull = np.cos(u[0] - u[1]) / 2
    return -np.sin(u) - np.array([pull, -pull])


def steps(scheme, count):
    h = np.longdouble(3) / count
    motion, kept = (PUSH, PLACE), None
    for _ in range(count):
        motion, kept = schemes.run(
            scheme,
            lambda a, m: (m[0], m[1] + a * h * m[0] / MASS),
            lambda b, c, m, f: (m[0] + b * h * f, m[1]),
            lambda c, m: force(m[1]),
            motion,
            kept if scheme.reuses_force else None,
        )
    return np.concatenate(motion)


def truth():
    def rate(t, y):
        return np.concatenate([force(y[2:]), y[:2] / MASS.astype(float)])

    start = np.concatenate([PUSH, PLACE]).astype(float)
    return solve_ivp(rate, (0, 3), start, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


@pytest.mark.parametrize("name", schemes.SCHEMES)
def test_order(name):
    """By differences of runs at h, h/2, h/4, which need no other solution."""
    scheme = schemes.SCHEMES[name]
    for count in (24, 48, 96, 192, 384):
        ends = [steps(scheme, count * factor) for factor in (1, 2, 4)]
        slope = np.log2(np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[1] - ends[2]))
        if abs(slope - scheme.order) < 0.1:
            break
    assert abs(slope - scheme.order) < 0.1, slope
    assert np.linalg.norm(ends[1] - ends[2]) > 1e3 * np.finfo(np.longdouble).eps  # not the slope of rounding
    np.testing.assert_allclose(ends[2].astype(float), truth(), atol=max(1e-11, 2.0 * np.linalg.norm(ends[2] - ends[1])))


@pytest.mark.parametrize("name", schemes.SCHEMES)
def test_coefficients_sum_to_one_and_read_the_same_backwards(name):
    scheme = schemes.SCHEMES[name]
    for kind in (schemes.KICK, schemes.FLIGHT):
        assert sum(c for k, c in scheme.stages if k == kind) == pytest.approx(1, abs=1e-13)
    assert scheme.symmetric == (scheme.order > 1)


# Steps per unit of time for the coarser of two runs: where the error is far above rounding.
ROTATIONS = {
    "SLIEMID[EA]": (2, 32),
    "SLIEMID4[EA]": (2, 32),
    "DLM[EA]": (2, 32),
    "SYMMETRIC[EA]": (2, 32),
    "LIEMID[SRKN6b]": (2, 32),
    "SLIEMID[S4]": (4, 16),
    "SLIEMID4[SRKN6b]": (4, 16),
    "SYMMETRIC[SRKN6b]": (4, 32),
    "SYMMETRIC[SRKN11b]": (6, 8),
}


@pytest.mark.parametrize("name", ROTATIONS)
def test_order_on_a_forced_body(name):
    """Under a torque that depends on attitude and time, momentum and attitude; a symmetric body where it must be."""
    method, (order, count) = ml.method(name), ROTATIONS[name]
    assert (method.name, method.order, method.symmetric) == (name, order, True)
    moments = [1.5, 1.5, 2.5] if name.startswith("SYMMETRIC") else [1.0, 2.0, 2.5]
    found = run(name, "float64", rows(*(setup(moments=moments, dt=1 / (count << level)) for level in (0, 1))), steps=64)
    assert np.all(found.ok)
    exact = [part[0] for part in true_motion(setup(moments=moments), np.array([1.0]))]
    errors = [
        [np.linalg.norm(x - y) for x, y in zip(at(found.states, level, count << level), exact, strict=True)]
        for level in (0, 1)
    ]
    slopes = np.log2(np.divide(errors[0], errors[1]))
    assert np.all(np.abs(slopes - order) < 0.1), (slopes, errors)


def test_methods_from_parts():
    by_name = ml.method("SLIEMID4[SRKN6b]")
    assert ml.method("SLIEMID4", "SRKN6b") == by_name
    assert ml.method(ml.flights.SymplecticMidpoint4(), ml.schemes.SRKN6B) == by_name
    assert ml.method("LIEMID", "EA") is ml.method("LIEMID[EA]")
    assert ml.method("linear", "KL8").order == 8
    for bad in ("SLIEMID4[RK4]", "SLIEMID9[EA]", "SLIEMID4"):
        with pytest.raises(ValueError, match=r"unknown method.*FLIGHT\[SCHEME\].*SRKN6b"):
            ml.method(bad)
    with pytest.raises(ValueError, match="unknown scheme 'RK4'"):
        ml.method("DLM", "RK4")
