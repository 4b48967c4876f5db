"""The picture of the claims: the mean energy error over the two long runs, for each method."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import Line, Panel, chart

from .drift import EIGHTHS
from .measure import Measured
from .verdicts import shifts

_COLOURS = (
    *("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00"),
    *("#56B4E9", "#000000", "#A03060", "#1B3A6B", "#662506"),
)
MOST = len(_COLOURS)


def draw(all_found: Sequence[Measured], path: str) -> None:
    """Draws at most `MOST` methods, and writes a PNG."""
    shown, middles = all_found[:MOST], np.arange(EIGHTHS) + 0.5

    def lines(time: Any, values: Sequence[Any]) -> list[Line]:
        look: Any = {"linewidth": 2, "marker": "o", "markersize": 4}
        rows = zip(shown, values, _COLOURS, strict=False)
        return [Line(found.method, time, value, colour, "-", True, look) for found, value, colour in rows]

    drifts = lines(10 / EIGHTHS * middles, [found.drift.eighths[0] for found in shown])
    time = 0.05 * all_found[0].steps / 1000 / EIGHTHS * middles
    tops = lines(time[1:], [shifts(found)[1:] for found in shown])
    across = "time [1000 units of time]"
    shift = "mean energy error relative to the first eighth [initial energy]"
    panels = [
        Panel("Drift test, h = 0.25", across, "mean energy error [unit of energy]", drifts),
        Panel("Chaotic heavy tops, h = 0.05", across, shift, tops, {"yscale": "log"}),
    ]
    title = "JACOBI[EA] and SLIEMID[EA] have no energy trend in either test"
    right = f"right, {all_found[0].steps:.0e} steps and the root mean square over the tops."
    note = f"Means over eighths of the run; {right}"
    chart(Path(path), [panels], (14.0, 6.2), title, note, bottom=0.11, wspace=0.2)
