"""Spins against other programs: Depondt and Mertens' method in JAX, Spirit, and a copy of all spins in memory."""

import contextlib
import itertools
import math
import os
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Compiled, Line, Panel, Table, chart, compiled, in_turn

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax._xla.fusion import split
from midlie_jax.advice.timing import timed_in_turn
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION
from midlie_jax.spins.turns import turned

from . import random

# ---- the predictor and corrector of P. Depondt and F. G. Mertens (J. Phys.: Condens. Matter 21, 2009, 336005) ----
#
# Each spin turns about its field; with the mean of the fields at both ends it turns again from the start. Second order.
# It has what makes our own methods fast: turns without sines, by a series, barriers that keep XLA from computing a
# field again for each neighbour that reads it, and the same options of the compiler.


def _exchange(spin: Any) -> Any:
    """The field of J = 1 on a periodic lattice."""
    return tuple(sum(jnp.roll(x, step, axis) for axis in range(x.ndim) for step in (1, -1)) for x in spin)


def depondt(spin: Any, dt: Any, steps: Any) -> Any:
    """Spins (*lattice, 3) after some steps under exchange with J = 1, without damping."""
    return _depondt(spin.size // 3)(spin, dt, steps)


@cache
def _depondt(count: int) -> Any:
    def step(dt: Any, spin: Any) -> Any:
        field = split(_exchange(spin))
        guess = split(turned(spin, tuple(dt * b for b in field)))
        mean = tuple(dt / 2 * (a + b) for a, b in zip(field, _exchange(guess), strict=True))
        return split(turned(spin, mean))

    def whole(spin: Any, dt: Any, steps: Any) -> Any:
        start = tuple(jnp.moveaxis(spin, -1, 0))
        return jnp.stack(jax.lax.fori_loop(0, steps, lambda _, x: step(dt, x), start), axis=-1)

    return jax.jit(whole, compiler_options=compiler_options(count))


# ---- the same lattice in Spirit (G. P. Mueller et al., Phys. Rev. B 99, 2019, 224414): `pip install spirit` ----
#
# Spirit measures energies in meV, fields in T and times in ps. A spin has the moment of one Bohr magneton, so that with
# J = 1 meV the time 1/J of our units is mu_B/gamma. Spirit rounds its time step to float32, which changes the time that
# is reached by a share of 1e-8.

SOLVERS = {"Spirit, Depondt": 2, "Spirit, SIB": 1, "Spirit, RK4": 4}


def spirit_installed() -> bool:
    return find_spec("spirit") is not None


@contextlib.contextmanager
def spirit_lattice(shape: tuple[int, int]) -> Generator[Any]:
    """A square lattice of Spirit with exchange J = 1 between nearest neighbours, periodic, without anything else."""
    from spirit import geometry, hamiltonian, state  # pyright: ignore[reportMissingImports]
    from spirit.parameters import llg  # pyright: ignore[reportMissingImports]

    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        _quiet(),
        state.State("", quiet=True) as own,
    ):
        geometry.set_mu_s(own, 1.0)
        geometry.set_n_cells(own, [*shape, 1])
        hamiltonian.set_boundary_conditions(own, [True, True, False])
        hamiltonian.set_field(own, 0.0, [0, 0, 1])
        hamiltonian.set_anisotropy(own, 0.0, [0, 0, 1])
        hamiltonian.set_exchange(own, 1, [1.0])
        hamiltonian.set_dmi(own, 0, [])
        hamiltonian.set_ddi(own, 0)
        llg.set_damping(own, 0.0)
        llg.set_temperature(own, 0.0)
        llg.set_convergence(own, 0.0)
        llg.set_output_general(own, any=False, initial=False, final=False)
        yield own


@contextlib.contextmanager
def _quiet() -> Generator[None]:
    """What a library of C++ writes to the terminal goes nowhere."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(nowhere)
        os.close(kept)


def spirit_runner(own: Any, solver: str, start: np.ndarray, dt: float, steps: int) -> Callable[[], np.ndarray]:
    """A run from spins (n, m, 3), which returns those at its end."""
    from spirit import constants, simulation, system  # pyright: ignore[reportMissingImports]
    from spirit.parameters import llg  # pyright: ignore[reportMissingImports]

    # Spirit's first index is the fastest, which is our last one.
    begin = np.swapaxes(start, 0, 1).reshape(-1, 3)

    def run() -> np.ndarray:
        llg.set_timestep(own, dt * constants.mu_B / constants.gamma)
        system.get_spin_directions(own)[:] = begin
        simulation.start(own, simulation.METHOD_LLG, SOLVERS[solver], single_shot=True)
        simulation.n_shot(own, steps)
        simulation.stop(own)
        n, m = start.shape[:2]
        return np.swapaxes(system.get_spin_directions(own).reshape(m, n, 3), 0, 1).copy()

    return run


# ---- error against time on a square lattice of hot spins ----

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
    return lambda: jax.block_until_ready((depondt(start.spin, dt, steps), True))


def _spirit(own: Any, method: str, start: ml.spins.SpinState, dt: float, steps: int) -> Callable[[], Any]:
    run = spirit_runner(own, method, np.asarray(start.spin), dt, steps)
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
    if not spirit_installed():
        print("Spirit is not installed (pip install spirit); it is left out.")
        cases = [case for case in cases if case[0] not in SOLVERS]
    method, dt = reference
    known, ok = _ours(method, start, dt, round(time / dt))()
    assert bool(ok)
    with contextlib.ExitStack() as stack:
        theirs = any(case[0] in SOLVERS for case in cases)
        own = stack.enter_context(spirit_lattice(shape)) if theirs else None
        runs = [
            _spirit(own, *case[:1], start, *case[1:])
            if case[0] in SOLVERS
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


# ---- steps a second of a large cubic lattice on one core, beside what memory allows ----

SHAPES = (16, 16, 16), (100, 100, 100)
TIMED = "SUBLATTICES[EA]", "SUBLATTICES[SRKN6b]", "RK4"
LEAST, UPDATES = 16, 8_000_000  # steps, and spin-steps of a run
# A step must at least read every spin, and write it.
NUMBERS = 6


def _copy(spin: Any, steps: int) -> Compiled:
    """As many passes over memory as steps, each of which reads all spins and writes them."""
    factor = jnp.asarray(1.0000001, spin.dtype)

    def whole(parts: Any) -> Any:
        return jax.lax.fori_loop(0, steps, lambda _, x: tuple(factor * y for y in x), parts)

    parts = tuple(jnp.asarray(spin[..., i]) for i in range(3))
    return compiled(whole, parts, bodies=spin.size // 3)


def _unsaved(method: str, start: ml.spins.SpinState, steps: int) -> Callable[[], Any]:
    field = ml.spins.Exchange(jnp.ones((), start.spin.dtype))
    dt = jnp.asarray(0.05, start.spin.dtype)

    def run() -> Any:
        return ml.integrate(method, ml.spins.Spins(), field, start, dt=dt, steps=steps, save_every=None).states.spin

    return run


def lattice_rows(shapes: tuple[tuple[int, ...], ...] = SHAPES, rounds: int = 5) -> list[tuple[str, ...]]:
    """The table: for each lattice and dtype, methods that take turns with a copy of all spins."""
    found: list[tuple[str, ...]] = []
    for shape in shapes:
        for dtype in ("float64", "float32"):
            start = ml.spins.SpinState(random(shape, 1).spin.astype(dtype))
            spin, dt = start.spin, jnp.asarray(0.05, dtype)
            steps = max(LEAST, UPDATES // math.prod(shape))

            def theirs(spin: Any = spin, dt: Any = dt, steps: int = steps) -> Any:
                return depondt(spin, dt, steps)

            runs = [_copy(spin, steps), *(_unsaved(method, start, steps) for method in TIMED), theirs]
            for run in runs:
                run()
            per = 1e9 / steps / math.prod(shape)
            limit, *times = (per * seconds for seconds in in_turn(runs, rounds))
            for method, time in zip((*(f"`{name}`" for name in TIMED), JAX), times, strict=True):
                cells = f"{time:.3g}", f"{1e3 / time:.3g}", f"{limit / time:.2g}"
                found.append((f"{math.prod(shape):,}", dtype, method, *cells))
            bandwidth = NUMBERS * spin.dtype.itemsize / limit
            cells = f"{limit:.3g}", f"{1e3 / limit:.3g}", f"{bandwidth:.3g} GB/s"
            found.append((f"{math.prod(shape):,}", dtype, "a copy", *cells))
    return found


LATTICE = Table(
    *("reports/heat.md", "lattice"),
    ("spins", "dtype", "method", "ns per spin-step", "million spin-steps per second", "relative to a copy"),
    *(lattice_rows, "spins-lattice", lambda row: row[:2] == ["1,000,000", "float64"], (2, 3, 4, 5)),
)
