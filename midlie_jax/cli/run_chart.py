"""Charts of runs: of a scene, from the record of `midlie run`, and of any store.

The chart of a scene shows the changes of energy and momenta, angular velocities, and the paths of an axis of the body
and of its centre of mass. The chart of a store shows its content against time, lag or frequency.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..drivers.path import COORDINATES
from ..model import so3, torques
from ..model.bodies import SymmetricRotor
from ..model.states import AxisState
from ..plot.conservation import Change
from ..plot.curves import in_plane, plane_of, seen_from_above
from ..plot.style import BLUE, GREEN, VERMILLION
from ..simulation.plan import BODY, TIME
from ..simulation.summary import Inspection
from .figures import FAINT, INK, PANEL_TITLE, heading, new_figure, panel
from .record import Record

_FIRST = 3  # number of bodies with a separate line
_COLOURS = (BLUE, VERMILLION, GREEN)
_BAND = (5, 95)  # percentiles of all bodies
_FEW = 50  # with fewer saved states, each has a dot
_ROUNDING = 1e3  # in units in the last place: smaller errors count as rounding
_LEAST_RANGE = 1e-3  # smallest range of a panel of angular velocities, relative to the largest of them
_SHOWN = 1000  # largest number of bodies that are read for the band of a store: evenly spaced ones
_PANELS = 15  # largest number of drawn components of a store: a translating body has 13
_COLUMNS = 3


def run_figure(record: Record) -> Any:
    travels = bool(record.travel)
    figure = new_figure(19.0 if travels else 13.0, 10.0)
    count, failed = len(record.ok), int(np.sum(~record.ok))
    note = f"Run by {record.method} with {record.steps} steps of {record.dt:g} in {record.dtype}."
    if count > 1 and not record.several:
        note += (
            f" {count} perturbed bodies. Lines: the first {min(count, _FIRST)} bodies; the very first is unperturbed. "
            f"Bands: percentiles {_BAND[0]} to {_BAND[1]} of all bodies."
        )
    if record.several:
        note += f"Each of the {record.scene.start.count} bodies has a colour, from blue, the first one, to the last."
        note += " Of several copies the first is drawn." if count > 1 else ""
    if failed:
        note += f" FAILED for {failed} of {count}: values that are not finite are left out."
    heading(figure, f"{record.scene.name}: {record.scene.title}", note)
    figure.subplots_adjust(bottom=0.065, wspace=0.2, hspace=0.28)
    grid = figure.add_gridspec(2, 3 if travels else 2)
    unit = record.scene.time_unit or "time"
    time = f"Time t  [{unit}]"
    energy, momentum, *others = record.changes
    _change(figure.add_subplot(grid[0, 0]), record, energy, time)
    _change(figure.add_subplot(grid[1, 0]), record, momentum, time)
    _trace(figure.add_subplot(grid[0, 1]), record)
    stack = grid[1, 1].subgridspec(3, 1, hspace=0.18)
    _rates([figure.add_subplot(stack[i]) for i in range(3)], record, time, unit)
    if travels:
        _flight_path(figure.add_subplot(grid[0, 2]), record)
        _change(figure.add_subplot(grid[1, 2]), record, others[0], time)
    return figure


def _change(axes: Any, record: Record, change: Change, time: str) -> None:
    kind = "Change" if change.reason else "Error"
    panel(axes, f"{kind} of the {change.name}", time, f"{change.formula}  [-]")
    _remark(axes, change.reason or change.note)
    _band(axes, record.times, change.values, FAINT)
    for values, colour in zip(change.values[:_FIRST], _COLOURS, strict=False):
        # Rounding errors jump from state to state, so a line through them would be a block of colour.
        rounding = np.nanmax(np.abs(values)) < _ROUNDING * np.finfo(record.dtype).eps
        _plot(axes, record.times, values, colour, line=not rounding)
    axes.set_xlim(*_span(record))
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))


def _rates(stack: Sequence[Any], record: Record, time: str, unit: str) -> None:
    """Draws the angular velocities in one panel for each axis, because their sizes may be very different."""
    body, is_axis = record.scene.body, isinstance(record.scene.start, AxisState)
    turning = getattr(body, "body", body)
    rates = record.momenta / np.asarray(turning.moment if isinstance(turning, SymmetricRotor) else turning.moments)
    named, letters = ("the axes of space", "xyz") if is_axis else ("the principal axes", "123")
    for i, axes in enumerate(stack):
        first, last = i == 0, i == len(stack) - 1
        title = f"Angular velocity about {named}" if first else ""
        largest = np.nanmax(np.abs(rates[..., i]))
        power = 3 * math.floor(math.log10(largest) / 3) if 0 < largest < 0.01 else 0
        scaled, scale = rates[..., i] / 10.0**power, f"$10^{{{power}}}$ " if power else ""
        panel(axes, title, time if last else "", "")
        axes.set_ylabel(f"Ω{letters[i]}  [{scale}rad/{unit}]", fontsize=9, color=INK)
        axes.tick_params(labelbottom=last)
        if not record.several:
            _band(axes, record.times, scaled, FAINT)
        for values, colour in zip(*record.lines(scaled[..., None], _FIRST), strict=False):
            _plot(axes, record.times, values[:, 0], colour)
        axes.set_xlim(*_span(record))
        low, high = axes.get_ylim()
        least = _LEAST_RANGE * np.nanmax(np.abs(scaled))  # hides the rounding of a constant rate
        if high - low < least:
            axes.set_ylim((low + high - least) / 2, (low + high + least) / 2)
        axes.ticklabel_format(axis="y", useOffset=False, style="plain")
    stack[0].figure.align_ylabels(stack)


def _trace(axes: Any, record: Record) -> None:
    """Draws the path of an axis of the body on the unit sphere, seen along the space z axis."""
    axis, name = _axis(record)
    poses, colours = record.lines(record.attitudes, _FIRST)
    is_axis = isinstance(record.scene.start, AxisState)
    tips = np.asarray(poses if is_axis else so3.to_matrix(jnp.asarray(poses)) @ axis, np.float64)
    for own, colour in zip(tips, colours, strict=False):
        seen_from_above(axes, own[np.isfinite(own).all(axis=1)], name, colour)
    panel(axes, f"Path of {name} in space, seen from +z", axes.get_xlabel(), axes.get_ylabel())
    axes.locator_params(nbins=6)
    _remark(axes, "dot: the start" + ("; faint: below the xy plane" if np.nanmin(tips[..., 2]) < 0 else ""))


def _remark(axes: Any, text: str) -> None:
    """Writes a small text above the right end of a panel, because a power of ten may stand above the left end."""
    style = {"fontsize": 8.5, "color": "#5f5f5f", "ha": "right", "va": "bottom"}
    axes.annotate(text, (1.0, 1.0), xytext=(0, 3), xycoords="axes fraction", textcoords="offset points", **style)
    axes.set_title(axes.get_title(loc="left"), loc="left", pad=17, fontsize=PANEL_TITLE, weight="bold", color=INK)


def _plot(axes: Any, times: np.ndarray, values: np.ndarray, colour: str, line: bool = True) -> None:
    few = len(times) < _FEW
    style = {"marker": "." if few or not line else "", "markersize": 6.0 if few else 1.5}
    axes.plot(times, values, color=colour, linewidth=1.0, linestyle="-" if line else "", **style)


def _span(record: Record) -> tuple[float, float]:
    low, high = sorted((float(record.times[0]), float(record.times[-1])))
    return low - 0.02 * (high - low), high + 0.02 * (high - low)


def _axis(record: Record) -> tuple[np.ndarray, str]:
    """The axis of the body in the picture, and its name: the axis of the torque if it has one, otherwise the third."""
    torque, axis, name = record.scene.torque, np.array([0.0, 0.0, 1.0]), ""
    if isinstance(record.scene.start, AxisState):
        return axis, "the axis of symmetry"
    if isinstance(torque, torques.HeavyTop):
        axis, name = np.asarray(torque.axis), "the axis from the pivot to the centre of mass"
    elif isinstance(torque, torques.DipoleInField):
        moment = np.asarray(torque.moment, np.float64)
        axis, name = moment / np.linalg.norm(moment), "the dipole"
    principal = [f"the body's axis e{i + 1}" for i in range(3) if axis[i] == 1 and np.count_nonzero(axis) == 1]
    return axis, principal[0] if principal else name


def _band(axes: Any, times: np.ndarray, values: np.ndarray, colour: str) -> None:
    finite = values[np.all(np.isfinite(values), axis=1)]
    if len(finite) > 1:
        axes.fill_between(times, *np.percentile(finite, _BAND, axis=0), color=colour, alpha=0.22, linewidth=0)


def _flight_path(axes: Any, record: Record) -> None:
    """Draws the paths of the first bodies, seen along the space axis of least motion."""
    found, colours = record.lines(np.asarray(record.travel[-1], np.float64), _FIRST)
    letters = plane_of(axes, found[np.isfinite(found).all(axis=-1)])
    for path, colour in zip(found, colours, strict=False):
        in_plane(letters, axes, path, colour, None)
    units = record.scene.units.partition(";")[0].split(",")
    unit = units[1].strip() if len(units) == 3 else "length"
    (along,) = set("xyz") - set(letters)
    panel(axes, f"Path of the centre of mass, seen along {along}", *(f"{letter}  [{unit}]" for letter in letters))
    axes.locator_params(nbins=6)


def store_figure(found: Inspection) -> Any:
    """The chart of any store, as far as the run is computed."""
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
        _band(axes, times[0], values, FAINT)
        for t, line, colour in zip(times, values, _COLOURS, strict=False):
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
