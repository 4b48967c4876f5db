"""The momentum alone: flights that find it without the attitude find the momentum of the whole flight, at less cost."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, MOMENTUM_FLIGHTS, RIGID_FLIGHTS, epsilon, quick, real

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
def test_no_time_changes_nothing_and_the_way_back_returns(flight):
    moments, momentum = problems()

    def there_and_back(nothing, moments, momentum):
        body, start = ml.RigidBody(moments), ml.MomentumState(momentum)
        method = ml.method(flight, "E1")
        still, there = (ml.integrate(method, body, None, start, dt=dt, steps=4, save_every=4) for dt in (nothing, 0.5))
        end = ml.MomentumState(there.states.momentum[-1])
        back = ml.integrate(method, body, None, end, dt=-0.5, steps=4, save_every=4)
        return still.states.momentum[-1], back.states.momentum[-1], there.ok

    nothing = np.zeros(len(moments))  # a step that is a number of Python is refused if zero
    still, back, ok = map(np.asarray, real(jax.vmap(there_and_back))(nothing, moments, momentum))
    assert ok.all()
    np.testing.assert_array_equal(still, momentum)
    error, size = np.linalg.norm(back - momentum, axis=1), np.linalg.norm(momentum, axis=1)
    assert np.all(error <= 40 * epsilon("float64") * size)


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


@pytest.mark.sample(0)
@EVERY
def test_its_reverse_derivative_is_its_forward_derivative(flight):
    moments, momentum = map(jnp.array, SPECIAL[0])

    def change(parameters):
        return flown(flight, *parameters)[2]

    parameters = moments, jnp.asarray(0.4), momentum
    forward, reverse = (quick(jac(change))(parameters) for jac in (jax.jacfwd, jax.jacrev))
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=0, atol=1e-14), forward, reverse)


@pytest.mark.sample(0)
@EVERY
def test_one_body_moves_as_in_a_batch(flight):
    """Under a torque of time; vectorised code contracts other products into fused multiply-adds."""
    moments, momentum = (x[:5] for x in problems())
    torque = ml.torques.Prescribed(lambda t: jnp.stack([0.1 * t, 0.2 - t * t, t]))

    def run(moments, momentum):
        body, start = ml.RigidBody(moments), ml.MomentumState(momentum)
        return ml.integrate(ml.method(flight, "EA"), body, torque, start, dt=0.1, steps=20).states.momentum

    together, one = real(jax.vmap(run))(moments, momentum), real(run)
    allowed = 4 * epsilon("float64") * np.arange(21)[:, None]
    for row in range(5):
        alone = np.asarray(one(moments[row], momentum[row]))
        assert np.all(np.abs(together[row] - alone) <= allowed * np.linalg.norm(alone, axis=-1, keepdims=True))


def test_a_state_without_pose_costs_less():
    """Whatever finds a flight's increment alone is not computed: the flights without a solve take half the work."""

    def work(name, start):
        moments = jnp.array([2.0, 2.0, 3.0])
        run = jax.jit(jax.vmap(lambda s: ml.integrate(name, ml.RigidBody(moments), None, s, dt=0.1, steps=4).states))
        many = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * 8), start)
        return run.lower(many).compile().cost_analysis()["flops"]

    momentum = jnp.array([0.3, 0.4, 0.5])
    for flight in RIGID_FLIGHTS:
        if flight.order is None:
            name = f"{flight.name}[EA]"
            whole = work(name, ml.RigidState(momentum, jnp.array([1.0, 0, 0, 0])))
            assert work(name, ml.MomentumState(momentum)) <= 0.6 * whole, name
