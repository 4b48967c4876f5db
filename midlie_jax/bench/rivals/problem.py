"""What every program is given: the same bodies, the same torque, the same clock; and how each is judged.

The equations are written once, on scalars, so that they can be floats of Python, arrays of JAX or expressions of
another program: Pi' = Pi x I^-1 Pi + T, q' = q (0, I^-1 Pi)/2. Momentum in the body frame, attitude body to space.
"""

import math
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from ...drivers.timing import Timing, timed
from ...model import torques
from ...model.orbits import KeplerOrbit
from ..scenes import Scene


class Point(NamedTuple):
    """One program or method at one tolerance or step.

    Attributes:
        method: its name.
        setting: the tolerance or step, as in "tol 1e-06".
        error: |R - R*| at the end, Frobenius norm, root mean square over the bodies judged.
        seconds: median time of the whole run for one body, compiling not counted (`timing.cost_clock`).
        evaluations: torque evaluations for one body; NaN where the word does not apply.
        steps: steps for one body.
        spread: half the distance between the quartiles of the timings, relative to the median.
    """

    method: str
    setting: str
    error: float
    seconds: float
    evaluations: float
    steps: float
    spread: float = math.nan


class Problem(NamedTuple):
    """Bodies to move, and where the first of them end.

    Attributes:
        scene: the body, the torque and the duration.
        momentum, attitude: the starts, (n, 3) and (n, 4).
        ends: rotation matrices at the end of the first k bodies, (k, 3, 3), by which a program is judged.
        source: how the ends were found.
        uncertainty: what they may be wrong by.
        repeats: runs timed at most, whose median counts.
        longest: seconds for all bodies; a program is not asked for a finer step once a run takes longer.
    """

    scene: Scene
    momentum: np.ndarray
    attitude: np.ndarray
    ends: np.ndarray
    source: str
    uncertainty: float
    repeats: int = 5
    longest: float = 1.0

    @property
    def bodies(self) -> int:
        return len(self.momentum)

    @property
    def states(self) -> np.ndarray:
        """Momentum and quaternion side by side, (n, 7)."""
        return np.concatenate([self.momentum, self.attitude], axis=1)

    def error(self, attitudes: Any) -> float:
        """The error of quaternions (m, 4) of the first m bodies, normalised here; no more than k are judged."""
        quaternions = np.asarray(attitudes, np.float64)[: len(self.ends)]
        quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        change = np.stack([matrix(q) for q in quaternions]) - self.ends[: len(quaternions)]
        return float(np.sqrt(np.mean(np.sum(change**2, axis=(1, 2)))))

    def timed(self, run: Callable[[], Any]) -> tuple[Any, Timing]:
        """The result of `run`, which waits for it, and the timing of a few runs."""
        return timed(run, most=self.repeats, longest=self.longest)


def program(name: str) -> Any:
    """The module of that name; an ImportError that names the extra where it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"the rivals need {name.split('.')[0]}: pip install 'midlie_jax[bench]'.") from error


def matrix(quaternion: Any) -> np.ndarray:
    """The rotation matrix of a unit quaternion, in the arithmetic of its entries."""
    return np.array(_rows(quaternion))


def _rows(quaternion: Any) -> tuple[Any, ...]:
    w, x, y, z = quaternion
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


Vector = tuple[Any, Any, Any]


def rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """d/dt of the seven numbers of a state as a function of them, and of the satellite's place, on scalars of any kind.

    What does not change is read here, once: a program that calls the function from Python is not to pay for arrays.

    Args:
        scene: a free body, a heavy top, or a satellite in a gravity gradient.

    Returns:
        `field(state, place=None)`: state is momentum and quaternion, place that of the satellite, seen from the
        attracting mass, in units of its distance at time 0.

    Raises:
        ValueError: another torque.
    """
    a, b, c = np.asarray(scene.body.moments).tolist()
    push_of = torque(scene)

    def field(state: Any, place: Vector | None = None) -> tuple[Any, ...]:
        p, (w, x, y, z) = state[:3], state[3:]
        o = (p[0] / a, p[1] / b, p[2] / c)
        turn = _cross((p[0], p[1], p[2]), o)
        push = push_of((w, x, y, z), place)
        spin = (
            -x * o[0] - y * o[1] - z * o[2],
            w * o[0] + y * o[2] - z * o[1],
            w * o[1] + z * o[0] - x * o[2],
            w * o[2] + x * o[1] - y * o[0],
        )
        return (*(t if f is None else t + f for t, f in zip(turn, push, strict=True)), *(0.5 * s for s in spin))

    return field


def torque(scene: Scene) -> Callable[[Any, Vector | None], tuple[Any, Any, Any]]:
    """The body-frame torque on scalars, as a function of quaternion and place; None for an entry that is zero."""
    field = scene.torque
    if field is None:
        return lambda q, place: (None, None, None)
    if isinstance(field, torques.HeavyTop) and field.axis == (0.0, 0.0, 1.0):
        weight = float(field.weight)

        def heavy_top(q: Any, place: Vector | None) -> tuple[Any, Any, Any]:
            del place
            w, x, y, z = q
            return weight * (2 * (y * z + w * x)), weight * (-2 * (x * z - w * y)), None

        return heavy_top
    if isinstance(field, torques.GravityGradient) and isinstance(field.orbit, KeplerOrbit):
        a, b, c = np.asarray(scene.body.moments).tolist()
        strength = 3 * _rate(field.orbit) ** 2

        def gravity_gradient(q: Any, place: Vector | None) -> tuple[Any, Any, Any]:
            """3 mu / r^5 (R^T r) x I (R^T r): no root to normalise r; mu is one in the units of the place."""
            if place is None:
                raise ValueError("the torque of a gravity gradient needs the satellite's place.")
            square = place[0] * place[0] + place[1] * place[1] + place[2] * place[2]
            columns = zip(*_rows(q), strict=True)
            u = tuple(column[0] * place[0] + column[1] * place[1] + column[2] * place[2] for column in columns)
            pull = strength * square**-2.5
            return pull * ((c - b) * u[1] * u[2]), pull * ((a - c) * u[2] * u[0]), pull * ((b - a) * u[0] * u[1])

        return gravity_gradient
    raise ValueError(f"the rivals know no {type(field).__name__} about this axis (scene {scene.name!r}).")


def orbit_of(scene: Scene) -> KeplerOrbit | None:
    """The orbit that the torque reads, if it reads one."""
    orbit = scene.torque.orbit if isinstance(scene.torque, torques.GravityGradient) else None
    return orbit if isinstance(orbit, KeplerOrbit) else None


def radius(orbit: KeplerOrbit) -> float:
    """The distance at time 0, the unit of length of an orbit here: adaptive steps are judged by the largest number."""
    return float(np.linalg.norm(np.asarray(orbit.position)))


def _rate(orbit: KeplerOrbit) -> float:
    """The angular rate of a circle through the start: its inverse is the unit of time of velocities on an orbit."""
    return math.sqrt(float(orbit.mu) / radius(orbit) ** 3)


def orbit_start(orbit: KeplerOrbit) -> np.ndarray:
    """Position and velocity at time 0, (6,): for a program that integrates the orbit along with the body."""
    size, rate = radius(orbit), _rate(orbit)
    return np.concatenate([np.asarray(orbit.position) / size, np.asarray(orbit.velocity) / (size * rate)])


def orbit_rates(orbit: KeplerOrbit, state: Any) -> tuple[Any, ...]:
    """d/dt of position and velocity in these units, on scalars."""
    r, v, rate = state[:3], state[3:], _rate(orbit)
    pull = -rate * (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) ** -1.5
    return (*(rate * x for x in v), *(pull * x for x in r))


def kepler(orbit: KeplerOrbit) -> Callable[[float], Vector]:
    """The place on the orbit in its unit of length as a function of time, on floats: the formulas of `KeplerOrbit`."""
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


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
