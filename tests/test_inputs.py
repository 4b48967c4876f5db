"""Each kind of bad input: a ValueError whose message names it, or inside jit a flag and never an exception."""

import inspect
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ROTATION, rows, run, setup

import midlie_jax as ml

BODY = ml.RigidBody(jnp.array([1.0, 2.0, 2.5]))
START = ml.RigidState(jnp.array([1.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0, 0.0]))
PARTICLES = ml.Particles(jnp.array([1.0, 2.0, 3.0]))
PLACES = ml.ParticleState(jnp.ones(3), jnp.zeros(3))
NAN = float("nan")

# The type checkers of the tests stand in front of the package's own checks; users do not have them.
integrate = inspect.unwrap(ml.integrate)


def go(method="LIEMID[EA]", body=BODY, torque=None, start=START, dt=0.1, steps=2, **options):
    return integrate(method, body, torque, start, dt=dt, steps=steps, **options)


def returns(value):
    return lambda t, state: value


def shapes(kind, **fields):
    """A value that cannot be built with the class's own checks, such as one made by `jax.tree.map`."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


BAD = {
    # bodies
    "negative moments": (lambda: ml.RigidBody(jnp.array([1.0, -2.0, 2.0])), "moments must be positive.*-2"),
    "zero moments": (lambda: ml.RigidBody(jnp.array([1.0, 0.0, 1.0])), "moments must be positive.*units"),
    "NaN moments": (lambda: ml.RigidBody(jnp.array([1.0, NAN, 1.0])), "moments must be positive and finite.*nan"),
    "infinite moments": (lambda: ml.RigidBody(jnp.array([1.0, jnp.inf, 1.0])), "moments must be positive and finite"),
    "unphysical moments": (lambda: ml.RigidBody(jnp.array([1.0, 2.0, 4.0])), "unphysical.*physical=False"),
    "one of a batch": (lambda: ml.RigidBody(jnp.array([[1.0, 1.0, 1.0], [1.0, 2.0, 4.0]])), "unphysical"),
    "two moments": (lambda: ml.RigidBody(jnp.array([1.0, 2.0])), r"moments must have shape \(3,\).*\(2,\)"),
    "integer moments": (lambda: ml.RigidBody(jnp.array([1, 2, 2])), "moments must be floating point.*int.*1.0"),
    "moments of text": (lambda: ml.RigidBody("abc"), "moments must be an array of numbers, got str"),
    "tensor shape": (lambda: ml.RigidBody.from_tensor(jnp.ones((3, 2))), r"tensor must have shape \(3, 3\)"),
    "tensor not symmetric": (
        lambda: ml.RigidBody.from_tensor(jnp.eye(3).at[0, 1].set(0.5)),
        "tensor must be symmetric.*J.T",
    ),
    "tensor NaN": (lambda: ml.RigidBody.from_tensor(jnp.eye(3).at[0, 0].set(NAN)), "tensor must be finite"),
    "tensor not positive": (lambda: ml.RigidBody.from_tensor(-jnp.eye(3)), "moments must be positive"),
    "tensor unphysical": (lambda: ml.RigidBody.from_tensor(jnp.diag(jnp.array([1.0, 1.0, 9.0]))), "unphysical"),
    # particles
    "mass zero": (lambda: ml.Particles(jnp.array(0.0)), "mass must be positive"),
    "mass negative": (lambda: ml.Particles(jnp.array([1.0, -1.0])), "mass must be positive"),
    "mass NaN": (lambda: ml.Particles(jnp.array([[NAN]])), "mass must be finite"),
    "mass not square": (lambda: ml.Particles(jnp.ones((2, 3))), r"mass must be a scalar.*\(2, 3\)"),
    "mass of three axes": (lambda: ml.Particles(jnp.ones((2, 2, 2))), r"mass must be a scalar.*vmap"),
    "mass not symmetric": (lambda: ml.Particles(jnp.array([[2.0, 1.0], [0.0, 2.0]])), "mass must be symmetric"),
    "mass indefinite": (lambda: ml.Particles(jnp.array([[1.0, 2.0], [2.0, 1.0]])), "positive definite"),
    "mass integer": (lambda: ml.Particles(1), "mass must be floating point"),
    # states
    "momentum shape": (lambda: ml.MomentumState(jnp.ones(4)), r"momentum must have shape \(3,\)"),
    "momentum NaN": (lambda: ml.MomentumState(jnp.array([NAN, 0.0, 0.0])), "momentum must be finite"),
    "momentum integer": (lambda: ml.MomentumState(jnp.array([1, 2, 3])), "momentum must be floating point"),
    "momentum a scalar": (lambda: ml.MomentumState(1.0), r"momentum must have shape \(3,\).*\(\)"),
    "attitude not unit": (
        lambda: ml.RigidState(jnp.ones(3), jnp.array([1.0, 1.0, 0.0, 0.0])),
        "attitude must be a unit quaternion.*norm",
    ),
    "attitude shape": (lambda: ml.RigidState(jnp.ones(3), jnp.eye(3)), r"attitude must have shape \(4,\)"),
    "attitude NaN": (lambda: ml.RigidState(jnp.ones(3), jnp.full(4, NAN)), "attitude must be a unit quaternion"),
    "direction not unit": (lambda: ml.DirectionState(jnp.ones(3), jnp.ones(3)), "direction must be a unit vector"),
    "position shape": (lambda: ml.ParticleState(jnp.ones(3), jnp.ones(2)), "must have one shape"),
    "position NaN": (lambda: ml.ParticleState(jnp.ones(1), jnp.full(1, NAN)), "position must be finite"),
    # torques
    "weight NaN": (lambda: ml.torques.HeavyTop(NAN), "weight must be finite"),
    "weight text": (lambda: ml.torques.HeavyTop("x"), "weight must be an array of numbers"),
    "dipole shape": (lambda: ml.torques.DipoleInField(jnp.ones(2), jnp.ones(3)), r"moment must have shape \(3,\)"),
    "field NaN": (lambda: ml.torques.DipoleInField(jnp.ones(3), jnp.full(3, NAN)), "field must be finite"),
    "mu negative": (lambda: ml.torques.GravityGradient(jnp.ones(3), lambda t: None, -1.0), "mu must be positive"),
    "orbit shape": (lambda: ml.orbits.CircularOrbit(jnp.ones(2), jnp.ones(3), 1.0), r"position must have shape"),
    "orbit NaN": (lambda: ml.orbits.KeplerOrbit(jnp.ones(3), jnp.full(3, NAN), 1.0), "velocity must be finite"),
    "torque not callable": (lambda: go(torque=jnp.ones(3)), "torque must be None or a callable"),
    "torque shape": (lambda: go(torque=returns(jnp.ones(2))), r"torque must return float64\[3\].*\[2\]"),
    "torque a scalar": (lambda: go(torque=returns(1.0)), r"torque must return float64\[3\].*jnp.stack"),
    "torque dtype": (lambda: go(torque=returns(jnp.ones(3, jnp.float32))), "torque must return float64.*float32.*cast"),
    "torque integer": (lambda: go(torque=returns(jnp.ones(3, int))), "torque must return float64.*int"),
    "force shape": (
        lambda: go("Verlet", PARTICLES, returns(jnp.ones(2)), PLACES),
        r"torque must return float64\[3\]",
    ),
    "no direction": (
        lambda: go(torque=ml.torques.HeavyTop(1.0), start=ml.MomentumState(jnp.ones(3))),
        "MomentumState knows no direction.*RigidState",
    ),
    "energy of a callable": (lambda: ml.energy(BODY, returns(jnp.ones(3)), START), "no potential.*FromPotential"),
    "energy of damping": (
        lambda: ml.energy(BODY, ml.torques.VelocityDependent(returns(jnp.ones(3))), START),
        "VelocityDependent has no potential",
    ),
    "spatial momentum": (lambda: ml.spatial_momentum(ml.MomentumState(jnp.ones(3))), "needs the attitude.*RigidState"),
    # integrate
    "unknown method": (lambda: ml.method("LIEMID"), "unknown method 'LIEMID'; choose from LIEMID.E1., .*Verlet"),
    "unknown name": (lambda: go("RK5"), "unknown method 'RK5'"),
    "method a number": (lambda: go(3), "method must come from midlie_jax.method.name., got int"),
    "start not a state": (lambda: go(start=jnp.ones(3)), "start must be a state"),
    "body of another kind": (lambda: go(body=PARTICLES), "RigidState belongs to RigidBody, but body is Particles"),
    "particles' method": (lambda: go("Verlet"), "'Verlet' moves Particles.*RigidBody.*methods"),
    "rotations' method": (lambda: go("SW", PARTICLES, None, PLACES), "'SW' moves RigidBody.*Particles"),
    "batch without vmap": (
        lambda: go(start=ml.MomentumState(jnp.ones((5, 3)))),
        r"start.momentum must be \(3,\), got \(5, 3\).*vmap",
    ),
    "bodies without vmap": (lambda: go(body=ml.RigidBody(jnp.ones((5, 3)))), r"body.moments must be \(3,\).*vmap"),
    "dt array": (lambda: go(dt=jnp.ones(3)), r"dt must be a scalar, got shape \(3,\).*vmap"),
    "dt NaN": (lambda: go(dt=NAN), "dt must be finite"),
    "t0 infinite": (lambda: go(t0=float("inf")), "t0 must be finite"),
    "t0 array": (lambda: go(t0=jnp.ones(1)), "t0 must be a scalar"),
    "steps zero": (lambda: go(steps=0), "steps must be a positive Python int, got 0"),
    "steps negative": (lambda: go(steps=-3), "steps must be a positive Python int, got -3"),
    "steps float": (lambda: go(steps=2.0), "steps must be a positive Python int, got 2.0"),
    "steps bool": (lambda: go(steps=True), "steps must be a positive Python int, got True"),
    "save_every zero": (lambda: go(save_every=0), "save_every must be a positive Python int"),
    "save_every float": (lambda: go(save_every=1.0), "save_every must be a positive Python int"),
    "not divisible": (lambda: go(steps=10, save_every=3), r"steps \(10\) must be divisible by save_every \(3\)"),
    "first_step float": (lambda: go(first_step=0.5), "first_step must be an integer, got 0.5"),
    "state of two dtypes": (
        lambda: go(start=ml.RigidState(START.momentum, START.attitude.astype(jnp.float32))),
        "all of start must have one dtype",
    ),
    "body of another dtype": (
        lambda: go(body=ml.RigidBody(BODY.moments.astype(jnp.float32))),
        "body is float32 but start.momentum is float64; cast one.*astype",
    ),
    "torque of another dtype": (
        lambda: go(torque=ml.torques.HeavyTop(jnp.array(1.0, jnp.float32))),
        "torque is float32 but start.momentum is float64",
    ),
    "NaN put in later": (
        lambda: go(torque=shapes(ml.torques.HeavyTop, weight=jnp.array(NAN), axis=(0.0, 0.0, 1.0))),
        "torque must be finite",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_is_named(name):
    call, message = BAD[name]
    with pytest.raises(ValueError, match=re.compile(message, re.DOTALL)):
        call()


def test_what_is_good_passes():
    assert go(dt=-0.1, t0=1, torque=returns(jnp.ones(3)), first_step=jnp.array(3)).ok
    assert go(dt=np.float32(0.1), torque=ml.torques.HeavyTop(2.0)).ok
    ml.RigidBody(jnp.array([1.0, 2.0, 4.0]), physical=False)
    ml.RigidBody(jnp.array([1.0, 2.0, 3.0 * (1 + 1e-7)]))  # flat, but for rounding


def test_values_are_not_read_inside_jit():
    made = jax.jit(lambda m, q: ml.RigidState(m, q))(jnp.full(3, NAN), jnp.ones(4))
    assert jnp.isnan(made.momentum).all()


@pytest.mark.parametrize("name", ROTATION)
def test_failures_inside_jit_are_flags(name):
    """Too large a step, and NaN in the torque, the body or the start; the rows beside them are none the worse."""
    found = run(
        name,
        "float64",
        rows(
            setup(),
            setup(dt=50.0),
            setup(dt=1e9),
            setup(weight=NAN),
            setup(strength=NAN),
            setup(moments=[1.0, NAN, 1.0]),
            setup(momentum=[NAN, 0.0, 1.0]),
            setup(attitude=[NAN, 0.0, 0.0, 1.0]),
            setup(dt=NAN),
            setup(weight=1e300),
        ),
    )
    assert found.ok.tolist() == [True] + 9 * [False]
    assert np.isfinite(found.states.momentum[0]).all()


def test_particles_fail_with_a_flag():
    def force(t, state):
        return jnp.where(t > 0.15, jnp.nan, -state.position)

    for name in ("Verlet", "implicit midpoint"):
        assert go(name, PARTICLES, force, PLACES, steps=1).ok
        assert not go(name, PARTICLES, force, PLACES, steps=4).ok
