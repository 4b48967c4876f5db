"""`animate`: rotating bodies as a GIF, made only with matplotlib and Pillow."""

from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from .._checks.arguments import as_count
from .model import Bodies, Paths, around_of, panels, picture_file, scenes

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
        body: the body of the path; for several paths one body for all, a list with one per path, or the bodies of an
            ensemble.
        path: a `Path` of one body with attitudes or axes, or of coupled bodies. Or up to 12 paths, 500 with `together`:
            a mapping of names to paths, a list, or a path of `ensemble`.
        file: the GIF to write, whose path is returned; an existing file is replaced.
        axis: as for `axis_path`.
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

    Raises:
        ValueError: a path is not of one body with attitudes or axes, or not of this kind of body, or its first two
            states are bad; an argument is out of range.
        ImportError: matplotlib is not installed.
        OSError: the file cannot be written.

    Examples:
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> ml.plot.animate(body, path, "top.gif", frames=4).name
        'top.gif'
    """
    from matplotlib.colors import is_color_like

    from .drawing import images_of, write_gif

    target, pixels = picture_file(file, ".gif"), as_count("size", size)
    if not 64 <= pixels <= 2000:
        raise ValueError(f"size must be between 64 and 2000 pixels, got {pixels}.")
    if not 0 < rate <= 50:
        raise ValueError(f"rate must be above 0 and at most 50 frames per second, got {rate}.")
    if not is_color_like(background):
        raise ValueError(
            f"background must be a colour of matplotlib, such as 'white' or '#111111', got {background!r}."
        )
    given = panels(body, path, together)
    around = around_of(box, planet, [panel.path for panel in given])
    shown = scenes(given, axis, frames, _MOST_FRAMES, points, around=around, in_one=together)
    write_gif(list(images_of(shown, pixels, (elevation, azimuth), background, title)), target, rate)
    return target
