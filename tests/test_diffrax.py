"""The methods inside diffrax.

Not the full product of methods x SaveAt kinds x controllers x adjoints x batches, but a round robin: every method is
run, and the other choices rotate along, so that each of them meets several methods. Compiling is what costs.
"""

from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from cases import AXIS, PARTICLE, ROTATION, epsilon, setup
from scipy.spatial.transform import Rotation

import midlie_jax as ml

# Times exact in binary, so that differences of times are the very step of `integrate`.
T0, DT, STEPS = 0.25, 1 / 64, 64
CASE = setup(t0=T0)
TIMES = T0 + DT * np.arange(STEPS + 1)
BODY = ml.RigidBody(jnp.asarray(CASE.moments))


def wind(strength, t):
    return strength * jnp.stack([jnp.cos(2 * t), jnp.sin(3 * t), jnp.ones_like(t)])


def forces(args):
    """A top in a wind; args are the weight and the strength of the wind."""
    weight, strength = args
    return ml.torques.HeavyTop(weight, AXIS) + ml.torques.Prescribed(jax.tree_util.Partial(wind, strength))


ARGS = (jnp.asarray(CASE.weight), jnp.asarray(CASE.strength))
TERM = ml.RigidBodyTerm(BODY, torque_of_args=forces)


def start(scale=1.0):
    return ml.RigidState(scale * jnp.asarray(CASE.momentum), jnp.asarray(CASE.attitude))


def solve(solver, y0, args=ARGS, *, term=TERM, t0=T0, t1=T0 + DT * STEPS, dt0=DT, throw=False, **options):
    solver = ml.LieSolver(solver) if isinstance(solver, str) else solver
    return diffrax.diffeqsolve(term, solver, t0, t1, dt0, y0, args, throw=throw, **options)


STEP_TO = {"dt0": None, "stepsize_controller": diffrax.StepTo(ts=jnp.asarray(TIMES))}
MIXED = [diffrax.SubSaveAt(t0=True, steps=16), diffrax.SubSaveAt(t1=True, fn=lambda t, y, args: y.momentum * args[0])]
KINDS = {
    "ts": diffrax.SaveAt(ts=jnp.asarray(TIMES[::16])),
    "steps": diffrax.SaveAt(t0=True, steps=16),
    "dense": diffrax.SaveAt(dense=True),
    "t1": diffrax.SaveAt(t1=True),
    "fn": diffrax.SaveAt(t0=True, t1=True, fn=lambda t, y, args: (y.momentum, y.attitude * args[0])),
    "subs": diffrax.SaveAt(subs=MIXED),
}
ROUND = [
    (name, list(KINDS)[i % len(KINDS)], "StepTo" if i % 3 else "ConstantStepSize", i % 4 == 0)
    for i, name in enumerate(ROTATION)
]


def kept(kind, solution, weight):
    """(index of the step, momentum, attitude or None) for everything that the solution kept."""
    if kind == "dense":
        states = [solution.evaluate(TIMES[i]) for i in (16, 64)]
        return [(i, s.momentum, s.attitude) for i, s in zip((16, 64), states, strict=True)]
    if kind == "fn":
        momenta, attitudes = solution.ys
        return [(i, m, a / weight) for i, m, a in zip((0, 64), momenta, attitudes, strict=True)]
    if kind == "subs":
        states, momentum = solution.ys
        first = [(16 * i, states.momentum[i], states.attitude[i]) for i in range(5)]
        return [*first, (64, momentum[0] / weight, None)]
    indices = (64,) if kind == "t1" else range(0, 65, 16)
    return [(i, solution.ys.momentum[n], solution.ys.attitude[n]) for n, i in enumerate(indices)]


@pytest.mark.parametrize(("name", "kind", "controller", "batched"), ROUND, ids=lambda x: str(x))
def test_equals_integrate_to_two_ulp_a_step(name, kind, controller, batched):
    options = {"saveat": KINDS[kind], "max_steps": STEPS, **(STEP_TO if controller == "StepTo" else {})}

    def theirs(y0):
        return solve(name, y0, **options)

    def ours(y0):
        return ml.integrate(name, BODY, forces(ARGS), y0, dt=DT, steps=STEPS, save_every=16, t0=T0)

    if batched:
        # Row 0 is compared; the other sees to it that there is a batch.
        y0 = jax.tree.map(lambda *x: jnp.stack(x), start(), start(0.5))
        solution, path = eqx.filter_vmap(theirs)(y0), jax.vmap(ours)(y0)
        solution, path = jax.tree.map(lambda x: x[0] if eqx.is_array(x) else x, (solution, path))
    else:
        solution, path = theirs(start()), ours(start())
    assert bool(solution.result == diffrax.RESULTS.successful)
    for i, momentum, attitude in kept(kind, solution, CASE.weight):
        # Dense output passes through exp and log on its way to the end of the step.
        bound = 2 * epsilon("float64") * max(i, 4)
        assert np.max(np.abs(momentum - path.states.momentum[i // 16])) <= bound * np.max(np.abs(CASE.momentum))
        if attitude is not None:
            assert np.max(np.abs(attitude - path.states.attitude[i // 16])) <= bound


@pytest.mark.parametrize("name", PARTICLE)
def test_particles_equal_integrate(name):
    body, spring = ml.Particles(jnp.array([1.0, 2.0])), lambda t, s: -jnp.sin(s.position) * (1 + t)
    y0 = ml.ParticleState(jnp.array([0.3, -0.2]), jnp.array([1.0, 0.4]))
    solution = solve(name, y0, term=ml.RigidBodyTerm(body, spring), saveat=diffrax.SaveAt(ts=jnp.asarray(TIMES[::16])))
    path = ml.integrate(name, body, spring, y0, dt=DT, steps=STEPS, save_every=16, t0=T0)
    for a, b in zip(jax.tree.leaves(solution.ys), jax.tree.leaves(path.states), strict=True):
        assert np.max(np.abs(a - b)) <= 2 * epsilon("float64") * STEPS


@eqx.filter_jit
def end(solver, y0, args, t0, t1, dt, controller=None, adjoint=None):
    """The solution at t1; compiled once a solver, for all times, steps and torques."""
    return diffrax.diffeqsolve(
        TERM,
        solver,
        t0,
        t1,
        dt,
        y0,
        args,
        stepsize_controller=controller or diffrax.ConstantStepSize(),
        adjoint=adjoint or diffrax.RecursiveCheckpointAdjoint(),
        throw=False,
    )


def numbers(state):
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(state)])


FROM, TO = jnp.array(T0), jnp.array(T0 + 1)
FREE = (jnp.array(0.0), jnp.array(0.0))


def truth(t1=TO, args=ARGS):
    return end(diffrax.Dopri8(), start(), args, FROM, t1, (t1 - FROM) / 32).ys


def test_one_term_under_six_solvers_agrees_at_their_orders():
    """And who keeps the spatial momentum of a free body: ours to rounding, theirs by their orders."""
    newton = optimistix.Newton(rtol=1e-11, atol=1e-11)
    solvers = [
        (diffrax.Heun(), 2),
        (diffrax.Bosh3(), 3),
        (diffrax.Tsit5(), 5),
        (diffrax.Dopri8(), 8),
        (diffrax.Kvaerno5(root_finder=newton), 5),
        (ml.LieSolver("LIEMID[EA]"), 2),
    ]
    exact, before = numbers(truth()), np.asarray(ml.spatial_momentum(start()))
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
        drifts.append(np.max(np.abs(ml.spatial_momentum(jax.tree.map(lambda x: x[0], free)) - before)))
        print(f"{type(solver).__name__:12} {errors[0]:12.1e} {slope:6.2f} {drifts[-1]:14.1e}")
        assert abs(slope - order) < 0.6
    assert drifts[-1] < 8 * epsilon("float64")
    assert min(drifts[:-1]) > 100 * drifts[-1]


def test_there_and_back():
    for name in ("LIEMID[EA]", "NMB"):
        solver = ml.LieSolver(name)
        there = end(solver, start(), ARGS, FROM, TO, jnp.array(DT)).ys
        back = end(solver, jax.tree.map(lambda x: x[0], there), ARGS, TO, FROM, jnp.array(-DT)).ys
        assert np.max(np.abs(numbers(back) - numbers(start()))) < 1e-13


def test_controller_holds_its_tolerance_and_rejects_failed_steps():
    solver, exact = ml.LieSolver("LIEMID[EA]"), numbers(truth())
    norm = ml.RotationNorm(momentum=2.0)
    errors = []
    for tolerance in (1e-3, 1e-5):
        controller = diffrax.PIDController(rtol=0.0, atol=jnp.array(tolerance), norm=norm)
        solution = end(solver, start(), ARGS, FROM, TO, jnp.array(DT), controller)
        assert bool(solution.result == diffrax.RESULTS.successful)
        errors.append(np.max(np.abs(numbers(solution.ys) - exact)))
    assert errors[0] < 1e-2
    assert errors[1] < errors[0] / 30  # the error goes with the tolerance
    # A first step too long for the flight's equation to be solved.
    fast = start(8.0)
    solution = end(solver, fast, ARGS, FROM, TO, jnp.array(1.0), controller)
    assert bool(solution.result == diffrax.RESULTS.successful)
    assert int(solution.stats["num_rejected_steps"]) > 0
    solution = end(solver, fast, ARGS, FROM, TO, jnp.array(1.0))
    assert bool(solution.result == diffrax.RESULTS.nonlinear_divergence)


def test_norm_is_the_angle_between_attitudes():
    q = CASE.attitude
    turned = (Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec([3e-6, -4e-6, 0])).as_quat(
        scalar_first=True
    )
    state = ml.RigidState(jnp.array([0.0, 0.0, 2e-6]), jnp.asarray(q))
    error = eqx.tree_at(lambda s: s.attitude, state, jnp.asarray(turned - q))
    assert abs(ml.RotationNorm()(error) - 5e-6) < 1e-15
    assert abs(ml.RotationNorm(momentum=0.1)(error) - 2e-5) < 1e-18


ADJOINTS = [
    ("LIEMID[EA]", diffrax.RecursiveCheckpointAdjoint(), jax.grad),
    ("NMB", diffrax.DirectAdjoint(), jax.grad),
    ("LIEMID[E2]", diffrax.ForwardMode(), jax.jacfwd),
    ("LIEMID[EA]", diffrax.BacksolveAdjoint(solver=diffrax.Tsit5()), jax.grad),
]


@pytest.mark.parametrize(("name", "adjoint", "derivative"), ADJOINTS, ids=[type(a).__name__ for _, a, _ in ADJOINTS])
def test_gradients_equal_differences(name, adjoint, derivative):
    """In a torque parameter that comes through `args`."""

    def value(weight, dt, adjoint=adjoint):
        y = end(ml.LieSolver(name), start(), (weight, ARGS[1]), FROM, TO, dt, adjoint=adjoint).ys
        return jnp.sum(jnp.sin(y.momentum)) + jnp.sum(jnp.cos(y.attitude))

    def differences(dt):
        sizes, factors = (2.0, 1.0, -1.0, -2.0), (-1.0, 8.0, -8.0, 1.0)
        plain = diffrax.ForwardMode()
        values = [f * value(ARGS[0] + 1e-3 * s, dt, plain) for s, f in zip(sizes, factors, strict=True)]
        return sum(values) / 12e-3

    slope = jax.jit(derivative(value))
    gaps = [abs(slope(ARGS[0], jnp.array(dt)) - differences(jnp.array(dt))) for dt in (1 / 16, 1 / 32)]
    if isinstance(adjoint, diffrax.BacksolveAdjoint):
        # The derivative of the motion and not of the steps: nearer by four at half the step.
        assert gaps[0] < 0.02
        assert 3 < gaps[0] / gaps[1] < 5
    else:
        assert max(gaps) < 1e-6 * abs(slope(ARGS[0], jnp.array(1 / 32)))


def test_float32():
    cast = partial(jax.tree.map, lambda x: x.astype(jnp.float32) if eqx.is_array(x) else x)
    times = [jnp.float32(t) for t in (T0, T0 + 1, DT)]
    term = ml.RigidBodyTerm(cast(BODY), torque_of_args=forces)
    y = diffrax.diffeqsolve(
        term,
        ml.LieSolver("LIEMID[EA]"),
        *times,
        cast(start()),
        cast(ARGS),
        saveat=diffrax.SaveAt(ts=jnp.linspace(T0, T0 + 1, 30, dtype=jnp.float32)),
    ).ys
    assert y.momentum.dtype == y.attitude.dtype == jnp.float32
    assert np.max(np.abs(np.linalg.norm(np.asarray(y.attitude, np.float64), axis=-1) - 1)) < 4 * epsilon("float32")
    exact = end(ml.LieSolver("LIEMID[EA]"), start(), ARGS, FROM, TO, jnp.array(DT)).ys
    assert np.max(np.abs(numbers(jax.tree.map(lambda x: x[-1], y)) - numbers(exact))) < 1e-5
    with pytest.raises(ValueError, match="give t0, t1 and dt0 as"):
        diffrax.diffeqsolve(term, ml.LieSolver(), T0, T0 + 1, DT, cast(start()), cast(ARGS))


INSIDE = np.linspace(0.05, 0.95, 7)


def test_dense_output_is_on_the_group_and_of_third_order_inside_a_step():
    @eqx.filter_jit
    def step(h):
        solution = solve("LIEMID[EA]", start(), t0=FROM, t1=FROM + h, dt0=h, saveat=KINDS["dense"], max_steps=1)
        times = FROM + h * INSIDE
        return jax.vmap(solution.evaluate)(times), jax.vmap(solution.derivative)(times)

    def exact(t):
        y = jax.tree.map(lambda x: x[0], truth(t))
        return y, TERM.vf(t, y, ARGS).ambient

    errors = []
    for h in (1 / 8, 1 / 16, 1 / 32):
        got = step(jnp.array(h))
        assert np.max(np.abs(np.linalg.norm(got[0].attitude, axis=-1) - 1)) < 4 * epsilon("float64")
        gaps = jax.tree.map(lambda a, b: np.max(np.abs(a - b)), got, eqx.filter_jit(jax.vmap(exact))(FROM + h * INSIDE))
        errors.append(jax.tree.leaves(gaps))
    slopes = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    print("order of momentum, attitude and their derivatives inside a step:", slopes)
    assert np.all(slopes[:, :2] > 2.8)
    assert np.all(slopes[:, 2:] > 1.8)


def only_the_top(weight):
    return ml.torques.HeavyTop(weight, AXIS)


@pytest.mark.parametrize("state", [ml.DirectionState, ml.MomentumState])
def test_states_without_attitude(state):
    """Agree with the full state, between steps too."""
    weight = ARGS[0] if state is ml.DirectionState else jnp.array(0.0)
    top = ml.RigidBodyTerm(BODY, torque_of_args=only_the_top)
    up = ml.so3.to_matrix(start().attitude)[2]
    few, term = (state(start().momentum, up), top) if weight else (state(start().momentum), ml.RigidBodyTerm(BODY))
    saveat = diffrax.SaveAt(ts=jnp.linspace(T0, T0 + 1, 23))
    less = solve("LIEMID[EA]", few, weight, term=term, saveat=saveat).ys
    full = solve("LIEMID[EA]", start(), weight, term=top, saveat=saveat).ys
    assert np.max(np.abs(less.momentum - full.momentum)) < 1e-7  # two cubics that differ in the fourth order
    if state is ml.DirectionState:
        assert np.max(np.abs(less.direction - jax.vmap(ml.so3.to_matrix)(full.attitude)[:, 2])) < 1e-7


def height(t, y, args, **kwargs):
    """Of the top's axis over a plane through its foot."""
    del t, args, kwargs
    return ml.so3.to_matrix(y.attitude)[0, 2]


def test_event_time_and_its_gradient():
    event = diffrax.Event(height, optimistix.Newton(1e-13, 1e-13))

    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def crossing(weight):
        solution = solve("LIEMID[EA]", start(), (weight, ARGS[1]), t1=T0 + 4, event=event)
        return solution.ts[0], jax.tree.map(lambda x: x[0], solution.ys)

    (found, y), slope = crossing(ARGS[0])
    assert T0 < found < T0 + 4 - DT
    _, speed = jax.jvp(lambda y: height(found, y, ARGS), (y,), (TERM.vf(found, y, ARGS).ambient,))
    assert abs(height(found, y, ARGS)) < 1e-10 * min(1, abs(speed))
    assert abs(height(found, jax.tree.map(lambda x: x[0], truth(found)), ARGS)) < 1e-3  # the method's own error
    sizes, factors = np.array([2.0, 1.0, -1.0, -2.0]) * 1e-3, np.array([-1.0, 8.0, -8.0, 1.0]) / 12e-3
    differences = sum(f * crossing(ARGS[0] + d)[0][0] for d, f in zip(sizes, factors, strict=True))
    assert abs(slope - differences) < 1e-6 * abs(differences)


def test_kept_torque_is_renewed_after_a_jump(capfd):
    def push(t):
        return jnp.where(t < 0.75, jnp.zeros_like(t), 3 * jnp.ones_like(t)) * jnp.ones(3)

    term = ml.RigidBodyTerm(BODY, ml.torques.Prescribed(push))
    same = diffrax.PIDController(rtol=0.0, atol=1e6, dtmax=DT)
    clip = diffrax.ClipStepSizeController(same, jump_ts=jnp.array([0.75]))
    meter = diffrax.TextProgressMeter(minimum_increase=0.5)
    once = solve("LIEMID[EA]", start(), term=term, stepsize_controller=clip, progress_meter=meter).ys
    assert "100.00%" in capfd.readouterr().out
    free = ml.integrate("LIEMID[EA]", BODY, None, start(), dt=DT, steps=32, save_every=32)
    pushed = ml.torques.Prescribed(lambda t: 3 * jnp.ones(3, t.dtype))
    middle = jax.tree.map(lambda x: x[-1], free.states)
    path = ml.integrate("LIEMID[EA]", BODY, pushed, middle, dt=DT, steps=32, save_every=32)
    assert np.max(np.abs(numbers(once) - numbers(jax.tree.map(lambda x: x[-1], path.states)))) < 1e-13


def test_bad_input_names_the_cure():
    torque = ml.torques.HeavyTop(jnp.array(1.0))
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), start())
    particles = ml.Particles(jnp.array([1.0, 2.0]))
    dots = ml.ParticleState(jnp.array([0.3, -0.2]), jnp.array([1.0, 0.4]))
    wrong = [
        (lambda: ml.LieSolver("RK4"), "choose from"),
        (lambda: ml.LieSolver(3), "midlie_jax.method"),
        (lambda: ml.RigidBodyTerm(1.0), "must be a midlie_jax.RigidBody"),
        (lambda: ml.RigidBodyTerm(BODY, 1.0), "callable of"),
        (lambda: ml.RigidBodyTerm(BODY, torque, torque_of_args=forces), "not both"),
        (lambda: solve("NMB", start(), term=diffrax.ODETerm(lambda t, y, args: y)), "RigidBodyTerm"),
        (lambda: solve("NMB", start().momentum), "must be one such as midlie_jax.RigidState"),
        (lambda: solve("NMB", batch), "jax.vmap"),
        (lambda: solve("NMB", dots), "belongs to Particles"),
        (lambda: solve("NMB", dots, term=ml.RigidBodyTerm(particles)), "midlie_jax.methods"),
        (lambda: solve("NMB", start(), term=ml.RigidBodyTerm(BODY, lambda t, y: jnp.ones(2))), "must return"),
        (lambda: solve(diffrax.Tsit5(), start(), term=ml.RigidBodyTerm(particles)), "belongs to RigidBody"),
    ]
    for call, message in wrong:
        with pytest.raises(ValueError, match=message):
            call()
