"""`view`: turning bodies in one HTML page that needs no network, made by plotly, for a notebook or a file."""

from collections.abc import Sequence
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .several import Bodies, Paths, grid, panels
from .style import BLUE, GREEN, GREY, ORANGE, SKY
from .turning import FACES, Turning, picture_file, turnings

_MOST_FRAMES, _MOST_POINTS = 1000, 4000
_DIGITS = 5  # decimals of the coordinates, which are at most about 1
_MILLISECONDS = 40  # how long a frame is shown
_FACE_COLOURS = (ORANGE, "#f3c96b", "#8fc6ea", "#c9e3f5", "#9a9a9a", "#c4c4c4")  # in the order of FACES
_REACH = 1.25
_HEIGHT = 560  # the height of a view in a notebook, pixels
_PAGE: dict[str, Any] = {
    "validate": False,
    "default_height": "96vh",
    "div_id": "midlie-view",  # fixed, so that the same motion gives the same page
    "config": {"displaylogo": False, "responsive": True},
}
# The colours of page and text follow the setting of the browser, light or dark; the body is visible on both.
_FOLLOW = """
const gd = document.getElementById('{plot_id}');
const dark = window.matchMedia('(prefers-color-scheme: dark)');
function follow() {
  const paper = dark.matches ? '#111111' : '#ffffff', ink = dark.matches ? '#eeeeee' : '#222222';
  const blue = dark.matches ? 'LIGHT_BLUE' : 'BLUE';
  document.body.style.background = paper;
  document.body.style.margin = '0';
  return Plotly.relayout(gd, {'paper_bgcolor': paper, 'font.color': ink, 'updatemenus[0].bgcolor': paper})
    .then(() => Plotly.restyle(gd, {'textfont.color': ink}, LETTERS))
    .then(() => Plotly.restyle(gd, {'line.color': blue, 'marker.color': blue}, BLUE_LINES));
}
dark.addEventListener('change', follow);
follow().then(() => { document.body.dataset.drawn = 'yes'; });
"""


class View:
    """Turning bodies, to be looked at from all sides: shown in a notebook as the value of a cell, or in a browser.

    Attributes:
        file: the file that was written last; None if there is none.
    """

    def __init__(self, figure: dict[str, Any]):
        self._figure = figure
        self.file: Path | None = None

    @property
    def html(self) -> str:
        """The whole page, some 5 MB, nearly all of it plotly."""
        from plotly.io import to_html

        data = self._figure["data"]
        blue = [place for place, trace in enumerate(data) if trace.get("line", {}).get("color") == BLUE]
        letters = [place for place, trace in enumerate(data) if "text" in trace]
        follow = _FOLLOW.replace("BLUE_LINES", str(blue)).replace("LIGHT_BLUE", SKY).replace("BLUE", BLUE)
        follow = follow.replace("LETTERS", str(letters))
        return to_html(self._figure, include_plotlyjs=True, auto_play=False, post_script=follow, **_PAGE)

    def write(self, file: str | Path) -> Path:
        """Writes the page to a file .html, replacing an existing one, and returns the path of the file.

        Raises:
            ValueError: the name has another ending.
            OSError: the file cannot be written.
        """
        target = picture_file(file, ".html")
        target.write_text(self.html, encoding="utf-8")
        self.file = target
        return target

    def _repr_html_(self) -> str:
        """The page in an HTML frame of its own, so that page and notebook do not interfere."""
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
) -> View:
    """A turning body that can be looked at from all sides, played, and set to any time, in a notebook or a browser.

    As the last value of a notebook's cell it is displayed there, and the notebook grows by 5 MB. It shows a box with
    the body's moments of inertia, an axis of the body and its path on the unit sphere, and the angular momentum over
    its largest length, with its path. All of it is in the space frame, whose axes x, y, z are drawn. Several bodies, or
    one body moved by several methods, stand side by side at the same times. The page contains plotly, some 5 MB, and
    loads nothing: it works without a network. It is light or dark like the reader's browser.

    Args:
        body: the body of the path, a `RigidBody` or a `TensorBody`; for several paths one body for all, a list with one
            for each, or the bodies of an ensemble.
        path: a `Path` or `AdaptivePath` of one body with `RigidState`s, from `integrate`, `integrate_adaptive` or
            `free_motion`. Or up to 12 paths: a mapping of names to paths, such as {"JACOBI[EA]": path}, a list, or a
            path of `ensemble`. If there are more than 4,000 saved states, only every second, third, ... of them is
            drawn.
        file: a file .html to write; an existing one is replaced. By default none is written.
        axis: an axis of the body: "e1", "e2", "e3" or its index 0, 1, 2, or a unit vector (3,) in the body frame.
        frames: at how many evenly spaced times the body is shown, at most 1,000. If the body turns by more than a
            quarter of a turn from one frame to the next, the picture says by how many turns.
        title: a line above the picture.

    Returns:
        The `View`, whose `file` is the file that was written.

    Raises:
        ValueError: a path is not of one body with attitudes, or its first two states are bad; an argument is out of
            its range.
        ImportError: plotly is not installed.
        OSError: the file cannot be written.
    """
    if file is not None:
        picture_file(file, ".html")
    shown = panels(body, path)
    turns = turnings([(panel.body, panel.path) for panel in shown], axis, frames, _MOST_FRAMES)
    if find_spec("plotly") is None:
        raise ImportError("a view needs plotly: pip install 'midlie_jax[plot]'.")
    found = View(_figure([panel.name for panel in shown], turns, title))
    if file is not None:
        found.write(file)
    return found


def _figure(names: Sequence[str], turns: Sequence[Turning], title: str) -> dict[str, Any]:
    """The picture as plotly's dictionary."""
    still = [
        trace for k, shown in enumerate(turns) for trace in _seen_in(k, [_space_axes(), _sphere(), *_paths(shown)])
    ]
    first = [trace for k, shown in enumerate(turns) for trace in _seen_in(k, _moving(shown, 0))]
    moving = list(range(len(still), len(still) + len(first)))
    # Later frames hold only coordinates: colours are those of the first frame, or of the reader's browser.
    times = [float(t) for t in turns[0].times]
    places = [
        [{axis: trace[axis] for axis in "xyz"} for shown in turns for trace in _moving(shown, k)]
        for k in range(len(times))
    ]
    frames = [{"name": str(k), "data": data, "traces": moving} for k, data in enumerate(places)]
    return {"data": still + first, "layout": _layout(names, turns, title, times), "frames": frames}


def _scene(k: int) -> str:
    """Plotly's name for the part of the page in which body k is seen."""
    return f"scene{k + 1}" if k else "scene"


def _seen_in(k: int, traces: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The traces of body k; the legend lists only those of the first body."""
    return [trace | {"scene": _scene(k)} | ({"showlegend": False} if k else {}) for trace in traces]


def _layout(names: Sequence[str], turns: Sequence[Turning], title: str, times: Sequence[float]) -> dict[str, Any]:
    """Where the bodies are seen, their names, the buttons and the slider."""
    play = {"frame": {"duration": _MILLISECONDS, "redraw": True}, "fromcurrent": True, "transition": {"duration": 0}}
    stop = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate", "transition": {"duration": 0}}
    steps = [{"method": "animate", "label": f"{t:.4g}", "args": [[str(k)], stop]} for k, t in enumerate(times)]
    rows, columns = grid(len(turns))
    places = [
        ((k % columns / columns, (k % columns + 1) / columns), (1 - (k // columns + 1) / rows, 1 - k // columns / rows))
        for k in range(len(turns))
    ]
    words = [
        "<br>".join(filter(None, [f"<b>{n}</b>" * bool(n), *t.remarks])) for n, t in zip(names, turns, strict=True)
    ]
    alone = len(turns) == 1
    heading = "<br>".join(filter(None, [title, words[0]])) if alone else title
    legend = {"x": 0.02, "y": 0.98} if alone else {"x": 0.02, "y": 1.0, "yanchor": "bottom", "orientation": "h"}
    return {
        "title": {"text": heading, "x": 0.02, "font": {"size": 15}},
        "margin": {"l": 0, "r": 0, "t": (50 if heading else 10) + (0 if alone else 30), "b": 100},
        "template": {},
        "autosize": True,
        **{_scene(k): _seen(*place) for k, place in enumerate(places)},
        "annotations": [] if alone else [_note(text, *place) for text, place in zip(words, places, strict=True)],
        "legend": legend | {"bgcolor": "rgba(0,0,0,0)"},
        "updatemenus": [
            {
                "type": "buttons",
                "direction": "left",
                "showactive": False,
                "x": 0.02,
                "y": 0.0,
                "xanchor": "left",
                "yanchor": "top",
                "pad": {"t": 42},
                "buttons": [
                    {"label": "play", "method": "animate", "args": [None, play]},
                    {"label": "pause", "method": "animate", "args": [[None], stop]},
                ],
            }
        ],
        "sliders": [
            {
                "steps": steps,
                "x": 0.2,
                "len": 0.77,
                "y": 0.0,
                "yanchor": "top",
                "pad": {"t": 30, "b": 10},
                "currentvalue": {"prefix": "time "},
                "minorticklen": 0,
                "ticklen": 0,
                "bgcolor": GREY,
            }
        ],
    }


def _seen(x: tuple[float, float], y: tuple[float, float]) -> dict[str, Any]:
    """The part of the page, as fractions, in which one body is seen, and from where."""
    hidden = {"visible": False, "range": [-_REACH, _REACH]}
    return {
        **dict.fromkeys(("xaxis", "yaxis", "zaxis"), hidden),
        "aspectmode": "cube",
        "domain": {"x": list(x), "y": list(y)},
        "camera": {"eye": {"x": 0.76, "y": -1.05, "z": 0.56}},
        "dragmode": "orbit",
    }


def _note(text: str, x: tuple[float, float], y: tuple[float, float]) -> dict[str, Any]:
    """The name of one body, at the upper left of its part of the page."""
    corner = {"x": x[0] + 0.02, "y": y[1] - 0.01, "xanchor": "left", "yanchor": "top"}
    return {"text": text, "xref": "paper", "yref": "paper", "showarrow": False, "align": "left", **corner}


def _numbers(values: np.ndarray) -> list[Any]:
    return np.round(np.asarray(values, float), _DIGITS).tolist()


def _line(points: np.ndarray, name: str, colour: str, width: int, **more: Any) -> dict[str, Any]:
    """A line through points (n, 3)."""
    x, y, z = (_numbers(column) for column in points.T)
    line = {"color": colour, "width": width}
    trace = {"type": "scatter3d", "mode": "lines", "name": name, "line": line, "hoverinfo": "skip", "showlegend": False}
    return {**trace, "x": x, "y": y, "z": z, **more}


def _space_axes() -> dict[str, Any]:
    nothing = np.full(3, np.nan)
    points = np.concatenate([[np.zeros(3), 1.15 * direction, nothing] for direction in np.eye(3)])
    trace = _line(points, "space", GREY, 3, mode="lines+text", text=["", "x", "", "", "y", "", "", "z", ""])
    return _without_nan(trace)


def _sphere() -> dict[str, Any]:
    """The unit sphere, as three great circles."""
    angle = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    gap = np.full((1, 3), np.nan)
    points = np.concatenate([part for shift in range(3) for part in (np.roll(circle, shift, axis=1), gap)])
    return _without_nan(_line(points, "unit sphere", GREY, 1, opacity=0.6))


def _without_nan(trace: dict[str, Any]) -> dict[str, Any]:
    """The trace with null for NaN, which JSON lacks; plotly interrupts a line at either."""
    return trace | {key: [None if v != v else v for v in trace[key]] for key in "xyz"}


def _paths(shown: Turning) -> list[dict[str, Any]]:
    every = -(-len(shown.path_times) // _MOST_POINTS)
    return [
        _line(shown.path_tips[::every], f"path of {shown.axis}", BLUE, 3, showlegend=True),
        _line(shown.path_momenta[::every], "path of the angular momentum", GREEN, 3, showlegend=True),
    ]


def _moving(shown: Turning, k: int) -> list[dict[str, Any]]:
    """The box, the axis (in the colour of its path) and the momentum, at frame k."""
    x, y, z = (_numbers(column) for column in shown.corners[k].T)
    triangles = [part for a, b, c, d in FACES for part in ((a, b, c), (a, c, d))]
    i, j, k_ = (list(corner) for corner in zip(*triangles, strict=True))
    box: dict[str, Any] = {"type": "mesh3d", "name": "body", "x": x, "y": y, "z": z, "i": i, "j": j, "k": k_}
    box |= {
        "facecolor": [colour for colour in _FACE_COLOURS for _ in range(2)],
        "flatshading": True,
        "hoverinfo": "skip",
        "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
    }
    tips = [
        _line(np.stack([np.zeros(3), end]), name, colour, 7, mode="lines+markers", marker=_dot(colour), showlegend=True)
        for end, name, colour in (
            (shown.tips[k], f"{shown.axis} of the body", BLUE),
            (shown.momenta[k], "angular momentum", GREEN),
        )
    ]
    return [box, *tips]


def _dot(colour: str) -> dict[str, Any]:
    return {"color": colour, "size": [0, 5]}
