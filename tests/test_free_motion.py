"""`free_motion`: exact at any time against the closed form in many digits, for every kind of body and state."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, epsilon, quick, real
from laboratory.free_body import free_body

import midlie_jax as ml

ONE = [1.0, 0.0, 0.0, 0.0]
SPECIAL = {
    "near the separatrix": ([1, 2, 3], [1e-9, 1, 1e-8]),
    "on the separatrix": ([3, 4, 6], [1, 0.3, 1]),
    "on it, the other way": ([6, 3, 4], [1, -1, 0.3]),
    "low axis": ([1, 2, 3], [1, 0, 0]),
    "middle axis": ([1, 2, 3], [0, 1, 0]),
    "high axis": ([1, 2, 3], [0, 0, -1]),
    "oblate": ([2, 2, 3], [0.3, 0.4, 0.9]),
    "prolate": ([3, 2, 3], [0.3, 0.4, 0.9]),
    "symmetric, about its axis": ([2, 2, 3], [0, 0, 1]),
    "symmetric, about its equator": ([2, 2, 3], [0.6, 0.8, 0]),
    "nearly symmetric": ([2, 2 * (1 + 1e-13), 3], [0.3, 0.4, 0.9]),
    "ball": ([2, 2, 2], [0.3, 0.4, 0.9]),
    "nearly a ball": ([2, 2 + 1e-14, 2 - 1e-12], [0.3, 0.4, 0.9]),
    "disc": ([1, 1, 2], [0.3, 0.4, 0.9]),
    "any disc": ([1, 2, 3], [0.2, 0.5, -0.6]),
    "rod": ([0.05, 1, 1], [0.05, 0.8, 0.3]),
    "at rest": ([1, 2, 3], [0, 0, 0]),
}
TURNS = np.array([0, 1e-3, 0.1, -0.7, 1.0, 5.0, -20.0, 1e2, 1e3, -1e4, 1e6])


def bodies():
    """The special bodies, and some at random in any order of moments."""
    rng = np.random.default_rng(1)
    masses = rng.uniform(0.1, 1, (15, 3))
    moments = np.concatenate([[i for i, _ in SPECIAL.values()], masses.sum(1, keepdims=True) - masses])
    return moments, np.concatenate([[p for _, p in SPECIAL.values()], rng.normal(size=(15, 3))])


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_it_is_the_closed_form(dtype):
    """To 8 eps (1 + Omega |t|), times what a long body magnifies; the sign of the quaternion follows the motion."""
    moments, momentum = (x.astype(dtype) for x in bodies())
    omega = np.sqrt(np.sum(momentum**2 / moments, axis=-1) / moments.min(axis=-1))  # the bound of the angular velocity
    times = (2 * np.pi * TURNS / np.where(omega == 0, 1, omega)[:, None]).astype(dtype)

    def run(moments, momentum, times):
        return ml.free_motion(ml.RigidBody(moments), ml.RigidState(momentum, jnp.array(ONE, momentum.dtype)), times)

    path = jax.tree.map(np.asarray, real(jax.vmap(run))(moments, momentum, times))
    assert path.ok.all()
    for row in range(len(moments)):
        exact = free_body(*(x[row].astype(float) for x in (moments, momentum)), ONE, times[row].astype(float))
        allowed = 8 * epsilon(dtype) * (1 + omega[row] * np.abs(times[row]))
        allowed *= 4 if moments[row].min() < 0.1 else 1
        size = np.linalg.norm(momentum[row])
        assert np.all(np.linalg.norm(path.states.momentum[row] - exact[0], axis=1) <= allowed * size), row
        assert np.all(np.linalg.norm(path.states.attitude[row] - exact[1], axis=1) <= allowed), row
        np.testing.assert_array_equal(path.states.momentum[row, 0], momentum[row])


def test_near_the_separatrix_it_is_the_motion_of_data_that_differ_by_rounding():
    """The error is no more than what changes of the momentum by some eps make, measured by the closed form."""
    moments = np.array([1.0, 2.0, 3.0])
    times, rng = np.array([3.0, 30.0, 300.0]), np.random.default_rng(4)
    run = real(lambda p: ml.free_motion(ml.RigidBody(moments), ml.MomentumState(p), times).states.momentum)
    for distance in (1e-3, 1e-6, -1e-9, 1e-12):
        momentum = np.array([0.6 / 3**0.5 * (1 + distance), 0.3, 0.6])
        exact, _ = free_body(moments, momentum, ONE, times)
        moved = [momentum * (1 + 4 * epsilon("float64") * rng.uniform(-1, 1, 3)) for _ in range(6)]
        swing = np.max([np.abs(free_body(moments, p, ONE, times)[0] - exact).max(axis=1) for p in moved], axis=0)
        error = np.abs(np.asarray(run(momentum)) - exact).max(axis=1)
        assert np.all(error <= swing + 8 * epsilon("float64") * (1 + times)), (distance, error, swing)


@pytest.mark.sample(0)
def test_every_state_and_a_tensor_body_move_alike():
    """And as `integrate` moves them; a tensor body in its own frame."""
    axes = ml.so3.to_matrix(ml.so3.exp(jnp.array([0.3, -0.5, 0.9])))
    tensor = ml.TensorBody(axes @ jnp.diag(jnp.array([1.0, 2.0, 2.6])) @ axes.T)
    times, momentum, direction = jnp.array([0.5, 2.0]), jnp.array([0.3, 1.1, -0.4]), jnp.array([0.0, 0.6, 0.8])
    states = ml.RigidState(momentum, jnp.array([0.5, 0.5, -0.5, 0.5])), ml.DirectionState(momentum, direction)
    for body in (ml.RigidBody([1.0, 2.0, 2.6]), tensor):
        for start in (*states, ml.MomentumState(momentum)):
            found = ml.free_motion(body, start, times)
            run = ml.integrate("JACOBI[EA]", body, None, start, dt=0.25, steps=8, save_every=2)
            assert found.ok
            assert type(found.states) is type(start)
            after = jax.tree.map(lambda x: x[jnp.array([1, 4])], run.states)
            jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=0, atol=3e-15), found.states, after)


@pytest.mark.sample(0)
def test_its_derivatives_are_differences():
    """In moments, momentum and time together, forward and in reverse."""
    move, times = np.random.default_rng(2).normal(size=7), jnp.array([0.7, 40.0])

    def along(s):
        body = ml.RigidBody(jnp.array([1.0, 2.0, 2.6]) * (1 + 0.1 * s * move[:3]))
        start = ml.RigidState(jnp.array([0.3, 1.1, -0.4]) + s * move[3:6], jnp.array(ONE))
        states = ml.free_motion(body, start, times + s * move[6]).states
        return jnp.concatenate([states.momentum.ravel(), states.attitude.ravel()])

    forward, step, value = quick(jax.jacfwd(along))(0.0), 1e-4, quick(along)
    a, b, c, d = (value(k * step) for k in (-2.0, -1.0, 1.0, 2.0))
    np.testing.assert_allclose(forward, (a - 8 * b + 8 * c - d) / (12 * step), rtol=0, atol=1e-7)
    np.testing.assert_allclose(quick(jax.jacrev(along))(0.0), forward, rtol=1e-13, atol=1e-13)


@pytest.mark.sample(0)
def test_what_cannot_be_exact_says_so():
    body, start = ml.RigidBody([1.0, 2.0, 3.0]), ml.RigidState([1.0, 0.2, 0.3], ONE)
    assert not ml.free_motion(body, start, [1.0, 1e17]).ok
    thin = ml.RigidBody([1e-6, 1.0, 1.0])
    spinning = jnp.array([1e-6, 0.8, 0.3])
    assert not ml.free_motion(thin, ml.RigidState(spinning, ONE), [1.0]).ok
    assert ml.free_motion(thin, ml.MomentumState(spinning), [1.0]).ok


@pytest.mark.parametrize(
    ("body", "momentum", "times", "message"),
    [
        (ml.Particles(1.0), [1.0, 2.0, 3.0], [1.0], "belongs to a RigidBody, but body is Particles"),
        (ml.RigidBody([1.0, 2.0, 2.5]), [1.0, 2.0, 3.0], [np.nan], "times must be finite"),
        (ml.RigidBody([1.0, 2.0, 2.5]), [1.0, 2.0, 3.0], [[1.0]], r"times must have shape \(n,\), got \(1, 1\)"),
        (ml.RigidBody([1.0, 2.0, 2.5]), [[1.0, 2.0, 3.0]] * 2, [1.0], r"start.momentum must be \(3,\)"),
    ],
)
def test_bad_arguments_are_named(body, momentum, times, message):
    with pytest.raises(ValueError, match=message):
        ml.free_motion(body, ml.MomentumState(momentum), times)
