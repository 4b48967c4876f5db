"""The picture of the claims: the mean energy error over the two long runs, for each method."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from midlie_jax.cli.figures import heading, new_figure, panel, write
from midlie_jax.cli.line_labels import End, label_ends

from .drift import EIGHTHS
from .measure import Measured
from .verdicts import shifts

_COLOURS = (
    "#D55E00",
    "#0072B2",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#000000",
    "#A03060",
    "#1B3A6B",
    "#662506",
)
MOST = len(_COLOURS)


def draw(all_found: Sequence[Measured], path: str) -> None:
    """Draws at most `MOST` methods, and writes a PNG."""
    shown = all_found[:MOST]
    figure = new_figure(14.0, 6.2)
    heading(
        figure,
        "JACOBI[EA] and SLIEMID[EA] have no energy trend in either test",
        f"Means over eighths of the run; right, {all_found[0].steps:.0e} steps and the root mean square over the tops.",
    )
    figure.subplots_adjust(bottom=0.11, wspace=0.2)
    left, right = figure.subplots(1, 2)
    eighths = np.arange(EIGHTHS)
    panel(left, "Drift test, h = 0.25", "time [1000 units of time]", "mean energy error [unit of energy]")
    time = 10 / EIGHTHS * (eighths + 0.5)
    _lines(left, shown, time, [found.drift.eighths[0] for found in shown])
    panel(
        right,
        "Chaotic heavy tops, h = 0.05",
        "time [1000 units of time]",
        "mean energy error relative to the first eighth [initial energy]",
    )
    right.set_yscale("log")
    time = 0.05 * all_found[0].steps / 1000 / EIGHTHS * (eighths + 0.5)
    _lines(right, shown, time[1:], [shifts(found)[1:] for found in shown])
    write(figure, path)


def _lines(axes: Any, shown: Sequence[Measured], time: np.ndarray, values: Sequence[np.ndarray]) -> None:
    ends: list[End] = []
    for colour, found, value in zip(_COLOURS, shown, values, strict=False):
        axes.plot(time, value, color=colour, linewidth=2, marker="o", markersize=4)
        ends.append(End(found.method, colour, time[-1], value[-1], True))
    axes.set_xlim(time[0], time[-1])
    axes.set_ylim(*axes.get_ylim())
    label_ends(axes, ends, size=9.0)
