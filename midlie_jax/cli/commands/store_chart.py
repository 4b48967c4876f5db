"""The chart of any store: its content against time, lag or frequency, for a few bodies and for all."""

from pathlib import Path
from typing import Any

import numpy as np

from ...plot.style import BLUE, GREEN, VERMILLION
from ...simulation.plan import BODY, TIME
from ...simulation.summary import Inspection
from ...simulation.variables import COORDINATES
from ..figures import FAINT, heading, new_figure, panel, write

_LINES = (BLUE, VERMILLION, GREEN)  # the colours of the first bodies
_BAND = (5, 95)  # percentiles of all bodies that are drawn
_SHOWN = 1000  # largest number of bodies that are read for the band: evenly spaced ones
_PANELS = 15  # largest number of drawn components: a translating body has 13
_COLUMNS = 3


def store_chart(found: Inspection, path: str) -> None:
    """Draws the run as far as it is computed, and writes a PNG."""
    write(store_figure(found), path)


def store_figure(found: Inspection) -> Any:
    panels = _panels(found)
    if not panels:
        raise ValueError(f"{found.path} holds nothing to draw yet; resume the run first.")
    rows = -(-min(len(panels), _PANELS) // _COLUMNS)
    figure = new_figure(13.0, 1.5 + 2.9 * rows)
    note = f"{found.bodies} bodies, {found.attributes['method']}; {found.done / found.total:.0%} computed."
    if found.bodies > 1:
        note += f" Lines: the first bodies. Bands: percentiles {_BAND[0]} to {_BAND[1]} of the bodies."
    if len(panels) > _PANELS:
        note += f" The first {_PANELS} of {len(panels)} components."
    heading(figure, str(found.attributes["title"]), note)
    figure.subplots_adjust(bottom=0.65 / figure.get_figheight(), wspace=0.28, hspace=0.55)
    for place, (title, unit, against, times, values) in enumerate(panels[:_PANELS]):
        axes = figure.add_subplot(rows, _COLUMNS, place + 1)
        panel(axes, title, against, f"[{unit}]" if unit else "")
        if len(values) > 1:
            finite = values[np.all(np.isfinite(values), axis=1)]
            if len(finite) > 1:
                low, high = np.percentile(finite, _BAND, axis=0)
                axes.fill_between(times[0], low, high, color=FAINT, alpha=0.22, linewidth=0)
        for t, line, colour in zip(times, values, _LINES, strict=False):
            axes.plot(t, line, color=colour, linewidth=1.0, marker="." if len(t) < 50 else "")
    return figure


def _panels(found: Inspection) -> list[tuple[str, str, str, np.ndarray, np.ndarray]]:
    """For each component: title, unit, the variable of its axis, times (bodies, n) and values (bodies, n).

    A statistic has a single row; a statistic over times has lags or frequencies in place of times.
    """
    import zarr

    root: Any = zarr.open_group(str(Path(found.path)), mode="r")
    every = slice(None, None, -(-found.bodies // _SHOWN))
    panels: list[tuple[str, str, str, np.ndarray, np.ndarray]] = []
    for name, array in sorted(root.arrays()):
        dims = tuple(str(dim) for dim in array.metadata.dimension_names or ())
        of_bodies = dims[:2] == (BODY, TIME)
        first, *others = *dims, ""
        own = len(others) == 1 and first in root and first not in (TIME, *COORDINATES)  # its lags, or its frequencies
        if not (of_bodies or own or first == TIME) or name in ("time", "times", first):
            continue
        values = np.asarray(array[every] if of_bodies else array[...][None], np.float64)
        place = first if own else "times" if "times" in root else "time"
        times = root[place][every] if place == "times" else root[place][...][None]
        against = first.rpartition("_")[2].capitalize() if own else "Time t"
        times = np.broadcast_to(times, (len(values), times.shape[1]))
        parts = values.reshape(*values.shape[:2], -1)
        computed = int(np.sum(np.any(np.isfinite(parts), axis=(0, 2))))
        for component in range(parts.shape[2] if computed else 0):
            title = _title(name, dims[2 if of_bodies else 1 :], values.shape[2:], component)
            unit = str(array.attrs.get("units", ""))
            panels.append((title, unit, against, times[:, :computed], parts[:, :computed, component]))
    return panels


def _title(name: str, dims: tuple[str, ...], shape: tuple[int, ...], component: int) -> str:
    """The name of a component: from the names of its coordinates, or its indices counted from 1."""
    places = zip(dims, np.unravel_index(component, shape), strict=True) if shape else ()
    return " ".join([name, *(COORDINATES[d][i] if d in COORDINATES else str(i + 1) for d, i in places)])
