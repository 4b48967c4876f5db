"""The plug-in against `integrate`: method by kind of output by controller by adjoint, one body and a batch.

Compiling is what costs, so every solve keeps all kinds of output at once, and by default each method has one solve, in
which controllers, and one body and a batch, take turns; each adjoint meets one method.
"""

from functools import cache

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ROTATION, WAYS, each, epsilon, firsts, quick
from diffrax_cases import (
    ADJOINTS,
    ARGS,
    CONTROLLERS,
    DT,
    EVERY,
    FACTORS,
    SIZES,
    STEPS,
    T0,
    TIMES,
    TS,
    WEIGHTS,
    problem,
    row,
    solve,
)

import midlie_jax as ml
from midlie_jax.integrators.splitting import Splitting

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


def outputs(name, weight, controller, saveat=KINDS, adjoint="RecursiveCheckpointAdjoint"):
    """Everything that is kept, by its kind, and the result."""
    term, y0 = problem(name)
    options = CONTROLLERS[controller] | {"saveat": saveat, "adjoint": ADJOINTS[adjoint], "max_steps": STEPS}
    solution = solve(name, y0, (weight, ARGS[1]), term=term, **options)
    if saveat is not KINDS:
        return {"ts": solution.ys}, solution.result
    dense = jax.vmap(solution.evaluate)(jnp.asarray(TIMES)[jnp.array([EVERY, STEPS])])
    fn = jax.tree.map(lambda x: x / weight, solution.ys["fn"])
    return solution.ys | {"dense": dense, "fn": fn}, solution.result


def loss(states):
    """A number into which every state at the times of ts enters."""
    return sum(jnp.sum(jnp.sin(leaf)) for leaf in jax.tree.leaves(states))


def kept_and_slope(name, weight, controller, adjoint):
    """What is kept at ts, and the derivative of its loss in the weight."""

    def value(weight):
        kept, result = outputs(name, weight, controller, TS, adjoint)
        return loss(kept["ts"]), (kept, result)

    derivative = jax.jacfwd if adjoint == "ForwardMode" else jax.grad
    slope, kept = derivative(value, has_aux=True)(weight)
    return kept, slope


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


def differences(name):
    """The derivative of the loss in the weight, by the runs of `integrate`."""
    return float(np.dot(FACTORS, [loss(row(paths(name), i)) for i in range(len(SIZES))]))


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
@pytest.mark.parametrize("name", [*OWN, *each(few=WAYS)])
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


PAIRS = [
    ("LIEMID[EA]", "PIDController", "RecursiveCheckpointAdjoint"),
    pytest.param("NMB", "ConstantStepSize", "DirectAdjoint", marks=pytest.mark.full),
    ("LIEMID[E2]", "StepTo", "ForwardMode"),
]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "controller", "adjoint"), PAIRS)
def test_derivatives_equal_differences(name, controller, adjoint):
    """Of a method that keeps its torque, of one that solves for it, and of one that is handed it."""
    kept, slope = quick(lambda w: kept_and_slope(name, w, controller, adjoint))(ARGS[0])
    compare(kept, row(paths(name), 2))
    assert abs(slope - differences(name)) <= 1e-6 * abs(differences(name))
