"""Curves on an ellipsoid, or the unit sphere, on 3-D axes: strong towards the viewer, faint behind.

matplotlib does not know which part of a curve an ellipsoid hides. The artists here find it whenever they are drawn, so
a picture that is turned by hand stays correct. The view is orthographic: a point is in front if the normal of the
surface there points to the viewer. This module imports matplotlib, so the modules of `plot` import it only when they
draw.
"""

from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3D, Poly3DCollection

from .labels3d import towards_viewer
from .style import GREY

BEHIND, IN_FRONT = 1.0, 20.0  # the sequence in which matplotlib draws; things inside the surface are between both
_BEHIND = 0.28  # opacity of things behind the surface
_ROOM = 1.3  # size of the panel over that of the ellipsoid, so that axes can stick out
_SMOOTH = np.radians(2.0)  # the angle between neighbouring points of a curve


class HalfCurve(Line3D):
    """The part of a curve on one side of an ellipsoid. Its data are the whole curve.

    Args:
        points: (n, 3).
        semi_axes: those of the ellipsoid, (3,).
        front: True for the part towards the viewer, False for the other.
        style: style of the line, as in matplotlib.
    """

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
    """The silhouette of an ellipsoid, as seen by the viewer, filled."""

    def __init__(self, semi_axes: np.ndarray):
        super().__init__([np.zeros((3, 3))], facecolor=GREY, edgecolor=GREY, alpha=0.1, linewidth=0.8)
        self.semi_axes = semi_axes

    def do_3d_projection(self) -> Any:
        # A point A u of the surface, |u| = 1, A = diag(semi-axes), has the normal A^-1 u.
        across = np.linalg.svd((towards_viewer(self.axes) / self.semi_axes)[None])[2][1:]
        angle = np.linspace(0, 2 * np.pi, 181)[:, None]
        self.set_verts([self.semi_axes * (np.cos(angle) * across[0] + np.sin(angle) * across[1])])
        return super().do_3d_projection()


def shade_of(axes: Any) -> Shade | None:
    """The ellipsoid that is already on the axes, if any."""
    return next((found for found in axes.collections if isinstance(found, Shade)), None)


def draw_ellipsoid(axes: Any, semi_axes: np.ndarray) -> None:
    """Draws the silhouette, and sets limits, aspect and projection of the axes; the box around them is hidden."""
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


def draw_dot(axes: Any, point: np.ndarray, semi_axes: np.ndarray, colour: str) -> None:
    """Draws a dot at a point (3,) of the ellipsoid."""
    draw_curve(axes, point[None], semi_axes, color=colour, marker="o", markersize=6.0, linestyle="")


def along_arcs(points: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3), with more between them on the shortest arcs, so that none are over two degrees apart."""
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
