"""The frames of a GIF by matplotlib and Pillow: each scene on 3-D axes, on the unit sphere or at its positions.

This module imports matplotlib, so `animate` imports it only when it draws.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from PIL import Image

from .artists import BEHIND, IN_FRONT, circle_around, draw_axes, draw_curve, draw_ellipsoid, draw_space, towards_viewer
from .model import Scene, Turning, grid
from .style import BLUE, GREY, PLANET, SKY, new_figure, time_text

_DPI = 80
_TEXT = 9.0  # font size, points
_LINE = 14  # height of a line of text, pixels
_STRIP = 26  # height of the title above several pictures, pixels
_COLOURS = 128  # size of the palette, which all frames share
_SMALL = 7.0  # font size of lengths at the axes
_LAMP = np.array([-0.3, 0.55, 0.78])  # direction of the lamp for the viewer: right, up, and out of the picture
_DOTS = 42.0, 14.0  # dot areas of a body drawn as points: of the first, and of each other
# The drawing order, if a planet hides some things.
_BEYOND, _PLANET, _INSIDE, _BEFORE = 2.0, 3.0, 3.5, 4.0
_BACKGROUND = 0.5  # opacity of the future part of the track


def images_of(shown: list[Scene], pixels: int, view: tuple[float, float], background: str, title: str) -> Iterator[Any]:
    """The frames as RGB images of Pillow: a drawing of each scene with its texts, the title and the clock."""
    dark = float(np.dot([0.2126, 0.7152, 0.0722], to_rgb(background))) < 0.4
    text, line = ("white", SKY) if dark else ("black", BLUE)
    rows, columns = grid(len(shown))
    # The title of a single picture is drawn in the picture; a common title is drawn above several pictures.
    strip = _STRIP if title and len(shown) > 1 else 0
    width, height, edge = columns * pixels, rows * pixels + strip, 0.03 * pixels
    figure, times = new_figure(width / _DPI, height / _DPI), shown[0].members[0].times
    figure.set_dpi(_DPI)
    figure.set_facecolor(background)

    def note(x: float, y: float, words: str, **style: Any) -> Any:
        return figure.text(x / width, y / height, words, **{"color": text, "fontsize": _TEXT, **style})

    drawings = list[_Drawing]()
    for k, scene in enumerate(shown):
        x, y = k % columns * pixels, (rows - 1 - k // columns) * pixels
        place = (x / width, y / height, pixels / width, pixels / height)
        drawings.append(_Drawing(figure, place, scene, view, text, line))
        heading, top = scene.title or (title if len(shown) == 1 else ""), y + pixels - edge
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


def write_gif(pictures: list[Any], target: Path, rate: float) -> None:
    """Writes the frames with one palette, taken from a sheet of several frames."""
    some = pictures[:: max(1, len(pictures) // 6)]
    width, height = some[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for i, picture in enumerate(some):
        sheet.paste(picture, (0, i * height))
    palette = sheet.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    few[0].save(target, save_all=True, append_images=few[1:], duration=round(1000 / rate), loop=0, optimize=True)


class _Drawing:
    """The artists of a scene, moved for each frame."""

    def __init__(self, figure: Any, place: Any, scene: Scene, view: tuple[float, float], text: str, line: str):
        self.scene, self.line, self.has_planet = scene, line, scene.around.planet is not None
        with rc_context({"grid.linewidth": 0.4, "grid.color": GREY}):  # 3-D axes read these when they are made
            self.axes = axes = figure.add_axes(place, projection="3d", facecolor="none")
        axes.xaxis.label.set_color(text)
        axes.view_init(*view)
        self.out = towards_viewer(axes)
        self.tip_path: list[Any] = []
        self.tracks = []
        if scene.limits is None:
            draw_ellipsoid(axes, np.ones(3))
            draw_axes(axes, np.zeros((3, 3)), 1.15 * np.eye(3), "xyz", _TEXT)
        else:
            draw_space(axes, scene.limits, _SMALL)
            self._draw_surroundings()
        if scene.solid:
            right = np.cross([0.0, 0.0, 1.0], self.out) / max(float(np.hypot(*self.out[:2])), 1e-9)
            self.lamp = _LAMP @ np.stack([right, np.cross(self.out, right), self.out])
            self.edge = "" if scene.members[0].shape.round else text
            # matplotlib pads short faces with uninitialised numbers, which may overflow; so all faces get the same
            # number of corners.
            self.most = max(len(face) for member in scene.members for face in member.shape.faces)
            # Nearer bodies hide farther ones; a planet hides the bodies beyond it.
            width, orders = 0.6 if scene.few else 0.25, (_BEYOND, _BEFORE) if self.has_planet else (_BEFORE,)
            faces = self._faces(scene.members[0], 0)
            self.layers = [Poly3DCollection(faces, linewidth=width, zorder=order) for order in orders]
            for layer in self.layers:
                axes.add_collection3d(layer, autolim=False)
        else:
            colours, areas = scene.styles_of_sites(*(area if scene.few else area / 2 for area in _DOTS))
            style: dict[str, Any] = {"depthshade": False, "edgecolors": "none", "zorder": _BEFORE}
            self.dots = axes.scatter(*np.concatenate(scene.sites(0)).T, s=areas, c=colours, **style)
            width = 1.4 if scene.few else 0.9
            self.sticks = Line3DCollection(scene.sticks(0), colors=GREY, linewidths=width, zorder=_BEFORE)
            axes.add_collection3d(self.sticks, autolim=False)
        self.arrows = [
            (member, axes.plot([], [], [], color=line if scene.alone else colour, linewidth=2.4)[0])
            for member, _, colour in scene.axes
        ]

    def move(self, k: int) -> None:
        """Moves the bodies, their axes and their paths to frame k."""
        if self.scene.solid:
            self._move_solids(k)
        else:
            self.dots._offsets3d = tuple(self._seen(np.concatenate(self.scene.sites(k))).T)
            self.sticks.set_segments([self._seen(stick) for stick in self.scene.sticks(k)])
        for member, line in self.arrows:
            tip = member.tips[k]
            line.set_data_3d(*self._seen(member.placed(k, np.stack([member.inside * tip, tip]))).T)
            line.set_zorder(IN_FRONT if tip @ self.out > 0 else _INSIDE if self.has_planet else BEHIND)
        for member, travel, line in self.tracks:
            past = np.concatenate([travel.track[_past(member, k)], travel.centres[k][None]])
            line.set_data_3d(*self._seen(past).T)
        if self.scene.limits is None:
            for line in self.tip_path:
                line.remove()
            (member,) = self.scene.members
            whole = np.concatenate([member.path_tips[_past(member, k)], member.tips[k][None]])
            self.tip_path = draw_curve(self.axes, whole, np.ones(3), color=self.line, linewidth=1.3)

    def _draw_surroundings(self) -> None:
        """The box, the planet, and the whole tracks in grey."""
        axes, scene = self.axes, self.scene
        for ends in scene.around.edges:
            axes.plot(*ends.T, color=GREY, linewidth=0.9, zorder=BEHIND)
        if scene.around.planet is not None:
            axes.computed_zorder = False  # the planet is between the things that it hides and the things in front of it
            rim = scene.around.planet * circle_around(self.out, 91)
            disc = Poly3DCollection([rim], facecolor=PLANET, edgecolor=GREY, linewidth=0.8, zorder=_PLANET)
            axes.add_collection3d(disc, autolim=False)
        for member, travel, _, colour in scene.tracks:
            zorder = _BEFORE if self.has_planet else BEHIND
            alpha = _BACKGROUND if scene.few else _BACKGROUND / 2  # some of many bodies may have the same track
            axes.plot(*self._seen(travel.track).T, color=GREY, linewidth=0.8, alpha=alpha, zorder=zorder)
            if scene.few:
                (line,) = axes.plot([], [], [], color=colour, linewidth=1.3, zorder=BEHIND)
                self.tracks.append((member, travel, line))

    def _move_solids(self, k: int) -> None:
        layers: list[list[tuple[np.ndarray, str]]] = [[] for _ in self.layers]
        for member, colour in zip(self.scene.members, self.scene.colours, strict=True):
            faces = self._faces(member, k)
            beyond = np.mean(faces[0], axis=0) @ self.out < 0
            layers[0 if beyond else -1].extend((face, colour) for face in faces)
        for layer, those in zip(self.layers, layers, strict=True):
            layer.set_visible(bool(those))
            if those:
                colours = [_lit(face, self.lamp, colour) for face, colour in those]
                layer.set_verts([face for face, _ in those])
                layer.set_facecolor(colours)
                layer.set_edgecolor(self.edge or colours)

    def _faces(self, member: Turning, k: int) -> list[np.ndarray]:
        corners = member.placed(k, member.corners[k])
        return [corners[[*face, *face[-1:] * (self.most - len(face))]] for face in member.shape.faces]

    def _seen(self, points: np.ndarray) -> np.ndarray:
        """The points (n, 3), with NaN for points hidden by a planet."""
        return np.where(self.scene.around.hidden(points, self.out)[:, None], np.nan, points)


def _past(member: Turning, k: int) -> np.ndarray:
    """The saved states before frame k, (n,)."""
    forward = member.path_times[-1] >= member.path_times[0]
    return member.path_times <= member.times[k] if forward else member.path_times >= member.times[k]


def _lit(face: np.ndarray, lamp: np.ndarray, colour: str) -> tuple[float, ...]:
    """The colour of a face (n, 3) in the light of the lamp."""
    normal = np.cross(face[1] - face[0], face[2] - face[1])
    shine = 0.7 + 0.3 * float(normal @ lamp) / max(float(np.linalg.norm(normal)), np.finfo(float).tiny)
    return tuple(shine * c for c in to_rgb(colour))
