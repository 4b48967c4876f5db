"""`DrivenWheels` in a control loop, and `Stepper.with_state`: against laws, closed forms and SciPy."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import midlie_jax as ml

MOMENTS, SLANTED = np.array([5.0, 4.0, 3.0]), np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
BODY, START = ml.RigidBody(MOMENTS), ml.RigidState([0.1, -0.2, 0.1], ml.so3.exp(jnp.array([0.3, -0.1, 0.2])))
TENSOR = ml.TensorBody([[5.0, 0.4, 0.1], [0.4, 4.0, -0.3], [0.1, -0.3, 3.0]])
FREE = ml.FreeState(START.momentum, START.attitude, [1.0, 2.0, 0.0], [0.0, 0.0, 3.0])
FRICTION, INERTIA = 0.002, 0.01
COMMAND, HELD = jnp.array([0.01, -0.02, 0.015, 0.005]), jnp.array([0.1, 0.2, -0.1, 0.05])
wheels_of = partial(ml.spacecraft.DrivenWheels, SLANTED)


def stepper(dt=0.05, body=BODY, start=START, torque=None) -> Any:
    return ml.stepper("JACOBI[EA]", body, torque, start, dt=dt)


@pytest.mark.parametrize(("body", "law"), [("principal", "limits"), ("tensor", "friction"), ("free", "commands")])
def test_body_and_wheels_keep_their_momentum_to_rounding(body, law):
    """In space, under commands that change at random and saturate the wheels."""
    body, start = {"principal": (BODY, START), "tensor": (TENSOR, START), "free": (ml.FreeBody(BODY, 3.0), FREE)}[body]
    limits = {"torque": 0.03, "momentum": [0.1, 0.15, 0.2, 0.12]} if law != "commands" else {}
    wheels = wheels_of(**limits, **({"friction": FRICTION, "inertia": INERTIA} if law == "friction" else {}))
    one = stepper(body=body, start=start)

    def sample(loop, command):
        return wheels.advance(one, *loop, command, 5), loop[1]

    commands = 0.05 * jax.random.normal(jax.random.key(0), (400, 4))
    begin = one.init(), jnp.zeros(4)
    (carry, momenta), seen = jax.jit(lambda begin: jax.lax.scan(sample, begin, commands))(begin)
    end = one.state(carry)
    total = ml.so3.rotate(end.attitude, end.momentum + momenta @ wheels.axes)
    np.testing.assert_allclose(
        total, ml.so3.rotate(start.attitude, start.momentum), rtol=0, atol=4e-13 if body is TENSOR else 2e-14
    )
    assert bool(one.ok(carry))
    saturated = limits and np.any(np.abs(np.asarray(seen)) == np.asarray(wheels.momentum))
    assert saturated if law == "limits" else np.abs(seen).max() > 0.04
    assert int(carry.index) == 2000


@pytest.mark.parametrize("friction", [{}, {"friction": FRICTION, "inertia": INERTIA}], ids=["free", "friction"])
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

    begin = np.concatenate([START.momentum, START.attitude, HELD])
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
    one = stepper(0.05, start=ml.RigidState(jnp.zeros(3), [1.0, 0.0, 0.0, 0.0]))
    for seconds, expected in ((2.0, 0.04), (4.0, 0.08), (10.0, 0.09)):
        carry, momenta = wheel.advance(one, one.init(), jnp.zeros(1), jnp.array([5.0]), round(seconds / 0.05))
        np.testing.assert_allclose([momenta[0], -one.state(carry).momentum[2]], expected, rtol=1e-12)
    _, momenta = wheel.advance(one, carry, momenta, jnp.array([-0.01]), 20)
    np.testing.assert_allclose(momenta, 0.08, rtol=1e-12)  # the other way it is free again


def test_magnetic_torquers_unload_the_wheels():
    """With a held external torque, in space, the total momentum changes by its integral."""
    zero = jnp.zeros(3)
    wheels, one = wheels_of(), stepper(0.01, torque=lambda t, state: zero)
    push = jnp.array([0.0, 0.0, 0.02])  # in space

    def pushed(t, state):
        return ml.so3.rotate(ml.so3.conjugate(state.attitude), push)

    carry, momenta = wheels.advance(one, one.init(), HELD, COMMAND, 500, torque=pushed)
    end = one.state(carry)
    before = ml.so3.rotate(START.attitude, START.momentum + HELD @ wheels.axes)
    after = ml.so3.rotate(end.attitude, end.momentum + momenta @ wheels.axes)
    np.testing.assert_allclose(after - before, 5 * push, atol=1e-12)


PLAIN = ml.spacecraft.DrivenWheels(jnp.eye(3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: wheels_of(torque=-1.0), "torque must be finite and not negative"),
        (lambda: wheels_of(friction=1.0), "friction and inertia must be given together"),
        (lambda: PLAIN.advance(stepper(), stepper().init(), jnp.zeros(3), jnp.zeros(4)), "command must have shape"),
        (
            lambda: wheels_of(momentum=0.1).advance(stepper(), stepper().init(), HELD, COMMAND),
            r"momenta must be within the limit of the wheels, got .*; raise momentum=",
        ),
        (
            lambda: PLAIN.advance(
                stepper(torque=ml.torques.Damping(0.1)), stepper().init(), jnp.zeros(3), jnp.zeros(3)
            ),
            "torque must not read the momentum",
        ),
    ],
)
def test_mistakes_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


# ---- Stepper.with_state ----


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
