"""`view`: turning bodies in one HTML page that needs no network, made by plotly, for a notebook or a file."""

from collections.abc import Sequence
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .around import around_of
from .several import Bodies, Paths, grid, panels
from .style import BLUE, GREY, SKY, time_text
from .together import Together, togethers
from .traces import moving_traces, still_traces
from .turning import picture_file

_MOST_FRAMES = 1000
_MILLISECONDS = 40  # how long a frame is shown
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
  const some = (change, traces) => traces.length ? Plotly.restyle(gd, change, traces) : null;  // [] would mean all
  return Plotly.relayout(gd, {'paper_bgcolor': paper, 'font.color': ink, 'updatemenus[0].bgcolor': paper})
    .then(() => some({'textfont.color': ink}, LETTERS))
    .then(() => some({'line.color': blue, 'marker.color': blue}, BLUE_LINES));
}
dark.addEventListener('change', follow);
follow().then(() => { document.body.dataset.drawn = 'yes'; });
"""


class View:
    """Turning bodies, to be looked at from all sides: shown in a notebook as the value of a cell, or in a browser.

    Attributes:
        file: the file that was written last; None if there is none.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
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
    points: ArrayLike | None = None,
    together: bool = False,
    box: ArrayLike | None = None,
    planet: float | None = None,
) -> View:
    """A turning body that can be looked at from all sides, played, and set to any time, in a notebook or a browser.

    As the last value of a notebook's cell it is displayed there, and the notebook grows by 5 MB. It shows a box with
    the body's moments of inertia, an axis of the body and its path on the unit sphere, and the angular momentum over
    its largest length, with its path. All of it is in the space frame, whose axes x, y, z are drawn. Several bodies, or
    one body moved by several methods, stand side by side at the same times. The page contains plotly, some 5 MB, and
    loads nothing: it works without a network. It is light or dark like the reader's browser.

    A body that travels is shown at its place, with the track of its centre of mass in place of the unit sphere. If its
    path is so long that it could not be seen beside it, it is drawn larger, and the picture says how many times. A body
    of which only the axis of symmetry is known is drawn as a cylinder, or a rod, whose spin is not shown.

    Bodies that act on each other are shown in one space, each in its colour, if they travel; up to six have their axes
    and tracks. The bodies of a `Rod` touch each other, and so show how it bends and twists. Bodies that travel and do
    not act on each other, such as a fleet of satellites, are drawn so by `together`.

    Args:
        body: the body of the path: a `RigidBody`, a `TensorBody`, a `Rotor` or a `FreeBody`; for several paths one body
            for all, a list with one for each, or the bodies of an ensemble.
        path: a `Path` or `AdaptivePath` of one body with attitudes or axes (`RigidState`, `AxisState`, `FreeState`,
            `FreeAxisState`), from `integrate`, `integrate_adaptive` or `free_motion`; or a path of coupled bodies. Or
            up to 12 paths: a mapping of names to paths, such as {"JACOBI[EA]": path}, a list, or a path of `ensemble`;
            up to 500 with `together`.
            If there are more than 4,000 saved states, only every second, third, ... of them is drawn.
        file: a file .html to write; an existing one is replaced. By default none is written.
        axis: an axis of the body: "e1", "e2", "e3" or its index 0, 1, 2, or a unit vector (3,) in the body frame. Where
            only the axis of symmetry is known, only e3, which is that axis.
        frames: at how many evenly spaced times the body is shown, at most 1,000. If the body turns by more than a
            quarter of a turn from one frame to the next, the picture says by how many turns.
        title: a line above the picture.
        points: places in the frame of the body, (a, 3), such as the atoms of a molecule: they are drawn in place of the
            solid, the first joined to each of the others; for bodies with a mass.
        together: whether several bodies that travel are drawn in one space, instead of side by side.
        box: the least and the largest corner of a periodic box, (2, 3), in the units of the positions. The centres of
            the bodies are drawn in it, and no tracks; from one saved state to the next they must move by less than half
            the box. Positions may be wrapped into the box or not.
        planet: the radius of a ball at the origin, in the units of the positions, such as the Earth below satellites.

    Returns:
        The `View`, whose `file` is the file that was written.

    Raises:
        ValueError: a path is not of one body with attitudes or axes, or not of this kind of body, or its first two
            states are bad; an argument is out of its range.
        ImportError: plotly is not installed.
        OSError: the file cannot be written.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> view = ml.plot.view(body, path, "top.html")
        >>> view.file.name
        'top.html'
    """
    if file is not None:
        picture_file(file, ".html")
    shown = panels(body, path, together)
    around = around_of(box, planet, [panel.path for panel in shown])
    turns = togethers(shown, axis, frames, _MOST_FRAMES, points, around=around, in_one=together)
    if find_spec("plotly") is None:
        raise ImportError("a view needs plotly: pip install 'midlie_jax[plot]'.")
    figure = _figure([""] if together else [panel.name for panel in shown], turns, title)
    found = View(figure, _alone_and_blue(figure, turns))
    if file is not None:
        found.write(file)
    return found


def _figure(names: Sequence[str], turns: Sequence[Together], title: str) -> dict[str, Any]:
    """The picture as plotly's dictionary."""
    still = [trace for k, shown in enumerate(turns) for trace in _seen_in(k, still_traces(shown))]
    first = [trace for k, shown in enumerate(turns) for trace in _seen_in(k, moving_traces(shown, 0))]
    moving = list(range(len(still), len(still) + len(first)))
    # Later frames hold only coordinates: colours are those of the first frame, or of the reader's browser.
    times = [float(t) for t in turns[0].times]
    places = [
        [{axis: trace[axis] for axis in "xyz"} for shown in turns for trace in moving_traces(shown, k)]
        for k in range(len(times))
    ]
    frames = [{"name": str(k), "data": data, "traces": moving} for k, data in enumerate(places)]
    return {"data": still + first, "layout": _layout(names, turns, title, times), "frames": frames}


def _alone_and_blue(figure: dict[str, Any], turns: Sequence[Together]) -> list[int]:
    """The blue lines that get another blue on a dark page: not those of a body that is told from others by its blue."""
    alone = [_scene(k) for k, shown in enumerate(turns) if shown.alone]
    lines = enumerate(figure["data"])
    return [i for i, one in lines if one["scene"] in alone and one.get("line", {}).get("color") == BLUE]


def _scene(k: int) -> str:
    """Plotly's name for the part of the page in which body k is seen."""
    return f"scene{k + 1}" if k else "scene"


def _seen_in(k: int, traces: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The traces of body k; the legend lists only those of the first body."""
    return [trace | {"scene": _scene(k)} | ({"showlegend": False} if k else {}) for trace in traces]


def _layout(names: Sequence[str], turns: Sequence[Together], title: str, times: Sequence[float]) -> dict[str, Any]:
    """Where the bodies are seen, their names, the buttons and the slider."""
    play = {"frame": {"duration": _MILLISECONDS, "redraw": True}, "fromcurrent": True, "transition": {"duration": 0}}
    stop = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate", "transition": {"duration": 0}}
    steps = [{"method": "animate", "label": time_text(t), "args": [[str(k)], stop]} for k, t in enumerate(times)]
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
        **{
            _scene(k): _seen(shown, columns / rows, *place)
            for k, (shown, place) in enumerate(zip(turns, places, strict=True))
        },
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


def _seen(shown: Together, columns: float, x: tuple[float, float], y: tuple[float, float]) -> dict[str, Any]:
    """The part of the page, as fractions, in which one body is seen, and from where."""
    hidden = {"visible": False, "range": [-_REACH, _REACH]}
    axes: dict[str, Any] = {**dict.fromkeys(("xaxis", "yaxis", "zaxis"), hidden), "aspectmode": "cube"}
    limits = shown.limits
    if limits is not None:
        spans = limits[1] - limits[0]
        axes = {f"{letter}axis": _lengths(letter, *ends) for letter, ends in zip("xyz", limits.T, strict=True)}
        sides = dict(zip("xyz", (1.3 * spans / spans.max()).tolist(), strict=True))
        axes |= {"aspectmode": "manual", "aspectratio": sides}
    near, lower = max(1.0, 0.45 * columns), 0.0  # a narrow part cuts off what is left and right
    if limits is not None:
        high = np.ptp(limits, axis=0)[2] / np.ptp(limits, axis=0).max()
        # Farther away where numbers stand at the axes, and the more so the narrower the part is.
        near = (1.75 + 0.25 * high) * max(1.0, 0.6 * columns)
        lower = -0.1 - 0.1 * high  # and looking at a lower place, for the names of x and y
    return {
        **axes,
        "domain": {"x": list(x), "y": list(y)},
        "camera": {
            "eye": {"x": 0.76 * near, "y": -1.05 * near, "z": 0.56 * near},
            "center": {"x": 0.0, "y": 0.0, "z": lower},
        },
        "dragmode": "orbit",
    }


def _lengths(letter: str, low: float, high: float) -> dict[str, Any]:
    """An axis of space with numbers; those of orbits are written as powers of ten."""
    grid = {"gridcolor": GREY, "zerolinecolor": GREY, "showbackground": False, "showspikes": False}
    numbers = {"nticks": 5, "exponentformat": "power", "showexponent": "all"}
    return {"title": {"text": f"{letter} [length]"}, "range": [float(low), float(high)], **grid, **numbers}


def _note(text: str, x: tuple[float, float], y: tuple[float, float]) -> dict[str, Any]:
    """The name of one body, at the upper left of its part of the page."""
    corner = {"x": x[0] + 0.02, "y": y[1] - 0.01, "xanchor": "left", "yanchor": "top"}
    return {"text": text, "xref": "paper", "yref": "paper", "showarrow": False, "align": "left", **corner}
