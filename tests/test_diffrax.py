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
import pytest
from cases import AXIS, PARTICLE, ROTATION, epsilon, setup, swing, true_motion
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import midlie_jax as ml

# Times exact in binary, so that differences of times are the very step of `integrate`.
T0, DT, STEPS = 0.25, 1 / 64, 64
CASE = setup(t0=T0)
TIMES = T0 + DT * np.arange(STEPS + 1)
BODY = ml.RigidBody(jnp.asarray(CASE.moments))


def forces(args):
    """The top in a swinging field; args are the weight and the field's strength."""
    weight, strength = args
    return ml.torques.HeavyTop(weight, AXIS) + jax.tree_util.Partial(swing, strength)


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
    (name, list(KINDS)[i % len(KINDS)], "StepTo" if i % 3 else "ConstantStepSize", i % 2 == 0)
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
