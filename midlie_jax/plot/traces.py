"""The traces of a view: what of a moving body stands still, and what moves, as plotly's dictionaries."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from .around import ball
from .style import BLUE, GREEN, GREY, ORANGE, PLANET, VERMILLION
from .together import Together
from .turning import Turning

_MOST_POINTS = 4000
_DIGITS = 5  # of the coordinates, relative to the size of the picture
_DOTS, _MANY_DOTS = (12, 6), (9, 5)  # sizes of the first point of a body and of its others, pixels
_FACE_COLOURS = (ORANGE, "#f3c96b", "#8fc6ea", "#c9e3f5", "#9a9a9a", "#c4c4c4")  # of a box, in the order of its faces
_ROUND_COLOURS = (ORANGE, "#8fc6ea", "#f3c96b")  # of a cylinder: the end at e3, the other end, and the side


def still_traces(shown: Together) -> list[dict[str, Any]]:
    """The sphere with the paths on it and the axes of space; of a few bodies that travel their tracks."""
    first, digits = shown.members[0], _digits(shown)
    every = -(-len(first.path_times) // _MOST_POINTS)
    if shown.limits is None:
        return [
            _space_axes(),
            _sphere(),
            _line(first.path_tips[::every], f"path of {first.axis}", BLUE, 3, digits, showlegend=True),
            _line(first.path_momenta[::every], "path of the angular momentum", GREEN, 3, digits, showlegend=True),
        ]
    tracks = [member.travel.track[::every] for member in shown.members if member.travel is not None]
    around = _planet(shown.around.planet, digits) if shown.around.planet is not None else []
    if edges := shown.around.edges:
        around.append(_pieces(edges, "box", 2, digits))
    if not shown.has_tracks:
        return around
    if not shown.few:
        return [*around, _pieces(tracks, "paths", 1, digits)]
    names = ["path of the centre of mass"] if shown.alone else [f"path of {shown.named(i)}" for i in range(len(tracks))]
    colours = [VERMILLION] if shown.alone else shown.colours
    return around + [
        _line(track, name, colour, 3, digits, showlegend=True)
        for track, name, colour in zip(tracks, names, colours, strict=True)
    ]


def moving_traces(shown: Together, k: int) -> list[dict[str, Any]]:
    """The bodies and, unless they are many, their axes at frame k; of one body its momentum, too."""
    digits = _digits(shown)
    bodies = [_solids(shown, k, digits)] if shown.solid else _sites(shown, k, digits)
    if shown.alone:
        (member,) = shown.members
        ends = [(member, member.tips[k], f"{member.axis} of the body", BLUE)]
        ends.append((member, member.momenta[k], "angular momentum", GREEN))
    else:
        few = shown.few and shown.solid
        pairs = list(zip(shown.members, shown.colours, strict=True)) if few else []
        ends = [(m, m.tips[k], f"{m.axis} of {shown.named(i)}", colour) for i, (m, colour) in enumerate(pairs)]
    return [*bodies, *(_arrow(member, k, end, name, colour, digits) for member, end, name, colour in ends)]


def _solids(shown: Together, k: int, digits: int) -> dict[str, Any]:
    """All solids as one mesh."""
    corners, colours, begin = list[tuple[int, int, int]](), list[str](), 0
    for member, own in zip(shown.members, shown.colours, strict=True):
        for place, face in enumerate(member.shape.faces):
            colour = _colour(member, place) if shown.alone else own
            triangles = [(begin + face[0], begin + b, begin + c) for b, c in pairwise(face[1:])]
            corners.extend(triangles)
            colours.extend([colour] * len(triangles))
        begin += len(member.shape.corners)
    x, y, z = (_numbers(column, digits) for column in np.concatenate(shown.sites(k)).T)
    i, j, last = (list(column) for column in zip(*corners, strict=True))
    mesh: dict[str, Any] = {"type": "mesh3d", "name": "body", "x": x, "y": y, "z": z, "i": i, "j": j, "k": last}
    return mesh | {
        "facecolor": colours,
        "flatshading": True,
        "hoverinfo": "skip",
        "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
    }


def _sites(shown: Together, k: int, digits: int) -> list[dict[str, Any]]:
    """The points of all bodies, and the lines between those of one body."""
    first, other = _DOTS if shown.few else _MANY_DOTS
    sizes = [other if place else first for member in shown.members for place in _places(member)]
    dots = {"mode": "markers", "marker": {"color": shown.colours_of_sites, "size": sizes}}
    return [
        _line(np.concatenate(shown.sites(k)), "points", GREY, 1, digits, **dots),
        _pieces(shown.sticks(k), "bonds", 4 if shown.few else 2, digits),
    ]


def _pieces(lines: Sequence[np.ndarray], name: str, width: int, digits: int, **more: Any) -> dict[str, Any]:
    """Several grey lines (n, 3) as one trace."""
    gap = np.full((1, 3), np.nan)
    points = np.concatenate([part for line in lines for part in (line, gap)] or [gap])
    return _without_nan(_line(points, name, GREY, width, digits, **more))


def _planet(radius: float, digits: int) -> list[dict[str, Any]]:
    points, triangles = ball(radius)
    x, y, z = (_numbers(column, digits) for column in points.T)
    i, j, k = triangles.T.tolist()
    mesh = {"type": "mesh3d", "name": "planet", "x": x, "y": y, "z": z, "i": i, "j": j, "k": k, "color": PLANET}
    return [mesh | {"hoverinfo": "skip", "lighting": {"ambient": 0.6, "diffuse": 0.6, "specular": 0.0}}]


def _places(member: Turning) -> range:
    return range(len(member.shape.corners))


def _arrow(member: Turning, k: int, end: np.ndarray, name: str, colour: str, digits: int) -> dict[str, Any]:
    """A line from the middle of a body, with a dot at its end."""
    points = member.placed(k, np.stack([np.zeros(3), end]))
    marker = {"color": colour, "size": [0, 5]}
    return _line(points, name, colour, 7, digits, mode="lines+markers", marker=marker, showlegend=True)


def _colour(shown: Turning, place: int) -> str:
    return _ROUND_COLOURS[min(place, 2)] if shown.shape.round else _FACE_COLOURS[place]


def _digits(shown: Together) -> int:
    """The decimals of the coordinates, which are about 1 unless the body travels."""
    limits = shown.limits
    if limits is None:
        return _DIGITS
    # The body must be resolved, too, which is about a tenth of the picture.
    return _DIGITS + 1 - int(np.ceil(np.log10(np.max(np.ptp(limits, axis=0)))))


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
    return _pieces([np.roll(circle, shift, axis=1) for shift in range(3)], "unit sphere", 1, _DIGITS, opacity=0.6)


def _without_nan(trace: dict[str, Any]) -> dict[str, Any]:
    """The trace with null for NaN, which JSON lacks; plotly interrupts a line at either."""
    return trace | {key: [None if v != v else v for v in trace[key]] for key in "xyz"}
