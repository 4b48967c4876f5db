"""Names of points on 3-D axes, in two columns beside the picture, joined to their points by leaders.

The columns are placed whenever they are drawn, so names stay apart when the picture is turned by hand. This module
imports matplotlib, so the modules of `plot` import it only when they draw.
"""

from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import IdentityTransform
from mpl_toolkits.mplot3d.proj3d import proj_transform

from .apart import apart
from .room import fitted, locate, on_page
from .style import SIZE, ink

_LINE = 1.35  # distance of two names, in font sizes
_BESIDE, _FREE = 16.0, 2.5  # points from the outermost artist to the names, and between a leader and its ends


def towards_viewer(axes: Any) -> np.ndarray:
    """The unit vector (3,) from the picture to the viewer, for 3-D axes whose z points up."""
    elevation, azimuth = np.radians([axes.elev, axes.azim])
    across = np.cos(elevation)
    return np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])


def pixels(axes: Any, points: np.ndarray) -> np.ndarray:
    """Where points (n, 3) are on the screen, (n, 2)."""
    x, y, _ = proj_transform(points[:, 0], points[:, 1], points[:, 2], axes.get_proj())
    return axes.transData.transform(np.stack([x, y], axis=1))


class Name(Text):
    """The name of a point of 3-D axes.

    Attributes:
        point: (3,), in the units of the data.
    """

    def __init__(self, axes: Any, point: np.ndarray, text: str, colour: str):
        super().__init__(0, 0, text, fontsize=SIZE, color=ink(axes), va="center_baseline", zorder=10)
        self.point, self._colour = np.asarray(point, float), colour
        self.set_clip_on(False)
        self.set_transform(IdentityTransform())  # places are pixels

    def _place(self) -> tuple[np.ndarray, np.ndarray]:
        """Moves the name to its place; returns the two ends of its leader, in pixels."""
        axes: Any = self.axes
        names = [text for text in axes.texts if isinstance(text, Name)]
        anchors = pixels(axes, np.stack([name.point for name in names]))
        unit = axes.figure.dpi / 72
        centre = pixels(axes, np.zeros((1, 3)))[0]
        mine = next(i for i, name in enumerate(names) if name is self)
        right = anchors[:, 0] >= centre[0]
        column = np.flatnonzero(right == right[mine])
        low, high = axes.bbox.y0 + SIZE * unit, axes.bbox.y1 - SIZE * unit
        heights = apart([float(h) for h in anchors[column, 1]], _LINE * SIZE * unit, low, high)
        outermost = float(np.max(np.abs(_outline(axes, anchors)[:, 0] - centre[0])))
        side = 1 if right[mine] else -1
        edge = centre[0] + side * (outermost + _BESIDE * unit)
        place = np.array([edge, heights[int(np.flatnonzero(column == mine)[0])]])
        self.set_position((float(place[0]), float(place[1])))
        self.set_horizontalalignment("left" if side > 0 else "right")
        return anchors[mine], place - [side * _FREE * unit, 0]

    def draw(self, renderer: Any) -> None:
        start, end = self._place()
        way = end - start
        start = start + way * min(1.0, 4.0 / max(float(np.linalg.norm(way)), 1e-9))
        leader = Line2D([start[0], end[0]], [start[1], end[1]], color=self._colour, linewidth=0.8, alpha=0.8)
        leader.set_figure(self.figure)
        leader.draw(renderer)
        super().draw(renderer)

    def get_window_extent(self, renderer: Any = None, dpi: float | None = None) -> Any:
        self._place()
        return super().get_window_extent(renderer, dpi)


def _outline(axes: Any, anchors: np.ndarray) -> np.ndarray:
    """The places, in pixels, that the names must not cover: their points, and the silhouettes of the ellipsoids."""
    azimuth = np.radians(axes.azim)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    found = [anchors]
    for shade in axes.collections:
        semi_axes = getattr(shade, "semi_axes", None)
        if semi_axes is not None:
            reach = right * float(np.linalg.norm(semi_axes * right))
            found.append(pixels(axes, np.stack([reach, -reach])))
    return np.concatenate(found)


def name_point(axes: Any, point: np.ndarray, text: str, colour: str) -> None:
    """Writes the name of a point beside the picture."""
    axes.add_artist(Name(axes, point, text, colour))
    locate(axes, _beside_names)


def _beside_names(axes: Any, renderer: Any) -> Any:
    """The place of a panel with which its names neither run off the page nor into the next panel."""
    axes.apply_aspect(axes.get_position(original=True))
    names = [text for text in axes.texts if isinstance(text, Name)]
    anchors = pixels(axes, np.stack([name.point for name in names]))
    centre = float(pixels(axes, np.zeros((1, 3)))[0, 0])
    picture = float(np.max(np.abs(_outline(axes, anchors)[:, 0] - centre)))
    beside = _BESIDE * axes.figure.dpi / 72
    widths = [0.0, 0.0]  # the widths of the left and the right column
    for name, anchor in zip(names, anchors, strict=True):
        side = int(anchor[0] >= centre)
        widths[side] = max(widths[side], beside + Text.get_window_extent(name, renderer).width)
    factor, shift = fitted(axes, centre, picture, widths[0], widths[1], renderer)
    box = axes.bbox.frozen()
    x, y = (box.x0 + box.x1) / 2 + shift, (box.y0 + box.y1) / 2
    half = factor * box.width / 2, factor * box.height / 2
    return on_page(axes, x - half[0], y - half[1], x + half[0], y + half[1])
