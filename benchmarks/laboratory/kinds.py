"""What the programs are told of each kind of state: its equations of motion on numbers, and the error of its end.

The numbers of a state are its arrays one after another, in the order of its fields. A new kind needs a
section here and a line in `kind_of`; nothing else tells the kinds apart."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from midlie_jax.cli.convergence import SOURCE, exact_ends
from midlie_jax.cli.scenes import Scene
from midlie_jax.model import torques
from midlie_jax.model.orbits import KeplerOrbit
from midlie_jax.model.states import AxisState, FreeState, RigidState
from midlie_jax.spacecraft.disturbances import GravityGradient

# ---- what must be known of a kind of state ----


class Kind(NamedTuple):
    """A kind of state.

    Attributes:
        rates: for a scene the function `field(state, place=None)`: d/dt of the numbers of a state, on scalars of any
            type, such as Python floats, JAX arrays or expressions of another program.
        errors: of ends (n, k) from exact ends (n, k), for each body, (n,).
        measured: what the errors are of, in words.
        exact: for a scene and starts (n, k) the numbers at the end and the name of the closed form, or None.
    """

    rates: Callable[[Scene], Callable[..., tuple[Any, ...]]]
    errors: Callable[[np.ndarray, np.ndarray], np.ndarray]
    measured: str
    exact: Callable[[Scene, np.ndarray], tuple[np.ndarray, str] | None]


def no_closed_form(scene: Scene, states: np.ndarray) -> None:
    """For a kind whose scenes have no closed form."""


# ---- vectors and quaternions on scalars of any type ----

Vector = tuple[Any, Any, Any]


def cross(a: Any, b: Any) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def rows(quaternion: Any) -> tuple[Vector, Vector, Vector]:
    """The rows of the rotation matrix of a unit quaternion."""
    w, x, y, z = quaternion
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def turning(quaternion: Any, velocity: Any) -> tuple[Any, Any, Any, Any]:
    """d/dt of the quaternion of a body, q (0, velocity)/2, with the angular velocity in the body frame."""
    w, x, y, z = quaternion
    a, b, c = velocity
    spin = (-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a)
    return 0.5 * spin[0], 0.5 * spin[1], 0.5 * spin[2], 0.5 * spin[3]


def matrix(quaternion: Any) -> np.ndarray:
    """The rotation matrix of a unit quaternion, computed in the number type of its entries."""
    return np.array(rows(quaternion))


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """The rotation matrices (n, 3, 3) of quaternions (n, 4) of any norm."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.stack([matrix(q) for q in unit])


# ---- a rigid body that rotates about a fixed point or its centre of mass: Pi and the quaternion, seven numbers ----
#
# Pi' = Pi x I^-1 Pi + T, q' = q (0, I^-1 Pi)/2. The momentum Pi is in the body frame, the attitude q is body to space.


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


def rigid_errors(ends: np.ndarray, rigid_exact: np.ndarray) -> np.ndarray:
    """|R - R*|, Frobenius norm."""
    return np.linalg.norm(matrices(ends[:, 3:]) - matrices(rigid_exact[:, 3:]), axis=(1, 2))


def rigid_exact(scene: Scene, states: np.ndarray) -> tuple[np.ndarray, str] | None:
    """The ends of a free body and of a heavy top."""
    starts = [RigidState(state[:3], state[3:]) for state in states]
    ends = exact_ends(np.asarray(scene.body.moments), scene.torque, starts, scene.duration)
    return None if ends is None else (np.concatenate(ends, axis=1), SOURCE)


RIGID = Kind(rates, rigid_errors, "the attitude, |R - R*| in the Frobenius norm", rigid_exact)


# ---- the axis of a top with two equal moments, in six numbers: the momentum pi and the axis e, both in space ----
#
# pi' = T, e' = pi x e / I1. Whoever asks for the axis alone would write these equations, whatever the program.


def axis_rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """The equations of motion; a ValueError for another torque than a heavy top's."""
    if not (isinstance(scene.torque, torques.HeavyTop) and scene.torque.axis == (0.0, 0.0, 1.0)):
        raise ValueError(f"scene {scene.name!r} is an axis, for which the rivals have the torque HeavyTop alone.")
    body: Any = scene.body
    moment, weight = float(body.moment), float(scene.torque.mgl)

    def field(state: Any, place: Any = None) -> tuple[Any, ...]:
        del place
        momentum, axis = state[:3], state[3:]
        velocity = tuple((1 / moment) * p for p in momentum)
        return (-weight * axis[1], weight * axis[0], 0.0 * momentum[2], *cross(velocity, axis))

    return field


def axis_errors(ends: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """|e - e*|, of axes of any length."""
    return np.linalg.norm(_unit(ends[:, 3:]) - _unit(exact[:, 3:]), axis=1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def errors_of_attitudes(ends: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The same of momenta and attitudes (n, 7), whose third columns are the axes."""
    return np.linalg.norm(matrices(ends[:, 3:])[:, :, 2] - _unit(exact[:, 3:]), axis=1)


_MEASURED = "the axis, |e - e*|"
AXIS = Kind(axis_rates, axis_errors, _MEASURED, no_closed_form)
# The same top as a body with an attitude, whose spin angle is integrated, too, but not judged.
SPINNING = Kind(rates, errors_of_attitudes, _MEASURED, no_closed_form)


# ---- a body that moves about a point mass, in thirteen numbers: Pi, the quaternion, p and x ----
#
# Pi' = Pi x I^-1 Pi + T, q' = q (0, I^-1 Pi)/2, p' = f, x' = p/m. With the position w = R^T x in the body frame, the
# force R^T f is -mu (m/r^3 + 3/(2 r^5) tr I - 15/(2 r^7) w . I w + 3/r^5 I) w, and the torque 3 mu/r^5 w x I w. For
# heyoka other ways to write them, with powers of r instead of products, or with R in another place, took equally long.


def free_rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """The equations of motion; a ValueError for another force than a point mass's."""
    if not isinstance(scene.torque, torques.PointMass):
        raise ValueError(f"scene {scene.name!r} travels, for which the rivals have the force PointMass alone.")
    body: Any = scene.body
    moments, mass, mu = np.asarray(body.body.moments).tolist(), float(body.mass), float(scene.torque.mu)
    a, b, c = moments

    def field(state: Any, place: Any = None) -> tuple[Any, ...]:
        del place
        momentum, attitude, linear, position = state[:3], state[3:7], state[7:10], state[10:]
        to_space = rows(attitude)
        w = tuple(dot(column, position) for column in zip(*to_space, strict=True))
        inverse = dot(position, position) ** -0.5
        square = inverse * inverse
        cube = inverse * square
        fifth = cube * square
        shape = dot(w, (a * w[0], b * w[1], c * w[2])) * square
        along = (-mu * mass) * cube + (-mu * fifth) * (1.5 * sum(moments) - 7.5 * shape)
        force = tuple((along + (-3 * mu * moment) * fifth) * x for moment, x in zip(moments, w, strict=True))
        pull = 3 * mu * fifth
        torque = pull * ((c - b) * w[1] * w[2]), pull * ((a - c) * w[2] * w[0]), pull * ((b - a) * w[0] * w[1])
        velocity = momentum[0] / a, momentum[1] / b, momentum[2] / c
        return (
            *(turn + pulled for turn, pulled in zip(cross(momentum, velocity), torque, strict=True)),
            *turning(attitude, velocity),
            *(dot(row, force) for row in to_space),
            *((1 / mass) * p for p in linear),
        )

    return field


def free_errors(ends: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The angle between the attitudes or the distance of the positions over r, whichever is larger."""
    chord = np.linalg.norm(matrices(ends[:, 3:7]) - matrices(exact[:, 3:7]), axis=(1, 2)) / np.sqrt(8)
    away = np.linalg.norm(ends[:, 10:] - exact[:, 10:], axis=1) / np.linalg.norm(exact[:, 10:], axis=1)
    return np.maximum(2 * np.arcsin(np.minimum(chord, 1.0)), away)


FREE = Kind(free_rates, free_errors, "attitude (rad) or position (over r), the larger", no_closed_form)


def kind_of(scene: Scene) -> Kind:
    """The kind of the state of a scene."""
    return {RigidState: RIGID, AxisState: AXIS, FreeState: FREE}[type(scene.start)]


def numbers(states: Any) -> np.ndarray:
    """The numbers (n, k) of states with a leading axis n."""
    return np.concatenate([np.asarray(leaf) for leaf in jax.tree.leaves(states)], axis=-1)


def sizes(start: Any) -> np.ndarray:
    """The size of each number of a state, (k,): the norm of its array; tolerances are relative to it."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(start)]
    return np.concatenate([np.full(len(leaf), np.linalg.norm(leaf)) for leaf in leaves])
