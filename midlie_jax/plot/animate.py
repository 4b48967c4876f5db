"""`animate`: rotating bodies as a GIF, made only with matplotlib and Pillow."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks.arguments import as_count
from .model import Bodies, Paths, Scene, around_of, grid, panels, picture_file, scenes
from .style import BLUE, SKY, new_figure, time_text

_DPI = 80
_TEXT = 9  # font size, points
_LINE = 14  # height of a line of text, pixels
_STRIP = 26  # height of the title above several pictures, pixels
_COLOURS = 128  # size of the palette, which all frames share
_MOST_FRAMES = 400


def animate(
    body: Bodies,
    path: Paths,
    file: str | Path = "top.gif",
    *,
    axis: str | int | ArrayLike = 2,
    frames: int = 72,
    rate: float = 20.0,
    size: int = 320,
    elevation: float = 22.0,
    azimuth: float = -55.0,
    background: str = "white",
    title: str = "",
    points: Any = None,
    together: bool = False,
    box: ArrayLike | None = None,
    planet: float | None = None,
) -> Path:
    """Writes a GIF of a rotating body: a box with its moments of inertia, an axis of the body, and this axis's path.

    A body that translates is drawn at its position, larger than it is if its path is long; interacting bodies that
    translate share one space. Several bodies are drawn side by side at the same times. The picture says how much a body
    is enlarged, whether it rotates by more than a quarter of a revolution between frames, and whether a run failed.

    Args:
        body: the body of the path: a `RigidBody`, a `TensorBody`, a `SymmetricRotor` or a `FreeBody`; for several paths
            one body for all, a list with one per path, or the bodies of an ensemble.
        path: a `Path` of one body with attitudes or axes (`RigidState`, `AxisState`, `FreeState`,
            `FreeAxisState`), from `integrate`, `integrate_variable_step` or `free_motion`; or a path of coupled bodies.
            Or up to 12 paths, 500 with `together`: a mapping of names to paths, a list, or a path of `ensemble`.
        file: the GIF to write; an existing file is replaced.
        axis: an axis of the body: "e1", "e2", "e3" or its index 0, 1, 2, or a unit vector (3,) in the body frame.
            States with only an axis support only this axis, e3.
        frames: number of frames, at most 400.
        rate: frames per second, at most 50, the maximum in browsers.
        size: width and height of the picture of one body, pixels.
        elevation, azimuth: the direction of the viewer in degrees, above the xy plane and around z from x.
        background: any colour of matplotlib; text is black or white, whichever has more contrast.
        title: a line above the picture.
        points: positions in the frame of the body, (a, 3), such as the atoms of a molecule. They replace the solid, and
            the first is joined to each of the others; only for bodies with a mass. Or a `Surface` of triangles in the
            frame of the body, or a list of surfaces, one for each of coupled bodies.
        together: whether several translating bodies are drawn in one space, instead of side by side.
        box: the lowest and the highest corner of a periodic box, (2, 3), in the units of the positions. The centres of
            the bodies are drawn in it, without tracks. Between saved states they must move by less than half the box.
            Positions may be wrapped into the box or not.
        planet: the radius of a ball at the origin, in the units of the positions, such as the Earth below satellites.

    Returns:
        The path of the file.

    Raises:
        ValueError: a path is not of one body with attitudes or axes, or not of this kind of body, or its first two
            states are bad; an argument is out of range.
        ImportError: matplotlib is not installed.
        OSError: the file cannot be written.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> ml.plot.animate(body, path, "top.gif", frames=4).name
        'top.gif'
    """
    target, pixels = picture_file(file, ".gif"), as_count("size", size)
    if not 64 <= pixels <= 2000:
        raise ValueError(f"size must be between 64 and 2000 pixels, got {pixels}.")
    if not 0 < rate <= 50:
        raise ValueError(f"rate must be above 0 and at most 50 frames per second, got {rate}.")
    dark = _is_dark(background)
    given = panels(body, path, together)
    around = around_of(box, planet, [panel.path for panel in given])
    shown = scenes(given, axis, frames, _MOST_FRAMES, points, around=around, in_one=together)
    names = [""] if together else [panel.name for panel in given]
    _write(list(_drawn(names, shown, pixels, (elevation, azimuth), background, dark, title)), target, rate)
    return target


def _is_dark(background: str) -> bool:
    from matplotlib.colors import is_color_like, to_rgb

    if not is_color_like(background):
        raise ValueError(
            f"background must be a colour of matplotlib, such as 'white' or '#111111', got {background!r}."
        )
    return float(np.dot([0.2126, 0.7152, 0.0722], to_rgb(background))) < 0.4


def _drawn(
    names: list[str],
    shown: list[Scene],
    pixels: int,
    view: tuple[float, float],
    background: str,
    dark: bool,
    title: str,
) -> Iterator[Any]:
    """The frames as RGB images of Pillow: a drawing of each scene with its texts, the title and the clock."""
    from PIL import Image

    from .drawing import Drawing

    text, line = ("white", SKY) if dark else ("black", BLUE)
    rows, columns = grid(len(shown))
    # The title of a single picture is drawn in the picture; a common title is drawn above several pictures.
    strip = _STRIP if title and len(shown) > 1 else 0
    width, height, edge = columns * pixels, rows * pixels + strip, 0.03 * pixels
    figure, times = new_figure(width / _DPI, height / _DPI), shown[0].times
    figure.set_dpi(_DPI)
    figure.set_facecolor(background)

    def note(x: float, y: float, words: str, **style: Any) -> Any:
        return figure.text(x / width, y / height, words, **{"color": text, "fontsize": _TEXT, **style})

    drawings = list[Drawing]()
    for k, (name, scene) in enumerate(zip(names, shown, strict=True)):
        x, y = k % columns * pixels, (rows - 1 - k // columns) * pixels
        place = (x / width, y / height, pixels / width, pixels / height)
        drawings.append(Drawing(figure, place, scene, view, text, line))
        heading, top = name or (title if len(shown) == 1 else ""), y + pixels - edge
        note(x + edge, top, heading, va="top", weight="bold")
        note(x + edge, y + edge + _LINE, "\n".join(scene.remarks))  # above the line of the clock
        named = [(n, c) for n, c in zip(scene.names, scene.colours, strict=False) if n and scene.few]
        for row, (word, colour) in enumerate(named, start=1 if heading else 0):
            note(x + edge, top - row * _LINE, word, va="top", color=colour)
    if strip:
        note(edge, height - edge, title, va="top", weight="bold")
    clock = note(width - edge, edge, "", ha="right")
    for k, t in enumerate(times):
        for drawing in drawings:
            drawing.move(k)
        clock.set_text(f"t = {time_text(float(t))}")
        figure.canvas.draw()
        yield Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())


def _write(pictures: list[Any], target: Path, rate: float) -> None:
    """Writes the frames with one palette, taken from a sheet of several frames."""
    from PIL import Image

    some = pictures[:: max(1, len(pictures) // 6)]
    width, height = some[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for i, picture in enumerate(some):
        sheet.paste(picture, (0, i * height))
    palette = sheet.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    few[0].save(target, save_all=True, append_images=few[1:], duration=round(1000 / rate), loop=0, optimize=True)
