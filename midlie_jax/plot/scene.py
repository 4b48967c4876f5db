"""`Scene`: one moving body of a GIF, on matplotlib's 3-D axes: on the unit sphere of directions, or at its place.

This module imports matplotlib, so `animate` imports it only when it draws.
"""

from typing import Any

import numpy as np
from matplotlib import rc_context
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from .ellipsoid import BEHIND, IN_FRONT, draw_curve, draw_ellipsoid
from .labels3d import towards_viewer
from .space import draw_space
from .style import GREY, ORANGE, VERMILLION
from .turning import Turning

_TEXT = 9  # font size of the letters at the axes, points
_SMALL = 7.0  # that of lengths at the axes
_LAMP = np.array([-0.3, 0.55, 0.78])  # direction of the lamp for the viewer: right, up, and out of the picture
_BODY = ORANGE
_BACKGROUND = 0.5  # opacity of the part of the track that is still to come


class Scene:
    """The artists of one body, which are moved for each frame."""

    def __init__(
        self,
        figure: Any,
        place: tuple[float, float, float, float],
        shown: Turning,
        view: tuple[float, float],
        text: str,
        colour: str,
    ):
        self.shown = shown
        with rc_context({"grid.linewidth": 0.4, "grid.color": GREY}):  # 3-D axes take these when they are made
            self.axes = axes = figure.add_axes(place, projection="3d", facecolor="none")
        axes.view_init(*view)
        self.out = towards_viewer(axes)
        right = np.cross([0.0, 0.0, 1.0], self.out) / max(float(np.hypot(*self.out[:2])), 1e-9)
        self.lamp = _LAMP @ np.stack([right, np.cross(self.out, right), self.out])
        self.ground = _Sphere(axes, shown, text, colour) if shown.travel is None else _Space(axes, shown, text)
        self.edge = "" if shown.shape.round else text
        self.body = Poly3DCollection(self._faces(0), linewidth=0.6)
        axes.add_collection3d(self.body, autolim=False)
        (self.axis,) = axes.plot([], [], [], color=colour, linewidth=2.4)

    def move(self, k: int) -> None:
        """Moves the body, its axis and its path to frame k."""
        shown, faces = self.shown, self._faces(k)
        colours = [_lit(face, self.lamp) for face in faces]
        self.body.set_verts(faces)
        self.body.set_facecolor(colours)
        self.body.set_edgecolor(self.edge or colours)
        tip = shown.tips[k]
        self.axis.set_data_3d(*shown.placed(k, np.stack([shown.inside * tip, tip])).T)
        self.axis.set_zorder(IN_FRONT if tip @ self.out > 0 else BEHIND)
        self.ground.move(k)

    def _faces(self, k: int) -> list[np.ndarray]:
        corners = self.shown.placed(k, self.shown.corners[k])
        # matplotlib fills short faces up with numbers from memory, which may overflow; so all get as many corners.
        most = max(map(len, self.shown.shape.faces))
        return [corners[[*face, *face[-1:] * (most - len(face))]] for face in self.shown.shape.faces]


def _past(shown: Turning, k: int) -> np.ndarray:
    """Which saved states are before frame k, (n,)."""
    forward = shown.path_times[-1] >= shown.path_times[0]
    return shown.path_times <= shown.times[k] if forward else shown.path_times >= shown.times[k]


class _Sphere:
    """The unit sphere, and on it the path of the axis of the body."""

    def __init__(self, axes: Any, shown: Turning, text: str, colour: str):
        self.axes, self.shown, self.colour = axes, shown, colour
        draw_ellipsoid(axes, np.ones(3))
        for direction, letter in zip(np.eye(3), "xyz", strict=True):
            axes.plot(*np.stack([0 * direction, 1.15 * direction]).T, color=GREY, linewidth=0.8)
            axes.text(*(1.24 * direction), letter, color=text, fontsize=_TEXT, ha="center", va="center")
        self.trace: list[Any] = []

    def move(self, k: int) -> None:
        for line in self.trace:
            line.remove()
        whole = np.concatenate([self.shown.path_tips[_past(self.shown, k)], self.shown.tips[k][None]])
        self.trace = draw_curve(self.axes, whole, np.ones(3), color=self.colour, linewidth=1.3)


class _Space:
    """The axes of space with their lengths, and the track of the centre of mass."""

    def __init__(self, axes: Any, shown: Turning, text: str):
        assert shown.travel is not None
        self.shown, self.travel = shown, shown.travel
        draw_space(axes, self.travel.limits, _SMALL, text)
        axes.plot(*self.travel.track.T, color=GREY, linewidth=0.8, alpha=_BACKGROUND, zorder=BEHIND)
        (self.line,) = axes.plot([], [], [], color=VERMILLION, linewidth=1.3, zorder=BEHIND)

    def move(self, k: int) -> None:
        past = self.travel.track[_past(self.shown, k)]
        self.line.set_data_3d(*np.concatenate([past, self.travel.centres[k][None]]).T)


def _lit(face: np.ndarray, lamp: np.ndarray) -> tuple[float, ...]:
    """The colour of a face (n, 3), from the light that falls on it from the direction of the lamp."""
    from matplotlib.colors import to_rgb

    normal = np.cross(face[1] - face[0], face[2] - face[1])
    shine = 0.7 + 0.3 * float(normal @ lamp) / max(float(np.linalg.norm(normal)), np.finfo(float).tiny)
    return tuple(shine * c for c in to_rgb(_BODY))
