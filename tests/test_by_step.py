"""Torques that are constant in each step: pulses give their exact impulse, and controls are seen by their own steps."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import BUILDS, ROTATION, by_turns, epsilon, quick, rows, suited, worst
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax.methods.system import System

HOLD, PARTS, INTERVALS = 0.3, 3, 4  # intervals of three steps
STEPS = PARTS * INTERVALS
MOMENTS = np.array([1.0, 2.0, 2.5])
WIDTH, PUSH, COUNT = 0.02, 5.0, 4  # pulses about the third axis, from rest: the momentum stays on it
ROWS = 7  # runs side by side, so that one program serves all laws of a method
RNG = np.random.default_rng(7)
VALUES = RNG.normal(size=(INTERVALS, 3))
UP = [1.0, 0.0, 0.0, 0.0]
# dt, t0, starts and width: two pulses in one step, pulses much shorter than steps, steps backwards, edges at the ends
# of steps, pulses that overlap and last for several steps, and times at which the clock is coarser than a pulse.
CLOCKS = {
    "several in a step": (0.1, 0.0, [0.003, 0.31, 0.501, 0.502], WIDTH),
    "short": (1.0, 0.5, [0.51, 3.3, 6.0, 11.999], WIDTH),
    "backwards": (-0.37, 0.0, [-0.3, -2.22, -3.0, -3.01], WIDTH),
    "at the ends": (0.125, 0.25, [0.25, 0.5, 1.0, 1.375], 0.125),
    "overlapping": (0.1, 0.0, [0.05, 0.1, 0.3, 0.31], 0.35),
    "late": (0.25, 4096.0, [4096.1, 4097.01, 4097.02, 4098.3], 0.001),
}


@cache
def program(name, dtype):
    """A compiled run under pulses and controls, which saves every step; rows differ in all numbers."""

    def run(momentum, attitude, dt, t0, first, starts, width, push, values, hold):
        body = ml.RigidBody(suited(name, jnp.asarray(MOMENTS, dtype)))
        torque = ml.torques.Pulses(starts, width, push) + ml.torques.Held(values, hold)
        start = ml.RigidState(momentum, attitude)
        return ml.integrate(name, body, torque, start, dt=dt, steps=STEPS, t0=t0, first_step=first)

    return quick(jax.vmap(run))


def run(name, dtype, *cases):
    """The runs of all cases (momentum, attitude, dt, t0, first, starts, width, push, values, hold) at once."""
    padded = [*cases, *[cases[0]] * (ROWS - len(cases))]
    columns = [np.stack([np.asarray(x) for x in column]) for column in zip(*padded, strict=True)]
    cast = [jnp.asarray(x, jnp.int32 if x.dtype.kind == "i" else dtype) for x in columns]
    return jax.tree.map(lambda x: np.asarray(x)[: len(cases)], program(name, dtype)(*cast))


def pulses(dt, t0, starts, width, first=0, momentum=(0.0, 0.0, 0.0)):
    return momentum, UP, dt, t0, first, starts, width, [0.0, 0.0, PUSH], np.zeros((INTERVALS, 3)), abs(dt)


def controls(values, first=0, momentum=(0.2, -0.3, 0.4), attitude=UP):
    return momentum, attitude, HOLD / PARTS, 0.0, first, [0.0] * COUNT, 0.0, [0.0] * 3, values, HOLD


@pytest.mark.parametrize(("name", "dtype"), by_turns())
@pytest.mark.sample(6)
def test_pulses_give_their_impulse_for_every_method_and_step(name, dtype):
    cases = [pulses(*clock) for clock in CLOCKS.values()]
    # A run that goes on in the middle of a pulse.
    cases += [pulses(0.1, 0.0, [1.195, 1.19, 1.5, 1.6], WIDTH)]
    path = run(name, dtype, *cases)
    assert path.ok.all()
    dt, width = (np.array([case[i] for case in cases]) for i in (2, 6))
    total = np.sign(dt) * width * PUSH * COUNT
    found = path.states.momentum[:, -1].astype(np.float64)
    more = run(name, dtype, *[pulses(*case[2:4], case[5], case[6], STEPS, p) for case, p in zip(cases, found)])
    assert not found[:, :2].any()
    bound = 64 * epsilon(dtype)
    assert np.abs(found[:-1, 2] / total[:-1] - 1).max() <= bound
    assert 0 < found[-1, 2] < total[-1]
    assert np.abs(more.states.momentum[:, -1, 2] / total - 1).max() <= bound


@pytest.mark.parametrize(("name", "dtype"), by_turns())
@pytest.mark.sample(6)
def test_each_step_sees_the_control_of_its_interval_alone(name, dtype):
    """The run under held controls is that of a loop over intervals, each under a torque that never changes."""
    path = run(name, dtype, controls(VALUES))
    assert path.ok.all()
    momentum, attitude = path.states.momentum[:, 0], path.states.attitude[:, 0]
    for n, value in enumerate(VALUES):
        part = run(name, dtype, controls(np.tile(value, (INTERVALS, 1)), n * PARTS, momentum[0], attitude[0]))
        for one, whole in zip(*map(jax.tree.leaves, (part.states, path.states)), strict=True):
            assert worst(one[0, 1 : PARTS + 1], whole[0, n * PARTS + 1 : (n + 1) * PARTS + 1]) <= 4 * epsilon(dtype)
        momentum, attitude = part.states.momentum[:, PARTS], part.states.attitude[:, PARTS]


def body_of(dtype=np.float64):
    return ml.RigidBody(jnp.asarray(MOMENTS, dtype))


def start_of(dtype=np.float64):
    return ml.RigidState(jnp.asarray([0.2, -0.3, 0.4], dtype), jnp.asarray(UP, dtype))


def test_held_controls_are_those_of_the_equations_of_motion():
    def rate(t, y, torque):
        velocity, q = y[:3] / MOMENTS, y[3:]
        turning = np.concatenate([[-q[1:] @ velocity], q[0] * velocity + np.cross(q[1:], velocity)]) / 2
        return np.concatenate([np.cross(y[:3], velocity) + torque, turning])

    y = np.concatenate([start_of().momentum, UP])
    for n, value in enumerate(VALUES):
        y = solve_ivp(rate, (n * HOLD, (n + 1) * HOLD), y, "DOP853", args=(value,), rtol=1e-13, atol=1e-14).y[:, -1]
    found = ml.integrate(
        "GBS12", body_of(), ml.torques.Held(VALUES, HOLD), start_of(), dt=HOLD, steps=INTERVALS, save_every=None
    )
    assert worst(np.concatenate(jax.tree.leaves(found.states)), y) < 1e-11


GRADIENTS = ["JACOBI[EA]", "RK4", "JACOBI[SRKN6b]", "AKW", "GBS12", "SPIRAL"]


@pytest.mark.parametrize("name", GRADIENTS)
@pytest.mark.sample(3)
def test_the_gradient_with_respect_to_controls_is_exact(name):
    def cost(values):
        torque = ml.torques.Held(values, HOLD) + ml.torques.HeavyTop(0.7)
        path = ml.integrate(name, body_of(), torque, start_of(), dt=HOLD, steps=INTERVALS, save_every=INTERVALS)
        return path.states.attitude[-1] @ jnp.array([1.0, 2.0, 3.0, 4.0]) + jnp.sum(path.states.momentum[-1] ** 2)

    ahead, step = RNG.normal(size=VALUES.shape), 1e-4
    both = quick(jax.vmap(jax.value_and_grad(cost)))
    values, gradients = both(jnp.stack([VALUES - 2 * step * ahead, VALUES - step * ahead, VALUES]
                                       + [VALUES + step * ahead, VALUES + 2 * step * ahead]))
    slope = (8 * (values[3] - values[1]) - (values[4] - values[0])) / (12 * step)
    assert abs(float(jnp.vdot(gradients[2], ahead) / slope) - 1) < 1e-10
