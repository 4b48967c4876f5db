"""Writes the names of the families beside their frontiers on the chart of error against cost.

A name is left of all lines at its height, where a chart of error against cost is empty, and a level leader joins it to
its frontier. So no name covers a line, and no leader crosses a name.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from midlie_jax.plot.labels import apart

from .bands import BANDS
from .frontier import cost_at

_SIZE = 12.0  # font size, points
_BESIDE = 14.0  # points from a name to the lines
_GAP = 1.6  # distance between the middles of two names, in units of the font size
# Where the names are, as fractions of the way from the largest error to the smallest. High up the frontiers are close
# together, so the one that is farthest right is named there.
_HEIGHTS = {"symplectic": 0.36, "conserving": 0.5, "general": 0.64}


class FamilyNames:
    """The names of the families in one panel.

    The vertical limits of the panel must be final, and all its lines drawn, before the object is created. Then widen
    the panel by `room` on the left, and call `settle`.
    """

    def __init__(self, axes: Any, edges: Mapping[str, Sequence[tuple[float, float]]]):
        """Finds the heights.

        Args:
            axes: matplotlib's axes, of a figure with an Agg canvas, with logarithmic scales.
            edges: for each family its frontier, pairs (cost, error) with decreasing errors; an empty one has no name.
        """
        self._axes, self._points = axes, 72 / axes.figure.dpi
        self._edges = {name: edges[name] for name in _HEIGHTS if edges[name]}
        self._lines = [list(zip(line.get_xdata(), line.get_ydata(), strict=True)) for line in axes.lines]
        if not self._edges:
            self._heights, self._texts = [], []
            return
        top = self._height(max(edge[0][1] for edge in self._edges.values()))
        bottom = self._height(min(edge[-1][1] for edge in self._edges.values()))
        wanted = [
            min(max(top + _HEIGHTS[name] * (bottom - top), self._height(edge[-1][1])), self._height(edge[0][1]))
            for name, edge in self._edges.items()
        ]
        low, high = axes.bbox.y0 * self._points + _SIZE, axes.bbox.y1 * self._points - _SIZE
        self._heights = apart(wanted, _GAP * _SIZE, low, high)
        self._texts = [self._write(*pair) for pair in zip(self._edges.items(), self._heights, strict=True)]

    def room(self, width: float) -> float:
        """The points by which to widen the panel on the left, if it has `width` points for that and for its lines."""
        from matplotlib.text import Text

        renderer = self._axes.figure.canvas.get_renderer()
        low, high = (math.log10(limit) for limit in self._axes.get_xlim())
        needed = 0.0
        for text, height in zip(self._texts, self._heights, strict=True):
            name = Text.get_window_extent(text, renderer).width * self._points + 1.5 * _BESIDE
            # The name may also use the part of the panel that is left of all lines at its height.
            part = min((math.log10(self._leftmost(height)) - low) / (high - low), 0.9)
            needed = max(needed, (name - part * width) / (1 - part))
        return needed

    def settle(self) -> None:
        """Moves the names to their places, when the limits of the panel are final."""
        to_data = self._axes.transData.inverted()
        for text, height in zip(self._texts, self._heights, strict=True):
            right = self._axes.transData.transform((self._leftmost(height), 1.0))[0] - _BESIDE / self._points
            text.set_position(to_data.transform((right, height / self._points)))

    def _write(self, family: tuple[str, Sequence[tuple[float, float]]], height: float) -> Any:
        from matplotlib.patheffects import withStroke

        (name, edge), colour = family, BANDS[family[0]].colour
        error = min(max(self._error(height), edge[-1][1]), edge[0][1])
        return self._axes.annotate(
            name,
            (cost_at(edge, error), error),
            fontsize=_SIZE,
            color=colour,
            weight="bold",
            va="center",
            ha="right",
            path_effects=[withStroke(linewidth=3, foreground="white")],
            arrowprops={
                "arrowstyle": "-",
                "color": colour,
                "linewidth": 1.2,
                "shrinkA": 2,
                "shrinkB": 0,
                "relpos": (1.0, 0.5),
            },
            zorder=7,
        )

    def _leftmost(self, height: float) -> float:
        """The least cost on any line at the height of a name."""
        upper, lower = self._error(height + 0.6 * _SIZE), self._error(height - 0.6 * _SIZE)
        passing = [line for line in self._lines if line[0][1] >= lower and line[-1][1] <= upper]
        return min(cost_at(line, upper) for line in passing or self._lines)

    def _height(self, error: float) -> float:
        """Points above the bottom of the figure."""
        return self._axes.transData.transform((1.0, error))[1] * self._points

    def _error(self, height: float) -> float:
        return self._axes.transData.inverted().transform((1.0, height / self._points))[1]
