"""A dipole in a bath: averages against step and time by our schemes and by diffrax, and what a step costs.

Units of kT, of the dipole's moment of inertia across its axis, and of the time sqrt(I/kT). In the field x = mu B/kT the
energy is -x cos(theta), and <cos(theta)> = coth x - 1/x (P. Langevin 1905). Friction and steps are given in units of
the rate sqrt(1 + x), which is about that of libration."""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Compiled, Line, Panel, Table, chart, compiled, in_turn
from jax import Array

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.plot.style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION

# ---- the dipole and our runs ----
#
# Units of kT, of the dipole's moment of inertia across its axis, and of the time sqrt(I/kT). In the field x = mu B/kT
# the energy is -x cos(theta), and <cos(theta)> = coth x - 1/x (P. Langevin 1905). Friction and steps are given in units
# of the rate sqrt(1 + x), which is about that of libration.

FIELDS = 0.5, 2.0, 10.0
MOMENTS = 1.0, 1.0, 0.5
BODIES = 10_000
FRICTION = 1.0  # per moment of inertia, in units of the rate
_BURN_IN, _TIME, _BLOCKS = 10.0, 200.0, 8  # times of a run in units of 1/rate; and parts into which it is cut
_OBSERVED = 1.0  # the time between two observations, likewise: in between, little is new
_GRID = 256  # steps are multiples of 1/_GRID, so that float32 has all times of a run exactly


class Average(NamedTuple):
    """<cos(theta)> and the kinetic temperature in units of kT, and their standard errors."""

    cosine: float
    temperature: float
    cosine_error: float
    temperature_error: float


def exact(x: float) -> float:
    """<cos(theta)>."""
    return 1 / math.tanh(x) - 1 / x


def rate(x: Any) -> Any:
    return (1 + x) ** 0.5


def step(x: float, share: float) -> float:
    """The step that is this share of 1/rate, rounded."""
    return round(share / rate(x) * _GRID) / _GRID


class Plan(NamedTuple):
    """How many steps a run has, those before it counts, and those between two observations."""

    steps: int
    skipped: int
    every: int

    @classmethod
    def of(cls, share: float) -> "Plan":
        """That of a step which is this share of 1/rate."""
        every = max(1, round(_OBSERVED / share))
        skipped = math.ceil(_BURN_IN / share / every)
        counted = math.ceil(_TIME / share / every / _BLOCKS) * _BLOCKS
        return cls(every * (skipped + counted), every * skipped, every)


def thermal(key: Array, x: Any, dtype: Any = jnp.float32) -> ml.RigidState:
    """Bodies in the equilibrium of the exact motion."""
    a, b, c = jax.random.split(key, 3)
    low = jnp.exp(-2 * x)
    cosine = 1 + jnp.log(low + (1 - low) * jax.random.uniform(a, (BODIES,), dtype, 1e-7)) / x
    half, turn, spin = jnp.arccos(jnp.clip(cosine, -1, 1)) / 2, *jax.random.uniform(b, (2, BODIES), dtype) * 2 * math.pi
    attitude = jnp.cos(half) * jnp.cos(turn), jnp.sin(half) * jnp.cos(spin), jnp.sin(half) * jnp.sin(spin)
    attitude = jnp.stack([*attitude, jnp.cos(half) * jnp.sin(turn)], axis=-1)
    momentum = jax.random.normal(c, (BODIES, 3), dtype) * jnp.sqrt(jnp.asarray(MOMENTS, dtype))
    return ml.RigidState(momentum, attitude)


def observed(t: Array, state: ml.RigidState) -> Array:
    """cos(theta), and the kinetic temperature."""
    del t
    return jnp.stack(of_parts(state.momentum, state.attitude))


def of_parts(momentum: Any, attitude: Any) -> tuple[Array, Array]:
    """The same of the components of momentum and attitude along the last axis."""
    cosine = 1 - 2 * (attitude[..., 1] ** 2 + attitude[..., 2] ** 2)
    p, q, r = (momentum[..., i] ** 2 / MOMENTS[i] for i in range(3))
    return cosine, (p + q + r) / 3


def scene(x: Any, keys: Array, dtype: Any) -> tuple[ml.RigidBody, Any, Any]:
    """The body, the torque of the field, and the bath."""
    field = ml.torques.HeavyTop(jnp.asarray(-x, dtype))
    bath = ml.baths.Langevin(jnp.asarray(1.0, dtype), jnp.asarray(FRICTION * rate(x), dtype), keys)
    return ml.RigidBody(jnp.asarray(MOMENTS, dtype)), field, bath


Run = Callable[[Array, Any, Any], Array]  # from a key, the field and the step to the means of `observed`, (k, 2)


def ours(method: str, share: float, dtype: Any = jnp.float32) -> Run:
    """Runs of all bodies, compiled once for all fields."""
    plan = Plan.of(share)

    def run(key: Array, x: Array, h: Array) -> Array:
        a, b = jax.random.split(key)
        body, torque, bath = scene(x, jax.random.split(b, BODIES), dtype)
        mean = ml.observe.Mean(observed)
        options: Any = {"dt": h, "steps": plan.steps, "save_every": plan.every, "observe": mean}
        path = ml.ensemble(method, body, torque, thermal(a, x, dtype), bath=bath, **options)
        return path.states.mean[1 + plan.skipped // plan.every :]

    return jax.jit(run, compiler_options=compiler_options(BODIES))


def timed(method: str, x: float, h: float, steps: int, dtype: Any = jnp.float32) -> Compiled:
    """A run of this many steps without observations, compiled."""
    key = jax.random.key(0)
    body, torque, bath = scene(x, jax.random.split(key, BODIES), dtype)

    def run(start: ml.RigidState) -> Any:
        return ml.ensemble(method, body, torque, start, dt=jnp.asarray(h, dtype), steps=steps, bath=bath)

    start = thermal(key, x, dtype)
    return compiled(run, start, bodies=BODIES)


def averaged(run: Run, x: float, share: float, runs: int, seed: int = 0) -> Average:
    """The averages over several runs, and over blocks of each for the standard errors."""
    place = jnp.float32(x), jnp.float32(step(x, share))
    blocks = np.concatenate(list(_blocks(lambda key: run(key, *place), runs, seed)))
    mean, error = blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / math.sqrt(len(blocks))
    return Average(*map(float, (*mean, *error)))


def _blocks(run: Callable[[Array], Array], runs: int, seed: int) -> Iterator[np.ndarray]:
    for key in jax.random.split(jax.random.key(seed), runs):
        means = np.asarray(run(key), np.float64)
        yield means.reshape(_BLOCKS, -1, 2).mean(axis=1)


# ---- the same dipole through diffrax: quaternion and body-frame momentum, with the bath as additive noise ----
#
# All that was measured to make it fast is used: one equation for all bodies, whose components are rows of numbers; the
# Brownian path that draws each increment afresh; a term that adds the noise to the momenta alone; `solver.step` in a
# loop without the bookkeeping of `diffeqsolve`; and XLA's options for our own steps. The quaternion is scaled to unit
# length after each step. With `jax.vmap` over bodies that each have a path, a step takes about five times as long.

SOLVERS: dict[str, Any] = {
    "EulerHeun": diffrax.EulerHeun(),
    "Heun": diffrax.Heun(),
    "SEA": diffrax.SEA(),
    "ShARK": diffrax.ShARK(),
}
_PLAIN = "EulerHeun", "Heun"  # the others read the space-time Levy area, too


class _Noise(diffrax.AbstractTerm[Any, Any]):
    """Noise of one size on the last three of seven rows."""

    size: Array
    path: Any

    def vf(self, t: Any, y: Any, args: Any) -> Any:
        return self.size

    def contr(self, t0: Any, t1: Any, **options: Any) -> Any:
        return self.path.evaluate(t0, t1, **options)

    def prod(self, vf: Any, control: Any) -> Any:
        return jnp.concatenate([jnp.zeros((4, *control.shape[1:]), control.dtype), vf * control])


def _rates(x: Any) -> Callable[[Any, Any, Any], Array]:
    friction = FRICTION * rate(x)

    def rates(t: Any, y: Any, args: Any) -> Array:
        del t, args
        a, b, c, d, *momentum = y
        (p, q, r), (u, v, w) = momentum, (m / moment for m, moment in zip(momentum, MOMENTS, strict=True))
        turning = -b * u - c * v - d * w, a * u + c * w - d * v, a * v + d * u - b * w, a * w + b * v - c * u
        east, north = 2 * (b * d - a * c), 2 * (c * d + a * b)  # components of the field along the axes of the body
        torque = -x * north - friction * u, x * east - friction * v, -friction * w
        gyroscopic = q * w - r * v, r * u - p * w, p * v - q * u
        return jnp.stack([*(k / 2 for k in turning), *(g + k for g, k in zip(gyroscopic, torque, strict=True))])

    return rates


def _loop(name: str, x: Any, h: Any, dtype: Any) -> Callable[[Array, Array, Array, int], Array]:
    """A function of the rows (7, n), a key, the number of the first step and how many steps to take."""
    solver, size = SOLVERS[name], jnp.asarray((2 * FRICTION * rate(x)) ** 0.5, dtype)
    levy: Any = diffrax.BrownianIncrement if name in _PLAIN else diffrax.SpaceTimeLevyArea

    def steps(rows: Array, key: Array, first: Array, count: int) -> Array:
        shape: Any = jax.ShapeDtypeStruct((3, rows.shape[1]), dtype)
        path = diffrax.UnsafeBrownianPath(shape, key, levy_area=levy)
        terms = diffrax.MultiTerm(diffrax.ODETerm(_rates(x)), _Noise(size, path))
        dt = jnp.asarray(h, dtype)

        def one(k: Array, carry: Any) -> Any:
            y, state = carry
            t = k.astype(dtype) * dt
            y, _, _, state, _ = solver.step(terms, t, t + dt, y, None, state, False)
            return y.at[:4].divide(jnp.sqrt(jnp.sum(y[:4] ** 2, axis=0))), state

        state = solver.init(terms, jnp.zeros((), dtype), dt, rows, None)
        return jax.lax.fori_loop(first, first + count, one, (rows, state))[0]

    return steps


def _rows_at_start(key: Array, x: Any, dtype: Any) -> Array:
    state = thermal(key, x, dtype)
    return jnp.concatenate([state.attitude, state.momentum], axis=-1).T


def theirs(name: str, share: float, dtype: Any = jnp.float32) -> Run:
    """As `ours`."""
    plan = Plan.of(share)

    def run(key: Array, x: Array, h: Array) -> Array:
        a, b = jax.random.split(key)
        advance = _loop(name, x, h, dtype)

        def save(rows: Array, k: Array) -> tuple[Array, Array]:
            rows = advance(rows, b, k * plan.every, plan.every)
            return rows, jnp.stack([jnp.mean(value) for value in of_parts(rows[4:].T, rows[:4].T)])

        means = jax.lax.scan(save, _rows_at_start(a, x, dtype), jnp.arange(plan.steps // plan.every))[1]
        return means[plan.skipped // plan.every :]

    return jax.jit(run, compiler_options=compiler_options(BODIES))


def timed_of_diffrax(name: str, x: float, h: float, steps: int, dtype: Any = jnp.float32) -> Compiled:
    """As `timed`."""
    key, advance = jax.random.key(0), _loop(name, x, h, dtype)
    rows = _rows_at_start(key, x, dtype)

    def run(rows: Array, key: Array) -> Array:
        return advance(rows, key, jnp.zeros((), jnp.int32), steps)

    return compiled(run, rows, key, bodies=BODIES)


# ---- errors of averages ----

OURS = {f"SYMMETRIC[{scheme}]": (0.25, 0.5, 0.75, 1.0, 1.5) for scheme in ("BAOAB", "OBABO", "ABOBA")}
THEIRS = {
    "Heun": (0.125, 0.25, 0.375, 0.5, 0.75, 1.0),
    "ShARK": (0.25, 0.375, 0.5, 0.75),
    "EulerHeun": (0.0625, 0.125, 0.25),
}
# Runs of each, so that the larger errors have larger standard errors.
_RUNS = {"SYMMETRIC[BAOAB]": 24, "SYMMETRIC[OBABO]": 8, "SYMMETRIC[ABOBA]": 12, "Heun": 8, "ShARK": 6, "EulerHeun": 2}
_STEPS, _ROUNDS, _TIMES = 300, 9, 3  # of the runs that are timed
ERRORS = 0.003, 0.01, 0.03  # at which costs are compared
_SURE = 3.0  # standard errors from which an error counts as measured
_LARGEST, _THEIR_LARGEST = 1.0, 0.5  # steps for the slopes: larger ones are close to where a method diverges


class Rung(NamedTuple):
    """One method in the field x: the step is a share of 1/rate and takes nanoseconds for a body."""

    method: str
    x: float
    share: float
    nanoseconds: float
    found: Average

    @property
    def error(self) -> float:
        """Relative error of <cos(theta)>."""
        return abs(self.found.cosine / exact(self.x) - 1)

    @property
    def uncertain(self) -> float:
        return self.found.cosine_error / exact(self.x)

    @property
    def warmth(self) -> float:
        """Relative error of the kinetic temperature."""
        return abs(self.found.temperature - 1)

    @property
    def either(self) -> float:
        """The larger one of both errors."""
        return max(self.error, self.warmth)

    @property
    def cost(self) -> float:
        """Nanoseconds of a body and a unit of time, 1/rate."""
        return self.nanoseconds / self.share


def costs() -> dict[str, float]:
    """Nanoseconds of a body and a step, float32, without observations; the programs take turns.

    The least of several medians, because other work on the machine only adds to a time.
    """
    names = [*OURS, *THEIRS]
    place = 2.0, step(2.0, 0.25), _STEPS
    runs = [(timed if name in OURS else timed_of_diffrax)(name, *place) for name in names]
    times = zip(*(in_turn(runs, _ROUNDS) for _ in range(_TIMES)), strict=True)
    return {name: 1e9 / _STEPS / BODIES * min(own) for name, own in zip(names, times, strict=True)}


def extend(kept: Path, seconds: float) -> list[Rung]:
    """Measures what is not in the file yet, for some time, and puts it there; returns all that is there."""
    data: Any = json.loads(kept.read_text()) if kept.exists() else {"costs": costs(), "rungs": []}
    began, done = time.monotonic(), {(method, share) for method, _, share, _ in data["rungs"]}
    for method, shares in (OURS | THEIRS).items():
        for share in shares:
            if (method, share) not in done and time.monotonic() - began < seconds:
                run = ours(method, share) if method in OURS else theirs(method, share)
                for x in FIELDS:
                    found = averaged(run, x, share, _RUNS[method])
                    data["rungs"].append((method, x, share, found))
                kept.write_text(json.dumps(data))
    named = data["costs"]
    return [Rung(method, x, share, named[method], Average(*found)) for method, x, share, found in data["rungs"]]


def slope(steps: Sequence[float], errors: Sequence[float], uncertain: Sequence[float]) -> tuple[float, float]:
    """The slope of log error against log step, and its standard error; NaN of fewer than two."""
    if len(steps) < 2:
        return math.nan, math.nan
    x, y = np.log(steps), np.log(errors)
    weights = (np.array(errors) / np.array(uncertain)) ** 2
    x = x - np.average(x, weights=weights)
    scatter = np.sum(weights * x * x)
    return float(np.sum(weights * x * y) / scatter), float(scatter**-0.5)


def slopes(found: Sequence[Rung]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of <cos(theta)> and of the temperature, of one method in one field; errors lost in the noise are left out."""
    small = [r for r in found if r.share <= (_THEIR_LARGEST if r.method in THEIRS else _LARGEST)]
    sure = [r for r in small if r.error > _SURE * r.uncertain]
    warm = [r for r in small if r.warmth > _SURE * r.found.temperature_error]
    of_cosine = slope([r.share for r in sure], [r.error for r in sure], [r.uncertain for r in sure])
    errors = [r.found.temperature_error for r in warm]
    return of_cosine, slope([r.share for r in warm], [r.warmth for r in warm], errors)


def step_at(found: Sequence[Rung], error: float, kind: str) -> float:
    """The largest step with this error, between the measured ones by their logarithms.

    The largest measured step that does not diverge if no error is as large; 0 if all are larger. A step counts only if
    all smaller ones are within the error, so that an average is not trusted where its error happens to change sign.
    """
    best: Rung | None = None
    for rung in sorted(found, key=lambda r: r.share):
        value = getattr(rung, kind)
        if value <= error:
            best = rung
        elif best is None:
            return 0.0
        elif not math.isfinite(value) or getattr(best, kind) == 0:
            return best.share
        else:
            part = math.log(error / getattr(best, kind)) / math.log(value / getattr(best, kind))
            return best.share * (rung.share / best.share) ** part
    return 0.0 if best is None else best.share


def rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    """Every method with every step in every field."""
    for r in sorted(found, key=lambda r: r.x):
        a = r.found
        if not math.isfinite(a.cosine):
            yield [f"{r.x:g}", name(r.method), f"{r.share:g}", f"{r.nanoseconds:.1f}", "", "", "diverges", ""]
            continue
        cosine = f"{exact(r.x):.5f}", f"{a.cosine - exact(r.x):+.5f} ± {a.cosine_error:.5f}"
        warmth = f"{a.temperature - 1:+.4f} ± {a.temperature_error:.4f}"
        yield [f"{r.x:g}", name(r.method), f"{r.share:g}", f"{r.nanoseconds:.1f}", f"{r.cost:.0f}", *cosine, warmth]


def name(method: str) -> str:
    return f"diffrax `{method}`" if method in THEIRS else f"`{method}`"


def _grouped(found: Sequence[Rung]) -> dict[tuple[float, str], list[Rung]]:
    groups = dict[tuple[float, str], list[Rung]]()
    for r in sorted(found, key=lambda r: r.x):
        groups.setdefault((r.x, r.method), []).append(r)
    return groups


def slope_rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    for (x, method), own in _grouped(found).items():
        cells = [f"{a:.2f} ± {b:.2f}" if math.isfinite(a) else "below the noise" for a, b in slopes(own)]
        yield [f"{x:g}", name(method), *cells]


def ratio_rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    """The cheapest of ours and of theirs within some errors of <cos(theta)>, and of both averages."""
    groups = _grouped(found)
    for x in FIELDS:
        for kind, words in (("error", "⟨cos θ⟩"), ("either", "⟨cos θ⟩ and T")):
            for error in ERRORS:
                best = [_cheapest(groups, methods, x, error, kind) for methods in (OURS, THEIRS)]
                if all(math.isfinite(cost) for _, cost in best):
                    cells = [cell for method, cost in best for cell in (name(method), f"{cost:.0f}")]
                    yield [f"{x:g}", words, f"{error:g}", *cells, f"{best[1][1] / best[0][1]:.1f}"]


def _cheapest(groups: Any, methods: Any, x: float, error: float, kind: str) -> tuple[str, float]:
    """A method and its cost at this error."""
    costs = dict[str, float]()
    for method in methods:
        own = groups.get((x, method), ())
        share = step_at(own, error, kind)
        costs[method] = own[0].nanoseconds / share if share else math.inf
    finite = {method: cost for method, cost in costs.items() if math.isfinite(cost)}
    return min(finite.items(), key=lambda pair: pair[1]) if finite else ("", math.nan)


PAGE = "reports/heat.md"
DIPOLE = Table(
    *(PAGE, "dipole"),
    ("x", "method", "step", "ns per step", "ns per time", "exact ⟨cos θ⟩", "error of ⟨cos θ⟩", "error of T"),
    data="heat-dipole",
    words=lambda rows: [],
)
SLOPES = Table(
    *(PAGE, "slopes", ("x", "method", "slope of the error of ⟨cos θ⟩", "of T")),
    data="heat-slopes",
    words=lambda rows: [],
)
RATIOS = Table(
    *(PAGE, "ratios", ("x", "of", "relative error", "midlie_jax", "ns", "diffrax", "ns", "times faster")),
    data="heat-ratios",
    key=lambda row: row[2] == "0.03",
    columns=(0, 1, 3, 4, 5, 6, 7),
)


def measure(options: argparse.Namespace) -> None:
    found = extend(options.kept, options.seconds)
    DIPOLE.show(options.write, rows(found))
    SLOPES.show(options.write, slope_rows(found))
    RATIOS.show(options.write, ratio_rows(found))
    if options.write:
        draw(found, REPORTS / "heat-averages.png")


_COLOURS = dict(zip((*OURS, *THEIRS), (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY), strict=True))
_LEAST, _MOST = 1e-5, 1.0  # errors that are drawn


def draw(found: Sequence[Rung], out: Path) -> None:
    """A column for each field; above against the step, below against the time."""

    def panel(x: float, across: str, words: str) -> Panel:
        own = sorted((r for r in found if r.x == x and r.error < _MOST), key=lambda r: getattr(r, across))
        lines = list[Line]()
        for method in dict.fromkeys(r.method for r in own):
            theirs = method in THEIRS
            name = f"diffrax {method}" if theirs else method.removeprefix("SYMMETRIC[").removesuffix("]")
            style: Any = {"linestyle": "--" if theirs else "-", "marker": "s" if theirs else "o", "markersize": 3.5}
            points = [r for r in own if r.method == method]
            x_values, y_values = [getattr(r, across) for r in points], [r.error for r in points]
            lines.append(Line(name, x_values, y_values, _COLOURS[method], "", options=style))

        def bars(axes: Any) -> None:
            for r in own:
                bar = [[min(r.uncertain, 0.9 * r.error)], [r.uncertain]]
                axes.errorbar([getattr(r, across)], [r.error], yerr=bar, color=_COLOURS[r.method], fmt="none")

        up = "relative error of ⟨cos θ⟩ [-]" if x == FIELDS[0] else ""
        scales = {"xscale": "log", "yscale": "log", "ylim": (_LEAST, _MOST)}
        return Panel(f"μB/kT = {x:g}", words, up, lines, scales, bars)

    rows = {"share": "step [1/rate]", "cost": "run time per body and 1/rate of simulated time [ns]"}
    panels = [[panel(x, across, words) for x in FIELDS] for across, words in rows.items()]
    title = "BAOAB and ABOBA reach a given error in less time than the diffrax solvers"
    chart(out, panels, (15, 8.4), title, left=0.06, right=0.99, top=0.9, bottom=0.07, wspace=0.3, hspace=0.25)


# ---- a step in a bath beside a step of `EA` on the same bodies under the same torque without the bath ----

_SCHEMES = "EA", "BAOAB", "OBABO", "ABOBA"
CASES = ("RigidState", "SYMMETRIC"), ("AxisState", "SYMMETRIC"), ("FreeState", "SYMMETRIC"), ("RigidState", "JACOBI")
_COST_STEPS, _COST_ROUNDS = 200, 9


def _states(kind: str, dtype: Any) -> tuple[Any, Any]:
    """The body and random states of it."""
    random = np.random.default_rng(0)

    def numbers(count: int) -> Any:
        return jnp.asarray(random.normal(size=(BODIES, count)), dtype)

    momentum, attitude = numbers(3), numbers(4)
    state = ml.RigidState(momentum, attitude / jnp.linalg.norm(attitude, axis=-1, keepdims=True))
    body = ml.RigidBody(jnp.asarray([1.0, 1.0, 0.5], dtype))
    if kind == "AxisState":
        return ml.SymmetricRotor(jnp.asarray(1.0, dtype), jnp.asarray(0.5, dtype)), ml.AxisState.of(state)
    if kind == "FreeState":
        free = ml.FreeBody(body, jnp.asarray(1.0, dtype))
        return free, ml.FreeState(state.momentum, state.attitude, numbers(3), numbers(3))
    return body, state


def _cost_run(kind: str, flight: str, scheme: str, dtype: Any) -> Compiled:
    body, start = _states(kind, dtype)
    torque = ml.torques.HeavyTop(jnp.asarray(-2.0, dtype))
    options: Any = {"dt": jnp.asarray(0.1, dtype), "steps": _COST_STEPS}
    if scheme != "EA":
        linear = jnp.asarray(1.0, dtype) if kind == "FreeState" else None
        keys = jax.random.split(jax.random.key(1), BODIES)
        options["bath"] = ml.baths.Langevin(jnp.asarray(1.0, dtype), jnp.asarray(1.0, dtype), keys, linear)

    def run(start: Any) -> Any:
        return ml.ensemble(f"{flight}[{scheme}]", body, torque, start, **options)

    return compiled(run, start, bodies=BODIES)


def cost_rows() -> Iterator[list[str]]:
    for kind, flight in CASES:
        for dtype in (jnp.float32, jnp.float64):
            runs = [_cost_run(kind, flight, scheme, dtype) for scheme in _SCHEMES]
            found = [1e9 * seconds / BODIES / _COST_STEPS for seconds in in_turn(runs, _COST_ROUNDS)]
            cells = [f"{x:.1f}" for x in found] + [f"{x / found[0]:.2f}" for x in found[1:]]
            yield [kind, f"`{flight}`", jnp.dtype(dtype).name, *cells]


COST = Table(
    *("reports/heat.md", "cost"),
    ("state", "flight", "dtype", *(f"{scheme}, ns" for scheme in _SCHEMES), *(f"{s} / EA" for s in _SCHEMES[1:])),
    *(cost_rows, "heat-cost", lambda row: row[2] == "float32", (0, 1, 3, 4, 5)),
)
