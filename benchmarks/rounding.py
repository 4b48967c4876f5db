"""Rounding errors and the energy over many steps, for docs/reports/rounding.md.

    python benchmarks/rounding.py free [--write]      what free flights conserve, over 1e6 steps
    python benchmarks/rounding.py growth [--write]    how errors grow, over up to 1e8 steps; rounding-growth.png
    python benchmarks/rounding.py cost [--write]      what a step costs with each state and dtype that `growth` compares
    python benchmarks/rounding.py long [--write]      the energy over 1e7 steps: which methods drift; docs/long-run.png

`--steps` takes another number of steps. Times are nanoseconds of processor time for a step of one body, on one core:
medians of runs that take turns.

Of free flights, each figure is the root mean square over 16 bodies of the relative change of the spatial momentum R Pi,
the length of Pi or, if the flight is exact, the energy, in units of eps times the square root of the number of steps,
for the worst of six angles per step, 1e-5 to 1 radian. If it is the same for any number of steps, rounding errors grow
as a random walk.

Of long runs, for P1 and an asymmetric top at a coarse step: the largest error of the energy, and how much its mean over
the last tenth of the run differs from that over the first, both relative to the energy at the start. A symplectic
method's energy stays within a band that does not move.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import DOCS, REPORTS, Line, Panel, Table, chart, in_turn, main
from laboratory.free_body import free_body
from laboratory.runner import TURNS, Rows, Runner, free_bodies, spatial_momentum

import midlie_jax as ml
from midlie_jax.advice.program import Program
from midlie_jax.cli import scenes
from midlie_jax.integrators.flights import FLIGHTS

BODIES, SHOWN = 16, ("JACOBI", "SYMMETRIC", "SLIEMID4", "DLM", "LIEMID")  # SHOWN: flights on the page
STATES = {"float64": ml.RigidState, "float32": ml.CompensatedState}
QUANTITIES = ("R Pi", "length of Pi", "energy")


def constants(flight, dtype, steps):
    """The figure for each of QUANTITIES; None for the energy of a flight that does not conserve it."""
    inputs = free_bodies(flight.equal_moments, dtype, count=BODIES, seed=2)

    def run(moments, momentum, attitude, dt):
        start = STATES[dtype](momentum, attitude)
        method, body = ml.method(flight, "E1"), ml.RigidBody(moments)
        return ml.integrate(method, body, None, start, dt=dt, steps=steps, save_every=steps)

    path = jax.jit(jax.vmap(run))(*inputs)
    if not path.ok.all():
        raise RuntimeError(f"{flight.name} failed: a solve did not succeed, or a number is not finite.")
    moments, momentum, attitude, *low = (
        np.asarray(x, np.longdouble) for x in (inputs[0], *jax.tree.leaves(path.states))
    )
    if low:
        momentum, attitude = momentum + low[0], attitude + low[1]
    space, square = spatial_momentum(attitude, momentum), np.sum(momentum**2, axis=-1)
    energy = np.sum(momentum**2 / moments[:, None], axis=-1)
    changes = (
        np.linalg.norm(space[:, 1] - space[:, 0], axis=-1) / np.sqrt(square[:, 0]),
        np.sqrt(square[:, 1] / square[:, 0]) - 1,
        energy[:, 1] / energy[:, 0] - 1 if flight.order is None else None,
    )
    unit = np.finfo(dtype).eps * steps**0.5
    return [None if c is None else float(worst(c / unit)) for c in changes]


def worst(change):
    return np.sqrt(np.mean(change.reshape(len(TURNS), BODIES) ** 2, axis=1)).max()


def free_rows(steps):
    for flight in (flight for flight in FLIGHTS.values() if flight.body is ml.RigidBody):
        figures = [c for dtype in ("float64", "float32") for c in constants(flight, dtype, steps)]
        yield [f"`{flight.name}`", *("" if c is None else f"{c:.2f}" for c in figures)]


FREE = Table(
    *("reports/rounding.md", "rounding"),
    ("flight", *(f"{quantity}, {dtype}" for dtype in ("float64", "float32") for quantity in QUANTITIES)),
    data="rounding",
    key=lambda row: row[0].strip("`") in SHOWN,
)

# ---- the energy over long runs ----

KEPT, PARTS = 20_000, 40
METHODS = {
    "P1": ("LIEMID[EA]", "SLIEMID[EA]", "DLM[EA]", "SYMMETRIC[EA]", "SYMMETRIC[CHIN4A]"),
    "asymmetric-top": ("LIEMID[EA]", "SLIEMID[EA]", "DLM[EA]", "JACOBI[EA]", "JACOBI[CHIN4A]"),
}
MOVED = "asymmetric-top"  # where the energy of LIEMID[EA] shifts
STEP = {"P1": 0.02, "asymmetric-top": 0.05}


def energies(name, scene, dt, steps):
    """Times, relative energy errors at these times, and whether every solve succeeded."""
    every = steps // KEPT

    @jax.jit
    def run(start):
        path = ml.integrate(name, scene.body, scene.torque, start, dt=dt, steps=steps, save_every=every)
        return path.times, jax.vmap(lambda s: ml.observe.energy(scene.body, scene.torque, s))(path.states), path.ok

    times, energy, ok = run(scene.start)
    energy = np.asarray(energy)
    return np.asarray(times), (energy - energy[0]) / abs(energy[0]), bool(ok)


def long_runs(steps):
    for scene_name, names in METHODS.items():
        scene = scenes.scene(scene_name)
        for name in names:
            times, error, ok = energies(name, scene, STEP[scene_name], steps)
            tenth = len(error) // 10
            trend = abs(error[-tenth:].mean() - error[:tenth].mean())
            yield scene_name, name, times, error, trend, ok


def shifts(times, error):
    """Middles of the parts after the first, and the largest shift so far of their mean error from the first part's."""
    middles, means = (np.array([part.mean() for part in np.array_split(x, PARTS)]) for x in (times, error))
    return middles[1:], np.maximum.accumulate(np.maximum(np.abs(means - means[0])[1:], 1e-16))


def draw_long(results, path):
    """Draws the largest difference so far of the mean energy error of a part of the run from the first part's."""
    colours = ("#D55E00", "#0072B2", "#009E73", "#56B4E9", "#CC79A7")

    def line(colour, name, times, error):
        return Line(name, *shifts(times, error), colour, bold=True, options={"linewidth": 2})

    panels = []
    for scene in METHODS:
        runs = [result[1:4] for result in results if result[0] == scene]
        lines = [line(colour, *one) for colour, one in zip(colours, runs, strict=True)]
        title, up = f"{scene}, step {STEP[scene]:g}", "shift of the mean energy error [initial energy]"
        options = {"yscale": "log", "xlim": (0, runs[0][1][-1])}
        panels.append(Panel(title, "time [unit of time]", up, lines, options, lambda axes: axes.ticklabel_format(
            axis="x", style="sci", scilimits=(5, 5))))  # fmt: skip
    peaks = {name: shifts(times, error)[1].max() for scene, name, times, error, *_ in results if scene == MOVED}
    ratio = peaks.pop("LIEMID[EA]") / max(peaks.values())
    title = f"On the asymmetric top, the energy of LIEMID[EA] shifts {ratio:.0f} times more than with other methods"
    note = f"Means of the energy error over {PARTS} parts of the run; the largest difference so far."
    chart(path, [panels], (13.0, 5.6), title, note, bottom=0.11, wspace=0.2)


def long_row(scene_name, name, _, error, trend, ok):
    note = "" if ok else " (a solve failed)"
    return [f"{scene_name}, step {STEP[scene_name]:g}", f"`{name}`", f"{np.abs(error).max():.1e}{note}", f"{trend:.1e}"]


def long(options):
    steps, results = int(options.steps or 1e7), []
    table = Table(
        *("reports/rounding.md", "long run"),
        (f"scene, {steps:.0e} steps", "method", "largest energy error", "shift of its mean"),
        data="long-run",
        key=lambda row: "CHIN4A" not in row[1] and "DLM" not in row[1],
    )
    table.show(options.write, (results.append(result) or long_row(*result) for result in long_runs(steps)))
    if options.write:
        draw_long(results, DOCS / "long-run.png")


# ---- how errors grow over up to 1e8 steps: free bodies and the fast top P1 ----
#
# Each run is an ensemble of 16 bodies. A free body is moved by the exact flight JACOBI, at .2 and at 2e-5 radians a
# step. P1 is moved by SYMMETRIC[CHIN4A] with steps of .005 (.25 radians), whose own error of the energy, 6e-15, is
# below rounding. Every run starts from numbers that float32 represents, so that the exact motion is the same in all
# precisions. Exact sums of rounding errors that fall either way grow as the square root of the number of steps
# (Brouwer's law); then the attitude, which sums the errors of the energy, grows with the power 3/2. The whole takes 20
# minutes on one core.

PER_DECADE = 4
LARGEST = 0.1  # an error beyond which an attitude is lost, and no longer grows as a power
DECADES = 3.0  # of steps before the last over which an exponent is fitted


class Mode(NamedTuple):
    name: str
    dtype: str
    state: type[ml.RigidState] = ml.RigidState


MODES = (
    Mode("float64", "float64"),
    Mode("float32", "float32"),
    Mode("float32, compensated", "float32", ml.CompensatedState),
)


class Case(NamedTuple):
    """An ensemble: the method, the rows in float64, all of them numbers of float32, and its share of the steps."""

    name: str
    method: str
    rows: Rows
    share: float = 1.0


def exact_rows(body: Any, torque: Any, momentum: Any, attitude: Any, dt: Any) -> Rows:
    def single(x: Any) -> Any:
        return jnp.asarray(np.asarray(x, np.float32), jnp.float64)

    start = ml.RigidState(single(momentum), single(attitude))
    return Rows(ml.RigidBody(single(body)), jax.tree.map(single, torque), start, single(dt))


def cases() -> list[Case]:
    moments, momentum, attitude, _ = (x[:BODIES] for x in free_bodies(False, "float32", count=BODIES, seed=2))
    top, one = scenes.scene("P1"), np.ones(BODIES)
    tops = scenes.perturbed(top, BODIES, 1e-3)
    weights = ml.torques.HeavyTop(20 * one)
    turning = {turn: exact_rows(moments, None, momentum, attitude, turn / 0.67 * one) for turn in (0.2, 2e-5)}
    p1 = exact_rows(np.tile(top.body.moments, (BODIES, 1)), weights, tops.momentum, tops.attitude, 0.005 * one)
    free = [Case(f"free body, {turn:g} rad per step", "JACOBI[EA]", rows) for turn, rows in turning.items()]
    return [free[0], free[1]._replace(share=0.1), Case("P1, 0.25 rad per step", "SYMMETRIC[CHIN4A]", p1)]


def rows_of(case: Case, mode: Mode) -> Rows:
    """The rows of a case in the dtype of the mode and with its class of state."""
    rows = jax.tree.map(lambda x: x.astype(mode.dtype), case.rows)
    # A quaternion in float32 has unit length to the rounding of float32 only.
    size = jnp.sqrt(jnp.sum(rows.start.attitude**2, axis=1, keepdims=True))
    return rows._replace(start=mode.state(rows.start.momentum, rows.start.attitude / size))


def run(case: Case, mode: Mode, counts: list[int]) -> ml.RigidState:
    """The states at the start and after these counts of steps, (1 + counts, bodies, ...), in float64."""
    rows = rows_of(case, mode)
    runner, found, before = Runner(ml.method(case.method), rows.body), [rows.start], 0
    for count in counts:
        end, ok = runner.run(rows._replace(start=found[-1]), count - before, before)
        if not ok.all():
            raise RuntimeError(f"{case.name}: a step failed before step {count}.")
        found.append(end)
        before = count
    return jax.tree.map(lambda *x: np.stack(x), *map(in_float64, found))


def in_float64(state: ml.RigidState) -> ml.RigidState:
    """The momenta and attitudes of states, with their low parts if there are any."""
    momentum, attitude = np.asarray(state.momentum, float), np.asarray(state.attitude, float)
    if isinstance(state, ml.CompensatedState):
        momentum, attitude = momentum + np.asarray(state.low_momentum), attitude + np.asarray(state.low_attitude)
    return ml.RigidState(momentum, attitude)


def angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The angle of the rotation from one attitude to the other, in radians."""
    w, u = one[..., :1], one[..., 1:]
    x, v = other[..., :1], other[..., 1:]
    vector = np.linalg.norm(w * v - x * u - np.cross(u, v), axis=-1)
    return 2 * np.arctan2(vector, np.abs(np.sum(one * other, axis=-1)))


def errors(case: Case, states: ml.RigidState, truth: np.ndarray | None) -> dict[str, np.ndarray]:
    """The errors at the counts of steps, (counts, bodies); those of constants are signed and relative."""
    rows = case.rows
    momentum = np.asarray(states.momentum, np.longdouble)
    attitude = np.asarray(states.attitude, np.longdouble)
    attitude /= np.linalg.norm(attitude, axis=-1, keepdims=True)
    energy = rows.energy(momentum, attitude)
    space = spatial_momentum(attitude, momentum)
    if rows.torque is not None:
        space = space[..., 2:]
    size = np.linalg.norm(momentum[0], axis=-1)
    change = space - space[0]
    found = {
        "momentum": change[..., 0] / size if change.shape[-1] == 1 else np.linalg.norm(change, axis=-1) / size,
        "energy": energy / energy[0] - 1,
    }
    if truth is not None:
        found["attitude"] = angle(truth, np.asarray(attitude, float))
    return {name: np.asarray(error[1:], float) for name, error in found.items()}


def exact_attitudes(case: Case, counts: list[int]) -> np.ndarray:
    """The attitudes of free bodies in closed form, (1 + counts, bodies, 4)."""
    rows = jax.tree.map(np.asarray, case.rows)
    bodies = zip(rows.body.moments, rows.start.momentum, rows.start.attitude, rows.dt, strict=True)
    return np.stack([free_body(i, p, q, dt * np.array([0, *counts]))[1] for i, p, q, dt in bodies], axis=1)


def rms(error: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(error**2, axis=1))


def exponent(counts: np.ndarray, error: np.ndarray) -> float:
    """The slope of log error over log steps, over the last `DECADES` before the error is lost; NaN without errors."""
    good = (error > 0) & (error < LARGEST)
    if not good.any():
        return np.nan
    good &= counts >= counts[good].max() / 10**DECADES
    return float(np.polyfit(np.log(counts[good]), np.log(error[good]), 1)[0]) if good.sum() > 2 else np.nan


class Growth(NamedTuple):
    """The growth of one error: rms over the bodies at each count, its exponent, and its mean in standard errors."""

    case: str
    mode: Mode
    quantity: str
    counts: np.ndarray
    error: np.ndarray
    exponent: float
    lean: float


def measured(steps: int) -> Iterator[Growth]:
    for case in cases():
        most = round(case.share * steps)
        samples = round(PER_DECADE * np.log10(most / 10))
        counts = np.unique(np.round(np.geomspace(10, most, samples + 1)).astype(int))
        truth: Any = exact_attitudes(case, list(counts)) if case.rows.torque is None else None
        for mode in MODES:
            states = run(case, mode, list(counts))
            found = errors(case, states, truth)
            if case.rows.torque is not None and mode.dtype == "float64":
                truth = states.attitude  # of the same method: in float64 its own error hides that of rounding
            for quantity, error in found.items():
                last = error[-1]
                signed = np.any(error < 0)
                lean = last.mean() / (last.std(ddof=1) / BODIES**0.5) if signed and last.std() > 0 else np.nan
                yield Growth(case.name, mode, quantity, counts, rms(error), exponent(counts, rms(error)), float(lean))


UNITS = {
    "momentum": "error of the spatial momentum [initial |Π|]",
    "energy": "error of the energy [initial E]",
    "attitude": "error of the attitude [rad]",
}
COLOURS = {"float64": "#0072B2", "float32": "#D55E00", "float32, compensated": "#CC79A7"}


def draw(results: list[Growth], path: Path) -> None:
    names = list(dict.fromkeys(growth.case for growth in results))

    def of(name: str, quantity: str) -> Panel:
        lines = list[Line]()
        for growth in results:
            if (growth.case, growth.quantity) == (name, quantity) and np.any(growth.error > 0):
                seen = growth.error > 0
                label = f"{growth.mode.name.removeprefix('float32, ')} ({growth.exponent:.2f})"
                x, y = growth.counts[seen], growth.error[seen]
                lines.append(Line(label, x, y, COLOURS[growth.mode.name], bold=True, options={"linewidth": 2}))
        counts = next(growth.counts for growth in results if growth.case == name)

        def powers(axes: Any) -> None:
            low, high = axes.get_ylim()
            for power in (0.5, 1.0) if quantity != "attitude" else (1.5,):
                for first in (1e-16, 6e-8):
                    axes.plot(counts, first * (counts / 10) ** power, ":", color="#8a8a8a", linewidth=1, zorder=1)
            axes.set(xlim=(counts[0], counts[-1]), ylim=(low, min(high, 10)))
            axes.set_xticks(10.0 ** np.arange(2, np.log10(counts[-1]) + 0.5, 2))

        up, scales = UNITS[quantity] if name == names[0] else "", {"xscale": "log", "yscale": "log"}
        return Panel(name, "number of steps", up, lines, scales, powers)

    title = "Rounding errors in float64 grow about as the square root of the number of steps"
    note = "Brackets: fitted exponents. Dotted: powers 1/2 (random walk) and 1 (bias); for the attitude 3/2."
    panels = [[of(name, quantity) for name in names] for quantity in UNITS]
    room = {"bottom": 0.06, "wspace": 0.24, "hspace": 0.36}
    chart(path, panels, (16.0, 12.5), title, note, **room)


def table_rows(results: list[Growth]) -> Iterator[list[str]]:
    for case, quantity in dict.fromkeys((growth.case, growth.quantity) for growth in results):
        cells = []
        for mode in MODES:
            found = [g for g in results if (g.case, g.quantity, g.mode) == (case, quantity, mode)]
            if not found or not np.any(found[0].error > 0):
                cells.append("exact" if found else "")
                continue
            lean = "" if np.isnan(found[0].lean) else f", mean {found[0].lean:+.1f}"
            cells.append(f"{found[0].exponent:.2f}: {found[0].error[-1]:.1e}{lean}")
        yield [case, quantity, *cells]


GROWTH = Table("reports/rounding.md", "growth", ("run", "quantity", *(mode.name for mode in MODES)))


def growth(options: Any) -> None:
    results: list[Growth] = []
    for growth in measured(int(options.steps or 1e8)):
        results.append(growth)
        numbers = f"{growth.error[-1]:.2e}", f"{growth.exponent:.2f}", f"{growth.lean:+.1f}"
        print(growth.case, growth.mode.name, growth.quantity, *numbers, flush=True)
    GROWTH.show(options.write, table_rows(results))
    if options.write:
        draw(results, REPORTS / "rounding-growth.png")


# ---- what a step costs with each state and dtype ----

COPIES, CHUNK, COST_STEPS, COST_ROUNDS = 64, 256, 2000, 15


def _compiled(case: Case, mode: Mode) -> Callable[[], Any]:
    """A run of many copies of the first body of a case, from the starts of all."""
    rows = rows_of(case, mode)
    body, torque, dt = jax.tree.map(lambda x: x[0], (rows.body, rows.torque, rows.dt))
    starts = jax.tree.map(lambda x: jnp.concatenate([x] * COPIES), rows.start)
    program = Program(ml.method(case.method), body, torque, starts, chunk=CHUNK)
    _, ok = program.run(float(dt), COST_STEPS)
    if not ok.all():
        raise RuntimeError(f"{case.name}, {mode.name}: a step failed.")
    return lambda: program.run(float(dt), COST_STEPS)


def cost_rows() -> Iterator[list[str]]:
    free, _, top = cases()
    for case in (free, top._replace(method="SYMMETRIC[EA]"), top):
        times = in_turn([_compiled(case, mode) for mode in MODES], COST_ROUNDS)
        yield [f"`{case.method}`", *(f"{1e9 * seconds / (COPIES * BODIES * COST_STEPS):.1f}" for seconds in times)]


COST = Table("reports/rounding.md", "cost", ("method", *(mode.name for mode in MODES)), cost_rows)


MEASURED = {
    "free": lambda options: FREE.show(options.write, free_rows(int(options.steps or 1e6))),
    "growth": growth,
    "cost": COST,
    "long": long,
}
if __name__ == "__main__":
    main(__doc__, MEASURED, {"--steps": {"type": float}})
