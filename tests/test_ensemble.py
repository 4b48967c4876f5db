"""The batch driver: the same motions as `integrate`, however the batch is cut, and errors that name the cure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import epsilon, quick

import midlie_jax as ml

COUNT, STEPS = 7, 12
METHOD = "LIEMID[E2]"
RNG = np.random.default_rng(3)
MOMENTS = 2 + RNG.uniform(size=(COUNT, 3))
WEIGHTS = RNG.uniform(1, 3, size=COUNT)
DTS = RNG.uniform(0.01, 0.03, size=COUNT)
T0S = RNG.uniform(0, 1, size=COUNT)


def starts(dtype=np.float64):
    turns, momenta = RNG.normal(size=(COUNT, 3)), RNG.normal(size=(COUNT, 3))
    return ml.RigidState(jnp.asarray(momenta, dtype), ml.so3.exp(jnp.asarray(turns, dtype)))


START = starts()


def row(tree, i):
    return jax.tree.map(lambda x: x[i], tree)


def alone(i, dtype, save_every):
    """The i-th of the bodies that differ in everything."""
    return ml.integrate(
        METHOD,
        ml.RigidBody(jnp.asarray(MOMENTS[i], dtype)),
        ml.torques.HeavyTop(jnp.asarray(WEIGHTS[i], dtype)),
        jax.tree.map(lambda x: x.astype(dtype), row(START, i)),
        dt=jnp.asarray(DTS[i], dtype),
        t0=jnp.asarray(T0S[i], dtype),
        steps=STEPS,
        save_every=save_every,
    )


def together(dtype, save_every, chunk):
    return ml.ensemble(
        METHOD,
        ml.RigidBody(jnp.asarray(MOMENTS, dtype)),
        jax.vmap(ml.torques.HeavyTop)(jnp.asarray(WEIGHTS, dtype)),
        jax.tree.map(lambda x: x.astype(dtype), START),
        dt=jnp.asarray(DTS, dtype),
        t0=jnp.asarray(T0S, dtype),
        steps=STEPS,
        save_every=save_every,
        torque_axes=0,
        chunk=chunk,
    )


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_each_body_moves_as_it_would_alone(dtype):
    path = together(dtype, 4, 3)
    assert path.times.shape == (COUNT, 4)
    assert path.states.momentum.shape == (COUNT, 4, 3)
    assert path.ok.shape == (COUNT,)
    assert np.all(path.ok)
    for i in (0, COUNT - 1):
        solo = alone(i, dtype, 4)
        for mine, its in zip(jax.tree.leaves(row(path, i)), jax.tree.leaves(solo), strict=True):
            assert mine.dtype == its.dtype
            np.testing.assert_allclose(mine, its, rtol=0, atol=4 * STEPS * epsilon(dtype))


def test_the_cut_changes_nothing_and_the_end_is_the_end():
    """A cut that fills its last chunk, one that does not, and none: the same to rounding; the end alone, too."""
    whole = together("float64", 4, 100)
    for chunk in (1, 3):
        for mine, its in zip(jax.tree.leaves(together("float64", 4, chunk)), jax.tree.leaves(whole), strict=True):
            np.testing.assert_allclose(mine, its, rtol=0, atol=4 * STEPS * epsilon("float64"))
    end = together("float64", None, 3)
    assert end.states.attitude.shape == (COUNT, 1, 4)
    assert end.times.shape == (COUNT, 1)
    last = jax.tree.map(lambda x: x[:, -1:], (whole.times, whole.states))
    for mine, its in zip(jax.tree.leaves((end.times, end.states)), jax.tree.leaves(last), strict=True):
        np.testing.assert_allclose(mine, its, rtol=0, atol=4 * STEPS * epsilon("float64"))


def test_shared_arguments_and_the_gradient():
    """One body, torque and step for all: times are shared, and the gradient is the sum of those of the bodies."""
    body, dt = ml.RigidBody(jnp.asarray(MOMENTS[0])), 0.02

    def cut(weight):
        path = ml.ensemble(METHOD, body, ml.torques.HeavyTop(weight), START, dt=dt, steps=STEPS, chunk=2)
        assert path.times.shape == (1,)
        return jnp.sum(path.states.momentum**2)

    def mapped(weight):
        def one(start):
            path = ml.integrate(METHOD, body, ml.torques.HeavyTop(weight), start, dt=dt, steps=STEPS)
            return jnp.sum(path.states.momentum[-1] ** 2)

        return jnp.sum(jax.vmap(one)(START))

    weight = jnp.asarray(2.0)
    by_cut, by_map = quick(lambda w: (jax.grad(cut)(w), jax.grad(mapped)(w)))(weight)
    np.testing.assert_allclose(by_cut, by_map, rtol=1e-12)


def test_failures_are_those_of_the_bodies():
    """A body that is spun too fast for its step says so; its neighbours do not."""
    fast = ml.RigidState(START.momentum.at[2].multiply(1e5), START.attitude)
    path = ml.ensemble(METHOD, ml.RigidBody(jnp.asarray(MOMENTS[0])), None, fast, dt=0.02, steps=STEPS, chunk=3)
    assert list(np.flatnonzero(~np.asarray(path.ok))) == [2]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": row(START, 0)}, "start.momentum must be .n, 3."),
        ({"body": ml.RigidBody(jnp.asarray(MOMENTS[:3]))}, "body.moments has 3 rows, but start.momentum has 7"),
        ({"dt": jnp.ones(3)}, "dt has 3 rows"),
        ({"t0": jnp.ones((7, 2))}, "t0 must be"),
        ({"chunk": 0}, "chunk must be a positive"),
        ({"save_every": 5}, "divisible"),
        ({"dt": jnp.nan}, "dt must"),
    ],
)
def test_bad_arguments_are_named(changes, message):
    given = {"body": ml.RigidBody(jnp.asarray(MOMENTS[0])), "torque": None, "start": START, "dt": 0.02, "steps": STEPS}
    given |= changes
    with pytest.raises(ValueError, match=message):
        ml.ensemble(METHOD, given.pop("body"), given.pop("torque"), given.pop("start"), **given)
