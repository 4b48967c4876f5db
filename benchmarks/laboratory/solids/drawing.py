"""Draws the block that is thrown in gravity: five frames in one picture, and a GIF of the flight in slow motion."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import midlie_jax as ml
from midlie_jax.cli.figures import few_colours
from midlie_jax.plot.style import BLUE, GREY, new_figure

from .block import Block, block, limit

CELLS = (8, 4, 2)
GRAVITY, FLIGHT = 9.81, 0.5  # m/s^2, s
FRAMES, STILLS, RATE = 49, 5, 12  # frames of the GIF, of the picture, and frames a second
_LIGHT = np.array([-0.4, -0.6, 0.7]) / np.linalg.norm([-0.4, -0.6, 0.7])
_WIDTH, _HEIGHT, _DPI = 5.6, 3.0, 80
_SHADES = 12
_GIF_COLOURS = 32


class Flight(NamedTuple):
    """Times (k,), places of nodes (k, n, 3) and centre of mass (k, 3), and the triangles of the surface (f, 3)."""

    times: np.ndarray
    places: np.ndarray
    middle: np.ndarray
    triangles: np.ndarray


def surface(corners: np.ndarray) -> np.ndarray:
    """The triangles (f, 3) that belong to one tetrahedron only."""
    faces = np.concatenate([np.delete(corners, k, axis=1) for k in range(4)])
    faces, counts = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    return faces[counts == 1]


def flight() -> Flight:
    """The flight in gravity, by Verlet."""
    made: Block = block(CELLS)
    mass, intervals = made.body.mass, FRAMES - 1

    def weight(t: Any, state: ml.ParticleState) -> Any:
        del t
        return GRAVITY * jnp.sum(mass[:, 0] * state.position[:, 2])

    forces = ml.torques.FromPotential(made.energy) + ml.torques.FromPotential(weight)
    every = int(np.ceil(FLIGHT / intervals / (limit(CELLS) / 3)))
    run: Any = {"dt": FLIGHT / (intervals * every), "steps": intervals * every, "save_every": every}
    path = ml.integrate("Verlet", made.body, forces, made.start, **run)
    places = np.asarray(path.states.position)
    middle = np.einsum("n,knc->kc", np.asarray(mass[:, 0] / jnp.sum(mass)), places)
    return Flight(np.asarray(path.times), places, middle, surface(np.asarray(made.corners)))


def _block(axes: Any, places: np.ndarray, triangles: np.ndarray) -> Any:
    """Adds the surface, seen along y: the far triangles first, each as light as it faces the light."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    spanned = places[triangles]
    order = np.argsort(-spanned[:, :, 1].mean(axis=1))
    normals = np.cross(spanned[:, 1] - spanned[:, 0], spanned[:, 2] - spanned[:, 0])
    outward = np.sign(normals[:, 1:2]) * -normals  # towards the viewer, at negative y
    share = np.clip(outward @ _LIGHT / np.linalg.norm(normals, axis=1), 0, 1)
    share = np.round(share * _SHADES) / _SHADES
    shade = share[:, None]  # from a darker to a lighter blue
    faces = np.clip(np.array(to_rgb(BLUE)) * (0.35 + 0.6 * shade) + 0.3 * shade, 0, 1)
    style: Any = {"edgecolors": "white", "linewidths": 0.25}
    return axes.add_collection(PolyCollection(list(spanned[order][:, :, [0, 2]]), facecolors=faces[order], **style))


def _panel(found: Flight, width: float = _WIDTH, height: float = _HEIGHT, dpi: int = _DPI) -> tuple[Any, Any]:
    """A figure with equal scales of both axes, and the path of the centre of mass."""
    figure = new_figure(width, height)
    figure.set_dpi(dpi)
    axes = figure.add_axes((0.11, 0.17, 0.87, 0.8))
    axes.set_aspect("equal")
    axes.set_xlim(-0.15, 1.15)
    axes.set_ylim(-0.14, 0.47)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("height z [m]")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    axes.plot(found.middle[:, 0], found.middle[:, 2], ":", color=GREY, linewidth=1)
    return figure, axes


def still(found: Flight, out: Path) -> None:
    """Five frames in one picture, each with its time."""
    figure, axes = _panel(found, 8.0, 4.2, 110)
    axes.set_position((0.11, 0.15, 0.87, 0.76))
    axes.set_title("The block bends; its centre of mass moves on a parabola", loc="left", fontsize=11, weight="bold")
    for k in np.linspace(0, FRAMES - 1, STILLS).round().astype(int):
        _block(axes, found.places[k], found.triangles)
        x, top = found.middle[k, 0], found.places[k, :, 2].max()
        axes.annotate(
            f"t = {found.times[k]:.3g} s", (x, top), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=9
        )
    axes.annotate(
        "centre of mass", found.middle[FRAMES // 10, [0, 2]], xytext=(-8, 0), textcoords="offset points",
        color=GREY, fontsize=9, ha="right",
    )  # fmt: skip
    figure.savefig(out, dpi=110)
    out.write_bytes(few_colours(out.read_bytes()))


def movie(found: Flight, out: Path) -> None:
    """The flight as a GIF with one palette."""
    from PIL import Image

    figure, axes = _panel(found)
    clock = axes.text(0.98, 0.94, "", transform=axes.transAxes, ha="right", fontsize=9)
    pictures = []
    for time, places in zip(found.times, found.places, strict=True):
        drawn = _block(axes, places, found.triangles)
        clock.set_text(f"t = {time:.2f} s, 1/{(FRAMES - 1) / (FLIGHT * RATE):.2g} of real speed")
        figure.canvas.draw()
        pictures.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()))
        drawn.remove()
    some = pictures[:: len(pictures) // 6]
    sheet = Image.fromarray(np.concatenate([np.asarray(picture) for picture in some]))
    palette = sheet.quantize(_GIF_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    few[0].save(out, save_all=True, append_images=few[1:], duration=round(1000 / RATE), loop=0, optimize=True)


def draw(folder: Path) -> None:
    """Writes thrown-block.png and thrown-block.gif."""
    found = jax.block_until_ready(flight())
    still(found, folder / "thrown-block.png")
    movie(found, folder / "thrown-block.gif")
