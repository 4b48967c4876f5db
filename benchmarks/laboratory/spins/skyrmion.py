"""A skyrmion under interfacial Dzyaloshinskii-Moriya interaction: relaxed, then driven by a gradient of the field.

The field is along z, and a sine along x; the lattice is periodic, so that there are no edges. A skyrmion that moves
without changing its shape obeys Thiele's equation (A. A. Thiele, Phys. Rev. Lett. 30, 1973, 230): in our convention,
with G = sum S . (dS/dx x dS/dy) = 4 pi Q, D = sum (dS/dx)^2 and the force F = -sum dB/dx (1 - z) along x,

    G v_y = -gamma F + alpha D v_x,    -G v_x = alpha D v_y,

which follows from S' = gamma B x S + alpha S x S', S = S(place - X), multiplied by the derivatives of S. So it moves
across the gradient, and by damping slowly down it.
"""

import itertools
import math
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Table

import midlie_jax as ml
from midlie_jax.cli.figures import write
from midlie_jax.plot.style import BLACK, new_figure

SIZE, J, DMI, FIELD, GRADIENT = 48, 1.0, 0.3, 0.06, 3e-4
RELAXING, MOVING = 0.5, 0.1  # dampings
METHOD, DT = "SUBLATTICES[SRKN6b]", 0.4
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


def measured(size: int = SIZE, time: float = TIME, frames: int = FRAMES, method: str = METHOD) -> Moved:
    """Relaxed in the uniform field, then driven."""
    relaxing = round(RELAXED / DT)
    still = ml.integrate(
        method, ml.spins.Spins(RELAXING), _torque(size, 0.0), guess(size), dt=DT, steps=relaxing, save_every=relaxing
    )
    start = ml.spins.SpinState(still.states.spin[-1]).normalised()
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


def rows(found: Moved, count: int = 3) -> Iterator[list[str]]:
    """In some spans the mean velocity, and that of Thiele's equation for the shape in the middle."""
    places = place(found.spin)
    ends = np.linspace(0, len(found.times) - 1, count + 1).astype(int)
    for first, last in itertools.pairwise(ends):
        velocity = (places[last] - places[first]) / (found.times[last] - found.times[first])
        spin = found.spin[(first + last) // 2]
        numbers = (f"{1e3 * x:.2f}e-3" for x in (*velocity, *thiele(spin)))
        yield [f"{found.times[first]:.0f} to {found.times[last]:.0f}", f"{charge(spin):+.4f}", *numbers]


def draw(found: Moved, out: Path, count: int = 4) -> None:
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


TABLE = Table("reports/heat.md", "skyrmion", ("time", "charge Q", "v_x", "v_y", "Thiele's v_x", "Thiele's v_y"))


def measure(options: Any) -> None:
    found = measured()
    if options.write:
        draw(found, REPORTS / "spins-skyrmion.png")
        animate(found, REPORTS / "skyrmion.gif")
    TABLE.show(options.write, rows(found))
