"""`midlie fit`: moments of inertia and initial rates of a free body from its instruments, in one file or two.

`free_flight` finds the part of a record to fit. It and the guess need only the measured rates and Euler's equations,
integrated over windows. I (Omega(t + w) - Omega(t)) = integral of (I Omega) x Omega from t to t + w, for all windows of
one length w, is a small least-squares problem in the ratios of the moments and, if requested, the bias. No motion is
integrated, so the distant minima of a fit of the whole motion do not occur.
"""

import argparse
from copy import copy
from functools import reduce
from itertools import pairwise
from operator import mul
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.interpolate import CubicSpline  # SciPy comes with JAX
from scipy.ndimage import median_filter
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ..fitting import Attitudes, Directions, Fit, Free, Moments, Rates, UnitQuaternion, UnitVector, states_at
from ..fitting import fit as run_fit
from ..fitting.checks import check_conventions
from ..model.bodies import RigidBody
from ..model.states import DirectionState, MomentumState, RigidState
from ..plot.style import BLUE, GREEN, VERMILLION
from .figures import heading, new_figure, panel, write
from .fit_data import UNITS_OF_RATE, Table, check_rates, read
from .tables import require

_TURN = 0.5  # largest rotation per step, radians
_MOST_TURNS = 0.5  # rotations between two rows; above, the rates at the rows do not determine the motion between them
_MOST_STEPS = 1_000_000  # about one second for each evaluation by the optimiser
_FIRST = 6.0  # rotation of the body in the span that is fitted first, radians
_BEFORE = 1.0  # the largest rotation of the body before the first row of the gyroscope, radians
_UP = (0.0, 0.0, 1.0)  # the direction that a DirectionState follows
_FACTOR = 20.0  # between the largest and the smallest speed; for a free body at most the ratio of its moments
_ROWS = 9  # of the running median, which ignores single wrong rows
_SLOW = 5.0  # percentage of the rows that may be slower than the smallest speed
_ORDERS = ((1.0, 2.0, 2.5), (2.5, 1.0, 2.0), (2.0, 2.5, 1.0), (2.0, 1.0, 2.5), (1.0, 2.5, 2.0), (2.5, 2.0, 1.0))
_TOTAL = 5.5  # the sum of the moments
_WINDOW = 1.0  # rotation of the body per window, radians
_UNIT_LENGTH = 1e-3  # the largest error of the length of a quaternion
_FINE, _MOST_POINTS = 0.05, 200_000  # radians between two points of an integral, and the largest number of points
_PER_WINDOW = 8  # windows that begin within the length of one
_GAP = 0.3  # radians: with denser rows elsewhere, a longer rotation between two rows is a gap in the record
_TURN_OF_SEARCH = 0.5  # radians per window of the search for the free flight
_LEFT, _NOISE = 0.05, 6.0  # unexplained changes: the share of the usual speed, and standard deviations of the noise
_SLOWEST = 0.2  # no flight is searched where the speed is below this share of the largest
_WHOLE = 2 * np.pi  # the least rotation in a flight, radians


class Problem(NamedTuple):
    """The data and options of a fit."""

    options: argparse.Namespace  # of the command
    given: dict[str, Any]  # the options for `midlie_jax.fit`
    measurements: list[Any]  # rates and, if there are a magnetometer and a star tracker, directions and attitudes
    table: Table  # the rates
    field: Table | None
    tracker: Table | None
    begin: float  # the first time of all, the time of the start


def fit(options: argparse.Namespace) -> None:
    if options.out:
        require("matplotlib")
    problem = _problem(options)
    result = _fitted(problem)
    _print(problem, result)
    if options.out:
        _draw(problem, result)
    told = ([] if result.ok else [result.message.rstrip(".")]) + _doubts(problem, result)
    if told:
        cures = [] if options.bias else ["try --bias"]
        if options.first is options.last is None:
            cures.append("if the file holds more than a free flight, give --from and --to")
        if cures and not (result.ok and result.doubts == [result.aliases]):
            told.append(" or, ".join(cures))
        raise ValueError(f"not ok: {'; '.join(told)}")


def _check_options(options: argparse.Namespace) -> None:
    given = {name for name, value in vars(options).items() if value}
    for name in ("magnetometer", "tracker"):
        if name in given and not {"sigma", f"{name}_sigma"} <= given:
            raise ValueError(f"with --{name}, give --sigma and --{name}-sigma, their relative weights.")
    columns, file = "with the names of its columns", "the magnetometer's own file"
    for needed, what, names in (
        ("tracker", f" {columns}", ("tracker_sigma", "space_to_body")),
        ("magnetometer", f" {columns}", ("magnetometer_sigma", "hard_iron", "magnetometer_data")),
        ("magnetometer_data", f", {file}", ("magnetometer_time", "magnetometer_time_unit", "magnetometer_clock")),
        ("magnetometer_time", ", the name of its column of time", ("magnetometer_data",)),
        ("magnetometer_clock", ": `same` if both files use one clock, or `fitted`", ("magnetometer_data",)),
    ):
        if needed not in given and (wrong := [name for name in names if name in given]):
            raise ValueError(f"--{wrong[0].replace('_', '-')} needs --{needed.replace('_', '-')}{what}.")


def _problem(options: argparse.Namespace) -> Problem:
    _check_options(options)
    table, field, tracker = read(options)
    table = _flight(options, table)
    others = dict[str, Table]()
    for name, one in (("magnetometer", field), ("tracker", tracker)):
        if one is None:
            continue
        others[name] = one.chosen(np.all(np.isfinite(one.values), axis=1)).within(*table.span)
        if not len(others[name].times):
            span = f"{table.shown(table.times[0])} to {table.shown(table.times[-1])}"
            raise ValueError(f"--{name} must have a complete row in the time of the rates, {span}; check its columns.")
    field, tracker = others.get("magnetometer"), others.get("tracker")
    if options.magnetometer_data and field is not None:
        _check_overlap(options, table, field)
    begin = table.times[0] if field is None else min(table.times[0], field.times[0])
    last = max(one.times[-1] for one in (table, field) if one is not None) - begin
    sigma = (options.sigma or 1.0) * UNITS_OF_RATE[options.unit]
    bias, iron = "bias" if options.bias else None, "iron" if options.hard_iron else None
    measurements: list[Any] = [Rates(table.times - begin, table.values, sigma, bias=bias)]
    if field is not None:
        said, known = np.deg2rad(options.magnetometer_sigma), _UP if tracker is None else "field"
        late = "clock" if options.magnetometer_clock == "fitted" else None
        seen = Directions(field.times - begin, field.values, said, reference=known, bias=iron, clock=late)
        measurements.append(seen)
    if tracker is not None:
        said, quaternions = np.deg2rad(options.tracker_sigma), tracker.values
        lengths = np.linalg.norm(quaternions, axis=1)
        if (wrong := np.flatnonzero(np.abs(lengths - 1) > _UNIT_LENGTH)).size:
            where = f"{options.data}, line {tracker.lines[wrong[0]]}"
            raise ValueError(f"{where}: the length of a quaternion must be 1, got {lengths[wrong[0]]:.6g}.")
        if options.space_to_body:
            tracker = tracker._replace(values=quaternions * [1.0, -1.0, -1.0, -1.0])
        measurements.append(Attitudes(tracker.times - begin, tracker.values, said))
        _check_convention(options, measurements)
    speeds = np.linalg.norm(table.values, axis=1)
    if table.times[-1] <= table.times[0] or not np.nanmax(speeds, initial=0.0) > 0:
        raise ValueError("the data need two times and a body that rotates; check the columns.")
    given = {
        "dt": _step(table, last, speeds, bool(options.moments)),
        "starts": options.starts,
        "absolute_sigma": bool(options.sigma),
        "require_rank": False,
        "first_span": _FIRST / float(np.nanmedian(speeds[speeds > 0])),
    }
    return Problem(options, given, measurements, table, field, tracker, begin)


def _flight(options: argparse.Namespace, table: Table) -> Table:
    """The rows of the free flight, unless the times of its ends are given."""
    times, rates = table.complete
    found = free_flight(times, rates) if options.first is options.last is None and len(times) > _ROWS else None
    if found is not None and (found[0] > times[0] or found[1] < times[-1]):
        table = table.within(*found)
        print(
            f"free flight: --from {table.shown(table.times[0])} --to {table.shown(table.times[-1])}, found by the rates"
            "; a part may be missing if the columns are over 5 degrees off the principal axes"
        )
    check_rates(options.data, table.lines, table.values / UNITS_OF_RATE[options.unit])
    _check_flight(options, table)
    return table


def _check_convention(options: argparse.Namespace, measurements: list[Any]) -> None:
    try:
        check_conventions(measurements, {"bias": np.zeros(3)})
    except ValueError as error:
        told = str(error).partition(" Pass ")[0]
        other = "leave out --space-to-body" if options.space_to_body else "give --space-to-body"
        order = "name the columns of --tracker in the order w x y z"
        cures = [cure for word, cure in (("scalar-last", order), ("conjugated", other)) if word in told]
        raise ValueError(f"{options.data}: {told} {' and '.join(cures).capitalize()}.") from None


def _check_overlap(options: argparse.Namespace, table: Table, field: Table) -> None:
    units = "check the units of time (--time-unit, --magnetometer-time-unit) and that both count from the same moment"
    if field.times[0] > table.times[-1] or field.times[-1] < table.times[0]:
        raise ValueError(
            f"{options.magnetometer_data} is of t = {field.times[0]:g} to {field.times[-1]:g} s, and {options.data} of "
            f"{table.times[0]:g} to {table.times[-1]:g} s; {units}."
        )
    before = np.nanmedian(np.linalg.norm(table.values, axis=1)) * (table.times[0] - field.times[0])
    if before > _BEFORE:
        first = field.lines[np.searchsorted(field.times, table.times[0])]
        raise ValueError(
            f"{options.magnetometer_data} begins {table.times[0] - field.times[0]:g} s before {options.data}, in which "
            f"the body rotates by {before:.3g} radians; remove the rows before line {first}, or {units}."
        )


def _step(table: Table, last: float, speeds: np.ndarray, guessed: bool) -> float:
    """The step. Evenly spaced rows lie on the grid of the step, which compiles and runs faster."""
    times = table.times - table.times[0]
    fastest, gaps = float(np.nanmax(speeds)), np.diff(times)
    spacing = float(np.median(gaps[gaps > 0]))
    turns = float(np.nanmedian(speeds)) * spacing / (2 * np.pi)
    units = "check the unit of time (--time-unit) and of the rates (--unit)"
    if turns > _MOST_TURNS and not guessed:
        raise ValueError(
            f"the body rotates {turns:.3g} times between rows; {units}. For such sparse rows, give a "
            "close guess by --moments."
        )
    counts = np.rint(gaps / spacing)
    length = float(times[-1] / max(counts.sum(), 1))
    even = np.all(np.abs(np.cumsum(counts) * length - times[1:]) <= 1e-9 * times[-1])
    whole = length if even else float(times[-1])
    dt = whole / np.ceil(whole * fastest / _TURN)
    if last / dt > _MOST_STEPS:
        line = table.lines[int(np.nanargmax(speeds))]
        raise ValueError(
            f"the run would take {last / dt:.2g} steps, more than {_MOST_STEPS:g}: the body rotates "
            f"{fastest * last / (2 * np.pi):.2g} times in all, by the rate in line {line}; {units}, "
            "or fit a part of the file."
        )
    return float(dt)


def _model(values: dict[str, jax.Array]) -> tuple[RigidBody, None, MomentumState | DirectionState | RigidState]:
    body = RigidBody(values["moments"])
    momentum = body.momentum(values["rate"])
    if "attitude" in values:
        return body, None, RigidState(momentum, values["attitude"])
    return body, None, DirectionState(momentum, values["field"]) if "field" in values else MomentumState(momentum)


def _fitted(problem: Problem) -> Fit:
    """The best fit from the given moments or a guess by the rates; if doubtful, also from all six permutations."""
    (guess, bias), moments = _guess(problem.table, problem.options.bias), problem.options.moments
    first = _from(problem, np.array(moments) if moments else guess, bias)
    if moments or (first.ok and not first.doubts):
        return first
    others = [_from(problem, np.array(order), bias) for order in _ORDERS]
    return min([first, *others], key=lambda result: (not result.ok, result.rms))


def _from(problem: Problem, moments: np.ndarray, bias: np.ndarray) -> Fit:
    options, table, field, tracker = problem.options, problem.table, problem.field, problem.tracker
    rate = table.complete[1][0] - bias
    start: dict[str, Any] = {"moments": Moments(moments, scale="fixed"), "rate": Free(rate)}
    if options.bias:
        start["bias"] = Free(bias)
    attitude = Rotation.identity()
    if tracker is not None:
        since = _turned_back(table, bias, problem.begin, float(tracker.times[0]))
        attitude = Rotation.from_quat(tracker.values[0], scalar_first=True) * since.inv()
        start["attitude"] = UnitQuaternion(attitude.as_quat(scalar_first=True))
    if field is not None:
        seen = field.values
        # In the body frame, the field of iron in the body is constant, and the measured field rotates about this
        # constant.
        iron = (seen.max(axis=0) + seen.min(axis=0)) / 2 if options.hard_iron else np.zeros(3)
        since = _turned_back(table, bias, problem.begin, float(field.times[0]))
        first = (attitude * since).apply(seen[0] - iron)  # in space with a star tracker, else in the body
        start["field"] = UnitVector(first / np.linalg.norm(first))
        if options.hard_iron:
            start["iron"] = Free(iron)
        if options.magnetometer_clock == "fitted":
            start["clock"] = Free(0.0)
    return run_fit(_model, start, problem.measurements, **problem.given)


def _doubts(problem: Problem, result: Fit) -> list[str]:
    lines, told = [one.lines for one in (problem.table, problem.field, problem.tracker) if one is not None], list[str]()
    for doubt in result.doubtful():
        places = [] if doubt.measurement is None else [str(lines[doubt.measurement][row]) for row in doubt.rows]
        where = f"line{'s' if len(places) > 1 else ''} {', '.join(places)}: " if places else ""
        told.append(f"{where}{doubt.text}")
    return told


def _print(problem: Problem, result: Fit) -> None:
    options, table, moments = problem.options, problem.table, np.asarray(result.values["moments"])
    shown = table.shown(problem.begin)
    print(
        f"{options.data}: {np.sum(np.isfinite(table.values))} angular velocities at {len(table.times)} times; free "
        f"body, moments with a sum of {moments.sum():g}, rates in {options.unit}, those at "
        + (shown if table.zero else f"t = {shown} {options.time_unit or 's'}")
    )
    if options.magnetometer_data and problem.field is not None:
        clock = "; clock: how far its clock is ahead, in s" if options.magnetometer_clock == "fitted" else ""
        print(f"{options.magnetometer_data}: {len(problem.field.times)} directions of the field{clock}")
    print(_in_units_of_file(problem, result))
    if not options.sigma:
        print(f"sigma is not given and counts as 1 {options.unit}; the rms of the rates determines the intervals")
    ratios, intervals = result.derived(lambda v: v["moments"][:2] / v["moments"][2])
    for i, (ratio, (low, high)) in enumerate(zip(ratios, intervals, strict=True)):
        print(f"moments[{i}] / moments[2]  {ratio:.10g}  [{low:.10g}, {high:.10g}]")


def _in_units_of_file(problem: Problem, result: Fit) -> Fit:
    shown, rates = copy(result), [name.startswith(("rate[", "bias[")) for name in result.names]
    scales = np.where(rates, 1 / UNITS_OF_RATE[problem.options.unit], 1.0)
    shown.coordinates, shown.intervals = result.coordinates * scales, result.intervals * scales[:, None]
    shown.covariance = result.covariance * np.outer(scales, scales)
    return shown


def _draw(problem: Problem, result: Fit) -> None:
    options, table, moments = problem.options, problem.table, np.asarray(result.values["moments"])
    body, _, start = _model(result.values)
    times = np.linspace(table.times[0] - problem.begin, table.times[-1] - problem.begin, 1000)
    curve = states_at("JACOBI[EA]", body, None, MomentumState(start.momentum), times, dt=problem.given["dt"])
    curves = np.asarray(curve.states.momentum) / moments + np.asarray(result.values.get("bias", np.zeros(3)))
    figure = new_figure(11.0, 8.0)
    name = Path(options.data).name
    heading(figure, f"{name}: a free body", "Lines: the fitted motion. Dots: the measurements and the residuals.")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    unit, in_file = "sigma" if options.sigma else options.unit, UNITS_OF_RATE[options.unit]
    panel(above, "Angular velocity about the principal axes", "", f"Ω  [{options.unit}]")
    panel(below, "Residuals: model minus measurement", "Time t  [s]", f"Residual  [{unit}]")
    residuals = result.residuals()[0]
    for i, colour in enumerate((BLUE, VERMILLION, GREEN)):
        style = {"color": colour, "markersize": 4}
        above.plot(problem.begin + times, curves[:, i] / in_file, color=colour, linewidth=1.2, label=f"Ω{i + 1}")
        above.plot(table.times, table.values[:, i] / in_file, ".", **style)
        below.plot(table.times, residuals[:, i], ".", **style)
    above.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    write(figure, options.out)
    print(f"wrote {options.out}")


def _check_flight(options: argparse.Namespace, table: Table) -> None:
    """Raises if the speed changes more than for a free body, because the body was held in a part of the record."""
    times, rates = table.complete
    if len(times) < _ROWS:
        return
    smooth = median_filter(np.linalg.norm(rates, axis=1), _ROWS, mode="nearest")
    moments, unit = options.moments or [1.0], UNITS_OF_RATE[options.unit]
    allowed = max(_FACTOR, 2 * max(moments) / min(moments))
    slow, fast = float(np.percentile(smooth, _SLOW)), int(np.argmax(smooth))
    if smooth[fast] <= allowed * slow:
        return
    below = np.flatnonzero(smooth < smooth[fast] / 2)
    first, last = below[below < fast].max(initial=-1) + 1, below[below > fast].min(initial=len(times)) - 1
    raise ValueError(
        f"{options.data}: the speed goes from {slow / unit:.3g} to {smooth[fast] / unit:.3g} {options.unit}, at "
        f"{table.shown(times[fast])}, too much for a free body: the file holds more than a free flight. Give "
        "the first and the last time of the flight; the speed is above half of its largest with "
        f"--from {table.shown(times[first])} --to {table.shown(times[last])}."
    )


def _guess(table: Table, bias: bool) -> tuple[np.ndarray, np.ndarray]:
    """Moments with the sum 5.5, and the bias (3,), zero unless it is requested.

    They are the best solution of the window equations, from starts with all six permutations of the moments.
    """
    times, rates = table.complete
    if len(times) < 3:
        return np.array(_ORDERS[0]), np.zeros(3)
    _, _, changes, products, linear = seen = windows(times - table.times[0], rates, _WINDOW)
    size = np.sqrt(np.mean(rates**2))

    def residuals(x: np.ndarray) -> np.ndarray:
        moments, b = _moments(x[:2]), (x[2:] if bias else np.zeros(3))
        # The integrals of the products of rates minus the bias.
        mixed = np.roll(linear, -1, 1) * np.roll(b, -2) + np.roll(linear, -2, 1) * np.roll(b, -1)
        without = products - mixed + seen.spans[:, None] * np.roll(b, -1) * np.roll(b, -2)
        slopes = (np.roll(moments, -1) - np.roll(moments, -2)) / moments
        return ((changes - slopes * without) / size).ravel()

    found: list[tuple[float, np.ndarray]] = []
    for order in _ORDERS:
        second = np.log(_TOTAL / 2 - np.array(order))
        start = np.concatenate([second[:2] - second[2], np.zeros(3 * bias)])
        scale = np.concatenate([np.ones(2), np.full(3 * bias, size)])
        solution = least_squares(residuals, start, x_scale=scale, loss="soft_l1", f_scale=0.1, max_nfev=200)
        found.append((solution.cost, solution.x))
    best = min(found, key=lambda one: one[0])[1]
    return _moments(np.clip(best[:2], -4, 4)), best[2:] if bias else np.zeros(3)


def _turned_back(table: Table, bias: np.ndarray, begin: float, end: float) -> Rotation:
    """The rotation of components of a space-fixed vector in the body frame, from `end` to `begin`.

    The body rotates with the measured rates between the rows, and before the first row with its rate.
    """
    times, rates = table.complete
    rates = rates - bias
    count = int(np.clip((end - begin) * np.linalg.norm(rates, axis=1).max() / _FINE, 1, _MOST_POINTS))
    middles = begin + (end - begin) * (np.arange(count) + 0.5) / count
    turns = np.stack([np.interp(middles, times, rates[:, i]) for i in range(3)], axis=1)
    return reduce(mul, Rotation.from_rotvec(turns * (end - begin) / count))


def _moments(logs: np.ndarray) -> np.ndarray:
    """Moments with the sum 5.5 from log(a/c) and log(b/c), as in `midlie_jax.fitting.Moments`."""
    second = np.exp(np.append(logs, 0.0))
    second = second * (_TOTAL / 2 / second.sum())
    return second.sum() - second


class Windows(NamedTuple):
    """Windows of one length in a record of angular velocities."""

    first: np.ndarray  # their beginnings, (m,)
    last: np.ndarray  # their ends, (m,)
    changes: np.ndarray  # of the rates, (m, 3)
    products: np.ndarray  # the integrals of Omega2 Omega3, Omega3 Omega1 and Omega1 Omega2, (m, 3)
    linear: np.ndarray  # the integrals of the rates, (m, 3)

    @property
    def spans(self) -> np.ndarray:
        return self.last - self.first


def windows(times: np.ndarray, rates: np.ndarray, turn: float) -> Windows:
    """Windows in which the body rotates by at most `turn` radians, without those over a gap between the rows."""
    speeds = np.linalg.norm(rates, axis=1)
    fastest, gaps = np.max(speeds), np.diff(times)
    count = int(np.clip((times[-1] - times[0]) * fastest / _FINE, 4 * len(times), _MOST_POINTS))
    fine = np.linspace(times[0], times[-1], count)
    values = CubicSpline(times, rates)(fine)
    products = np.roll(values, -1, 1) * np.roll(values, -2, 1)
    h = fine[1] - fine[0]
    of_products, of_rates = (
        np.vstack([np.zeros(3), np.cumsum((x[1:] + x[:-1]) * h / 2, axis=0)]) for x in (products, values)
    )
    width = int(np.clip(turn / fastest / h, 1, count // 3))
    first = np.arange(0, count - width, max(1, width // _PER_WINDOW))
    last = first + width
    long = np.flatnonzero(gaps > max(_GAP / np.median(speeds), 4 * np.median(gaps)))
    over = np.searchsorted(times[long], fine[last]) > np.searchsorted(times[long + 1], fine[first], side="right")
    if not np.all(over):
        first, last = first[~over], last[~over]
    of = (of_products[last] - of_products[first], of_rates[last] - of_rates[first])
    return Windows(fine[first], fine[last], values[last] - values[first], *of)


def free_flight(times: np.ndarray, rates: np.ndarray) -> tuple[float, float] | None:
    """The first and the last time of the free flight; None without a free rotation by one revolution.

    It is the part with the largest rotation in which one set of factors k explains the changes of the rates by Euler's
    equations, Omega1' = k1 Omega2 Omega3 and so on, in all windows of half a radian, to 5 % of the usual speed or to 6
    standard deviations of the noise. The rates are about principal axes: the test allows 5 degrees between them and the
    columns; at 10 degrees parts of a flight, or one in ten, are lost.

    Args:
        times, rates: (n,) and (n, 3), in seconds and rad/s, finite, and ascending without repetition.
    """
    noise = float(np.median(np.abs(np.diff(rates, 2, axis=0)))) / 0.6745 / np.sqrt(6)
    seen = windows(times, median_filter(rates, (3, 1), mode="nearest"), _TURN_OF_SEARCH)
    speeds = np.linalg.norm(seen.linear, axis=1) / seen.spans
    turned = np.concatenate([[0.0], np.cumsum(speeds * np.diff(seen.first, append=seen.last[-1]))])
    count, best, searched = len(speeds), (0, 0), np.zeros(len(speeds), bool)

    def unexplained(fitted: slice, asked: slice) -> np.ndarray:
        """The places of the windows that contradict the factors of other windows."""
        squares = np.sum(seen.products[fitted] ** 2, axis=0)
        factors = np.sum(seen.changes[fitted] * seen.products[fitted], axis=0) / np.maximum(squares, 1e-300)
        off = np.max(np.abs(seen.changes[asked] - factors * seen.products[asked]), axis=1)
        return asked.start + np.flatnonzero(off > max(_LEFT * np.median(speeds[fitted]), _NOISE * noise))

    for seed in np.flatnonzero(speeds > _SLOWEST * np.max(speeds))[:: _PER_WINDOW // 2]:
        part = slice(max(0, seed - _PER_WINDOW), min(count, seed + _PER_WINDOW))
        if searched[seed] or unexplained(part, part).size:
            continue
        grown = None
        while grown != part:
            grown, more = part, max(_PER_WINDOW, (part.stop - part.start) // 4)
            wider = slice(max(0, part.start - more), min(count, part.stop + more))
            wrong = unexplained(part, wider)
            begin = wrong[wrong < part.start].max(initial=wider.start - 1) + 1
            part = slice(begin, wrong[wrong >= part.stop].min(initial=wider.stop))
        ends = [part.start - 1, *unexplained(part, part), part.stop]
        begin, end = max(((a + 1, b) for a, b in pairwise(ends)), key=lambda x: x[1] - x[0])
        searched[begin:end] = True
        if turned[end] - turned[begin] > turned[best[1]] - turned[best[0]]:
            best = begin, end
    begin, end = best
    if turned[end] - turned[begin] < _WHOLE:
        return None
    margin = (seen.last[begin] - seen.first[begin]) / 2  # a window may extend beyond the flight
    first = times[0] if begin == 0 else seen.first[begin] + margin
    last = times[-1] if end == count else seen.last[end - 1] - margin
    return float(first), float(last)
