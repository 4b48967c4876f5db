"""Laws of every rotation method: order, reversal, adjoints, rest. A new method is tested by being registered."""

from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    BUILDS,
    CLASSES,
    DTYPES,
    METHODS,
    OTHER,
    RIGID_FLIGHTS,
    ROTATION,
    STEPS,
    at,
    continued,
    each,
    epsilon,
    equal_moments,
    gap,
    quick,
    rows,
    run,
    setup,
    true_motion,
    whole,
)

import midlie_jax as ml
from midlie_jax.integrators import schemes

# Two bodies at halving steps; row r reaches time 1 at step 16 << r % 4. Then a row for each law that needs one.
LEVELS = 4
RUNS = rows(*(setup(**body, dt=1 / (16 << level)) for body in ({}, OTHER) for level in range(LEVELS)), setup(dt=0.0))
STILL = 2 * LEVELS
# The runs used where rounding is measured: times 2 and 1, before small differences have grown much.
SHORT = [2, 3, 6, 7]


# In float64 all that are built differently; in float32 one of each class.
SINGLE = CLASSES
TAKEN = [*product(BUILDS, ["float64"]), *product(SINGLE, ["float32"])]
TAKEN += whole(*(pair for pair in product(ROTATION, DTYPES) if pair not in TAKEN))


@cache
def paths(name, dtype):
    return run(name, dtype, RUNS)


def roundings(name):
    """Steps, counted once for every two flights in them."""
    return STEPS * max(1, getattr(ml.method(name), "scheme", schemes.EA).flights / 2)


@cache
def truth(body, equal):
    start = setup(**(OTHER if body else {}))
    moments = start.moments[[0, 0, 2]] if equal else start.moments
    return true_motion(start._replace(moments=moments), np.array([1.0]))


# At higher orders the errors of these steps are those of rounding: `test_schemes.py` measures each scheme by itself.
MEASURED = [method.name for method in METHODS if method.order <= 4 and not getattr(method, "small", None)]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", each(MEASURED))
def test_order(name):
    """Measured on an asymmetric body under a torque that depends on attitude and time, at the smallest steps.

    At the largest where the order is high, whose errors are soon those of rounding.
    """
    found, order = paths(name, "float64"), ml.method(name).order
    for body in (0, 1):
        exact = [part[0] for part in truth(body, equal_moments(name))]
        errors = []
        for level in range(LEVELS):
            state = at(found.states, body * LEVELS + level, 16 << level)
            errors.append([np.linalg.norm(x - y) for x, y in zip(state, exact, strict=True)])
        coarse, fine = errors[-2:] if order <= 2 else errors[:2]
        slopes = np.log2(np.divide(coarse, fine))
        assert np.all(np.abs(slopes - order) < (0.1 if order <= 2 else 0.2)), (slopes, errors)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=SINGLE))
def test_float32_follows_float64(name):
    """Each step rounds a few times, and the motion magnifies it little in this time: half a unit a step at most."""
    single, double = paths(name, "float32"), paths(name, "float64")
    assert single.states.momentum.dtype == single.times.dtype == np.float32
    assert np.all(single.ok)
    assert np.all(double.ok)
    for row in SHORT:
        difference = gap(at(single.states, row), at(double.states, row))
        assert difference <= roundings(name) / 2 * epsilon("float32"), difference / epsilon("float32")


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "dtype"), TAKEN)
def test_symmetric_methods_come_back(name, dtype):
    """N steps of dt, then N of -dt. The others miss by their own error, of 1e-3 or more here at order 1."""
    gaps, method = missed(name, name, dtype), ml.method(name)
    if method.symmetric:
        assert max(gaps) <= roundings(name) * epsilon(dtype), np.array(gaps) / epsilon(dtype)
    elif method.order == 1:
        assert min(gaps) > 1e-3, gaps


def missed(there, back, dtype):
    """How far from the start the method `back` ends after the steps of `there`."""
    out = paths(there, dtype)
    returned = run(back, dtype, continued(RUNS, out, dt=-RUNS.dt, t0=RUNS.t0 + STEPS * RUNS.dt))
    return [gap(at(returned.states, row, -1), at(out.states, row, 0)) for row in SHORT]


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_first_order_methods_are_adjoint(dtype):
    """A step of -dt by one undoes a step of dt by the other."""
    for there, back in (("LIEMID[E1]", "LIEMID[E2]"), ("LIEMID[E2]", "LIEMID[E1]")):
        gaps = missed(there, back, dtype)
        assert max(gaps) <= STEPS * epsilon(dtype), np.array(gaps) / epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), TAKEN)
def test_a_step_of_no_length_changes_no_bit(name, dtype):
    states = paths(name, dtype).states
    for part, start in zip(at(states, STILL), at(states, STILL, 0), strict=True):
        np.testing.assert_array_equal(part, np.broadcast_to(start, part.shape))


FLOWN = [f"{flight.name}[EA]" for flight in RIGID_FLIGHTS]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", each(list(dict.fromkeys([*FLOWN, *ROTATION])), few=[*FLOWN, *CLASSES]))
def test_thirty_radians_a_step_are_refused(name):
    """By every method: none has a step of which such a turn is a part of the truth."""
    rng = np.random.default_rng(0)
    masses = rng.uniform(0.3, 1, (1000, 3))
    if equal_moments(name):
        masses[:, 1] = masses[:, 0]
    moments = masses.sum(1, keepdims=True) - masses
    momentum = rng.normal(size=(1000, 3))
    momentum *= 30 / np.linalg.norm(momentum / moments, axis=1, keepdims=True)

    def run(moments, momentum):
        start = ml.RigidState(momentum, jnp.array([1.0, 0, 0, 0]))
        return ml.integrate(name, ml.RigidBody(moments), None, start, dt=1.0, steps=1).ok

    assert not np.any(quick(jax.vmap(run))(moments, momentum))
