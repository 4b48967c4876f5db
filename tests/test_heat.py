"""Bodies in a heat bath: what its stage does exactly, the distributions of Maxwell and Boltzmann, random numbers."""

from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import REAL, keys, quick, real, refused, still
from scipy.linalg import expm

import midlie_jax as ml
from midlie_jax._xla import compiler
from midlie_jax.integrators import schemes
from midlie_jax.integrators.schemes import BATH, FLIGHT, KICK, measured_weak_order
from midlie_jax.model.exposure import exposures

KT, FRICTION, KEY = 0.7, 1.3, jax.random.key(7)
MOMENTS = np.array([1.0, 2.0, 2.5])
BODY, SPHERE = ml.RigidBody(MOMENTS), ml.RigidBody([2.0, 2.0, 2.0])
BATHS = ["BAOAB", "OBABO", "ABOBA"]
MANY = 8192
Langevin = ml.baths.Langevin


def tensors(count, seed=0, rank=3):
    """Random symmetric tensors with no negative eigenvalue, (count, 3, 3)."""
    factor = np.random.default_rng(seed).normal(size=(count, 3, rank))
    return factor @ np.swapaxes(factor, -1, -2)


IN_SPACE = tensors(1, seed=8, rank=2)[0]
RECOIL = ml.baths.Recoil(IN_SPACE, jax.random.key(0))


def ensemble(*given, **options):
    """Compiled as for users: thousands of bodies take long in hurried code."""
    with patch.object(compiler, "compiler_options", lambda bodies: REAL):
        return ml.ensemble(*given, **options)


def too_hot(count):
    momentum = np.random.default_rng(5).normal(size=(count, 3)) * np.sqrt(10 * KT * MOMENTS)
    return ml.RigidState(momentum, still(count).attitude)


def close_to_one(values, *, errors=3.0):
    """Whether the mean of squares of standard normal numbers (n, ...) is 1 within three standard errors."""
    values = np.asarray(values)
    assert np.all(np.abs(values.mean(0) - 1) < errors * np.sqrt(2 / len(values))), values.mean(0)


@pytest.mark.parametrize("time", [1e-6, 0.3, 20.0])
def test_a_stage_of_the_bath_is_the_solution_of_its_equations(time):
    """Mean and covariance are those of the matrix exponential; a friction of a lower rank leaves directions free."""
    inertia = np.diag(MOMENTS)

    def full(numbers):
        return np.array(numbers) if np.ndim(numbers) == 2 else np.diag(np.broadcast_to(numbers, 3))

    of_ranks = [friction for rank in (1, 2, 3) for friction in tensors(3, rank=rank)]
    for friction in (*of_ranks, np.array([0.3, 1.1, 0.0]), np.array(0.8)):
        done = exposures(BODY, None, jnp.asarray(friction), None, jnp.asarray(time), jnp.sqrt(KT))
        lost, spread = full(done.lost), full(done.spread)
        kept = expm(-full(friction) @ np.diag(1 / MOMENTS) * time)
        np.testing.assert_allclose(np.eye(3) - lost, kept, atol=1e-12)
        np.testing.assert_allclose(spread @ spread.T, KT * (inertia - kept @ inertia @ kept.T), atol=2e-12)


def kinds(count):
    """States of every kind with the square of each momentum over its mean, (n, k): all should be 1."""
    rest, z = still(count), jnp.zeros((count, 3))
    up = z.at[:, 2].set(1)
    free = ml.FreeBody(BODY, 3.0)

    def turning(state):
        return np.asarray(state.momentum) ** 2 / (KT * MOMENTS)

    def axis(state):
        along = np.sum(np.asarray(state.momentum * state.axis), -1)
        across = np.sum(np.asarray(state.momentum) ** 2, -1) - along**2
        return np.stack([along**2 / (0.9 * KT), across / (4 * KT)], -1)

    def travelling(of):
        return lambda state: np.concatenate([of(state), np.asarray(state.linear) ** 2 / (3 * KT)], -1)

    tilted = Langevin(KT, tensors(1)[0] + jnp.eye(3), keys(count), tensors(1, seed=2)[0] + jnp.eye(3))
    plain = Langevin(KT, FRICTION, keys(count))
    symmetric = Langevin(KT, [1.0, 1.0, 0.5], keys(count), [1.0, 1.0, 2.0])
    rotor = ml.SymmetricRotor(2.0, 0.9)
    pairs = ml.CoupledState(*(x.reshape(count // 2, 2, -1) for x in (z, rest.attitude, z, z)))
    return {
        "momentum": (BODY, plain, ml.MomentumState(z), turning),
        "compensated": (BODY, plain, ml.CompensatedState(z, rest.attitude), turning),
        "free, tensors": (free, tilted, ml.FreeState(z, rest.attitude, z, z), travelling(turning)),
        "free axis": (ml.FreeBody(rotor, 3.0), symmetric, ml.FreeAxisState(z, up, z, z), travelling(axis)),
        "two": (free, Langevin(KT, FRICTION, keys(count // 2), 0.8), pairs, travelling(turning)),
    }


def method_for(kind):
    flights = {"free axis": "SYMMETRIC", "compensated": "LIEMID", "free, tensors": "DLM"}
    return f"{flights.get(kind, 'JACOBI')}[BAOAB]"


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", kinds(10))
def test_every_kind_of_state_comes_to_the_maxwell_distribution(kind):
    body, bath, start, squares = kinds(MANY)[kind]
    path = ensemble(method_for(kind), body, None, start, dt=0.2, steps=120, bath=bath)
    assert bool(path.ok.all())
    assert len(np.unique(np.asarray(path.states.momentum))) > 3 * MANY - 100  # bodies of a set have noise of their own
    found = squares(path.states)
    close_to_one(found.reshape(-1, found.shape[-1]), errors=3.5)


@pytest.mark.sample(1)
@pytest.mark.parametrize("bath", [Langevin(KT, FRICTION, jax.random.key(0)), RECOIL], ids=["Langevin", "Recoil"])
def test_a_linear_molecule_does_not_spin(bath):
    start = ml.AxisState(np.zeros(3), [0.0, 0.6, 0.8])
    path = ml.integrate("SYMMETRIC[BAOAB]", ml.SymmetricRotor(2.0, 0.0), None, start, dt=0.2, steps=50, bath=bath)
    assert np.abs(np.sum(np.asarray(path.states.momentum * path.states.axis), -1)).max() < 1e-14
    assert np.abs(path.states.momentum[-1]).max() > 0.1


@pytest.mark.sample(0)
def test_a_dipole_in_a_field_points_as_langevin_says():
    """<cos theta> = coth x - 1/x; the errors of the steps, of order (h omega)^2/20, are below the sampling error."""
    count, x, body = 2048, 2.0, ml.RigidBody([2.0, 2.0, 0.9])
    run = {"dt": 0.2 / np.sqrt(x), "steps": 600, "save_every": 30, "bath": Langevin(KT, FRICTION, keys(count))}
    field, observe = ml.torques.HeavyTop(-x * KT), ml.observe.Axis()
    path = ensemble("SYMMETRIC[BAOAB]", body, field, still(count), observe=observe, **run)
    cosine = np.asarray(path.states)[:, 6:, 2].mean(1)  # of each body, after nine relaxation times
    error = cosine.std() / np.sqrt(count)
    assert abs(cosine.mean() - (1 / np.tanh(x) - 1 / x)) < 3 * error + 2e-3


OMEGA_H = 1.2
SHARE = 1 - OMEGA_H**2 / 4  # by which <x^2> or <p^2> in a harmonic well differs from its value


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("scheme", "position", "linear"), [("BAOAB", 1.0, SHARE), ("OBABO", 1 / SHARE, 1.0), ("ABOBA", 1.0, 1 / SHARE)]
)
def test_the_averages_in_a_harmonic_well_are_those_of_theory(scheme, position, linear):
    """At h omega = 1.2, where a scheme that is not exact is 56 percent off."""
    stiffness, mass = 2.0, 3.0
    dt = OMEGA_H / np.sqrt(stiffness / mass)
    rest, z = still(MANY), jnp.zeros((MANY, 3))
    well = ml.torques.FromPotential(lambda t, state: stiffness / 2 * jnp.sum(state.position**2))
    body, start = ml.FreeBody(BODY, mass), ml.FreeState(z, rest.attitude, z, z)
    bath = Langevin(KT, FRICTION, keys(MANY), 2.0)
    path = ensemble(f"JACOBI[{scheme}]", body, well, start, bath=bath, dt=dt, steps=40)
    close_to_one(stiffness * path.states.position**2 / (KT * position))
    close_to_one(path.states.linear**2 / (mass * KT * linear))


@pytest.mark.sample(0)
def test_a_temperature_and_a_friction_that_depend_on_time_are_those_of_the_time():
    """Of d<Pi^2>/dt = 2 g (kT I - <Pi^2>) with g = 1/s and kT = T s, s = 1 + t: <Pi^2> = 2/3 T I (s - 1/s^2)."""
    heating = Langevin(lambda t: KT * (1 + t), lambda t: 2 / (1 + t) * jnp.eye(3), keys(MANY))
    end = ensemble("JACOBI[OBABO]", SPHERE, None, still(MANY), dt=0.02, steps=75, bath=heating).states
    close_to_one(end.momentum**2 / (2 * KT * 2 / 3 * (2.5 - 2.5**-2)))


@pytest.mark.sample(0)
def test_gases_and_recoil_heat_a_sphere_as_their_equation_says():
    """<Pi^2> = I (kT + D/G) with G = G1 + G2 and G kT = G1 kT1 + G2 kT2; the error at x = G h/I is x^2/6."""
    count, diffusion, x, z = MANY // 2, 2.0, 0.04, jnp.zeros((MANY // 2, 3))
    bath = Langevin(KT, 1.0, keys(count), 1.0) + Langevin(5 * KT, 3.0, keys(count), 3.0)
    bath = bath + ml.baths.Recoil(diffusion, keys(count, 2), diffusion)
    body, start = ml.FreeBody(ml.RigidBody(np.ones(3)), 1.0), ml.FreeState(z, still(count).attitude, z, z)
    states = ensemble("JACOBI[BAOAB]", body, None, start, dt=x / 4, steps=200, bath=bath).states
    for momentum in (states.momentum, states.linear):
        close_to_one(momentum**2 / (4 * KT + diffusion / 4))


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", ["frame of a user", "compensated", "free axis", "five"])
def test_recoil_is_fixed_in_space(kind):
    """The covariance of the momenta in space grows as 2 D t while bodies turn."""
    count, dt, steps = MANY, 0.1, 5
    q, z = jnp.tile(ml.so3.exp(jnp.array([0.4, -0.9, 0.5])), (count, 1)), jnp.zeros((count, 3))
    few = [x.reshape(-1, 4, x.shape[-1]) for x in (z, q, z, z)]
    free_axis = ml.FreeAxisState(z, ml.so3.rotate(q, z.at[:, 2].set(1)), z, z)
    body, start = {
        "frame of a user": (ml.TensorBody(tensors(1)[0] + 3 * np.eye(3)), ml.RigidState(z, q)),
        "compensated": (BODY, ml.CompensatedState(z, q)),
        "free axis": (ml.FreeBody(ml.SymmetricRotor(2.0, 0.9), 3.0), free_axis),
        "five": (ml.FreeBody(BODY, 3.0), ml.CoupledState(*few)),
    }[kind]
    linear = IN_SPACE[::-1, ::-1] if hasattr(start, "linear") else None
    bath = ml.baths.Recoil(IN_SPACE, keys(len(start.momentum)), linear)
    path = ensemble(method_for(kind), body, None, start, dt=dt, steps=steps, bath=bath)
    assert bool(path.ok.all())
    momentum = path.states.momentum
    found = [(IN_SPACE, momentum if "axis" in kind else ml.so3.rotate(path.states.attitude, momentum))]
    found += [] if linear is None else [(linear, path.states.linear)]
    for diffusion, momentum in found:
        momentum, wanted = np.asarray(momentum).reshape(-1, 3), 2 * diffusion * dt * steps
        error = np.sqrt((np.outer(np.diag(wanted), np.diag(wanted)) + wanted**2) / count)
        assert np.all(np.abs(momentum.T @ momentum / count - wanted) < 3.5 * error)


def last_of(states):
    return jax.tree.map(lambda x: x[-1], states)


@pytest.mark.sample(0)
def test_a_key_within_a_program_draws_what_a_key_as_an_argument_does():
    """The compiler does not compute the noise of a known key by itself, because it rounds differently."""

    def run(start, key):
        options = {"dt": 0.1, "steps": 2, "save_every": 2, "bath": Langevin(1.0, 0.5, key)}
        return ml.integrate("JACOBI[OBABO]", BODY, None, start, **options).states

    start = ml.RigidState([0.1, 0.2, 1.0], [1.0, 0.0, 0.0, 0.0])
    given = real(run)(start, KEY)
    for known in (real(lambda start: run(start, KEY))(start), real(lambda: run(start, KEY))()):
        jax.tree.map(np.testing.assert_array_equal, known, given)


@pytest.mark.sample(0)
def test_gradients_by_a_friction_whose_eigenvalues_agree_or_differ_much():
    """Against differences; finite also for exp(-300 t) and exp(-300000 t) in one matrix, and for no bath at all."""

    def end(kT, friction):
        start, run = last_of(too_hot(1)), {"dt": 0.1, "steps": 20, "bath": Langevin(kT, friction, KEY)}
        path = ml.integrate("JACOBI[BAOAB]", SPHERE, ml.torques.HeavyTop(1.5), start, **run)
        return path.states.momentum[-1] @ jnp.array([1.0, -0.4, 0.3])

    value, gradient, step = quick(end), quick(jax.grad(end, (0, 1))), 1e-6
    slope = gradient(KT, jnp.eye(3) * FRICTION)[1]
    for change in (np.diag([1.0, 0, 0]), np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, 0]])):
        ends = [value(KT, jnp.eye(3) * FRICTION + sign * step * change) for sign in (1, -1)]
        np.testing.assert_allclose(np.sum(slope * change), (ends[0] - ends[1]) / (2 * step), rtol=1e-5)
    assert np.all(np.isfinite(gradient(KT, jnp.diag(jnp.array([0.0, 1.0, 3e5])))[1]))
    assert np.all(np.isfinite(gradient(0.0, 0.0)))


BAO = ((KICK, 1.0), (FLIGHT, 1.0), (BATH, 1.0))
LONG = ((BATH, 0.5), *schemes.SRKN6B.stages, (BATH, 0.5))  # of high order but for the bath at its ends


@pytest.mark.sample(0)
def test_the_order_of_a_table_with_a_bath_is_that_of_averages():
    for name in BATHS:
        assert abs(measured_weak_order(schemes.SCHEMES[name]) - 2) < 0.05
        assert not schemes.SCHEMES[name].symmetric
    assert schemes.Scheme("BAO", 1, BAO).order == 1
    assert schemes.Scheme("O SRKN6b O", 2, LONG).order == 2


START = last_of(still(1))
FREE = ml.FreeBody(BODY, 3.0), ml.FreeState(START.momentum, START.attitude, START.momentum, START.momentum)
AXIS, ROTOR = ml.AxisState.of(START), ml.SymmetricRotor(2.0, 0.9)
PARTICLES: dict[str, Any] = {"method": ml.method(ml.flights.Linear(), "BAOAB")}
PARTICLES |= {"body": ml.Particles(jnp.ones(1)), "start": ml.ParticleState(jnp.ones(1), jnp.ones(1))}
HEAT = Langevin(KT, FRICTION, KEY)
RUN = {"dt": 0.1, "steps": 4}
VARIABLE = RUN | {"density": lambda t, state: 1.0}


def go(*friction, body=BODY, start=START, kT=KT, method="JACOBI[BAOAB]", torque=None, **options):
    """One run in a bath, by default a Langevin with one or two frictions."""
    given = {**RUN, "bath": Langevin(kT, friction[0], KEY, *friction[1:]) if friction else HEAT, **options}
    return ml.integrate(method, body, torque, start, **given)


def of_three(bath, **options):
    return ml.ensemble("JACOBI[BAOAB]", BODY, None, still(3), bath=bath, **RUN, **options)


def on_axis(body, friction):
    return go(friction, body=body, start=AXIS, method="SYMMETRIC[BAOAB]")


SKEW, FRAME = [[1.0, 2, 0], [0, 1, 0], [0, 0, 1]], ml.TensorBody(np.diag(MOMENTS))
ONE_KEY = r"bath.key must have one key for each of 3 bodies.* pass jax.random.split\(key, 3\)"
test_bad_input_is_named = refused(
    (lambda: Langevin(-KT, 1.0, KEY), "kT must be finite and not negative"),
    (lambda: Langevin(KT, -1.0, KEY), "friction must not be negative"),
    (lambda: Langevin(KT, SKEW, KEY), "friction must be symmetric.*if these are three numbers for each"),
    (lambda: Langevin(KT, 1.0, 7), "key must be a typed key, got int"),
    (lambda: Langevin(KT, lambda t, s: 1.0, KEY), r"friction must be a function of \(t\)"),
    (lambda: ml.baths.Recoil([1.0, -1.0, 0.0], KEY), "diffusion must not be negative"),
    (lambda: ml.baths.Sum(), "a sum must have at least one bath"),
    (lambda: HEAT + 1.0, "a sum must be of baths of bodies"),
    (lambda: go(method="JACOBI[EA]"), "must have a stage for the bath"),
    (lambda: go(bath=None, torque=ml.torques.HeavyTop(1.0)), "but bath is None; pass bath="),
    (lambda: go(lambda t: jnp.ones(2)), "friction of one run must be of shape"),
    (lambda: go(1.0, kT=jnp.ones(3)), "kT must be one number"),
    (lambda: go(bath=RECOIL, start=ml.MomentumState(START.momentum)), "diffusion must be a number for a MomentumState"),
    (lambda: go(body=FREE[0], start=FREE[1], bath=ml.baths.Recoil(1.0, KEY)), "give Recoil the linear_diffusion"),
    (lambda: go(body=FREE[0], start=FREE[1]), "give Langevin the linear_friction"),
    (lambda: go(1.0, 1.0), "leave out linear_friction"),
    (lambda: go(dt=-0.1), "dt must be positive in a heat bath"),
    (lambda: go(bath=Langevin(KT, 1.0, keys(3))), "has one key, got"),
    (lambda: go([1.0, 2.0, 3.0], body=FRAME), "Give the tensor"),
    (lambda: on_axis(ml.SymmetricRotor(2.0), 1.0), r"SymmetricRotor\(moment, along\)"),
    (lambda: go(adjoint=ml.adjoints.Reversible()), "symmetric method"),
    (lambda: go(**PARTICLES), "Langevin acts on rigid bodies and rotors, not on a ParticleState"),
    (lambda: of_three(HEAT), ONE_KEY),
    (lambda: of_three(HEAT, torque_axes=["key"]), "the torque's parameters are bath.kT, bath.key, bath.friction"),
    (lambda: of_three(Langevin(KT, 1.0, keys(2)), torque_axes=0), "bath.* has .* rows"),
    (lambda: ml.integrate_variable_step("JACOBI[BAOAB]", BODY, None, START, **VARIABLE), "would bias averages"),
    (lambda: replace(schemes.BAOAB, name="x", gradients=(0.0, 0.0)), "weak order 2 at most; leave out gradients"),
    (lambda: schemes.Scheme("BAO", 2, BAO), "of order 2, but an order of"),
    (lambda: schemes.Scheme("O SRKN6b O", 4, LONG), "of order 4, but an order of"),
    (lambda: ml.check("JACOBI[BAOAB]", BODY, None, START, dt=0.1), "needs a deterministic run"),
)


def test_an_oblique_axis_is_refused_also_after_a_run_that_was_right():
    """What is remembered of the first run is of its shapes, not of its numbers."""
    on_axis(ROTOR, [1.0, 1.0, 3.0])
    with pytest.raises(ValueError, match="with the first two equal"):
        on_axis(ROTOR, [1.0, 2.0, 3.0])


@pytest.mark.sample(0)
def test_rows_of_a_bath_are_rows_of_one_body():
    count = 2
    weights, kT, friction = jnp.linspace(1.0, 2.0, count), jnp.linspace(0.5, 1.0, count), FRICTION * jnp.eye(3)
    bath, start = Langevin(kT, friction, keys(count)), too_hot(count)
    tops = ml.torques.HeavyTop(weights)
    run = partial(ml.ensemble, "JACOBI[BAOAB]", BODY, tops, start, bath=bath)

    def axis(path, leaf):
        return 0 if jax.tree_util.keystr(path) in (".mgl", ".kT", ".key") else None

    axes = tuple(jax.tree_util.tree_map_with_path(axis, tree) for tree in (tops, bath))
    for said in (["mgl", "bath.kT", "bath.key"], axes, "auto"):
        found = run(dt=0.1, steps=5, torque_axes=said).states.momentum[-1]
        one, torque = Langevin(kT[-1], friction, bath.key[-1]), ml.torques.HeavyTop(weights[-1])
        alone = go(body=BODY, torque=torque, start=last_of(start), steps=5, bath=one).states.momentum[-1]
        np.testing.assert_allclose(found, alone, rtol=1e-12, atol=1e-13)


@pytest.mark.sample(0)
def test_python_numbers_run_in_float32():
    path = go(1.3, kT=0.7, body=ml.RigidBody(jnp.asarray(MOMENTS, "float32")), start=last_of(still(1, "float32")))
    assert path.ok
    assert path.states.momentum.dtype == jnp.float32


@pytest.mark.sample(0)
def test_a_failure_is_a_flag():
    """A temperature or friction that becomes negative, a tensor that is not symmetric, a traced step backwards."""

    def falling(rate, value, t):
        return (1 - rate * t) * value

    def passed(cooling, rate, skew, dt):
        tensor = jnp.diag(jnp.array([1.0, 0.0, 1.0])).at[0, 1].set(skew)
        kT, friction = (jax.tree_util.Partial(falling, *given) for given in ((cooling, 1.0), (rate, tensor)))
        return go(bath=Langevin(kT, friction, KEY), dt=dt).ok

    bad = ([10.0, 0.0, 0.0, 0.1], [0.0, 10.0, 0.0, 0.1], [0.0, 0.0, 0.5, 0.1], [0.0, 0.0, 0.0, -0.1])
    found = jax.jit(jax.vmap(passed))(*np.array([[0.0, 0.0, 0.0, 0.1], *bad]).T)
    np.testing.assert_array_equal(found, [True, False, False, False, False])
    assert not go(bath=ml.baths.Recoil(lambda t: (1 - 10 * t) * jnp.array([1.0, 0.0, 1.0]), KEY)).ok


@pytest.mark.sample(0)
def test_keys_are_drawn_saved_and_resumed(tmp_path):
    drawn, some = (ml.scatter(jax.random.key(1), n, noise=ml.distributions.Key()) for n in (20, range(5, 9)))
    np.testing.assert_array_equal(*(jax.random.key_data(x) for x in (some["noise"], drawn["noise"][5:9])))
    run = {"dt": 0.1, "steps": 4, "chunk": 8, "group": 8, "out": tmp_path / "run.zarr", "progress": False}
    run |= {"method": "JACOBI[BAOAB]", "body": BODY, "torque": None, "start": still(20)}
    assert ml.simulate(**run, bath=Langevin(KT, FRICTION, drawn["noise"])).ok.all()
    with pytest.raises(ValueError, match="key"):
        ml.simulate(**run, bath=Langevin(KT, FRICTION, keys(20)), resume=True)


@pytest.mark.sample(0)
def test_a_free_body_diffuses_faster_by_a_known_factor_at_long_steps():
    """(x/2) coth(x/2) with x = h G/I, of position and rotation; angles are so small that rotations commute."""
    x, cold, zero = 2.0, 1e-6, jnp.zeros((MANY, 3))
    momenta = np.random.default_rng(4).normal(size=(2, MANY, 3)) * cold**0.5
    start = ml.FreeState(momenta[0], still(MANY).attitude, momenta[1], zero)
    bath, body = Langevin(cold, 1.0, keys(MANY), 1.0), ml.FreeBody(ml.RigidBody(np.ones(3)), 1.0)
    every = 10  # more than ten relaxation times
    run = {"dt": x, "steps": 4 * every, "save_every": every}
    states = ensemble("SYMMETRIC[BAOAB]", body, None, start, bath=bath, **run).states
    for way in (states.position, ml.so3.log(states.attitude)):
        gained = np.sum(np.asarray(way)[:, -1] ** 2 - np.asarray(way)[:, 1] ** 2, axis=-1) / (6 * cold * x * 3 * every)
        assert abs(gained.mean() - x / 2 / np.tanh(x / 2)) < 3 * gained.std() / np.sqrt(MANY)
