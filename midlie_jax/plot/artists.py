"""Artists for 3-D axes: curves on an ellipsoid, strong in front and faint behind, and axes of space.

matplotlib does not compute which part of a curve an ellipsoid hides. The artists here compute it on each drawing, so a
picture rotated by hand stays correct. The view is orthographic: a point is in front if the normal of the surface there
points to the viewer. This module imports matplotlib, so other modules import it only when they draw.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3D, Poly3DCollection

from .style import GREY, SIZE, circle, ink

BEHIND, IN_FRONT = 1.0, 20.0  # drawing order of matplotlib; things inside the surface are between both
_BEHIND = 0.28  # opacity of things behind the surface
_ROOM = 1.3  # size of the panel over the size of the ellipsoid, so that axes can extend beyond it
_SMOOTH = np.radians(2.0)  # the angle between neighbouring points of a curve
_TICKS = 3  # approximate number of tick labels per axis


def towards_viewer(axes: Any) -> np.ndarray:
    """The unit vector (3,) from the picture to the viewer, for 3-D axes with z up."""
    elevation, azimuth = np.radians([axes.elev, axes.azim])
    across = np.cos(elevation)
    return np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])


def circle_around(axis: np.ndarray, count: int) -> np.ndarray:
    """Points (count, 3) of the unit circle around an axis."""
    return circle(count)[:, :2] @ np.linalg.svd(axis[None])[2][1:]


class HalfCurve(Line3D):
    """The part of a curve (n, 3) towards the viewer (`front`) or behind the ellipsoid. Its data are the whole curve."""

    def __init__(self, points: np.ndarray, semi_axes: np.ndarray, front: bool, **style: Any):
        super().__init__(*points.T, **style)
        self._normals, self._front = points / semi_axes**2, front

    def draw(self, renderer: Any) -> None:
        whole = np.array(self.get_data_3d(), float)
        seen = (self._normals @ towards_viewer(self.axes) >= 0) == self._front
        # Pieces in front begin one point earlier and end one later, so that there is no gap between the two parts.
        shown = seen | np.roll(seen, 1) | np.roll(seen, -1) if self._front else seen
        self.set_data_3d(*np.where(shown, whole, np.nan))
        super().draw(renderer)
        self.set_data_3d(*whole)


class Shade(Poly3DCollection):
    """The filled silhouette of an ellipsoid for the viewer."""

    def __init__(self, semi_axes: np.ndarray):
        super().__init__([np.zeros((3, 3))], facecolor=GREY, edgecolor=GREY, alpha=0.1, linewidth=0.8)
        self.semi_axes = semi_axes

    def do_3d_projection(self) -> Any:
        # A point A u of the surface, |u| = 1, A = diag(semi-axes), has the normal A^-1 u.
        self.set_verts([self.semi_axes * circle_around(towards_viewer(self.axes) / self.semi_axes, 181)])
        return super().do_3d_projection()


def draw_ellipsoid(axes: Any, semi_axes: np.ndarray) -> None:
    """Draws the silhouette, and sets limits, aspect and projection of the axes; the surrounding box is hidden."""
    reach = _ROOM * float(np.max(semi_axes))
    axes.set_proj_type("ortho")
    axes.set_axis_off()
    axes.patch.set_visible(False)  # it would cover names of the next panel
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
    axes.set_box_aspect((1, 1, 1), zoom=1.5)
    axes.add_collection3d(Shade(semi_axes), autolim=False)


def draw_curve(axes: Any, points: np.ndarray, semi_axes: np.ndarray, **style: Any) -> list[Any]:
    """Draws a curve (n, 3) on the ellipsoid; returns the part behind and the part in front."""
    alpha = style.pop("alpha", 1.0)
    behind = style | {"label": "_", "alpha": alpha * _BEHIND, "zorder": BEHIND}
    before = style | {"alpha": alpha, "zorder": IN_FRONT}
    parts = [HalfCurve(points, semi_axes, False, **behind), HalfCurve(points, semi_axes, True, **before)]
    return [axes.add_line(part) for part in parts]


def draw_axes(axes: Any, starts: np.ndarray, ends: np.ndarray, names: Sequence[str], size: float = SIZE) -> None:
    """Draws a grey line from each beginning to its end (n, 3), with a name beyond it, below all other things."""
    halo = [withStroke(linewidth=2.0, foreground=axes.figure.get_facecolor())]
    style = {"fontsize": size, "color": ink(axes), "ha": "center", "va": "center", "zorder": 2 * IN_FRONT}
    for start, end, name in zip(starts, ends, names, strict=True):
        axes.plot(*np.stack([start, end]).T, color=GREY, linewidth=1.0)
        axes.text(*(1.08 * end), name, path_effects=halo, **style)


def along_arcs(points: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3), with further ones on the shortest arcs, at most two degrees apart."""
    ends = points[1:]
    turns = np.arctan2(np.linalg.norm(np.cross(points[:-1], ends), axis=1), np.sum(points[:-1] * ends, axis=1))
    pieces = [points[:1]]
    for start, end, turn in zip(points[:-1], ends, turns, strict=True):
        count = int(np.ceil(turn / _SMOOTH))
        if count < 2 or np.sin(turn) < 1e-6:
            pieces.append(end[None])
            continue
        share = turn * np.arange(1, count + 1)[:, None] / count
        pieces.append((np.sin(turn - share) * start + np.sin(share) * end) / np.sin(turn))
    return np.concatenate(pieces)


def draw_space(axes: Any, limits: np.ndarray, size: float = SIZE) -> None:
    """Sets limits (2, 3), equal scales and axis names, with few tick labels, in a font of this size."""
    colour, spans = ink(axes), limits[1] - limits[0]
    power = 3 * int(np.floor(np.log10(max(float(np.max(np.abs(limits))), np.finfo(float).tiny)) / 3 + 1e-9))
    scale, unit = (10.0**power, rf"$10^{{{power}}}$ length") if power not in (0, -3) else (1.0, "length")
    axes.set_proj_type("ortho")
    axes.set(xlim=limits[:, 0], ylim=limits[:, 1], zlim=limits[:, 2])
    axes.set_box_aspect(spans / spans.max(), zoom=0.76 if size < SIZE else 0.88)
    for axis, letter in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_major_locator(MaxNLocator(_TICKS))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / scale:.6g}"))
        axis.set_label_text(f"{letter}  [{unit}]", fontsize=size, color=colour)
        axis.set_tick_params(labelsize=size, labelcolor=colour, color=GREY)
        axis.line.set_color(GREY)
        axis.set_pane_color((0.5, 0.5, 0.5, 0.05))
