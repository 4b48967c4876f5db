"""`view`: rotating bodies in one HTML page, made by plotly, for a notebook or a file, without a network."""

from collections.abc import Iterable, Sequence
from html import escape
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .model import Bodies, Paths, Scene, around_of, grid, panels, picture_file, scenes
from .solids import ball
from .style import BLUE, GREEN, GREY, ORANGE, PLANET, SKY, circle, time_text

_MOST_FRAMES = 1000
_MOST_POINTS = 4000
_MILLISECONDS = 40  # display time of a frame
_REACH = 1.25
_HEIGHT = 560  # the height of a view in a notebook, pixels
_DIGITS = 5  # of the coordinates, relative to the size of the picture
_DOTS, _MANY_DOTS = (12, 6), (9, 5)  # dot sizes of the first point of a body and of its others, pixels
_FACE_COLOURS = (ORANGE, "#f3c96b", "#8fc6ea", "#c9e3f5", "#9a9a9a", "#c4c4c4")  # of a box, in the order of its faces
_ROUND_COLOURS = (ORANGE, "#8fc6ea", "#f3c96b")  # of a cylinder: the end at e3, the other end, and the side
_PAGE: dict[str, Any] = {
    "validate": False,
    "default_height": "96vh",
    "div_id": "midlie-view",  # fixed, so that the same motion gives the same page
    "config": {"displaylogo": False, "responsive": True},
}
# The colours of page and text follow the browser setting, light or dark; the body is visible on both.
_FOLLOW = """
const gd = document.getElementById('{plot_id}');
const dark = window.matchMedia('(prefers-color-scheme: dark)');
function follow() {
  const paper = dark.matches ? '#111111' : '#ffffff', ink = dark.matches ? '#eeeeee' : '#222222';
  const blue = dark.matches ? 'LIGHT_BLUE' : 'BLUE';
  document.body.style.background = paper;
  document.body.style.margin = '0';
  const some = (change, traces) => traces.length ? Plotly.restyle(gd, change, traces) : null;  // [] would mean all
  return Plotly.relayout(gd, {'paper_bgcolor': paper, 'font.color': ink, 'updatemenus[0].bgcolor': paper})
    .then(() => some({'textfont.color': ink}, LETTERS))
    .then(() => some({'line.color': blue, 'marker.color': blue}, BLUE_LINES));
}
dark.addEventListener('change', follow);
follow().then(() => { document.body.dataset.drawn = 'yes'; });
"""


class View:
    """Rotating bodies viewed from all sides, in a notebook as the value of a cell, or in a browser.

    Attributes:
        file: the last file written; None if there is none.

    Examples:
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> view = ml.plot.view(body, path)  # as the last line of a notebook's cell it shows itself
        >>> view.write("top.html").name
        'top.html'
    """

    def __init__(self, figure: dict[str, Any], blue: Sequence[int] = ()):
        self._figure, self._blue = figure, list(blue)
        self.file: Path | None = None

    @property
    def html(self) -> str:
        """The whole page, some 5 MB, nearly all of it plotly."""
        from plotly.io import to_html

        data = self._figure["data"]
        letters = [place for place, trace in enumerate(data) if "text" in trace]
        follow = _FOLLOW.replace("BLUE_LINES", str(self._blue)).replace("LIGHT_BLUE", SKY).replace("BLUE", BLUE)
        follow = follow.replace("LETTERS", str(letters))
        return to_html(self._figure, include_plotlyjs=True, auto_play=False, post_script=follow, **_PAGE)

    def write(self, file: str | Path) -> Path:
        """Writes the page to a file .html, replacing an existing one; a ValueError if the name has another ending."""
        target = picture_file(file, ".html")
        target.write_text(self.html, encoding="utf-8")
        self.file = target
        return target

    def _repr_html_(self) -> str:  # in a frame, so that page and notebook do not interfere
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: {_HEIGHT}px; border: 0"></iframe>'

    def __repr__(self) -> str:
        where = f"written to {self.file}" if self.file else "shown in a notebook; .write('view.html') writes it"
        return f"<View of {len(self._figure['frames'])} frames, {where}>"


def view(
    body: Bodies,
    path: Paths,
    file: str | Path | None = None,
    *,
    axis: str | int | ArrayLike = 2,
    frames: int = 200,
    title: str = "",
    points: Any = None,
    together: bool = False,
    box: ArrayLike | None = None,
    planet: float | None = None,
) -> View:
    """Shows a rotating body from all sides, played or at any time, in a notebook or a browser.

    It shows what `animate` draws, for one body at rest also the angular momentum over its largest length, with its
    path. The page contains plotly, some 5 MB, and works without a network. It is light or dark according to the
    browser. From more than 4,000 saved states, every second, third, ... is drawn.

    Args:
        file: a file .html to write; an existing one is replaced. By default none is written.
        frames: number of evenly spaced times, at most 1,000.
        body, path, axis, title, points, together, box, planet: as for `animate`.

    Raises:
        ValueError: as for `animate`.
        ImportError: plotly is not installed.
        OSError: the file cannot be written.

    Examples:
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> view = ml.plot.view(body, path, "top.html")
        >>> view.file.name
        'top.html'
    """
    if file is not None:
        picture_file(file, ".html")
    given = panels(body, path, together)
    around = around_of(box, planet, [panel.path for panel in given])
    shown = scenes(given, axis, frames, _MOST_FRAMES, points, around=around, in_one=together)
    if find_spec("plotly") is None:
        raise ImportError("a view needs plotly: pip install 'midlie_jax[plot]'.")
    figure = _figure(shown, title)
    # Blue lines get another blue on a dark page, except lines whose colour identifies a body.
    alone = [_scene(k) for k, scene in enumerate(shown) if scene.alone]
    lines = [one["scene"] in alone and one.get("line", {}).get("color") == BLUE for one in figure["data"]]
    found = View(figure, np.flatnonzero(lines).tolist())
    if file is not None:
        found.write(file)
    return found


def _figure(shown: Sequence[Scene], title: str) -> dict[str, Any]:
    """The picture as plotly's dictionary."""
    still, first, digits = list[dict[str, Any]](), list[dict[str, Any]](), [_digits(scene) for scene in shown]
    for k, (scene, own) in enumerate(zip(shown, digits, strict=True)):
        place = {"scene": _scene(k)} | ({"showlegend": False} if k else {})  # the legend lists the first panel
        moving = zip(_moving_points(scene, 0), _moving(scene), strict=True)
        for traces, found in ((still, _still(scene)), (first, moving)):
            traces += [trace | _coordinates(points, own) | place for points, trace in found]
    # Later frames hold only coordinates; colours come from the first frame, or from the reader's browser.
    places, frames = list(range(len(still), len(still) + len(first))), list[dict[str, Any]]()
    for k in range(len(shown[0].members[0].times)):
        each = zip(shown, digits, strict=True)
        data = [_coordinates(points, own) for scene, own in each for points in _moving_points(scene, k)]
        frames.append({"name": str(k), "data": data, "traces": places})
    return {"data": still + first, "layout": _layout(shown, title), "frames": frames}


def _scene(k: int) -> str:
    """Plotly's name for the part of the page with scene k."""
    return f"scene{k + 1}" if k else "scene"


def _still(scene: Scene) -> list[tuple[np.ndarray, dict[str, Any]]]:
    """The sphere with the paths on it and the axes of space; or the tracks and the surroundings."""
    first = scene.members[0]
    every = -(-len(first.path_times) // _MOST_POINTS)
    if scene.limits is None:
        axes = _joined(np.stack([np.zeros(3), 1.15 * direction]) for direction in np.eye(3))
        sphere = _joined(np.roll(circle(73), i, axis=1) for i in range(3))
        letters = ["", "x", "", "", "y", "", "", "z", ""]
        momentum = "path of the angular momentum"
        return [
            (axes, _line("space", GREY, 3) | {"mode": "lines+text", "text": letters}),
            (sphere, _line("unit sphere", GREY, 1, opacity=0.6)),
            (first.path_tips[::every], _line(f"path of {first.axis}", BLUE, 3, showlegend=True)),
            (first.path_momenta[::every], _line(momentum, GREEN, 3, showlegend=True)),
        ]
    found = list[tuple[np.ndarray, dict[str, Any]]]()
    if scene.around.planet is not None:
        points, triangles = ball(scene.around.planet)
        light = {"ambient": 0.6, "diffuse": 0.6, "specular": 0.0}
        found.append((points, _mesh("planet", triangles, color=PLANET, lighting=light)))
    if edges := scene.around.edges:
        found.append((_joined(edges), _line("box", GREY, 2)))
    tracks = [(travel.track[::every], name, colour) for _, travel, name, colour in scene.tracks]
    if tracks and not scene.few:
        return [*found, (_joined(track for track, _, _ in tracks), _line("paths", GREY, 1))]
    return found + [(track, _line(name, colour, 3, showlegend=True)) for track, name, colour in tracks]


def _moving_points(scene: Scene, k: int) -> list[np.ndarray]:
    """The points of the traces of `_moving` at frame k."""
    found = [np.concatenate(scene.sites(k))]
    if not scene.solid:
        found.append(_joined(scene.sticks(k)))
    ends = [(member, member.tips[k]) for member, _, _ in scene.axes]
    if scene.alone:
        ends.append((scene.members[0], scene.members[0].momenta[k]))
    return found + [member.placed(k, np.stack([np.zeros(3), end])) for member, end in ends]


def _moving(scene: Scene) -> list[dict[str, Any]]:
    """The bodies and, unless they are many, their axes; for one body also its momentum. They lack their points."""
    if scene.solid:
        found = [_solids(scene)]
    else:
        colours, sizes = scene.styles_of_sites(*(_DOTS if scene.few else _MANY_DOTS))
        dots = {"mode": "markers", "marker": {"color": colours, "size": sizes}}
        found = [_line("points", GREY, 1, **dots), _line("bonds", GREY, 4 if scene.few else 2)]
    ends = [(name, colour) for _, name, colour in scene.axes] + [("angular momentum", GREEN)] * scene.alone
    for name, colour in ends:
        dots = {"mode": "lines+markers", "marker": {"color": colour, "size": [0, 5]}}
        found.append(_line(name, colour, 7, **dots, showlegend=True))
    return found


def _solids(scene: Scene) -> dict[str, Any]:
    """All solids as one mesh; the faces of a single body have different colours."""
    corners, colours, begin = list[tuple[int, int, int]](), list[str](), 0
    for member, own in zip(scene.members, scene.colours, strict=True):
        several = _ROUND_COLOURS if member.shape.round else _FACE_COLOURS
        several = several[:1] if member.shape.one_colour else several
        for place, face in enumerate(member.shape.faces):
            triangles = [(begin + face[0], begin + b, begin + c) for b, c in pairwise(face[1:])]
            corners.extend(triangles)
            colours.extend([several[min(place, len(several) - 1)] if scene.alone else own] * len(triangles))
        begin += len(member.shape.corners)
    light = {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05}
    return _mesh("body", np.array(corners), facecolor=colours, flatshading=True, lighting=light)


def _mesh(name: str, triangles: np.ndarray, **style: Any) -> dict[str, Any]:
    corners = dict(zip("ijk", triangles.T.tolist(), strict=True))
    return {"type": "mesh3d", "name": name, **corners, "hoverinfo": "skip", **style}


def _line(name: str, colour: str, width: int, **more: Any) -> dict[str, Any]:
    trace = {"type": "scatter3d", "mode": "lines", "name": name, "line": {"color": colour, "width": width}}
    return {**trace, "hoverinfo": "skip", "showlegend": False, **more}


def _joined(lines: Iterable[np.ndarray]) -> np.ndarray:
    """Lines (n, 3) with gaps between them."""
    gap = np.full((1, 3), np.nan)
    return np.concatenate([part for line in lines for part in (line, gap)] or [gap])


def _coordinates(points: np.ndarray, digits: int) -> dict[str, list[Any]]:
    """Points (n, 3) as plotly's x, y and z, with null for NaN, which JSON lacks; plotly interrupts a line there."""
    rounded = np.round(np.asarray(points, float), digits)
    if np.any(gaps := np.isnan(rounded)):
        rounded = rounded.astype(object)
        rounded[gaps] = None
    return dict(zip("xyz", rounded.T.tolist(), strict=True))


def _digits(scene: Scene) -> int:
    """The decimals of the coordinates, which are about 1 unless the body translates."""
    if scene.limits is None:
        return _DIGITS
    # The body must be resolved as well, which is about a tenth of the picture.
    return _DIGITS + 1 - int(np.ceil(np.log10(np.max(np.ptp(scene.limits, axis=0)))))


def _layout(shown: Sequence[Scene], title: str) -> dict[str, Any]:
    play = {"frame": {"duration": _MILLISECONDS, "redraw": True}, "fromcurrent": True, "transition": {"duration": 0}}
    stop = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate", "transition": {"duration": 0}}
    times = map(time_text, shown[0].members[0].times.tolist())
    steps = [{"method": "animate", "label": t, "args": [[str(k)], stop]} for k, t in enumerate(times)]
    rows, columns = grid(len(shown))
    corners = [(k % columns, k // columns) for k in range(len(shown))]
    places = [((i / columns, (i + 1) / columns), (1 - (j + 1) / rows, 1 - j / rows)) for i, j in corners]
    words = ["<br>".join([f"<b>{one.title}</b>"] * bool(one.title) + [*one.remarks]) for one in shown]
    alone = len(shown) == 1
    heading = "<br>".join(filter(None, [title, words[0]])) if alone else title
    legend = {"x": 0.02, "y": 0.98} if alone else {"x": 0.02, "y": 1.0, "yanchor": "bottom", "orientation": "h"}
    corner = {"align": "left", "xanchor": "left", "yanchor": "top"}
    paper = {"xref": "paper", "yref": "paper", "showarrow": False, **corner}
    each = zip(words, places, strict=True)
    notes = [{"text": text, **paper, "x": x[0] + 0.02, "y": y[1] - 0.01} for text, (x, y) in each]
    lower_left = {"x": 0.02, "y": 0.0, "xanchor": "left", "yanchor": "top", "pad": {"t": 42}}
    buttons = [
        {"label": "play", "method": "animate", "args": [None, play]},
        {"label": "pause", "method": "animate", "args": [[None], stop]},
    ]
    slider = {"steps": steps, "x": 0.2, "len": 0.77, "y": 0.0, "yanchor": "top", "pad": {"t": 30, "b": 10}}
    ticks = {"currentvalue": {"prefix": "time "}, "minorticklen": 0, "ticklen": 0, "bgcolor": GREY}
    return {
        "title": {"text": heading, "x": 0.02, "font": {"size": 15}},
        "margin": {"l": 0, "r": 0, "t": (50 if heading else 10) + (0 if alone else 30), "b": 100},
        "template": {},
        "autosize": True,
        **{_scene(k): _seen(*pair, columns / rows) for k, pair in enumerate(zip(shown, places, strict=True))},
        "annotations": [] if alone else notes,
        "legend": legend | {"bgcolor": "rgba(0,0,0,0)"},
        "updatemenus": [
            {"type": "buttons", "direction": "left", "showactive": False, **lower_left, "buttons": buttons}
        ],
        "sliders": [slider | ticks],
    }


def _seen(scene: Scene, place: tuple[Any, Any], columns: float) -> dict[str, Any]:
    """The part of the page, as fractions, for one scene, and its viewpoint."""
    limits = scene.limits
    if limits is None:
        hidden = {"visible": False, "range": [-_REACH, _REACH]}
        axes: dict[str, Any] = {**dict.fromkeys(("xaxis", "yaxis", "zaxis"), hidden), "aspectmode": "cube"}
        near, lower = max(1.0, 0.45 * columns), 0.0  # a narrow part cuts off the left and right sides
    else:
        spans = limits[1] - limits[0]
        grid = {"gridcolor": GREY, "zerolinecolor": GREY, "showbackground": False, "showspikes": False}
        numbers = {"nticks": 5, "exponentformat": "power", "showexponent": "all"}
        axes = {
            f"{letter}axis": {"title": {"text": f"{letter} [length]"}, "range": ends, **grid, **numbers}
            for letter, ends in zip("xyz", limits.T.tolist(), strict=True)
        }
        sides = dict(zip("xyz", (1.3 * spans / spans.max()).tolist(), strict=True))
        axes |= {"aspectmode": "manual", "aspectratio": sides}
        # The viewpoint is farther away if the axes have tick labels, and farther for narrower parts; it looks at a
        # lower position, to show the names of x and y.
        high = spans[2] / spans.max()
        near, lower = (1.75 + 0.25 * high) * max(1.0, 0.6 * columns), -0.1 - 0.1 * high
    eye = {"x": 0.76 * near, "y": -1.05 * near, "z": 0.56 * near}
    return {
        **axes,
        "domain": dict(zip("xy", map(list, place), strict=True)),
        "camera": {"eye": eye, "center": {"x": 0.0, "y": 0.0, "z": lower}},
        "dragmode": "orbit",
    }
