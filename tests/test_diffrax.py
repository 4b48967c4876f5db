"""The methods inside diffrax: their orders, error estimates, failures and messages.

`test_dense_output.py` has the states between the steps, and `test_diffrax_matrix.py` holds all to `integrate`.
"""

import re
from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from cases import AXIS, epsilon, quick, real
from diffrax_cases import (
    ARGS,
    BODY,
    CASE,
    CONTROLLERS,
    DT,
    FROM,
    STEPS,
    T0,
    TERM,
    TO,
    TS,
    end,
    forces,
    problem,
    row,
    solve,
    start,
    truth,
)
from scipy.spatial.transform import Rotation

import midlie_jax as ml


def numbers(state):
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(state)])


FREE = (jnp.array(0.0), jnp.array(0.0))


@pytest.mark.sample(0)
def test_one_term_under_several_solvers_agrees_at_their_orders():
    """And who keeps the spatial momentum of a free body: ours to rounding, theirs by their orders."""
    newton = optimistix.Newton(rtol=1e-11, atol=1e-11)
    solvers = [
        (diffrax.Tsit5(), 5),
        (diffrax.Kvaerno5(root_finder=newton), 5),
        (ml.diffrax.LieSolver("LIEMID[EA]"), 2),
    ]
    exact, before = numbers(truth()), np.asarray(ml.observe.spatial_momentum(start()))
    drifts = []
    print(f"{'solver':12} {'error at 1/8':>12} {'order':>6} {'drift of R Pi':>14}")
    for solver, order in solvers:
        errors = []
        for dt in (1 / 8, 1 / 16):
            solution = end(solver, start(), ARGS, FROM, TO, jnp.array(dt))
            assert bool(solution.result == diffrax.RESULTS.successful)
            errors.append(np.max(np.abs(numbers(solution.ys) - exact)))
        slope = np.log2(errors[0] / errors[1])
        free = end(solver, start(), FREE, FROM, TO, jnp.array(1 / 4)).ys
        drifts.append(np.max(np.abs(ml.observe.spatial_momentum(jax.tree.map(lambda x: x[0], free)) - before)))
        print(f"{type(solver).__name__:12} {errors[0]:12.1e} {slope:6.2f} {drifts[-1]:14.1e}")
        assert abs(slope - order) < 0.6
    assert drifts[-1] < 8 * epsilon("float64")
    assert min(drifts[:-1]) > 100 * drifts[-1]


def test_norm_is_the_angle_between_attitudes():
    q = CASE.attitude
    turned = (Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec([3e-6, -4e-6, 0])).as_quat(
        scalar_first=True
    )
    state = ml.RigidState(jnp.array([0.0, 0.0, 2e-6]), jnp.asarray(q))
    error = eqx.tree_at(lambda s: s.attitude, state, jnp.asarray(turned - q))
    assert abs(ml.diffrax.RotationNorm()(error) - 5e-6) < 1e-15
    assert abs(ml.diffrax.RotationNorm(momentum=0.1)(error) - 2e-5) < 1e-18


# A method of each family; the orders of its estimate in momentum and attitude, and the span of estimate over error.
FAMILIES = {
    "LIEMID[E2]": (2, 2, 0.95, 1.05),
    "LIEMID[EA]": (3, 3, 0.95, 1.05),
    "NMB": (3, 3, 0.95, 1.05),
    "SYMMETRIC[SRKN6b]": (4, 5, 1.0, np.inf),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", FAMILIES)
def test_estimate_is_the_local_error_or_above(name):
    """On a second step; the first has no history, and an estimate of second order in the momentum."""
    solver, (term, y0) = ml.diffrax.LieSolver(name), problem(name)

    @quick
    @jax.vmap
    def first_two(h):
        state, rows = solver.init(term, FROM, FROM + h, y0, ARGS), []
        y, t = y0, FROM
        for _ in range(2):
            y1, error, _, state, _ = solver.step(term, t, t + h, y, ARGS, state, False)
            rows.append((t, y, y1, error))
            y, t = y1, t + h
        return rows

    def exact(t, y, h):
        ends = [
            end(diffrax.Dopri8(), row(y, i), ARGS, t[i], t[i] + h[i], h[i] / 4, term=term).ys for i in range(len(h))
        ]
        return jax.tree.map(lambda *x: jnp.concatenate(x), *ends)

    hs = jnp.array([1 / 32, 1 / 64])
    first, (t, y, y1, error) = first_two(hs)
    true = jax.tree.map(jnp.subtract, y1, exact(t, y, hs))
    sizes = [[np.linalg.norm(x, axis=-1) for x in jax.tree.leaves(e)] for e in (error, true, first[3])]
    ratio, slopes = np.divide(sizes[0], sizes[1]), np.log2(np.divide(*np.transpose(sizes)))
    momentum, attitude, least, most = FAMILIES[name]
    print(f"{name:18} estimate over error {ratio[:, 1]} at h = 1/64, orders {slopes[:, 0]}")
    assert np.all((ratio[:, 1] > least) & (ratio[:, 1] < most)), ratio
    assert np.all(np.abs(slopes[:, 0] - [momentum, attitude]) < 0.25)
    assert abs(slopes[0, 2] - 2) < 0.25
    assert solver.error_order(term) == min(momentum, attitude)


@pytest.mark.sample(0)
def test_failed_steps_are_rejected():
    """A first step too long for the flight's equation to be solved, with a controller and without."""
    solver, fast = ml.diffrax.LieSolver("LIEMID[EA]"), start(8.0)
    norm = ml.diffrax.RotationNorm(jnp.array(2.0), jnp.array(1.0))
    controller = diffrax.PIDController(rtol=0.0, atol=jnp.array(1e-5), norm=norm)
    solution = end(solver, fast, ARGS, FROM, TO, jnp.array(1.0), controller)
    assert bool(solution.result == diffrax.RESULTS.successful)
    assert int(solution.stats["num_rejected_steps"]) > 0
    solution = end(solver, fast, ARGS, FROM, TO, jnp.array(1.0))
    assert bool(solution.result == diffrax.RESULTS.nonlinear_divergence)
    # An overflow, with a tolerance that reads the state.
    controller = diffrax.PIDController(rtol=jnp.array(1e-5), atol=jnp.array(1e-5))
    solution = end(ml.diffrax.LieSolver("NMB"), start(50.0), ARGS, FROM, TO, jnp.array(1.0), controller)
    assert bool(solution.result == diffrax.RESULTS.successful)


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("name", "controller", "dense", "evaluations"),
    [("LIEMID[EA]", "PIDController", True, 1), ("LIEMID[EA*]", "PIDController", False, 2)],
)
def test_torque_evaluations(name, controller, dense, evaluations):
    """As `LieSolver` says, counted in the compiled program."""
    count = []

    def counted(x):
        count.append(1)
        return x

    def torque(t, state):
        like = jax.ShapeDtypeStruct((), t.dtype)
        return ml.torques.HeavyTop(jax.pure_callback(counted, like, 1 + 0 * state.vertical()[0]), AXIS)(t, state)

    saveat = TS if dense else diffrax.SaveAt(t1=True)
    options = CONTROLLERS[controller] | {"saveat": saveat}
    done = (
        quick(lambda y: solve(name, y, term=ml.diffrax.RigidBodyTerm(BODY, torque), **options).ys)
        .lower(start())
        .compile()
    )
    count.clear()
    jax.block_until_ready(done(start()))
    assert evaluations * STEPS <= len(count) <= evaluations * STEPS + 2


@pytest.mark.sample(0)
def test_the_rotation_norm_measures_the_state_on_the_way_back_of_backsolve():
    """There diffrax solves for the state, its adjoint and more together."""
    control = diffrax.PIDController(rtol=0, atol=1e-6, norm=ml.diffrax.RotationNorm())

    def value(weight):
        term = ml.diffrax.RigidBodyTerm(BODY, ml.torques.HeavyTop(weight))
        back = diffrax.BacksolveAdjoint(solver=diffrax.Tsit5())
        solution = diffrax.diffeqsolve(
            term, ml.diffrax.LieSolver("LIEMID[EA]"), 0.0, 0.5, 0.01, start(), adjoint=back, stepsize_controller=control
        )
        return jnp.sum(solution.ys.momentum**2)

    slope, h = quick(jax.grad(value))(2.0), 1e-3
    run = quick(value)
    assert slope == pytest.approx(float(run(2.0 + h) - run(2.0 - h)) / (2 * h), rel=1e-2)


@pytest.mark.sample(0)
def test_float32():
    cast = partial(jax.tree.map, lambda x: x.astype(jnp.float32) if eqx.is_array(x) else x)
    times = [jnp.float32(t) for t in (T0, T0 + 1, DT)]
    term = ml.diffrax.RigidBodyTerm(cast(BODY), torque_of_args=forces)
    y = diffrax.diffeqsolve(
        term,
        ml.diffrax.LieSolver("LIEMID[EA]"),
        *times,
        cast(start()),
        cast(ARGS),
        saveat=diffrax.SaveAt(ts=jnp.linspace(T0, T0 + 1, 30, dtype=jnp.float32)),
    ).ys
    assert y.momentum.dtype == y.attitude.dtype == jnp.float32
    assert np.max(np.abs(np.linalg.norm(np.asarray(y.attitude, np.float64), axis=-1) - 1)) < 4 * epsilon("float32")
    exact = end(ml.diffrax.LieSolver("LIEMID[EA]"), start(), ARGS, FROM, TO, jnp.array(DT)).ys
    assert np.max(np.abs(numbers(jax.tree.map(lambda x: x[-1], y)) - numbers(exact))) < 1e-5
    with pytest.raises(ValueError, match="give t0, t1 and dt0 as"):
        diffrax.diffeqsolve(term, ml.diffrax.LieSolver(), T0, T0 + 1, DT, cast(start()), cast(ARGS))


@pytest.mark.sample(0)
def test_kept_torque_is_renewed_after_a_jump(capfd):
    def push(t):
        return jnp.where(t < 0.75, jnp.zeros_like(t), 3 * jnp.ones_like(t)) * jnp.ones(3)

    term = ml.diffrax.RigidBodyTerm(BODY, ml.torques.Prescribed(push))
    same = diffrax.PIDController(rtol=0.0, atol=1e6, dtmax=DT)
    clip = diffrax.ClipStepSizeController(same, jump_ts=jnp.array([0.75]))
    meter = diffrax.TextProgressMeter(minimum_increase=0.5)
    once = solve("LIEMID[EA]", start(), term=term, t1=T0 + 1, stepsize_controller=clip, progress_meter=meter).ys
    assert "100.00%" in capfd.readouterr().out
    free = ml.integrate("LIEMID[EA]", BODY, None, start(), dt=DT, steps=32, save_every=32)
    pushed = ml.torques.Prescribed(lambda t: 3 * jnp.ones(3, t.dtype))
    middle = jax.tree.map(lambda x: x[-1], free.states)
    path = ml.integrate("LIEMID[EA]", BODY, pushed, middle, dt=DT, steps=32, save_every=32)
    assert np.max(np.abs(numbers(once) - numbers(jax.tree.map(lambda x: x[-1], path.states)))) < 1e-13


@pytest.mark.parametrize("name", ["LIEMID[EA]"])
def test_a_step_hands_few_numbers_to_its_reverse_derivative(name):
    """Each is a loop of its own in the program of diffrax; without a checkpoint there are over a hundred."""
    solver, y0 = ml.diffrax.LieSolver(name), start()

    def pullback(y, args):
        memory = solver.init(TERM, FROM, FROM + DT, y, args)
        return jax.vjp(lambda y, args: solver.step(TERM, FROM, FROM + DT, y, args, memory, False)[0], y, args)[1]

    assert len(jax.tree.leaves(jax.eval_shape(pullback, y0, ARGS))) < 60


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="`fuse` makes these loops on CPUs alone")
@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["LIEMID[E2]", "JACOBI[EA]"])
def test_equal_steps_compute_neither_estimate_nor_dense_output(name):
    """The compiler removes both where nothing uses them: of the loops that `fuse` makes, that of the step is left."""

    def run(y, steps):
        return diffrax.diffeqsolve(
            TERM,
            ml.diffrax.LieSolver(name),
            T0,
            T0 + DT * STEPS,
            DT,
            y,
            ARGS,
            stepsize_controller=steps,
            max_steps=None,
        )

    def loops(controller):
        program = real(lambda y: run(y, controller).ys).lower(start()).compile()
        return len(re.findall(r"= \(.* reduce\(", program.as_text()))

    assert loops(diffrax.ConstantStepSize()) == 1
    assert loops(diffrax.PIDController(rtol=0.0, atol=1e-6, norm=ml.diffrax.RotationNorm())) > 1


def test_bad_input_names_the_cure():
    torque = ml.torques.HeavyTop(jnp.array(1.0))
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), start())
    particles = ml.Particles(jnp.array([1.0, 2.0]))
    dots = ml.ParticleState(jnp.array([0.3, -0.2]), jnp.array([1.0, 0.4]))
    wrong = [
        (lambda: ml.diffrax.LieSolver("RK5"), "did you mean 'RK4'"),
        (lambda: ml.diffrax.RigidBodyTerm(1.0), "must be a midlie_jax.RigidBody"),
        (lambda: ml.diffrax.RigidBodyTerm(BODY, torque, torque_of_args=forces), "not both"),
        (lambda: solve("NMB", start(), term=diffrax.ODETerm(lambda t, y, args: y)), "RigidBodyTerm"),
        (lambda: solve("NMB", start(), term=diffrax.MultiTerm(TERM, TERM)), "got MultiTerm; add torques with"),
        (lambda: solve("NMB", start().momentum), "must be one such as midlie_jax.RigidState"),
        (lambda: solve("NMB", batch), "jax.vmap"),
        (lambda: solve("NMB", dots), "belongs to a Particles, but body is RigidBody"),
        (lambda: solve("NMB", start(), term=ml.diffrax.RigidBodyTerm(BODY, lambda t, y: jnp.ones(2))), "must return"),
        (
            lambda: solve(diffrax.Tsit5(), start(), term=ml.diffrax.RigidBodyTerm(particles)),
            "belongs to a RigidBody, but body is Particles",
        ),
    ]
    for call, message in wrong:
        with pytest.raises(ValueError, match=message):
            call()
