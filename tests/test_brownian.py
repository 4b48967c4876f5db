"""BROWNIAN: the weak error of one step, diffusion, and what is refused."""

from functools import partial
from itertools import combinations
from unittest.mock import patch

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import keys, quick, refused, still

import midlie_jax as ml
from midlie_jax.model.exposure import PreparedBath

KT = 0.7
METHOD = ml.method("BROWNIAN")
MOMENTS = np.array([1.0, 2.0, 2.5])
TENSOR = np.array([[1.2, 0.3, -0.2], [0.3, 2.0, 0.4], [-0.2, 0.4, 3.0]])
LINEAR = np.array([[0.9, -0.2, 0.1], [-0.2, 1.5, 0.3], [0.1, 0.3, 0.7]])
POSE = ml.so3.exp(jnp.array([0.4, -0.7, 0.5]))
HERE = jnp.array([0.3, -0.2, 0.5])
Langevin, KEY = ml.baths.Langevin, jax.random.key(0)


def along(state, **weights):
    """Of each part of the pose that the state has, its sum with weights."""
    return [jnp.array(w) @ getattr(state, name) for name, w in weights.items() if hasattr(state, name)]


def pull(state):
    turn = {"attitude": [0.3, -0.5, 0.4, 0.7], "direction": [0.6, -0.5, 0.8], "axis": [0.6, -0.5, 0.8]}
    return sum(jnp.sin(x) + x**2 for x in along(state, **turn, position=[0.4, 0.8, -0.3]))


BODY, ROTOR = ml.RigidBody(MOMENTS), ml.SymmetricRotor(2.0, 0.9)
FREE = ml.FreeBody(BODY, 3.0)
ZERO, AXIS = jnp.zeros(3), jnp.array([0.48, 0.6, 0.64])
STATES = {  # body, state, friction, linear friction
    "tensor body": (ml.TensorBody(np.diag(MOMENTS) + 0.2), ml.RigidState(ZERO, POSE), TENSOR, None),
    "direction": (BODY, ml.DirectionState(ZERO, AXIS), TENSOR, None),
    "free, tensors": (FREE, ml.FreeState(ZERO, POSE, ZERO, HERE), TENSOR, LINEAR),
    "free axis": (ml.FreeBody(ROTOR, 3.0), ml.FreeAxisState(ZERO, AXIS, ZERO, HERE), [1.3, 1.3, 0.5], [0.8, 0.8, 0.4]),
}


def cubature(size):
    """Nodes and weights for standard normal numbers, exact up to degree 5 (Stroud and Secrest 1963)."""
    unit, far = np.eye(size), np.sqrt(size + 2)
    ends = [sign * far * axis for axis in unit for sign in (1, -1)]
    pairs = [far / np.sqrt(2) * (a * x + b * y) for x, y in combinations(unit, 2) for a in (1, -1) for b in (1, -1)]
    weights = [2 / (size + 2), *[(4 - size) / (2 * (size + 2) ** 2)] * len(ends), *[1 / (size + 2) ** 2] * len(pairs)]
    return jnp.array([np.zeros(size), *ends, *pairs]), jnp.array(weights)


def moved(state, rotation, shift):
    """The state after a rotation in the frame of its momentum, and a displacement in the frame of its position."""
    acts = {
        "attitude": lambda now: ml.so3.multiply(now, ml.so3.exp(rotation)),
        "direction": lambda now: ml.so3.rotate(ml.so3.exp(-rotation), now),
        "axis": lambda now: ml.so3.rotate(ml.so3.exp(rotation), now),
        "position": lambda now: now + shift,
    }
    for name in acts:
        if hasattr(state, name):
            state = eqx.tree_at(lambda s, name=name: getattr(s, name), state, replace_fn=acts[name])
    return state


PULL = ml.torques.FromPotential(lambda t, state: pull(state))


def generator(function, state, friction, linear, body):
    """The change per time of the mean of a function of the state: drift and diffusion, by derivatives."""
    mobility = jnp.linalg.inv(as_matrix(friction))
    moved_by = partial(moved, state)
    wrench, across = ml.torques.on_body(PULL, body)(0.0, state), jnp.zeros((3, 3))
    if linear is None:
        wrench = ml.torques.Wrench(wrench, jnp.zeros(3))
    else:
        frame = frame_of(state)
        across = frame @ jnp.linalg.inv(as_matrix(linear)) @ frame.T

    def at(numbers):
        return function(moved_by(numbers[:3], numbers[3:]))

    slope, bend = jax.grad(at)(jnp.zeros(6)), jax.hessian(at)(jnp.zeros(6))
    drift = jnp.concatenate([mobility @ wrench.torque, across @ wrench.force])
    return drift @ slope + KT * (jnp.sum(mobility * bend[:3, :3]) + jnp.sum(across * bend[3:, 3:]))


def as_matrix(friction):
    friction = jnp.asarray(friction)
    return friction if friction.ndim == 2 else jnp.diag(jnp.broadcast_to(friction, 3))


def frame_of(state):
    if hasattr(state, "attitude"):
        return ml.so3.to_matrix(state.attitude)
    first = jnp.cross(state.axis, jnp.array([0.0, 0.0, 1.0]))
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(state.axis, first), state.axis], 1)


def mean_after(function, name):
    """The mean of a function of the state after one step, over all random numbers, as a function of the step."""
    body, state, friction, linear = STATES[name]
    bath = Langevin(KT, friction, KEY, linear)
    nodes, weights = cubature(6 if linear is None else 12)

    def end(numbers, h):
        def given(self, stage, like):
            return tuple(numbers[3 * stage : 3 * stage + 3])

        with patch.object(PreparedBath, "noise", given):
            path = ml.integrate(METHOD, body, PULL, state, dt=h, steps=1, save_every=None, bath=bath)
        return function(path.states)

    return quick(lambda h: weights @ jax.vmap(end, (0, None))(nodes, h))


def seen(state):
    """A function of the state without symmetries."""
    (turn,) = along(state, attitude=[0.9, 0.4, -0.6, 0.2], direction=[0.5, 0.7, -0.9], axis=[0.5, 0.7, -0.9])
    return jnp.exp(turn) * sum(map(jnp.cos, along(state, position=[0.7, -0.4, 0.9])), 1.0)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", STATES)
def test_the_mean_after_a_step_is_that_of_the_equations_up_to_the_third_order(name):
    """Against f + h A f + h^2/2 A^2 f with the generator A, from derivatives alone: the error falls as h^3."""
    body, state, friction, linear = STATES[name]
    once = partial(generator, friction=friction, linear=linear, body=body)
    first, second = quick(lambda s: (once(seen, s), once(partial(once, seen), s)))(state)
    steps, mean = (0.02, 0.01), mean_after(seen, name)
    errors = [mean(h) - (seen(state) + h * first + h**2 / 2 * second) for h in steps]
    assert abs(errors[0]) < 100 * steps[0] ** 3
    assert 6.5 < errors[0] / errors[1] < 9.5


@pytest.mark.sample(0)
def test_a_friction_that_depends_on_time_slows_the_diffusion():
    """<cos> = exp(-2 kT integral of 1/G) = (1 + t)^(-2 kT/G) for a friction G (1 + t)."""
    count, friction, time = 10_000, 1.4, 2.0
    bath = Langevin(KT, lambda t: friction * (1 + t), keys(count))
    run = {"dt": 0.05, "steps": 40, "observe": ml.observe.Axis(), "bath": bath}
    cosine = np.asarray(ml.ensemble(METHOD, BODY, None, still(count), **run).states)[..., 2]
    assert abs(cosine.mean() - (1 + time) ** (-2 * KT / friction)) < 3.5 * cosine.std() / np.sqrt(count) + 1e-3


def go(body=BODY, torque=None, friction=1.0, linear=None, state=None, **options):
    state = ml.RigidState(ZERO + 0.3, POSE) if state is None else state
    bath = Langevin(KT, friction, KEY, linear)
    return ml.integrate(METHOD, body, torque, state, **{"dt": 0.1, "steps": 4, "bath": bath, **options})


@pytest.mark.sample(0)
def test_the_momentum_stays_and_a_step_that_is_too_long_is_a_flag():
    path = go(torque=ml.torques.HeavyTop(1.0))
    assert path.ok
    np.testing.assert_array_equal(path.states.momentum, np.full((5, 3), 0.3))
    for failed in (go(torque=ml.torques.HeavyTop(1e3)), go(friction=1e-3 * np.eye(3))):
        assert not failed.ok
        assert failed.result == ml.RESULTS.beyond_reach


TWO = Langevin(KT, 1.0, KEY) + ml.baths.Recoil(1.0, KEY)
test_what_is_refused = refused(
    (lambda: go(friction=0.0), "friction must be positive in every direction for BROWNIAN"),
    (lambda: go(FREE, state=ml.FreeState(ZERO, POSE, ZERO, ZERO), linear=0.0), "linear_friction must be positive"),
    (lambda: go(torque=ml.torques.Damping(1.0)), "torque must not read the momentum under BROWNIAN"),
    (lambda: go(bath=None), "has a stage for a heat bath, but bath is None"),
    (lambda: go(bath=TWO), "bath must be one midlie_jax.baths.Langevin for BROWNIAN"),
    (lambda: go(dt=-0.1), "dt must be positive in a heat bath"),
    (lambda: go(adjoint=ml.adjoints.Reversible()), "symmetric method"),
    (lambda: go(ml.Particles(AXIS), state=ml.ParticleState(ZERO, ZERO)), "moves RigidBody, but body is Particles"),
)
