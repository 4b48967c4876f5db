"""What the tests of the plug-in share: a top in a wind, springs, and solves of them compiled in a hurry."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from cases import AXIS, PARTICLE, QUICK, setup

import midlie_jax as ml

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
    """The term and the start for a method."""
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
