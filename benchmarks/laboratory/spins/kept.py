"""What methods for spins keep: energy, total spin and lengths; areas; and the spin waves of a ferromagnet."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart

import midlie_jax as ml
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILLION

from . import random

# ---- a closed Heisenberg chain, H = sum S_i . S_i+1 ----

SPINS, TIME = 64, 20.0
CHAIN_STEPS = 0.1, 0.2
CHAIN_METHODS = "SUBLATTICES[EA]", "SUBLATTICES[KL6]", "spherical midpoint", "Lie midpoint of spins", "RK4"


def errors(method: str, dt: float, *, spins: int = SPINS, time: float = TIME) -> tuple[float, float, float]:
    """The largest errors in a run of energy and total spin, each over the number of spins, and of a length."""
    body, field, start = ml.spins.Spins(), ml.spins.Exchange(-1.0), random((spins,), 0)
    path = ml.integrate(method, body, field, start, dt=dt, steps=round(time / dt))
    assert bool(jnp.all(path.ok))
    energy = np.asarray(ml.observe.energy(body, field, path))
    spin = np.asarray(path.states.spin)
    total = np.linalg.norm(spin.sum(axis=1) - spin[0].sum(axis=0), axis=-1)
    lengths = np.abs(np.linalg.norm(spin, axis=-1) - 1)
    return float(np.abs(energy - energy[0]).max() / spins), float(total.max() / spins), float(lengths.max())


def chain_rows() -> Iterator[list[str]]:
    for method in CHAIN_METHODS:
        for dt in CHAIN_STEPS:
            yield [f"`{method}`", f"{dt:g}", *(f"{error:.1e}" for error in errors(method, dt))]


CONSERVATION = Table(
    *("reports/heat.md", "conservation"),
    ("method", "h", "energy error / N", "total spin error / N", "length error"),
    *(chain_rows, "spins-conservation", lambda row: row[1] == "0.2", (0, 2, 3, 4)),
)


# ---- how far one step is from symplectic, and from preserving volumes, from its derivative by autodiff ----
#
# The form on the product of spheres is w(u, v) = sum S . (u x v) over tangent vectors. In a right-handed orthonormal
# basis of the tangent plane of each spin its matrix is the canonical J. With M, the derivative of the step in such
# bases at both ends, a symplectic step has M^T J M = J, and one that keeps volumes det M = 1.

AREA_STEPS = 0.8, 0.4, 0.2, 0.1
STARTS = 8
HALVES = jnp.array([1.0, 0.5, 0.2]) / 2  # of the energy S . diag(1, .5, .2) S / 2
ONE = "one spin"
COUPLED = "four coupled spins"


class Case(NamedTuple):
    """A method on a system."""

    system: str
    method: str


AREA_METHODS: tuple[str, ...] = (
    "spherical midpoint",
    "Lie midpoint of spins",
    "SUBLATTICES[EA]",
    "SUBLATTICES[SRKN6b]",
    "SUBLATTICES[KL6]",
)
CASES = [*(Case(ONE, method) for method in AREA_METHODS[:2]), *(Case(COUPLED, method) for method in AREA_METHODS)]


def _field(system: str) -> Any:
    if system == ONE:
        return ml.torques.FromPotential(lambda t, state: jnp.sum(HALVES * state.spin**2))
    return ml.spins.Exchange(1.0, periodic=False)


def _basis(spin: np.ndarray) -> np.ndarray:
    """Two tangent vectors of each spin (n, 3), with u x v = S: columns (3 n, 2 n)."""
    columns = np.zeros((len(spin), 3, len(spin), 2))
    for i, s in enumerate(spin):
        u = np.cross(s, np.eye(3)[np.argmin(np.abs(s))])
        u /= np.linalg.norm(u)
        columns[i, :, i] = np.stack([u, np.cross(s, u)], axis=1)
    return columns.reshape(3 * len(spin), 2 * len(spin))


def defects(case: Case, steps: Sequence[float] = AREA_STEPS, starts: int = STARTS) -> np.ndarray:
    """For each step the largest entry of |M^T J M - J| and the largest |det M - 1| over some starts, (steps, 2).

    NaN where an implicit method finds no solution from some start.
    """
    field, body = _field(case.system), ml.spins.Spins()
    shape = () if case.system == ONE else (4,)

    def end(spin: Any, dt: Any) -> Any:
        start = ml.spins.SpinState.unchecked(spin=spin)
        run = ml.integrate(case.method, body, field, start, dt=dt, steps=1, adjoint=ml.adjoints.Forward())
        return run.states.spin[-1], (run.states.spin[-1], run.ok)

    derivative = jax.jit(jax.jacfwd(end, has_aux=True))
    found = np.zeros((len(steps), 2))
    for seed in range(starts):
        spin = random(shape, seed).spin
        count = max(1, spin.size // 3)
        canonical = np.kron(np.eye(count), np.array([[0, 1], [-1, 0]]))
        for row, dt in zip(found, steps, strict=True):
            matrix, (after, ok) = derivative(spin, jnp.asarray(dt))
            if not bool(jnp.all(ok)):
                row[:] = np.nan
                continue
            before, after = (np.asarray(x).reshape(count, 3) for x in (spin, after))
            m = _basis(after).T @ np.asarray(matrix).reshape(3 * count, 3 * count) @ _basis(before)
            own = np.abs(m.T @ canonical @ m - canonical).max(), abs(np.linalg.det(m) - 1)
            row[:] = np.maximum(row, own)  # NaN stays
    return found


def _areas() -> dict[Case, np.ndarray]:
    return {case: defects(case) for case in CASES}


def _order(errors: np.ndarray) -> str:
    """The slope of the two shortest steps, or nothing at rounding."""
    return "rounding" if errors[-2:].max() < 1e-13 else f"{np.log2(errors[-2] / errors[-1]):.1f}"


def area_rows(found: dict[Case, np.ndarray]) -> Iterator[list[str]]:
    for case, errors in found.items():
        for name, column in zip(("symplectic", "volume"), errors.T, strict=True):
            if case.system == COUPLED or name == "symplectic":
                cells = [f"{x:.1e}" if np.isfinite(x) else "no solution" for x in column]
                yield [case.system, f"`{case.method}`", name, *cells, _order(column)]


def _draw_area(found: dict[Case, np.ndarray], out: Path, steps: Sequence[float] = AREA_STEPS) -> None:
    """The defect of a step against its length: one spin on the left, four coupled spins on the right."""
    colours = dict(zip(AREA_METHODS, (GREEN, VERMILLION, BLUE, ORANGE, PURPLE), strict=True))

    def lines(system: str) -> Iterator[Line]:
        for case, errors in found.items():
            if case.system == system:
                solved = np.isfinite(errors[:, 0])
                x, y = np.asarray(steps)[solved][::-1], errors[solved, 0][::-1]
                yield Line(case.method, x, y, colours[case.method], "o-", options={"markersize": 4})

    def ticks(axes: Any) -> None:
        axes.set_xticks(steps, [f"{h:g}" for h in steps])
        axes.minorticks_off()

    options: Any = {"xscale": "log", "yscale": "log", "xlim": (steps[-1] / 1.15, steps[0] * 1.15)}
    words = "step [ħ/J]", "symplectic defect of one step [-]"
    panels = [Panel(system, *words, list(lines(system)), options, ticks) for system in (ONE, COUPLED)]
    title = "Only the spherical midpoint rule is symplectic"
    chart(out, [panels], (9.6, 4.4), title, left=0.09, bottom=0.13, wspace=0.2)


AREA = Table(
    *("reports/heat.md", "area", ("system", "method", "defect", *(f"h = {h:g}" for h in AREA_STEPS), "order in h")),
    data="spins-area",
    key=lambda row: row[0] != ONE and row[2] == "symplectic",
    columns=(1, 5, 7),
)


def area(options: Any) -> None:
    found = _areas()
    if options.write:
        _draw_area(found, REPORTS / "spins-area.png")
    AREA.show(options.write, area_rows(found))


# ---- spin waves of a Heisenberg ferromagnet: w(k) = 2 J sum over axes of (1 - cos k) ----
#
# Two measurements. `frequencies` are those of one step, linear about the ferromagnet: the eigenvalues of its
# derivative. `peaks` are those of the spectrum of a run from weak white noise, as an experiment would see them.

WAVE_METHODS = "SUBLATTICES[EA]", "SUBLATTICES[SRKN6b]", "SUBLATTICES[KL6]", "spherical midpoint", "RK4", "GBS12"
LATTICES = {"chain of 32": (32,), "square of 8 x 8": (8, 8)}
GRID = 60  # steps that are tried
ENOUGH = 1e-3  # relative error of a frequency
NOISE = 1e-4
EXCHANGE = 1.0


def known(shape: tuple[int, ...]) -> np.ndarray:
    """w(k) of each wave vector of a periodic lattice, in the order of numpy's FFT."""
    parts = [2 * EXCHANGE * (1 - np.cos(2 * math.pi * np.fft.fftfreq(n))) for n in shape]
    return np.asarray(sum(np.meshgrid(*parts, indexing="ij")))


def _end(method: str, shape: tuple[int, ...]) -> Any:
    """The spins after one step as a function of their components x and y and the step, and whether it succeeded."""

    def end(across: Any, dt: Any) -> Any:
        along = jnp.sqrt(1 - jnp.sum(across**2, axis=-1, keepdims=True))
        start = ml.spins.SpinState.unchecked(spin=jnp.concatenate([across, along], axis=-1))
        field = ml.spins.Exchange(EXCHANGE)
        run = ml.integrate(method, ml.spins.Spins(), field, start, dt=dt, steps=1, adjoint=ml.adjoints.Forward())
        return run.states.spin[-1, ..., :2], run.ok

    return jax.jit(lambda dt: jax.jacfwd(lambda x: end(x, dt), has_aux=True)(jnp.zeros((*shape, 2))))


class Waves(NamedTuple):
    """Of a linear step the largest relative error of a frequency, inf if it fails, and largest | |eigenvalue| - 1 |."""

    error: float
    growth: float


def waves(derivative: Any, dt: float, shape: tuple[int, ...]) -> Waves:
    matrix, ok = derivative(jnp.asarray(dt))
    if not bool(jnp.all(ok)):
        return Waves(math.inf, math.inf)
    size = 2 * math.prod(shape)
    values = np.linalg.eigvals(np.asarray(matrix).reshape(size, size))
    found = np.sort(np.abs(np.angle(values)) / dt)
    expected = np.sort(np.repeat(known(shape).ravel(), 2))
    moving = expected > 1e-9
    error = np.abs(found[moving] / expected[moving] - 1).max()
    return Waves(float(error), float(np.abs(np.abs(values) - 1).max()))


def largest_step(method: str, shape: tuple[int, ...], steps: int = GRID) -> tuple[float, Waves]:
    """The largest step of a grid up to which all frequencies are within `ENOUGH`, and the waves of that step.

    The grid ends where the angle of the fastest wave in a step is pi: beyond, a frequency is ambiguous.
    """
    derivative = _end(method, shape)
    found = 0.0, Waves(math.inf, math.inf)
    for number in range(1, steps):
        dt = number / steps * math.pi / float(known(shape).max())
        tried = waves(derivative, dt, shape)
        if tried.error > ENOUGH:
            break
        found = dt, tried
    return found


def _cost(method: str) -> float:
    """Evaluations of the field on the whole lattice in a step; a turn of one of two sublattices is half of one."""
    evaluations = ml.method(method).evaluations
    return evaluations / 2 if method.startswith("SUBLATTICES") else evaluations


def step_rows() -> Iterator[list[str]]:
    for name, shape in LATTICES.items():
        for method in WAVE_METHODS:
            dt, found = largest_step(method, shape)
            cost = f"{_cost(method) / dt:.0f}" if dt else "-"
            yield [f"`{method}`", name, f"{dt:.3f}", f"{dt * known(shape).max():.2f}", cost, f"{found.growth:.0e}"]


class Peaks(NamedTuple):
    """For each wave number k of a chain, from -pi to pi, the frequency of the highest peak of |S+(k, w)|^2."""

    angles: np.ndarray
    found: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        return np.abs(self.found - 2 * EXCHANGE * (1 - np.cos(self.angles)))


SEEN = "SUBLATTICES[EA]", "spherical midpoint", "SUBLATTICES[SRKN6b]"
DT, WAVE_SPINS, WAVE_STEPS = 0.4, 64, 8192


def peaks(method: str, spins: int = WAVE_SPINS, steps: int = WAVE_STEPS) -> Peaks:
    """From weak white noise on the ferromagnetic chain; S+ = Sx + i Sy turns as exp(i w t)."""
    across = NOISE * np.random.default_rng(0).normal(size=(spins, 2))
    spin = np.concatenate([across, np.sqrt(1 - np.sum(across**2, axis=1, keepdims=True))], axis=1)
    start, field = ml.spins.SpinState(jnp.asarray(spin)), ml.spins.Exchange(EXCHANGE)
    path = ml.integrate(method, ml.spins.Spins(), field, start, dt=DT, steps=steps)
    assert bool(jnp.all(path.ok))
    x, y, _ = np.moveaxis(np.asarray(path.states.spin[:-1]), -1, 0)
    by_wave = np.fft.fftshift(np.fft.fft(x + 1j * y, axis=1), axes=1)
    window = np.hanning(steps + 1)[:-1, None]
    size = np.abs(np.fft.fft(window * by_wave, axis=0))
    frequencies = 2 * math.pi * np.fft.fftfreq(steps, DT)
    angles = 2 * math.pi * np.fft.fftshift(np.fft.fftfreq(spins))
    return Peaks(angles, np.array([peak_of(frequencies, column) for column in size.T]))


def peak_of(frequencies: np.ndarray, size: np.ndarray) -> float:
    """Between the bins, for a window of Hann: d = (2 r - 1)/(r + 1) bins towards the larger neighbour, r its share."""
    at = int(np.argmax(size))
    before, after = size[at - 1], size[(at + 1) % len(size)]
    ratio = max(before, after) / size[at]
    shift = (2 * ratio - 1) / (1 + ratio) * (1 if after > before else -1)
    return float(frequencies[at] + shift * (frequencies[1] - frequencies[0]))


def peak_rows(found: dict[str, Peaks]) -> Iterator[list[str]]:
    for method, seen in found.items():
        errors = seen.errors
        middle = len(errors) // 2
        cells = errors.max(), errors[middle + middle // 4], errors[0]
        yield [f"`{method}`", *(f"{x:.1e}" for x in cells)]


def _draw_waves(found: dict[str, Peaks], out: Path) -> None:
    """On the left the peaks over the closed form, on the right their errors."""
    k = np.linspace(0, math.pi, 200)
    peaks, errors = [Line("2 J (1 - cos k)", k / math.pi, 2 * EXCHANGE * (1 - np.cos(k)), GREY)], list[Line]()
    for method, colour, marker in zip(found, (BLUE, GREEN, ORANGE), "xso", strict=False):
        seen, options = found[method], {"markersize": 4, "markerfacecolor": "none"}
        half = seen.angles >= 0
        x = np.append(seen.angles[half], math.pi) / math.pi
        y, wrong = (np.append(values[half], values[0]) for values in (seen.found, seen.errors))
        peaks.append(Line(method, x, y, colour, marker, options=options))
        errors.append(Line(method, x[1:], np.maximum(wrong[1:], 1e-8), colour, marker, options=options))
    across = "wave number [π / lattice constant]"
    title = f"{SEEN[-1]}: at most {found[SEEN[-1]].errors.max():.1e}"
    panels = [
        Panel("Spin waves: peaks and theory", across, "frequency [J/ħ]", peaks),
        Panel(title, across, "error of a peak [J/ħ]", errors, {"yscale": "log"}),
    ]
    chart(out, [panels], (11, 4.2), left=0.06, right=0.985, top=0.92, bottom=0.13, wspace=0.25)


STEP_HEADS = (
    "method",
    "lattice",
    "largest h",
    "h times the highest w",
    "field evaluations per time",
    "size of a wave - 1",
)
LARGEST = Table(
    *("reports/heat.md", "steps", STEP_HEADS, step_rows),
    *("spins-steps", lambda row: row[1] == "chain of 32", (0, 2, 4, 5)),
)
PEAKS = Table(
    *("reports/heat.md", "peaks", ("method", "largest error of a peak", "at k = π/4", "at k = π")),
    data="spins-peaks",
    columns=(0, 1),
)


def dispersion(options: Any) -> None:
    found = {method: peaks(method) for method in SEEN}
    if options.write:
        _draw_waves(found, REPORTS / "spins-waves.png")
    PEAKS.show(options.write, peak_rows(found))
    LARGEST.show(options.write)
