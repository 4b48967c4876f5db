"""The path of the centre of mass in space, a panel of the chart of a run."""

from typing import Any

import numpy as np

from ..figures import panel
from .record import Record

_FIRST = 3  # bodies with a separate line, as in the other panels


def flight_path(axes: Any, record: Record) -> None:
    """Draws the paths of the first bodies, seen along the space axis of least motion."""
    found, colours = record.lines(record.travel[-1], _FIRST)
    paths = np.asarray(found, np.float64)
    spans = np.nan_to_num(np.nanmax(paths, axis=(0, 1)) - np.nanmin(paths, axis=(0, 1)))
    i, j = sorted(np.argsort(spans, kind="stable")[1:])
    letters, units = "xyz", record.scene.units.partition(";")[0].split(",")
    unit = units[1].strip() if len(units) == 3 else "length"
    title = f"Path of the centre of mass, seen along {letters[3 - i - j]}"
    panel(axes, title, f"{letters[i]}  [{unit}]", f"{letters[j]}  [{unit}]")
    for path, colour in zip(paths, colours, strict=False):
        axes.plot(path[:, i], path[:, j], color=colour, linewidth=1.2)
        axes.plot(*path[0, [i, j]], marker="o", markersize=7, color=colour, markeredgecolor="white", zorder=3)
    if np.min(spans[[i, j]]) > 0.05 * np.max(spans):  # a nearly straight path would have no height
        axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=6)
