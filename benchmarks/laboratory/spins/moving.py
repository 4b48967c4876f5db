"""Spins that move: a domain wall driven by a field, beside Walker, and a skyrmion down a slope, beside Thiele."""

import itertools
import math
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart

import midlie_jax as ml
from midlie_jax.cli.figures import write
from midlie_jax.plot.style import BLACK, BLUE, VERMILLION, new_figure

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
METHOD, WALL_DT, WALL_TIME, SPINS = "SUBLATTICES[SRKN6b]", 0.5, 8000.0, 320
SAVED = 400


class Speed(NamedTuple):
    """The mean speed of a wall in a field, lattice constants over time: found, and known."""

    field: float
    found: float
    known: float


def width(azimuth: Any) -> Any:
    return np.sqrt(J / (2 * (EASY + HARD * np.cos(azimuth) ** 2)))


def _resting(field: float) -> float:
    """The azimuth of the wall below Walker's field; above, that of the widest wall."""
    return math.pi / 2 + (0.5 * math.asin(field / WALKER) if field <= WALKER else 0.0)


def known(field: float) -> float:
    """The mean speed in the continuum."""
    if field <= WALKER:
        return float(width(_resting(field)) * field / DAMPING)
    azimuth = np.linspace(0, math.pi, 4000, endpoint=False)
    turning = (field + DAMPING * HARD * np.sin(2 * azimuth)) / (1 + DAMPING**2)
    return float(np.mean(width(azimuth) * (field - turning) / DAMPING / turning) / np.mean(1 / turning))


def found(
    field: float, *, method: str = METHOD, spins: int = SPINS, time: float = WALL_TIME, saved: int = SAVED
) -> float:
    """The mean speed on the chain after a tenth of the time, over whole half turns if the wall precesses."""
    place = np.arange(spins) - 40.0
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
    every = max(1, round(time / WALL_DT) // saved)
    run: Any = {"dt": WALL_DT, "steps": every * saved, "save_every": every}
    path = ml.integrate(method, ml.spins.Spins(DAMPING), torque, ml.spins.SpinState(jnp.asarray(start)), **run)
    assert bool(jnp.all(path.ok))
    spin = np.asarray(path.states.spin)
    where = spin[..., 2].sum(axis=1) / 2
    azimuth = np.unwrap(np.arctan2(spin[..., 1].sum(axis=1), spin[..., 0].sum(axis=1)))
    first, last = saved // 10, saved
    if field > WALKER:
        turns = np.floor((azimuth[-1] - azimuth[first]) / math.pi)
        last = int(np.argmin(np.abs(azimuth - azimuth[first] - turns * math.pi)))
    return float((where[last] - where[first]) / ((last - first) * every * WALL_DT))


def wall_speeds(shares: Sequence[float] = SHARES, **options: Any) -> list[Speed]:
    return [Speed(share * WALKER, found(share * WALKER, **options), known(share * WALKER)) for share in shares]


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
    *("reports/heat.md", "wall", ("B / (alpha K')", "simulated speed", "theory", "simulated / theory - 1")),
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
DT = 0.4
RELAXED, TIME, FRAMES = 400.0, 6000.0, 30


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
    """Spins down in the middle, which turn outwards and up within a few places."""
    x, y = (np.arange(size) - (size - 1) / 2 for _ in range(2))
    x, y = np.meshgrid(x, y, indexing="ij")
    theta = 4 * np.arctan(np.exp(-np.hypot(x, y) / 5))
    azimuth = np.arctan2(y, x)
    spin = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    return ml.spins.SpinState(jnp.asarray(spin))


def skyrmion_states(size: int = SIZE, time: float = TIME, frames: int = FRAMES, method: str = METHOD) -> Moved:
    """Relaxed in the uniform field, then driven."""
    relaxing = round(RELAXED / DT)
    still = ml.integrate(
        method, ml.spins.Spins(RELAXING), _torque(size, 0.0), guess(size), dt=DT, steps=relaxing, save_every=relaxing
    )
    last = still.states.spin[-1]
    start = ml.spins.SpinState(last / jnp.linalg.norm(last, axis=-1, keepdims=True))
    every = max(1, round(time / DT) // frames)
    path = ml.integrate(
        method, ml.spins.Spins(MOVING), _torque(size, GRADIENT), start, dt=DT, steps=every * frames, save_every=every
    )
    assert bool(jnp.all(still.ok))
    assert bool(jnp.all(path.ok))
    return Moved(DT * every * np.arange(frames + 1), np.asarray(path.states.spin))


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
    """The velocity (2,) of Thiele's equation for the shape of a skyrmion."""
    g = 4 * math.pi * charge(spin)
    change = (np.roll(spin, -1, axis=0) - np.roll(spin, 1, axis=0)) / 2
    d = float((change**2).sum())
    push = GRADIENT * float((np.cos(_angle_of(len(spin)))[:, None] * (1 - spin[..., 2])).sum())  # -F
    y = push * g / (g**2 + (MOVING * d) ** 2)
    return np.array([-MOVING * d * y / g, y])


def skyrmion_rows(found: Moved, count: int = 3) -> Iterator[list[str]]:
    """In some spans the mean velocity, and that of Thiele's equation for the shape in the middle."""
    places = place(found.spin)
    ends = np.linspace(0, len(found.times) - 1, count + 1).astype(int)
    for first, last in itertools.pairwise(ends):
        velocity = (places[last] - places[first]) / (found.times[last] - found.times[first])
        spin = found.spin[(first + last) // 2]
        numbers = (f"{1e3 * x:.2f}e-3" for x in (*velocity, *thiele(spin)))
        yield [f"{found.times[first]:.0f} to {found.times[last]:.0f}", f"{charge(spin):+.4f}", *numbers]


def _draw_skyrmion(found: Moved, out: Path, count: int = 4) -> None:
    """The lattice at some times; colours are the component z, arrows the others."""
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
    """A GIF of the component z: red down, blue up."""
    from matplotlib import colormaps
    from PIL import Image

    frames: list[Any] = []
    for spin in found.spin:
        colours = colormaps["RdBu"]((spin[..., 2].T[::-1] + 1.2) / 2.4)[..., :3]
        picture = Image.fromarray((255 * colours).astype(np.uint8))
        picture = picture.resize((scale * picture.width, scale * picture.height), Image.Resampling.BICUBIC)
        frames.append(picture.quantize(32, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE))
    whole = BytesIO()
    pause = round(1000 * seconds / len(frames))
    frames[0].save(whole, format="GIF", save_all=True, append_images=frames[1:], duration=pause, loop=0, optimize=True)
    out.write_bytes(whole.getvalue())


SKYRMION = Table("reports/heat.md", "skyrmion", ("time", "charge Q", "v_x", "v_y", "Thiele's v_x", "Thiele's v_y"))


def skyrmion(options: Any) -> None:
    found = skyrmion_states()
    if options.write:
        _draw_skyrmion(found, REPORTS / "spins-skyrmion.png")
        animate(found, REPORTS / "skyrmion.gif")
    SKYRMION.show(options.write, skyrmion_rows(found))
