"""Names of lines outside the right edge of a panel, each beside the end of its line and joined to it by a leader."""

from collections.abc import Sequence
from typing import Any

from .apart import apart
from .room import in_same_column, locate, narrowed, on_page, own_place
from .style import SIZE, ink

_MARK = "midlie_jax.plot.edge"  # marks the texts of this module on a panel
_LINE, _NEXT_LINE = 1.3, 1.2  # distance of two names, and of two lines of one name, in font sizes
_LEADER, _FREE = 14.0, 2.0  # points from the edge of the panel to the names, and between leader and name


def name_at_edge(axes: Any, named: Sequence[tuple[str, float]], colour: str) -> None:
    """Writes each name at its height, in the units of the data; earlier names move to make room.

    Text has the colour of the axis labels, leaders have the colour of the line. On a figure without a layout engine the
    panel becomes narrower by the width of the names.
    """
    for name, height in named:
        written = axes.annotate(
            name,
            (1.0, height),
            xycoords=axes.get_yaxis_transform(),
            xytext=(_LEADER, 0.0),
            textcoords="offset points",
            fontsize=SIZE,
            color=ink(axes),
            va="center_baseline",
            ha="left",
            annotation_clip=False,
            gid=_MARK,
            # The leader goes from the edge of the name to the end of its line.
            arrowprops={
                "arrowstyle": "-",
                "color": colour,
                "linewidth": 1.0,
                "shrinkA": _FREE,
                "shrinkB": 0.0,
                "relpos": (0.0, 0.5),
            },
        )
        written.words = name.split(" ")
    axes.autoscale_view()
    _spread(axes)
    locate(axes, _beside_names)
    in_same_column(axes, _beside_names)  # the present panels; later ones are found when they are drawn


def _spread(axes: Any) -> None:
    """Moves our names on a panel up and down, as little as possible, so that none covers another."""
    texts = _names(axes)
    lines = max((text.get_text().count("\n") + 1 for text in texts), default=1)
    points, to_pixels = 72 / axes.figure.dpi, axes.get_yaxis_transform()
    wanted = [to_pixels.transform(text.xy)[1] * points for text in texts]
    bottom, top = axes.bbox.y0 * points, axes.bbox.y1 * points
    gap = SIZE * (_LINE + _NEXT_LINE * (lines - 1))
    for text, before, after in zip(texts, wanted, apart(wanted, gap, bottom, top), strict=True):
        text.set_position((_LEADER, after - before))


def _names(axes: Any) -> list[Any]:
    return [text for text in axes.texts if text.get_gid() == _MARK]


def _beside_names(axes: Any, renderer: Any) -> Any:
    """The place of a panel that leaves room for its names; panels in one column have the same right edge.

    Names that would take half of the panel are written with one word per line.
    """
    column = [other for other in in_same_column(axes, _beside_names) if _names(other)]
    own = own_place(axes)
    right = own.x1
    for between in (" ", "\n"):
        for other in column:
            for text in _names(other):
                text.set_text(between.join(text.words))
        right = min((narrowed(other, _width(other, renderer), renderer) for other in column), default=own.x1)
        if right >= (own.x0 + own.x1) / 2:
            break
    _spread(axes)
    return on_page(axes, own.x0, own.y0, right, own.y1)


def _width(axes: Any, renderer: Any) -> float:
    """The width in pixels of the names beside a panel, with their leaders."""
    from matplotlib.text import Text

    # The width of the text alone, because the extent of an annotation includes its leader.
    widest = max(Text.get_window_extent(text, renderer).width for text in _names(axes))
    return widest + _LEADER * axes.figure.dpi / 72
