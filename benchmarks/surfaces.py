"""Surfaces: what sunlight and shadows cost, and a light curve: docs/reports/applications.md and docs/surfaces.md.

    python benchmarks/surfaces.py cost [--write]      a step with sunlight beside a loop in C over the same facets
    python benchmarks/surfaces.py shadows [--write]   shadows beside ray tracing, and their run time; needs embreex
    python benchmarks/surfaces.py curve [--write]     the light curve of a tumbling body; light-curve.png

Times are processor times on one core; programs that are compared take turns.
"""

import re
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import limit
import numpy as np
import one_core  # noqa: F401
from harness import DOCS, Compiled, Table, compiled, in_turn, main

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax.cli.figures import panel, write
from midlie_jax.plot.style import BLUE, SIZE, VERMILLION, new_figure

PAGE = "reports/applications.md"

# ---- a step with sunlight, beside one without and a loop in C over the same facets and bodies ----

SOURCE = Path(__file__).with_name("facets.c")
FACETS, LIT, CHUNK = 980, 10_000, 2000
_STEPS, _ROUNDS = 20, 5
_TYPES = {"float64": ("double", "long long"), "float32": ("float", "int")}


def bodies(count: int, dtype: Any) -> ml.RigidState:
    random = np.random.default_rng(0)
    attitude = random.normal(size=(count, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return ml.RigidState(jnp.asarray(random.normal(size=(count, 3)), dtype), jnp.asarray(attitude, dtype))


def lit_scene(facets: int, dtype: Any) -> tuple[Any, Any, Any]:
    surface = ml.Surface.ellipsoid([3.0, 2.0, 1.0], facets).moved([0.1, 0.2, -0.3])
    surface = surface if facets > 6 else ml.Surface.box([3.0, 2.0, 1.0]).moved([0.1, 0.2, -0.3])
    torque = ml.asteroids.Sunlight(surface, [0.48, 0.6, 0.64], 1e-3, 0.2, 0.3, 0.5, speed_of_light=1.0)
    start = bodies(LIT, dtype)
    cast: Any = jax.tree.map(lambda x: x.astype(dtype), (ml.RigidBody([1.0, 1.8, 2.3]), torque))
    return *cast, start


def in_c(facets: int, dtype: str) -> Callable[[], float]:
    """A function that returns the seconds of one torque on all bodies, by the fastest form; it agrees with ours."""
    _, torque, start = lit_scene(facets, jnp.dtype(dtype))
    table = np.stack(torque._columns()[:-1], axis=1)
    sun = np.stack(start.seen_from_body(cp.vector(torque.direction)))
    folder = Path(tempfile.mkdtemp(prefix="midlie-facets-"))
    (folder / "numbers").write_bytes(table.tobytes() + sun.tobytes())
    ours = np.asarray(torque(0.0, jax.tree.map(lambda x: x[0], start))) / -1e-3
    programs = []
    for compiler in limit.compilers():
        for vectors in (1, 2, 4):
            program = folder / f"facets-{len(programs)}"
            names = dict(zip(("REAL", "INTEGER"), _TYPES[dtype], strict=True)) | {"VECTORS": vectors}
            flags = [*limit.FLAGS, *limit.extra_flags(compiler), *(f"-D{k}={v}" for k, v in names.items())]
            subprocess.run([compiler, *flags, "-o", str(program), str(SOURCE)], check=True)
            programs.append(program)

    def seconds(program: Path) -> float:
        command = [str(program), str(folder / "numbers"), *map(str, (len(table), LIT, 5))]
        words = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        difference = np.abs(np.array(words[1:], float) - ours).max()
        assert difference < (1e-11 if dtype == "float64" else 1e-2) * max(1, np.abs(ours).max())
        return float(words[0])

    fastest = min(programs, key=seconds)
    return lambda: seconds(fastest)


def _programs(facets: int, dtype: Any) -> list[Compiled]:
    body, torque, start = lit_scene(facets, dtype)
    options: Any = {"dt": jnp.asarray(0.01, dtype), "steps": _STEPS, "chunk": CHUNK}

    def run(start: Any, torque: Any = torque) -> Any:
        return ml.ensemble("JACOBI[EA]", body, torque, start, **options).states.momentum

    slope = jax.grad(lambda start: jnp.sum(run(start)[:, -1] ** 2))
    return [compiled(function, start, bodies=CHUNK) for function in (run, lambda start: run(start, None), slope)]


def loops(program: Any) -> int:
    text = program.as_text()
    parts = {part.split()[0].lstrip("%"): part for part in re.split(r"\n}\n+", text) if part.split()}
    bodies = [parts[name] for name in set(re.findall(r"body=%?([\w.\-]+)", text))]
    return max(len(re.findall(rf"\[{CHUNK}\].* fusion\(", body)) for body in bodies if "[16,11]" in body)


def cost_rows() -> Iterator[list[str]]:
    for facets in (FACETS, 80):
        for dtype in _TYPES:
            c = in_c(facets, dtype)
            step, dark, gradient = _programs(facets, jnp.dtype(dtype))
            least = min(c() for _ in range(_ROUNDS))
            lit, free, back = (seconds / _STEPS for seconds in in_turn((step, dark, gradient), _ROUNDS))
            # A run of n steps evaluates n + 1 torques.
            own = (lit - free) * _STEPS / (_STEPS + 1)
            count = 1e-12 * facets * LIT
            memory = [f"{program.memory / LIT:.0f}" for program in (step, gradient)]
            ours = f"{least / count:.0f}", f"{own / count:.0f}", f"{own / least:.2f}", str(loops(step.program))
            yield [str(facets), dtype, *ours, memory[0], f"{back / lit:.1f}", memory[1]]


COST = Table(
    *(PAGE, "surfaces cost"),
    (
        *("facets", "dtype", "C, ps", "additional time, ps", "ratio", "loops over bodies", "memory, bytes a body"),
        *("gradient / step", "its memory"),
    ),
    *(cost_rows, "surfaces", lambda row: row[1] == "float64", (0, 2, 3, 4, 7)),
)


# ---- a light curve ----

HOUR = 3600.0
SEMI_AXES, DENSITY = (150.0, 75.0, 60.0), 2500.0  # m, kg/m^3
SUN, OBSERVER = (1.0, 0.0, 0.0), (0.8, 0.6, 0.0)
SPINS = {"about its shortest axis": (0.0, 0.0, 1.0), "tumbling": (0.65, 0.1, 0.75)}  # directions of the momentum
_MESSAGES = {
    "about its shortest axis": "Spin about the shortest axis: all minima are equal",
    "tumbling": "Tumbling: no two minima in a row are equal",
}
PERIOD, HOURS, EVERY = 27.0, 120.0, 0.1  # hours: of a turn by the largest moment, of the run, between samples


def tumbling_curve(direction: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    body, surface = ml.Surface.ellipsoid(SEMI_AXES).principal(DENSITY)
    seen = ml.asteroids.Brightness(surface, SUN, OBSERVER, ml.asteroids.LommelSeeliger(lambert=0.1), magnitude=True)
    towards = np.array(direction) / np.linalg.norm(direction)
    momentum = 2 * np.pi / (PERIOD * HOUR) * body.moments[2] * jnp.asarray(towards)
    start = ml.RigidState(momentum, ml.so3.exp(jnp.array([0.4, 0.2, 0.0])))
    options: Any = {"dt": EVERY * HOUR, "steps": round(HOURS / EVERY), "observe": seen}
    path: Any = ml.integrate("JACOBI[EA]", body, None, start, **options)
    values = np.asarray(path.states)
    return np.asarray(path.times) / HOUR, values - values.mean()


def curve(options: Any) -> None:
    curves = {name: tumbling_curve(direction) for name, direction in SPINS.items()}
    for name, (_, values) in curves.items():
        print(f"{name}: {np.ptp(values):.2f} mag from the brightest to the faintest")
    if not options.write:
        return
    figure = new_figure(9, 5.2)
    axes = figure.subplots(2, 1, sharex=True, sharey=True)
    figure.subplots_adjust(left=0.09, right=0.985, top=0.93, bottom=0.11, hspace=0.28)
    for one, colour, (name, (hours, values)) in zip(axes, (BLUE, VERMILLION), curves.items(), strict=True):
        panel(one, _MESSAGES[name], "", "relative magnitude [mag]")
        one.plot(hours, values, color=colour, linewidth=1.3)
        one.yaxis.label.set_fontsize(SIZE + 2)
    axes[0].invert_yaxis()
    axes[1].set_xlabel("time [h]", fontsize=SIZE + 2)
    axes[0].set_xlim(0, HOURS)
    write(figure, str(DOCS / "light-curve.png"))


# ---- shapes that are not convex, their light curves by ray tracing, and the run time of shadows ----

PHASES = (0, 30, 60, 90)  # degrees
BODIES = 2000
_SHADOW_STEPS, _SHADOW_ROUNDS = 5, 5


class Dark(ml.asteroids.Scattering):
    def __call__(self, mu: Any, mu0: Any) -> Any:
        return mu * mu0 * (1 / (mu + mu0) + 0.1)


LAW = Dark()


def stretched(subdivisions: int, radius: Callable[[np.ndarray], np.ndarray]) -> ml.Surface:
    import trimesh

    ball: Any = trimesh.creation.icosphere(subdivisions)
    vertices = np.asarray(ball.vertices)
    return ml.Surface(vertices * radius(vertices)[:, None], np.asarray(ball.faces))


def dumbbell() -> ml.Surface:
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
    first, second = (stretched(3, lambda v, r=r: np.full(len(v), r)) for r in (1.0, 0.7))
    return first.moved([-1.0, 0, 0]) + second.moved([0.7, 0, 0])


SHAPES = {"craters": cratered, "dumbbell": dumbbell, "bowl": bowl, "two balls in contact": pair}


def phases_of(name: str) -> tuple[int, ...]:
    return PHASES[:3] if name == "bowl" else PHASES


# ---- light curves ----


def directions(phase: int) -> tuple[np.ndarray, np.ndarray]:
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)

    def at(longitude: np.ndarray, latitude: float) -> np.ndarray:
        z = np.full_like(longitude, np.sin(latitude))
        return np.stack([np.cos(longitude) * np.cos(latitude), np.sin(longitude) * np.cos(latitude), z], axis=-1)

    sun = at(turn, 0.4)
    return sun, at(turn + np.radians(phase), -0.2) if phase else sun


def points_of(k: int) -> np.ndarray:
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
    still = ml.RigidState(jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0]))

    def at(sun: Any, observer: Any) -> Any:
        return ml.asteroids.Brightness(surface, sun, observer, LAW, magnitude=True)(0.0, still)

    return jax.vmap(at)(suns, observers)


def errors(name: str, plain: ml.Surface, shadowed: ml.Surface) -> dict[int, tuple[float, float]]:
    found = dict[int, tuple[float, float]]()
    for phase in phases_of(name):
        suns, observers = directions(phase)
        exact = traced(plain, suns, observers)
        off = [np.abs(np.asarray(light_curve(x, suns, observers)) - exact).max() for x in (plain, shadowed)]
        found[phase] = float(off[0]), float(off[1])
    return found


# ---- run time ----


def _run(surface: ml.Surface | None, dtype: Any) -> Any:
    start = bodies(BODIES, dtype)
    direction, reflects = [0.48, 0.6, 0.64], (0.2, 0.3, 0.5)
    torque: Any = surface
    if surface is not None:
        torque = ml.asteroids.Sunlight(surface, direction, 1e-3, *reflects, speed_of_light=1.0)
    body, torque = jax.tree.map(lambda x: x.astype(dtype), (ml.RigidBody([1.0, 1.8, 2.3]), torque))
    options: Any = {"dt": jnp.asarray(0.01, dtype), "steps": _SHADOW_STEPS, "chunk": BODIES}
    return compiled(
        lambda start, torque: ml.ensemble("JACOBI[EA]", body, torque, start, **options).states.momentum,
        *(start, torque),
        bodies=BODIES,
    )


def shadow_rows() -> Iterator[list[str]]:
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
                free, light, dark = in_turn(
                    [_run(x, jnp.dtype(dtype)) for x in (None, plain, shadowed)], _SHADOW_ROUNDS
                )
            # A run of n steps evaluates n + 1 torques.
            count = 1e-9 * (_SHADOW_STEPS + 1) * BODIES * plain.count
            nanoseconds += [f"{(light - free) / count:.2f}", f"{(dark - free) / count:.2f}"]
        yield [name, str(plain.count), *largest, f"{1e3 * horizons / plain.count:.1f}", *nanoseconds]


SHADOWS = Table(
    *(PAGE, "surfaces shadows"),
    (
        *("shape", "facets", "error without, mag", "error with, mag", "horizon of a facet, ms", "ns without"),
        *("ns with", "float32, ns without", "float32, ns with"),
    ),
    *(shadow_rows, "shadows", bool, (0, 2, 3, 5, 6)),
)

if __name__ == "__main__":
    main(__doc__, {"cost": COST, "shadows": SHADOWS, "curve": curve})
