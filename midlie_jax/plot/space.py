"""Axes of space with lengths, on matplotlib's 3-D axes: one scale in all directions, and few numbers."""

from typing import Any

import numpy as np

from .style import GREY, SIZE, ink

_TICKS = 3  # about how many numbers stand at an axis
_TICK_OFFSET, _LABEL_OFFSET = 8.0, 21.0  # matplotlib's own distances of numbers and names from an axis, points


def unit_of(limits: np.ndarray) -> tuple[float, str]:
    """The power of 1000 in which lengths are written, and how it is called."""
    largest = max(float(np.max(np.abs(limits))), np.finfo(float).tiny)
    power = 3 * int(np.floor(np.log10(largest) / 3 + 1e-9))
    return (10.0**power, rf"$10^{{{power}}}$ length") if power not in (0, -3) else (1.0, "length")


def draw_space(axes: Any, limits: np.ndarray, size: float = SIZE, colour: Any = None) -> None:
    """Sets limits (2, 3), scale and names of 3-D axes.

    Args:
        axes: matplotlib's 3-D axes.
        limits: the least and the largest coordinates.
        size: font size, points.
        colour: that of the text; by default that of the axis labels.
    """
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    colour = ink(axes) if colour is None else colour
    spans = limits[1] - limits[0]
    scale, unit = unit_of(limits)
    axes.set_proj_type("ortho")
    axes.set(xlim=limits[:, 0], ylim=limits[:, 1], zlim=limits[:, 2])
    axes.set_box_aspect(spans / spans.max(), zoom=0.76 if size < SIZE else 0.88)
    for place, (axis, letter) in enumerate(zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True)):
        axis.set_major_locator(MaxNLocator(_TICKS))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / scale:.6g}"))
        axis.set_label_text(f"{letter}  [{unit}]", fontsize=size, color=colour)
        # matplotlib places texts at distances that shrink with the picture across the axis, here undone by half.
        farther = float(spans.max() / np.delete(spans, place).max()) ** 0.5 - 1
        pad = (1 if letter == "z" else -3) + _TICK_OFFSET * farther
        axis.set_tick_params(labelsize=size, labelcolor=colour, color=GREY, pad=pad)
        axis.labelpad = _LABEL_OFFSET * farther
        axis.line.set_color(GREY)
        axis.set_pane_color((0.5, 0.5, 0.5, 0.05))
