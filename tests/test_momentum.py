"""The momentum alone: flights that find it without the attitude find the momentum of the whole flight, at less cost."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, MOMENTUM_FLIGHTS, epsilon, quick, real

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax.integrators import flights

# Bodies and momenta where formulas of free bodies have their special cases.
SPECIAL = (
    ([1.0, 2.0, 2.6], [0.1, 1.9, 0.12]),
    ([1.0, 2.0, 3.0], [0.0, 1.0, 0.0]),  # on the separatrix, about the middle axis
    ([3.0, 4.0, 6.0], [1.0, 0.3, 1.0]),  # on it, elsewhere
    ([2.0, 2.0, 2.0], [0.3, -0.4, 0.9]),
    ([2.0, 3.0, 2.0], [0.3, -0.4, 0.9]),
    ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0]),
    ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]),
)
EVERY = pytest.mark.parametrize("flight", MOMENTUM_FLIGHTS, ids=lambda flight: flight.name)


def flown(flight, moments, h, momentum):
    """The change of the momentum and `ok`: of the whole flight, and of the momentum alone."""
    inertia, momentum = flights.Inertia.of(ml.RigidBody(moments)), cp.vector(momentum)
    _, whole, ok = flight(inertia, h, momentum)
    alone, fine = flight.momentum_change(inertia, h, momentum)
    return cp.pack(whole), ok, cp.pack(alone), fine


def problems(count=4000):
    """Moments and momenta with turns of up to 1.4 radians in a unit of time, and the special cases."""
    rng = np.random.default_rng(3)
    masses = 10 ** rng.uniform(-1, 0, (count, 3))
    moments, momentum = masses.sum(1, keepdims=True) - masses, rng.normal(size=(count, 3))
    momentum *= 1.4 * rng.random((count, 1)) / np.linalg.norm(momentum / moments, axis=1, keepdims=True)
    special = [np.array(x) for x in zip(*SPECIAL, strict=True)]
    return np.concatenate([moments, special[0]]), np.concatenate([momentum, special[1]])


@pytest.mark.sample(0)
@EVERY
def test_it_is_the_change_of_the_whole_flight(flight):
    """To some units in the last place of the change itself; and `ok` means the same."""
    fly = real(jax.vmap(lambda i, p: flown(flight, i, jnp.ones((), p.dtype), p)))
    for dtype in DTYPES:
        moments, momentum = (x.astype(dtype) for x in problems())
        exact, _, _, _ = map(np.asarray, fly(moments.astype(float), momentum.astype(float)))
        _, ok, alone, fine = map(np.asarray, fly(moments, momentum))
        np.testing.assert_array_equal(fine, ok)
        assert 0.7 < ok.mean() < 0.95
        error = np.linalg.norm(alone - exact, axis=1)[ok]
        turn, size = np.linalg.norm(momentum / moments, axis=1)[ok], np.linalg.norm(momentum, axis=1)[ok]
        assert np.all(error <= 12 * epsilon(dtype) * turn * size)


@pytest.mark.sample(0)
@EVERY
def test_its_derivatives_are_those_of_the_whole_flight(flight):
    """In moments, time and momentum together, in every special case."""
    moments, momentum = map(jnp.array, zip(*SPECIAL, strict=True))
    moves = np.random.default_rng(0).normal(size=(3, 7))

    def derivatives(alone, moments, momentum, move):
        def along(s):
            moved = moments * (1 + 0.1 * s * move[:3]), 0.4 + 0.3 * s * move[3], momentum + s * move[4:]
            return flown(flight, *moved)[2 if alone else 0]

        return jax.jacfwd(along)(0.0)

    over_moves = jax.vmap(derivatives, (None, None, None, 0))
    whole, alone = (
        quick(jax.vmap(partial(over_moves, alone), (0, 0, None)))(moments, momentum, moves) for alone in (False, True)
    )
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=0, atol=2e-13), whole, alone)
