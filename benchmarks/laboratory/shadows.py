"""Shapes that are not convex, their light curves by ray tracing (trimesh with embree), and the run time of shadows."""

import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import Table, compiled, in_turn

import midlie_jax as ml

PHASES = (0, 30, 60, 90)  # degrees
BODIES = 2000
_STEPS, _ROUNDS = 5, 5


class Dark(ml.asteroids.Scattering):
    """The law of light curve inversion, without arrays."""

    def __call__(self, mu: Any, mu0: Any) -> Any:
        return mu * mu0 * (1 / (mu + mu0) + 0.1)


LAW = Dark()


# ---- shapes ----


def stretched(subdivisions: int, radius: Callable[[np.ndarray], np.ndarray]) -> ml.Surface:
    """The surface of vertices at the distance `radius(directions)`."""
    import trimesh

    ball: Any = trimesh.creation.icosphere(subdivisions)
    vertices = np.asarray(ball.vertices)
    return ml.Surface(vertices * radius(vertices)[:, None], np.asarray(ball.faces))


def dumbbell() -> ml.Surface:
    """An oval of Cassini, rotated about its long axis: two lobes with a thin neck."""

    def radius(v: np.ndarray) -> np.ndarray:
        cosine = 2 * v[:, 0] ** 2 - 1
        return np.sqrt(cosine + np.sqrt(cosine**2 + 1.02**4 - 1))

    return stretched(3, radius)


def cratered() -> ml.Surface:
    random, holes = np.random.default_rng(1), list[tuple[np.ndarray, float]]()
    for _ in range(15):
        centre, size = random.normal(size=3), random.uniform(0.2, 0.5)
        holes.append((centre / np.linalg.norm(centre), size))

    def radius(v: np.ndarray) -> np.ndarray:
        angles = [(np.arccos(np.clip(v @ centre, -1, 1)) / size, size) for centre, size in holes]
        return 1 + np.sum([0.45 * size * (np.minimum(angle, 1) ** 2 - 1) for angle, size in angles], axis=0)

    return stretched(3, radius)


def bowl() -> ml.Surface:
    """Half of a hollow ball, open towards x."""
    import trimesh

    angles = np.linspace(0, np.pi / 2, 9)
    wall = [(r * np.sin(a), -r * np.cos(a)) for r, order in ((0.8, 1), (1.0, -1)) for a in angles[::order]]
    mesh: Any = trimesh.creation.revolve(np.array(wall), sections=24)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    faces = np.asarray(mesh.faces)
    vertices = np.roll(np.asarray(mesh.vertices), 1, axis=1)
    return ml.Surface(vertices, faces if mesh.volume > 0 else faces[:, ::-1])


def pair() -> ml.Surface:
    """Two balls in contact."""
    first, second = (stretched(3, lambda v, r=r: np.full(len(v), r)) for r in (1.0, 0.7))
    return first.moved([-1.0, 0, 0]) + second.moved([0.7, 0, 0])


SHAPES = {"craters": cratered, "dumbbell": dumbbell, "bowl": bowl, "two balls in contact": pair}


def phases_of(name: str) -> tuple[int, ...]:
    """The phase angles of a shape; at 90 degrees nearly all of a bowl is dark."""
    return PHASES[:3] if name == "bowl" else PHASES


# ---- light curves ----


def directions(phase: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the Sun and of the observer, (24, 3), around the z axis at other latitudes."""
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)

    def at(longitude: np.ndarray, latitude: float) -> np.ndarray:
        z = np.full_like(longitude, np.sin(latitude))
        return np.stack([np.cos(longitude) * np.cos(latitude), np.sin(longitude) * np.cos(latitude), z], axis=-1)

    sun = at(turn, 0.4)
    return sun, at(turn + np.radians(phase), -0.2) if phase else sun


def points_of(k: int) -> np.ndarray:
    """Barycentric coordinates of the centres of k^2 equal triangles in one."""
    upright = [((i + 1 / 3) / k, (j + 1 / 3) / k) for i in range(k) for j in range(k - i)]
    others = [((i + 2 / 3) / k, (j + 2 / 3) / k) for i in range(k) for j in range(k - i - 1)]
    points = np.array(upright + others)
    return np.concatenate([1 - points.sum(1, keepdims=True), points], axis=1)


def traced(surface: ml.Surface, suns: np.ndarray, observers: np.ndarray) -> np.ndarray:
    """Magnitudes by rays from 16 points of each facet to the Sun and to the observer."""
    import trimesh

    corners, normals, points = np.asarray(surface.corners), np.asarray(surface.normals), points_of(4)
    mesh: Any = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), process=False)
    start = points[None] @ corners + 1e-6 * np.abs(corners).max() * normals[:, None]  # embree has float32
    found = list[float]()
    for sun, observer in zip(suns, observers, strict=True):
        mu, mu0 = normals @ observer, normals @ sun
        seen = np.repeat(((mu > 0) & (mu0 > 0))[:, None], len(points), axis=1)
        for way in (sun, observer):
            rays = np.nonzero(seen)
            seen[rays] = ~mesh.ray.intersects_any(start[rays], np.tile(way, (len(rays[0]), 1)))
        weights = np.asarray(surface.areas) * seen.mean(1)
        some = weights > 0
        found.append(float(np.sum(weights[some] * LAW(mu[some], mu0[some]))))
    return -2.5 * np.log10(found)


@jax.jit
def light_curve(surface: ml.Surface, suns: Any, observers: Any) -> Any:
    """Magnitudes by `Brightness`."""
    still = ml.RigidState(jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0]))

    def at(sun: Any, observer: Any) -> Any:
        return ml.asteroids.Brightness(surface, sun, observer, LAW, magnitude=True)(0.0, still)

    return jax.vmap(at)(suns, observers)


def errors(name: str, plain: ml.Surface, shadowed: ml.Surface) -> dict[int, tuple[float, float]]:
    """For each phase angle the largest errors without and with shadows, in magnitudes."""
    found = dict[int, tuple[float, float]]()
    for phase in phases_of(name):
        suns, observers = directions(phase)
        exact = traced(plain, suns, observers)
        off = [np.abs(np.asarray(light_curve(x, suns, observers)) - exact).max() for x in (plain, shadowed)]
        found[phase] = float(off[0]), float(off[1])
    return found


# ---- run time ----


def _run(surface: ml.Surface | None, dtype: Any) -> Any:
    random = np.random.default_rng(0)
    attitude = random.normal(size=(BODIES, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    start = ml.RigidState(jnp.asarray(random.normal(size=(BODIES, 3)), dtype), jnp.asarray(attitude, dtype))
    direction, reflects = [0.48, 0.6, 0.64], (0.2, 0.3, 0.5)
    torque: Any = surface
    if surface is not None:
        torque = ml.asteroids.Sunlight(surface, direction, 1e-3, *reflects, speed_of_light=1.0)
    body, torque = jax.tree.map(lambda x: x.astype(dtype), (ml.RigidBody([1.0, 1.8, 2.3]), torque))
    options: Any = {"dt": jnp.asarray(0.01, dtype), "steps": _STEPS, "chunk": BODIES}
    return compiled(
        lambda start, torque: ml.ensemble("JACOBI[EA]", body, torque, start, **options).states.momentum,
        *(start, torque),
        bodies=BODIES,
    )


def rows() -> Iterator[list[str]]:
    for name, make in SHAPES.items():
        plain = make()
        began = time.process_time()
        shadowed = plain.with_shadows()
        horizons = time.process_time() - began
        off = errors(name, plain, shadowed)
        largest = [f"{max(pair[i] for pair in off.values()):.3f}" for i in range(2)]
        nanoseconds = list[str]()
        for dtype in ("float64", "float32"):
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="this surface is not convex")
                free, light, dark = in_turn([_run(x, jnp.dtype(dtype)) for x in (None, plain, shadowed)], _ROUNDS)
            # A run of n steps evaluates n + 1 torques.
            count = 1e-9 * (_STEPS + 1) * BODIES * plain.count
            nanoseconds += [f"{(light - free) / count:.2f}", f"{(dark - free) / count:.2f}"]
        yield [name, str(plain.count), *largest, f"{1e3 * horizons / plain.count:.1f}", *nanoseconds]


TABLE = Table(
    *("reports/applications.md", "surfaces shadows"),
    (
        *("shape", "facets", "error without, mag", "error with, mag", "horizon of a facet, ms", "ns without"),
        *("ns with", "float32, ns without", "float32, ns with"),
    ),
    *(rows, "shadows", bool, (0, 2, 3, 5, 6)),
)
