"""Torques with leaves that are no floats: keys of random numbers, typed and raw, and integers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick

import midlie_jax as ml
from midlie_jax._xla.fusion import begin, cut, fuse, fuse_derivative, split

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


@pytest.mark.parametrize("held", [begin, fuse, split, cut, fuse_derivative])
def test_what_holds_outputs_together_is_the_identity_on_any_leaf(held):
    leaves = {
        "key": jax.random.key(3),
        "keys": jax.random.split(jax.random.key(3), 2),
        "truth": jnp.array([True, False]),
        "integers": jnp.array([3, -4], jnp.int8),
        "floats": jnp.array([0.5, jnp.nan]),
        "half": jnp.array(0.5, jnp.float16),
        "complex": jnp.array([1 + 2j, 3.0]),
        "nothing": jnp.zeros((0, 3)),
    }
    for found in (held(leaves), jax.jit(held)(leaves)):
        for name, leaf in leaves.items():
            plain = [jax.random.key_data(x) if "key" in name else x for x in (found[name], leaf)]
            np.testing.assert_array_equal(*plain)
            assert found[name].dtype == leaf.dtype
