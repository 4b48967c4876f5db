"""Rounding errors over many steps, and variable steps, for docs/reports/rounding.md.

    python benchmarks/rounding.py free [--write]      what free flights conserve, over 1e6 steps
    python benchmarks/rounding.py growth [--write]    how errors grow, over up to 1e8 steps; rounding-growth.png
    python benchmarks/rounding.py variable            what variable steps gain over constant ones

`--steps` takes another number of steps.

Of free flights, each figure is the root mean square over 16 bodies of the relative change of the spatial momentum R Pi,
the length of Pi or, if the flight is exact, the energy, in units of eps times the square root of the number of steps,
for the worst of six angles per step, 1e-5 to 1 radian. If it is the same for any number of steps, rounding errors grow
as a random walk.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import REPORTS, Line, Panel, Table, chart, main
from laboratory.free_body import free_body
from laboratory.runner import TURNS, Rows, Runner, free_bodies, spatial_momentum

import midlie_jax as ml
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

# ---- how errors grow over up to 1e8 steps: free bodies and the fast top P1 ----
#
# Each run is an ensemble of 16 bodies. A free body is moved by the exact flight JACOBI, at 0.2 and at 2e-5 radians a
# step. P1 is moved by SYMMETRIC[CHIN4A] with steps of 0.005 (0.25 radians), whose own error of the energy, 6e-15, is
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


# ---- the gain of `ml.integrate_variable_step` over constant steps: errors at equal torque evaluations ----

VARIABLE_METHODS = ("LIEMID[EA]", "JACOBI[EA]", "JACOBI[SRKN6b]")


def satellite(eccentricity, orbits=5.3):
    """A satellite on an eccentric orbit, from the periapsis, in units of the semi-major axis and the period."""
    mu = jnp.array(4 * np.pi**2)
    position = jnp.array([1 - eccentricity, 0.0, 0.0])
    velocity = jnp.array([0.0, 2 * np.pi * jnp.sqrt((1 + eccentricity) / (1 - eccentricity)), 0.0])
    orbit = ml.orbits.KeplerOrbit(position, velocity, mu)
    body = ml.RigidBody(jnp.array([1.0, 1.05, 1.1]))
    torque = ml.spacecraft.GravityGradient(body.moments, orbit, mu)
    start = ml.RigidState(body.moments * jnp.array([0.5, 1.0, 6.0]), ml.so3.exp(jnp.array([0.2, 0.3, 0.4])))
    return body, torque, start, ml.densities.OrbitalDistance(orbit, jnp.array(1.0)), float(orbits)


def bruls_cardona():
    scene = scenes.scene("bruls-cardona")
    density = ml.densities.TorqueSize(scene.torque, jnp.array(147.15), jnp.array(14.715))
    return scene.body, scene.torque, scene.start, density, scene.duration


def constant_density(t, state):
    return jnp.ones_like(t)


MOTIONS = {
    "satellite, eccentricity .6": (satellite(0.6), (200, 800)),
    "satellite, eccentricity .8": (satellite(0.8), (800, 3200)),
    "bruls-cardona, by torque": (bruls_cardona(), (800, 3200)),
}


def ends(name, case, density, dts, most):
    """Rotation matrices at the end, numbers of steps taken, and `ok`, for each of `dts`."""
    body, torque, start, _, t1 = case

    @jax.jit
    @jax.vmap
    def run(dt):
        path = ml.integrate_variable_step(
            name, body, torque, start, density=density, dt=dt, steps=most, save_every=most, t1=t1
        )
        return ml.so3.to_matrix(path.states.attitude[-1]), path.taken, path.ok

    return [np.asarray(x) for x in run(jnp.asarray(dts))]


def gain():
    for label, (case, ladder) in MOTIONS.items():
        density, t1 = case[3], case[4]
        smallest = t1 / (30 * ladder[-1])
        # The reference, and its uncertainty: the distance between the results with two small steps.
        exact, taken, ok = ends("JACOBI[SRKN6b]", case, density, [smallest, 0.7 * smallest], 1 << 20)
        mean = taken[0] * smallest / t1
        uncertainty = np.linalg.norm(exact[1] - exact[0])
        assert ok.all(), label
        for name in VARIABLE_METHODS:
            dts = t1 * mean / np.array(ladder)
            adaptive, taken, ok = ends(name, case, density, dts, 1 << 20)
            constant, constant_taken, constant_ok = ends(name, case, constant_density, t1 / taken, 1 << 20)
            assert (np.abs(constant_taken - taken)[constant_ok & ok] <= 1).all(), (constant_taken, taken)
            for i, count in enumerate(taken):
                adaptive_error, constant_error = (np.linalg.norm(x[i] - exact[1]) for x in (adaptive, constant))
                results = (constant_error, constant_ok[i]), (adaptive_error, ok[i])
                texts = [f"{error:.1e}" if succeeded else "failed" for error, succeeded in results]
                known = ok[i] and constant_ok[i] and min(constant_error, adaptive_error) > 10 * uncertainty
                ratio = f"{constant_error / adaptive_error:.2g}" if known else "not known"
                yield [label, f"`{name}`", str(count), *texts, ratio]
        print(f"(uncertainty of the reference {uncertainty:.0e})", flush=True)


VARIABLE = Table("", "", ("case", "method", "steps", "error, constant step", "error, adaptive", "gain"), gain)

MEASURED = {
    "free": lambda options: FREE.show(options.write, free_rows(int(options.steps or 1e6))),
    "growth": growth,
    "variable": VARIABLE,
}
if __name__ == "__main__":
    main(__doc__, MEASURED, {"--steps": {"type": float}})
