"""`midlie fit`: moments of inertia and initial rates of a free body from measured angular velocities in a file."""

import argparse
import csv
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ...fitting import Fit, Free, Moments, Rates, states_at
from ...fitting import fit as run_fit
from ...model.bodies import RigidBody
from ...model.states import MomentumState
from .output import require

_FACTORS = {"rad/s": 1.0, "deg/s": np.pi / 180}
_GUESSES = ((1.0, 2.0, 2.5), (2.5, 1.0, 2.0), (2.0, 2.5, 1.0), (2.0, 1.0, 2.5), (1.0, 2.5, 2.0), (2.5, 2.0, 1.0))
_TURN = 0.5  # the most radians in a step


def fit(options: argparse.Namespace) -> None:
    """Fits the data and prints the estimates; writes a chart."""
    if options.out:
        require("matplotlib")
    times, rates = _read(options.data, options.columns, _FACTORS[options.unit])
    data = Rates(times, rates, options.sigma * _FACTORS[options.unit] if options.sigma else 1.0)
    result, dt = _fitted(times, data, rates, options.moments, bool(options.sigma))
    moments = np.asarray(result.values["moments"])
    ratios, intervals = result.derived(lambda v: v["moments"][:2] / v["moments"][2])
    known = np.sum(np.isfinite(rates))
    print(f"{options.data}: {known} angular velocities at {len(times)} times; free body, moments with a sum of "
          f"{moments.sum():g}, rates in rad/s")  # fmt: skip
    print(result)
    if not options.sigma:
        print(
            "sigma is not given and counts as 1 rad/s: the rms is that of the rates, and the intervals follow from it"
        )
    for i, (ratio, (low, high)) in enumerate(zip(ratios, intervals, strict=True)):
        print(f"moments[{i}] / moments[2]  {ratio:.10g}  [{low:.10g}, {high:.10g}]")
    if options.out:
        from .fit_chart import fit_chart

        body = RigidBody(result.values["moments"])
        start = MomentumState(body.momentum(result.values["rate"]))
        curve_times = np.linspace(times[0], times[-1], 1000)
        curve = states_at("JACOBI[EA]", body, None, start, curve_times, dt=dt, t0=float(times[0]))
        curves = np.asarray(curve.states.momentum) / moments
        unit = "sigma" if options.sigma else "rad/s"
        fit_chart(Path(options.data).name, times, rates, curve_times, curves, result.residuals()[0], unit, options.out)
        print(f"wrote {options.out}")
    if not result.ok:
        raise ValueError("the fit did not converge; give a guess of the moments by --moments, or check the unit.")


def _model(values: dict[str, jax.Array]) -> tuple[RigidBody, None, MomentumState]:
    body = RigidBody(values["moments"])
    return body, None, MomentumState(body.momentum(values["rate"]))


def _fitted(
    times: np.ndarray, data: Rates, rates: np.ndarray, moments: list[float] | None, absolute: bool
) -> tuple[Fit, float]:
    """The best fit from the given moments, or from six guesses of their order; and the step."""
    first = rates[np.flatnonzero(np.all(np.isfinite(rates), axis=1))[0]]
    fastest = float(np.nanmax(np.linalg.norm(rates, axis=1)))
    span = float(times[-1] - times[0])
    if span <= 0 or fastest == 0:
        raise ValueError("the data need two times and a body that turns; check the columns.")
    # A body turns faster than its rates show if a moment is much smaller than the others; the step leaves room for it.
    dt = span / np.ceil(span * fastest / _TURN)
    found: list[Fit] = []
    for start in [moments] if moments else _GUESSES:
        guess = {"moments": Moments(jnp.asarray(start, float), scale="fixed"), "rate": Free(first)}
        found.append(
            run_fit(
                _model, guess, data, dt=float(dt), t0=float(times[0]), absolute_sigma=absolute, require_rank=False
            )
        )  # fmt: skip
    return min(found, key=lambda result: (not result.ok, result.rms)), float(dt)


def _read(path: str, columns: list[str] | None, factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and angular velocities (n, 3) in rad/s from a CSV file with a header; NaN where a cell is empty.

    Raises:
        ValueError: a column is missing, a cell is no number, or a time is missing.
    """
    with open(path, newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file) if row]
    if len(rows) < 2:
        raise ValueError(f"{path} has no rows of data below a header.")
    header = [name.strip() for name in rows[0]]
    names = columns or header[:4]
    if len(names) != 4:
        raise ValueError(f"four columns are needed, time and three rates; {path} has {', '.join(header)}.")
    missing = [name for name in names if name not in header]
    if missing:
        raise ValueError(f"{path} has no column {missing[0]!r}; it has {', '.join(header)}. Give --columns.")
    places = [header.index(name) for name in names]
    table = np.full((len(rows) - 1, 4), np.nan)
    for i, row in enumerate(rows[1:]):
        for k, place in enumerate(places):
            cell = row[place].strip() if place < len(row) else ""
            try:
                table[i, k] = float(cell) if cell else np.nan
            except ValueError:
                raise ValueError(f"{path}, line {i + 2}: {names[k]} must be a number, got {cell!r}.") from None
    return table[:, 0], table[:, 1:] * factor
