"""The traces of a view: what of a moving body stands still, and what moves, as plotly's dictionaries."""

from itertools import pairwise
from typing import Any

import numpy as np

from .style import BLUE, GREEN, GREY, ORANGE, VERMILLION
from .turning import Turning

_MOST_POINTS = 4000
_DIGITS = 5  # of the coordinates, relative to the size of the picture
_FACE_COLOURS = (ORANGE, "#f3c96b", "#8fc6ea", "#c9e3f5", "#9a9a9a", "#c4c4c4")  # of a box, in the order of its faces
_ROUND_COLOURS = (ORANGE, "#8fc6ea", "#f3c96b")  # of a cylinder: the end at e3, the other end, and the side


def still_traces(shown: Turning) -> list[dict[str, Any]]:
    """The sphere with the paths on it and the axes of space; of a body that travels its track."""
    every, digits = -(-len(shown.path_times) // _MOST_POINTS), _digits(shown)
    if shown.travel is not None:
        track = shown.travel.track[::every]
        return [_line(track, "path of the centre of mass", VERMILLION, 3, digits, showlegend=True)]
    return [
        _space_axes(),
        _sphere(),
        _line(shown.path_tips[::every], f"path of {shown.axis}", BLUE, 3, digits, showlegend=True),
        _line(shown.path_momenta[::every], "path of the angular momentum", GREEN, 3, digits, showlegend=True),
    ]


def moving_traces(shown: Turning, k: int) -> list[dict[str, Any]]:
    """The body, the axis (in the colour of its path) and the momentum, at frame k."""
    digits = _digits(shown)
    x, y, z = (_numbers(column, digits) for column in shown.placed(k, shown.corners[k]).T)
    faces = shown.shape.faces
    triangles = [(face[0], b, c) for face in faces for b, c in pairwise(face[1:])]
    i, j, k_ = (list(corner) for corner in zip(*triangles, strict=True))
    body: dict[str, Any] = {"type": "mesh3d", "name": "body", "x": x, "y": y, "z": z, "i": i, "j": j, "k": k_}
    body |= {
        "facecolor": [
            colour for place, face in enumerate(faces) for colour in [_colour(shown, place)] * (len(face) - 2)
        ],
        "flatshading": True,
        "hoverinfo": "skip",
        "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
    }
    tips = [
        _line(
            shown.placed(k, np.stack([np.zeros(3), end])),
            name,
            colour,
            7,
            digits,
            mode="lines+markers",
            marker={"color": colour, "size": [0, 5]},
            showlegend=True,
        )
        for end, name, colour in (
            (shown.tips[k], f"{shown.axis} of the body", BLUE),
            (shown.momenta[k], "angular momentum", GREEN),
        )
    ]
    return [body, *tips]


def _colour(shown: Turning, place: int) -> str:
    return _ROUND_COLOURS[min(place, 2)] if shown.shape.round else _FACE_COLOURS[place]


def _digits(shown: Turning) -> int:
    """The decimals of the coordinates, which are about 1 unless the body travels."""
    if shown.travel is None:
        return _DIGITS
    # The body must be resolved, too, which is about a tenth of the picture.
    return _DIGITS + 1 - int(np.ceil(np.log10(np.max(np.ptp(shown.travel.limits, axis=0)))))


def _numbers(values: np.ndarray, digits: int) -> list[Any]:
    return np.round(np.asarray(values, float), digits).tolist()


def _line(points: np.ndarray, name: str, colour: str, width: int, digits: int, **more: Any) -> dict[str, Any]:
    """A line through points (n, 3)."""
    x, y, z = (_numbers(column, digits) for column in points.T)
    line = {"color": colour, "width": width}
    trace = {"type": "scatter3d", "mode": "lines", "name": name, "line": line, "hoverinfo": "skip", "showlegend": False}
    return {**trace, "x": x, "y": y, "z": z, **more}


def _space_axes() -> dict[str, Any]:
    nothing = np.full(3, np.nan)
    points = np.concatenate([[np.zeros(3), 1.15 * direction, nothing] for direction in np.eye(3)])
    letters = ["", "x", "", "", "y", "", "", "z", ""]
    return _without_nan(_line(points, "space", GREY, 3, _DIGITS, mode="lines+text", text=letters))


def _sphere() -> dict[str, Any]:
    """The unit sphere, as three great circles."""
    angle = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    gap = np.full((1, 3), np.nan)
    points = np.concatenate([part for shift in range(3) for part in (np.roll(circle, shift, axis=1), gap)])
    return _without_nan(_line(points, "unit sphere", GREY, 1, _DIGITS, opacity=0.6))


def _without_nan(trace: dict[str, Any]) -> dict[str, Any]:
    """The trace with null for NaN, which JSON lacks; plotly interrupts a line at either."""
    return trace | {key: [None if v != v else v for v in trace[key]] for key in "xyz"}
