"""Torques of spacecraft, each against what it is known to do; driven wheels in a control loop; sidereal time."""

from datetime import datetime, timedelta, timezone
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import refused
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax.model import so3, torques

BODY = ml.RigidBody(jnp.array([1.0, 1.8, 2.3]))
START = ml.RigidState(jnp.array([0.3, -0.8, 0.5]), so3.exp(jnp.array([0.2, 0.9, -0.4])))
ZERO = jnp.zeros(3)
REST = ml.RigidState(ZERO, START.attitude)
SPIN = jnp.array([0.4, -0.2, 0.9])  # of rotors


def run(torque, steps, start, dt=0.02):
    path = ml.integrate("JACOBI[EA]", BODY, torque, start, dt=dt, steps=steps, save_every=steps // 10)
    assert path.ok
    return path


def test_control_brings_a_body_to_its_target_and_to_rest():
    """By the short way: no more than the angle at the start."""
    target, turn = so3.exp(jnp.array([-0.4, 0.2, 0.6])), -2.5
    start = ml.RigidState(ZERO, so3.multiply(target, so3.exp(jnp.array([0.0, 0.6, 0.8]) * turn)))
    path = run(ml.spacecraft.PDControl(target, 2.0, jnp.array([3.0, 4.0, 4.5])), 2000, start)
    left = np.linalg.norm(so3.log(so3.multiply(so3.conjugate(target), path.states.attitude)), axis=-1)
    assert left[0] == pytest.approx(abs(turn))
    assert np.all(left <= left[0] + 1e-12)
    assert left[-1] < 1e-6
    assert np.linalg.norm(path.states.momentum[-1]) < 1e-6


def test_wheels_that_speed_up_turn_a_body_at_rest_the_other_way():
    """I Omega = -h: what the motors give to the wheels, the body loses; all of R (Pi + h) stays."""

    def speed(t):
        return SPIN * jnp.sin(0.7 * t)

    path = run(ml.spacecraft.ReactionWheels(speed), 1000, REST, dt=0.005)
    whole = np.asarray(so3.rotate(path.states.attitude, path.states.momentum + jax.vmap(speed)(path.times)))
    np.testing.assert_allclose(whole, 0, atol=1e-5)
    wheels = ml.spacecraft.ReactionWheels(lambda t: SPIN + 0 * t), ml.spacecraft.MomentumWheels(SPIN)
    steady, rotors = (run(torque, 10, START).states for torque in wheels)
    np.testing.assert_allclose(steady.momentum, rotors.momentum, rtol=1e-14)


ORBIT = ml.orbits.CircularOrbit(jnp.array([2.0, 0.0, 0.0]), jnp.array([0.0, 0.6, 0.8]), 1.0)


def test_the_field_of_a_dipole_is_minus_the_gradient_of_its_potential():
    pole = jnp.array([0.1, -0.2, 1.5])
    field = ml.orbits.DipoleField(ORBIT, pole, 1.0)
    for t in (0.0, 3.0, 11.0):
        slope = jax.grad(lambda place: pole @ place / jnp.sum(place**2) ** 1.5)(ORBIT(t))
        np.testing.assert_allclose(field(t), -slope, rtol=1e-12)


def test_drag_pushes_against_the_wind_and_turns_the_lever_down_it():
    """The torque is lever x R^T F, F against the motion and with the square of the speed."""
    lever, wind = jnp.array([0.0, 0.0, 0.5]), jnp.array([3.0, 0.0, 4.0])
    drag = torques.Drag(lever, 2.0, 0.1, wind)
    force = -0.5 * 0.1 * 2.0 * 5.0 * wind
    exact = jnp.cross(lever, so3.rotate(so3.conjugate(START.attitude), force))
    np.testing.assert_allclose(drag(0.0, START), exact, rtol=1e-13)
    moving = torques.Drag(lever, 2.0, 0.1, lambda t: wind * (1 + t))
    np.testing.assert_allclose(moving(1.0, START), 4 * exact, rtol=1e-13)


gmst, PULL = ml.spacecraft.gmst, ml.spacecraft.GravityGradient(BODY.moments, ORBIT, 1.0)
test_mistakes_are_named = refused(
    (lambda: wheels_of(torque=-1.0), "torque must be finite and not negative"),
    (lambda: wheels_of(friction=1.0), "friction and inertia must be given together"),
    (lambda: driven(PLAIN, ZERO, jnp.zeros(4)), "command must have shape"),
    (
        lambda: driven(wheels_of(momentum=0.1), HELD, COMMAND),
        "momenta must be within the limit of the wheels.*raise",
    ),
    (lambda: driven(PLAIN, ZERO, ZERO, torque=torques.Damping(0.1)), "torque must not read the momentum"),
    (lambda: gmst(53101.3), "epoch must be a Julian date from 1800 to 2200, got 53101.3; add 2400000.5"),
    (lambda: gmst(float("nan")), "epoch must be a Julian date"),
    (lambda: gmst("2026-13-01T00:00:00"), "epoch must be an existing date"),
    (lambda: gmst("13 April 2026"), "epoch must be an epoch such as"),
    (lambda: run(ml.spacecraft.PDControl(lambda t: jnp.zeros(3), 1.0, 1.0), 10, START), "target must return a quat"),
    (lambda: ml.spacecraft.PDControl(START.attitude, 1.0, 1.0, limit=-1.0), "limit must be finite and not negat"),
    (lambda: torques.Damping(jnp.ones(2)), r"coefficient must be a number or have shape \(3,\).*write jnp.tile\("),
    (lambda: ml.spacecraft.PDControl(jnp.ones(4), 1.0, 1.0), "target must be a unit quaternion"),
    (lambda: torques.Drag(jnp.ones(3), 1.0, 1.0, jnp.full(3, jnp.nan)), "velocity must be finite"),
    (lambda: torques.Damping(1.0)(0.0, START), r"Damping reads the body: call torque.on\(body\)"),
    (lambda: ml.observe.energy(BODY, torques.Damping(1.0), START), "Damping has no potential energy"),
    (lambda: PULL(0.0, ml.DirectionState(SPIN, jnp.eye(3)[0])), "holds one fixed direction; use a RigidState"),
)


PANEL = ml.Surface.of_facets([2.0], [[1.0, 0.0, 0.0]], [[0.0, 0.5, 0.0]])
FLYING = ml.FreeBody(BODY, 2.0), ml.FreeState(START.momentum, START.attitude, jnp.ones(3), jnp.ones(3))
SPINNING = ml.spins.Spins(), ml.spins.SpinState(jnp.eye(3)[:2])
X = (1.0, 0.0, 0.0)
FUNCTIONS = {
    "field of a dipole": (lambda f: torques.DipoleInField(X, f), "field", BODY, START),
    "field of currents": (lambda f: ml.spacecraft.EddyCurrents(1.0, f), "field", BODY, START),
    "force": (lambda f: ml.spacecraft.Thrust(f, X), "force", *FLYING),
    "lever": (lambda f: ml.spacecraft.Thrust(X, f), "lever", *FLYING),
    "velocity": (lambda f: torques.Drag(X, 1.0, 1.0, f), "velocity", BODY, START),
    "wind": (lambda f: torques.Drag(X, 1.0, 1.0, wind=f), "wind", *FLYING),
    "wind of a ball": (lambda f: torques.Magnus(1.0, f), "wind", *FLYING),
    "orbit": (lambda f: ml.spacecraft.GravityGradient(None, f, 1.0), "orbit", BODY, START),
    "orbit of a field": (lambda f: torques.DipoleInField(X, ml.orbits.DipoleField(f, X)), "orbit", BODY, START),
    "wheels": (ml.spacecraft.ReactionWheels, "momentum", BODY, START),
    "direction": (lambda f: ml.asteroids.Sunlight(PANEL, f, 1.0), "direction", BODY, START),
    "velocity in a gas": (lambda f: ml.spacecraft.FreeMolecularDrag(PANEL, 1.0, f), "velocity", BODY, START),
    "wind of a gas": (lambda f: ml.spacecraft.FreeMolecularDrag(PANEL, 1.0, wind=f), "wind", *FLYING),
    "field on spins": (ml.spins.AppliedField, "value", *SPINNING),
}
RETURNED = {
    "two": (lambda t: t * jnp.ones(2), r"an array of shape \(2,\)"),
    "four": (lambda t: t * jnp.ones(4), r"an array of shape \(4,\)"),
    "a number": (lambda t: t, r"an array of shape \(\)|float"),
    "a list": (lambda t: [t, t, t], "list"),
}


@pytest.mark.parametrize(("case", "returned"), [*zip(FUNCTIONS, [*RETURNED] * 4, strict=False)])
def test_a_function_of_time_returns_a_vector(case, returned):
    """JAX reads beyond the end of an array without an error, so that two or four components would do for three."""
    make, name, body, state = FUNCTIONS[case]
    function, what = RETURNED[returned]
    message = rf"{name} is a function of time, which must return an array \(3,\), got ({what}); use jnp.array"
    with pytest.raises(ValueError, match=message):
        jax.eval_shape(lambda t: torques.on_body(make(function), body)(t, state), jnp.zeros(()))
    jax.eval_shape(torques.on_body(make(lambda t: jnp.stack([t, t, t])), body), jnp.ones(()), state)


MU, RADIUS = 3.986e14, 7e6
CIRCLE = ml.orbits.CircularOrbit([RADIUS, 0.0, 0.0], [0.0, 0.6, 0.8], MU)
MEAN_MOTION = (MU / RADIUS**3) ** 0.5


def test_control_follows_the_local_frame_within_its_limit():
    """The pitch axis is a principal axis, so the error goes to zero, and the torque never exceeds the limit."""
    body, limit = ml.RigidBody([10.0, 12.0, 7.0]), 2e-3
    control = ml.spacecraft.PDControl(CIRCLE.lvlh, 0.02, 0.6, limit=limit)
    start = ml.RigidState([0.0, 0.0, 0.0], so3.multiply(CIRCLE.lvlh(0.0), so3.exp(jnp.array([0.5, -0.4, 0.3]))))
    observe = {
        "angles": ml.observe.EulerAngles(frame=CIRCLE.lvlh),
        "torque": lambda t, state: control.on(body)(t, state),
        "rate": ml.observe.angular_velocity,
    }
    path = ml.integrate("JACOBI[EA]", body, control, start, dt=0.5, steps=4000, save_every=20, observe=observe)
    assert path.ok
    assert np.abs(path.states["torque"]).max() <= limit * (1 + 1e-12)
    assert np.abs(path.states["torque"]).max() == pytest.approx(limit)
    assert np.abs(path.states["angles"][-1]).max() < 1e-6
    np.testing.assert_allclose(path.states["rate"][-1], [0.0, -MEAN_MOTION, 0.0], atol=1e-8)


def test_pitch_librates_at_the_rate_of_the_gravity_gradient():
    """n sqrt(3 (I1 - I3) / I2) for small pitch (Hughes, chapter 9), seen by `observe.EulerAngles`."""
    body = ml.RigidBody([11.0, 12.0, 4.0])
    torque = ml.spacecraft.GravityGradient(None, CIRCLE, MU)
    attitude = so3.multiply(CIRCLE.lvlh(0.0), so3.exp(jnp.array([0.0, 1e-4, 0.0])))
    start = ml.RigidState.from_velocity(body, [0.0, -MEAN_MOTION, 0.0], attitude)
    observe = ml.observe.EulerAngles("ZYX", frame=CIRCLE.lvlh)
    path = ml.integrate("JACOBI[SRKN6b]", body, torque, start, dt=20.0, steps=500, observe=observe)
    yaw, pitch, roll = np.asarray(path.states).T
    rate = MEAN_MOTION * np.sqrt(3 * (11.0 - 4.0) / 12.0)
    np.testing.assert_allclose(pitch, 1e-4 * np.cos(rate * np.asarray(path.times)), atol=1e-8)
    np.testing.assert_allclose([yaw, roll], 0, atol=1e-11)


def test_sidereal_time_is_as_published():
    """By D. A. Vallado, Fundamentals of Astrodynamics (2013), example 3-5, and at 2000 by Aoki and others (1982)."""
    epochs = "1992-08-20T12:14:00", 2451545.0, datetime(2000, 1, 1, 14, tzinfo=timezone(timedelta(hours=2)))
    right = [152.578787810, 280.46061837, 280.46061837]
    np.testing.assert_allclose(np.degrees([*map(gmst, epochs)]), right, rtol=0, atol=1.2e-7)  # of dates in days


@pytest.mark.parametrize("epoch", ["1950-01-01T00:00:00", "1999-12-31T23:59:59.5", "2026-04-13T21:45:00", 2461144.25])
def test_sidereal_time_is_that_of_astropy(epoch):
    """Which evaluates the same formula by ERFA; a Julian date has a rounding of 3e-9 rad."""
    time = pytest.importorskip("astropy.time")
    given = time.Time(epoch, scale="ut1", format="jd" if isinstance(epoch, float) else "isot")
    right = given.sidereal_time("mean", "greenwich", model="IAU1982").rad
    assert gmst(epoch) == pytest.approx(right, abs=1e-13)
    assert gmst(float(given.jd)) == pytest.approx(right, abs=3e-9)


MOMENTS, SLANTED = np.array([5.0, 4.0, 3.0]), np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
CRAFT, BEGIN = ml.RigidBody(MOMENTS), ml.RigidState([0.1, -0.2, 0.1], ml.so3.exp(jnp.array([0.3, -0.1, 0.2])))
TENSOR = ml.TensorBody([[5.0, 0.4, 0.1], [0.4, 4.0, -0.3], [0.1, -0.3, 3.0]])
FREE = ml.FreeState(BEGIN.momentum, BEGIN.attitude, [1.0, 2.0, 0.0], [0.0, 0.0, 3.0])
FRICTION, INERTIA = 0.002, 0.01
COMMAND, HELD = jnp.array([0.01, -0.02, 0.015, 0.005]), jnp.array([0.1, 0.2, -0.1, 0.05])
wheels_of = partial(ml.spacecraft.DrivenWheels, SLANTED)


def in_space(state, momenta):
    return ml.so3.rotate(state.attitude, state.momentum + momenta @ wheels_of().axes)


def stepper(dt=0.05, body=CRAFT, start=BEGIN, torque=None) -> Any:
    return ml.stepper("JACOBI[EA]", body, torque, start, dt=dt)


def driven(wheels, *given, **options):
    one = stepper(**options)
    return wheels.advance(one, one.init(), *given)


LIMITS, RUBBING = {"torque": 0.03, "momentum": [0.1, 0.15, 0.2, 0.12]}, {"friction": FRICTION, "inertia": INERTIA}


@pytest.mark.parametrize(
    ("body", "start", "limits", "friction"),
    [(CRAFT, BEGIN, LIMITS, {}), (TENSOR, BEGIN, LIMITS, RUBBING), (ml.FreeBody(CRAFT, 3.0), FREE, {}, {})],
)
def test_body_and_wheels_keep_their_momentum_to_rounding(body, start, limits, friction):
    """In space, under commands that change at random and saturate the wheels."""
    wheels, one = wheels_of(**limits, **friction), stepper(body=body, start=start)

    def sample(loop, command):
        return wheels.advance(one, *loop, command, 5), loop[1]

    commands = 0.05 * jax.random.normal(jax.random.key(0), (400, 4))
    begin = one.init(), jnp.zeros(4)
    (carry, momenta), seen = jax.jit(lambda begin: jax.lax.scan(sample, begin, commands))(begin)
    total, bound = in_space(one.state(carry), momenta), 4e-13 if body is TENSOR else 2e-14
    np.testing.assert_allclose(total, in_space(start, jnp.zeros(4)), rtol=0, atol=bound)
    assert bool(one.ok(carry))
    saturated = limits and np.any(np.abs(np.asarray(seen)) == np.asarray(wheels.momentum))
    assert saturated if limits and not friction else np.abs(seen).max() > 0.04
    assert int(carry.index) == 2000


@pytest.mark.parametrize("friction", [{}, RUBBING], ids=["free", "friction"])
def test_the_motion_is_that_of_euler_with_wheels(friction):
    """In other variables, by SciPy: I w' = (I w + h) x w - h', h' = u - friction (h / J - a . w); of order 2."""
    wheels = wheels_of(**friction)
    axes = np.asarray(wheels.axes)

    def rates(t, y):
        momentum, q, h = y[:3], y[3:7], y[7:]
        w = momentum / MOMENTS
        drive = np.asarray(COMMAND) - (FRICTION * (h / INERTIA - axes @ w) if friction else 0)
        turn = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        return np.concatenate([np.cross(momentum + axes.T @ h, w) - axes.T @ drive, turn, drive])

    begin = np.concatenate([BEGIN.momentum, BEGIN.attitude, HELD])
    right = solve_ivp(rates, (0.0, 20.0), begin, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]

    def error(dt):
        one = stepper(dt)
        carry, momenta = jax.jit(lambda c: wheels.advance(one, c, HELD, COMMAND, round(20 / dt)))(one.init())
        end = one.state(carry)
        return np.abs(np.concatenate([end.momentum, end.attitude, momenta]) - right).max()

    errors = error(0.1), error(0.05)
    assert errors[1] < 2e-6
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def test_limits_of_motor_and_momentum():
    """A wheel at rest takes the torque of its motor, not the command, and at its limit nothing more."""
    wheel = ml.spacecraft.DrivenWheels([[0.0, 0.0, 1.0]], torque=0.02, momentum=0.09)
    one = stepper(0.05, start=ml.RigidState(ZERO, [1.0, 0.0, 0.0, 0.0]))
    for seconds, expected in ((2.0, 0.04), (4.0, 0.08), (10.0, 0.09)):
        carry, momenta = wheel.advance(one, one.init(), jnp.zeros(1), jnp.array([5.0]), round(seconds / 0.05))
        np.testing.assert_allclose([momenta[0], -one.state(carry).momentum[2]], expected, rtol=1e-12)
    _, momenta = wheel.advance(one, carry, momenta, jnp.array([-0.01]), 20)
    np.testing.assert_allclose(momenta, 0.08, rtol=1e-12)  # the other way it is free again


def test_magnetic_torquers_unload_the_wheels():
    """With a held external torque, in space, the total momentum changes by its integral."""
    wheels, one = wheels_of(), stepper(0.01, torque=lambda t, state: ZERO)
    push = jnp.array([0.0, 0.0, 0.02])  # in space

    def pushed(t, state):
        return ml.so3.rotate(ml.so3.conjugate(state.attitude), push)

    carry, momenta = wheels.advance(one, one.init(), HELD, COMMAND, 500, torque=pushed)
    np.testing.assert_allclose(in_space(one.state(carry), momenta) - in_space(BEGIN, HELD), 5 * push, atol=1e-12)


PLAIN = ml.spacecraft.DrivenWheels(jnp.eye(3))


def test_another_state_keeps_index_and_force():
    """A run whose state is put back is the same run; after an impulse it is the run from there."""
    top = stepper(torque=ml.torques.HeavyTop(2.0))
    half = top.advance(top.init(), 20)
    again = top.advance(top.with_state(half, top.state(half)), 20)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-13, atol=1e-15), again, top.advance(half, 20))
    moved = top.state(half).plus(jnp.array([0.0, 0.5, 0.0, 0.1, 0.0, 0.0]))
    found = top.advance(top.with_state(half, moved), 20)
    expected = top.advance(top.init(moved, first_step=20), 20)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-13, atol=1e-15), found, expected)
