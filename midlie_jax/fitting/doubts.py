"""Whether the residuals of a fit look like noise: where they do not, the intervals are too narrow."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri  # SciPy comes with JAX

from .measurements import Measurement

_FEW = 12  # with fewer rows, the correlation of neighbours is not tested
_LAGS = (1, 8)
_SIGNIFICANT = 5.0  # standard deviations
_CHANCE = 1e-5  # the probability that noise has a value that counts as far off
_SPREAD = 1.15  # the factor by which the deviation of few values may be underestimated
_EXACT = 1e-6  # relative to the measured values; smaller residuals come from the optimiser's tolerance
_LARGE = 0.3


class Doubt(NamedTuple):
    """Why a fit may be wrong although it converged.

    Attributes:
        text: what the residuals show.
        measurement, row: the indices of the value in question, or None if it is no single value.
    """

    text: str
    measurement: int
    row: int | None = None


def doubts(residuals: Sequence[np.ndarray], measurements: Sequence[Measurement]) -> list[Doubt]:
    """The reasons to doubt a fit.

    Args:
        residuals: for each measurement, the residuals over sigma, of the shape of its `present`; NaN where missing.
        measurements: the measurements, in the same order.
    """
    found: list[Doubt] = []
    for i, (over_sigma, measurement) in enumerate(zip(residuals, measurements, strict=True)):
        kind = type(measurement).__name__
        absolute = over_sigma * np.asarray(measurement.sigma)
        size = np.sqrt(np.mean(np.asarray(measurement.values) ** 2))
        rms = np.sqrt(np.nanmean(absolute**2))
        if not np.isfinite(rms) or rms <= _EXACT * size:
            continue
        rows = over_sigma.reshape(len(over_sigma), -1)
        far = _outlier(rows)
        if far is not None:
            row, times = far
            when = f"{float(measurement.times[row]):.6g}"
            found.append(
                Doubt(f"{kind}: the value at t = {when} is off by {times:.0f} times the others' deviation", i, row)
            )
        if kind == "Rates" and rms > _LARGE * size:
            found.append(Doubt(f"{kind}: the residuals are {rms / size:.0%} of what was measured", i))
        alike = _alike(rows)
        if alike is not None:
            text = (
                f"{kind}: neighbouring residuals are alike (correlation {alike:.2f}), which noise is not: the model "
                "leaves something out, such as a bias or a torque, and the intervals are too narrow"
            )
            found.append(Doubt(text, i))
    return found


def _outlier(rows: np.ndarray) -> tuple[int, float] | None:
    """The row furthest off, and its distance in units of the usual deviation; None if no row is far off."""
    sizes = np.abs(rows)
    if np.sum(np.isfinite(sizes)) < _FEW:
        return None
    usual = np.nanmedian(sizes, axis=0) / 0.6745
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(np.isfinite(sizes), sizes / usual, 0.0)
    row = int(np.argmax(np.max(relative, axis=1)))
    most = float(np.max(relative))
    far = _SPREAD * ndtri(1 - _CHANCE / 2 / np.sum(np.isfinite(sizes)))
    return (row, most) if most > far else None


def _alike(rows: np.ndarray) -> float | None:
    """The mean correlation with the next row, or with the next eight, if chance does not explain it; else None."""
    complete = rows[np.all(np.isfinite(rows), axis=1)]
    if len(complete) < _FEW:
        return None
    square = np.sum(complete**2)
    for lags in _LAGS:
        if len(complete) <= 4 * lags:
            continue
        each = [float(np.sum(complete[lag:] * complete[:-lag]) / square) for lag in range(1, lags + 1)]
        if np.mean(each) * np.sqrt(lags * complete.size) > _SIGNIFICANT:
            return float(np.mean(each))
    return None
