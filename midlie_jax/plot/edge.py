"""Names of lines outside the right edge of a panel, each beside the end of its line and joined to it by a leader."""

from collections.abc import Sequence
from typing import Any

from .apart import apart
from .style import SIZE, ink

_MARK = "midlie_jax.plot.edge"  # the group of our texts on a panel
_LINE = 1.3  # distance of two names, in font sizes
_LEADER, _FREE = 14.0, 2.0  # points from the edge of the panel to the names, and between leader and name


def name_at_edge(axes: Any, named: Sequence[tuple[str, float]], colour: str) -> None:
    """Writes each name at its height, in the units of the data; names that are there already make room.

    The limits of the axes must be set before, or autoscaled. Text has the colour of the axis labels, leaders have that
    of the line.
    """
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
            ha="left",
            annotation_clip=False,
            gid=_MARK,
            # From the edge of the name to the end of its line.
            arrowprops={
                "arrowstyle": "-",
                "color": colour,
                "linewidth": 1.0,
                "shrinkA": _FREE,
                "shrinkB": 0.0,
                "relpos": (0.0, 0.5),
            },
        )
    _spread(axes)


def _spread(axes: Any) -> None:
    """Moves our names on a panel up and down, as little as possible, so that none covers another."""
    texts = [text for text in axes.texts if text.get_gid() == _MARK]
    axes.autoscale_view()
    points, to_pixels = 72 / axes.figure.dpi, axes.get_yaxis_transform()
    wanted = [to_pixels.transform(text.xy)[1] * points for text in texts]
    bottom, top = axes.bbox.y0 * points, axes.bbox.y1 * points
    for text, before, after in zip(texts, wanted, apart(wanted, _LINE * SIZE, bottom, top), strict=True):
        text.set_position((_LEADER, after - before))
