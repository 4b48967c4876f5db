"""Spins on lattices: what methods keep, spin waves, rivals, walls and skyrmions: docs/reports/heat.md.

    python benchmarks/spins.py conservation [--write]  energy, total spin and lengths in runs of a chain
    python benchmarks/spins.py dispersion [--write]    spin waves beside their closed form
    python benchmarks/spins.py lattice [--write]       steps a second of a million spins, beside a copy of them
    python benchmarks/spins.py rivals [--write]        error against time, beside Spirit; spins-rivals.png
    python benchmarks/spins.py wall [--write]          a domain wall in a field, beside Walker; spins-wall.png
    python benchmarks/spins.py skyrmion [--write]      a skyrmion beside Thiele; spins-skyrmion.png, skyrmion.gif

Times are processor times on one core; programs that are compared take turns. Spirit is measured if it is installed:
`pip install spirit`.
"""

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
import one_core  # noqa: F401
from harness import REPORTS, Compiled, Line, Panel, Table, chart, compiled, in_turn, main
from matplotlib import colormaps
from PIL import Image

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax._xla.fusion import split
from midlie_jax.advice.timing import timed_in_turn
from midlie_jax.cli.figures import write
from midlie_jax.plot.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, new_figure
from midlie_jax.spins.turns import turned

PAGE = "reports/heat.md"


def random(shape: tuple[int, ...], seed: int) -> ml.spins.SpinState:
    """Spins (*shape, 3) that point anywhere, the state of infinite temperature."""
    drawn = np.random.default_rng(seed).normal(size=(*shape, 3))
    return ml.spins.SpinState(jnp.asarray(drawn / np.linalg.norm(drawn, axis=-1, keepdims=True)))


# ---- a closed Heisenberg chain, H = sum S_i . S_i+1 ----

CHAIN, CHAIN_TIME = 64, 20.0
CHAIN_STEPS = 0.1, 0.2
CHAIN_METHODS = "SUBLATTICES[EA]", "SUBLATTICES[KL6]", "spherical midpoint", "Lie midpoint of spins", "RK4"


def errors(method: str, dt: float) -> tuple[float, float, float]:
    body, field, start = ml.spins.Spins(), ml.spins.Exchange(-1.0), random((CHAIN,), 0)
    path = ml.integrate(method, body, field, start, dt=dt, steps=round(CHAIN_TIME / dt))
    assert bool(jnp.all(path.ok))
    energy = np.asarray(ml.observe.energy(body, field, path))
    spin = np.asarray(path.states.spin)
    total = np.linalg.norm(spin.sum(axis=1) - spin[0].sum(axis=0), axis=-1)
    lengths = np.abs(np.linalg.norm(spin, axis=-1) - 1)
    return float(np.abs(energy - energy[0]).max() / CHAIN), float(total.max() / CHAIN), float(lengths.max())


def chain_rows() -> Iterator[list[str]]:
    for method in CHAIN_METHODS:
        for dt in CHAIN_STEPS:
            yield [f"`{method}`", f"{dt:g}", *(f"{error:.1e}" for error in errors(method, dt))]


CONSERVATION = Table(
    *(PAGE, "conservation"),
    ("method", "h", "energy error / N", "total spin error / N", "length error"),
    *(chain_rows, "spins-conservation", lambda row: row[1] == "0.2", (0, 2, 3, 4)),
)


# ---- spin waves of a Heisenberg ferromagnet: w(k) = 2 J sum over axes of (1 - cos k) ----
#
# The frequencies are those of one step, linear about the ferromagnet: the eigenvalues of its derivative.

WAVE_METHODS = "SUBLATTICES[EA]", "SUBLATTICES[SRKN6b]", "SUBLATTICES[KL6]", "spherical midpoint", "RK4", "GBS12"
LATTICES = {"chain of 32": (32,), "square of 8 x 8": (8, 8)}
GRID = 60  # steps that are tried
ENOUGH = 1e-3  # relative error of a frequency
EXCHANGE = 1.0


def known_waves(shape: tuple[int, ...]) -> np.ndarray:
    parts = [2 * EXCHANGE * (1 - np.cos(2 * math.pi * np.fft.fftfreq(n))) for n in shape]
    return np.asarray(sum(np.meshgrid(*parts, indexing="ij")))


def _end(method: str, shape: tuple[int, ...]) -> Any:
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
    expected = np.sort(np.repeat(known_waves(shape).ravel(), 2))
    moving = expected > 1e-9
    error = np.abs(found[moving] / expected[moving] - 1).max()
    return Waves(float(error), float(np.abs(np.abs(values) - 1).max()))


def largest_step(method: str, shape: tuple[int, ...]) -> tuple[float, Waves]:
    """The largest step of a grid up to which all frequencies are within `ENOUGH`, and the waves of that step.

    The grid ends where the angle of the fastest wave in a step is pi: beyond, a frequency is ambiguous.
    """
    derivative = _end(method, shape)
    found = 0.0, Waves(math.inf, math.inf)
    for number in range(1, GRID):
        dt = number / GRID * math.pi / float(known_waves(shape).max())
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
            yield [
                f"`{method}`",
                name,
                f"{dt:.3f}",
                f"{dt * known_waves(shape).max():.2f}",
                cost,
                f"{found.growth:.0e}",
            ]


STEP_HEADS = (
    "method",
    "lattice",
    "largest h",
    "h times the highest w",
    "field evaluations per time",
    "size of a wave - 1",
)
LARGEST = Table(
    *(PAGE, "steps", STEP_HEADS, step_rows), *("spins-steps", lambda row: row[1] == "chain of 32", (0, 2, 4, 5))
)


# ---- the wall: its speed beside Walker's closed form ----
#
# A chain with exchange J, easy axis z, hard axis x,
#
#     H = -J sum S_i . S_i+1 - K sum z^2 + K' sum x^2 - B sum z.
#
# In the continuum a wall between z = 1 on the left and z = -1 on the right, with its spins at the azimuth p from x, is
# tan(theta/2) = exp((position - X)/d) with the width d = sqrt(J/(2 (K + K' cos^2 p))). In S' = gamma B x S + alpha S x
# S' it moves by theta' = -sin(theta) X'/d, and
#
#     theta' = gamma K' sin(theta) sin 2p - alpha sin(theta) p',    sin(theta) p' = gamma B sin(theta) + alpha theta'.
#
# Below the field alpha K' the azimuth rests:
#
#     X' = gamma d B / alpha,    sin 2p = -B / (alpha K')
#
# (N. L. Schryer and L. R. Walker, J. Appl. Phys. 45, 1974, 5406). Above, the wall precesses:
#
#     (1 + alpha^2) p' = gamma (B + alpha K' sin 2p),    X' = d (gamma B - p') / alpha,
#
# which neglects that the width changes while it does.

J, EASY, HARD, DAMPING = 1.0, 0.02, 0.004, 0.2
WALKER = DAMPING * HARD
SHARES = 0.25, 0.5, 0.75, 0.9, 1.5, 2.0, 3.0, 4.0, 6.0  # of Walker's field
METHOD, WALL_DT, WALL_TIME, WALL_SPINS = "SUBLATTICES[SRKN6b]", 0.5, 8000.0, 320
SAVED = 400


class Speed(NamedTuple):
    """The mean speed of a wall in a field, lattice constants over time: found, and known."""

    field: float
    found: float
    known: float


def width(azimuth: Any) -> Any:
    return np.sqrt(J / (2 * (EASY + HARD * np.cos(azimuth) ** 2)))


def _resting(field: float) -> float:
    return math.pi / 2 + (0.5 * math.asin(field / WALKER) if field <= WALKER else 0.0)


def known(field: float) -> float:
    if field <= WALKER:
        return float(width(_resting(field)) * field / DAMPING)
    azimuth = np.linspace(0, math.pi, 4000, endpoint=False)
    turning = (field + DAMPING * HARD * np.sin(2 * azimuth)) / (1 + DAMPING**2)
    return float(np.mean(width(azimuth) * (field - turning) / DAMPING / turning) / np.mean(1 / turning))


def found(field: float) -> float:
    """The mean speed on the chain after a tenth of the time, over whole half turns if the wall precesses."""
    place = np.arange(WALL_SPINS) - 40.0
    azimuth = _resting(field)
    theta = 2 * np.arctan(np.exp(np.minimum(place / width(azimuth), 300)))
    along, across = np.cos(azimuth) * np.sin(theta), np.sin(azimuth) * np.sin(theta)
    start = np.stack([along, across, np.cos(theta)], axis=-1)
    torque = (
        ml.spins.Exchange(J, periodic=False)
        + ml.spins.Anisotropy(EASY)
        + ml.spins.Anisotropy(-HARD, (1.0, 0.0, 0.0))
        + ml.spins.AppliedField(jnp.array([0.0, 0.0, field]))
    )
    every = max(1, round(WALL_TIME / WALL_DT) // SAVED)
    run: Any = {"dt": WALL_DT, "steps": every * SAVED, "save_every": every}
    path = ml.integrate(METHOD, ml.spins.Spins(DAMPING), torque, ml.spins.SpinState(jnp.asarray(start)), **run)
    assert bool(jnp.all(path.ok))
    spin = np.asarray(path.states.spin)
    where = spin[..., 2].sum(axis=1) / 2
    azimuth = np.unwrap(np.arctan2(spin[..., 1].sum(axis=1), spin[..., 0].sum(axis=1)))
    first, last = SAVED // 10, SAVED
    if field > WALKER:
        turns = np.floor((azimuth[-1] - azimuth[first]) / math.pi)
        last = int(np.argmin(np.abs(azimuth - azimuth[first] - turns * math.pi)))
    return float((where[last] - where[first]) / ((last - first) * every * WALL_DT))


def wall_speeds() -> list[Speed]:
    return [Speed(share * WALKER, found(share * WALKER), known(share * WALKER)) for share in SHARES]


def wall_rows(speeds: Sequence[Speed]) -> Iterator[list[str]]:
    for one in speeds:
        cells = f"{one.found:.5f}", f"{one.known:.5f}", f"{one.found / one.known - 1:+.1e}"
        yield [f"{one.field / WALKER:g}", *cells]


def _draw_wall(speeds: Sequence[Speed], out: Path) -> None:
    most = max(one.field for one in speeds) / WALKER
    names = "theory: gamma d B / alpha", "theory: the wall precesses"
    parts = np.linspace(0, 1, 100), np.linspace(1.0001, 1.05 * most, 400)
    lines = [
        Line(name, part, [known(x * WALKER) for x in part], VERMILLION) for name, part in zip(names, parts, strict=True)
    ]
    lines.append(Line("simulated", [one.field / WALKER for one in speeds], [one.found for one in speeds], BLUE, "o"))
    words = "field [Walker's field alpha K']", "speed [lattice constants per ħ/J]"
    title = "Above Walker's field a wall slows down"
    one = Panel(title, *words, lines, more=lambda axes: axes.set(xlim=(0, None), ylim=(0, None)))
    chart(out, [[one]], (8.2, 4.0), left=0.1, right=0.98, top=0.9, bottom=0.14)


def words(rows: list[dict[str, str]]) -> list[str]:
    off = max(abs(float(row["simulated / theory - 1"])) for row in rows)
    return [f"The simulated speeds agree with theory within {off:.1e} (relative), below and above Walker's field.", ""]


WALL = Table(
    *(PAGE, "wall", ("B / (alpha K')", "simulated speed", "theory", "simulated / theory - 1")),
    data="spins-wall",
    words=words,
)


def wall(options: Any) -> None:
    found = wall_speeds()
    if options.write:
        _draw_wall(found, REPORTS / "spins-wall.png")
    WALL.show(options.write, wall_rows(found))


# ---- the skyrmion under interfacial Dzyaloshinskii-Moriya interaction: relaxed, then driven by a gradient ----
#
# The field is along z, and a sine along x; the lattice is periodic, so that there are no edges. A skyrmion that moves
# without changing its shape obeys Thiele's equation (A. A. Thiele, Phys. Rev. Lett. 30, 1973, 230): in our convention,
# with G = sum S . (dS/dx x dS/dy) = 4 pi Q, D = sum (dS/dx)^2 and the force F = -sum dB/dx (1 - z) along x,
#
#     G v_y = -gamma F + alpha D v_x,    -G v_x = alpha D v_y,
#
# which follows from S' = gamma B x S + alpha S x S', S = S(place - X), multiplied by the derivatives of S. So it moves
# across the gradient, and by damping slowly down it.

SIZE, DMI, FIELD, GRADIENT = 48, 0.3, 0.06, 3e-4
RELAXING, MOVING = 0.5, 0.1  # dampings
SKYRMION_DT = 0.4
RELAXED, SKYRMION_TIME, FRAMES = 400.0, 6000.0, 30


class Moved(NamedTuple):
    """Times of the saved states, (frames + 1,), and their spins, (frames + 1, n, n, 3)."""

    times: np.ndarray
    spin: np.ndarray


def _angle_of(size: int) -> np.ndarray:
    """2 pi x / size of each x, zero in the middle, where the field grows fastest."""
    return 2 * math.pi / size * (np.arange(size) - (size - 1) / 2)


def _torque(size: int, gradient: float) -> Any:
    field = np.zeros((size, size, 3))
    field[..., 2] = FIELD + gradient * size / (2 * math.pi) * np.sin(_angle_of(size))[:, None]
    vectors = DMI * np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z x bond
    return ml.spins.Exchange(J) + ml.spins.DzyaloshinskiiMoriya(vectors) + ml.spins.AppliedField(jnp.asarray(field))


def guess(size: int) -> ml.spins.SpinState:
    x, y = (np.arange(size) - (size - 1) / 2 for _ in range(2))
    x, y = np.meshgrid(x, y, indexing="ij")
    theta = 4 * np.arctan(np.exp(-np.hypot(x, y) / 5))
    azimuth = np.arctan2(y, x)
    spin = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    return ml.spins.SpinState(jnp.asarray(spin))


def skyrmion_states() -> Moved:
    relaxing, every = round(RELAXED / SKYRMION_DT), round(SKYRMION_TIME / SKYRMION_DT) // FRAMES

    def run(damping: float, gradient: float, start: ml.spins.SpinState, **options: Any) -> Any:
        torque = _torque(SIZE, gradient)
        path = ml.integrate(METHOD, ml.spins.Spins(damping), torque, start, dt=SKYRMION_DT, **options)
        assert bool(jnp.all(path.ok))
        return path.states.spin

    last = run(RELAXING, 0.0, guess(SIZE), steps=relaxing, save_every=relaxing)[-1]
    start = ml.spins.SpinState(last / jnp.linalg.norm(last, axis=-1, keepdims=True))
    spin = run(MOVING, GRADIENT, start, steps=every * FRAMES, save_every=every)
    return Moved(SKYRMION_DT * every * np.arange(FRAMES + 1), np.asarray(spin))


def charge(spin: np.ndarray) -> float:
    """The topological charge Q of spins (n, m, 3): the solid angles of two triangles a cell, over 4 pi."""
    right, above = np.roll(spin, -1, axis=0), np.roll(spin, -1, axis=1)
    across = np.roll(right, -1, axis=1)
    return float((_angle(spin, right, across) + _angle(spin, across, above)).sum() / (4 * math.pi))


def _angle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The solid angle of a spherical triangle (A. van Oosterom and J. Strackee, 1983)."""
    volume = np.sum(a * np.cross(b, c), axis=-1)
    return 2 * np.arctan2(volume, 1 + np.sum(a * b + b * c + c * a, axis=-1))


def place(spin: np.ndarray) -> np.ndarray:
    """The middle (..., 2) of the spins that point down, which stay away from the ends of x."""
    size = spin.shape[-2]
    weight = np.maximum(-spin[..., 2], 0)
    total = weight.sum(axis=(-2, -1))
    x = (weight.sum(axis=-1) * np.arange(spin.shape[-3])).sum(axis=-1) / total
    turns = (weight.sum(axis=-2) * np.exp(2j * math.pi * np.arange(size) / size)).sum(axis=-1)
    unwrapped = np.unwrap(np.angle(turns)) if turns.ndim else np.angle(turns)
    return np.stack([x, unwrapped * size / (2 * math.pi)], axis=-1)


def thiele(spin: np.ndarray) -> np.ndarray:
    g = 4 * math.pi * charge(spin)
    change = (np.roll(spin, -1, axis=0) - np.roll(spin, 1, axis=0)) / 2
    d = float((change**2).sum())
    push = GRADIENT * float((np.cos(_angle_of(len(spin)))[:, None] * (1 - spin[..., 2])).sum())  # -F
    y = push * g / (g**2 + (MOVING * d) ** 2)
    return np.array([-MOVING * d * y / g, y])


def skyrmion_rows(found: Moved, count: int = 3) -> Iterator[list[str]]:
    places = place(found.spin)
    ends = np.linspace(0, len(found.times) - 1, count + 1).astype(int)
    for first, last in itertools.pairwise(ends):
        velocity = (places[last] - places[first]) / (found.times[last] - found.times[first])
        spin = found.spin[(first + last) // 2]
        numbers = (f"{1e3 * x:.2f}e-3" for x in (*velocity, *thiele(spin)))
        yield [f"{found.times[first]:.0f} to {found.times[last]:.0f}", f"{charge(spin):+.4f}", *numbers]


def _draw_skyrmion(found: Moved, out: Path, count: int = 4) -> None:
    figure = new_figure(10.4, 3.35)
    panels = figure.subplots(1, count, sharey=True)
    figure.subplots_adjust(left=0.055, right=0.93, top=0.84, bottom=0.15, wspace=0.06)
    title = "The skyrmion moves across the slope of the field"
    figure.suptitle(title, x=0.055, y=0.985, ha="left", fontsize=11, weight="bold")
    size = found.spin.shape[1]
    image = None
    every = slice(None, None, 2)
    x, y = np.meshgrid(np.arange(size)[every], np.arange(size)[every], indexing="ij")
    for panel, at in zip(panels, np.linspace(0, len(found.times) - 1, count).astype(int), strict=True):
        spin = found.spin[at]
        image = panel.imshow(spin[..., 2].T, origin="lower", cmap="RdBu", vmin=-1.2, vmax=1.2)
        u, v = (spin[every, every, i] for i in (0, 1))
        seen = np.hypot(u, v) > 0.2
        panel.quiver(x[seen], y[seen], u[seen], v[seen], color=BLACK, scale=26, width=0.006, pivot="mid")
        panel.set_title(f"t = {found.times[at]:.0f} ħ/J", loc="left", fontsize=9)
        panel.set_xlabel("x [lattice constants]")
    panels[0].set_ylabel("y [lattice constants]")
    bar = figure.colorbar(image, cax=figure.add_axes((0.945, 0.15, 0.012, 0.69)), ticks=[-1, 0, 1])
    bar.set_label("z", rotation=0)
    write(figure, str(out))


def animate(found: Moved, out: Path, scale: int = 4, seconds: float = 4.0) -> None:
    frames: list[Any] = []
    for spin in found.spin:
        colours = colormaps["RdBu"]((spin[..., 2].T[::-1] + 1.2) / 2.4)[..., :3]
        picture = Image.fromarray((255 * colours).astype(np.uint8))
        picture = picture.resize((scale * picture.width, scale * picture.height), Image.Resampling.BICUBIC)
        frames.append(picture.quantize(32, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE))
    pause = round(1000 * seconds / len(frames))
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=pause, loop=0, optimize=True)


SKYRMION = Table(PAGE, "skyrmion", ("time", "charge Q", "v_x", "v_y", "Thiele's v_x", "Thiele's v_y"))


def skyrmion(options: Any) -> None:
    found = skyrmion_states()
    if options.write:
        _draw_skyrmion(found, REPORTS / "spins-skyrmion.png")
        animate(found, REPORTS / "skyrmion.gif")
    SKYRMION.show(options.write, skyrmion_rows(found))


# ---- the predictor and corrector of P. Depondt and F. G. Mertens (J. Phys.: Condens. Matter 21, 2009, 336005) ----
#
# Each spin turns about its field; with the mean of the fields at both ends it turns again from the start. Second order.
# It has what makes our own methods fast: turns without sines, by a series, barriers that keep XLA from computing a
# field again for each neighbour that reads it, and the same options of the compiler.


def _exchange(spin: Any) -> Any:
    return tuple(sum(jnp.roll(x, step, axis) for axis in range(x.ndim) for step in (1, -1)) for x in spin)


def depondt(spin: Any, dt: Any, steps: Any) -> Any:
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


@contextlib.contextmanager
def spirit_lattice(shape: tuple[int, int]) -> Generator[Any]:
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
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(nowhere)
        os.close(kept)


def spirit_runner(own: Any, solver: str, start: np.ndarray, dt: float, steps: int) -> Callable[[], np.ndarray]:
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


def measured(
    shape: tuple[int, int] = SHAPE,
    time: float = TIME,
    ladders: dict[str, tuple[float, ...]] = LADDERS,
    rounds: int = ROUNDS,
    reference: tuple[str, float] = REFERENCE,
) -> list[Rung]:
    start = random(shape, 1)
    cases = [(m, dt, round(time / dt)) for m, steps in ladders.items() for dt in steps]
    if find_spec("spirit") is None:
        print("Spirit is not installed (pip install spirit); it is left out.")
        cases = [case for case in cases if case[0] not in SOLVERS]
    method, dt = reference
    known, ok = _ours(method, start, dt, round(time / dt))()
    assert bool(ok)
    with contextlib.ExitStack() as stack:
        theirs = any(case[0] in SOLVERS for case in cases)
        own = stack.enter_context(spirit_lattice(shape)) if theirs else None

        def run_of(method: str, dt: float, steps: int) -> Callable[[], Any]:
            if method in SOLVERS:
                run = spirit_runner(own, method, np.asarray(start.spin), dt, steps)
                return lambda: (run(), True)
            if method == JAX:
                return lambda: jax.block_until_ready((depondt(start.spin, dt, steps), True))
            return _ours(method, start, dt, steps)

        runs = [run_of(*case) for case in cases]
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
    *(PAGE, "rivals", ("method", "ns per spin-step", *(f"error {x:g}" for x in TARGETS))),
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


def lattice_rows() -> Iterator[tuple[str, ...]]:
    for shape in SHAPES:
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
            limit, *times = (per * seconds for seconds in in_turn(runs, 5))
            for method, time in zip((*(f"`{name}`" for name in TIMED), JAX), times, strict=True):
                cells = f"{time:.3g}", f"{1e3 / time:.3g}", f"{limit / time:.2g}"
                yield f"{math.prod(shape):,}", dtype, method, *cells
            bandwidth = NUMBERS * spin.dtype.itemsize / limit
            cells = f"{limit:.3g}", f"{1e3 / limit:.3g}", f"{bandwidth:.3g} GB/s"
            yield f"{math.prod(shape):,}", dtype, "a copy", *cells


LATTICE = Table(
    *(PAGE, "lattice"),
    ("spins", "dtype", "method", "ns per spin-step", "million spin-steps per second", "relative to a copy"),
    *(lattice_rows, "spins-lattice", lambda row: row[:2] == ["1,000,000", "float64"], (2, 3, 4, 5)),
)

PARTS = {
    "conservation": CONSERVATION,
    "dispersion": LARGEST,
    "lattice": LATTICE,
    "rivals": measure,
    "wall": wall,
    "skyrmion": skyrmion,
}

if __name__ == "__main__":
    main(__doc__, PARTS)
