"""Other programs and methods on the same problems, each through its public interface: error against cost.

First the scenes, then what the programs are told of each kind of state, the problem that every program solves, our
methods on it, and the rivals, each of which imports its program only when it runs. `work_precision.py` compares them. A
new rival needs a function that yields points and a line in `RIVALS`.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax._math.short_series import LARGEST_SQUARE, half_turn
from midlie_jax._xla.compiler import compiler_options, vector_width_options
from midlie_jax._xla.fusion import fuse
from midlie_jax.advice.program import Program
from midlie_jax.advice.timing import Timing, timed, timed_in_turn
from midlie_jax.cli import chosen, scenes
from midlie_jax.cli.convergence import SOURCE, exact_ends
from midlie_jax.cli.scenes import Scene
from midlie_jax.drivers.chunks import chunk_size
from midlie_jax.integrators.base import Method
from midlie_jax.integrators.system import AnyMotion, Motion, System
from midlie_jax.model.state import AnyState

# ---- the scenes: those of the package, and a few whose state is of another kind ----


@dataclass(frozen=True, eq=False)
class SceneOfAnyKind(Scene):
    body: Any
    start: Any


def _orbit() -> Scene:
    moments, mass = jnp.array([0.01, 0.02, 0.025]), 3.0
    attitude = np.array([0.8, 0.3, -0.4, 0.33])
    return SceneOfAnyKind(
        name="orbit",
        title="asymmetric body in the gravity of a point mass, two orbits",
        body=ml.FreeBody(ml.RigidBody(moments), mass),
        torque=ml.torques.PointMass(1.0),
        start=ml.FreeState(
            momentum=moments * jnp.array([0.5, 0.8, 4.0]),
            attitude=attitude / np.linalg.norm(attitude),
            linear=mass * np.array([0.0, 1.1, 0.0]),
            position=[1.0, 0.0, 0.0],
        ),
        dt=0.01,
        duration=20.0,
        # A spin of 2 instead of 4 would make the motion chaotic: errors of 1e-12 would be below its rounding.
        source="chosen here, not published",
        units="any consistent units",
    )


def _axis() -> Scene:
    whole = scenes.scene("P1-tilted", "float64")
    return SceneOfAnyKind(
        name="axis",
        title="the axis of the fast heavy top P1, tilted by 0.3 rad, without its spin angle",
        body=ml.SymmetricRotor(whole.body.moments[0], whole.body.moments[2]),
        torque=whole.torque,
        start=ml.AxisState.of(whole.start),
        dt=whole.dt,
        duration=whole.duration,
        source=whole.source,
        units=whole.units,
    )


OWN: dict[Any, Callable[[], Scene]] = {"orbit": _orbit, "axis": _axis}


def scene(which: str | Scene) -> Scene:
    """The scene, or that of this name, of `OWN` or of the package; with the axis of symmetry as third axis."""
    found = OWN[which]() if which in OWN else chosen.scene(which, jnp.float64)
    return axis_third(found) if isinstance(found.body, ml.RigidBody) else found


def perturbed(start: Any, count: int, size: float) -> Any:
    """Perturbed copies of a state of any kind, with a leading axis; the first is the start itself.

    Each component changes by a normal number of the standard deviation `size`, relative to the norm of its array; an
    attitude or axis turns by so many radians. They are those of `scenes.perturbed` where both exist.
    """
    norms = [float(jnp.linalg.norm(leaf)) for leaf in jax.tree.leaves(start)]
    whole = start.minus(start).shape[-1]
    counts = [3, whole - 3 * (len(norms) - 1), *([3] * (len(norms) - 2))]  # the pose has 3 or 2, vectors have 3
    changes = size * np.repeat(norms, counts) * np.random.default_rng(0).standard_normal((count, whole))
    changes[0] = 0
    starts = jax.vmap(start.plus)(jnp.asarray(changes))
    return starts.kind.normalised(starts)


def axis_third(scene: Scene) -> Scene:
    """The scene with the axis of symmetry of the body as third axis, as the exact flight of such a body needs.

    If there are several, it is the axis of the torque, otherwise the last. Without one the scene is unchanged.
    """
    moments, torque = np.asarray(scene.body.moments), scene.torque
    own = torque.axis if isinstance(torque, ml.torques.HeavyTop) else (0.0, 0.0, 0.0)
    axes = [k for k in range(3) if moments[(k + 1) % 3] == moments[(k + 2) % 3]]
    return renumbered(scene, max(axes, key=lambda k: (abs(own[k]), k), default=2))


def renumbered(scene: Scene, third: int) -> Scene:
    """The scene with this axis of the body as third, by a cyclic change; unchanged if its torque does not allow it."""
    order, torque = ((third + 1) % 3, (third + 2) % 3, third), scene.torque
    if third == 2 or not (torque is None or isinstance(torque, ml.torques.HeavyTop | ml.spacecraft.GravityGradient)):
        return scene
    pick = jnp.array(order)
    moments = scene.body.moments[pick]
    if isinstance(torque, ml.torques.HeavyTop):
        a, b, c = (torque.axis[i] for i in order)
        torque = ml.torques.HeavyTop(torque.mgl, (a, b, c))
    elif torque is not None:
        torque = ml.spacecraft.GravityGradient(moments, torque.orbit, torque.mu)
    momentum, attitude = scene.start.momentum, scene.start.attitude
    turn = jnp.array([(0.5, 0.5, 0.5, 0.5), (0.5, -0.5, -0.5, -0.5)][third], attitude.dtype)  # from new axes to old
    start = type(scene.start)(momentum[pick], ml.so3.multiply(attitude, turn))
    return replace(scene, body=ml.RigidBody(moments), torque=torque, start=start, axes=None)


# ---- a kind of state: its equations of motion on numbers, and the error of its end ----
#
# The numbers of a state are its arrays one after another, in the order of its fields. A new kind needs a section here
# and a line in `kind_of`.


class Kind(NamedTuple):
    """What must be known of a kind of state.

    Attributes:
        rates: for a scene `field(state, place=None)`, d/dt of the numbers of a state on scalars of any type; `place` is
            the position of a satellite relative to the attracting mass, in units of its distance at time 0.
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


Vector = tuple[Any, Any, Any]


def cross(a: Any, b: Any) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def rows(quaternion: Any) -> tuple[Vector, Vector, Vector]:
    w, x, y, z = quaternion
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def turning(quaternion: Any, velocity: Any) -> tuple[Any, Any, Any, Any]:
    w, x, y, z = quaternion
    a, b, c = velocity
    spin = (-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a)
    return 0.5 * spin[0], 0.5 * spin[1], 0.5 * spin[2], 0.5 * spin[3]


def matrix(quaternion: Any) -> np.ndarray:
    return np.array(rows(quaternion))


def matrices(quaternions: np.ndarray) -> np.ndarray:
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.stack([matrix(q) for q in unit])


# ---- a rigid body that rotates about a fixed point or its centre of mass: Pi and the quaternion, seven numbers ----
#
# Pi' = Pi x I^-1 Pi + T, q' = q (0, I^-1 Pi)/2. The momentum Pi is in the body frame, the attitude q is body to space.


def rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """The equations of motion. Constants are read from arrays once, so that Python does not spend time on arrays."""
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
    if isinstance(field, ml.torques.HeavyTop) and field.axis == (0.0, 0.0, 1.0):
        weight = float(field.mgl)

        def heavy_top(q: Any, place: Vector | None) -> tuple[Any, Any, Any]:
            del place
            w, x, y, z = q
            return weight * (2 * (y * z + w * x)), weight * (-2 * (x * z - w * y)), None

        return heavy_top
    if isinstance(field, ml.spacecraft.GravityGradient) and isinstance(field.orbit, ml.orbits.KeplerOrbit):
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


def orbit_of(scene: Scene) -> ml.orbits.KeplerOrbit | None:
    orbit = scene.torque.orbit if isinstance(scene.torque, ml.spacecraft.GravityGradient) else None
    return orbit if isinstance(orbit, ml.orbits.KeplerOrbit) else None


def radius(orbit: ml.orbits.KeplerOrbit) -> float:
    """The distance at time 0, the unit of length of an orbit: adaptive steps need numbers of similar size."""
    return float(np.linalg.norm(np.asarray(orbit.position)))


def _rate(orbit: ml.orbits.KeplerOrbit) -> float:
    """The angular rate of a circular orbit through the start; its inverse is the unit of time of orbital velocities."""
    return math.sqrt(float(orbit.mu) / radius(orbit) ** 3)


def orbit_start(orbit: ml.orbits.KeplerOrbit) -> np.ndarray:
    """Position and velocity at time 0 in these units, (6,), for a program that also integrates the orbit."""
    size, rate = radius(orbit), _rate(orbit)
    return np.concatenate([np.asarray(orbit.position) / size, np.asarray(orbit.velocity) / (size * rate)])


def orbit_rates(orbit: ml.orbits.KeplerOrbit, state: Any) -> tuple[Any, ...]:
    """d/dt of position and velocity, in the units of `orbit_start`, on scalars."""
    r, v, rate = state[:3], state[3:], _rate(orbit)
    pull = -rate * (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) ** -1.5
    return (*(rate * x for x in v), *(pull * x for x in r))


def kepler(orbit: ml.orbits.KeplerOrbit) -> Callable[[float], Vector]:
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
    return np.linalg.norm(matrices(ends[:, 3:]) - matrices(rigid_exact[:, 3:]), axis=(1, 2))


def rigid_exact(scene: Scene, states: np.ndarray) -> tuple[np.ndarray, str] | None:
    starts = [ml.RigidState(state[:3], state[3:]) for state in states]
    ends = exact_ends(np.asarray(scene.body.moments), scene.torque, starts, scene.duration)
    return None if ends is None else (np.concatenate(ends, axis=1), SOURCE)


RIGID = Kind(rates, rigid_errors, "the attitude, |R - R*| in the Frobenius norm", rigid_exact)


# ---- the axis of a top with two equal moments, in six numbers: the momentum pi and the axis e, both in space ----
#
# pi' = T, e' = pi x e / I1. Whoever asks for the axis alone would write these equations, whatever the program.


def axis_rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    if not (isinstance(scene.torque, ml.torques.HeavyTop) and scene.torque.axis == (0.0, 0.0, 1.0)):
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
    if not isinstance(scene.torque, ml.torques.PointMass):
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
    return {ml.RigidState: RIGID, ml.AxisState: AXIS, ml.FreeState: FREE}[type(scene.start)]


def numbers(states: Any) -> np.ndarray:
    return np.concatenate([np.asarray(leaf) for leaf in jax.tree.leaves(states)], axis=-1)


def sizes(start: Any) -> np.ndarray:
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(start)]
    return np.concatenate([np.full(len(leaf), np.linalg.norm(leaf)) for leaf in leaves])


# ---- the problem that every program solves: the same bodies, torque and clock, and the same measure of the error ----


class Point(NamedTuple):
    """One program or method at one tolerance or step, for one body.

    Attributes:
        setting: the tolerance or step, such as "tol 1e-06", and after a comma the options of the program, if any.
        error: at the end, root mean square over the bodies with a reference end.
        seconds: median time of the whole run, without compiling (`timing.cost_clock`).
        evaluations: torque evaluations; NaN for a method or problem without.
        steps: NaN for a closed form, which takes none.
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
        starts: the states of n bodies.
        ends: reference numbers at the end, of the first m bodies, (m, k), computed by `source` to this uncertainty.
        repeats: largest number of timed runs.
        longest: seconds of a run of all bodies; after a longer run no smaller step is tried.
    """

    scene: Scene
    kind: Kind
    starts: AnyState
    ends: np.ndarray
    source: str
    uncertainty: float
    repeats: int = 5
    longest: float = 1.0

    @property
    def bodies(self) -> int:
        return len(self.starts.momentum)

    @property
    def states(self) -> np.ndarray:
        return numbers(self.starts)

    @property
    def sizes(self) -> np.ndarray:
        return sizes(jax.tree.map(lambda leaf: leaf[0], self.starts))

    def error(self, ends: Any) -> float:
        given = np.asarray(ends, np.float64)[: len(self.ends)]
        return float(np.sqrt(np.mean(self.kind.errors(given, self.ends[: len(given)]) ** 2)))

    def point(
        self, name: str, setting: str, ends: Any, timing: Timing, steps: Any, evaluations: Any, bodies: int = 0
    ) -> Iterator[Point]:
        """The point of a run of so many bodies, by default all, if its ends are finite."""
        if np.all(np.isfinite(ends)):
            count = math.nan if self.scene.torque is None else evaluations
            seconds = timing.seconds / (bodies or self.bodies)
            yield Point(name, setting, self.error(ends), seconds, count, steps, timing.spread)

    def timed(self, run: Callable[[], Any]) -> tuple[Any, Timing]:
        return timed(run, most=self.repeats, longest=self.longest)

    def timed_in_turn(self, runs: Sequence[Callable[[], Any]]) -> list[Timing]:
        return [timing for _, timing in timed_in_turn(runs, most=self.repeats, longest=self.longest)]


def program(name: str) -> Any:
    """The module of that name; if it is not installed, an ImportError that names the extra."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"the rivals need {name.split('.')[0]}: pip install 'midlie_jax[bench]'.") from error


# ---- our methods over a ladder of steps, and the closed form ----

_EVALUATIONS = 20  # of the closed form in a timed run; one alone is a tenth of a millisecond, too short for the clock
FREE_MOTION = "free_motion"  # as points and charts name the closed form of a free body
_FLOOR = 3e-14  # below this error rounding dominates, and smaller steps give no more information
_ROUGH = 0.1  # above this error a method has not begun to converge
_GROWTH = 1.6  # factor between the numbers of steps of two rungs


def ladder(method: Method, case: Problem) -> Iterator[Point]:
    """Points from coarse steps until rounding dominates or runs take too long; none if it does not move such bodies."""
    scene, starts = case.scene, case.starts
    if not method.moves(scene.body):
        return
    program = Program(method, scene.body, scene.torque, starts, chunk=chunk_size(len(starts.momentum), starts))
    count = max(1, case.scene.steps // 100)
    best, rungs_without_gain = np.inf, 0
    while rungs_without_gain < 3:
        steps = program.whole(count)
        (states, bodies_ok), timing = case.timed(lambda steps=steps: program.run(scene.duration / steps, steps))
        setting, ends = f"step {scene.duration / steps:.2e}", numbers(states) if np.all(bodies_ok) else np.nan
        for point in case.point(method.name, setting, ends, timing, steps, method.evaluations * steps):
            yield point
            error = point.error
            # Three rungs below the floor, or without gain on a run that has begun to converge, show only rounding.
            no_gain = error < _FLOOR or (best < _ROUGH and error > 0.7 * best)
            rungs_without_gain = rungs_without_gain + 1 if no_gain else 0
            best = min(best, error)
        if timing.seconds > case.longest:
            return
        count = max(count + 1, round(count * _GROWTH))


def exact_point(case: Problem) -> Iterator[Point]:
    times = jnp.asarray([case.scene.duration])

    def end(start: ml.RigidState) -> tuple[ml.RigidState, Array]:
        path = ml.free_motion(case.scene.body, start, times)
        return jax.tree.map(lambda leaf: leaf[0], path.states), path.ok

    program = jax.jit(jax.vmap(end)).lower(case.starts).compile(compiler_options=compiler_options(case.bodies))

    def run() -> tuple[ml.RigidState, Array]:
        return [jax.block_until_ready(program(case.starts)) for _ in range(_EVALUATIONS)][-1]

    run()  # the first call takes longer than the others and must not be timed
    (ends, ok), timing = case.timed(run)
    if bool(np.all(ok)):
        seconds, nan = timing.seconds / (_EVALUATIONS * case.bodies), float("nan")
        yield Point(FREE_MOTION, "one evaluation", case.error(numbers(ends)), seconds, nan, nan, timing.spread)


# ---- two classical Lie-group methods of order 4, with the rotations of this package, run like its own methods ----
#
# Both integrate the pair (R, pi), where pi = R Pi is the momentum in space: R' = R skew(I^-1 R^T pi), pi' = R T. The
# momentum takes a classical Runge-Kutta step, and the attitude a step of products of exponentials. So pi is constant
# for a free body.


class _OnTheGroup(Method):
    name: eqx.AbstractVar[str]
    order: int = eqx.field(static=True, default=4)
    symmetric: bool = eqx.field(static=True, default=False)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=True)
    bodies: type = eqx.field(static=True, default=ml.RigidBody)
    evaluations: int = eqx.field(static=True, default=4)

    def keeps_force(self, system: System) -> bool:
        return False


def _rates(system: System, t: Array, momentum: cp.Vector, pose: Any) -> tuple[cp.Vector, cp.Vector]:
    """Angular velocity in the body frame I^-1 R^T pi, and torque in space R T."""
    body = cp.rotate_back(pose, momentum)
    velocity = cp.times(system.inertia.inverses, body)
    if system.torque is None:
        return velocity, (body[0] * 0, body[0] * 0, body[0] * 0)
    return velocity, cp.rotate(pose, system.force(t, Motion(body, pose)))


def _exp(v: cp.Vector) -> tuple[cp.Quaternion, Array]:
    half = cp.scale(0.5, v)
    root = half_turn(half)
    return cp.square(root), cp.dot(half, half)


def _sum(*terms: tuple[float, cp.Vector]) -> cp.Vector:
    total = cp.scale(*terms[0])
    for c, v in terms[1:]:
        total = cp.add(total, cp.scale(c, v))
    return total


def _weighted(k: list[cp.Vector]) -> cp.Vector:
    return _sum((1 / 6, k[0]), (1 / 3, k[1]), (1 / 3, k[2]), (1 / 6, k[3]))


class RKMK4(_OnTheGroup):
    """The classical Runge-Kutta method on u' = dexp_(-u)^-1 Omega, R = R0 exp(u), the inverse cut after two brackets.

    Order 4. Munthe-Kaas, Appl. Numer. Math. 29 (1999) 115.
    """

    name: str = eqx.field(static=True, default="RKMK4")

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        del force
        start, pose = cp.rotate(motion.pose, motion.momentum), motion.pose
        turns: list[cp.Vector] = []  # h times the angular velocity of each stage
        impulses: list[cp.Vector] = []  # h times the torque of each stage
        u, momentum, stage_pose = None, start, pose
        for stage, (c, t) in enumerate(((0.5, t0), (0.5, t0 + h / 2), (1.0, t0 + h / 2), (None, t1))):
            velocity, torque = _rates(system, t, momentum, stage_pose)
            if u is not None:  # dexp_(-u)^-1 v = v + u x v / 2 + u x (u x v) / 12
                first = cp.cross(u, velocity)
                velocity = _sum((1.0, velocity), (0.5, first), (1 / 12, cp.cross(u, first)))
            turns.append(cp.scale(h, velocity))
            impulses.append(cp.scale(h, torque))
            if c is not None:
                u, momentum = cp.scale(c, turns[stage]), cp.add(start, cp.scale(c, impulses[stage]))
                turns, impulses, u, momentum = fuse((turns, impulses, u, momentum))
                stage_pose = cp.multiply(pose, _exp(u)[0])
        increment, square = _exp(_weighted(turns))
        momentum = cp.add(start, _weighted(impulses))
        turned = system.turned(pose, increment, h)
        return Motion(cp.rotate_back(turned, momentum), turned), None, square <= LARGEST_SQUARE


class CF4(_OnTheGroup):
    """The commutator-free method of order 4: five exponentials and no bracket.

    Celledoni, Marthinsen & Owren, Future Gener. Comput. Syst. 19 (2003) 341.
    """

    name: str = eqx.field(static=True, default="CF4")

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        del force
        start, pose = cp.rotate(motion.pose, motion.momentum), motion.pose

        def stage(t: Array, momentum: cp.Vector, stage_pose: Any) -> tuple[cp.Vector, cp.Vector]:
            velocity, torque = _rates(system, t, momentum, stage_pose)
            return fuse((cp.scale(h, velocity), cp.scale(h, torque)))

        v1, f1 = stage(t0, start, pose)
        second = cp.multiply(pose, _exp(cp.scale(0.5, v1))[0])
        v2, f2 = stage(t0 + h / 2, cp.add(start, cp.scale(0.5, f1)), second)
        third = cp.multiply(pose, _exp(cp.scale(0.5, v2))[0])
        v3, f3 = stage(t0 + h / 2, cp.add(start, cp.scale(0.5, f2)), third)
        fourth = cp.multiply(second, _exp(_sum((1.0, v3), (-0.5, v1)))[0])
        v4, f4 = stage(t1, cp.add(start, f3), fourth)
        inner, inner_square = _exp(_sum((0.25, v1), (1 / 6, v2), (1 / 6, v3), (-1 / 12, v4)))
        outer, outer_square = _exp(_sum((-1 / 12, v1), (1 / 6, v2), (1 / 6, v3), (0.25, v4)))
        momentum = cp.add(start, _weighted([f1, f2, f3, f4]))
        turned = system.turned(cp.multiply(pose, inner), outer, h)
        ok = (inner_square <= LARGEST_SQUARE) & (outer_square <= LARGEST_SQUARE)
        return Motion(cp.rotate_back(turned, momentum), turned), None, ok


# ---- diffrax: explicit Runge-Kutta methods on the numbers of a state, with constant and with adaptive steps ----
#
# The tolerance or step is an argument of the compiled program, so each of the two is compiled once. The programs have
# the full vectors of the machine, but XLA's own way to compile short loops: without it they are half as fast.

ADAPTIVE = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
_PATIENCE = 6  # runs may take so many times as long as those of others, to reach the small errors that are compared


def measure_diffrax(problem: Problem, solver: Any, name: str, stages: int) -> Iterator[Point]:
    scene, orbit, equations = problem.scene, orbit_of(problem.scene), problem.kind.rates(problem.scene)
    states, size = jnp.asarray(problem.states), jnp.asarray(problem.sizes)

    def field(t: Any, y: Any, args: Any) -> Any:
        del args
        position = None if orbit is None else tuple(orbit(t) / radius(orbit))
        return jnp.stack(equations(tuple(y), position))

    def solve(start: Any, step: Any, controller: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            solver,
            0.0,
            scene.duration,
            step,
            start,
            stepsize_controller=controller,
            adjoint=diffrax.ForwardMode(),
            max_steps=None,
            throw=False,
        )
        ends: Any = solution.ys
        return ends[-1], solution.stats["num_steps"]

    def constant(starts: Any, step: Any) -> Any:
        return jax.vmap(lambda start: solve(start, step, diffrax.ConstantStepSize()))(starts)

    def adaptive(starts: Any, tolerance: Any) -> Any:
        controller = diffrax.PIDController(rtol=0.0, atol=tolerance * size)
        first = scene.dt / 4
        return jax.vmap(lambda start: solve(start, first, controller))(starts)

    constant_steps = [scene.duration / max(4, scene.steps // 64) / 2**n for n in range(16)]
    options = vector_width_options()
    for function, values, label in ((adaptive, ADAPTIVE, "tol"), (constant, constant_steps, "step")):
        compiled = jax.jit(function).lower(states, jnp.asarray(1.0)).compile(compiler_options=options)
        for value in values:

            def run(value: float = value, compiled: Any = compiled) -> Any:
                return jax.block_until_ready(compiled(states, jnp.asarray(value)))

            (ends, steps), timing = problem.timed(run)
            count = float(np.mean(steps))
            yield from problem.point(name, f"{label} {value:.1e}", ends, timing, count, stages * count)
            if timing.seconds > _PATIENCE * problem.longest:
                break


# ---- SciPy's DOP853: one body at a time in Python ----
#
# The right-hand side works on Python floats, which for a dozen numbers is faster than on NumPy arrays.

_SCIPY_BODIES = 2  # bodies timed and compared: one body takes as long as hundreds of bodies of a compiled program
_SCIPY_LONGEST = 1.0  # seconds for one body after which no smaller tolerance is tried


def dop853(problem: Problem, tolerances: tuple[float, ...] = ADAPTIVE) -> Iterator[Point]:
    solve_ivp = program("scipy.integrate").solve_ivp

    scene, orbit, equations = problem.scene, orbit_of(problem.scene), problem.kind.rates(problem.scene)
    position = None if orbit is None else kepler(orbit)

    def field(t: float, y: np.ndarray) -> tuple[float, ...]:
        return equations(y.tolist(), None if position is None else position(t))

    starts = problem.states[:_SCIPY_BODIES]
    for tolerance in tolerances:

        def run(tolerance: float = tolerance) -> list[Any]:
            options = {"rtol": max(tolerance, 3e-14), "atol": tolerance * problem.sizes, "t_eval": [scene.duration]}
            return [solve_ivp(field, (0.0, scene.duration), start, "DOP853", **options) for start in starts]

        solutions, timing = problem.timed(run)
        ends = np.stack([solution.y[:, -1] for solution in solutions])
        count = float(np.mean([solution.nfev for solution in solutions]))
        yield from problem.point("SciPy DOP853", f"tol {tolerance:.0e}", ends, timing, count / 12, count, _SCIPY_BODIES)
        if timing.seconds / _SCIPY_BODIES > _SCIPY_LONGEST:
            return


# ---- MuJoCo: a body on a ball joint, with gravity on its centre of mass, and MuJoCo's own loop over steps in C ----
#
# Body and joint frame are the body frame of this package, so qvel is the angular velocity in the body frame and qpos
# the attitude. Gravity is MuJoCo's only torque without a callback in Python; a satellite, which would need one, is left
# out.

_LEVER = 1e-4  # from the pivot to the centre of mass, with mass 1: so moments about both points differ by only 1e-8
_MUJOCO_BODIES = 4  # bodies timed
_MUJOCO_LONGEST = 0.5  # seconds of a run of these bodies after which no smaller step is taken


def model(scene: Scene, integrator: str) -> Any:
    mujoco = program("mujoco")

    weight = 0.0 if scene.torque is None else float(scene.torque.mgl)  # pyright: ignore
    mj_model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option integrator="{integrator}" gravity="0 0 {-weight / _LEVER!r}">
        <flag contact="disable" energy="disable"/></option>
        <worldbody><body><joint type="ball" damping="0" armature="0"/>
        <inertial pos="0 0 {_LEVER!r}" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    # The XML parser would refuse a flat body, whose largest moment is the sum of the others only up to rounding. So the
    # moments are set in the compiled model.
    mj_model.body_inertia[1] = np.asarray(scene.body.moments) - _LEVER**2 * np.array([1.0, 1.0, 0.0])
    mujoco.mj_setConst(mj_model, mujoco.MjData(mj_model))
    return mj_model


def measure_mujoco(problem: Problem, integrator: str, name: str, evaluations: int) -> Iterator[Point]:
    mujoco = program("mujoco")
    rollout = program("mujoco.rollout")

    scene = problem.scene
    if not isinstance(problem.starts, ml.RigidState) or not isinstance(scene.torque, ml.torques.HeavyTop | None):
        return
    mj_model = model(scene, integrator)
    moments = np.asarray(scene.body.moments)
    momenta, attitudes = problem.states[:_MUJOCO_BODIES, :3], problem.states[:_MUJOCO_BODIES, 3:]
    starts = np.concatenate([np.zeros((_MUJOCO_BODIES, 1)), attitudes, momenta / moments], axis=1)
    if mujoco.mj_stateSize(mj_model, mujoco.mjtState.mjSTATE_FULLPHYSICS) != starts.shape[1]:
        raise RuntimeError(
            "this version of MuJoCo has a state other than time, position and velocity; change how `starts` is built."
        )
    steps = max(1, scene.steps // 8)
    data = mujoco.MjData(mj_model)
    # MuJoCo writes warnings to a file in the user's folder. Warnings about coarse steps are expected, so they are off.
    mujoco.set_mju_user_warning(lambda text: None)
    with rollout.Rollout(nthread=0) as loop:
        while True:
            mj_model.opt.timestep = scene.duration / steps

            def run(steps: int = steps) -> np.ndarray:
                states, _ = loop.rollout(mj_model, data, starts, nstep=steps, skip_checks=False)
                ends = np.asarray(states)[:, -1]
                return np.concatenate([moments * ends[:, 5:], ends[:, 1:5]], axis=1)

            ends, timing = problem.timed(run)
            setting = f"step {mj_model.opt.timestep:.2e}"
            yield from problem.point(name, setting, ends, timing, steps, evaluations * steps, _MUJOCO_BODIES)
            if timing.seconds > _MUJOCO_LONGEST:
                break
            steps *= 2
    mujoco.set_mju_user_warning(None)


# ---- heyoka: Taylor's method with adaptive step and order (Biscani & Izzo, MNRAS 504 (2021) 2614) ----
#
# At each tolerance several variants of the integrator are timed in turn, and the point is the quickest. They differ in
# the number of bodies in a batch, in `fast_math`, and, on processors with AVX-512, in `force_avx512`; which is the
# quickest depends on the processor and the tolerance. Left out, because never the quickest: `compact_mode`,
# `slp_vectorize`, and the integrator for a single body. Each variant is built anew for each tolerance, because the
# order of the series depends on it. The time of the same Python loop over batches without integration steps is
# subtracted.

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14, 1e-15)
# A variant that takes so many times as long as the quickest, and is not the second, is not built for the smaller
# tolerances. There the series have more terms, and wide batches, which need more registers than there are, fall behind
# further; they are also the variants that take seconds to build.
_HOPELESS = 1.25


class Variant(NamedTuple):
    """A way to build the integrator: bodies in a batch, and heyoka's options of these names."""

    width: int
    fast_math: bool
    force_avx512: bool = False

    def __str__(self) -> str:
        options = [name for name in ("fast_math", "force_avx512") if getattr(self, name)]
        return ", ".join([f"{self.width} bodies a batch", *options])


def variants(bodies: int) -> list[Variant]:
    width = program("heyoka").recommended_simd_size()
    found = [Variant(width, False), Variant(width, True), Variant(2 * width, True)]
    if vector_width_options():  # the processor has AVX-512, and our programs use it
        found += [Variant(2 * width, True, True), Variant(4 * width, True, True)]
    # A batch cannot be wider than the number of bodies.
    return list(dict.fromkeys(variant._replace(width=min(variant.width, bodies)) for variant in found))


def equations(scene: Scene, kind: Kind, count: int) -> list[Any]:
    heyoka = program("heyoka")

    state = heyoka.make_vars(*(f"s{i}" for i in range(count)))
    orbit, field = orbit_of(scene), kind.rates(scene)
    if orbit is None:
        return list(zip(state, field(state), strict=True))
    orbit_state = heyoka.make_vars("x", "y", "z", "u", "v", "w")
    derivatives = (*field(state, tuple(orbit_state[:3])), *orbit_rates(orbit, orbit_state))
    return list(zip((*state, *orbit_state), derivatives, strict=True))


class _Integrator:
    """A variant of the integrator, built for a tolerance, and the batches that it moves."""

    def __init__(self, variant: Variant, system: list[Any], states: np.ndarray, tolerance: float):
        width = variant.width
        self.variant = variant
        self.batches = [np.ascontiguousarray(states[i : i + width].T) for i in range(0, len(states) - width + 1, width)]
        options = {"fast_math": variant.fast_math, "force_avx512": variant.force_avx512}
        build = program("heyoka").taylor_adaptive_batch
        self.taylor = build(system, self.batches[0].copy(), tol=tolerance, **options)

    @property
    def bodies(self) -> int:
        return self.variant.width * len(self.batches)

    def loop(self, end: float) -> None:
        state, set_time, propagate = self.taylor.state, self.taylor.set_time, self.taylor.propagate_until
        for batch in self.batches:
            set_time(0.0)
            state[:] = batch
            propagate(end)

    def ends(self, end: float, bodies: int) -> tuple[np.ndarray, float]:
        """The numbers of at least the first `bodies` bodies at the time `end`, and the mean number of steps."""
        ends, steps = [], []
        for batch in self.batches[: -(-bodies // self.variant.width)]:
            self.taylor.set_time(0.0)
            self.taylor.state[:] = batch
            self.taylor.propagate_until(end)
            ends.append(self.taylor.state.T.copy())
            steps.append(np.mean([outcome[3] for outcome in self.taylor.propagate_res]))
        return np.concatenate(ends), float(np.mean(steps))


def measure(problem: Problem, tolerances: tuple[float, ...] = TOLERANCES, label: str = "heyoka") -> Iterator[Point]:
    """A point for each tolerance, of the variant that is quickest there; `tolerances` must decrease."""
    end, orbit, states = problem.scene.duration, orbit_of(problem.scene), problem.states
    count = states.shape[1]
    system = equations(problem.scene, problem.kind, count)
    if orbit is not None:
        states = np.concatenate([states, np.tile(orbit_start(orbit), (len(states), 1))], axis=1)
    promising = variants(len(states))
    for tolerance in tolerances:
        integrators = [_Integrator(variant, system, states, tolerance) for variant in promising]
        loops = [lambda it=it, end=time: it.loop(end) for time in (end, 0.0) for it in integrators]
        timings = problem.timed_in_turn(loops)
        found: list[tuple[float, float, _Integrator]] = []  # seconds for one body, spread, of which integrator
        for integrator, timing, idle in zip(integrators, timings, timings[len(integrators) :], strict=False):
            part = max(1 - idle.seconds / timing.seconds, 0.5)  # heyoka's fraction of the time of the loop
            found.append((part * timing.seconds / integrator.bodies, timing.spread / part, integrator))
        found.sort(key=lambda entry: entry[0])
        cost, spread, best = found[0]
        promising = [
            it.variant for rank, (seconds, _, it) in enumerate(found) if rank < 2 or seconds < _HOPELESS * cost
        ]
        ends, steps = best.ends(end, len(problem.ends))
        setting = f"tol {tolerance:.0e}, {best.variant}"
        yield Point(label, setting, problem.error(ends[:, :count]), cost, float("nan"), steps, spread)


def reference(scene: Scene, kind: Kind, states: np.ndarray, digits: int = 38) -> np.ndarray:
    """The numbers (m, k) at the end of a scene from those at its start, by Taylor's method in `digits` digits."""
    heyoka = program("heyoka")

    bits = int(digits * 3.33) + 2
    exact = np.vectorize(lambda x: heyoka.real(float(x), prec=bits), otypes=[object])
    orbit = orbit_of(scene)
    orbit_state = np.zeros(0) if orbit is None else orbit_start(orbit)
    system = equations(scene, kind, states.shape[1])
    first = np.array(list(exact(np.concatenate([states[0], orbit_state]))))
    integrator = heyoka.taylor_adaptive(system, first, fp_type=heyoka.real, prec=bits, compact_mode=True)
    ends = []
    for start in states:
        integrator.time = heyoka.real(0.0, prec=bits)
        for i, x in enumerate(np.concatenate([start, orbit_state])):
            integrator.state[i] = heyoka.real(float(x), prec=bits)
        integrator.propagate_until(heyoka.real(scene.duration, prec=bits))
        ends.append(np.array([float(x) for x in integrator.state[: states.shape[1]]]))
    return np.stack(ends)


# ---- the seven equations of a whole top, where only its axis is asked for: what a program pays for the spin ----

LABEL = "heyoka, with the spin"


def whole(problem: Problem) -> Problem:
    scene: Any = problem.scene
    starts: Any = problem.starts
    rotor = scene.body
    moments = jnp.stack([rotor.moment, rotor.moment, rotor.known_along])
    start = scene.start.with_attitude()
    as_body = Scene(
        *(scene.name, scene.title, ml.RigidBody(moments), scene.torque, start),
        *(scene.dt, scene.duration, scene.source, scene.units),
    )
    return problem._replace(scene=as_body, kind=SPINNING, starts=starts.with_attitude())


def measure_spinning(problem: Problem) -> Iterator[Point]:
    if isinstance(problem.scene.body, ml.SymmetricRotor):
        yield from measure(whole(problem), label=LABEL)


# ---- the rivals ----


class Rival(NamedTuple):
    """A program, or one of its methods, and the packages that it imports. It yields no point where it cannot solve."""

    label: str
    needs: tuple[str, ...]
    measure: Callable[[Problem], Iterator[Point]]


def _diffrax(name: str, solver: Any, stages: int) -> Rival:
    return Rival(name, (), partial(measure_diffrax, solver=solver, name=name, stages=stages))


def _mujoco(name: str, integrator: str, evaluations: int) -> Rival:
    run = partial(measure_mujoco, integrator=integrator, name=name, evaluations=evaluations)
    return Rival(name, ("mujoco",), run)


RIVALS = (
    Rival("heyoka", ("heyoka",), measure),
    _diffrax("diffrax Tsit5", diffrax.Tsit5(), 6),
    _diffrax("diffrax Dopri8", diffrax.Dopri8(), 13),
    Rival("SciPy DOP853", ("scipy",), dop853),
    _mujoco("MuJoCo RK4", "RK4", 4),
    _mujoco("MuJoCo implicitfast", "implicitfast", 1),
    Rival("RKMK4", (), partial(ladder, RKMK4())),
    Rival("CF4", (), partial(ladder, CF4())),
    Rival(LABEL, ("heyoka",), measure_spinning),
)


def require(rivals: tuple[Rival, ...] = RIVALS) -> None:
    missing = [name for name in dict.fromkeys(n for r in rivals for n in r.needs) if find_spec(name) is None]
    if missing:
        raise ImportError(f"the rivals need {' and '.join(missing)}: pip install 'midlie_jax[bench]'.")
