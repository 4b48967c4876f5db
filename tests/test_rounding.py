"""Rounding is unbiased: over many steps its errors grow as the square root of their number, whatever the turn a step.

Each law takes many bodies and asks for a mean of zero, to three standard errors, and for a spread of at most one unit
in the last place times the square root of the number of steps; in float32 of a `CompensatedState`.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    CLASSES,
    METHODS,
    MOMENTUM_FLIGHTS,
    RIGID_FLIGHTS,
    by_turns,
    each,
    epsilon,
    equal_moments,
    quick,
    real,
    setup,
    suited,
    swing,
    whole,
)
from laboratory.runner import TURNS, free_bodies, spatial_momentum

import midlie_jax as ml
from midlie_jax.cli.oracle import exact_motion
from midlie_jax.integrators.splitting import Splitting

BODIES, STEPS = 16, 100_000  # bodies for each turn
FLOWN = {f"{flight.name}[EA]": flight for flight in RIGID_FLIGHTS}
EXACT = [flight for flight in RIGID_FLIGHTS if flight.order is None]
KEPT = {"float64": ml.RigidState, "float32": ml.CompensatedState}  # states whose sums are not biased


@cache
def ends(flight, dtype, kind, steps):
    """Moments, and momentum and pose at both ends of a free run, (n, 2, ...), in extended precision; and ok."""
    moments, momentum, attitude, dt = free_bodies(flight.equal_moments, dtype, count=BODIES, seed=6)

    def run(moments, momentum, attitude, dt):
        start = kind(momentum, attitude) if kind.leaves[0].has_pose else kind(momentum)
        method, body = ml.method(flight, "E1"), ml.RigidBody(moments)
        return ml.integrate(method, body, None, start, dt=dt, steps=steps, save_every=steps)

    path = real(jax.vmap(run))(moments, momentum, attitude, dt)
    return *(np.asarray(x, np.longdouble) for x in (moments, *whole_numbers(path.states))), np.asarray(path.ok)


def whole_numbers(states):
    """Momentum and pose, with their low parts if they have any, added in extended precision."""
    exact = [np.asarray(x, np.longdouble) for x in jax.tree.leaves(states)]
    return [exact[0] + exact[2], exact[1] + exact[3]] if isinstance(states, ml.CompensatedState) else exact


def changes(flight, dtype, kind, steps=STEPS):
    """The changes of what a free flight keeps, each (turns, bodies), relative, in units of sqrt(steps) eps."""
    moments, momentum, *pose, ok = ends(flight, dtype, kind, steps)
    assert ok.all()
    square = np.sum(momentum**2, axis=-1)
    found = {"length of Pi": square[:, 1] / square[:, 0] - 1}
    if pose:
        space = spatial_momentum(*pose, momentum)
        found |= {f"R Pi along {k}": (space[:, 1, k] - space[:, 0, k]) / np.sqrt(square[:, 0]) for k in range(3)}
    if flight.order is None:
        energy = np.sum(momentum**2 / moments[:, None], axis=-1)
        found["energy"] = energy[:, 1] / energy[:, 0] - 1
    unit = epsilon(dtype) * steps**0.5
    return {name: (change / unit).astype(float).reshape(len(TURNS), BODIES) for name, change in found.items()}


def unbiased(found):
    for name, change in found.items():
        error = change.std(ddof=1) / change.size**0.5
        assert abs(change.mean()) <= 3 * error, (name, change.mean() / error)
        assert np.sqrt(np.mean(change**2, axis=1)).max() <= 1, (name, np.sqrt(np.mean(change**2, axis=1)))


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("flight", "dtype"), by_turns(RIGID_FLIGHTS, few=RIGID_FLIGHTS), ids=lambda x: getattr(x, "name", x)
)
def test_rounding_of_a_free_flight_is_unbiased(flight, dtype):
    unbiased(changes(flight, dtype, KEPT[dtype]))


@pytest.mark.parametrize("flight", MOMENTUM_FLIGHTS, ids=lambda x: x.name)
def test_rounding_of_the_momentum_alone_is_unbiased(flight):
    """Of flights that find the momentum without the attitude, by other formulas."""
    unbiased(changes(flight, "float64", ml.MomentumState))


@cache
def spun_up(kind, share):
    """The errors of the momenta of balls under a constant torque, of `share` times their last place a step; `check`."""
    rng, steps, dt, eps = np.random.default_rng(0), 100_000, np.float32(0.5), epsilon("float32")
    momentum = np.stack([rng.uniform(1, 2, 64), np.zeros(64), np.zeros(64)], axis=-1).astype(np.float32)
    pull = (share * eps * rng.uniform(0.5, 1, 64) / dt).astype(np.float32)
    torque = jax.tree_util.Partial(lambda pull, t, state: pull * jnp.array([1, 0, 0], pull.dtype), jnp.asarray(pull))
    body = ml.RigidBody(jnp.full(3, 1000, jnp.float32))
    start = kind(momentum, np.tile(np.float32([1, 0, 0, 0]), (64, 1)))
    path = ml.ensemble("JACOBI[EA]", body, torque, start, dt=float(dt), steps=steps, torque_axes=0)
    gain = whole_numbers(path.states)[0][:, 0] - momentum[:, 0]
    found = ml.check("JACOBI[EA]", body, torque, start, dt=float(dt), steps=1000, torque_axes=0)
    return (gain - np.asarray(pull, float) * dt * steps) / momentum[:, 0], found.rounding, steps


@pytest.mark.sample(0)
@pytest.mark.parametrize("share", [0.3, 7.0])
def test_a_constant_torque_is_lost_to_rounding_unless_the_state_is_compensated(share):
    """It changes the momentum by the same bits in every step, and every sum rounds it the same way; `check` says so."""
    lost, told, steps = spun_up(ml.RigidState, share)
    error = np.sqrt(np.mean(lost.astype(float) ** 2))
    assert error > 0.05 * epsilon("float32") * steps
    assert told.loses(steps)
    assert 0.1 < told.error(steps) / error < 10
    assert "a CompensatedState loses" in told.text(steps)
    kept, told, steps = spun_up(ml.CompensatedState, share)
    assert np.max(np.abs(kept)) <= epsilon("float32") * max(1, share)
    assert not told.loses(steps)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("turn", "kind"), [(2e-5, ml.RigidState), (0.2, ml.RigidState), (1e-3, ml.CompensatedState)])
def test_check_estimates_the_rounding_of_a_free_body(kind, turn):
    """Of float32, within a factor of ten; and only small steps need a compensated state."""
    moments, momentum, attitude, _ = (x[:BODIES] for x in free_bodies(False, "float32", count=BODIES, seed=2))
    start, steps, dt = kind(momentum, attitude), 100_000, jnp.float32(turn / 0.67)
    path = ml.ensemble("JACOBI[EA]", ml.RigidBody(moments), None, start, dt=dt, steps=steps)
    p0, q0 = (x[:, None] for x in whole_numbers(start))
    p1, q1 = (x[:, None] for x in whole_numbers(path.states))
    change = np.linalg.norm((spatial_momentum(q1, p1) - spatial_momentum(q0, p0)).astype(float), axis=-1)
    error = np.sqrt(np.mean((change / np.linalg.norm(p0.astype(float), axis=-1)) ** 2))
    told = ml.check("JACOBI[EA]", ml.RigidBody(moments), None, start, dt=dt, steps=100).rounding
    assert 0.1 < told.error(steps) / error < 10
    assert told.loses(steps) == (kind is ml.RigidState and turn < epsilon("float32") ** 0.5)


@pytest.mark.sample(0)
@pytest.mark.parametrize("flight", [EXACT[0], *whole(*EXACT[1:])], ids=lambda flight: flight.name)
def test_the_rounding_of_a_compensated_state_is_that_of_the_changes(flight):
    """In proportion to the turn of a step, where that of a `RigidState` does not depend on the turn."""

    def errors(kind):
        along = [change for name, change in changes(flight, "float32", kind, 10_000).items() if name.startswith("R Pi")]
        return np.sqrt(np.mean(np.sum(np.square(along), axis=0), axis=1))

    assert np.all(errors(ml.CompensatedState) <= 4 * TURNS)
    assert np.all(errors(ml.RigidState) >= 0.2)


def swung(name, kind, state, first, dtype):
    """32 steps under gravity and a torque that turns with time, with every eighth state."""
    s = jax.tree.map(lambda x: jnp.asarray(x.astype(np.float32), dtype), setup())
    torque = ml.torques.HeavyTop(s.weight) + jax.tree_util.Partial(swing, s.strength)
    start = kind(s.momentum, s.attitude) if state is None else state
    body = ml.RigidBody(suited(name, s.moments))
    return ml.integrate(name, body, torque, start, dt=s.dt, t0=s.t0, steps=32, save_every=8, first_step=first)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=["JACOBI[CHIN4A]", "LIEMID[I]"]))
def test_a_compensated_state_moves_like_a_rigid_state_and_a_split_run_equals_the_whole(name):
    """In float32 like one in float64, to a few units in the last place; and split to the bit, low parts included."""
    run = quick(partial(swung, name, ml.CompensatedState, dtype=np.float32))
    path, truth = run(None, np.int32(0)), quick(partial(swung, name, ml.RigidState, dtype=float))(None, np.int32(0))
    assert path.ok
    for x, y in ((path.states.momentum, truth.states.momentum), (path.states.attitude, truth.states.attitude)):
        error = np.abs(np.asarray(x, float) - y) / np.linalg.norm(y, axis=-1, keepdims=True)
        assert error.max() <= 4 * epsilon("float32")
    rest = run(jax.tree.map(lambda x: x[2], path.states), np.int32(16))
    for x, y in zip(jax.tree.leaves(rest.states), jax.tree.leaves(path.states), strict=True):
        np.testing.assert_array_equal(x[:3], y[2:])


# A heavy top whose motion is known, with a scheme whose own error is below rounding at the fewest steps.
TOP, WEIGHT, TIME = np.array([1.0, 1.0, 0.625]), 2.5, 2.0
COUNTS = [256, 2048, 16384]


@cache
def tops(dtype):
    """Momenta and attitudes at the start and, by the closed form, at the end."""
    rng = np.random.default_rng(1)
    momentum, attitude = rng.normal(size=(BODIES, 3)) * [2, 2, 3], rng.normal(size=(BODIES, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    starts = [x.astype(dtype) for x in (momentum, attitude)]
    ends = [exact_motion(TOP, p, q, [TIME], weight=WEIGHT) for p, q in zip(*starts, strict=True)]
    return *starts, np.stack([end[0][0] for end in ends]), np.stack([end[1][0] for end in ends])


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns([f"{flight.name}[SRKN14a]" for flight in EXACT]))
def test_more_steps_of_a_forced_top_round_no_worse_than_their_square_root(name, dtype):
    """Against the closed form, momentum and attitude; and the energy, whose mean error stays zero."""
    *starts, momentum, attitude = tops(dtype)
    body, torque = ml.RigidBody(TOP.astype(dtype)), ml.torques.HeavyTop(jnp.asarray(WEIGHT, dtype))
    starts = KEPT[dtype](*starts)
    for steps in COUNTS:
        path = ml.ensemble(name, body, torque, starts, dt=jnp.asarray(TIME / steps, dtype), steps=steps)
        assert path.ok.all()
        end = ml.RigidState(*(jnp.asarray(x, float) for x in whole_numbers(path.states)))
        end, away = jax.tree.map(np.asarray, end), ml.so3.conjugate(jnp.asarray(attitude))
        unit = epsilon(dtype) * (steps * ml.schemes.SRKN14A.flights) ** 0.5
        size = np.linalg.norm(momentum, axis=1)
        errors = {
            "momentum": np.linalg.norm(end.momentum - momentum, axis=1) / size,
            "attitude": np.linalg.norm(ml.so3.log(ml.so3.multiply(away, jnp.asarray(end.attitude))), axis=1),
        }
        for part, error in errors.items():
            assert np.sqrt(np.mean(error**2)) <= 3 * unit, (part, steps, np.sqrt(np.mean(error**2)) / unit)
        gain = energy(end.momentum, end.attitude) - energy(*(np.asarray(x, float) for x in tops(dtype)[:2]))
        assert abs(gain.mean()) <= 3 * gain.std(ddof=1) / BODIES**0.5, (steps, gain / unit)


def energy(momentum, attitude):
    up = np.asarray(ml.so3.to_matrix(jnp.asarray(attitude)))[:, 2, 2] / np.sum(attitude**2, axis=1)
    return np.sum(momentum**2 / TOP, axis=1) / 2 + WEIGHT * up


OTHERS = [method.name for method in METHODS if not isinstance(method, Splitting)]
MASSES = {"float32": [2.0**-76, 2.0**74], "float64": [2.0**-600, 2.0**600]}
RATES = {"float32": [2.0**-54, 2.0**54], "float64": [2.0**-450, 2.0**450]}
FREE_RATES = {"float32": [2.0**-62, 2.0**62], "float64": [2.0**-510, 2.0**510]}


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns([*FLOWN, *OTHERS], few=[*[*FLOWN][::2], *CLASSES]))
def test_units_change_no_bit(name, dtype):
    """Of mass, by a power of two: moments, momentum and torque. Of time: momentum, the square in the torque, and dt."""
    moments, momentum, attitude, _ = (x[::12] for x in free_bodies(equal_moments(name), dtype, count=BODIES, seed=6))

    def run(moments, momentum, attitude, weight, dt):
        start, torque = ml.RigidState(momentum, attitude), ml.torques.HeavyTop(weight)
        path = ml.integrate(name, ml.RigidBody(moments), torque, start, dt=dt, steps=10, save_every=10)
        return path.states.attitude[-1], path.states.momentum[-1], path.ok

    made = quick(jax.vmap(run, in_axes=(0, 0, 0, None, None)))

    def same(mass, rate, weight):
        mass, rate, weight, dt = (jnp.asarray(x, dtype) for x in (mass, rate, weight, 0.4))
        turned, end, ok = made(moments, momentum, attitude, weight, dt)
        again, scaled, fine = made(
            moments * mass, momentum * mass * rate, attitude, weight * mass * rate * rate, dt / rate
        )
        return ok.all() and fine.all() and np.all(again == turned) and np.all(scaled / mass / rate == end)

    assert all(same(mass, 1, 0.7) for mass in MASSES[dtype])
    assert all(same(1, rate, 0.7) for rate in RATES[dtype])
    assert all(same(1, rate, 0) for rate in FREE_RATES[dtype])
