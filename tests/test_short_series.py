"""The short polynomials of `_math/short_series.py`, up to the ends of their ranges, and the long turns they allow."""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, epsilon

import midlie_jax as ml
from midlie_jax._math import short_series

WIDEST = short_series.WIDEST_SQUARE


def exactly(shift, x):
    """The sum of (-x)^n / (2n + shift)!, in extended precision."""
    return np.sum([(-x) ** n / np.longdouble(factorial(2 * n + shift)) for n in range(30)], axis=0)


def value(coefficients, x, dtype):
    """The polynomial with coefficients rounded to `dtype`, in extended precision."""
    return np.sum([np.longdouble(np.dtype(dtype).type(c)) * x**n for n, c in enumerate(coefficients)], axis=0)


@pytest.mark.parametrize("dtype", DTYPES)
def test_polynomials_are_exact_to_rounding(dtype):
    x = np.linspace(0, 1, 200, dtype=np.longdouble)
    name, half = np.dtype(dtype).name, np.finfo(dtype).eps / 2
    for shift in (0, 1):
        spin = short_series.economised(shift, short_series.SPIN_TERMS[name])
        assert abs(value(spin, WIDEST * x, dtype) - exactly(shift, WIDEST * x)).max() < 1.1 * half
        turn = short_series.half_angle_polynomials(name)[shift]
        assert abs(value(turn, WIDEST * x, dtype) - exactly(shift, WIDEST * x / 4) / (1 + shift)).max() < half
    for shift in (4, 5):
        terms = short_series.economised(shift, short_series.STUMPFF_TERMS[name], 4 * WIDEST)
        assert abs(value(terms, 4 * WIDEST * x, dtype) - exactly(shift, 4 * WIDEST * x)).max() < half / 16


def test_what_the_polynomials_do_to_a_length_is_far_below_rounding_for_small_turns():
    """Else a million small turns would add up to more than their roundings do."""
    x = np.linspace(0, 0.5, 100, dtype=np.longdouble)
    cosine, sine = (value(short_series.economised(k, short_series.SPIN_TERMS["float64"]), x, "float64") for k in (0, 1))
    assert abs(cosine**2 + x * sine**2 - 1).max() < epsilon("float64") / 40
    cosine, sine = (value(c, x, "float64") for c in short_series.half_angle_polynomials("float64"))
    assert abs(cosine**2 + x * sine**2 - 1).max() < epsilon("float64") / 40


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["SYMMETRIC[E1]", "NEARSYM[E1]"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_a_symmetric_body_turns_by_up_to_4_4_radians_in_a_flight(dtype, name):
    """A flight of h, the whole step of E1, is two of h/2, for a fast spin and for a turn about the momentum."""
    moments = np.array([5.0, 5.0, 1.0])
    fast_spin, slow_spin = np.array([0.3, -0.2, 5.0]), np.array([20.0, 3.0, 0.5])
    spin_rate = (1 / moments[2] - 1 / moments[0]) * fast_spin[2]
    for momentum, rate in ((fast_spin, spin_rate), (slow_spin, np.linalg.norm(slow_spin) / moments[0])):

        def flights(h, momentum=momentum):
            """The body after one flight of h, and after two of h/2."""
            start = ml.RigidState(jnp.asarray(momentum, dtype), jnp.asarray([1.0, 0, 0, 0], dtype))
            body = ml.RigidBody(jnp.asarray(moments, dtype))
            return [ml.integrate(name, body, None, start, dt=h / n, steps=n) for n in (1, 2)]

        for angle in (2.5, 3.5, 4.35):
            once, twice = flights(angle / rate)
            assert once.ok
            assert twice.ok
            for a, b in zip(jax.tree.leaves(once.states), jax.tree.leaves(twice.states), strict=True):
                scale = np.abs(np.asarray(a[-1])).max()
                np.testing.assert_allclose(a[-1], b[-1], atol=40 * epsilon(dtype) * scale)
        beyond, _ = flights(4.45 / rate)
        assert not beyond.ok
        assert beyond.first_bad == 1
