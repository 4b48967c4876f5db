"""Binary asteroids: what a day costs at an error, and ten years of energy and momenta: docs/reports/applications.md.

    python benchmarks/binaries.py [cost] [long] [first] [--write]

Processor times on one core, medians of rounds in which all methods take turns; 1000 binaries of different shapes
through `ml.ensemble`. First calls are measured in separate processes. `--write` puts tables and picture into docs/.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import one_core  # noqa: F401
from harness import REPORTS, Compiled, Line, Panel, Table, chart, compiled, first_call, in_turn, main, save, shown
from laboratory import didymos

import midlie_jax as ml
from midlie_jax.plot.style import BLUE, GREEN, ORANGE, VERMILLION

PICTURE = "binaries.png"
DEGREES, ERROR = (2, 4), 1e-10
YEARS, STATES = 10, 1000
BINARIES = 1000
# Steps a day.
LADDERS = {
    "JACOBI[EA]": (360, 1440, 5760),
    "JACOBI[SRKN6b]": (96, 144, 192, 288, 432, 576),
    "JACOBI[SRKN14a]": (48, 72, 96, 108, 120, 144),
    "GBS12": (32, 40, 48, 60, 72, 96),
}
FINEST = "JACOBI[SRKN14a]", 576  # whose end counts as exact where none is published
# What the program of the field takes for a day of one binary, seconds, and its error after it: its Lie-group integrator
# of order 2 with its own step of 30 s, on one core of the same kind of machine, compiled with -O2.
GUBAS = {2: (0.39, 6.1e-3), 4: (8.1, 6.1e-3)}
ROUNDS = 5


class Rung(NamedTuple):
    """One method with so many steps a day: milliseconds of a binary and a day, and the largest error after the day."""

    method: str
    degree: int
    steps: int
    milliseconds: float
    error: float


def gravity(degree: int) -> Any:
    return ml.asteroids.MutualGravity(didymos.G, degree=degree)


def end(method: str, degree: int, steps: int) -> ml.CoupledState:
    """The state of the known binary after a day."""
    options: Any = {"dt": didymos.DAY / steps, "steps": steps, "save_every": None}
    path = ml.integrate(method, didymos.BODY, gravity(degree), didymos.start(), **options)
    if not bool(path.ok):
        raise RuntimeError(f"{method} with {steps} steps a day failed.")
    return path.states


def known_end(degree: int) -> dict[str, tuple[float, ...]]:
    """The published end after a day; for degree 4, the end of the finest run."""
    if (didymos.TILTED, degree, didymos.DAY) in didymos.ENDS:
        return didymos.ENDS[didymos.TILTED, degree, didymos.DAY]
    return didymos.as_end(end(FINEST[0], degree, FINEST[1]))


def day(method: str, degree: int, steps: int) -> Compiled:
    """A day of many binaries with different shapes."""
    body, start = didymos.scattered(BINARIES)
    options: Any = {"dt": didymos.DAY / steps, "steps": steps}
    run = compiled(lambda start: ml.ensemble(method, body, gravity(degree), start, **options), start, bodies=BINARIES)
    if not bool(np.all(run().ok)):
        raise RuntimeError(f"{method} with {steps} steps a day failed.")
    return run


def rungs(degree: int) -> list[Rung]:
    """Every method with every step, timed in turns on one core."""
    cases = [(method, steps) for method, ladder in LADDERS.items() for steps in ladder]
    exact = known_end(degree)
    errors = [max(didymos.errors(end(method, degree, steps), exact).values()) for method, steps in cases]
    times = in_turn([day(method, degree, steps) for method, steps in cases], ROUNDS)
    return [
        Rung(method, degree, steps, 1e3 * seconds / BINARIES, error)
        for (method, steps), seconds, error in zip(cases, times, errors, strict=True)
    ]


def fastest(found: list[Rung], error: float) -> Rung:
    """The one that takes least among those within this error."""
    return min((rung for rung in found if rung.error <= error), key=lambda rung: rung.milliseconds)


def cost_rows(found: dict[int, list[Rung]]) -> Iterator[list[str]]:
    """For each degree the fastest run within an error of 1e-10, of each method and the fastest of all last."""
    for degree, all_rungs in found.items():
        seconds, error = GUBAS[degree]
        best = fastest(all_rungs, ERROR)
        for method in dict.fromkeys(rung.method for rung in all_rungs if rung.error <= ERROR):
            rung = fastest([rung for rung in all_rungs if rung.method == method], ERROR)
            mark = "**" if rung == best else ""
            ratio = f"{mark}{1e3 * seconds / rung.milliseconds:.0f}{mark}"
            own = [f"`{method}`", str(rung.steps), f"{rung.milliseconds:.3g}", f"{rung.error:.1g}"]
            yield [str(degree), *own, f"{1e3 * seconds:.0f}", f"{error:.1g}", ratio]


def first_rows() -> Iterator[list[str]]:
    """Seconds of first calls in separate processes; imports are not counted."""
    for degree in DEGREES:
        for method in ("JACOBI[SRKN14a]", "GBS12"):
            cells = list[str]()
            for kind in ("one", "many"):
                cells.append(f"{first_call(__file__, method, str(degree), kind):.1f}")
            yield [str(degree), f"`{method}`", *cells]


def day_of(method: str, degree: str, kind: str) -> Callable[[], Any]:
    run: Any = end if kind == "one" else lambda *case: day(*case)()
    return lambda: run(method, int(degree), 144)


def long_rows() -> Iterator[list[str]]:
    """Ten years of the known binary, degree 2: the largest relative errors of energy and angular momentum."""
    for method, dt in (("JACOBI[EA]", 300.0), ("JACOBI[SRKN6b]", 600.0), ("JACOBI[SRKN14a]", 600.0), ("GBS12", 900.0)):
        steps = round(YEARS * 365.25 * didymos.DAY / dt / STATES) * STATES
        options: Any = {"dt": dt, "steps": steps, "save_every": steps // STATES}
        began = time.process_time()
        path = jax.block_until_ready(ml.integrate(method, didymos.BODY, gravity(2), didymos.start(), **options))
        seconds = time.process_time() - began
        energy = np.asarray(ml.observe.energy(didymos.BODY, gravity(2), path))
        spin = np.asarray(ml.observe.spatial_momentum(path.states))
        halves = [f"{np.abs(half / energy[0] - 1).max():.1e}" for half in np.split(energy[1:], 2)]
        lost = np.abs(spin - spin[0]).max() / np.linalg.norm(spin[0])
        yield [f"`{method}`", f"{dt:g}", *halves, f"{lost:.0e}", f"{seconds:.1f}"]


COLOURS = (BLUE, ORANGE, GREEN, VERMILLION)


def draw(found: dict[int, list[Rung]], out: Path) -> None:
    """Error of a day against its run time: a panel for each degree of the gravity, a line for each method."""
    panels = []
    for degree, all_rungs in found.items():
        lines = []
        for colour, method in zip(COLOURS, dict.fromkeys(rung.method for rung in all_rungs), strict=False):
            own = sorted((rung for rung in all_rungs if rung.method == method), key=lambda rung: rung.milliseconds)
            x, y = [rung.milliseconds for rung in own], [rung.error for rung in own]
            lines.append(Line(method, x, y, colour, "o-", options={"markersize": 4}))
        seconds, error = GUBAS[degree]
        lines.append(Line("GUBAS", [1e3 * seconds], [error], "0.35", "s"))
        faster = 1e3 * seconds / fastest(all_rungs, error).milliseconds
        title = f"gravity of degree {degree}: {float(f'{faster:.1g}'):,.0f} times faster than GUBAS"
        up, scales = "largest relative error after a simulated day", {"xscale": "log", "yscale": "log"}
        across = "run time per simulated day and binary, one core [ms]"
        panels.append(Panel(title, across, up, lines, scales))
    chart(out, [panels], (13, 4.8), left=0.08, right=0.98, bottom=0.12, top=0.92, wspace=0.25)


COST = Table(
    *("reports/applications.md", "binaries cost"),
    (
        *("degree", "method", "steps per day", "ms per day and binary", "error"),
        *("GUBAS, ms", "error of GUBAS", "times faster"),
    ),
)
LONG = ("method", "step, s", "energy, first five years", "last five years", "angular momentum", "seconds")


def cost(options: Any) -> None:
    found = {degree: rungs(degree) for degree in DEGREES}
    COST.show(options.write, cost_rows(found))
    if options.write:
        draw(found, REPORTS / PICTURE)


def first(options: Any) -> None:
    lines = shown(("degree", "method", "one binary, s", "1000 binaries, s"), first_rows())
    if options.write:
        save("binaries-first-calls", lines)


PARTS = {"cost": cost, "long": Table("reports/applications.md", "binaries long", LONG, long_rows), "first": first}

if __name__ == "__main__":
    main(__doc__, PARTS, first=day_of)
