"""Writes the names of lines in one column beside the lines of a panel; a thin leader joins each name to its line.

All line ends lie on one side of the column and all leaders stop at its edge, so no leader crosses a name.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..plot.labels import apart

_SIZE = 8.5  # font size of the names, points
_GAP = 1.3  # distance between the middles of two names, in units of the font size
_LEADER = 26.0  # points from the last line end to the names
_INSET = 4.0  # points from the names to the panel's edges


class End(NamedTuple):
    """The end (x, y) of a line, and the colour of its name."""

    name: str
    colour: str
    x: float
    y: float
    bold: bool = False


def label_ends(
    axes: Any,
    ends: Sequence[End],
    side: str = "right",
    size: float = _SIZE,
    free: Callable[[float], float] = lambda width: 0.0,
) -> None:
    """Widens a panel on one side, and writes the names of its lines there.

    The limits of the panel, which must contain all its lines, and its place in the figure must already be final.

    Args:
        axes: matplotlib's axes, of a figure with an Agg canvas.
        ends: the ends of the lines.
        side: "left" or "right".
        size: largest font size of the names, points; it is reduced if there are many names.
        free: how many points to leave free on the other side for other texts, as a function of the panel's width
            without the names, in points.
    """
    whole = axes.bbox.width * 72 / axes.figure.dpi
    if not ends:
        _make_room(axes, side, 0.0, free(whole) / whole)
        return
    from matplotlib.patheffects import withStroke
    from matplotlib.text import Text

    renderer, points = axes.figure.canvas.get_renderer(), 72 / axes.figure.dpi
    low, high = axes.bbox.y0 * points + size, axes.bbox.y1 * points - size
    gap = min(_GAP * size, (high - low) / max(len(ends) - 1, 1))
    size = min(size, gap / _GAP)
    texts = [
        axes.annotate(
            end.name,
            (end.x, end.y),
            fontsize=size,
            color=end.colour,
            weight="bold" if end.bold else "normal",
            va="center",
            ha="left" if side == "right" else "right",
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
            # The leader points to the edge of the name; if it pointed to the middle, it would cross other names.
            arrowprops={
                "arrowstyle": "-",
                "color": end.colour,
                "linewidth": 0.7,
                "alpha": 0.8,
                "shrinkA": 2,
                "shrinkB": 5,
                "relpos": (0.0 if side == "right" else 1.0, 0.5),
            },
            zorder=6,
        )
        for end in ends
    ]
    # Width of the text alone, because the extent of an annotation includes its leader.
    width = max(Text.get_window_extent(text, renderer).width for text in texts) * points
    names = width + _INSET + _LEADER
    _make_room(axes, side, names / whole, free(whole - names) / whole)
    places = [axes.transData.transform((end.x, end.y)) * points for end in ends]
    edge = axes.bbox.x1 * points - width - _INSET if side == "right" else axes.bbox.x0 * points + width + _INSET
    to_data = axes.transData.inverted()
    for text, height in zip(texts, apart([place[1] for place in places], gap, low, high), strict=True):
        text.set_position(to_data.transform((edge / points, height / points)))


def _make_room(axes: Any, side: str, part: float, other: float) -> None:
    """Widens the limits of a panel: fractions `part` and `other` of its width are free on this and the other side."""
    scale = axes.xaxis.get_transform()
    low, high = scale.transform(np.array(axes.get_xlim()))
    shrink = min(1.0, 0.8 / max(part + other, 1e-9))  # at least a fifth of the panel is left to the lines
    part, other = shrink * part, shrink * other
    left, right = (part, other) if side == "left" else (other, part)
    unit = (high - low) / (1 - left - right)
    axes.set_xlim(*scale.inverted().transform(np.array([low - unit * left, high + unit * right])))
