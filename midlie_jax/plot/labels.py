"""Names of lines: at the right edge of a panel, each next to the end of its line, or in a legend."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from .style import SIZE, ink, is_3d

_MARK = "midlie_jax.plot.labels"  # marks the names at the edge of a panel
_LINE, _NEXT_LINE = 1.3, 1.2  # distance of two names, and of two lines of one name, in font sizes
_LEADER = 14.0  # points from the edge of the panel to the names
_WIDEST = 0.5  # the largest share of the panel's width for names
_WIDEST_LEGEND = 0.4  # the largest share for a legend on 3-D axes; a wider one has one word per line


def apart(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """The nearest heights, by least squares, at least `gap` apart, in the same order, and within low to high.

    With the gaps subtracted, the problem is isotonic regression: neighbours out of order are pooled at their mean.
    """
    order = sorted(range(len(heights)), key=lambda i: heights[i])
    pools: list[tuple[float, int]] = []  # means and numbers of members
    for rank, i in enumerate(order):
        mean, members = heights[i] - rank * gap, 1
        while pools and pools[-1][0] > mean:
            before, more = pools.pop()
            mean, members = (before * more + mean * members) / (more + members), more + members
        pools.append((mean, members))
    room = max(low, high - (len(heights) - 1) * gap)
    placed = [min(max(mean, low), room) for mean, members in pools for _ in range(members)]
    return [placed[rank] + rank * gap for rank in sorted(range(len(order)), key=lambda rank: order[rank])]


def name_in_legend(axes: Any) -> None:
    """Shows the labels of all lines on the axes in a legend."""
    style = {"fontsize": SIZE, "labelcolor": ink(axes), "markerscale": 2.0, "framealpha": 0.7, "edgecolor": "none"}
    if not is_3d(axes):
        axes.legend(loc="best", **style)
        return
    legend = axes.legend(loc="upper left", **style)
    if legend.get_window_extent().width > _WIDEST_LEGEND * axes.bbox.width:  # it would cover the axis that points up
        for text in axes.legend(loc="upper left", handlelength=1.0, **style).get_texts():
            text.set_text("\n".join(text.get_text().split()))


def name_at_edge(axes: Any, named: Sequence[tuple[str, float]], colour: str) -> None:
    """Writes each name at its height, in the units of the data; names on one panel move up and down to make room.

    Without a layout engine the panel becomes narrower by the width of the names.
    """
    leader = {"arrowstyle": "-", "color": colour, "linewidth": 1.0, "shrinkA": 2.0, "shrinkB": 0.0, "relpos": (0, 0.5)}
    for name, height in named:
        axes.annotate(
            name,
            (1.0, height),
            xycoords=axes.get_yaxis_transform(),
            xytext=(_LEADER, 0.0),
            textcoords="offset points",
            fontsize=SIZE,
            color=ink(axes),
            va="center_baseline",
            annotation_clip=False,
            gid=_MARK,
            arrowprops=leader,
        )
    axes.autoscale_view()
    _locate(axes)


def _locate(axes: Any) -> None:
    locator: Any = partial(_beside_names)
    locator.get_subplotspec = axes.get_subplotspec  # tight_layout reads the locator instead of the axes
    axes.set_axes_locator(locator)


def _beside_names(axes: Any, renderer: Any) -> Any:
    """The position of the panel for matplotlib; all panels above one another have the same right edge."""
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    place, figure = axes.get_position(original=True), axes.figure
    if figure.get_layout_engine() is not None:
        _spread(axes)
        return place
    places = [(other, other.get_position(original=True)) for other in figure.axes if not is_3d(other)]
    column = [other for other, its in places if abs(its.x0 - place.x0) + abs(its.x1 - place.x1) < 1e-6]
    for other in column:
        if other.get_axes_locator() is None:
            _locate(other)  # with another edge, a shared scale would not match
    texts = [text for other in column for text in _names(other)]
    # The names end before the labels of the next panel, or before the edge of the page.
    right = [other for other in figure.axes if other.get_position(original=True).x0 > place.x1 - 1e-6]
    free = [(other.bbox if is_3d(other) else other.get_tightbbox(renderer)).x0 for other in right]
    end = edge = (min(free, default=figure.bbox.x1) - figure.bbox.x0) / figure.bbox.width - 0.01
    for between in (" ", "\n"):  # names wider than half of the panel get one word per line
        for text in texts:
            text.set_text(between.join(text.get_text().split()))
        width = max((Text.get_window_extent(text, renderer).width for text in texts), default=0.0)
        edge = end - (width + _LEADER * figure.dpi / 72) / figure.bbox.width
        if edge >= place.x1 - _WIDEST * place.width:
            break
    _spread(axes)
    return Bbox.from_extents(place.x0, place.y0, min(max(edge, place.x0 + 0.25 * place.width), place.x1), place.y1)


def _spread(axes: Any) -> None:
    """Moves the names on a panel up and down as little as possible, so that they do not overlap."""
    texts, points = _names(axes), 72 / axes.figure.dpi
    lines = max((text.get_text().count("\n") + 1 for text in texts), default=1)
    wanted = [axes.transData.transform((0.0, text.xy[1]))[1] * points for text in texts]
    gap = SIZE * (_LINE + _NEXT_LINE * (lines - 1))
    for text, old, new in zip(
        texts, wanted, apart(wanted, gap, axes.bbox.y0 * points, axes.bbox.y1 * points), strict=True
    ):
        text.set_position((_LEADER, new - old))


def _names(axes: Any) -> list[Any]:
    return [text for text in axes.texts if text.get_gid() == _MARK]
