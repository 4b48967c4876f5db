"""States between the steps of diffrax: their order, how long a turn may be, and states without attitude."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS, QUICK, epsilon, quick
from diffrax_cases import ARGS, BODY, DT, FROM, STEPS, T0, TERM, solve, start
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax.diffrax.dense import LARGEST_TURN

INSIDE = np.linspace(0.05, 0.95, 7)


@pytest.mark.sample(1)
def test_dense_output_is_on_the_group_and_of_third_order_inside_a_step():
    @eqx.filter_jit(compiler_options=QUICK)
    def step(h):
        solution = solve(
            "LIEMID[EA]", start(), t0=FROM, t1=FROM + h, dt0=h, saveat=diffrax.SaveAt(dense=True), max_steps=1
        )
        times = FROM + h * INSIDE
        return jax.vmap(solution.evaluate)(times), jax.vmap(solution.derivative)(times)

    rate = quick(lambda t, y: TERM.vf(t, y, ARGS).ambient)

    def exact(times):
        """States and their derivatives, by SciPy."""

        def flat(t, y):
            return np.concatenate(jax.tree.leaves(rate(t, ml.RigidState(y[:3], y[3:]))))

        begin = np.concatenate(jax.tree.leaves(start()))
        y = solve_ivp(flat, (T0, times[-1]), begin, "DOP853", t_eval=times, rtol=1e-12, atol=1e-13).y.T
        return y[:, :3], y[:, 3:], *np.hsplit(np.array([flat(t, x) for t, x in zip(times, y, strict=True)]), [3])

    errors = []
    for h in (1 / 8, 1 / 16, 1 / 32):
        got = step(jnp.array(h))
        assert np.max(np.abs(np.linalg.norm(got[0].attitude, axis=-1) - 1)) < 4 * epsilon("float64")
        exactly = exact(T0 + h * INSIDE)
        errors.append([np.max(np.abs(a - b)) for a, b in zip(jax.tree.leaves(got), exactly, strict=True)])
    slopes = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    print("order of momentum, attitude and their derivatives inside a step:", slopes)
    assert np.all(slopes[:, :2] > 2.8)
    assert np.all(slopes[:, 2:] > 1.8)


def spun(turn):
    """A steady spin: the state after a turn about the third axis, and its angular velocity."""
    return ml.RigidState(jnp.array([0.0, 0.0, 2.5]), ml.so3.exp(jnp.array([0.0, 0.0, turn]))), jnp.array(
        [0.0, 0.0, 1.0]
    )


@pytest.mark.sample(0)
def test_dense_output_of_a_long_turn_is_right_or_nan():
    """Up to 8.8 radians the attitude of a steady spin is the true one, above there is none; a controller keeps below.

    Nor is there one where the ends differ from a steady turn by more than a quarter of a turn.
    """
    for turn in (0.0, 3.1, -3.1, 3.2, 6.0, 2 * np.pi, -8.7, 8.9):
        (y0, spin), (y1, _) = spun(0.0), spun(turn)
        for gap in (0.0, 1.5, -1.5, 1.6, -1.6):
            velocities = {"velocity0": spin, "velocity1": spin, "torque0": 0 * spin, "torque1": 0 * spin}
            times = {"t0": jnp.array(0.0), "t1": jnp.array(1.0), "h": jnp.array(turn + gap)}
            inside = ml.diffrax.LieInterpolation(**times, y0=y0, y1=y1, **velocities).evaluate(0.3)
            if abs(turn + gap) > LARGEST_TURN or abs(gap) > np.pi / 2:
                assert np.all(np.isnan(inside.attitude))
            elif gap == 0:
                np.testing.assert_allclose(inside.attitude, spun(0.3 * turn)[0].attitude, atol=4e-15)
                np.testing.assert_allclose(inside.momentum, y0.momentum, atol=4e-15)
            else:
                np.testing.assert_allclose(np.linalg.norm(inside.attitude), 1, atol=4e-16)

    times = T0 + jnp.linspace(0.0, 20.0, 41)
    controller = diffrax.PIDController(rtol=0.0, atol=1e-6, norm=ml.diffrax.RotationNorm())
    options = {"t1": times[-1], "stepsize_controller": controller, "saveat": diffrax.SaveAt(ts=times)}
    found = quick(lambda y: solve("LIEMID[EA]", y, term=ml.diffrax.RigidBodyTerm(BODY), **options))(spun(0.0)[0])
    assert found.stats["num_accepted_steps"] < 20
    for time, matrix in zip(times, jax.vmap(ml.so3.to_matrix)(found.ys.attitude), strict=True):
        np.testing.assert_allclose(matrix, ml.so3.to_matrix(spun(time - T0)[0].attitude), atol=1e-13)


def only_the_top(weight):
    return ml.torques.HeavyTop(weight, AXIS)


@pytest.mark.sample(0)
@pytest.mark.parametrize("state", [ml.DirectionState, ml.MomentumState])
def test_states_without_attitude(state):
    """Agree with the full state, between steps too."""
    weight = ARGS[0] if state is ml.DirectionState else jnp.array(0.0)
    top = ml.diffrax.RigidBodyTerm(BODY, torque_of_args=only_the_top)
    up = ml.so3.to_matrix(start().attitude)[2]
    few, term = (
        (state(start().momentum, up), top) if weight else (state(start().momentum), ml.diffrax.RigidBodyTerm(BODY))
    )
    saveat = diffrax.SaveAt(ts=jnp.linspace(T0, T0 + DT * STEPS, 23))
    less, full = quick(
        lambda weight: (
            solve("LIEMID[EA]", few, weight, term=term, saveat=saveat).ys,
            solve("LIEMID[EA]", start(), weight, term=top, saveat=saveat).ys,
        )
    )(weight)
    assert np.max(np.abs(less.momentum - full.momentum)) < 1e-7  # two cubics that differ in the fourth order
    if state is ml.DirectionState:
        assert np.max(np.abs(less.direction - jax.vmap(ml.so3.to_matrix)(full.attitude)[:, 2])) < 1e-7
