"""The scenes of translating bodies, and the scene of a body without attitude; `scenes` gives them their names."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..model import so3
from ..model.bodies import RigidBody
from ..model.free_body import FreeBody
from ..model.rotor import Rotor
from ..model.states import AxisState, FreeState
from ..model.torques import HeavyTop, Oblateness, PointMass, UniformGravity
from . import jeod
from .blades import Blades
from .scene import Scene

_BRICK = np.array([0.00189422, 0.006211019, 0.007194665]), 0.155404754  # moments and mass, slug and ft
_EARTH = 3.986004418e14, 6378137.0, 1.08262982e-3  # mu, radius and J2 of WGS-84, m and s
_TURN_OF_EARTH = 7.292115e-5  # rad/s
_FOOT = 0.3048


def _start(momentum: Any, attitude: Any, linear: Any, position: Any, dtype: Any) -> FreeState:
    return FreeState(*(jnp.asarray(x, dtype) for x in (momentum, attitude, linear, position)))


def _body(moments: Any, mass: float, dtype: Any) -> FreeBody:
    return FreeBody(RigidBody(jnp.asarray(moments, dtype)), jnp.asarray(mass, dtype))


def thrown_brick(dtype: Any) -> Scene:
    moments, mass = _BRICK
    return Scene(
        name="",
        title="a brick in a parabola that turns over again and again about its middle axis",
        body=_body(moments, mass, dtype),
        torque=UniformGravity(jnp.asarray([0.0, 0.0, -32.174], dtype)),
        start=_start(
            moments * np.array([0.1, 12.0, 0.1]), [1.0, 0.0, 0.0, 0.0], mass * np.array([15.0, 0.0, 32.174]),
            [0.0, 0.0, 5.0], dtype,
        ),
        dt=0.005,
        duration=2.0,
        source="the brick of NASA NESC's check-case 2; the throw is chosen here, not published",
        units="slug, ft, s; z up",
    )  # fmt: skip


def dropped_brick(dtype: Any) -> Scene:
    moments, mass = _BRICK
    mu, radius, j2 = _EARTH
    height = radius / _FOOT + 30000
    mu, radius, j2, pole = (jnp.asarray(x, dtype) for x in (mu / _FOOT**3, radius / _FOOT, j2, [1.0, 0.0, 0.0]))
    earth = PointMass(mu, gradient=False) + Oblateness(mu, radius, j2, pole, gradient=False)  # as published
    return Scene(
        name="",
        title="the tumbling brick dropped from 30000 ft over the turning Earth, east of the plumb line",
        body=_body(moments, mass, dtype),
        torque=earth,
        start=_start(
            moments * np.deg2rad([10.0, 20.0, 30.0]),
            [1.0, 0.0, 0.0, 0.0],
            [0.0, mass * _TURN_OF_EARTH * height, 0.0],
            [0.0, 0.0, -height],
            dtype,
        ),
        dt=0.05,
        duration=30.0,
        source="NASA NESC six-degree-of-freedom check-case 2, as carried by nasa/simupy-flight; J2 of WGS-84",
        units="slug, ft, s; space is North-East-Down over the equator at time 0, from the Earth's centre, not turning",
    )  # The axis points to the left of the throw, along y, and leans upwards.


def boomerang(dtype: Any) -> Scene:
    moments, mass, lean = np.array([1.25e-3, 1.25e-3, 2.5e-3]), 0.1, np.deg2rad(33.0)
    # The axis points to the left of the throw, along y, and leans upwards.
    half = (lean - np.pi / 2) / 2
    blades = (jnp.asarray(x, dtype) for x in (0.0145, 0.3, 0.8, 3.0, 0.016))
    return Scene(
        name="",
        title="the lift of its blades turns its axis, and so it flies a circle and comes back",
        body=_body(moments, mass, dtype),
        torque=Blades(*blades) + UniformGravity(jnp.asarray([0.0, 0.0, -9.81], dtype)),
        start=_start(
            moments * np.array([0.0, 0.0, 100.0]), [np.cos(half), np.sin(half), 0.0, 0.0],
            mass * np.array([22.0, 0.0, 8.8]), [0.0, 0.0, 1.8], dtype,
        ),
        dt=0.001,
        duration=2.0,
        source="mean over a turn of the lift and drag of its blades (after Hess, Sci. Am. 219 (1968) 124); numbers "
        "chosen here",
        units="kg, m, s; z up; the throw is along x",
    )  # fmt: skip


def satellite(dtype: Any) -> Scene:
    mass, earth = 1000.0, tuple(jnp.asarray(x, dtype) for x in (jeod.MU, 6378136.3, 1.0826357e-3))
    return Scene(
        name="",
        title="orbit and attitude as one system: the Earth's oblateness turns the orbit",
        body=_body(jeod.MOMENTS, mass, dtype),
        torque=PointMass(earth[0]) + Oblateness(*earth),
        start=_start(
            np.array(jeod.MOMENTS) * np.array(jeod.RATES), so3.from_matrix(jnp.asarray(jeod.TO_BODY, dtype).T),
            mass * np.array(jeod.VELOCITY), jeod.POSITION, dtype,
        ),
        dt=10.0,
        duration=28800.0,
        source="body and orbit of NASA JEOD's verification case RUN_10A, which has no oblateness; the mass is chosen "
        "here, and J2 is that of JGM-3",
        units="kg, m, s; space is Earth-centred inertial",
    )  # fmt: skip


def spherical_pendulum(dtype: Any) -> Scene:
    mass, length = 1.0, 1.0
    down = np.deg2rad(60.0)  # from the vertical, downwards
    push = 0.7 * np.sqrt(9.81 / length)  # rad/s, about the vertical
    axis = np.array([np.sin(down), 0.0, -np.cos(down)])
    momentum = mass * length**2 * np.cross(axis, np.cross([0.0, 0.0, push], axis))
    return Scene(
        name="",
        title="an axis that hangs: the bob swings between two heights, and the swing turns",
        body=Rotor(jnp.asarray(mass * length**2, dtype)),
        torque=HeavyTop(jnp.asarray(mass * 9.81 * length, dtype)),
        start=AxisState(jnp.asarray(momentum, dtype), jnp.asarray(axis, dtype)),
        dt=0.01,
        duration=10.0,
        source="chosen here, not published",
        units="kg, m, s; z up; the axis points from the pivot to the bob",
        method="SYMMETRIC[EA]",
    )
