"""Shared code of all charts: the heading, the style of a panel and of a line, and a small PNG.

The colours come from Okabe and Ito (Color Universal Design, 2008), with a few dark colours that are equally easy to
distinguish in any colour vision (`tests/test_charts.py`). Cool colours are for the methods of this package, warm
colours for others. matplotlib is an optional dependency, imported only when a chart is drawn.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from itertools import cycle, islice
from typing import Any, NamedTuple

from ..plot.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION
from ..plot.style import new_figure as new_figure

INK, FAINT, GRID = "#222222", GREY, "#e3e3e3"
_LEFT, _RIGHT = 0.06, 0.985  # edges of panels and heading, as fractions of the width of the figure
_EDGE = 12.0  # points between the heading and the top of the figure
_TITLE, _NOTE = 15.0, 10.0  # font sizes, points
PANEL_TITLE = 11.5
_COLOURS = 256
COOL = (BLUE, GREEN, SKY, "#1B3A6B", BLACK)
WARM = (VERMILLION, ORANGE, PURPLE, "#A03060", "#662506")
_MARKS = ("o", "^", "s", "v", "D", "P", "X", "<", "p", ">", "d", "h", "*")  # 13: coprime to the 5 colours
SOLID, DASHED = "-", (0, (4, 2))
_DASHES = ((0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (8, 2, 1, 2, 1, 2)))  # for more lines than colour-mark pairs
RING = "ring"  # a mark that is visible around another mark
_CLEAR = 36.0  # points from the heading to the panels: the height of a panel's title and a gap above and below


def heading(figure: Any, title: str, note: str) -> None:
    """Writes title and note at the top, in lines that fit the width, and moves the panels below them."""
    renderer, points = figure.canvas.get_renderer(), 72 / figure.dpi
    height = figure.bbox.height * points
    top = height - _EDGE
    figure.subplots_adjust(left=_LEFT, right=_RIGHT)
    for text, size, weight in ((title, _TITLE, "bold"), (note, _NOTE, "normal")):
        style = {"fontsize": size, "weight": weight, "color": INK, "va": "top", "linespacing": 1.3}
        drawn = figure.text(_LEFT, top / height, text, wrap=True, **style)
        top = drawn.get_window_extent(renderer).y0 * points - 0.4 * size
    figure.subplots_adjust(top=(top - _CLEAR) / height)


def panel(axes: Any, title: str, x_label: str, y_label: str) -> None:
    axes.set_title(title, loc="left", fontsize=PANEL_TITLE, weight="bold", color=INK)
    axes.set_xlabel(x_label, color=INK)
    axes.set_ylabel(y_label, color=INK)
    axes.grid(which="major", color=GRID, linewidth=0.8)
    axes.tick_params(which="both", colors=INK, labelsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_axisbelow(True)


def write(figure: Any, path: str) -> None:
    """Writes a PNG; an existing file is replaced."""
    whole = BytesIO()
    figure.savefig(whole, format="png")
    with open(path, "wb") as file:
        file.write(few_colours(whole.getvalue()))


def few_colours(png: bytes) -> bytes:
    """The same picture with fewer colours, in a file of about half the size."""
    from PIL import Image  # matplotlib also needs it

    picture = Image.open(BytesIO(png)).convert("RGB")
    few = picture.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small = BytesIO()
    few.save(small, format="PNG", optimize=True)
    return small.getvalue()


def spread_bars(axes: Any, x: Sequence[float], y: Sequence[float], spread: Sequence[float], colour: str) -> None:
    """Draws horizontal bars from x (1 - spread) to x (1 + spread); none where the spread is unknown (NaN)."""
    bars = [(h, a * max(1 - s, 0.01), a * (1 + s)) for a, h, s in zip(x, y, spread, strict=True) if math.isfinite(s)]
    if bars:
        axes.hlines(*zip(*bars, strict=True), color=colour, linewidth=3.0, alpha=0.45, zorder=2.5)


class Style(NamedTuple):
    """How a line is drawn."""

    colour: str
    mark: str  # matplotlib's marker, or `RING`
    dash: Any
    ours: bool  # whether marks are filled, for methods of this package, or hollow

    def drawn(self, width: float, size: float) -> dict[str, Any]:
        """The arguments of `Axes.plot` for a line; width of the line and size of the marks in points."""
        line = {"color": self.colour, "linewidth": width, "linestyle": self.dash}
        if self.mark == RING:
            return line | {"marker": "o", "markersize": 1.6 * size, "markerfacecolor": "none"}
        if self.ours:
            return line | {"marker": self.mark, "markersize": size, "markeredgecolor": "white", "markeredgewidth": 0.6}
        return line | {"marker": self.mark, "markersize": size, "markerfacecolor": "white", "markeredgewidth": 1.1}


def styles(
    names: Iterable[str], colours: Sequence[str], dash: Any, *, ours: bool, fixed: Mapping[str, Style] | None = None
) -> dict[str, Style]:
    """A style for each name, in order; those in `fixed` have the style given there.

    Each line has a colour of its own while there are any; further lines repeat the colours with other marks.
    """
    names, fixed = list(dict.fromkeys(names)), fixed or {}
    taken = {fixed[name][:3] for name in names if name in fixed}
    ordered = sorted(colours, key=[colour for colour, *_ in taken].count)
    looks = (
        (colour, mark, each)
        for each in (dash, *_DASHES)
        for colour, mark in islice(zip(cycle(ordered), cycle(_MARKS), strict=False), len(ordered) * len(_MARKS))
    )
    unused = (look for look in looks if look not in taken)
    return {name: fixed[name] if name in fixed else Style(*next(unused), ours) for name in names}
