"""Inputs that no body owns: computed once for an ensemble, and the motion is that of every body alone."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import WAYS, by_turns, epsilon, firsts, quick, real

import midlie_jax as ml
from midlie_jax._xla.hoisting import hoist
from midlie_jax.drivers import shared_inputs
from midlie_jax.integrators.runge_kutta import RungeKutta
from midlie_jax.integrators.splitting import Splitting

FEW = firsts(lambda m: isinstance(m, Splitting) and m.loops, lambda m: isinstance(m, RungeKutta), lambda m: m.symmetric)
COUNT, STEPS, DT = 5, 32, 1 / 64
MOMENTS = (1.0, 2.0, 2.5)
EXPENSIVE = r"\b(sine|cosine|divide|sqrt|rsqrt|exponential|power|atan2)\("


def orbiting(strength, t, state):
    """The gravity gradient of a user who writes it on arrays: the place turns, and is the same for all bodies."""
    place = jnp.stack([jnp.cos(3 * t), jnp.sin(3 * t), 0.3 / (2 + jnp.cos(t))])
    u = ml.so3.to_matrix(state.attitude).T @ (place / jnp.sqrt(place @ place))
    return strength * jnp.cross(u, jnp.array(MOMENTS, t.dtype) * u)


def starts(dtype, count=COUNT):
    rng = np.random.default_rng(3)
    turns = rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return ml.RigidState(jnp.asarray(rng.normal(size=(count, 3)), dtype), jnp.asarray(turns, dtype))


def body(dtype):
    return ml.RigidBody(jnp.array(MOMENTS, dtype))


def torque(strength, dtype):
    return jax.tree_util.Partial(orbiting, jnp.asarray(strength, dtype))


def found(name, dtype, field, own_dt=False):
    """What `ensemble` finds, for one body."""
    start = jax.tree.map(lambda x: x[0], starts(dtype))
    method = ml.method(name).fitted(body(dtype))
    arguments = body(dtype), field, start, jnp.asarray(DT, dtype), jnp.zeros((), dtype)
    shared = jax.tree.map(lambda _: False, arguments[:2])
    return shared_inputs.find(method, arguments, (*shared, jax.tree.map(lambda _: True, start), own_dt, False))


def run(name, dtype, count=COUNT, **options):
    return ml.ensemble(name, body(dtype), torque(1.3, dtype), starts(dtype, count), dt=DT, steps=STEPS, **options)


def difference(a, b):
    return max(float(jnp.max(jnp.abs(x - y))) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns(WAYS, FEW))
def test_an_ensemble_with_prepared_inputs_moves_as_each_body_alone(name, dtype):
    """To rounding, of which the prepared inputs have another than those in the step."""
    assert found(name, dtype, torque(1.3, dtype)) is not None
    together = quick(partial(run, name, dtype, save_every=8))()

    def alone(start):
        return ml.integrate(name, body(dtype), torque(1.3, dtype), start, dt=DT, steps=STEPS, save_every=8)

    apart = quick(jax.vmap(alone))(starts(dtype))
    assert together.ok.all()
    assert apart.ok.all()
    assert difference(together.states, apart.states) < 16 * STEPS * epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["JACOBI[SRKN14a]"])
def test_a_run_in_two_parts_is_the_whole_run_bit_for_bit(name):
    whole = run(name, "float64", save_every=8)
    half = run(name, "float64", save_every=8).states
    middle = jax.tree.map(lambda x: x[:, 2], half)
    field = torque(1.3, "float64")
    rest = ml.ensemble(name, body("float64"), field, middle, dt=DT, steps=16, save_every=8, first_step=16)
    assert all(
        np.array_equal(x[:, 2:], y)
        for x, y in zip(jax.tree.leaves(whole.states), jax.tree.leaves(rest.states), strict=True)
    )


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["JACOBI[EA]", "DOP853", "JACOBI[SRKN14a]"])
def test_the_loop_over_steps_holds_nothing_expensive(name):
    """Only the table is computed with expensive operations, in blocks of rows; no loop over the bodies has any."""
    count = 517  # a number that nothing else in the program has
    text = real(partial(run, name, "float64", count)).lower().compile().as_text()
    fusions = [c for c in re.split(r"\n}\n+", text) if re.search(rf"\[{count}\]", c)]
    assert fusions
    assert not any(re.search(rf"\[{count}\]\S* {EXPENSIVE[2:]}", c) for c in fusions)


def test_what_a_body_has_of_its_own_is_not_shared():
    field = torque(1.3, "float64")
    assert found("JACOBI[EA]", "float64", field) is not None
    assert found("JACOBI[EA]", "float64", field, own_dt=True) is None
    assert found("JACOBI[EA]", "float64", ml.torques.HeavyTop(2.0)) is None
    assert found("JACOBI[EA]", "float64", None) is None


@pytest.mark.sample(0)
def test_derivatives_pass_through_the_table():
    """In a parameter of the shared input; in reverse through the ensemble, against forward through each body."""

    def end(run_of, phase):
        def field(t, state):
            return orbiting(1.3, t + phase, state)

        return jnp.sum(run_of(field).momentum[..., 0])

    def together(field):
        return ml.ensemble("JACOBI[EA]", body("float64"), field, starts("float64"), dt=DT, steps=8).states

    def apart(field):
        def one(start):
            return ml.integrate("JACOBI[EA]", body("float64"), field, start, dt=DT, steps=8).states

        return jax.tree.map(lambda x: x[:, -1], jax.vmap(one)(starts("float64")))

    reverse = quick(jax.grad(partial(end, together)))(0.4)
    forward = quick(jax.jacfwd(partial(end, apart)))(0.4)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-12)


@pytest.mark.sample(0)
def test_inputs_of_any_kind_are_shared():
    """Random numbers of the time, a table, a loop, a branch: as in each body alone."""
    key, table = jax.random.key(3), jnp.linspace(0, 1, 50)

    def field(t, state):
        noise = jax.random.normal(jax.random.fold_in(key, (64 * t).astype(jnp.int32)), (), t.dtype)
        course = jax.lax.fori_loop(0, 3, lambda _, x: jnp.sqrt(x + t), jnp.interp(t, table, table**2))
        return jnp.stack([noise, course, jax.lax.cond(t > 0.1, jnp.sin, jnp.zeros_like, t)]) * state.momentum[0]

    def alone(start):
        return ml.integrate("RK4", body("float64"), field, start, dt=DT, steps=8).states

    assert found("RK4", "float64", field) is not None
    together = ml.ensemble("RK4", body("float64"), field, starts("float64"), dt=DT, steps=8, save_every=1)
    assert difference(together.states, jax.vmap(alone)(starts("float64"))) < 1e-14


def split_of(function, known, varying, *arguments):
    return hoist(jax.make_jaxpr(function)(*arguments), known, varying)


def test_hoisting_takes_what_is_expensive_and_known_and_leaves_the_rest():
    def step(n, a, x):
        angle = a * n
        return jnp.sin(angle) * x + angle, jnp.cos(x)

    arguments = 3.0, 0.7, 1.1
    split = split_of(step, [True, True, False], [True, False, False], *arguments)
    (row,) = split.prepare(3.0, 0.7, None)
    assert row == jnp.sin(0.7 * 3.0)
    assert all(a == b for a, b in zip(split.rest([row], *arguments), step(*arguments), strict=True))


@pytest.mark.parametrize(
    ("known", "varying"), [([False, True, False], [True, False, False]), ([True, True, False], [False, False, False])]
)
def test_nothing_is_hoisted_that_is_unknown_or_the_same_in_every_step(known, varying):
    assert split_of(lambda n, a, x: jnp.sin(a * n) * x, known, varying, 3.0, 0.7, 1.1) is None


def test_hoisting_splits_a_loop_within_the_step():
    parts = jnp.array([0.1, 0.4, 0.9])

    def step(n, x):
        def turn(x, part):
            force = jnp.exp(-(n + part)) * x
            return x + force, (part, force)

        return jax.lax.scan(turn, x, parts)

    split = split_of(step, [True, False], [True, False], 0.5, 1.1)
    rows = split.prepare(0.5, None)
    assert [leaf.shape for leaf in jax.tree.leaves(rows)] == [(3,)]
    assert "exp" not in str(jax.make_jaxpr(split.rest)(rows, 0.5, 1.1))
    results, expected = split.rest(rows, 0.5, 1.1), jax.tree.leaves(step(0.5, 1.1))
    assert all(np.array_equal(a, b) for a, b in zip(results, expected, strict=True))


def test_a_torque_with_effects_stays_whole():
    def step(n, x):
        jax.debug.print("{}", n)
        return jnp.sin(n) * x

    assert split_of(step, [True, False], [True, False], 0.5, 1.1) is None
