"""Error against time on a square lattice of hot spins: our methods, Depondt and Mertens' in JAX, and Spirit."""

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart

import midlie_jax as ml
from midlie_jax.advice.timing import timed_in_turn
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION

from . import depondt, random, spirit_runs

SHAPE, TIME = (64, 64), 10.0
JAX = "Depondt-Mertens in JAX"
LADDERS: dict[str, tuple[float, ...]] = {
    "SUBLATTICES[EA]": (0.1, 0.05, 0.025, 0.0125, 0.00625, 0.003125),
    "SUBLATTICES[SRKN6b]": (0.5, 0.4, 0.25, 0.2, 0.125, 0.1, 0.0625, 0.05, 0.04),
    "SUBLATTICES[KL6]": (0.4, 0.25, 0.2, 0.125, 0.1, 0.0625),
    "spherical midpoint": (0.1, 0.05, 0.025, 0.0125, 0.00625),
    "RK4": (0.125, 0.1, 0.05, 0.025, 0.0125),
    "GBS12": (10 / 13, 0.625, 0.5, 0.4, 0.25),
    JAX: (0.1, 0.05, 0.025, 0.0125, 0.00625, 0.003125, 0.0015625),
    "Spirit, Depondt": (0.1, 0.05, 0.025, 0.0125, 0.00625),
    "Spirit, SIB": (0.1, 0.05, 0.025, 0.0125, 0.00625),
    "Spirit, RK4": (0.1, 0.05, 0.025, 0.0125),
}
REFERENCE = "GBS12", 0.1
ROUNDS = 3
TARGETS = 1e-1, 1e-2, 1e-3, 1e-4


class Rung(NamedTuple):
    """A method with a step: rms error of a spin at the end, ns a spin and time 1/J, and ns a spin and step."""

    method: str
    dt: float
    error: float
    cost: float
    step_cost: float


def _ours(method: str, start: ml.spins.SpinState, dt: float, steps: int) -> Callable[[], Any]:
    field, body = ml.spins.Exchange(1.0), ml.spins.Spins()

    def run() -> Any:
        path = ml.integrate(method, body, field, start, dt=dt, steps=steps, save_every=steps)
        return jax.block_until_ready((path.states.spin[-1], jnp.all(path.ok)))

    return run


def _jax(start: ml.spins.SpinState, dt: float, steps: int) -> Callable[[], Any]:
    return lambda: jax.block_until_ready((depondt.run(start.spin, dt, steps), True))


def _spirit(own: Any, method: str, start: ml.spins.SpinState, dt: float, steps: int) -> Callable[[], Any]:
    run = spirit_runs.runner(own, method, np.asarray(start.spin), dt, steps)
    return lambda: (run(), True)


def measured(
    shape: tuple[int, int] = SHAPE,
    time: float = TIME,
    ladders: dict[str, tuple[float, ...]] = LADDERS,
    rounds: int = ROUNDS,
    reference: tuple[str, float] = REFERENCE,
) -> list[Rung]:
    """All rungs of all ladders, whose runs take turns; those of Spirit only where it is installed."""
    start = random(shape, 1)
    cases = [(m, dt, round(time / dt)) for m, steps in ladders.items() for dt in steps]
    if not spirit_runs.installed():
        print("Spirit is not installed (pip install spirit); it is left out.")
        cases = [case for case in cases if case[0] not in spirit_runs.SOLVERS]
    method, dt = reference
    known, ok = _ours(method, start, dt, round(time / dt))()
    assert bool(ok)
    with contextlib.ExitStack() as stack:
        theirs = any(case[0] in spirit_runs.SOLVERS for case in cases)
        own = stack.enter_context(spirit_runs.lattice(shape)) if theirs else None
        runs = [
            _spirit(own, *case[:1], start, *case[1:])
            if case[0] in spirit_runs.SOLVERS
            else (_jax(start, *case[1:]) if case[0] == JAX else _ours(case[0], start, *case[1:]))
            for case in cases
        ]
        for run in runs:
            run()
        timings = timed_in_turn(runs, least=rounds, most=rounds)
    found: list[Rung] = []
    for (method, dt, steps), ((end, ok), timing) in zip(cases, timings, strict=True):
        if bool(ok):
            error = math.sqrt(float(np.mean(np.sum((np.asarray(end) - np.asarray(known)) ** 2, axis=-1))))
            nanoseconds = 1e9 * timing.seconds / math.prod(shape)
            found.append(Rung(method, dt, error, nanoseconds / time, nanoseconds / steps))
    return found


def cost_at(rungs: Sequence[Rung], error: float) -> float:
    """The cost of an error, between rungs along a line in logarithms; NaN where no two rungs are on both sides."""
    own = sorted(rungs, key=lambda rung: rung.dt)
    for fine, coarse in itertools.pairwise(own):
        if fine.error <= error <= coarse.error:
            share = math.log(error / fine.error) / math.log(coarse.error / fine.error)
            return math.exp((1 - share) * math.log(fine.cost) + share * math.log(coarse.cost))
    return math.nan


COMPARED = "SUBLATTICES[SRKN6b]"


def rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    """For each method the time of a step, and for each error its cost over that of `COMPARED`."""
    own = [rung for rung in found if rung.method == COMPARED]
    for method in dict.fromkeys(rung.method for rung in found):
        rungs = [rung for rung in found if rung.method == method]
        ratios = [cost_at(rungs, x) / cost_at(own, x) for x in TARGETS]
        step = sorted(rung.step_cost for rung in rungs)[len(rungs) // 2]
        name = method if "," in method or method == JAX else f"`{method}`"
        yield [name, f"{step:.3g}", *("-" if math.isnan(x) else f"{x:.2g}" for x in ratios)]


_BROWNS = "#A03060", "#662506", "#000000"  # of Spirit
_COLOURS = dict(zip(LADDERS, (BLUE, ORANGE, PURPLE, GREEN, GREY, SKY, VERMILLION, *_BROWNS), strict=True))
_DASHES = {JAX: "-", "Spirit, Depondt": "--", "Spirit, SIB": "-.", "Spirit, RK4": ":"}


def draw(found: Sequence[Rung], out: Path) -> None:
    lines = list[Line]()
    for method in dict.fromkeys(rung.method for rung in found):
        rungs = sorted((rung for rung in found if rung.method == method), key=lambda rung: -rung.dt)
        x, y = [rung.cost for rung in rungs], [rung.error for rung in rungs]
        options: Any = {"linestyle": _DASHES.get(method, "-"), "marker": "o", "markersize": 3.5}
        lines.append(Line(method, x, y, _COLOURS[method], "", options=options))
    across = "run time per spin and ħ/J of simulated time, one core, float64 [ns]"
    title = "SUBLATTICES[SRKN6b] and [KL6] reach a given error in the least time"
    one = Panel(title, across, "error of a spin, root mean square [-]", lines, {"xscale": "log", "yscale": "log"})
    chart(out, [[one]], (8.4, 5.2), left=0.09, right=0.985, top=0.93, bottom=0.1)


TABLE = Table(
    *("reports/heat.md", "rivals", ("method", "ns per spin-step", *(f"error {x:g}" for x in TARGETS))),
    data="spins-rivals",
    key=lambda row: "SIB" not in row[0],
    columns=(0, 1, 2, 3, 5),
)


def measure(options: Any) -> None:
    found = measured()
    if options.write:
        draw(found, REPORTS / "spins-rivals.png")
    TABLE.show(options.write, rows(found))
