"""A rigid body that turns about a fixed point or its centre of mass: the momentum Pi and the quaternion, seven numbers.

Pi' = Pi x I^-1 Pi + T, q' = q (0, I^-1 Pi)/2. The momentum Pi is in the body frame, the attitude q is body to space.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from midlie_jax.cli.convergence import SOURCE, exact_ends
from midlie_jax.cli.scenes import Scene
from midlie_jax.model import torques
from midlie_jax.model.orbits import KeplerOrbit
from midlie_jax.model.states import RigidState
from midlie_jax.spacecraft.gravity_gradient import GravityGradient

from .kind import Kind
from .vectors import Vector, cross, matrices, rows, turning


def rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """The equations of motion: d/dt of the seven numbers of a state, as a function on scalars of any type.

    The constants are read from arrays once, so that a program that calls the function from Python does not spend time
    on arrays.

    Args:
        scene: a free body, a heavy top, or a satellite in a gravity gradient.

    Returns:
        `field(state, place=None)`: `state` is momentum and quaternion; `place` is the position of the satellite
        relative to the attracting mass, in units of its distance at time 0.
    """
    a, b, c = np.asarray(scene.body.moments).tolist()
    torque_of = torque(scene)

    def field(state: Any, place: Vector | None = None) -> tuple[Any, ...]:
        p, q = state[:3], state[3:]
        velocity = (p[0] / a, p[1] / b, p[2] / c)
        changes = zip(cross(p, velocity), torque_of(q, place), strict=True)
        return (*(turn if pull is None else turn + pull for turn, pull in changes), *turning(q, velocity))

    return field


def torque(scene: Scene) -> Callable[[Any, Vector | None], tuple[Any, Any, Any]]:
    """The body-frame torque on scalars, as a function of quaternion and place; an entry that is zero is None."""
    field = scene.torque
    if field is None:
        return lambda q, place: (None, None, None)
    if isinstance(field, torques.HeavyTop) and field.axis == (0.0, 0.0, 1.0):
        weight = float(field.mgl)

        def heavy_top(q: Any, place: Vector | None) -> tuple[Any, Any, Any]:
            del place
            w, x, y, z = q
            return weight * (2 * (y * z + w * x)), weight * (-2 * (x * z - w * y)), None

        return heavy_top
    if isinstance(field, GravityGradient) and isinstance(field.orbit, KeplerOrbit):
        a, b, c = np.asarray(scene.body.moments).tolist()
        strength = 3 * _rate(field.orbit) ** 2

        def gravity_gradient(q: Any, place: Vector | None) -> tuple[Any, Any, Any]:
            """3 mu / r^5 (R^T r) x I (R^T r), without a square root to normalise r; mu is 1 in the units of `place`."""
            if place is None:
                raise ValueError("place must not be None for a gravity gradient; pass the position of the satellite.")
            square = place[0] * place[0] + place[1] * place[1] + place[2] * place[2]
            columns = zip(*rows(q), strict=True)
            u = tuple(column[0] * place[0] + column[1] * place[1] + column[2] * place[2] for column in columns)
            pull = strength * square**-2.5
            return pull * ((c - b) * u[1] * u[2]), pull * ((a - c) * u[2] * u[0]), pull * ((b - a) * u[0] * u[1])

        return gravity_gradient
    raise ValueError(
        f"scene {scene.name!r} has a torque {type(field).__name__} that the rivals do not have; take a free body, a "
        "HeavyTop with axis (0, 0, 1), or a GravityGradient on a KeplerOrbit."
    )


def orbit_of(scene: Scene) -> KeplerOrbit | None:
    """The orbit of the torque, or None if it has none."""
    orbit = scene.torque.orbit if isinstance(scene.torque, GravityGradient) else None
    return orbit if isinstance(orbit, KeplerOrbit) else None


def radius(orbit: KeplerOrbit) -> float:
    """The distance at time 0, the unit of length of an orbit: adaptive steps need numbers of similar size."""
    return float(np.linalg.norm(np.asarray(orbit.position)))


def _rate(orbit: KeplerOrbit) -> float:
    """The angular rate of a circular orbit through the start; its inverse is the unit of time of orbital velocities."""
    return math.sqrt(float(orbit.mu) / radius(orbit) ** 3)


def orbit_start(orbit: KeplerOrbit) -> np.ndarray:
    """Position and velocity at time 0 in these units, (6,), for a program that also integrates the orbit."""
    size, rate = radius(orbit), _rate(orbit)
    return np.concatenate([np.asarray(orbit.position) / size, np.asarray(orbit.velocity) / (size * rate)])


def orbit_rates(orbit: KeplerOrbit, state: Any) -> tuple[Any, ...]:
    """d/dt of position and velocity, in the units of `orbit_start`, on scalars."""
    r, v, rate = state[:3], state[3:], _rate(orbit)
    pull = -rate * (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) ** -1.5
    return (*(rate * x for x in v), *(pull * x for x in r))


def kepler(orbit: KeplerOrbit) -> Callable[[float], Vector]:
    """The position on the orbit, in units of `radius`, as a function of time, on floats; formulas of `KeplerOrbit`."""
    r, v, mu = np.asarray(orbit.position), np.asarray(orbit.velocity), float(orbit.mu)
    size = radius(orbit)
    axis = 1 / (2 / size - (v @ v) / mu)
    motion, sine_part, cosine_part = math.sqrt(mu / axis**3), (r @ v) / math.sqrt(mu * axis), 1 - size / axis
    (x, y, z), (a, b, c) = (r / size).tolist(), (v / size).tolist()

    def place(t: float) -> Vector:
        turns = round(motion * t / (2 * math.pi))
        mean = motion * t - 2 * math.pi * turns
        change = mean
        for _ in range(8):
            s, co = math.sin(change), math.cos(change)
            step = (change - cosine_part * s + sine_part * (1 - co) - mean) / (1 - cosine_part * co + sine_part * s)
            change -= step
            if abs(step) < 1e-15:
                break
        f = 1 - 2 * math.sin(change / 2) ** 2 * axis / size
        g = (mean - change + math.sin(change)) / motion
        return f * x + g * a, f * y + g * b, f * z + g * c

    return place


def errors(ends: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """|R - R*|, Frobenius norm."""
    return np.linalg.norm(matrices(ends[:, 3:]) - matrices(exact[:, 3:]), axis=(1, 2))


def exact(scene: Scene, states: np.ndarray) -> tuple[np.ndarray, str] | None:
    """The ends of a free body and of a heavy top."""
    starts = [RigidState(state[:3], state[3:]) for state in states]
    ends = exact_ends(np.asarray(scene.body.moments), scene.torque, starts, scene.duration)
    return None if ends is None else (np.concatenate(ends, axis=1), SOURCE)


RIGID = Kind(rates, errors, "the attitude, |R - R*| in the Frobenius norm", exact)
