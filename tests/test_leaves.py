"""Torques with leaves of all kinds: keys of random numbers, typed and raw, integers, and neural networks."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick
from test_scalars import FUNCTIONS

import midlie_jax as ml
from midlie_jax._xla.replay import Packed, by_components

BODY = ml.RigidBody(jnp.array([1.0, 2.0, 3.0]))
START = ml.RigidState(jnp.array([0.3, -0.8, 0.5]), jnp.array([1.0, 0.0, 0.0, 0.0]))
RAW = jax.random.PRNGKey(5)
SCALE, COUNT = jnp.array(0.3), jnp.array(4, jnp.int32)


def noise(key, count, scale, t, state):
    """White noise held over a quarter of a second, with a spring."""
    drawn = jax.random.normal(jax.random.fold_in(key, (count.astype(t.dtype) * t).astype(jnp.int32)), (3,))
    return scale * drawn - count.astype(t.dtype) * state.attitude[1:]


def energy(path):
    return jnp.sum(path.states.momentum[-1] ** 2)


def end(torque):
    return energy(ml.integrate("LIEMID[E2]", BODY, torque, START, dt=0.05, steps=12, save_every=12))


def end_adaptive(torque):
    path = ml.integrate_variable_step(
        "LIEMID[EA]", BODY, torque, START, density=lambda t, state: 1 + t * t, dt=0.05, steps=12, save_every=12
    )
    return energy(path)


@pytest.mark.sample(0)
@pytest.mark.parametrize("run", [end, end_adaptive])
def test_derivatives_pass_by_keys_and_integers(run):
    """Reverse, mapped over keys, is forward; by an integer there is none; a typed key is as good as a raw one."""

    def result(scale, count, key):
        return run(jax.tree_util.Partial(noise, key, count, scale))

    def results(raw):
        typed = jax.random.wrap_key_data(raw)
        reverse = jax.value_and_grad(result, (0, 1), allow_int=True)
        values, (slopes, none) = jax.vmap(reverse, (None, None, 0))(SCALE, COUNT, typed)
        assert none.dtype == jax.dtypes.float0
        forward = jax.jvp(lambda scale: result(scale, COUNT, typed[0]), (SCALE,), (jnp.ones_like(SCALE),))
        return values, slopes, *forward, result(SCALE, COUNT, raw[0])

    values, slopes, value, slope, by_raw = quick(results)(jnp.stack([RAW, RAW + 1]))
    assert abs(slopes[0] - slopes[1]) > 1e-3
    np.testing.assert_allclose(slopes[0], slope, rtol=1e-12)
    np.testing.assert_allclose([values[0], value], by_raw, rtol=1e-12)


ROUND = ml.RigidBody(jnp.array([1.5, 1.5, 2.5]))
DT, STEPS = 1 / 64, 16


class Network(eqx.Module):
    layers: eqx.nn.MLP

    def __call__(self, t, state):
        return self.layers(state.attitude)


class Hybrid(Network):
    """A network that corrects a formula, in one function."""

    def __call__(self, t, state):
        return ml.torques.HeavyTop(2.0)(t, state) + super().__call__(t, state)


def layers(width, out=3):
    return eqx.nn.MLP(4, out, width, depth=2, activation=jnp.tanh, key=jax.random.key(0))


TORQUES = {
    "network": lambda width: Network(layers(width)),
    "hybrid": lambda width: Hybrid(layers(width)),
    "potential": lambda width: ml.torques.FromPotential(
        jax.tree_util.Partial(lambda net, t, s: net(s.attitude)[0], layers(width, 1))
    ),
}


def starts(count=3):
    turns = 0.3 * jax.random.normal(jax.random.key(1), (count, 3))
    return jax.vmap(lambda turn: ml.RigidState(jnp.array([1.0, 0.8, -1.3]), ml.so3.exp(turn)))(turns)


def operations(function):
    """The shapes of all results in the trace of a function of attitudes, evaluated on components."""

    def entries(q):
        return by_components(function, jnp.asarray(0.5), Packed(q))[0]

    equations = jax.make_jaxpr(entries)((jnp.asarray(0.5),) * 4).jaxpr.eqns
    types: list[Any] = [v.aval for equation in equations for v in equation.outvars]
    return [type_.shape for type_ in types]


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", TORQUES)
def test_a_wider_network_is_no_longer_program(name):
    torques = [TORQUES[name](width) for width in (4, 64)]
    short, long = (operations(lambda t, q, f=f: f(t, ml.RigidState(jnp.ones(3), q))) for f in torques)
    assert len(short) == len(long)


@pytest.mark.parametrize("name", ["einsum_trace", "matrix_product", "exp_log"])
def test_a_long_formula_stays_on_scalars(name):
    shapes = operations(lambda t, q: FUNCTIONS[name](t, q[1:], q))
    assert len(shapes) > 80
    assert set(shapes) == {()}


def run(torque, start, adjoint=None):
    run = {"dt": DT, "steps": STEPS, "save_every": None, "adjoint": adjoint}
    return ml.integrate("SYMMETRIC[EA]", ROUND, torque, start, **run).states


@pytest.mark.sample(0)
def test_a_run_under_a_network_may_be_mapped():
    torque = TORQUES["network"](8)
    mapped = quick(jax.vmap(lambda start: run(torque, start)))(starts())
    many = ml.ensemble("SYMMETRIC[EA]", ROUND, torque, starts(), dt=DT, steps=STEPS, torque_axes=None).states
    solo = quick(partial(run, torque))(jax.tree.map(lambda x: x[0], starts()))
    for alone, row, member in zip(*map(jax.tree.leaves, (solo, mapped, many)), strict=True):
        np.testing.assert_allclose(row[0], alone, atol=1e-14)
        np.testing.assert_allclose(member, row, atol=1e-14)


@pytest.mark.sample(0)
def test_each_mode_has_the_gradient_of_a_network():
    arrays, rest = eqx.partition(TORQUES["network"](8), eqx.is_array)
    start = jax.tree.map(lambda x: x[0], starts())

    def loss(arrays, adjoint):
        return jnp.sum(jnp.sin(run(eqx.combine(arrays, rest), start, adjoint).momentum))

    direction = jax.tree.map(lambda x: jnp.cos(jnp.arange(x.size, dtype=x.dtype)).reshape(x.shape), arrays)
    value = quick(partial(loss, adjoint=ml.adjoints.Forward()))
    a, b, c, d = (
        value(jax.tree.map(lambda x, d, s=s: x + s * d, arrays, direction)) for s in (2e-3, 1e-3, -1e-3, -2e-3)
    )
    expected = (-a + 8 * b - 8 * c + d) / 12e-3
    _, slope = quick(lambda a, d: jax.jvp(partial(loss, adjoint=ml.adjoints.Forward()), (a,), (d,)))(arrays, direction)
    np.testing.assert_allclose(slope, expected, rtol=1e-7)
    gradient = quick(jax.grad(partial(loss, adjoint=ml.adjoints.Reversible())))(arrays)
    total = sum(jax.tree.leaves(jax.tree.map(lambda g, d: jnp.sum(g * d), gradient, direction)))
    np.testing.assert_allclose(total, slope, rtol=1e-11)
