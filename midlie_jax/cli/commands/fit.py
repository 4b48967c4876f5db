"""`midlie fit`: moments of inertia and initial rates of a free body from its instruments, in one file or two."""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from ...fitting import Directions, Fit, Free, Moments, Rates, UnitVector, states_at
from ...fitting import fit as run_fit
from ...fitting.noise import Doubt
from ...model.bodies import RigidBody
from ...model.states import DirectionState, MomentumState
from .fit_data import UNITS_OF_RATE, UNITS_OF_TIME, Columns, Field, FieldColumns, Table, read, read_field
from .fit_flight import check_flight
from .fit_guess import ORDERS, Guess, guess, turned_back
from .output import require

_TURN = 0.5  # largest rotation per step, radians
_MOST_TURNS = 0.5  # rotations between two rows; above, the rates at the rows do not determine the motion between them
_MOST_STEPS = 1_000_000  # about one second for each evaluation by the optimiser
_FIRST = 6.0  # rotation of the body in the span that is fitted first, radians
_BEFORE = 1.0  # the largest rotation of the body before the first row of the gyroscope, radians
_UP = (0.0, 0.0, 1.0)  # the direction that a DirectionState follows


class Problem(NamedTuple):
    """The data and options of a fit.

    Attributes:
        measurements: rates and, if there is a magnetometer, directions.
        options: the options for `midlie_jax.fit`.
        bias, iron: whether the gyroscope has a bias, and whether the magnetometer has one.
        clock: whether the clock of the magnetometer is also found.
        table, field: the data of the files.
        begin: the first time of all, the time of the start.
    """

    measurements: list[Any]
    options: dict[str, Any]
    bias: bool
    iron: bool
    clock: bool
    table: Table
    field: Field | None
    begin: float


def fit(options: argparse.Namespace) -> None:
    """Fits the data, prints the estimates, and writes a chart if requested."""
    if options.out:
        require("matplotlib")
    problem = _problem(options)
    result = _fitted(problem, options.moments)
    _print(options, problem, result)
    if options.out:
        _draw(options, problem, result)
    told = ([] if result.ok else [result.message.rstrip(".")]) + _doubts(problem, result)
    if told:
        raise ValueError(f"not ok: {'; '.join([*told, *_cures(options, result)])}")


def _cures(options: argparse.Namespace, result: Fit) -> list[str]:
    if result.ok and result.doubts == [result.aliases]:
        return []
    bias = [] if options.bias else ["try --bias"]
    part = ["if the file holds more than a free flight, give --from and --to"] if _whole(options) else []
    return [" or, ".join(bias + part)] if bias + part else []


def _whole(options: argparse.Namespace) -> bool:
    return options.first is None and options.last is None


_NEEDS_FIELD = ("magnetometer_sigma", "hard_iron", "magnetometer_data")
_NEEDS_FILE = ("magnetometer_time", "magnetometer_time_unit", "magnetometer_clock")


def _check_options(options: argparse.Namespace) -> None:
    if options.magnetometer and not (options.sigma and options.magnetometer_sigma):
        raise ValueError("with --magnetometer, give --sigma and --magnetometer-sigma, their relative weights.")
    for name in _NEEDS_FIELD:
        if getattr(options, name) and not options.magnetometer:
            raise ValueError(f"--{name.replace('_', '-')} needs --magnetometer with the names of its columns.")
    for name in _NEEDS_FILE:
        if getattr(options, name) and not options.magnetometer_data:
            raise ValueError(f"--{name.replace('_', '-')} needs --magnetometer-data, the magnetometer's own file.")
    if options.magnetometer_data and not options.magnetometer_time:
        raise ValueError("--magnetometer-data needs --magnetometer-time, the name of its column of time.")
    if options.magnetometer_data and not options.magnetometer_clock:
        raise ValueError(
            "--magnetometer-data needs --magnetometer-clock: `same` if both files use one clock, or `fitted`."
        )


def _problem(options: argparse.Namespace) -> Problem:
    _check_options(options)
    own = options.magnetometer_data
    among = None if own else options.magnetometer
    if options.first is not None and options.last is not None and options.first >= options.last:
        raise ValueError(f"--from must be before --to, got {options.first:g} and {options.last:g}.")
    columns = Columns(options.columns, among, options.unit, options.time_unit, options.first, options.last)
    table, field = read(options.data, columns)
    check_flight(options.data, table, UNITS_OF_TIME[options.time_unit or "s"], options.moments)
    if own:
        columns = FieldColumns(options.magnetometer_time, options.magnetometer, options.magnetometer_time_unit)
        field = _within(options, read_field(own, columns))
        _check_overlap(options, table, field)
    begin = table.times[0] if field is None else min(table.times[0], field.times[0])
    times = table.times - begin
    sigma = options.sigma * UNITS_OF_RATE[options.unit] if options.sigma else 1.0
    measurements: list[Any] = [Rates(times, table.rates, sigma, bias="bias" if options.bias else None)]
    clock = options.magnetometer_clock == "fitted"
    last = times[-1]
    if field is not None:
        iron = "iron" if options.hard_iron else None
        said = np.deg2rad(options.magnetometer_sigma)
        late = "clock" if clock else None
        seen = Directions(field.times - begin, field.vectors, said, reference=_UP, bias=iron, clock=late)
        measurements.append(seen)
        last = max(last, field.times[-1] - begin)
    speeds = np.linalg.norm(table.rates, axis=1)
    if table.times[-1] <= table.times[0] or not np.nanmax(speeds, initial=0.0) > 0:
        raise ValueError("the data need two times and a body that rotates; check the columns.")
    dt = _step(table, last, speeds, bool(options.moments))
    given = {
        "dt": dt,
        "starts": options.starts,
        "absolute_sigma": bool(options.sigma),
        "require_rank": False,
        "first_span": _FIRST / float(np.nanmedian(speeds[speeds > 0])),
    }
    return Problem(measurements, given, options.bias, bool(options.hard_iron), clock, table, field, begin)


def _within(options: argparse.Namespace, field: Field) -> Field:
    unit = UNITS_OF_TIME[options.time_unit or "s"]
    kept = np.ones(len(field.times), bool)
    if options.first is not None:
        kept &= field.times >= options.first * unit
    if options.last is not None:
        kept &= field.times <= options.last * unit
    if not kept.any():
        raise ValueError(f"{options.magnetometer_data} has no rows between --from and --to.")
    return Field(field.times[kept], field.vectors[kept], field.lines[kept])


def _check_overlap(options: argparse.Namespace, table: Table, field: Field) -> None:
    units = "check the units of time (--time-unit, --magnetometer-time-unit) and that both count from the same moment"
    if field.times[0] > table.times[-1] or field.times[-1] < table.times[0]:
        raise ValueError(
            f"{options.magnetometer_data} is of t = {field.times[0]:g} to {field.times[-1]:g} s, and {options.data} of "
            f"{table.times[0]:g} to {table.times[-1]:g} s; {units}."
        )
    before = np.nanmedian(np.linalg.norm(table.rates, axis=1)) * (table.times[0] - field.times[0])
    if before > _BEFORE:
        first = field.lines[np.searchsorted(field.times, table.times[0])]
        raise ValueError(
            f"{options.magnetometer_data} begins {table.times[0] - field.times[0]:g} s before "
            f"{options.data}, in which the body rotates by {before:.3g} radians; remove the rows "
            f"before line {first}, or {units}."
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


def _model(values: dict[str, jax.Array]) -> tuple[RigidBody, None, MomentumState | DirectionState]:
    body = RigidBody(values["moments"])
    momentum = body.momentum(values["rate"])
    return body, None, DirectionState(momentum, values["field"]) if "field" in values else MomentumState(momentum)


def _fitted(problem: Problem, moments: list[float] | None) -> Fit:
    """The best fit from the given moments or a guess by the rates; if doubtful, also from all six permutations."""
    table = problem.table
    near = guess(table.times - table.times[0], table.rates, problem.bias)
    first = _from(problem, near._replace(moments=np.array(moments)) if moments else near)
    if moments or (first.ok and not first.doubts):
        return first
    others = [_from(problem, near._replace(moments=np.array(order))) for order in ORDERS]
    return min([first, *others], key=lambda result: (not result.ok, result.rms))


def _from(problem: Problem, near: Guess) -> Fit:
    rates = problem.table.rates
    rate = rates[np.flatnonzero(np.all(np.isfinite(rates), axis=1))[0]] - near.bias
    start: dict[str, Any] = {"moments": Moments(near.moments, scale="fixed"), "rate": Free(rate)}
    if problem.bias:
        start["bias"] = Free(near.bias)
    field = problem.field
    if field is not None:
        whole = np.all(np.isfinite(field.vectors), axis=1)
        complete = field.vectors[whole]
        # In the body frame, the field of iron in the body is constant, and the measured field rotates about this
        # constant.
        iron = (complete.max(axis=0) + complete.min(axis=0)) / 2 if problem.iron else np.zeros(3)
        first = turned_back(problem.table, near.bias, complete[0] - iron, problem.begin, field.times[whole][0])
        start["field"] = UnitVector(first / np.linalg.norm(first))
        if problem.iron:
            start["iron"] = Free(iron)
        if problem.clock:
            start["clock"] = Free(0.0)
    return run_fit(_model, start, problem.measurements, **problem.options)


def _doubts(problem: Problem, result: Fit) -> list[str]:
    lines = [problem.table.lines] + ([] if problem.field is None else [problem.field.lines])

    def named(doubt: Doubt) -> str:
        if doubt.measurement is None or not doubt.rows:
            return doubt.text
        places = [str(lines[doubt.measurement][row]) for row in doubt.rows]
        return f"line{'s' if len(places) > 1 else ''} {', '.join(places)}: {doubt.text}"

    return [named(doubt) for doubt in result.doubtful()]


def _print(options: argparse.Namespace, problem: Problem, result: Fit) -> None:
    table = problem.table
    moments = np.asarray(result.values["moments"])
    print(
        f"{options.data}: {np.sum(np.isfinite(table.rates))} angular velocities at {len(table.times)} times; free body,"
        f" moments with a sum of {moments.sum():g}, rates in rad/s, those at t = {problem.begin:g} s"
    )
    if options.magnetometer_data and problem.field is not None:
        count = np.sum(np.isfinite(problem.field.vectors).all(axis=1))
        clock = "; clock: how far its clock is ahead, in s" if problem.clock else ""
        print(f"{options.magnetometer_data}: {count} directions of the field{clock}")
    print(result)
    if not options.sigma:
        print("sigma is not given and counts as 1 rad/s: the rms refers to the rates and determines the intervals")
    ratios, intervals = result.derived(lambda v: v["moments"][:2] / v["moments"][2])
    for i, (ratio, (low, high)) in enumerate(zip(ratios, intervals, strict=True)):
        print(f"moments[{i}] / moments[2]  {ratio:.10g}  [{low:.10g}, {high:.10g}]")


def _draw(options: argparse.Namespace, problem: Problem, result: Fit) -> None:
    from .fit_chart import fit_chart

    table, moments = problem.table, np.asarray(result.values["moments"])
    body, _, start = _model(result.values)
    times = np.linspace(table.times[0] - problem.begin, table.times[-1] - problem.begin, 1000)
    curve = states_at("JACOBI[EA]", body, None, MomentumState(start.momentum), times, dt=problem.options["dt"])
    curves = np.asarray(curve.states.momentum) / moments + np.asarray(result.values.get("bias", np.zeros(3)))
    fit_chart(
        Path(options.data).name,
        table.times,
        table.rates,
        problem.begin + times,
        curves,
        result.residuals()[0],
        "sigma" if options.sigma else "rad/s",
        options.out,
    )
    print(f"wrote {options.out}")
