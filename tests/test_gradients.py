"""Derivatives of a run: forward and reverse, of first and second order, against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, setup, whole

import midlie_jax as ml

STEPS = 16
CASE = setup()
PARAMETERS = tuple(jnp.asarray(x) for x in (CASE.moments, CASE.weight, CASE.momentum, CASE.attitude, CASE.dt))
NAMES = ("moments", "weight", "momentum", "attitude", "dt")
WEIGHTS = jnp.array([0.3, -1.1, 0.7, 0.9, -0.4, 0.6, 1.3])


def end(name, parameters):
    """One number that depends on every entry of the end state."""
    moments, weight, momentum, attitude, dt = parameters
    start = ml.RigidState(momentum, attitude)
    torque = ml.torques.HeavyTop(weight, (0.48, 0.6, 0.64))
    path = ml.integrate(name, ml.RigidBody(moments), torque, start, dt=dt, steps=STEPS, save_every=STEPS)
    final = jnp.concatenate([path.states.momentum[-1], path.states.attitude[-1]])
    return jnp.sum(WEIGHTS * final) + jnp.sum(final**2 * WEIGHTS)


def directions(seed=0):
    """One direction for each parameter, in that parameter alone."""
    random = np.random.default_rng(seed)
    moves = [jnp.asarray(random.standard_normal(x.shape)) for x in PARAMETERS]
    alone = [tuple(m if i == j else jnp.zeros_like(m) for j, m in enumerate(moves)) for i in range(len(moves))]
    return jax.tree.map(lambda *x: jnp.stack(x), *alone)


def shifted(direction, size):
    return jax.tree.map(lambda x, d: x + size * d, PARAMETERS, direction)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["LIEMID[EA]", "LIEMID[I]", *whole("NMB", "JACOBI[EA]")])
def test_reverse_and_forward_equal_differences(name):
    along = directions()
    reverse = quick(jax.grad(lambda p: end(name, p)))(PARAMETERS)
    by_reverse = [float(jnp.sum(g * d[i])) for i, (g, d) in enumerate(zip(reverse, along, strict=True))]
    forward = quick(jax.vmap(lambda d: jax.jvp(lambda p: end(name, p), (PARAMETERS,), (d,))[1]))(along)
    # Fourth-order differences: their own error is 1e-10 here.
    sizes, factors = jnp.array([2.0, 1.0, -1.0, -2.0]) * 1e-3, jnp.array([-1.0, 8.0, -8.0, 1.0]) / 12e-3
    values = quick(jax.vmap(jax.vmap(lambda d, s: end(name, shifted(d, s)), (None, 0)), (0, None)))(along, sizes)
    differences = values @ factors
    for label, r, f, d in zip(NAMES, by_reverse, forward, differences, strict=True):
        assert abs(f - r) <= 1e-11 * (1 + abs(r)), label
        assert abs(d - r) <= 1e-6 * (1e-2 + abs(r)), label


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["LIEMID[E2]", *whole("LIEMID[EA]", "LIEMID[I]")])
def test_gradient_of_a_gradient_equals_differences(name):
    def in_weight(weight):
        return end(name, (PARAMETERS[0], weight, *PARAMETERS[2:]))

    second = quick(jax.grad(jax.grad(in_weight)))(PARAMETERS[1])
    # Of fourth order in the size, so wrong by 1e-9.
    size, factors = 1e-2, jnp.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12
    values = quick(jax.vmap(in_weight))(PARAMETERS[1] + size * jnp.arange(-2.0, 3.0))
    differences = values @ factors / size**2
    assert abs(second - differences) <= 1e-7 * abs(differences)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["LIEMID[EA]", *whole("SW")])
def test_gradients_are_finite_at_rest(name):
    resting = (*PARAMETERS[:2], jnp.zeros(3), *PARAMETERS[3:])
    gradient = quick(jax.grad(lambda p: end(name, p)))(resting)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(gradient))


@pytest.mark.sample(0)
def test_derivatives_through_an_array_torque_and_a_potential_agree():
    def tip(t, state):
        del t
        return PARAMETERS[1] * ml.so3.to_matrix(state.attitude)[2] @ jnp.array([0.48, 0.6, 0.64])

    def end_of(torque, momentum):
        start = ml.RigidState(momentum, PARAMETERS[3])
        path = ml.integrate(
            "LIEMID[EA]", ml.RigidBody(PARAMETERS[0]), torque, start, dt=1 / 64, steps=STEPS, save_every=STEPS
        )
        return jnp.sum(path.states.attitude[-1] * WEIGHTS[:4])

    fields = ml.torques.HeavyTop(PARAMETERS[1], (0.48, 0.6, 0.64)), ml.torques.FromPotential(tip)
    first, second = (quick(jax.grad(lambda p, f=f: end_of(f, p)))(PARAMETERS[2]) for f in fields)
    np.testing.assert_allclose(first, second, rtol=1e-12)
