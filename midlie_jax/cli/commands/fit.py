"""`midlie fit`: moments of inertia and initial rates of a free body from what its instruments measured, in a file."""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from ...fitting import Directions, Fit, Free, Moments, Rates, UnitVector, states_at
from ...fitting import fit as run_fit
from ...fitting.doubts import doubts
from ...model.bodies import RigidBody
from ...model.states import DirectionState, MomentumState
from .fit_data import UNITS_OF_RATE, Columns, Table, read
from .fit_guess import ORDERS, Guess, guess
from .output import require

_TURN = 0.5  # the most radians per step
_MOST_TURNS = 0.5  # turns between two rows; with more, the rates at the rows do not determine the motion between
_MOST_STEPS = 1_000_000  # about one second for each evaluation by the optimiser
_FIRST = 6.0  # radians by which the body turns in the span that is fitted first
_UP = (0.0, 0.0, 1.0)  # the direction that a DirectionState follows


class Problem(NamedTuple):
    """What is fitted.

    Attributes:
        measurements: rates and, if there is a magnetometer, directions.
        options: the options for `midlie_jax.fit`.
        bias, iron: whether the gyroscope has a bias, and whether the magnetometer has one.
        line: the line of the file for each row.
    """

    measurements: list[Any]
    options: dict[str, Any]
    bias: bool
    iron: bool
    table: Table


def fit(options: argparse.Namespace) -> None:
    """Fits the data, prints the estimates, and writes a chart if requested.

    Raises:
        ValueError: the file or an option is wrong, or the fit is not ok; the message says why.
    """
    if options.out:
        require("matplotlib")
    problem = _problem(options)
    result = _fitted(problem, options.moments)
    _print(options, problem, result)
    if options.out:
        _draw(options, problem, result)
    if not result.ok:
        raise ValueError(f"not ok: {result.message}")
    if told := _doubts(problem, result):
        cure = "" if options.bias else "; try --bias"
        raise ValueError(f"not ok: {'; '.join(told)}{cure}")


def _problem(options: argparse.Namespace) -> Problem:
    """Reads the file and refuses data that cannot be fitted, before anything is compiled."""
    field = options.magnetometer
    if field and not (options.sigma and options.magnetometer_sigma):
        raise ValueError(
            "with --magnetometer, give --sigma and --magnetometer-sigma: they weigh one against the other."
        )
    for name in ("magnetometer_sigma", "hard_iron"):
        if getattr(options, name) and not field:
            raise ValueError(f"--{name.replace('_', '-')} needs --magnetometer with the names of its columns.")
    table = read(options.data, Columns(options.columns, field, options.unit, options.time_unit))
    times = table.times - table.times[0]
    sigma = options.sigma * UNITS_OF_RATE[options.unit] if options.sigma else 1.0
    measurements: list[Any] = [Rates(times, table.rates, sigma, bias="bias" if options.bias else None)]
    if table.field is not None:
        iron = "iron" if options.hard_iron else None
        seen = Directions(times, table.field, np.deg2rad(options.magnetometer_sigma), reference=_UP, bias=iron)
        measurements.append(seen)
    speeds = np.linalg.norm(table.rates, axis=1)
    if times[-1] <= 0 or not np.nanmax(speeds, initial=0.0) > 0:
        raise ValueError("the data need two times and a body that turns; check the columns.")
    dt = _step(table, times, speeds, bool(options.moments))
    given = {
        "dt": dt,
        "starts": options.starts,
        "absolute_sigma": bool(options.sigma),
        "require_rank": False,
        "first_span": _FIRST / float(np.nanmedian(speeds[speeds > 0])),
    }
    return Problem(measurements, given, options.bias, bool(options.hard_iron), table)


def _step(table: Table, times: np.ndarray, speeds: np.ndarray, guessed: bool) -> float:
    """The step. If the rows are evenly spaced, they lie on the grid of the step, which compiles and runs faster."""
    fastest, gaps = float(np.nanmax(speeds)), np.diff(times)
    spacing = float(np.median(gaps[gaps > 0]))
    turns = float(np.nanmedian(speeds)) * spacing / (2 * np.pi)
    units = "check the unit of time (--time-unit) and of the rates (--unit)"
    if turns > _MOST_TURNS and not guessed:
        raise ValueError(
            f"the body turns {turns:.3g} times between rows; {units}. If the rows are so far apart, give a guess that "
            "is near by --moments."
        )
    counts = np.rint(gaps / spacing)
    length = float(times[-1] / max(counts.sum(), 1))
    even = np.all(np.abs(np.cumsum(counts) * length - times[1:]) <= 1e-9 * times[-1])
    whole = length if even else float(times[-1])
    dt = whole / np.ceil(whole * fastest / _TURN)
    if times[-1] / dt > _MOST_STEPS:
        line = table.lines[int(np.nanargmax(speeds))]
        raise ValueError(
            f"the run would take {times[-1] / dt:.2g} steps, more than {_MOST_STEPS:g}: the body turns "
            f"{fastest * times[-1] / (2 * np.pi):.2g} times in all, by the rate in line {line}; {units}, or fit a "
            "part of the file."
        )
    return float(dt)


def _model(values: dict[str, jax.Array]) -> tuple[RigidBody, None, MomentumState | DirectionState]:
    body = RigidBody(values["moments"])
    momentum = body.momentum(values["rate"])
    return body, None, DirectionState(momentum, values["field"]) if "field" in values else MomentumState(momentum)


def _fitted(problem: Problem, moments: list[float] | None) -> Fit:
    """The best fit from the given moments or a guess by the rates; if doubtful, also from all six sortings."""
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
    field = problem.table.field
    if field is not None:
        complete = field[np.all(np.isfinite(field), axis=1)]
        # In the body frame, the field of iron in the body is constant, and the measured field turns about this
        # constant.
        iron = (complete.max(axis=0) + complete.min(axis=0)) / 2 if problem.iron else np.zeros(3)
        start["field"] = UnitVector((complete[0] - iron) / np.linalg.norm(complete[0] - iron))
        if problem.iron:
            start["iron"] = Free(iron)
    return run_fit(_model, start, problem.measurements, **problem.options)


def _doubts(problem: Problem, result: Fit) -> list[str]:
    """The doubts about the fit, with the lines of the file that they concern."""
    lines = problem.table.lines
    found = doubts(result.residuals(), problem.measurements)
    return [doubt.text if doubt.row is None else f"line {lines[doubt.row]}: {doubt.text}" for doubt in found]


def _print(options: argparse.Namespace, problem: Problem, result: Fit) -> None:
    table = problem.table
    moments = np.asarray(result.values["moments"])
    print(
        f"{options.data}: {np.sum(np.isfinite(table.rates))} angular velocities at {len(table.times)} times; free body,"
        f" moments with a sum of {moments.sum():g}, rates in rad/s, those of the first row"
    )
    print(result)
    if not options.sigma:
        print(
            "sigma is not given and counts as 1 rad/s: the rms is that of the rates, and the intervals follow from it"
        )
    ratios, intervals = result.derived(lambda v: v["moments"][:2] / v["moments"][2])
    for i, (ratio, (low, high)) in enumerate(zip(ratios, intervals, strict=True)):
        print(f"moments[{i}] / moments[2]  {ratio:.10g}  [{low:.10g}, {high:.10g}]")


def _draw(options: argparse.Namespace, problem: Problem, result: Fit) -> None:
    from .fit_chart import fit_chart

    table, moments = problem.table, np.asarray(result.values["moments"])
    body, _, start = _model(result.values)
    times = np.linspace(0.0, table.times[-1] - table.times[0], 1000)
    curve = states_at("JACOBI[EA]", body, None, MomentumState(start.momentum), times, dt=problem.options["dt"])
    curves = np.asarray(curve.states.momentum) / moments + np.asarray(result.values.get("bias", np.zeros(3)))
    fit_chart(
        Path(options.data).name,
        table.times,
        table.rates,
        table.times[0] + times,
        curves,
        result.residuals()[0],
        "sigma" if options.sigma else "rad/s",
        options.out,
    )
    print(f"wrote {options.out}")
