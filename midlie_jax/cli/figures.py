"""Shared code of all charts: the heading above the panels, the style of a panel, and a small PNG.

Colours and the empty figure come from `midlie_jax.plot.style`. matplotlib is an optional dependency, imported only when
a chart is drawn.
"""

import math
from collections.abc import Sequence
from io import BytesIO
from typing import Any

from ..plot.style import GREY
from ..plot.style import new_figure as new_figure

INK, FAINT, GRID = "#222222", GREY, "#e3e3e3"
_LEFT, _RIGHT = 0.06, 0.985  # edges of panels and heading, as fractions of the width of the figure
_EDGE = 12.0  # points between the heading and the top of the figure
_TITLE, _NOTE = 15.0, 10.0  # font sizes, points
PANEL_TITLE = 11.5
_COLOURS = 256
_CLEAR = 36.0  # points from the heading to the panels: the height of a panel's title and a gap above and below


def heading(figure: Any, title: str, note: str) -> None:
    """Writes title and note at the top, in lines that fit the width, and moves the panels below them."""
    renderer, points = figure.canvas.get_renderer(), 72 / figure.dpi
    height = figure.bbox.height * points
    top = height - _EDGE
    figure.subplots_adjust(left=_LEFT, right=_RIGHT)
    for text, size, weight in ((title, _TITLE, "bold"), (note, _NOTE, "normal")):
        style = {"fontsize": size, "weight": weight, "color": INK, "va": "top", "linespacing": 1.3}
        drawn = figure.text(_LEFT, top / height, "", **style)
        _break_lines(drawn, text, (_RIGHT - _LEFT) * figure.bbox.width, renderer)
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
    from PIL import Image, PngImagePlugin  # matplotlib also needs it

    picture = Image.open(BytesIO(png)).convert("RGB")
    few = picture.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    maker = PngImagePlugin.PngInfo()
    maker.add_text("Software", "midlie_jax")
    small = BytesIO()
    few.save(small, format="PNG", optimize=True, pnginfo=maker)
    return small.getvalue()


def _break_lines(drawn: Any, text: str, width: float, renderer: Any) -> None:
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        drawn.set_text(longer)
        if lines and drawn.get_window_extent(renderer).width <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    drawn.set_text("\n".join(lines))


def spread_bars(axes: Any, x: Sequence[float], y: Sequence[float], spread: Sequence[float], colour: str) -> None:
    """Draws horizontal bars from x (1 - spread) to x (1 + spread); none where the spread is unknown (NaN)."""
    bars = [(h, a * max(1 - s, 0.01), a * (1 + s)) for a, h, s in zip(x, y, spread, strict=True) if math.isfinite(s)]
    if bars:
        axes.hlines(*zip(*bars, strict=True), color=colour, linewidth=3.0, alpha=0.45, zorder=2.5)
