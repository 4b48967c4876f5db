"""216 waters in a box, and 1,728: how their energy fluctuates, their temperatures, and the time of a step."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart, put

import midlie_jax as ml
from midlie_jax.advice.timing import timed_in_turn

from . import water
from .lammps_runs import Waters

# ---- the energy of 216 waters for 2 ps at equal numbers of forces ----

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


BOX = Table("reports/heat.md", "box", ("method", "step at one force per fs, fs", "2 forces per fs", "1", "1/2", "1/4"))


def energies(options: Any) -> None:
    results = list(measured())
    lines = BOX.show(False, (row(*result) for result in results))
    said = f"After 0.1 ps, no site is farther than {places_apart():.1e} nm from its position in LAMMPS."
    print(said)
    if options.write:
        put(BOX.page, BOX.mark, [*lines, "", said])
        draw(results, REPORTS / "waters.png")


# ---- whether the temperatures of rotation and translation are equal, as in equilibrium ----
#
# A symplectic method of step h follows a system whose energy differs by terms of order h^p, and the mean kinetic
# energies are those of that system. At order 2 rotation, whose frequencies are higher, seems colder than travel.

CASES = [(scheme, per_force) for per_force in (1.0, 2.0) for scheme in ("EA", "CHIN4A", "SRKN6b")] + [("EA", 4.0)]
TURN, FORGOTTEN = 4.0, 4.0  # ps of a run at a time, and at its begin
BLOCKS = 20
FIELDS = ("momentum", "attitude", "linear", "position")


def extend(kept: Path, minutes: float) -> None:
    """Continues all runs in turn, each from its state in the file, until the minutes are over."""
    ends, found = time.monotonic() + 60 * minutes, _read(kept)
    while True:
        for case in CASES:
            if time.monotonic() > ends:
                return
            state, samples = found.get(case) or (water.box()[0], np.zeros((0, 2)))
            state, more = _continued(*case, state)
            found[case] = state, np.concatenate([samples, more])
        _write(kept, found)


def _continued(scheme: str, per_force: float, start: ml.CoupledState) -> tuple[Any, np.ndarray]:
    """The state after a turn, and the temperatures of travel and rotation on the way."""
    name, edge = f"JACOBI[{scheme}]", water.EDGE
    dt, every = 1e-3 * per_force * water.forces_per_step(name), SCHEMES[scheme]
    steps = every * round(TURN / (dt * every))
    path = water.motion(name, start, edge, dt, steps, every=every, skin=edge, single=True)
    if not path.ok:
        raise RuntimeError(f"{name} at a step of {dt:g} ps: {path.result}")
    later = jax.tree.map(lambda x: x[1:], path.states)
    return jax.tree.map(lambda x: x[-1], path.states), np.stack(water.temperatures(later), axis=-1)


def _name(scheme: str, per_force: float) -> str:
    return f"{scheme} {per_force:g}"


def _read(kept: Path) -> dict[tuple[str, float], tuple[Any, np.ndarray]]:
    if not kept.exists():
        return {}
    with np.load(kept) as data:
        known = [case for case in CASES if f"{_name(*case)} samples" in data]
        return {
            case: (
                ml.CoupledState(*(jnp.asarray(data[f"{_name(*case)} {field}"]) for field in FIELDS)),
                data[f"{_name(*case)} samples"],
            )
            for case in known
        }


def _write(kept: Path, found: dict[tuple[str, float], tuple[Any, np.ndarray]]) -> None:
    arrays = dict[str, np.ndarray]()
    for case, (state, samples) in found.items():
        arrays |= {f"{_name(*case)} {field}": np.asarray(getattr(state, field)) for field in FIELDS}
        arrays[f"{_name(*case)} samples"] = samples
    beside = kept.with_suffix(".part.npz")
    np.savez(beside, **arrays)  # pyright: ignore[reportArgumentType]
    beside.replace(kept)


def equipartition_rows(kept: Path) -> Iterator[list[str]]:
    """Means with the errors of means of blocks."""
    found = _read(kept)
    for case in CASES:
        if case not in found:
            continue
        scheme, per_force = case
        step = per_force * water.forces_per_step(f"JACOBI[{scheme}]")
        every = 1e-3 * step * SCHEMES[scheme]
        samples = found[case][1][round(FORGOTTEN / every) :]
        if len(samples) < 2 * BLOCKS:
            continue
        travel, turn = samples.T
        mean, error = with_error(turn - travel)
        length = f"{len(samples) * every:.0f}"
        whole = f"{np.mean(samples):.1f}"
        yield [f"`JACOBI[{scheme}]`", f"{per_force:g}", f"{step:g}", length, f"{mean:.2f} ± {error:.2f}", whole]


def with_error(samples: np.ndarray) -> tuple[float, float]:
    """The mean, and its standard error from that of the means of blocks."""
    means = [np.mean(block) for block in np.array_split(samples, BLOCKS)]
    return float(np.mean(samples)), float(np.std(means, ddof=1) / np.sqrt(BLOCKS))


EQUIPARTITION = Table(
    *("reports/heat.md", "equipartition"),
    ("method", "time per force, fs", "step, fs", "run, ps", "T_rot - T_tr, K", "T, K"),
    data="waters-equipartition",
    key=lambda row: "6b" not in row[0],
    columns=(0, 2, 4),
)


def equipartition(options: Any) -> None:
    extend(options.kept, options.minutes)
    EQUIPARTITION.show(options.write, equipartition_rows(options.kept))


# ---- the time of a step, here and in LAMMPS, which take turns on one core ----

# Copies of the box along an edge: skin of the list in nm (None: all are neighbours), steps. LAMMPS' skin of 2 A is the
# fastest of 1, 1.5, 2 and 2.5.
SIZES: dict[int, tuple[float | None, int]] = {1: (None, 120), 2: (0.24, 48)}
ROUNDS, LAMMPS_SKIN = 9, 2.0


def speed_rows() -> Iterator[list[str]]:
    for copies, (skin, total) in SIZES.items():
        start, edge = water.box(copies)
        with Waters(start, 1.0, edge, skin=LAMMPS_SKIN) as other:
            other.run(total, prepare=True)
            runs = [_timed(start, edge, skin or edge, total, single) for single in (False, True)]
            timings = timed_in_turn([lambda: other.run(total), *runs], least=ROUNDS, most=ROUNDS)  # noqa: B023
        names = ("LAMMPS `rigid/nve/small`", "`JACOBI[EA]`", "`JACOBI[EA]`, pairs in float32")
        for name, (_, timing) in zip(names, timings, strict=True):
            ratio = timing.seconds / timings[0][1].seconds
            time = f"{1e3 * timing.seconds / total:.3g}"
            yield [f"{start.count:,}", name, time, f"±{timing.spread:.0%}", f"{ratio:.2f}"]


def _timed(start: Any, edge: float, skin: float, total: int, single: bool) -> Callable[[], Any]:
    """Some lists with their steps, the lists included; compiled."""

    def run() -> Any:
        return jax.block_until_ready(
            water.motion("JACOBI[EA]", start, edge, 1e-3, total, every=total, skin=skin, single=single)
        )

    run()
    return run


SPEED = Table(
    *(
        "reports/heat.md",
        "speed",
        ("molecules", "program", "time per step, ms", "spread", "relative to LAMMPS"),
        speed_rows,
    ),
    data="waters-speed",
    columns=(0, 1, 2, 4),
)
