"""Coupled bodies under every driver: what serves them, what is refused with the cure, and what a bad body costs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from travel_cases import COUPLED, KINDS, at, forced, gap, potential, start

import midlie_jax as ml

NAME = {kind: "SYMMETRIC[EA]" if KINDS[kind].axes else "JACOBI[EA]" for kind in COUPLED}


def setup(kind):
    return KINDS[kind].body(), forced(), start(kind)


def replicas(state, count=4):
    """Starts that differ a little."""
    factors = 1 + 0.01 * jnp.arange(float(count))
    many = jax.tree.map(lambda x: jnp.stack([x] * count), state)
    return type(state)(many.momentum * factors[:, None, None], *jax.tree.leaves(many)[1:])


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", ["five", "two axes"])
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
def test_bodies_with_full_tensors_move_as_in_their_principal_axes():
    one, kind, torque = start("five"), KINDS["five"], ml.torques.OnEach(ml.torques.PointMass(3.0))
    frames = jnp.broadcast_to(ml.so3.exp(jnp.array([0.3, -0.5, 0.9])), (5, 4))
    axes = np.asarray(ml.so3.to_matrix(frames[0]))
    tensor = ml.FreeBody(ml.TensorBody(axes @ kind.inertia @ axes.T), kind.mass)
    attitude = ml.so3.multiply(one.attitude, ml.so3.conjugate(frames))
    turned = ml.CoupledState(ml.so3.rotate(frames, one.momentum), attitude, one.linear, one.position)
    options = {"dt": 0.02, "steps": 20, "save_every": None}
    found = ml.integrate("JACOBI[EA]", tensor, torque, turned, **options)
    expected = ml.integrate("JACOBI[EA]", kind.body(), torque, one, **options)
    assert gap(found.states.position, expected.states.position) < 1e-12
    assert gap(found.states.momentum, ml.so3.rotate(frames, expected.states.momentum)) < 1e-12


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
    "N of the body": (lambda b, t, s: step(one_more(b), t, s), "leading axes"),
    "batch": (lambda b, t, s: step(b, t, replicas(s)), "midlie_jax.ensemble"),
    "weight": (lambda b, t, s: step(b, WEIGHT, s), r"OnEach\(UniformGravity"),
    "projection": (lambda b, t, s: step(b.body, None, rigid(s), "PGBS8"), "moves one body"),
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
    "bodies": (lambda b, t, s: ml.CoupledState.of_bodies(s), "FreeState"),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_what_is_refused(case):
    call, message = REFUSED[case]
    for kind in ("two", "five"):
        with pytest.raises(ValueError, match=message):
            call(*setup(kind))


def test_the_energy_is_computed_by_one_compiled_program():
    """Called again, it does not call the potential, whose operations on arrays would take a second one by one."""
    calls, body, begin = [], KINDS["five"].body(), start("five")

    def counted(t, state):
        calls.append(t)
        return potential(0.9, t, state)

    torque = ml.torques.FromPotential(counted)
    first = ml.observe.energy(body, torque, begin)
    traced = len(calls)
    assert ml.observe.energy(body, torque, begin) == first
    two = jax.tree.map(lambda x: jnp.stack([x, x]), begin)
    both = ml.observe.energy(body, torque, two, t=jnp.array([0.0, 1.0]))
    traced_of_two = len(calls)
    assert bool(jnp.all(ml.observe.energy(body, torque, two, t=jnp.array([2.0, 1.0])) == both))
    assert len(calls) - traced_of_two == 0 < traced < traced_of_two
