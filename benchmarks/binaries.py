"""Binary asteroids: what a day costs at an error, and ten years of energy and momenta: docs/reports/applications.md.

    python benchmarks/binaries.py [--write]

Processor times on one core, medians of rounds in which all methods take turns; 1000 binaries of different shapes
through `ml.ensemble`. First calls are measured in processes of their own. `--write` puts tables and picture into docs/.
"""

import argparse
import time
from collections.abc import Iterator
from typing import Any

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402
import numpy as np  # noqa: E402

jax.config.update("jax_enable_x64", True)

import first_call  # noqa: E402
from laboratory.binaries import chart, didymos  # noqa: E402
from laboratory.binaries.cost import GUBAS, Rung, day, end, fastest, gravity, rungs  # noqa: E402
from pages import DOCS, put, save, shown  # noqa: E402

import midlie_jax as ml  # noqa: E402

MARKERS = {
    "cost": ("<!-- binaries cost -->", "<!-- /binaries cost -->"),
    "long": ("<!-- binaries long -->", "<!-- /binaries long -->"),
}
PAGE, PICTURE = "reports/applications.md", "binaries.png"
DEGREES, ERROR = (2, 4), 1e-10
HEADS = (
    "degree",
    "method",
    "steps per day",
    "ms per day and binary",
    "error",
    "GUBAS, ms",
    "error of GUBAS",
    "times faster",
)
FIRST_HEADS = ("degree", "method", "one binary, s", "1000 binaries, s")
LONG_HEADS = ("method", "step, s", "energy, first five years", "last five years", "angular momentum", "seconds")
YEARS, STATES = 10, 1000


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
    """Seconds of first calls in processes of their own; imports are not counted."""
    for degree in DEGREES:
        for method in ("JACOBI[SRKN14a]", "GBS12"):
            cells = list[str]()
            for kind in ("one", "many"):
                cells.append(f"{first_call.seconds(__file__, method, str(degree), kind):.1f}")
            yield [str(degree), f"`{method}`", *cells]


def print_first_call(method: str, degree: str, kind: str) -> None:
    run: Any = end if kind == "one" else lambda *case: day(*case)()
    first_call.report(lambda: run(method, int(degree), 144))


def long_rows() -> Iterator[list[str]]:
    """Ten years of the known binary, degree 2: the largest relative errors of energy and angular momentum."""
    for method, dt in (("JACOBI[EA]", 300.0), ("JACOBI[SRKN6b]", 600.0), ("JACOBI[SRKN14a]", 600.0), ("GBS12", 900.0)):
        steps = round(YEARS * 365.25 * didymos.DAY / dt / STATES) * STATES
        options: Any = {"dt": dt, "steps": steps, "save_every": steps // STATES}
        began = time.process_time()
        path = jax.block_until_ready(ml.integrate(method, didymos.BODY, gravity(2), didymos.start(), **options))
        seconds = time.process_time() - began
        energy = np.asarray(ml.energy(didymos.BODY, gravity(2), path))
        spin = np.asarray(ml.spatial_momentum(path.states))
        halves = [f"{np.abs(half / energy[0] - 1).max():.1e}" for half in np.split(energy[1:], 2)]
        lost = np.abs(spin - spin[0]).max() / np.linalg.norm(spin[0])
        yield [f"`{method}`", f"{dt:g}", *halves, f"{lost:.0e}", f"{seconds:.1f}"]


def write(name: str, lines: list[str]) -> None:
    """Puts a table into the page; first calls only into a data file."""
    if name == "first":
        save("binaries-first-calls", lines)
    else:
        put(PAGE, *MARKERS[name], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"put tables and picture into docs/{PAGE}")
    parser.add_argument("--first", nargs=3, metavar="PART", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.first:
        print_first_call(*options.first)
        return
    found = {degree: rungs(degree) for degree in DEGREES}
    parts = {
        "cost": shown(HEADS, cost_rows(found)),
        "long": shown(LONG_HEADS, long_rows()),
        "first": shown(FIRST_HEADS, first_rows()),
    }
    if options.write:
        chart.draw(found, DOCS / "reports" / PICTURE)
        for name, lines in parts.items():
            write(name, lines)


if __name__ == "__main__":
    main()
