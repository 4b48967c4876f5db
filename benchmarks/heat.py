"""Bodies in a heat bath: errors of known averages, and costs: docs/reports/heat.md.

    python benchmarks/heat.py dipole [--write]         a dipole in a field, beside diffrax; heat-averages.png
    python benchmarks/heat.py cost [--write]           what a step in a bath costs beside a step of EA
    python benchmarks/heat.py brownian [--write]       a dipole under strong friction, by BROWNIAN and others

Times are processor times on one core; programs that are compared take turns.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import REPORTS, Compiled, Line, Panel, Table, chart, compiled, in_turn, main
from jax import Array
from scipy.linalg import expm

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.plot.style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION

PAGE = "reports/heat.md"

# ---- the dipole and our runs ----
#
# Units of kT, of the dipole's moment of inertia across its axis, and of the time sqrt(I/kT). In the field x = mu B/kT
# the energy is -x cos(theta), and <cos(theta)> = coth x - 1/x (P. Langevin 1905). Friction and steps are given in units
# of the rate sqrt(1 + x), which is about that of libration.

FIELDS = 0.5, 2.0, 10.0
MOMENTS = 1.0, 1.0, 0.5
BODIES = 10_000
FRICTION = 1.0  # per moment of inertia, in units of the rate
_BURN_IN, _RUN_TIME, _BLOCKS = 10.0, 200.0, 8  # times of a run in units of 1/rate; and parts into which it is cut
_OBSERVED = 1.0  # the time between two observations, likewise: in between, little is new
_GRID = 256  # steps are multiples of 1/_GRID, so that float32 has all times of a run exactly


class Average(NamedTuple):
    """<cos(theta)> and the kinetic temperature in units of kT, and their standard errors."""

    cosine: float
    temperature: float
    cosine_error: float
    temperature_error: float


def exact(x: float) -> float:
    return 1 / math.tanh(x) - 1 / x


def rate(x: Any) -> Any:
    return (1 + x) ** 0.5


def step(x: float, share: float) -> float:
    return round(share / rate(x) * _GRID) / _GRID


def plan(share: float) -> tuple[int, int, int]:
    """The steps between two observations, and how many observations are skipped and counted."""
    every = max(1, round(_OBSERVED / share))
    counted = math.ceil(_RUN_TIME / share / every / _BLOCKS) * _BLOCKS
    return every, math.ceil(_BURN_IN / share / every), counted


def thermal(key: Array, x: Any, dtype: Any = jnp.float32) -> ml.RigidState:
    a, b, c = jax.random.split(key, 3)
    low = jnp.exp(-2 * x)
    cosine = 1 + jnp.log(low + (1 - low) * jax.random.uniform(a, (BODIES,), dtype, 1e-7)) / x
    half, turn, spin = jnp.arccos(jnp.clip(cosine, -1, 1)) / 2, *jax.random.uniform(b, (2, BODIES), dtype) * 2 * math.pi
    attitude = jnp.cos(half) * jnp.cos(turn), jnp.sin(half) * jnp.cos(spin), jnp.sin(half) * jnp.sin(spin)
    attitude = jnp.stack([*attitude, jnp.cos(half) * jnp.sin(turn)], axis=-1)
    momentum = jax.random.normal(c, (BODIES, 3), dtype) * jnp.sqrt(jnp.asarray(MOMENTS, dtype))
    return ml.RigidState(momentum, attitude)


def observed(t: Array, state: ml.RigidState) -> Array:
    del t
    return jnp.stack(of_parts(state.momentum, state.attitude))


def of_parts(momentum: Any, attitude: Any) -> tuple[Array, Array]:
    cosine = 1 - 2 * (attitude[..., 1] ** 2 + attitude[..., 2] ** 2)
    p, q, r = (momentum[..., i] ** 2 / MOMENTS[i] for i in range(3))
    return cosine, (p + q + r) / 3


def scene(x: Any, keys: Array, dtype: Any) -> tuple[ml.RigidBody, Any, Any]:
    field = ml.torques.HeavyTop(jnp.asarray(-x, dtype))
    bath = ml.baths.Langevin(jnp.asarray(1.0, dtype), jnp.asarray(FRICTION * rate(x), dtype), keys)
    return ml.RigidBody(jnp.asarray(MOMENTS, dtype)), field, bath


Run = Callable[[Array, Any, Any], Array]  # from a key, the field and the step to the means of `observed`, (k, 2)


def ours(method: str, share: float, dtype: Any = jnp.float32) -> Run:
    every, skipped, counted = plan(share)

    def run(key: Array, x: Array, h: Array) -> Array:
        a, b = jax.random.split(key)
        body, torque, bath = scene(x, jax.random.split(b, BODIES), dtype)
        mean = ml.observe.Mean(observed)
        options: Any = {"dt": h, "steps": every * (skipped + counted), "save_every": every, "observe": mean}
        path: Any = ml.ensemble(method, body, torque, thermal(a, x, dtype), bath=bath, **options)
        return path.states.mean[1 + skipped :]

    return jax.jit(run, compiler_options=compiler_options(BODIES))


def timed(method: str, x: float, h: float, steps: int, dtype: Any = jnp.float32) -> Compiled:
    key = jax.random.key(0)
    body, torque, bath = scene(x, jax.random.split(key, BODIES), dtype)

    def run(start: ml.RigidState) -> Any:
        return ml.ensemble(method, body, torque, start, dt=jnp.asarray(h, dtype), steps=steps, bath=bath)

    start = thermal(key, x, dtype)
    return compiled(run, start, bodies=BODIES)


def averaged(run: Run, x: float, share: float, runs: int, seed: int = 0) -> Average:
    place = jnp.float32(x), jnp.float32(step(x, share))
    means = [np.asarray(run(key, *place), np.float64) for key in jax.random.split(jax.random.key(seed), runs)]
    blocks = np.concatenate([part.reshape(_BLOCKS, -1, 2).mean(axis=1) for part in means])
    mean, error = blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / math.sqrt(len(blocks))
    return Average(*map(float, (*mean, *error)))


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
    every, skipped, counted = plan(share)

    def run(key: Array, x: Array, h: Array) -> Array:
        a, b = jax.random.split(key)
        advance = _loop(name, x, h, dtype)

        def save(rows: Array, k: Array) -> tuple[Array, Array]:
            rows = advance(rows, b, k * every, every)
            return rows, jnp.stack([jnp.mean(value) for value in of_parts(rows[4:].T, rows[:4].T)])

        means = jax.lax.scan(save, _rows_at_start(a, x, dtype), jnp.arange(skipped + counted))[1]
        return means[skipped:]

    return jax.jit(run, compiler_options=compiler_options(BODIES))


def timed_of_diffrax(name: str, x: float, h: float, steps: int, dtype: Any = jnp.float32) -> Compiled:
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


class Rung(NamedTuple):
    method: str
    x: float
    share: float
    nanoseconds: float
    found: Average

    @property
    def error(self) -> float:
        return abs(self.found.cosine / exact(self.x) - 1)

    @property
    def uncertain(self) -> float:
        return self.found.cosine_error / exact(self.x)

    @property
    def warmth(self) -> float:
        return abs(self.found.temperature - 1)

    @property
    def either(self) -> float:
        return max(self.error, self.warmth)

    @property
    def cost(self) -> float:
        return self.nanoseconds / self.share


def costs() -> dict[str, float]:
    """Nanoseconds of a body and step, float32: the least of several medians, as other work only adds to a time."""
    names = [*OURS, *THEIRS]
    place = 2.0, step(2.0, 0.25), _STEPS
    runs = [(timed if name in OURS else timed_of_diffrax)(name, *place) for name in names]
    times = zip(*(in_turn(runs, _ROUNDS) for _ in range(_TIMES)), strict=True)
    return {name: 1e9 / _STEPS / BODIES * min(own) for name, own in zip(names, times, strict=True)}


def rungs() -> Iterator[Rung]:
    nanoseconds = costs()
    for method, shares in (OURS | THEIRS).items():
        for share in shares:
            run = ours(method, share) if method in OURS else theirs(method, share)
            for x in FIELDS:
                yield Rung(method, x, share, nanoseconds[method], averaged(run, x, share, _RUNS[method]))


def step_at(found: Sequence[Rung], error: float, kind: str) -> float:
    """The largest step with this error and none larger at any smaller step, between the measured ones by logarithms.

    So an average is not trusted where its error changes sign. Of steps that diverge the largest below; 0 if none suits.
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


def dipole_rows(found: Sequence[Rung]) -> Iterator[list[str]]:
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


def ratio_rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    groups = _grouped(found)
    for x in FIELDS:
        for kind, words in (("error", "⟨cos θ⟩"), ("either", "⟨cos θ⟩ and T")):
            for error in ERRORS:
                best = [_cheapest(groups, methods, x, error, kind) for methods in (OURS, THEIRS)]
                if all(math.isfinite(cost) for _, cost in best):
                    cells = [cell for method, cost in best for cell in (name(method), f"{cost:.0f}")]
                    yield [f"{x:g}", words, f"{error:g}", *cells, f"{best[1][1] / best[0][1]:.1f}"]


def _cheapest(groups: Any, methods: Any, x: float, error: float, kind: str) -> tuple[str, float]:
    costs = dict[str, float]()
    for method in methods:
        own = groups.get((x, method), ())
        share = step_at(own, error, kind)
        costs[method] = own[0].nanoseconds / share if share else math.inf
    finite = {method: cost for method, cost in costs.items() if math.isfinite(cost)}
    return min(finite.items(), key=lambda pair: pair[1]) if finite else ("", math.nan)


AVERAGES = Table(
    *(PAGE, "dipole"),
    ("x", "method", "step", "ns per step", "ns per time", "exact ⟨cos θ⟩", "error of ⟨cos θ⟩", "error of T"),
    data="heat-dipole",
    words=lambda rows: [],
)
RATIOS = Table(
    *(PAGE, "ratios", ("x", "of", "relative error", "midlie_jax", "ns", "diffrax", "ns", "times faster")),
    data="heat-ratios",
    key=lambda row: row[2] == "0.03",
    columns=(0, 1, 3, 4, 5, 6, 7),
)


def dipole(options: argparse.Namespace) -> None:
    found = list(rungs())
    AVERAGES.show(options.write, dipole_rows(found))
    RATIOS.show(options.write, ratio_rows(found))
    if options.write:
        draw_averages(found, REPORTS / "heat-averages.png")


_COLOURS = dict(zip((*OURS, *THEIRS), (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY), strict=True))
_LEAST, _MOST = 1e-5, 1.0  # errors that are drawn


def draw_averages(found: Sequence[Rung], out: Path) -> None:
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
    *(PAGE, "cost"),
    ("state", "flight", "dtype", *(f"{scheme}, ns" for scheme in _SCHEMES), *(f"{s} / EA" for s in _SCHEMES[1:])),
    *(cost_rows, "heat-cost", lambda row: row[2] == "float32", (0, 1, 3, 4, 5)),
)


# ---- relaxation of a dipole under strong friction: BROWNIAN, BAOAB with a small moment, Euler-Maruyama ----
#
# The energy is -x kT cos(theta), with x = 2; friction, kT and therefore D = kT/G are 1. All bodies start along the
# field. The exact mean at the time 1/2 comes from the moments of Smoluchowski's equation,
#
#     d<P_l>/dt = l (l + 1) (x (<P_l-1> - <P_l+1>)/(2 l + 1) - <P_l>).
#
# BAOAB has inertia, with G/I = 1000, and needs steps below I/G. Euler-Maruyama adds the random rotation to the
# quaternion and normalises it: weak order 1.

DIPOLES, TIME, FIELD, MOMENT = 400_000, 0.5, 2.0, 1e-3
LADDERS = {"BROWNIAN": (0.125, 0.0625), "Euler-Maruyama": (0.125, 0.0625, 0.03125), "JACOBI[BAOAB]": (0.004, 0.0005)}
_LARGEST = 40  # Legendre polynomials


def relaxed() -> float:
    degree = np.arange(1, _LARGEST + 1)
    strength = degree * (degree + 1.0)
    coupling = FIELD * strength / (2 * degree + 1)
    rates = np.zeros((_LARGEST + 1, _LARGEST + 1))
    rates[degree, degree] = -strength
    rates[degree, degree - 1] = coupling
    rates[degree[:-1], degree[:-1] + 1] = -coupling[:-1]
    return float((expm(rates * TIME) @ np.ones(_LARGEST + 1))[1])


def overdamped(method: str, h: float) -> Callable[..., Any]:
    bath = ml.baths.Langevin(1.0, 1.0, jax.random.split(jax.random.key(1), DIPOLES))
    body, field = ml.RigidBody(MOMENT * jnp.ones(3)), ml.torques.HeavyTop(-FIELD)

    def run(start: ml.RigidState) -> Any:
        return ml.ensemble(method, body, field, start, dt=h, steps=round(TIME / h), bath=bath).states.attitude

    return run


def euler_maruyama(h: float) -> Callable[..., Any]:
    def step(attitude: Any, n: Any) -> tuple[Any, None]:
        up = ml.so3.to_matrix(attitude)[:, 2]
        torque = FIELD * jnp.stack([-up[:, 1], up[:, 0], jnp.zeros(DIPOLES)], -1)
        noise = jax.random.normal(jax.random.fold_in(jax.random.key(1), n), (DIPOLES, 3))
        turn = h * torque + jnp.sqrt(2 * h) * noise
        pure = jnp.concatenate([jnp.zeros((DIPOLES, 1)), turn / 2], axis=-1)
        moved = attitude + ml.so3.multiply(attitude, pure)
        return moved / jnp.linalg.norm(moved, axis=-1, keepdims=True), None

    return lambda start: jax.lax.scan(step, start.attitude, jnp.arange(round(TIME / h)))[0]


def brownian_runs() -> Iterator[tuple[str, float, Compiled]]:
    upright = jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (DIPOLES, 1))
    momenta = jnp.sqrt(MOMENT) * jax.random.normal(jax.random.key(0), (DIPOLES, 3))
    start = ml.RigidState(momenta, upright)
    for name, steps in LADDERS.items():
        for h in steps:
            made = euler_maruyama(h) if name == "Euler-Maruyama" else overdamped(name, h)
            yield name, h, compiled(made, start, bodies=DIPOLES)


def brownian_rows() -> Iterator[Sequence[str]]:
    programs = list(brownian_runs())
    seconds = in_turn([program for _, _, program in programs], 3)
    for (name, h, program), took in zip(programs, seconds, strict=True):
        cosine = np.asarray(ml.so3.to_matrix(program()))[:, 2, 2]
        error, chance = cosine.mean() - relaxed(), cosine.std() / np.sqrt(DIPOLES)
        shown = name if name == "Euler-Maruyama" else f"`{name}`"
        yield [shown, f"{h:g}", f"{error:+.4f} ± {chance:.4f}", f"{took / DIPOLES / TIME * 1e9:.0f}"]


BROWNIAN = Table(
    *(PAGE, "brownian"),
    ("method", "step", "⟨cos θ⟩ - exact", "ns per body and unit of time"),
    *(brownian_rows, "heat-brownian"),
    key=lambda row: row[1] in ("0.0625", "0.0005"),
)

PARTS = {"dipole": dipole, "cost": COST, "brownian": BROWNIAN}
if __name__ == "__main__":
    main(__doc__, PARTS)
