"""What light on the facets of a surface costs, and the light curve of a tumbling body beside that of slower tumbling.

The cost is that of a step with sunlight, beside one without and a loop in C over the same facets and bodies.
"""

import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import limit
import numpy as np
from harness import DOCS, Compiled, Table, compiled, in_turn

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax.cli.figures import panel, write
from midlie_jax.plot.style import BLUE, SIZE, VERMILLION, new_figure

SOURCE = Path(limit.__file__).parent / "facets.c"
FACETS, BODIES, CHUNK = 980, 10_000, 2000
_STEPS, _ROUNDS = 20, 5
_TYPES = {"float64": ("double", "long long"), "float32": ("float", "int")}


def scene(facets: int, dtype: Any) -> tuple[Any, Any, Any]:
    """A body off the centre of an ellipsoid in sunlight, and random states of it."""
    random = np.random.default_rng(0)
    surface = ml.Surface.ellipsoid([3.0, 2.0, 1.0], facets).moved([0.1, 0.2, -0.3])
    surface = surface if facets > 6 else ml.Surface.box([3.0, 2.0, 1.0]).moved([0.1, 0.2, -0.3])
    torque = ml.asteroids.Sunlight(surface, [0.48, 0.6, 0.64], 1e-3, 0.2, 0.3, 0.5, speed_of_light=1.0)
    attitude = random.normal(size=(BODIES, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    start = ml.RigidState(jnp.asarray(random.normal(size=(BODIES, 3)), dtype), jnp.asarray(attitude, dtype))
    cast: Any = jax.tree.map(lambda x: x.astype(dtype), (ml.RigidBody([1.0, 1.8, 2.3]), torque))
    return *cast, start


def in_c(facets: int, dtype: str) -> Callable[[], float]:
    """A function that returns the seconds of one torque on all bodies, by the fastest form; it agrees with ours."""
    _, torque, start = scene(facets, jnp.dtype(dtype))
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
        command = [str(program), str(folder / "numbers"), *map(str, (len(table), BODIES, 5))]
        words = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        difference = np.abs(np.array(words[1:], float) - ours).max()
        assert difference < (1e-11 if dtype == "float64" else 1e-2) * max(1, np.abs(ours).max())
        return float(words[0])

    fastest = min(programs, key=seconds)
    return lambda: seconds(fastest)


def _programs(facets: int, dtype: Any) -> list[Compiled]:
    """A run with and without sunlight, and the gradient of the first."""
    body, torque, start = scene(facets, dtype)
    options: Any = {"dt": jnp.asarray(0.01, dtype), "steps": _STEPS, "chunk": CHUNK}

    def run(start: Any, torque: Any = torque) -> Any:
        return ml.ensemble("JACOBI[EA]", body, torque, start, **options).states.momentum

    slope = jax.grad(lambda start: jnp.sum(run(start)[:, -1] ** 2))
    return [compiled(function, start, bodies=CHUNK) for function in (run, lambda start: run(start, None), slope)]


def loops(program: Any) -> int:
    """The most fused loops over the bodies of a chunk in a loop over blocks of facets."""
    text = program.as_text()
    parts = {part.split()[0].lstrip("%"): part for part in re.split(r"\n}\n+", text) if part.split()}
    bodies = [parts[name] for name in set(re.findall(r"body=%?([\w.\-]+)", text))]
    return max(len(re.findall(rf"\[{CHUNK}\].* fusion\(", body)) for body in bodies if "[16,11]" in body)


def rows() -> Iterator[list[str]]:
    for facets in (FACETS, 80):
        for dtype in _TYPES:
            c = in_c(facets, dtype)
            step, dark, gradient = _programs(facets, jnp.dtype(dtype))
            least = min(c() for _ in range(_ROUNDS))
            lit, free, back = (seconds / _STEPS for seconds in in_turn((step, dark, gradient), _ROUNDS))
            # A run of n steps evaluates n + 1 torques.
            own = (lit - free) * _STEPS / (_STEPS + 1)
            count = 1e-12 * facets * BODIES
            memory = [f"{program.memory / BODIES:.0f}" for program in (step, gradient)]
            ours = f"{least / count:.0f}", f"{own / count:.0f}", f"{own / least:.2f}", str(loops(step.program))
            yield [str(facets), dtype, *ours, memory[0], f"{back / lit:.1f}", memory[1]]


TABLE = Table(
    *("reports/applications.md", "surfaces cost"),
    (
        *("facets", "dtype", "C, ps", "additional time, ps", "ratio", "loops over bodies", "memory, bytes a body"),
        *("gradient / step", "its memory"),
    ),
    *(rows, "surfaces", lambda row: row[1] == "float64", (0, 2, 3, 4, 7)),
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


def light_curve(direction: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Hours and magnitudes relative to their mean."""
    body, surface = ml.Surface.ellipsoid(SEMI_AXES).principal(DENSITY)
    seen = ml.asteroids.Brightness(surface, SUN, OBSERVER, ml.asteroids.LommelSeeliger(lambert=0.1), magnitude=True)
    towards = np.array(direction) / np.linalg.norm(direction)
    momentum = 2 * np.pi / (PERIOD * HOUR) * body.moments[2] * jnp.asarray(towards)
    start = ml.RigidState(momentum, ml.so3.exp(jnp.array([0.4, 0.2, 0.0])))
    options: Any = {"dt": EVERY * HOUR, "steps": round(HOURS / EVERY), "observe": seen}
    path: Any = ml.integrate("JACOBI[EA]", body, None, start, **options)
    values = np.asarray(path.states)
    return np.asarray(path.times) / HOUR, values - values.mean()


def measure(options: Any) -> None:
    """Prints the ranges of the curves; with `write` draws them one above the other."""
    curves = {name: light_curve(direction) for name, direction in SPINS.items()}
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
