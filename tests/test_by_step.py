"""Torques that are constant in each step: pulses give their exact impulse, and controls are seen by their own steps."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import CLASSES, ROTATION, by_turns, epsilon, quick, refused, suited, worst

import midlie_jax as ml
from midlie_jax.model.torques.reads_body import ReadsBody

HOLD, PARTS, INTERVALS = 0.3, 3, 4  # intervals of three steps
STEPS = PARTS * INTERVALS
MOMENTS = np.array([1.5, 2.0, 2.5])
WIDTH, PUSH, COUNT = 0.02, 5.0, 4  # pulses about the third axis, from rest: the momentum stays on it
SOONEST = [*CLASSES, *(name for name in ROTATION if name not in CLASSES)]
FEW = ["JACOBI[EA]", "LIEMID[I]", "AKW", "GBS12", "JACOBI[SRKN6b]", "LIEMID[EA*]"]
ROWS = 7  # runs side by side, so that one program serves all laws of a method
RNG = np.random.default_rng(7)
VALUES = RNG.normal(size=(INTERVALS, 3))
UP = [1.0, 0.0, 0.0, 0.0]
BODY, START = ml.RigidBody(MOMENTS), ml.RigidState([0.2, -0.3, 0.4], UP)
STARTS = ml.RigidState([[0.4, -0.6, 0.8], START.momentum, START.momentum], [UP] * 3)
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


@pytest.mark.parametrize(("name", "dtype"), by_turns(SOONEST, FEW))
@pytest.mark.sample(1)
def test_pulses_give_their_impulse_for_every_method_and_step(name, dtype):
    cases = [pulses(*clock) for clock in CLOCKS.values()]
    # A run that goes on in the middle of a pulse.
    cases += [pulses(0.1, 0.0, [1.195, 1.19, 1.5, 1.6], WIDTH)]
    path = run(name, dtype, *cases)
    assert path.ok.all()
    dt, width = (np.array([case[i] for case in cases]) for i in (2, 6))
    total = np.sign(dt) * width * PUSH * COUNT
    found = path.states.momentum[:, -1].astype(np.float64)
    more = run(
        name, dtype, *[pulses(*case[2:4], case[5], case[6], STEPS, p) for case, p in zip(cases, found, strict=True)]
    )
    assert not found[:, :2].any()
    bound = 64 * epsilon(dtype)
    assert np.abs(found[:-1, 2] / total[:-1] - 1).max() <= bound
    assert 0 < found[-1, 2] < total[-1]
    assert np.abs(more.states.momentum[:, -1, 2] / total - 1).max() <= bound


@pytest.mark.parametrize(("name", "dtype"), by_turns(SOONEST, FEW))
@pytest.mark.sample(2)
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


@pytest.mark.parametrize("name", ["RK4", "LIEMID[EA]"])
@pytest.mark.sample(1)
def test_the_gradient_with_respect_to_controls_is_exact(name):
    adjoint = ml.adjoints.Reversible() if name == "LIEMID[EA]" else None

    def cost(values):
        torque = ml.torques.Held(values, HOLD) + ml.torques.HeavyTop(0.7)
        run = {"dt": HOLD, "steps": INTERVALS, "save_every": None, "adjoint": adjoint}
        end = ml.integrate(name, BODY, torque, START, **run).states
        return end.attitude @ jnp.array([1.0, 2.0, 3.0, 4.0]) + jnp.sum(end.momentum**2)

    ahead, step = RNG.normal(size=VALUES.shape), 1e-4
    both = quick(jax.vmap(jax.value_and_grad(cost)))
    values, gradients = both(jnp.stack([VALUES + k * step * ahead for k in (-2, -1, 0, 1, 2)]))
    slope = (8 * (values[3] - values[1]) - (values[4] - values[0])) / (12 * step)
    assert abs(float(jnp.vdot(gradients[2], ahead) / slope) - 1) < 1e-10


RUN = {"dt": HOLD / PARTS, "steps": STEPS, "save_every": None}


@pytest.mark.sample(0)
def test_steps_backwards_and_by_a_density_of_one_are_the_same():
    """The ends of steps by a density are those of the clock of a run to rounding alone."""
    torque = ml.torques.Held(VALUES, HOLD) + ml.torques.Pulses([0.31, 0.33], 0.01, [0.0, 2.0, 0.0])
    end = ml.integrate("LIEMID[EA]", BODY, torque, START, **RUN).states
    density = {"density": lambda t, state: jnp.ones_like(t)}
    other = ml.integrate_variable_step("LIEMID[EA]", BODY, torque, START, **RUN, **density).states
    back = {**RUN, "dt": -RUN["dt"], "first_step": -STEPS}
    back = ml.integrate("LIEMID[EA]", BODY, torque, end, **back).states
    for found, expected in ((other, end), (back, START)):
        assert max(map(worst, jax.tree.leaves(found), jax.tree.leaves(expected))) < 1e-14


@pytest.mark.sample(0)
def test_controls_of_each_body_are_its_own():
    values, pushes = RNG.normal(size=(3, *VALUES.shape)), RNG.normal(size=(3, 3))
    together = ml.torques.Held(values, HOLD) + ml.torques.Pulses([0.31, 0.33], [0.01, 0.01], pushes)
    alone = ml.torques.Held(values[1], HOLD) + ml.torques.Pulses([0.31, 0.33], 0.01, pushes[1])
    ends = ml.ensemble("LIEMID[EA]", BODY, together, STARTS, **RUN, chunk=2).states
    assert worst(ends.momentum[1], ml.integrate("LIEMID[EA]", BODY, alone, START, **RUN).states.momentum) < 1e-14


@pytest.mark.sample(0)
def test_a_controller_of_steps_keeps_the_impulse():
    import diffrax

    pulses = ml.torques.Pulses([0.31, 0.33, 2.0], 0.01, [0.0, 0.0, 2.0])
    term, start = ml.diffrax.RigidBodyTerm(BODY, pulses), ml.RigidState([0.0, 0.0, 0.1], UP)
    run = {"stepsize_controller": diffrax.PIDController(rtol=1e-5, atol=1e-5), "saveat": diffrax.SaveAt(steps=True)}
    found = diffrax.diffeqsolve(term, ml.diffrax.LieSolver("LIEMID[EA]"), 0.0, 5.0, 0.5, start, max_steps=512, **run)
    assert found.stats["num_accepted_steps"] < 400
    assert abs(float(found.ys.momentum[found.stats["num_accepted_steps"] - 1, 2]) - 0.16) < 1e-15


# A function of time within a torque: the torque from the function, the body, and the state.
class Pushed(ReadsBody):
    """A torque of a user that reads the body, and has a function of time in a field."""

    push: object

    def at(self, t, state, body):
        return self.push(t) - 0.1 * body.velocity(state.momentum)


def free(shape=()):
    rows = {"attitude": UP, "linear": [0.3, 0.3, 0.3], "position": [0.0, 1.0, 2.0]}
    return {name: np.broadcast_to(row, (*shape, len(row))) for name, row in rows.items()}


ONE = ml.FreeBody(BODY, 2.0)
WITHIN = {
    "a sum": (lambda f: ml.torques.HeavyTop(0.5) + (f + ml.torques.Damping(0.1)), BODY, START),
    "a field of a class": (Pushed, BODY, START),
    "an axis": (lambda f: f, ml.SymmetricRotor(2.0, 2.5), ml.AxisState([0.1, 0.2, 0.3], [0.0, 0.0, 1.0])),
    "an engine": (lambda f: ml.spacecraft.Thrust(f, [0.1, 0.0, 0.3]), ONE, ml.FreeState(jnp.ones(3), **free())),
    "many coupled bodies": (ml.torques.OnEach, ONE, ml.CoupledState(jnp.zeros((20, 3)) + 0.1, **free((20,)))),
    "a field on spins": (
        ml.spins.AppliedField,
        ml.spins.Spins(),
        ml.spins.SpinState([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]]),
    ),
}


def ends(torque, body, start, **run) -> Any:
    method = "SUBLATTICES[EA]" if isinstance(start, ml.spins.SpinState) else "LIEMID[EA]"
    if isinstance(body, ml.SymmetricRotor):
        method = "SYMMETRIC[EA]"
    path = ml.integrate(method, body, torque, start, **run, save_every=None)
    assert path.ok
    return path.states


@pytest.mark.parametrize("case", WITHIN)
@pytest.mark.sample(1)
def test_a_function_of_time_is_found_wherever_it_is_in_a_torque(case):
    """Two intervals under held values are two runs, each under one value."""
    torque, body, start = WITHIN[case]
    values, run = VALUES[:2], {"dt": 0.1, "steps": 2}
    both = ends(torque(ml.torques.Held(values, 0.2)), body, start, dt=0.1, steps=4)
    for n, value in enumerate(values):
        start = ends(torque(ml.torques.Held(np.tile(value, (2, 1)), 0.2)), body, start, **run, first_step=2 * n)
    assert max(map(worst, jax.tree.leaves(both), jax.tree.leaves(start))) < 1e-14


@pytest.mark.sample(0)
def test_values_can_be_wrenches_and_differ_between_coupled_bodies():
    wrench = ml.torques.Wrench(VALUES, RNG.normal(size=VALUES.shape))
    run = {"dt": HOLD / PARTS, "steps": STEPS}
    found = ends(ml.torques.Held(wrench, HOLD), ONE, ml.FreeState(jnp.zeros(3), **free()), **run)
    assert worst(found.linear, 0.3 + HOLD * wrench.force.sum(0)) < 1e-14
    values = RNG.normal(size=(INTERVALS, 2, 3)) * np.array([0.0, 0.0, 1.0])
    start = ml.CoupledRigidState(jnp.zeros((2, 3)), jnp.tile(jnp.array(UP), (2, 1)))
    pulses = ml.torques.Pulses([0.01, 0.5], [0.001, 0.3], values[:2])
    for torque, total in (
        (ml.torques.Held(values, HOLD), HOLD * values.sum(0)),
        (pulses, 0.001 * values[0] + 0.3 * values[1]),
    ):
        assert worst(ends(torque, BODY, start, **run).momentum, total) < 1e-14


def test_values_at_instants():
    held = ml.torques.Held(VALUES, 0.1, t0=1.0)
    times = 1.0 + 0.1 * np.arange(-1, INTERVALS + 2)
    expected = np.concatenate([np.zeros((1, 3)), VALUES, np.zeros((2, 3))])
    np.testing.assert_array_equal(jax.vmap(held)(times), expected)
    np.testing.assert_array_equal(jax.vmap(held)(times + 0.05), expected)
    pulses = ml.torques.Pulses([1.0, 1.5], 1.0, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    found = jax.vmap(pulses)(jnp.array([0.9, 1.0, 1.7, 2.1, 2.5]))
    np.testing.assert_array_equal(found[:, :2], [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])


test_errors = refused(
    (lambda: ml.torques.Held([1.0, 2.0, 3.0], 0.1), r"values must have shape \(K, 3\)"),
    (lambda: ml.torques.Held(np.zeros((4, 2)), 0.1), r"values must have shape \(K, 3\)"),
    (lambda: ml.torques.Held(VALUES, 0.0), "dt must be positive and finite, got 0"),
    (lambda: ml.torques.Held(VALUES * np.nan, 0.1), "values must be finite"),
    (lambda: ml.torques.Pulses(1.0, 0.1, [0.0, 0.0, 1.0]), r"starts must be an array of times \(P,\)"),
    (lambda: ml.torques.Pulses([1.0], -0.1, [0.0, 0.0, 1.0]), "width must be finite and not negative"),
    (lambda: ml.torques.Pulses([1.0], 0.1, 1.0), r"torque must have shape \(3,\)"),
    (lambda: ml.torques.Pulses([1.0, 2.0], 0.1, np.ones((3, 3)))(0.0), "one for each of the 2 pulses"),
    (lambda: ml.torques.Pulses([1.0, 2.0], [0.1] * 3, np.ones(3))(0.0), r"width \(\) or \(P,\), got"),
)


def test_a_step_longer_than_an_interval_is_refused():
    held, run = ml.torques.Held(VALUES, 0.1), {"dt": 0.11, "steps": 1}
    with pytest.raises(ValueError, match=r"dt must be at most the interval of .*Held, 0\.1, got 0\.11"):
        ml.integrate("LIEMID[EA]", BODY, held, START, **run)
    with pytest.raises(ValueError, match="dt must be at most the interval"):
        ml.ensemble("LIEMID[EA]", BODY, held, STARTS, **run)
    path = jax.jit(lambda dt: ml.integrate("LIEMID[EA]", BODY, held, START, dt=dt, steps=1))(0.11)
    assert not path.ok
