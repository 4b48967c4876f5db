"""The picture of stability maps: a column for each method, a row for each sweep, with the theoretical limits on top."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .figures import INK, heading, new_figure
from .stability import BLOWN_UP, Line, Map, Sweep

_WIDTH, _HEIGHT = 2.0, 2.25  # the size of a panel with its share of the margins, inches
_MARGINS = 0.85, 1.95  # left and right of all panels, above and below them, inches
_LEAST_ERROR = 1e-14
_FAILED = "#d9d9d9"
# The colours of Okabe and Ito that are visible on all colours of the map.
_LINES: dict[str, dict[str, Any]] = {
    "reach": {"color": "#E69F00", "linestyle": "-", "linewidth": 2.2},
    "stability": {"color": "#D55E00", "linestyle": (0, (4, 1.5)), "linewidth": 2.2},
    "resonance": {"color": "#FFFFFF", "linestyle": (0, (1, 1.2)), "linewidth": 1.6},
}
_MEANINGS = {
    "reach": "reach: largest turn a step",
    "stability": "limit of h ω: unstable, or several solutions",
    "resonance": "nutation resonances h ω = π, π/2, π/3",
}


def stability_figure(
    maps: Sequence[Sequence[Map]],
    lines: Mapping[tuple[str, str], Sequence[Line]],
    steps: np.ndarray,
    sweeps: Sequence[Sweep],
    *,
    title: str,
    note: str,
    time_unit: str,
) -> Any:
    """The picture, a matplotlib figure."""
    from matplotlib.colors import LogNorm

    columns, rows = len(maps), len(sweeps)
    width = max(_WIDTH * columns + _MARGINS[0], 12.2)  # inches, for the legend beside the scale of colours
    height = _HEIGHT * rows + _MARGINS[1]
    figure = new_figure(width, height)
    heading(figure, title, note)
    figure.subplots_adjust(left=0.75 / width, right=1 - 0.15 / width, bottom=1.0 / height, wspace=0.08, hspace=0.16)
    norm = LogNorm(_LEAST_ERROR, BLOWN_UP)
    panels = figure.subplots(rows, columns, sharex=True, sharey="row", squeeze=False)
    drawn: dict[str, Any] = {}
    image: Any = None
    for row, sweep in enumerate(sweeps):
        for column, of_method in enumerate(maps):
            axes, found = panels[row, column], of_method[row]
            image = _map(axes, found, steps, sweep, norm)
            for line in lines.get((found.method, sweep.name), ()):
                drawn[line.kind] = _boundary(axes, line, sweep)
            if row == 0:
                axes.set_title(found.method, fontsize=11, weight="bold", color=INK)
            if column == 0:
                axes.set_ylabel(sweep.label, fontsize=9.5, color=INK)
    for axes in panels[-1]:
        axes.set_xlabel(f"step h  [{time_unit or 'time'}]", fontsize=9.5, color=INK)
    _legend(figure, image, drawn, width, height)
    return figure


def _map(axes: Any, found: Map, steps: np.ndarray, sweep: Sweep, norm: Any) -> Any:
    """Draws a map: colours, black where the run blew up, hatched where a solve failed."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    x, y = _edges(steps, True), _edges(sweep.values, sweep.logarithmic)
    axes.set(xscale="log", yscale="log" if sweep.logarithmic else "linear", xlim=x[[0, -1]], ylim=y[[0, -1]])
    axes.tick_params(which="both", labelsize=8, colors=INK)
    axes.set_rasterization_zorder(None)
    # The hatched background is visible where nothing is drawn over it.
    axes.add_patch(
        Rectangle((0, 0), 1, 1, transform=axes.transAxes, facecolor=_FAILED, edgecolor="#8a8a8a", hatch="////", lw=0)
    )
    worst = np.ma.masked_where(found.failed | found.blown_up, np.clip(found.worst, _LEAST_ERROR, BLOWN_UP))
    image = axes.pcolormesh(x, y, worst, norm=norm, cmap="viridis", zorder=1.5)
    black = np.ma.masked_where(~found.blown_up, np.ones(found.worst.shape))
    axes.pcolormesh(x, y, black, cmap=ListedColormap(["black"]), zorder=1.6)
    if y[0] < sweep.own < y[-1]:
        axes.plot([0, 0.045], [sweep.own] * 2, color="#CC79A7", lw=3, transform=axes.get_yaxis_transform(), zorder=5)
    return image


def _edges(middles: np.ndarray, logarithmic: bool) -> np.ndarray:
    places = np.log(middles) if logarithmic else middles
    half = (places[1] - places[0]) / 2
    edges = np.append(places - half, places[-1] + half)
    return np.exp(edges) if logarithmic else edges


def _boundary(axes: Any, line: Line, sweep: Sweep) -> Any:
    from matplotlib.patheffects import withStroke

    style = _LINES[line.kind]
    outline = [withStroke(linewidth=style["linewidth"] + 1.4, foreground="black")]
    (drawn,) = axes.plot(line.steps, sweep.values, zorder=3, path_effects=outline, **style)
    return drawn


def _legend(figure: Any, image: Any, drawn: Mapping[str, Any], width: float, height: float) -> None:
    from matplotlib.patches import Patch

    bar = figure.colorbar(
        image, cax=figure.add_axes([0.75 / width, 0.42 / height, 2.6 / width, 0.13 / height]), orientation="horizontal"
    )
    bar.set_label("worst energy error, of |K| + |V| at the start  [-]", fontsize=8.5, color=INK, labelpad=1)
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.set_ticks([1e-14, 1e-10, 1e-6, 1e-2])
    patches = [
        Patch(facecolor="black", label="blows up: error over 1"),
        Patch(facecolor=_FAILED, edgecolor="#8a8a8a", hatch="////", label="a solve fails (ok is False)"),
    ]
    marks = [drawn[kind] for kind in _MEANINGS if kind in drawn]
    names = [_MEANINGS[kind] for kind in _MEANINGS if kind in drawn]
    own = figure.axes[0].plot([], [], color="#CC79A7", lw=3)[0]
    figure.legend(
        [*patches, *marks, own],
        [*(patch.get_label() for patch in patches), *names, "the scene's own value"],
        loc="lower right",
        bbox_to_anchor=(1 - 0.1 / width, 0.06 / height),
        ncols=3,
        fontsize=8.5,
        frameon=True,
        facecolor="#b9c6cc",
        edgecolor="none",
        labelcolor=INK,
    )
