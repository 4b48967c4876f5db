"""The libration spectrum of a levitated nanodumbbell in light that is polarised along z.

Two equal spheres in touch, whose moments are as 7 : 7 : 2, in the potential V0 (1 - u_z^2 + a u_y^2) of the light; u is
the long axis, and a the small difference between the stiffness about the two short axes. The dumbbell librates about z.
The spin about its long axis, which the gas drives and the light does not hold, couples the two librations like a
gyroscope: to first order in u_x and u_y, in units of I1,

    u_x'' + G u_x' + w_x^2 u_x + l u_y' = noise,    u_y'' + G u_y' + w_y^2 u_y - l u_x' = noise,    l = I3 Omega3 / I1

with w_x = w_y the two lines are at w +- l/2. A spin changes in the time I3/G, so a spectrum is the average of such
pairs over the Maxwell distribution of the spin (W. Bang et al., Phys. Rev. Research 2 (2020) 043054; see also arXiv
2509.01636, whose measured spectrum has such shoulders).
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Panel, Table, chart
from harness import Line as Drawn  # `Line` is that of a spectrum
from scipy import signal

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.plot.style import BLUE, GREEN, VERMILLION

STIFFNESS = 400.0  # V0/kT
SHARE = 2 / 7  # I3/I1
FRICTION = 1e-3  # per I1, in units of sqrt(kT/I1)
OMEGA = math.sqrt(2 * STIFFNESS)  # of libration in the plane x z, in the same units
BODIES = 3000
SAMPLES = 8192
RUNS = 3
_STEP, _EVERY = 0.1, 12  # the step in units of 1/OMEGA, and steps between samples
DIFFERENCES = 0.0, 0.04  # a, of the pictures
METHOD = "SYMMETRIC[BAOAB]"
_DENSITIES = 1e-5, 0.8  # of a picture
_SHOWN = 0.06  # from the middle of a picture to its ends, in units of the libration frequency


SPINS = np.linspace(0, 5, 2001)  # |Omega3| in units of its thermal size


class Line(NamedTuple):
    """The spectrum of some of the bodies.

    Attributes:
        density: of u_x, one-sided, per unit of the frequency; its integral is <u_x^2>.
        weights: how often their spins are near each of `SPINS`, summing to 1.
    """

    density: np.ndarray
    weights: np.ndarray

    @property
    def spin(self) -> float:
        """The root of the mean square of the spins, in units of the thermal size."""
        return float(np.sum(self.weights * SPINS**2) ** 0.5)


class Spectrum(NamedTuple):
    """Attributes:
    frequency: in units of the libration frequency.
    every, slow, fast: all bodies, and those thirds of them that spin least and most.
    """

    frequency: np.ndarray
    every: Line
    slow: Line
    fast: Line


def start(difference: float, seed: int = 0) -> ml.RigidState:
    """Bodies in equilibrium: u_x and u_y are normal, with the weight 1/u_z of the sphere."""
    random = np.random.default_rng(seed)
    place = random.normal(size=(3 * BODIES, 2)) / np.sqrt(2 * STIFFNESS * np.array([1, 1 + difference]))
    weight = 1 / np.sqrt(1 - np.sum(place**2, axis=1).clip(max=0.75))
    x, y = place[random.uniform(0, 2, 3 * BODIES) < weight][:BODIES].T
    axis = np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=-1)
    # The shortest turn from z, after any turn about z.
    turn = np.stack([1 + axis[:, 2], -axis[:, 1], axis[:, 0], np.zeros(BODIES)], axis=-1)
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    spin = random.uniform(0, 2 * math.pi, BODIES) / 2
    zero = np.zeros(BODIES)
    attitude = ml.so3.multiply(jnp.asarray(turn), jnp.asarray(np.stack([np.cos(spin), zero, zero, np.sin(spin)], -1)))
    momentum = random.normal(size=(BODIES, 3)) * np.sqrt([1, 1, SHARE])
    return ml.RigidState(jnp.asarray(momentum, jnp.float32), attitude.astype(jnp.float32))


def axis(state: ml.RigidState) -> tuple[Any, Any]:
    """u_x and u_y."""
    a, b, c, d = (state.attitude[..., i] for i in range(4))
    return 2 * (b * d + a * c), 2 * (c * d - a * b)


def spectrum(difference: float) -> Spectrum:
    """That of several runs of all bodies."""
    runs = [_values(difference, seed) for seed in range(RUNS)]
    spins = np.concatenate([np.abs(values[:, :, 1]) for values in runs]) / math.sqrt(SHARE)
    # Times are in units of 1/OMEGA, and OMEGA is at the frequency 1.
    rate = 2 * math.pi / (_STEP * _EVERY)
    options: Any = {"nperseg": SAMPLES, "detrend": False}
    parts = [signal.welch(values[:, :, 0], rate, **options) for values in runs]
    frequency, each = parts[0][0], np.concatenate([density for _, density in parts])
    order = np.argsort(spins.mean(axis=1))
    thirds = np.array_split(order, 3)
    lines = [Line(each[group].mean(axis=0), _weights(spins[group])) for group in (order, thirds[0], thirds[2])]
    return Spectrum(frequency, *lines)


def _values(difference: float, seed: int) -> np.ndarray:
    """u_x and the spin of all bodies at all samples, (n, k, 2)."""

    def light(t: Any, state: ml.RigidState) -> Any:
        del t
        x, y = axis(state)
        return STIFFNESS * (x * x + (1 + difference) * y * y)

    def observed(t: Any, state: ml.RigidState) -> Any:
        del t
        return jnp.stack([axis(state)[0], state.momentum[2]])

    def run(begin: ml.RigidState, keys: Any) -> Any:
        body = ml.RigidBody(jnp.asarray([1, 1, SHARE], jnp.float32))
        gas = ml.baths.Langevin(jnp.float32(1), jnp.float32(FRICTION), keys)
        torque = ml.torques.FromPotential(light)
        options: Any = {"dt": jnp.float32(_STEP / OMEGA), "steps": SAMPLES * _EVERY, "save_every": _EVERY}
        return ml.ensemble(METHOD, body, torque, begin, bath=gas, **options, observe=observed).states

    keys = jax.random.split(jax.random.key(100 + seed), BODIES)
    program = jax.jit(run, compiler_options=compiler_options(BODIES))
    return np.asarray(program(start(difference, seed), keys))[:, :SAMPLES]


def _weights(spins: np.ndarray) -> np.ndarray:
    counts, edges = np.histogram(spins, np.linspace(0, 5, 101))
    weights = np.interp(SPINS, (edges[1:] + edges[:-1]) / 2, counts)
    return weights / weights.sum()


def predicted(frequency: np.ndarray, weights: np.ndarray, difference: float) -> np.ndarray:
    """The density of u_x for the linear equations above, averaged over `SPINS` with these weights."""
    w = frequency[:, None]
    coupling = math.sqrt(SHARE) * SPINS / OMEGA
    friction, both = FRICTION / OMEGA, w * coupling
    x, y = (square - w * w + 1j * friction * w for square in (1, 1 + difference))
    shape = (np.abs(y) ** 2 + both**2) / np.abs(x * y - both**2) ** 2
    noise = 4 * friction / OMEGA**2 / (2 * math.pi)  # kT = I1 = 1
    return noise * shape @ weights


def smoothed(frequency: np.ndarray, weights: np.ndarray, difference: float) -> np.ndarray:
    """`predicted`, as a spectrum shows it that is made with Hann's window of all samples."""
    fine, width = 16, 4
    spacing = frequency[1] - frequency[0]
    offsets = np.arange(-width * fine, width * fine + 1) / fine
    with np.errstate(divide="ignore", invalid="ignore"):
        kernel = np.where(np.abs(np.abs(offsets) - 1) < 1e-9, 0.5, np.sinc(offsets) / (1 - offsets**2)) ** 2
    grid = frequency[0] + spacing * np.arange(-width * fine, (len(frequency) - 1 + width) * fine + 1) / fine
    density = np.concatenate(
        [predicted(part, weights, difference) for part in np.array_split(grid, len(grid) // 64 + 1)]
    )
    return np.convolve(density, kernel / kernel.sum(), mode="valid")[::fine]


def maxwell() -> np.ndarray:
    """The weights of thermal spins."""
    weights = np.exp(-(SPINS**2) / 2)
    return weights / weights.sum()


def shoulders(spin: float, difference: float) -> tuple[float, float]:
    """The two frequencies of bodies with this spin, in units of the libration frequency."""
    square = SHARE * spin**2 / OMEGA**2
    mean, product = (2 + difference + square) / 2, 1 + difference
    root = math.sqrt(mean**2 - product)
    return math.sqrt(mean - root), math.sqrt(mean + root)


def rows(panels: Sequence[tuple[float, Spectrum]]) -> Iterator[list[str]]:
    """The highest peak on each side of the middle, beside the two lines of the root mean square of the spins."""
    for difference, found in panels:
        middle = 1 + difference / 4
        for line, words in ((found.every, "all"), (found.slow, "slowest third"), (found.fast, "fastest third")):
            sides = found.frequency < middle, found.frequency > middle
            peaks = [found.frequency[side][np.argmax(line.density[side])] for side in sides]
            known = shoulders(line.spin, difference)
            size = np.sum(line.density) * found.frequency[1] * 2 * STIFFNESS
            cells = [f"{line.spin:.2f}", *(f"{a:.4f}, {b:.4f}" for a, b in (peaks, known)), f"{size:.3f}"]
            yield [f"{difference:g}", words, *cells]


def draw(panels: Sequence[tuple[float, Spectrum]], out: Path) -> None:
    """A panel for each difference of the two stiffnesses; measured as lines, predicted as dashes."""

    def panel(difference: float, found: Spectrum) -> Panel:
        shown = np.abs(found.frequency - 1 - difference / 4) < _SHOWN
        x, lines = found.frequency[shown], list[Drawn]()
        groups = ("all bodies", found.every, BLUE), ("fastest", found.fast, VERMILLION), ("slowest", found.slow, GREEN)
        for name, line, colour in groups[: 1 if difference else 3]:
            weights = maxwell() if line is found.every else line.weights
            lines.append(Drawn("", x, line.density[shown], colour, options={"linewidth": 1.3, "label": name}))
            lines.append(Drawn("", x, smoothed(x, weights, difference), colour, "--", options={"linewidth": 1}))
        words = f"Stiffness {100 * difference:.0f} % larger across: two shoulders, of fast spin"
        words = words if difference else "Equal stiffness: fast spin splits the line at ω ± l/2"
        up = "" if difference else "spectral density of $u_x$ [rad² per libration frequency]"
        scales = {"yscale": "log", "ylim": _DENSITIES}
        return Panel(
            words, "frequency [libration frequency]", up, lines, scales, lambda axes: axes.legend(frameon=False)
        )

    note = "Solid: simulated, all bodies and the thirds with the fastest and slowest spin. Dashed: theory."
    title = "The spin of a dumbbell shows in its libration spectrum"
    chart(out, [[panel(*one) for one in panels]], (12.5, 5.4), title, note, bottom=0.12, wspace=0.2)


TABLE = Table(
    *("reports/heat.md", "dumbbell"),
    ("a", "bodies", "spin / thermal spin", "simulated peaks", "theory: ω ± l/2", "⟨u_x²⟩ / (kT/2 V0)"),
    data="heat-dumbbell",
    key=lambda row: row[1] != "slowest third",
    columns=(0, 1, 3, 4, 5),
)


def measure(options: argparse.Namespace) -> None:
    panels = [(difference, spectrum(difference)) for difference in DIFFERENCES]
    if options.write:
        draw(panels, REPORTS / "dumbbell-spectrum.png")
    TABLE.show(options.write, rows(panels))
