"""Coupled bodies under every driver: what serves them, what is refused with the cure, and what a bad body costs."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from coupled_cases import DT, FIELD, KINDS, forced, potential, start
from travel_cases import at, gap

import midlie_jax as ml

NAME = {kind: "SYMMETRIC[EA]" if KINDS[kind].axes else "JACOBI[EA]" for kind in KINDS}
BOTH = ["two", "five"]


def setup(kind):
    return KINDS[kind].body(), forced(jnp.asarray(FIELD)), start(kind)


def replicas(state, count=4):
    """Starts that differ a little."""
    factors = 1 + 0.01 * jnp.arange(float(count))
    many = jax.tree.map(lambda x: jnp.stack([x] * count), state)
    return type(state)(many.momentum * factors[:, None, None], *jax.tree.leaves(many)[1:])


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", ["five", *(kind for kind in KINDS if kind != "five")])
def test_an_ensemble_moves_replicas(kind):
    """As each alone, also with a body and a step for each; and the energy is that of each."""
    body, torque, one = setup(kind)
    many, options = replicas(one), {"steps": 20, "save_every": 10}
    own = jax.tree.map(lambda x: jnp.stack([x * (1 + 0.01 * k) for k in range(4)]), body)
    dt = jnp.linspace(0.01, 0.02, 4)
    found = ml.ensemble(NAME[kind], own, torque, many, dt=dt, **options)
    assert found.states.momentum.shape == (4, 3, KINDS[kind].count, 3)
    alone = ml.integrate(NAME[kind], at(own, 2), torque, at(many, 2), dt=dt[2], **options)
    assert gap(at(found.states, 2), alone.states) < 1e-12
    energies = ml.observe.energy(own, torque, found)
    assert energies.shape == (4, 3)
    np.testing.assert_allclose(energies[2], ml.observe.energy(at(own, 2), torque, alone), rtol=1e-12)


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", ["five", "two", "two axes"])
def test_a_simulation_of_replicas_is_stored_and_resumed(kind, tmp_path):
    body, torque, one = setup(kind)
    many, options = replicas(one), {"dt": 0.01, "steps": 20, "save_every": 5}
    out = tmp_path / "run.zarr"
    run = ml.simulate(NAME[kind], body, torque, many, out=out, **options)
    again = ml.simulate(NAME[kind], body, torque, many, out=out, resume=True, **options)
    found = again.states()
    data = run.open()
    assert data.momentum.dims[-2:] == ("member", "space_axis" if KINDS[kind].axes else "axis")
    expected = ml.ensemble(NAME[kind], body, torque, many, **options)
    assert type(found) is type(one)
    assert gap(found, expected.states) < 1e-13


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", BOTH)
def test_variable_steps_follow_a_constant_density(kind):
    body, torque, one = setup(kind)
    found = ml.integrate_variable_step(NAME[kind], body, torque, one, dt=0.01, steps=20, density=lambda t, s: 1.0)
    fixed = ml.integrate(NAME[kind], body, torque, one, dt=0.01, steps=20)
    assert gap(found.states, fixed.states) < 1e-11


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", ["five", "two", "two axes"])
def test_diffrax_takes_the_same_steps_and_its_own_solvers_agree(kind):
    body, torque, one = setup(kind)
    solve = partial(diffrax.diffeqsolve, ml.diffrax.RigidBodyTerm(body, torque), t0=0.0, t1=0.2, dt0=0.02, y0=one)
    found = solve(ml.diffrax.LieSolver(NAME[kind]), saveat=diffrax.SaveAt(t1=True, ts=jnp.array([0.1, 0.15])))
    fixed = ml.integrate(NAME[kind], body, torque, one, dt=0.02, steps=10)
    assert gap(at(found.ys, 2), at(fixed.states, 10)) < 1e-12
    assert gap(at(found.ys, 0), at(fixed.states, 5)) < 1e-12
    assert gap(at(solve(diffrax.Dopri8()).ys, 0), at(fixed.states, 10)) < 1e-2


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", list(KINDS))
def test_free_motion_is_that_of_each_body(kind):
    body, _, one = setup(kind)
    times = jnp.array([0.0, 0.3, 2.0])
    found = ml.free_motion(body, one, times)
    assert found.ok
    assert found.first_bad == 3
    for i in range(KINDS[kind].count):
        alone = ml.free_motion(jax.tree.map(lambda x, i=i: x[i], body), one.of_body(i), times)
        assert gap(found.states.of_body(i), alone.states) < 1e-13


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", BOTH)
def test_check_finds_a_step(kind):
    body, torque, one = setup(kind)
    found = ml.check(NAME[kind], body, torque, one, dt=DT[3], steps=100)
    assert found.sane
    assert DT[3] < found.suggested < 10


@pytest.mark.sample(0)
def test_a_bad_number_of_one_replica_costs_no_other():
    body, torque, one = setup("five")
    many = replicas(one)
    broken = many.position.at[1, 3, 0].set(1e308)
    broken = ml.CoupledState(many.momentum, many.attitude, many.linear, broken)
    found = ml.ensemble("JACOBI[EA]", body, torque, broken, dt=0.01, steps=10)
    np.testing.assert_array_equal(found.ok, [True, False, True, True])
    whole = ml.ensemble("JACOBI[EA]", body, torque, many, dt=0.01, steps=10)
    keep = np.array([0, 2, 3])
    assert gap(at(found.states, keep), at(whole.states, keep)) == 0


def test_one_body_that_turns_too_far_fails_the_run():
    body, torque, one = setup("five")
    fast = ml.CoupledState(one.momentum.at[2].multiply(1e4), one.attitude, one.linear, one.position)
    path = ml.integrate("JACOBI[EA]", body, torque, fast, dt=0.1, steps=10)
    assert not path.ok
    assert path.result == ml.RESULTS.beyond_reach


@pytest.mark.sample(0)
def test_a_body_that_serves_all_is_the_same_as_a_row_for_each():
    _, torque, one = setup("five")
    each = ml.FreeBody(ml.RigidBody(np.tile([1.0, 1.2, 1.5], (5, 1))), np.full(5, 1.3))
    options = {"dt": 0.02, "steps": 10}
    found = ml.integrate("JACOBI[EA]", ml.FreeBody(ml.RigidBody([1.0, 1.2, 1.5]), 1.3), torque, one, **options)
    assert gap(found.states, ml.integrate("JACOBI[EA]", each, torque, one, **options).states) < 1e-14


@pytest.mark.sample(0)
@pytest.mark.parametrize("count", [2, 5])
def test_a_body_with_a_full_tensor_moves_as_in_its_principal_axes(count):
    one = start("two" if count == 2 else "five")
    frame = ml.so3.exp(jnp.array([0.3, -0.5, 0.9]))
    axes, moments = np.asarray(ml.so3.to_matrix(frame)), np.asarray(KINDS["two" if count == 2 else "five"].moments)
    mass, torque = KINDS["two" if count == 2 else "five"].mass, ml.torques.OnEach(ml.torques.PointMass(3.0))
    tensor = ml.FreeBody(ml.TensorBody(np.einsum("ia,na,ja->nij", axes, moments, axes)), mass)
    principal = ml.FreeBody(ml.RigidBody(moments), mass)
    frames = jnp.broadcast_to(frame, (count, 4))
    turned = ml.CoupledState(
        ml.so3.rotate(frames, one.momentum),
        ml.so3.multiply(one.attitude, ml.so3.conjugate(frames)),
        one.linear,
        one.position,
    )
    options = {"dt": 0.02, "steps": 20, "save_every": None}
    found = ml.integrate("JACOBI[EA]", tensor, torque, turned, **options)
    expected = ml.integrate("JACOBI[EA]", principal, torque, one, **options)
    assert gap(found.states.position, expected.states.position) < 1e-12
    assert gap(found.states.momentum, ml.so3.rotate(frames, expected.states.momentum)) < 1e-12


@pytest.mark.sample(0)
def test_a_linear_molecule_is_a_body_with_a_small_third_moment():
    """Kinds are not mixed; without a torque about the axis and without spin, the third moment enters nothing."""
    kind = KINDS["two axes"]
    axes = start("two axes")
    across = jnp.cross(axes.axis, axes.momentum)
    axes = ml.CoupledFreeAxisState(jnp.cross(across, axes.axis), axes.axis, axes.linear, axes.position)
    bodies = jax.vmap(lambda s: s.with_attitude())(axes.of_body(slice(None)))
    thin = jnp.concatenate([kind.body().body.moment[:, None]] * 2 + [1e-3 * jnp.ones((2, 1))], axis=1)
    options = {"dt": 0.01, "steps": 50, "save_every": None}
    found = ml.integrate(
        "SYMMETRIC[EA]",
        ml.FreeBody(ml.RigidBody(thin), kind.mass),
        forced(FIELD),
        ml.CoupledState.of_bodies(bodies),
        **options,
    )
    expected = ml.integrate("SYMMETRIC[EA]", kind.body(), forced(FIELD), axes, **options)
    assert gap(ml.CoupledFreeAxisState.of(found.states), expected.states) < 1e-11


def wrench(rows):
    return lambda t, s: ml.torques.Wrench(jnp.zeros((rows, 3)), jnp.zeros((rows, 3)))


def step(body, torque, state, name="JACOBI[EA]"):
    return ml.integrate(name, body, torque, state, dt=0.1, steps=1)


def rigid(state):
    return ml.CoupledRigidState(state.momentum, state.attitude)


def first(tree):
    return jax.tree.map(lambda x: x[0], tree)


def one_more(tree):
    return jax.tree.map(lambda x: jnp.stack([*x, x[0]]), tree)


WEIGHT, POINT = ml.torques.UniformGravity([0, 0, 1.0]), ml.torques.PointMass(1.0)
REFUSED = {
    "torque of one": (lambda b, t, s: step(b, lambda t, s: jnp.zeros(3), s), "torque must return|one row"),
    "other N": (lambda b, t, s: step(b, wrench(7), s), "must return"),
    "N of the body": (lambda b, t, s: step(one_more(b), t, s), "leading axes"),
    "batch": (lambda b, t, s: step(b, t, replicas(s)), "midlie_jax.ensemble"),
    "no batch": (lambda b, t, s: ml.ensemble("JACOBI[EA]", b, t, s, dt=0.1, steps=1), r"must be \(n, N, 3\)"),
    "free batch": (lambda b, t, s: step(b, t, s.of_body(slice(None))), "midlie_jax.ensemble"),
    "weight": (lambda b, t, s: step(b, WEIGHT, s), r"OnEach\(UniformGravity"),
    "top": (lambda b, t, s: step(b, ml.torques.HeavyTop(1.0), s), "OnEach"),
    "projection": (lambda b, t, s: step(b.body, None, rigid(s), "PGBS8"), "moves one body"),
    "implicit": (lambda b, t, s: step(b.body, None, rigid(s), "AKW"), "moves one body"),
    "recommend": (
        lambda b, t, s: ml.recommend(b, t, s, tolerance=1e-3, duration=1.0, length=1.0),
        "start must be of one body for recommend",
    ),
    "control": (
        lambda b, t, s: step(b, ml.spacecraft.PDControl([1.0, 0.0, 0.0, 0.0], 1.0, 1.0), s),
        r"PDControl acts on one body.*OnEach\(PDControl",
    ),
    "one on one": (lambda b, t, s: step(first(b), ml.torques.OnEach(POINT), s.of_body(0)), "leave OnEach out"),
    "shapes": (lambda b, t, s: ml.CoupledState(*(x[0] for x in jax.tree.leaves(s))), r"\(..., N, 3\) for N bodies"),
    "counts": (lambda b, t, s: ml.CoupledState(s.momentum, s.attitude, s.linear[:1], s.position), "have"),
    "bodies": (lambda b, t, s: ml.CoupledState.of_bodies(s), "FreeState"),
}


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("case", list(REFUSED))
def test_what_is_refused(kind, case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call(*setup(kind))


def test_the_energy_is_computed_by_one_compiled_program():
    """Called again, it does not call the potential, whose operations on arrays would take a second one by one."""
    calls, body, begin = [], KINDS["five"].body(), start("five")

    def counted(t, state):
        calls.append(t)
        return potential(FIELD, t, state)

    torque = ml.torques.FromPotential(counted)
    first = ml.observe.energy(body, torque, begin)
    traced = len(calls)
    assert ml.observe.energy(body, torque, begin) == first
    two = jax.tree.map(lambda x: jnp.stack([x, x]), begin)
    both = ml.observe.energy(body, torque, two, t=jnp.array([0.0, 1.0]))
    traced_of_two = len(calls)
    assert bool(jnp.all(ml.observe.energy(body, torque, two, t=jnp.array([2.0, 1.0])) == both))
    assert len(calls) - traced_of_two == 0 < traced < traced_of_two


def test_check_is_for_few_bodies():
    state = jax.tree.map(lambda x: jnp.concatenate([x] * 8), start("five"))
    with pytest.raises(ValueError, match="at most 32 coupled bodies"):
        ml.check("JACOBI[EA]", ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.5]), 1.0), None, state, dt=0.1)
