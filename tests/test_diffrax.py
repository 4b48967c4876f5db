"""The methods inside diffrax: what `integrate` gives, orders, error estimates, failures and messages."""

from functools import cache

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS, CLASSES, PARTICLE, QUICK, ROTATION, each, epsilon, firsts, quick, refused, setup, whole
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax.integrators.splitting import Splitting

# Times exact in binary, so that differences of times are the very step of `integrate`.
T0, DT, STEPS, EVERY = 0.25, 1 / 64, 32, 8
CASE = setup(t0=T0)
TIMES = T0 + DT * np.arange(STEPS + 1)
BODY = ml.RigidBody(jnp.asarray(CASE.moments))


def wind(strength, t):
    return strength * jnp.stack([jnp.cos(2 * t), jnp.sin(3 * t), jnp.ones_like(t)])


def forces(args):
    weight, strength = args
    return ml.torques.HeavyTop(weight, AXIS) + ml.torques.Prescribed(jax.tree_util.Partial(wind, strength))


def pull(stiffness, t, state):
    return -stiffness * jnp.sin(state.position) * (1 + t)


def spring(args):
    return jax.tree_util.Partial(pull, args[0])


ARGS = (jnp.asarray(CASE.weight), jnp.asarray(CASE.strength))
TERM = ml.diffrax.RigidBodyTerm(BODY, torque_of_args=forces)
SYMMETRIC = ml.diffrax.RigidBodyTerm(ml.RigidBody(jnp.array([1.5, 1.5, 2.5])), torque_of_args=forces)
SPRINGS = ml.diffrax.RigidBodyTerm(ml.Particles(jnp.array([1.0, 2.0])), torque_of_args=spring)
DOTS = ml.ParticleState(jnp.array([0.3, -0.2]), jnp.array([1.0, 0.4]))


def start(scale=1.0):
    return ml.RigidState(scale * jnp.asarray(CASE.momentum), jnp.asarray(CASE.attitude))


def problem(name):
    if name in PARTICLE:
        return SPRINGS, DOTS
    return (SYMMETRIC if name.startswith("SYMMETRIC") else TERM), start()


def solve(solver, y0, args=ARGS, *, term=TERM, t0=T0, t1=T0 + DT * STEPS, dt0=DT, throw=False, **options):
    solver = ml.diffrax.LieSolver(solver) if isinstance(solver, str) else solver
    return diffrax.diffeqsolve(term, solver, t0, t1, dt0, y0, args, throw=throw, **options)


def solve_to_the_end(solver, y0, args, t0, t1, dt, controller=None, adjoint=None, term=TERM):
    """The solution at t1; compiled once a solver, for all times, steps and torques."""
    options = {"stepsize_controller": controller or diffrax.ConstantStepSize()}
    options["adjoint"] = adjoint or diffrax.RecursiveCheckpointAdjoint()
    return solve(solver, y0, args, term=term, t0=t0, t1=t1, dt0=dt, **options)


end = eqx.filter_jit(solve_to_the_end, compiler_options=QUICK)
FROM, TO = jnp.array(T0), jnp.array(T0 + 1)


def truth(t1=TO, args=ARGS, term=TERM):
    return end(diffrax.Dopri8(), start(), args, FROM, t1, (t1 - FROM) / 32, term=term).ys


# Fourth-order differences.
SIZES, FACTORS = np.array([2.0, 1.0, 0.0, -1.0, -2.0]) * 1e-3, np.array([-1.0, 8.0, 0.0, -8.0, 1.0]) / 12e-3
WEIGHTS = ARGS[0] + jnp.asarray(SIZES)


def row(tree, i):
    return jax.tree.map(lambda x: x[i] if eqx.is_array(x) else x, tree, is_leaf=lambda x: isinstance(x, np.ndarray))


CONTROLLERS = {
    "ConstantStepSize": {},
    "StepTo": {"dt0": None, "stepsize_controller": diffrax.StepTo(ts=jnp.asarray(TIMES))},
    # Never in doubt, so that its steps are those of the others.
    "PIDController": {"stepsize_controller": diffrax.PIDController(rtol=0.0, atol=1e6, dtmax=DT)},
}
TS = diffrax.SaveAt(ts=jnp.asarray(TIMES[::EVERY]))


def numbers(state):
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(state)])


def test_norm_is_the_angle_between_attitudes():
    q = CASE.attitude
    turned = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec([3e-6, -4e-6, 0])
    state = ml.RigidState(jnp.array([0.0, 0.0, 2e-6]), jnp.asarray(q))
    error = eqx.tree_at(lambda s: s.attitude, state, jnp.asarray(turned.as_quat(scalar_first=True) - q))
    assert abs(ml.diffrax.RotationNorm()(error) - 5e-6) < 1e-15
    assert abs(ml.diffrax.RotationNorm(momentum=0.1)(error) - 2e-5) < 1e-18


# A method of each family; the orders of its estimate in momentum and attitude, and the span of estimate over error.
FAMILIES = {"LIEMID[E2]": (2, 2, 0.95, 1.05), "NMB": (3, 3, 0.95, 1.05), "SYMMETRIC[SRKN6b]": (4, 5, 1.0, np.inf)}


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
@pytest.mark.parametrize(("name", "saveat", "evaluations"), [("LIEMID[EA]", TS, 1), ("LIEMID[EA*]", None, 2)])
def test_torque_evaluations(name, saveat, evaluations):
    """As `LieSolver` says, counted in the compiled program."""
    count = []

    def counted(x):
        count.append(1)
        return x

    def torque(t, state):
        like = jax.ShapeDtypeStruct((), t.dtype)
        return ml.torques.HeavyTop(jax.pure_callback(counted, like, 1 + 0 * state.vertical()[0]), AXIS)(t, state)

    options = CONTROLLERS["PIDController"] | {"saveat": saveat or diffrax.SaveAt(t1=True)}
    term = ml.diffrax.RigidBodyTerm(BODY, torque)
    done = quick(lambda y: solve(name, y, term=term, **options).ys).lower(start()).compile()
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


SINGLE, LIGHT = jax.tree.map(lambda x: x.astype(jnp.float32), (start(), BODY))
test_bad_input_names_the_cure = refused(
    (lambda: ml.diffrax.LieSolver("RK5"), "did you mean 'RK4'"),
    (lambda: ml.diffrax.RigidBodyTerm(1.0), "must be a midlie_jax.RigidBody"),
    (lambda: ml.diffrax.RigidBodyTerm(BODY, ml.torques.HeavyTop(1.0), torque_of_args=forces), "not both"),
    (lambda: solve("NMB", start(), term=diffrax.ODETerm(lambda t, y, args: y)), "RigidBodyTerm"),
    (lambda: solve("NMB", start(), term=diffrax.MultiTerm(TERM, TERM)), "got MultiTerm; add torques with"),
    (lambda: solve("NMB", start().momentum), "must be one such as midlie_jax.RigidState"),
    (lambda: solve("NMB", jax.tree.map(lambda x: jnp.stack([x, x]), start())), "jax.vmap"),
    (lambda: solve("NMB", ml.CompensatedState(start().momentum, start().attitude)), "use a RigidState"),
    (lambda: solve("NMB", SINGLE, term=ml.diffrax.RigidBodyTerm(LIGHT)), "give t0, t1 and dt0 as"),
    (lambda: solve("NMB", DOTS), "belongs to a Particles, but body is RigidBody"),
    (lambda: solve("NMB", start(), term=ml.diffrax.RigidBodyTerm(BODY, lambda t, y: jnp.ones(2))), "must return"),
    (lambda: solve(diffrax.Tsit5(), start(), term=SPRINGS), "belongs to a RigidBody, but body is Particles"),
)


# ---- the states of `integrate` ----

KINDS = diffrax.SaveAt(
    subs={
        "t1": diffrax.SubSaveAt(t1=True),
        "ts": diffrax.SubSaveAt(ts=jnp.asarray(TIMES[::EVERY])),
        "steps": diffrax.SubSaveAt(t0=True, steps=EVERY),
        "fn": diffrax.SubSaveAt(t0=True, t1=True, fn=lambda t, y, args: jax.tree.map(lambda x: x * args[0], y)),
    },
    dense=True,
)
INDICES = {"t1": [-1], "ts": slice(None), "steps": slice(None), "fn": [0, -1], "dense": [1, -1]}
REVERSE = diffrax.RecursiveCheckpointAdjoint()


def outputs(name, weight, controller, saveat=KINDS, adjoint=REVERSE):
    """Everything that is kept, by its kind, and the result."""
    term, y0 = problem(name)
    options = CONTROLLERS[controller] | {"saveat": saveat, "adjoint": adjoint, "max_steps": STEPS}
    solution = solve(name, y0, (weight, ARGS[1]), term=term, **options)
    if saveat is not KINDS:
        return {"ts": solution.ys}, solution.result
    dense = jax.vmap(solution.evaluate)(jnp.asarray(TIMES)[jnp.array([EVERY, STEPS])])
    fn = jax.tree.map(lambda x: x / weight, solution.ys["fn"])
    return solution.ys | {"dense": dense, "fn": fn}, solution.result


@cache
def paths(name):
    """The states of `integrate` for the weights of the differences, every EVERY steps."""
    term, y0 = problem(name)

    def run(weight):
        torque = term.torque_at((weight, ARGS[1]))
        return ml.integrate(name, term.body, torque, y0, dt=DT, steps=STEPS, save_every=EVERY, t0=T0).states

    return jax.tree.map(np.asarray, quick(jax.vmap(run))(WEIGHTS))


def compare(kept, path):
    """A solution with the states of `integrate`: 2 ulp a step."""
    states_of, result = kept
    assert bool(result == diffrax.RESULTS.successful)
    for kind, states in states_of.items():
        index = INDICES[kind]
        for leaf, expected in zip(jax.tree.leaves(states), jax.tree.leaves(path), strict=True):
            # Dense output passes through exp and log on its way to the end of the step.
            steps = np.maximum(EVERY * np.arange(len(expected))[index], 4)
            bound = 2 * epsilon("float64") * steps * np.max(np.abs(expected))
            assert np.all(np.max(np.abs(leaf - expected[index]), axis=-1) <= bound), kind


def torque_use(method):
    """How a method comes by the torque: kept from step to step, evaluated anew, or solved for."""
    if isinstance(method, Splitting):
        return method.scheme.reuses_force
    return method.evaluations > 1, method.keeps_momentum


KEEPS = firsts(torque_use)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=KEEPS))
def test_outputs_equal_integrate(name):
    """With every kind of output; the controllers take turns, and so do one body and a batch."""
    turn = ROTATION.index(name)
    controller, batched = list(CONTROLLERS)[turn % 3], turn % 2 == 0

    def program(weight):
        return outputs(name, weight, controller)

    found = quick(jax.vmap(program) if batched else program)(WEIGHTS if batched else WEIGHTS[2])
    for i in range(len(SIZES)) if batched else (2,):
        compare(row(found, i) if batched else found, row(paths(name), i))


KICK, FLIGHT = ml.schemes.KICK, ml.schemes.FLIGHT
ENDS = (KICK, 1 / 6), (FLIGHT, 0.5), (KICK, 2 / 3), (FLIGHT, 0.5), (KICK, 1 / 6)
# Schemes whose first kick, or whose first and last, take a gradient of the torque: such a force is not kept.
OWN = {
    "ends": ml.schemes.Scheme("CHINB", 4, ENDS, gradients=(1 / 24, 0.0, 1 / 24)),
    "displaced": ml.schemes.Scheme("CHIND", 4, ENDS, gradients=(1 / 24, 0.0, 1 / 24), displaced=True),
    "first": ml.schemes.Scheme("FIRST", 2, ENDS, gradients=(1 / 24, 0.0, 0.0)),
}


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", [*OWN, *each(few=CLASSES)])
def test_equal_steps_end_where_those_of_integrate_do(name):
    """And so with the same order: two steps of every method, and of own schemes that begin with a gradient."""
    method = ml.method("JACOBI", OWN[name]) if name in OWN else ml.method(name)
    term, y0 = problem(name)
    torque = term.torque_at(ARGS)

    @quick
    def ends(start):
        found = solve(ml.diffrax.LieSolver(method), start, term=term, t1=T0 + 2 * DT, max_steps=2)
        path = ml.integrate(method, term.body, torque, start, dt=DT, steps=2, save_every=None, t0=T0)
        return jax.tree.map(lambda x: x[-1], found.ys), path.states

    for found, expected in zip(*map(jax.tree.leaves, ends(y0)), strict=True):
        assert np.max(np.abs(found - expected)) <= 8 * epsilon("float64") * np.max(np.abs(expected))


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("name", "controller", "adjoint"),
    [
        ("LIEMID[EA]", "PIDController", diffrax.RecursiveCheckpointAdjoint()),
        *whole(("NMB", "ConstantStepSize", diffrax.DirectAdjoint())),
        ("LIEMID[E2]", "StepTo", diffrax.ForwardMode()),
    ],
)
def test_derivatives_equal_differences(name, controller, adjoint):
    """Of a method that keeps its torque, of one that solves for it, and of one that is handed it."""

    def loss(states):
        return sum(jnp.sum(jnp.sin(leaf)) for leaf in jax.tree.leaves(states))

    def value(weight):
        kept, result = outputs(name, weight, controller, TS, adjoint)
        return loss(kept["ts"]), (kept, result)

    derivative = jax.jacfwd if isinstance(adjoint, diffrax.ForwardMode) else jax.grad
    slope, kept = quick(derivative(value, has_aux=True))(ARGS[0])
    compare(kept, row(paths(name), 2))
    difference = float(np.dot(FACTORS, [loss(row(paths(name), i)) for i in range(len(SIZES))]))
    assert abs(slope - difference) <= 1e-6 * abs(difference)
