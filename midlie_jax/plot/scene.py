"""`Scene`: the moving bodies of a panel of a GIF, on matplotlib's 3-D axes: on the unit sphere, or at their places.

This module imports matplotlib, so `animate` imports it only when it draws.
"""

from typing import Any

import numpy as np
from matplotlib import rc_context
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from .artists import BEHIND, IN_FRONT, draw_axes, draw_curve, draw_ellipsoid, draw_space, towards_viewer
from .style import GREY, PLANET, VERMILLION
from .together import Together
from .travel import Travel
from .turning import Turning

_TEXT = 9.0  # font size of the letters at the axes, points
_SMALL = 7.0  # that of lengths at the axes
_LAMP = np.array([-0.3, 0.55, 0.78])  # direction of the lamp for the viewer: right, up, and out of the picture
_FIRST, _OTHER = 42.0, 14.0  # areas of the dots of a body drawn as points: of the first, and of each other
# The sequence in which things are drawn, if a planet hides some of them.
_BEYOND, _PLANET, _INSIDE, _BEFORE = 2.0, 3.0, 3.5, 4.0
_BACKGROUND = 0.5  # opacity of the part of the track that is still to come


class Scene:
    """The artists of the bodies of a panel, which are moved for each frame."""

    def __init__(
        self,
        figure: Any,
        place: tuple[float, float, float, float],
        shown: Together,
        view: tuple[float, float],
        text: str,
        colour: str,
    ):
        self.shown = shown
        with rc_context({"grid.linewidth": 0.4, "grid.color": GREY}):  # 3-D axes take these when they are made
            self.axes = axes = figure.add_axes(place, projection="3d", facecolor="none")
        axes.xaxis.label.set_color(text)
        axes.view_init(*view)
        self.out = towards_viewer(axes)
        right = np.cross([0.0, 0.0, 1.0], self.out) / max(float(np.hypot(*self.out[:2])), 1e-9)
        self.lamp = _LAMP @ np.stack([right, np.cross(self.out, right), self.out])
        limits = shown.limits
        sphere = limits is None
        self.ground = (
            _Sphere(axes, shown.members[0], text, colour) if sphere else _Space(axes, shown, limits, text, self.out)
        )
        edge = "" if shown.members[0].shape.round else text
        self.bodies = (_Solids if shown.solid else _Sites)(axes, shown, self.lamp, edge, self.out)
        own = [colour] if shown.alone else shown.colours if shown.few and shown.solid else ()
        self.axes_of_bodies = [
            (member, axes.plot([], [], [], color=own_colour, linewidth=2.4)[0])
            for member, own_colour in zip(shown.members, own, strict=False)
        ]

    def move(self, k: int) -> None:
        """Moves the bodies, their axes and their paths to frame k."""
        self.bodies.move(k)
        for member, line in self.axes_of_bodies:
            tip = member.tips[k]
            ends = member.placed(k, np.stack([member.inside * tip, tip]))
            line.set_data_3d(*_seen(ends, self.shown, self.out).T)
            behind = _INSIDE if self.shown.around.planet else BEHIND
            line.set_zorder(IN_FRONT if tip @ self.out > 0 else behind)
        self.ground.move(k)


class _Solids:
    """Bodies drawn as solids, of which the nearer hides the farther; a planet hides those beyond it."""

    def __init__(self, axes: Any, shown: Together, lamp: np.ndarray, edge: str, out: np.ndarray):
        self.shown, self.lamp, self.edge, self.out = shown, lamp, edge, out
        # matplotlib fills short faces up with numbers from memory, which may overflow; so all get as many corners.
        self.most = max(len(face) for member in shown.members for face in member.shape.faces)
        self.layers = [
            Poly3DCollection(self._faces(shown.members[0], 0), linewidth=0.6 if shown.few else 0.25, zorder=zorder)
            for zorder in ((_BEYOND, _BEFORE) if shown.around.planet else (_BEFORE,))
        ]
        for layer in self.layers:
            axes.add_collection3d(layer, autolim=False)

    def move(self, k: int) -> None:
        faces = [self._faces(member, k) for member in self.shown.members]
        beyond = [bool(np.mean(own[0], axis=0) @ self.out < 0) and len(self.layers) > 1 for own in faces]
        for layer in self.layers:
            hidden = layer is not self.layers[-1]
            those = [
                both
                for both, far in zip(zip(faces, self.shown.colours, strict=True), beyond, strict=True)
                if far == hidden
            ]
            colours = [_lit(face, self.lamp, colour) for own, colour in those for face in own]
            layer.set_visible(bool(those))
            if those:
                layer.set_verts([face for own, _ in those for face in own])
                layer.set_facecolor(colours)
                layer.set_edgecolor(self.edge or colours)

    def _faces(self, member: Turning, k: int) -> list[np.ndarray]:
        corners = member.placed(k, member.corners[k])
        return [corners[[*face, *face[-1:] * (self.most - len(face))]] for face in member.shape.faces]


class _Sites:
    """Bodies drawn as points, the first of which is joined to each of the others."""

    def __init__(self, axes: Any, shown: Together, lamp: np.ndarray, edge: str, out: np.ndarray):
        del lamp, edge
        self.shown, self.out, colours = shown, out, shown.colours_of_sites
        first, other = (areas if shown.few else areas / 2 for areas in (_FIRST, _OTHER))
        areas = [other if k else first for member in shown.members for k in range(member.corners.shape[1])]
        style = {"depthshade": False, "edgecolors": "none", "zorder": _BEFORE}
        self.dots = axes.scatter(*np.concatenate(shown.sites(0)).T, s=areas, c=colours, **style)
        self.sticks = Line3DCollection(
            shown.sticks(0), colors=GREY, linewidths=1.4 if shown.few else 0.9, zorder=_BEFORE
        )
        axes.add_collection3d(self.sticks, autolim=False)

    def move(self, k: int) -> None:
        self.dots._offsets3d = tuple(_seen(np.concatenate(self.shown.sites(k)), self.shown, self.out).T)
        self.sticks.set_segments([_seen(stick, self.shown, self.out) for stick in self.shown.sticks(k)])


def _seen(points: np.ndarray, shown: Together, out: np.ndarray) -> np.ndarray:
    """The points (n, 3), with NaN in place of those that a planet hides."""
    return np.where(shown.around.hidden(points, out)[:, None], np.nan, points)


def _past(shown: Turning, k: int) -> np.ndarray:
    """Which saved states are before frame k, (n,)."""
    forward = shown.path_times[-1] >= shown.path_times[0]
    return shown.path_times <= shown.times[k] if forward else shown.path_times >= shown.times[k]


class _Sphere:
    """The unit sphere, and on it the path of the axis of the body."""

    def __init__(self, axes: Any, shown: Turning, text: str, colour: str):
        self.axes, self.shown, self.colour = axes, shown, colour
        draw_ellipsoid(axes, np.ones(3))
        draw_axes(axes, np.zeros((3, 3)), 1.15 * np.eye(3), "xyz", _TEXT)
        self.trace: list[Any] = []

    def move(self, k: int) -> None:
        for line in self.trace:
            line.remove()
        whole = np.concatenate([self.shown.path_tips[_past(self.shown, k)], self.shown.tips[k][None]])
        self.trace = draw_curve(self.axes, whole, np.ones(3), color=self.colour, linewidth=1.3)


class _Space:
    """The axes of space with their lengths, what stands around, and the tracks of the centres of mass, if not many."""

    def __init__(self, axes: Any, shown: Together, limits: np.ndarray, text: str, out: np.ndarray):
        draw_space(axes, limits, _SMALL)
        self.shown, self.out, around = shown, out, shown.around
        for ends in around.edges:
            axes.plot(*ends.T, color=GREY, linewidth=0.9, zorder=BEHIND)
        if around.planet is not None:
            axes.computed_zorder = False  # the planet comes between what it hides and what is before it
            axes.add_collection3d(_disc(around.planet, out), autolim=False)
        self.tracks = list[tuple[Turning, Travel, Any]]()
        for member, colour in zip(shown.members, [VERMILLION] if shown.alone else shown.colours, strict=True):
            travel = member.travel
            if not shown.has_tracks or travel is None:
                continue
            whole = _seen(travel.track, shown, out)
            zorder = _BEFORE if around.planet else BEHIND
            alpha = _BACKGROUND if shown.few else _BACKGROUND / 2  # of many bodies, some may have the same track
            axes.plot(*whole.T, color=GREY, linewidth=0.8, alpha=alpha, zorder=zorder)
            if shown.few:
                (line,) = axes.plot([], [], [], color=colour, linewidth=1.3, zorder=BEHIND)
                self.tracks.append((member, travel, line))

    def move(self, k: int) -> None:
        for member, travel, line in self.tracks:
            past = travel.track[_past(member, k)]
            line.set_data_3d(*_seen(np.concatenate([past, travel.centres[k][None]]), self.shown, self.out).T)


def _disc(radius: float, out: np.ndarray) -> Any:
    """A planet as the viewer in the direction `out` sees it."""
    across = np.linalg.svd(out[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, 91)[:, None]
    rim = radius * (np.cos(angle) * across[0] + np.sin(angle) * across[1])
    return Poly3DCollection([rim], facecolor=PLANET, edgecolor=GREY, linewidth=0.8, zorder=_PLANET)


def _lit(face: np.ndarray, lamp: np.ndarray, colour: str) -> tuple[float, ...]:
    """The colour of a face (n, 3) of a body, from the light that falls on it from the direction of the lamp."""
    from matplotlib.colors import to_rgb

    normal = np.cross(face[1] - face[0], face[2] - face[1])
    shine = 0.7 + 0.3 * float(normal @ lamp) / max(float(np.linalg.norm(normal)), np.finfo(float).tiny)
    return tuple(shine * c for c in to_rgb(colour))
