"""Each kind of bad input: a ValueError whose message names it, or inside jit a flag and never an exception."""

from inspect import unwrap
from typing import Any

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from cases import CLASSES, each, refused, rows, run, setup

import midlie_jax as ml
from midlie_jax.drivers.clock import time_of

BODY = ml.RigidBody(jnp.array([1.0, 2.0, 2.5]))
START = ml.RigidState(jnp.array([1.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0, 0.0]))
UPRIGHT = START.momentum, START.attitude
PARTICLES = ml.Particles(jnp.array([1.0, 2.0, 3.0]))
PLACES = ml.ParticleState(jnp.ones(3), jnp.zeros(3))
NAN = float("nan")
SINGLE, SLOW = jax.tree.map(lambda x: x.astype(jnp.float32), (BODY, START))
SLOW_TWO = jax.tree.map(lambda x: x[None].repeat(2, 0), SLOW)
TENSOR = ml.TensorBody(np.diag([1.0, 2, 2.5]))
ORBIT = ml.orbits.CircularOrbit([1.0, 0, 0], [0.0, 1, 0], 1.0)


# The type checkers of the tests stand in front of the package's own checks; users do not have them.
def go(method="LIEMID[EA]", body=BODY, torque=None, start=START, dt=0.1, steps=2, **options):
    return unwrap(ml.integrate)(method, body, torque, start, dt=dt, steps=steps, **options)


def flying(mass, shape):
    return go("Verlet", ml.Particles(mass), None, ml.ParticleState(jnp.zeros(shape), jnp.ones(shape)))


def returns(value):
    return lambda t, state: value


BAD = {
    # bodies
    "moments must be positive.*-2": lambda: ml.RigidBody(jnp.array([1.0, -2.0, 2.0])),
    r"for a thin rod.*use midlie_jax.SymmetricRotor\(moment\)": lambda: ml.RigidBody([1.0, 1.0, 0.0]),
    "moments must be positive and finite.*nan": lambda: ml.RigidBody(jnp.array([1.0, NAN, 1.0])),
    "unphysical.*physical=False": lambda: ml.RigidBody(jnp.array([1.0, 2.0, 4.0])),
    "unphysical": lambda: ml.RigidBody([0.0833, 0.0833, 0.1669]),
    r"moments must have shape \(3,\).*\(2,\)": lambda: ml.RigidBody(jnp.array([1.0, 2.0])),
    "moments must be an array of numbers, got str": lambda: ml.RigidBody("abc"),
    "moments must be float32 or float64, got bool": lambda: ml.RigidBody([True, True, True]),
    "float16; cast it": lambda: ml.RigidBody(jnp.ones(3, jnp.float16)),
    "moments must be between.*units": lambda: ml.RigidBody(jnp.full(3, 1e300)),
    "full inertia tensor use midlie_jax.TensorBody or RigidBody.from_tensor": lambda: ml.RigidBody(jnp.eye(3) - 0.1),
    r"tensor must have shape \(3, 3\)": lambda: ml.RigidBody.from_tensor(jnp.ones((3, 2))),
    "tensor must be symmetric.*J.T": lambda: ml.RigidBody.from_tensor(jnp.eye(3).at[0, 1].set(0.5)),
    # particles
    "mass must be positive": lambda: ml.Particles(jnp.array(0.0)),
    r"mass must be a scalar.*\(2, 3\)": lambda: ml.Particles(jnp.ones((2, 3))),
    r"mass must be a scalar.*\(4, 3\).*flatten": lambda: ml.Particles(jnp.ones((4, 3))),
    r"body.mass must be a column or a row for .*of shape \(3, 3\).*mass\[:, None\].*mass\[None, :\]": lambda: flying(
        jnp.ones(3), (3, 3)
    ),
    "must be a column or a row for velocity": lambda: ml.Particles(jnp.ones(3)).momentum(jnp.ones((3, 3))),
    r"body.mass \(4, 1\) does not fit start.position of shape \(5, 3\).*\(5, 1\).*\(1, 3\)": lambda: flying(
        jnp.ones((4, 1)), (5, 3)
    ),
    r"body.mass must have one row per coordinate .*\(4, 4\).*\(4, 3\).*Flatten": lambda: flying(jnp.eye(4), (4, 3)),
    r"mass must be a scalar.*vmap": lambda: ml.Particles(jnp.ones((2, 2, 2))),
    "mass must be symmetric": lambda: ml.Particles(jnp.array([[2.0, 1.0], [0.0, 2.0]])),
    "positive definite": lambda: ml.Particles(jnp.array([[1.0, 2.0], [2.0, 1.0]])),
    # states
    r"momentum must have shape \(3,\)": lambda: ml.MomentumState(jnp.ones(4)),
    "momentum must be finite": lambda: ml.MomentumState(jnp.array([NAN, 0.0, 0.0])),
    "momentum must be float32 or float64": lambda: ml.MomentumState(jnp.ones(3, complex)),
    r"momentum \(3,\) and attitude \(5, 4\) must have the same leading axes": lambda: ml.RigidState(
        jnp.ones(3), jnp.tile(START.attitude, (5, 1))
    ),
    "attitude must be a unit quaternion.*norm": lambda: ml.RigidState(jnp.ones(3), jnp.array([1.0, 1.0, 0.0, 0.0])),
    r"attitude must have shape \(4,\)": lambda: ml.RigidState(jnp.ones(3), jnp.eye(3)),
    "direction must be a unit vector": lambda: ml.DirectionState(jnp.ones(3), jnp.ones(3)),
    "must have one shape": lambda: ml.ParticleState(jnp.ones(3), jnp.ones(2)),
    r"low_momentum must have shape \(3,\)": lambda: ml.CompensatedState(*UPRIGHT, jnp.zeros(4)),
    "low_attitude.*NaN": lambda: ml.CompensatedState(*UPRIGHT, low_attitude=jnp.full(4, jnp.nan)),
    "low_momentum.* must have the same leading axes": lambda: ml.CompensatedState(*UPRIGHT, jnp.zeros((2, 3))),
    # torques
    "mgl must be finite": lambda: ml.torques.HeavyTop(NAN),
    r"moment must have shape \(3,\)": lambda: ml.torques.DipoleInField(jnp.ones(2), jnp.ones(3)),
    "field must be finite": lambda: ml.torques.DipoleInField(jnp.ones(3), jnp.full(3, NAN)),
    "mu must be positive": lambda: ml.spacecraft.GravityGradient(jnp.ones(3), lambda t: None, -1.0),
    "velocity must be finite": lambda: ml.orbits.KeplerOrbit(jnp.ones(3), jnp.full(3, NAN), 1.0),
    "torque must be None or a callable": lambda: go(torque=jnp.ones(3)),
    r"torque must return float64\[3\].*\[2\]": lambda: go(torque=returns(jnp.ones(2))),
    "torque must return float64.*float32.*cast": lambda: go(torque=returns(jnp.ones(3, jnp.float32))),
    "MomentumState holds no direction.*RigidState": lambda: go(
        torque=ml.torques.HeavyTop(1.0), start=ml.MomentumState(jnp.ones(3))
    ),
    "no potential.*FromPotential": lambda: ml.observe.energy(BODY, returns(jnp.ones(3)), START),
    "VelocityDependent has no potential": lambda: ml.observe.energy(
        BODY, ml.torques.VelocityDependent(returns(jnp.ones(3))), START
    ),
    "needs the attitude.*RigidState": lambda: unwrap(ml.observe.spatial_momentum)(ml.MomentumState(jnp.ones(3))),
    r"axis must have shape \(3,\)": lambda: ml.torques.HeavyTop(1.0, (0.0, 1.0)),
    "a sum of torques needs at least one": lambda: ml.torques.Sum(None),
    "needs the attitude, which MomentumState does not have": lambda: go(
        torque=ml.spacecraft.PDControl([1.0, 0, 0, 0], 1.0, 1.0), start=ml.MomentumState(jnp.ones(3))
    ),
    "moments refer to principal axes; give None": lambda: go(
        body=TENSOR, torque=ml.spacecraft.GravityGradient([1.0, 2, 2.5], ORBIT, 1.0)
    ),
    "must be \\(n, 3\\) or .* for moments \\(n, 3\\).* Map other axes": lambda: unwrap(ml.observe.kinetic_energy)(
        ml.RigidBody(jnp.ones((4, 3))), ml.MomentumState(jnp.ones((5, 4, 3)))
    ),
    # integrate
    "name must be a name or a midlie_jax Flight, got int": lambda: unwrap(ml.method)(5, "EA"),
    "is a flight; add a scheme": lambda: unwrap(ml.method)(ml.flights.Jacobi()),
    r"did you mean 'JACOBI\[EA\]'": lambda: ml.method("JACOBI[EA"),
    "t0 must be finite": lambda: go(body=SINGLE, start=SLOW, t0=1e300, dt=0.1),
    r"t0 \+ \(first_step \+ steps\) dt must be finite in float32, got inf; choose a larger unit": lambda: go(
        body=SINGLE, start=SLOW, dt=2e38
    ),
    "dt must be finite in float32": lambda: ml.ensemble(
        "SW", SINGLE, None, SLOW_TWO, dt=jnp.array([0.1, 2e38], jnp.float32), steps=2
    ),
    "dt must be finite, got an integer that is too large": lambda: go(dt=10**400),
    "unknown method 'nobody'; choose from JACOBI.EA., .*Verlet": lambda: ml.method("nobody"),
    "did you mean 'Verlet'": lambda: go("verlet"),
    "unknown flight 'JACOBY'; did you mean 'JACOBI'": lambda: ml.method("JACOBY[EA]"),
    "unknown scheme 'SRKN14'; did you mean 'SRKN14a'": lambda: ml.method("JACOBI[SRKN14]"),
    "method must be a name or come from midlie_jax.method.name., got int": lambda: go(3),
    "start must be a state": lambda: go(start=jnp.ones(3)),
    "RigidState belongs to a RigidBody, but body is Particles": lambda: go(body=PARTICLES),
    "body is HeavyTop; the body comes before the torque": lambda: go(body=ml.torques.HeavyTop(1.0), torque=BODY),
    "'Verlet' moves Particles.*RigidBody.*methods": lambda: go("Verlet"),
    "'SW' moves RigidBody.*Particles": lambda: go("SW", PARTICLES, None, PLACES),
    r"start.momentum must be \(3,\), got \(5, 3\).*vmap": lambda: go(start=ml.MomentumState(jnp.ones((5, 3)))),
    r"body.moments must be \(3,\).*vmap": lambda: go(body=ml.RigidBody(jnp.ones((5, 3)))),
    "SYMMETRIC needs bodies with two equal moments.*use JACOBI": lambda: go("SYMMETRIC[EA]"),
    "the torque needs numbers.*jnp.where": lambda: go(
        torque=lambda t, state: jnp.ones(3) if state.momentum[0] > 0 else jnp.zeros(3)
    ),
    r"got float64\[5, 3\].*midlie_jax.ensemble": lambda: go(torque=ml.torques.HeavyTop(jnp.ones(5))),
    "axis must be a unit vector": lambda: ml.torques.HeavyTop(1.0, (0.0, 0.0, 2.0)),
    "dt must be finite and not zero, got 0": lambda: go(dt=0),
    "dt must not be zero in float32, got 1e-60; take other units, or use float64": lambda: go(
        body=SINGLE, start=SLOW, dt=1e-60
    ),
    "dt must be finite": lambda: go(dt=NAN),
    "steps must be a positive Python int, got 0": lambda: go(steps=0),
    "steps must be a positive Python int, got 2.0": lambda: go(steps=2.0),
    "save_every must be a positive Python int": lambda: go(save_every=0),
    r"steps \(10\) must be divisible by save_every \(3\)": lambda: go(steps=10, save_every=3),
    "first_step must be an integer, got 0.5": lambda: go(first_step=0.5),
    r"first_step must be one integer, got float64": lambda: go(first_step=jnp.array(2.7)),
    "count beyond 2147483647.*first_step 0": lambda: go(first_step=2**31 - 2, steps=2),
    "all of start must have one dtype": lambda: go(start=ml.RigidState(START.momentum, SLOW.attitude)),
    "body is float32 but start.momentum is float64; cast one.*astype": lambda: go(body=SINGLE),
    "torque is float32 but start.momentum is float64": lambda: go(torque=ml.torques.HeavyTop(jnp.float32(1.0))),
    "torque must be finite": lambda: go(torque=jax.tree.map(lambda x: NAN * x, ml.torques.HeavyTop(jnp.ones(())))),
}

test_is_named = refused(*((call, message) for message, call in BAD.items()))


def test_what_is_good_passes():
    assert go(dt=-0.1, t0=1, torque=returns(jnp.ones(3)), first_step=jnp.array(3)).ok
    assert go(dt=np.float32(0.1), torque=ml.torques.HeavyTop(2.0)).ok
    ml.RigidBody(jnp.array([1.0, 2.0, 4.0]), physical=False)
    ml.RigidBody(jnp.ones((3, 3)))  # three balls
    ml.RigidBody(jnp.array([1.0, 2.0, 3.0 * (1 + 1e-7)]))  # flat, but for rounding


@pytest.mark.parametrize(("dtype", "scale"), [("float64", 1e4), ("float32", 1e-20)])
def test_moments_of_a_flat_body_may_be_rounded(dtype, scale):
    """0.0833 + 0.0833 < 0.1667 by one unit in the last digit: the largest becomes the sum, in a batch, too."""
    given = np.array([[float(f"{x * scale:.6g}") for x in (0.0833, 0.1667, 0.0833)], [scale] * 3], dtype)
    moments = np.asarray(ml.RigidBody(given).moments)
    assert moments[0, 1] == given[0, 0] + given[0, 2]
    np.testing.assert_array_equal(moments[:, [0, 2]], given[:, [0, 2]])
    np.testing.assert_array_equal(moments[1], given[1])


def test_integers_are_numbers():
    """Lists of them for arrays, and NumPy's own for counts."""
    body, start = ml.RigidBody([1, 2, 2]), ml.RigidState([1, 0, 0], [1, 0, 0, 0])
    assert body.moments.dtype == start.momentum.dtype == jnp.float64
    path = go(body=body, start=start, torque=ml.torques.HeavyTop(2), dt=1, steps=np.int64(2), save_every=np.int32(1))
    assert path.ok
    assert path.times.shape == (3,)
    assert go(body=SINGLE, start=SLOW, torque=ml.torques.HeavyTop(2), dt=1).ok  # a plain number fits either dtype


def test_an_index_of_32_bits_is_counted_to_its_end_and_not_beyond():
    last = 2**31 - 1
    path = go(first_step=last - 2, steps=2, t0=-1.0, dt=0.5)
    assert path.ok
    np.testing.assert_array_equal(path.times, -1.0 + 0.5 * (last - 2 + np.arange(3)))
    traced = jax.jit(lambda n: go(first_step=n, steps=2).ok)
    assert traced(jnp.array(last - 2))
    assert not traced(jnp.array(last - 1))
    assert not traced(jnp.array(2**33))
    for narrow in (np.int8, np.int16, np.uint8):
        assert go(first_step=narrow(3), steps=2).ok


def test_a_time_is_that_of_the_exact_index():
    """To 3/4 of a unit in the last place: 1/2 from a sum and 1/4 from a product. A rounded index adds up to 1/2."""
    rng = np.random.default_rng(4)
    n, dt = rng.integers(2**24, 2**25, 1000), rng.uniform(1, 2, 1000).astype(np.float32)
    found = jax.jit(time_of)(jnp.float32(0), dt, n.astype(np.int32))
    exact = dt.astype(float) * n
    assert (np.abs(np.asarray(found, float) - exact) / np.spacing(exact.astype(np.float32))).max() <= 0.75


def test_values_are_not_read_inside_jit():
    made = jax.jit(lambda m, q: ml.RigidState(m, q))(jnp.full(3, NAN), jnp.ones(4))
    assert jnp.isnan(made.momentum).all()


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=CLASSES))
def test_failures_inside_jit_are_flags(name):
    """Too large a step, and NaN in the torque, the body or the start; the rows beside them are none the worse."""
    changes = [{}, {"dt": 50.0}, {"dt": 1e9}, {"weight": NAN}, {"strength": NAN}, {"moments": [1.0, 1.0, NAN]}]
    changes += [{"momentum": [NAN, 0.0, 1.0]}, {"attitude": [NAN, 0.0, 0.0, 1.0]}, {"dt": NAN}, {"weight": 1e300}]
    found = run(name, "float64", rows(*(setup(**change) for change in changes)))
    assert found.ok.tolist() == [True] + 9 * [False]
    assert np.isfinite(found.states.momentum[0]).all()


def test_a_number_is_no_torque(monkeypatch):
    """Zero alone, with which Python's sum begins."""
    torque: Any = ml.torques.HeavyTop(1.0)
    assert 0 + torque is torque
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    for add, shown in ((lambda: 7 + torque, "7"), (lambda: torque + 0.5, "0.5"), (lambda: sum([torque], 1), "1")):
        with pytest.raises(ValueError, match=rf"a function of \(t, state\), got {shown} in a sum.*Prescribed"):
            add()


def three(t, state, body):
    return state.momentum


NEED = r"must be a function of \(%s\), got one of \(t, state, body\)"
ROWS = jax.tree.map(lambda x: x[None], START)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: go("RK4", torque=three), "BodyTorque"),
        (lambda: go("RK4", torque=ml.torques.Sum(ml.torques.HeavyTop(1.0), three)), "BodyTorque"),
        (lambda: ml.ensemble("RK4", BODY, three, ROWS, dt=0.1, steps=1), "BodyTorque"),
        (lambda: ml.check("RK4", BODY, three, START, dt=0.1), "BodyTorque"),
        (lambda: go("RK4", torque=lambda t: jnp.zeros(3)), "Prescribed"),
        (lambda: ml.torques.Prescribed(three), NEED % "t"),
        (lambda: ml.torques.FromPotential(three), NEED % "t, state"),
        (lambda: go("RK4", observe=three), NEED % "t, state"),
        (
            lambda: ml.integrate_variable_step("LIEMID[EA]", BODY, None, START, dt=0.1, steps=1, density=three),
            NEED % "t, state",
        ),
        (lambda: ml.torques.BodyTorque(lambda x: x), r"of \(t, state, body\), got one of \(x\)"),
    ],
)
def test_functions_with_other_arguments_are_named_with_their_cure(monkeypatch, call, message):
    """Before they are called, when JAX would raise a TypeError from within; also as a term of a sum."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match=message):
        call()
