"""How rounding errors grow over up to 1e8 steps: free bodies and the fast top P1, for docs/reports/rounding.md.

Each run is an ensemble of 16 bodies. A free body is moved by the exact flight JACOBI, at .2 and at 2e-5 radians a step.
P1 is moved by SYMMETRIC[CHIN4A] with steps of .005 (.25 radians), whose own error of the energy, 6e-15, is below
rounding. Every run starts from numbers that float32 represents, so that the exact motion is the same in all precisions.
Exact sums of rounding errors that fall either way grow as the square root of the number of steps (Brouwer's law); then
the attitude, which sums the errors of the energy, grows with the power 3/2. The whole takes 20 minutes on one core.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart, in_turn

import midlie_jax as ml
from midlie_jax.advice.program import Program
from midlie_jax.cli import scenes

from .free_bodies import free_bodies, spatial_momentum
from .free_body import free_body
from .runner import Rows, Runner

BODIES, PER_DECADE = 16, 4
LARGEST = 0.1  # an error beyond which an attitude is lost, and no longer grows as a power
DECADES = 3.0  # of steps before the last over which an exponent is fitted


class Mode(NamedTuple):
    """A way of rounding: dtype and state."""

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


def kept(case: Case, mode: Mode, counts: list[int], folder: Path | None) -> ml.RigidState:
    """The states of `run`, from the folder if an earlier run left them there."""
    name = "".join(c if c.isalnum() else "-" for c in f"{case.name} {mode.name} {counts[-1]}")
    file = None if folder is None else folder / f"{name}.npz"
    if file is not None and file.exists():
        with np.load(file) as parts:
            return ml.RigidState(parts["momentum"], parts["attitude"])
    states = run(case, mode, counts)
    if file is not None:
        np.savez(file, momentum=states.momentum, attitude=states.attitude)
    return states


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


def measured(steps: int, folder: Path | None) -> Iterator[Growth]:
    for case in cases():
        most = round(case.share * steps)
        samples = round(PER_DECADE * np.log10(most / 10))
        counts = np.unique(np.round(np.geomspace(10, most, samples + 1)).astype(int))
        truth: Any = exact_attitudes(case, list(counts)) if case.rows.torque is None else None
        for mode in MODES:
            states = kept(case, mode, list(counts), folder)
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


def measure(options: Any) -> None:
    results: list[Growth] = []
    for growth in measured(int(options.steps or 1e8), options.parts):
        results.append(growth)
        numbers = f"{growth.error[-1]:.2e}", f"{growth.exponent:.2f}", f"{growth.lean:+.1f}"
        print(growth.case, growth.mode.name, growth.quantity, *numbers, flush=True)
    GROWTH.show(options.write, table_rows(results))
    if options.write:
        draw(results, REPORTS / "rounding-growth.png")


# ---- what a step costs with each state and dtype ----

COPIES, CHUNK, STEPS, TURNS = 64, 256, 2000, 15


def _compiled(case: Case, mode: Mode) -> Callable[[], Any]:
    """A run of many copies of the first body of a case, from the starts of all."""
    rows = rows_of(case, mode)
    body, torque, dt = jax.tree.map(lambda x: x[0], (rows.body, rows.torque, rows.dt))
    starts = jax.tree.map(lambda x: jnp.concatenate([x] * COPIES), rows.start)
    program = Program(ml.method(case.method), body, torque, starts, chunk=CHUNK)
    _, ok = program.run(float(dt), STEPS)
    if not ok.all():
        raise RuntimeError(f"{case.name}, {mode.name}: a step failed.")
    return lambda: program.run(float(dt), STEPS)


def cost_rows() -> Iterator[list[str]]:
    free, _, top = cases()
    for case in (free, top._replace(method="SYMMETRIC[EA]"), top):
        times = in_turn([_compiled(case, mode) for mode in MODES], TURNS)
        yield [f"`{case.method}`", *(f"{1e9 * seconds / (COPIES * BODIES * STEPS):.1f}" for seconds in times)]


COST = Table("reports/rounding.md", "cost", ("method", *(mode.name for mode in MODES)), cost_rows)
