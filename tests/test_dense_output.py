"""States between the steps of diffrax: by a cubic of third order, and by shorter steps with the order of the method."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from cases import QUICK, epsilon, quick, whole
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from test_diffrax import ARGS, BODY, CASE, DT, FACTORS, FROM, SIZES, T0, TERM, row, solve, start, truth

import midlie_jax as ml
from midlie_jax.cli.oracle import exact_motion
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
    assert np.all(slopes[:, :2] > 2.8)
    assert np.all(slopes[:, 2:] > 1.8)


def spun(turn):
    """A steady spin: the state after a turn about the third axis, and its angular velocity."""
    return ml.RigidState(jnp.array([0.0, 0.0, 2.5]), ml.so3.exp(jnp.array([0.0, 0.0, turn]))), jnp.array(
        [0.0, 0.0, 1.0]
    )


@pytest.mark.sample(0)
def test_dense_output_of_a_long_turn_is_right_or_nan():
    """Up to 8.8 radians the attitude of a steady spin is true, above there is none; a controller keeps below."""
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


# ---- by shorter steps ----


def gaps(a, b):
    return max(np.max(np.abs(x - y)) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


def by_step(name):
    return ml.diffrax.LieSolver(name, dense="step")


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["JACOBI[SRKN6b]", "RK4"])
def test_inside_a_step_the_error_is_that_of_a_step(name):
    @eqx.filter_jit(compiler_options=QUICK)
    def inside(h, part):
        solution = solve(
            by_step(name), start(), t0=FROM, t1=FROM + h, dt0=h, saveat=diffrax.SaveAt(dense=True), max_steps=1
        )
        return solution.evaluate(FROM + part * h)

    errors = []
    for h in (1 / 16, 1 / 32):
        exact = jax.tree.map(lambda x: x[0], truth(FROM + 0.6 * h))
        errors.append(gaps(inside(jnp.array(h), jnp.array(0.6)), exact))
    slope = np.log2(errors[0] / errors[1])
    assert slope > ml.method(name).order + 0.8


@pytest.mark.sample(0)
def test_every_way_of_asking_gives_the_state_of_a_shorter_step():
    """Saved times and the whole solution, mapped over a batch, for a body in a frame of its own."""
    turned = ml.so3.to_matrix(ml.so3.exp(jnp.array([0.3, -0.2, 0.5])))
    body = ml.TensorBody(turned @ jnp.diag(jnp.asarray(CASE.moments)) @ turned.T)
    torque, parts = ml.torques.HeavyTop, np.array([0.0, 0.3, 1.0, 1.7, 2.0])
    term = ml.diffrax.RigidBodyTerm(body, torque_of_args=torque)

    def states(weight, y, saveat):
        options = {"term": term, "t1": T0 + 2 * DT, "saveat": saveat, "max_steps": 4}
        return solve(by_step("LIEMID[EA]"), y, weight, **options)

    def both(y):
        saved = states(ARGS[0], y, diffrax.SaveAt(ts=T0 + DT * parts)).ys
        return saved, jax.vmap(states(ARGS[0], y, diffrax.SaveAt(dense=True)).evaluate)(T0 + DT * parts)

    @quick
    def step(state, t, h):
        path = ml.integrate("LIEMID[EA]", body, torque(ARGS[0]), state, dt=h, steps=1, t0=t)
        return jax.tree.map(lambda x: x[-1], path.states)

    middle = step(start(), T0, DT)
    expected = [
        start(),
        step(start(), T0, 0.3 * DT),
        middle,
        step(middle, T0 + DT, 0.7 * DT),
        step(middle, T0 + DT, DT),
    ]
    expected = jax.tree.map(lambda *x: jnp.stack(x), *expected)
    for found in quick(jax.vmap(both))(jax.tree.map(lambda x: jnp.stack([x, x]), start())):
        assert gaps(row(found, 1), expected) < 1e-14


def north(t, y, args, **kwargs):
    """Where the axis of the top stands over the plane x = 0."""
    return ml.so3.to_matrix(y.attitude)[0, 2]


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("derivative", "adjoint"),
    [(jax.jacfwd, diffrax.ForwardMode()), *whole((jax.grad, diffrax.RecursiveCheckpointAdjoint()))],
)
def test_an_event_has_the_error_of_the_method_and_a_derivative(derivative, adjoint):
    """A crossing of Lagrange's top in closed form; the cubic is wrong by much more at the same step."""
    moments, axis, weight = (1.5, 1.5, 2.5), (0.0, 0.0, 1.0), float(ARGS[0])
    term = ml.diffrax.RigidBodyTerm(
        ml.RigidBody(jnp.array(moments)), torque_of_args=lambda w: ml.torques.HeavyTop(w, axis)
    )
    event = diffrax.Event(north, optimistix.Newton(1e-13, 1e-13), direction=False)

    def crossing(weight, dense):
        solver = ml.diffrax.LieSolver("SYMMETRIC[SRKN6b]", dense=dense)
        times = {"t0": jnp.array(0.0), "t1": jnp.array(8.0), "dt0": jnp.array(1 / 32)}
        solution = solve(solver, start(), weight, term=term, event=event, adjoint=adjoint, **times)
        return solution.ts[0], row(solution.ys, 0)

    def x(t, weight):
        _, (q,) = exact_motion(moments, CASE.momentum, CASE.attitude, [t], weight=weight)
        return Rotation.from_quat(q, scalar_first=True).as_matrix()[0, 2]

    def value(weight):
        time, state = crossing(weight, "step")
        return time, (time, state)

    slope, (time, state) = quick(derivative(value, has_aux=True))(ARGS[0])
    cubic, _ = quick(lambda w: crossing(w, "cubic"))(ARGS[0])

    def exact(weight):
        return brentq(x, float(time) - 0.01, float(time) + 0.01, (weight,), xtol=1e-14, rtol=1e-14)

    expected = sum(f * exact(weight + s) for f, s in zip(FACTORS, SIZES, strict=True) if f)
    error, coarse = abs(time - exact(weight)), abs(cubic - exact(weight))
    assert 50 * error < coarse
    assert error < 1e-8
    assert abs(north(time, state, None)) < 1e-12
    assert abs(slope - expected) < 1e-6 * abs(expected)


def test_a_wrong_dense_output_names_the_cure():
    with pytest.raises(ValueError, match='dense must be "cubic" or "step", got'):
        ml.diffrax.LieSolver(dense="linear")
