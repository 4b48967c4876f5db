"""216 waters for 2 ps: how much their energy wavers, at equal numbers of forces."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart, put

import midlie_jax as ml

from . import water
from .lammps_runs import Waters

PER_FORCE = (0.5, 1.0, 2.0, 4.0)  # fs
SCHEMES = {"EA": 20, "CHIN4A": 6, "SRKN6b": 3, "SRKN14a": 2}  # steps between two samples
LENGTH = 2.0  # ps
LAMMPS = "LAMMPS `rigid/nve/small`"


def own(scheme: str, per_force: float) -> float:
    """The standard deviation of the energy, kJ/mol; NaN if the run fails."""
    name, (start, edge) = f"JACOBI[{scheme}]", water.box()
    dt, every = 1e-3 * per_force * water.forces_per_step(name), SCHEMES[scheme]
    options: Any = {"dt": dt, "steps": every * round(LENGTH / (dt * every)), "save_every": every, "skin": edge}
    body = water.molecules(start.count)
    path = ml.molecules.integrate(name, body, water.forces(edge), start, **options, observe=ml.observe.energy)
    return float(np.std(path.states[1:])) if path.ok else np.nan


def lammps(step: float) -> float:
    start, edge = water.box()
    with Waters(start, step, edge) as run:
        found, every = list[float](), round(20 / step)
        run.run(0, prepare=True)
        for _ in range(round(1000 * LENGTH / step) // every):
            run.run(every)
            found.append(run.energy())
    return float(np.std(found))


def measured() -> Iterator[tuple[str, float, list[float]]]:
    """Name, forces a step, and for each of `PER_FORCE` the standard deviation of the energy."""
    yield LAMMPS, 1, [lammps(step) for step in PER_FORCE]
    for scheme in SCHEMES:
        yield f"`JACOBI[{scheme}]`", water.forces_per_step(f"JACOBI[{scheme}]"), [own(scheme, x) for x in PER_FORCE]


def row(name: str, forces: float, found: list[float]) -> list[str]:
    return [name, f"{forces:g}", *("fails" if not x < 1e3 else f"{x:.2g}" for x in found)]


def draw(results: list[tuple[str, float, list[float]]], path: Path) -> None:
    """The table as a chart."""
    lines = list[Line]()
    for colour, (name, _, found) in zip(("#555555", "#0072B2", "#009E73", "#D55E00", "#CC79A7"), results, strict=True):
        x, y = zip(*((x, y) for x, y in zip(PER_FORCE, found, strict=True) if y < 1e3), strict=True)
        lines.append(Line(name.replace("`", ""), x, y, colour, "o-", True, {"linewidth": 2}))

    def ticks(axes: Any) -> None:
        axes.set_xticks(PER_FORCE, [f"{x:g}" for x in PER_FORCE])
        axes.set_xticks([], minor=True)

    scales = {"xscale": "log", "yscale": "log"}
    words = "simulated time per force evaluation [fs]", "standard deviation of the energy [kJ/mol]"
    one = Panel("", *words, lines, scales, ticks)
    title = "Higher orders have a steadier energy up to 1 fs per force"
    note = "216 water molecules, 2 ps from one initial state."
    chart(path, [[one]], (9.0, 5.6), title, note, left=0.11, bottom=0.13, right=0.97)


def places_apart(length: float = 0.1) -> float:
    """The largest distance of a site in LAMMPS, in steps of .1 fs, from that under SRKN6b, in steps of 1 fs, in nm."""
    start, edge = water.box()
    steps = round(1e3 * length)
    path = water.motion("JACOBI[SRKN6b]", start, edge, 1e-3, steps, every=steps, skin=edge, single=False)
    state = jax.tree.map(lambda x: x[-1], path.states)
    with Waters(start, 0.1, edge) as run:
        run.run(round(1e4 * length), prepare=True)
        difference = run.places() - np.asarray(ml.molecules.sites(state, water.POINTS))
    return float(np.max(np.linalg.norm(difference, axis=-1)))


TABLE = Table(
    "reports/heat.md", "box", ("method", "step at one force per fs, fs", "2 forces per fs", "1", "1/2", "1/4")
)


def measure(options: Any) -> None:
    results = list(measured())
    lines = TABLE.show(False, (row(*result) for result in results))
    said = f"After 0.1 ps, no site is farther than {places_apart():.1e} nm from its position in LAMMPS."
    print(said)
    if options.write:
        put(TABLE.page, TABLE.mark, [*lines, "", said])
        draw(results, REPORTS / "waters.png")
