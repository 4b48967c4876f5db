"""Spin waves of a Heisenberg ferromagnet: what a method makes of w(k) = 2 J sum over axes of (1 - cos k).

Two measurements. `frequencies` are those of one step, linear about the ferromagnet: the eigenvalues of its derivative.
`peaks` are those of the spectrum of a run from weak white noise, as an experiment would see them.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart

import midlie_jax as ml
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE

METHODS = "SUBLATTICES[EA]", "SUBLATTICES[SRKN6b]", "SUBLATTICES[KL6]", "spherical midpoint", "RK4", "GBS12"
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
        run = ml.integrate(method, ml.spins.Spins(), field, start, dt=dt, steps=1, adjoint=ml.Forward())
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


def rows() -> Iterator[list[str]]:
    for name, shape in LATTICES.items():
        for method in METHODS:
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
DT, SPINS, STEPS = 0.4, 64, 8192


def peaks(method: str, spins: int = SPINS, steps: int = STEPS) -> Peaks:
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


def draw(found: dict[str, Peaks], out: Path) -> None:
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
    *("reports/heat.md", "steps", STEP_HEADS, rows),
    *("spins-steps", lambda row: row[1] == "chain of 32", (0, 2, 4, 5)),
)
PEAKS = Table(
    *("reports/heat.md", "peaks", ("method", "largest error of a peak", "at k = π/4", "at k = π")),
    data="spins-peaks",
    columns=(0, 1),
)


def measure(options: Any) -> None:
    found = {method: peaks(method) for method in SEEN}
    if options.write:
        draw(found, REPORTS / "spins-waves.png")
    PEAKS.show(options.write, peak_rows(found))
    LARGEST.show(options.write)
