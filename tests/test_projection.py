"""Methods that keep the energy by a projection after each step, and with it the momentum about an axis in space."""

from functools import cache, partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, METHODS, epsilon, numbers, quick, real, turn, whole

import midlie_jax as ml
from midlie_jax.integrators.runge_kutta import RungeKutta

KEEPING = [method.name for method in METHODS if method.keeps_energy]
STEPS, DT = 2000, 0.25
ATTITUDE, MOMENTUM = turn(0.5, -0.3, 0.8), [1.0, 0.8, -1.3]
UP = ml.so3.to_matrix(jnp.asarray(ATTITUDE))[2]
BODY = ml.RigidBody([1.0, 2.0, 2.5])
TENSOR = ml.TensorBody(jnp.diag(BODY.moments) + 0.2 * (jnp.ones((3, 3)) - jnp.eye(3)))
TOP = ml.torques.HeavyTop(2.0, (0.48, 0.6, 0.64))
COMPASS = ml.torques.DipoleInField([0.3, 1.0, -0.4], [0.0, 0.0, 1.5])
START = ml.RigidState(MOMENTUM, ATTITUDE)
TILT = 0.7  # of a top that precesses once in 2 pi: I1 cos(tilt) + weight = I3 spin


def two_springs(t, state):
    """A potential without symmetry about any axis."""
    r = ml.so3.to_matrix(state.attitude)
    return r[0, 0] + 0.5 * r[1, 2] ** 2


# Body, torque, start, and the component of the spatial momentum that is constant, or None.
CASES = {
    "top": (BODY, TOP, START, 2),
    "top, its direction alone": (BODY, TOP, ml.DirectionState(MOMENTUM, UP), 0),
    "top, compensated": (BODY, TOP, ml.CompensatedState(MOMENTUM, ATTITUDE), 2),
    "compass of a tensor": (TENSOR, COMPASS, START, 2),
    "no axis": (BODY, ml.torques.FromPotential(two_springs), START, None),
    "free": (BODY, None, ml.MomentumState(MOMENTUM), 0),
    # Released from rest, it swings in a plane and stands still at both ends.
    "swing": (BODY, ml.torques.HeavyTop(2.0), ml.RigidState([0.0] * 3, turn(2.0, 0.0, 0.0)), None),
    "steady precession": (
        ml.RigidBody([1.0, 1.0, 2.0]),
        ml.torques.HeavyTop(1.0),
        ml.RigidState([0.0, np.sin(TILT), 1 + np.cos(TILT)], turn(TILT, 0.0, 0.0)),
        2,
    ),
    "at rest": (BODY, ml.torques.HeavyTop(-2.0), ml.RigidState([0.0] * 3, turn(0.0, 0.0, 1.0)), 2),
}


@cache
def path(name, case, dtype="float64", steps=STEPS, dt=DT, save_every=10):
    parts = jax.tree.map(lambda x: jnp.asarray(x, dtype) if isinstance(x, jax.Array) else x, CASES[case][:3])
    body, torque, start = parts
    run = real(lambda start: ml.integrate(name, body, torque, start, dt=dt, steps=steps, save_every=save_every))
    return numbers(run(start))


def invariants(case, states):
    """The energy, (n,), relative to the largest kinetic and potential energy; and the spatial momentum, (n, k)."""
    body, torque, _, _ = CASES[case]
    states = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), states)
    energy = np.asarray(ml.observe.energy(body, torque, states))
    kinetic = np.asarray(ml.observe.kinetic_energy(body, states))
    size = np.max(kinetic) + np.max(np.abs(energy - kinetic))
    if isinstance(states, ml.RigidState):
        momentum = ml.observe.spatial_momentum(states)
    elif isinstance(states, ml.DirectionState):
        momentum = jnp.sum(states.momentum * states.direction, axis=-1, keepdims=True)
    else:
        momentum = jnp.linalg.norm(states.momentum, axis=-1, keepdims=True)
    return energy / size, np.asarray(momentum) / max(np.linalg.norm(states.momentum, axis=-1).max(), 1e-300)


def in_turns(*axes):
    """Parameters: each value of the first axis with one of each other axis, in turns; the rest in the whole matrix."""
    first, *others = axes
    few = [(value, *(other[n % len(other)] for other in others)) for n, value in enumerate(first)]
    return [*few, *whole(*(values for values in product(*axes) if values not in few))]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("case", "dtype", "name"), in_turns(CASES, [*DTYPES, *DTYPES[::-1]], KEEPING))
def test_energy_and_momentum_about_the_axis_stay(name, dtype, case):
    """To rounding, whose errors walk."""
    found = path(name, case, dtype)
    assert found.ok
    energy, momentum = invariants(case, found.states)
    allowed = 4 * np.sqrt(STEPS) * epsilon(dtype)
    assert np.ptp(energy) <= allowed, np.ptp(energy) / allowed
    component = CASES[case][3]
    if component is not None:
        moved = np.ptp(momentum[:, component])
        assert moved <= allowed, moved / allowed


def plain(name):
    """The method that takes the same step without a projection."""
    method = ml.method(name)
    assert isinstance(method, RungeKutta)
    return next(m.name for m in METHODS if isinstance(m, RungeKutta) and m.formula == method.formula and not m.projects)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("case", "name"), in_turns(["swing", "steady precession"], KEEPING))
def test_a_projected_step_is_as_accurate(name, case):
    """Also where a body swings to rest, and where the gradients of the invariants are parallel."""
    fine = path("GBS12", case, steps=512, dt=1 / 64, save_every=512).states
    errors = {}
    for method in (plain(name), name):
        states = path(method, case, steps=32, dt=0.25, save_every=32).states
        errors[method] = max(
            float(np.abs(x[-1] - y[-1]).max())
            for x, y in zip(jax.tree.leaves(states)[:2], jax.tree.leaves(fine)[:2], strict=True)
        )
    assert errors[name] <= 4 * errors[plain(name)] + 1e-13, errors


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), in_turns(KEEPING, DTYPES))
def test_what_a_step_cannot_keep_it_says(name, dtype):
    """One step of many bodies, from short to far too long: the energy is kept to rounding, or `ok` is False."""
    rng = np.random.default_rng(9)
    count = 500
    moments = np.sort(np.exp(rng.uniform(-1.5, 1.5, (count, 3))), axis=1)
    moments[:, 2] = np.minimum(moments[:, 2], 0.95 * (moments[:, 0] + moments[:, 1]))
    attitudes = rng.normal(size=(count, 4))
    momenta = rng.normal(size=(count, 3)) * np.exp(rng.uniform(-3, 1.5, (count, 1)))
    attitudes /= np.linalg.norm(attitudes, axis=1)[:, None]
    weights, steps = np.exp(rng.uniform(-2, 3, count)), np.exp(rng.uniform(-3, 1, count))
    arrays = [jnp.asarray(x, dtype) for x in (moments, weights, momenta, attitudes, steps)]

    def step(method, moments, weight, momentum, attitude, dt):
        body, torque = ml.RigidBody(moments), ml.torques.HeavyTop(weight)
        path = ml.integrate(method, body, torque, ml.RigidState(momentum, attitude), dt=dt, steps=1)
        return path.states, path.ok

    def energies(moments, weight, states):
        kinetic = ml.observe.kinetic_energy(ml.RigidBody(moments), states)
        return kinetic, ml.observe.energy(ml.RigidBody(moments), ml.torques.HeavyTop(weight), states)

    errors, fine = {}, {}
    for method in (plain(name), name):
        states, fine[method] = numbers(quick(jax.vmap(partial(step, method)))(*arrays))
        exact = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), (*arrays[:2], states))
        kinetic, energy = numbers(jax.vmap(energies)(*exact))
        errors[method] = np.abs(energy[:, 1] - energy[:, 0]) / (kinetic[:, 0] + weights)
    kept = errors[name] <= 200 * epsilon(dtype)
    assert np.all(kept | ~fine[name]), errors[name][fine[name]].max() / epsilon(dtype)
    assert np.all(fine[name] | ~(errors[plain(name)] < 1e-5) | ~fine[plain(name)])
    assert not np.all(fine[name] | ~fine[plain(name)])  # some of the steps are too long


@pytest.mark.sample(0)
def test_a_small_swing_is_no_failure():
    """Where the potential, 1 - cos, is a small difference of large terms, and the energy has few digits."""

    def potential(t, state):
        return 10 - 10 * ml.so3.to_matrix(state.attitude)[2, 2]

    start = ml.RigidState(jnp.zeros(3), turn(1e-6, 0.0, 0.0))
    run = partial(ml.integrate, "PGBS8", BODY, ml.torques.FromPotential(potential), dt=DT, steps=200, save_every=200)
    path = quick(run)(start)
    assert path.ok, path.result
