"""The problem that every program solves: the same bodies, torque and clock, and the same measure of the error.

The equations are written once, on scalars, which can be Python floats, JAX arrays or expressions of another program:
Pi' = Pi x I^-1 Pi + T, q' = q (0, I^-1 Pi)/2. The momentum Pi is in the body frame, the attitude q is body to space.
"""

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from midlie_jax.advice.timing import Timing, timed, timed_in_turn
from midlie_jax.cli.scenes import Scene
from midlie_jax.model import torques
from midlie_jax.model.orbits import KeplerOrbit


class Point(NamedTuple):
    """One program or method at one tolerance or step.

    Attributes:
        method: name of the method.
        setting: the tolerance or step, such as "tol 1e-06", and after a comma the options of the program, if any.
        error: |R - R*| at the end, Frobenius norm, root mean square over the bodies with a reference end R*.
        seconds: median time of the whole run for one body, without compiling (`timing.cost_clock`).
        evaluations: torque evaluations for one body; NaN for a method or problem without torque evaluations.
        steps: number of steps for one body; NaN for a closed form, which takes none.
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
    """Bodies to move, and the reference ends of the first of them.

    Attributes:
        scene: the body, the torque and the duration.
        momentum, attitude: the starts, (n, 3) and (n, 4).
        ends: reference rotation matrices at the end, of the first k bodies, (k, 3, 3).
        source: how the ends were computed.
        uncertainty: estimate of the error of the ends.
        repeats: largest number of timed runs.
        longest: seconds of a run of all bodies; after a longer run no smaller step is tried.
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
        """Momentum and quaternion, concatenated to (n, 7)."""
        return np.concatenate([self.momentum, self.attitude], axis=1)

    def error(self, attitudes: Any) -> float:
        """The error of quaternions (m, 4) of the first m bodies, of any norm; at most k bodies are compared."""
        quaternions = np.asarray(attitudes, np.float64)[: len(self.ends)]
        quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        change = np.stack([matrix(q) for q in quaternions]) - self.ends[: len(quaternions)]
        return float(np.sqrt(np.mean(np.sum(change**2, axis=(1, 2)))))

    def timed(self, run: Callable[[], Any]) -> tuple[Any, Timing]:
        """The result of `run`, which must wait for it, and the timing of several runs."""
        return timed(run, most=self.repeats, longest=self.longest)

    def timed_in_turn(self, runs: Sequence[Callable[[], Any]]) -> list[Timing]:
        """The timings of several runs that take turns, so that what slows the machine for a while slows them all."""
        return [timing for _, timing in timed_in_turn(runs, most=self.repeats, longest=self.longest)]


def program(name: str) -> Any:
    """The module of that name; if it is not installed, an ImportError that names the extra."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"the rivals need {name.split('.')[0]}: pip install 'midlie_jax[bench]'.") from error


def matrix(quaternion: Any) -> np.ndarray:
    """The rotation matrix of a unit quaternion, computed in the number type of its entries."""
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
    """The equations of motion: d/dt of the seven numbers of a state, as a function on scalars of any type.

    The constants are read from arrays once, so that a program that calls the function from Python does not spend time
    on arrays.

    Args:
        scene: a free body, a heavy top, or a satellite in a gravity gradient.

    Returns:
        `field(state, place=None)`: `state` is momentum and quaternion; `place` is the position of the satellite
        relative to the attracting mass, in units of its distance at time 0.

    Raises:
        ValueError: the scene has another torque.
    """
    a, b, c = np.asarray(scene.body.moments).tolist()
    torque_of = torque(scene)

    def field(state: Any, place: Vector | None = None) -> tuple[Any, ...]:
        p, (w, x, y, z) = state[:3], state[3:]
        o = (p[0] / a, p[1] / b, p[2] / c)
        turn = _cross((p[0], p[1], p[2]), o)
        body_torque = torque_of((w, x, y, z), place)
        spin = (
            -x * o[0] - y * o[1] - z * o[2],
            w * o[0] + y * o[2] - z * o[1],
            w * o[1] + z * o[0] - x * o[2],
            w * o[2] + x * o[1] - y * o[0],
        )
        return (*(t if f is None else t + f for t, f in zip(turn, body_torque, strict=True)), *(0.5 * s for s in spin))

    return field


def torque(scene: Scene) -> Callable[[Any, Vector | None], tuple[Any, Any, Any]]:
    """The body-frame torque on scalars, as a function of quaternion and place; an entry that is zero is None."""
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
            """3 mu / r^5 (R^T r) x I (R^T r), without a square root to normalise r; mu is 1 in the units of `place`."""
            if place is None:
                raise ValueError("place must not be None for a gravity gradient; pass the position of the satellite.")
            square = place[0] * place[0] + place[1] * place[1] + place[2] * place[2]
            columns = zip(*_rows(q), strict=True)
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
    orbit = scene.torque.orbit if isinstance(scene.torque, torques.GravityGradient) else None
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


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
