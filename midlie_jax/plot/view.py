"""`view`: a turning body in one HTML file that needs no network, made by plotly."""

from pathlib import Path
from typing import Any

import numpy as np

from .style import BLUE, GREEN, GREY, ORANGE, SKY
from .turning import FACES, Turning, picture_file, turning

_MOST_FRAMES, _MOST_POINTS = 1000, 4000
_DIGITS = 5  # of the coordinates, which are at most about 1
_MILLISECONDS = 40  # for which a frame is shown
_FACE_COLOURS = (ORANGE, "#f3c96b", "#8fc6ea", "#c9e3f5", "#9a9a9a", "#c4c4c4")  # in the order of FACES
_REACH = 1.25
_PAGE: dict[str, Any] = {
    "validate": False,
    "default_height": "96vh",
    "config": {"displaylogo": False, "responsive": True},
}
# The colours of page and text follow the browser, which is set to light or dark; the body is legible on both.
_FOLLOW = """
const gd = document.getElementById('{plot_id}');
const dark = window.matchMedia('(prefers-color-scheme: dark)');
function follow() {
  const paper = dark.matches ? '#111111' : '#ffffff', ink = dark.matches ? '#eeeeee' : '#222222';
  const blue = dark.matches ? 'LIGHT_BLUE' : 'BLUE';
  document.body.style.background = paper;
  document.body.style.margin = '0';
  return Plotly.relayout(gd, {'paper_bgcolor': paper, 'font.color': ink, 'updatemenus[0].bgcolor': paper})
    .then(() => Plotly.restyle(gd, {'textfont.color': ink}, [0]))
    .then(() => Plotly.restyle(gd, {'line.color': blue, 'marker.color': blue}, BLUE_LINES));
}
dark.addEventListener('change', follow);
follow().then(() => { document.body.dataset.drawn = 'yes'; });
"""


def view(
    body: Any,
    path: Any,
    file: str | Path = "view.html",
    *,
    axis: Any = 2,
    frames: int = 200,
    title: str = "",
) -> Path:
    """Writes an HTML file with a turning body that can be looked at from all sides, played, and set to any time.

    It shows a box of the body's moments of inertia, an axis of the body and its path on the unit sphere, and the
    angular momentum and its path, over its largest length. All of it is in the space frame, whose axes x, y, z are
    drawn. The file contains plotly, some 5 MB, and loads nothing: it works without a network. The page is light or dark
    as the reader's browser is.

    Args:
        body: the body of the path, a `RigidBody` or a `TensorBody`.
        path: of one body, from `integrate`, `integrate_adaptive` or `free_motion`, with `RigidState`s. Of more than
            4,000 saved states every so many are drawn.
        file: the file to write; an existing one is replaced.
        axis: 0, 1 or 2 for an axis of the body frame, or a unit vector (3,) in that frame.
        frames: at how many evenly spaced times the body is shown, at most 1,000. If the body turns by more than a
            quarter of a turn from one to the next, the picture says by how many turns.
        title: a line above.

    Returns:
        The path of the file.

    Raises:
        ValueError: the path is not of one body with attitudes, or its first two states are bad; an argument is out of
            its range.
        ImportError: plotly is not installed.
        OSError: the file cannot be written.
    """
    target = picture_file(file, ".html")
    shown = turning(body, path, axis, frames, _MOST_FRAMES)
    try:
        from plotly.io import to_html
    except ImportError as error:
        raise ImportError("a view needs plotly: pip install 'midlie_jax[plot]'.") from error
    figure = _figure(shown, title)
    blue = [place for place, trace in enumerate(figure["data"]) if trace.get("line", {}).get("color") == BLUE]
    follow = _FOLLOW.replace("BLUE_LINES", str(blue)).replace("LIGHT_BLUE", SKY).replace("BLUE", BLUE)
    page = to_html(figure, include_plotlyjs=True, auto_play=False, post_script=follow, **_PAGE)
    target.write_text(page, encoding="utf-8")
    return target


def _figure(shown: Turning, title: str) -> dict[str, Any]:
    """The picture as plotly's dictionary."""
    still = [_space_axes(), _sphere(), *_paths(shown)]
    moving = list(range(len(still), len(still) + 3))
    play = {"frame": {"duration": _MILLISECONDS, "redraw": True}, "fromcurrent": True, "transition": {"duration": 0}}
    stop = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate", "transition": {"duration": 0}}
    steps = [
        {"method": "animate", "label": f"{t:.4g}", "args": [[str(k)], stop]}
        for k, t in enumerate(map(float, shown.times))
    ]
    hidden = {"visible": False, "range": [-_REACH, _REACH]}
    layout = {
        "title": {"text": "<br>".join(filter(None, [title, *shown.remarks])), "x": 0.02, "font": {"size": 15}},
        "margin": {"l": 0, "r": 0, "t": 50 if title or shown.remarks else 10, "b": 100},
        "template": {},
        "autosize": True,
        "scene": {
            **dict.fromkeys(("xaxis", "yaxis", "zaxis"), hidden),
            "aspectmode": "cube",
            "domain": {"x": [0, 1], "y": [0, 1]},
            "camera": {"eye": {"x": 0.76, "y": -1.05, "z": 0.56}},
            "dragmode": "orbit",
        },
        "legend": {"x": 0.02, "y": 0.98, "bgcolor": "rgba(0,0,0,0)"},
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
    # The places alone: colours are those of the first frame, or of the reader's browser.
    places = [[{axis: trace[axis] for axis in "xyz"} for trace in _moving(shown, k)] for k in range(len(shown.times))]
    frames = [{"name": str(k), "data": data, "traces": moving} for k, data in enumerate(places)]
    return {"data": still + _moving(shown, 0), "layout": layout, "frames": frames}


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
    """Three great circles."""
    angle = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    gap = np.full((1, 3), np.nan)
    points = np.concatenate([part for shift in range(3) for part in (np.roll(circle, shift, axis=1), gap)])
    return _without_nan(_line(points, "unit sphere", GREY, 1, opacity=0.6))


def _without_nan(trace: dict[str, Any]) -> dict[str, Any]:
    """NaN as null, where plotly interrupts a line: JSON has no NaN."""
    return trace | {key: [None if v != v else v for v in trace[key]] for key in "xyz"}


def _paths(shown: Turning) -> list[dict[str, Any]]:
    every = -(-len(shown.path_times) // _MOST_POINTS)
    return [
        _line(shown.path_tips[::every], f"path of {shown.axis}", BLUE, 3, showlegend=True),
        _line(shown.path_momenta[::every], "path of the angular momentum", GREEN, 3, showlegend=True),
    ]


def _moving(shown: Turning, k: int) -> list[dict[str, Any]]:
    """The box, the axis, in the colour of its path, and the momentum at frame k."""
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
