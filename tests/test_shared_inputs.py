"""Inputs that no body owns: computed once for an ensemble, and the motion is that of every body alone."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import WAYS, by_turns, epsilon, firsts, quick, real, worst

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
    assert max(map(worst, *map(jax.tree.leaves, (together.states, apart.states)))) < 16 * STEPS * epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["JACOBI[EA]", "JACOBI[SRKN14a]"])
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


def split_of(function, known, varying, *arguments):
    return hoist(jax.make_jaxpr(function)(*arguments), known, varying)


@pytest.mark.parametrize(
    ("known", "varying"), [([False, True, False], [True, False, False]), ([True, True, False], [False, False, False])]
)
def test_nothing_is_hoisted_that_is_unknown_or_the_same_in_every_step(known, varying):
    assert split_of(lambda n, a, x: jnp.sin(a * n) * x, known, varying, 3.0, 0.7, 1.1) is None


def test_a_torque_with_effects_stays_whole():
    def step(n, x):
        jax.debug.print("{}", n)
        return jnp.sin(n) * x

    assert split_of(step, [True, False], [True, False], 0.5, 1.1) is None


@jax.jit
def place(a, t):
    return jnp.exp(-a * t), jnp.sqrt(1 + t)


def test_a_function_that_a_step_calls_many_times_is_in_the_program_once():
    """All calls of the step in one, and that of the derivative; with the results of each call."""

    def step(h, n, a, x):
        for k in range(7):
            near, far = place(a, n * h + k / 7)
            x = x * near + jnp.sin(x) / far
        return x, jax.jvp(lambda t: place(a, t)[0], (n * h,), (h,))[1] * x

    def calls(function, *arguments):
        return sum(e.primitive.name == "jit" for e in jax.make_jaxpr(function)(*arguments).jaxpr.eqns)

    given = 0.25, 3.0, 0.7, 1.1
    split = split_of(step, [True, True, True, False], [False, True, False, False], *given)
    assert (calls(step, *given), calls(lambda *x: split.prepare(*x, None), *given[:3])) == (8, 2)
    np.testing.assert_allclose(split.rest(split.prepare(*given[:3], None), *given), step(*given), rtol=4e-16)
