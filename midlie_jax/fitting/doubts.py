"""Whether the residuals of a fit look like white noise, and whether the rows are close enough together."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri  # SciPy comes with JAX

from .measurements import Measurement
from .misfit import FEW, SIGNIFICANT, negligible

_LAGS = (1, 8)
_CHANCE = 1e-5  # the probability that noise has a value that counts as far off
_SPREAD = 1.15  # the factor by which the deviation of few values may be underestimated
_MANY = 50  # rows from which on each component has a deviation of its own
_WINDOW = 5.0  # correlation times over which the correlations are summed
_NARROW = 1.1  # smaller factors are not worth a word
_LISTED = 50  # the most rows that a text lists


class Doubt(NamedTuple):
    """Why a fit may be wrong although it converged.

    Attributes:
        text: what the residuals show.
        measurement: the index of the measurement, or None if it concerns all.
        rows: the rows of the values in question; empty if it is no single values.
    """

    text: str
    measurement: int | None
    rows: tuple[int, ...] = ()


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
        if not np.isfinite(rms) or rms <= negligible(measurement.sigma.dtype) * size:
            continue
        rows = over_sigma.reshape(len(over_sigma), -1)
        if far := _outliers(rows):
            found.append(Doubt(f"{kind}: {_far(measurement, far)}", i, tuple(row for row, _ in far)))
        correlation = _correlation(rows)
        if correlation is not None:
            factor = _narrowness(rows)
            by = f", by a factor of about {factor:.2g}" if factor > _NARROW else ""
            text = (
                f"{kind}: neighbouring residuals are correlated ({correlation:.2f}), unlike noise; the model leaves "
                f"something out, such as a bias or a torque, and the intervals are too narrow{by}"
            )
            found.append(Doubt(text, i))
    return found


def _far(measurement: Measurement, far: list[tuple[int, float]]) -> str:
    """The times of the values that are far off, and by how much."""
    if len(far) == 1:
        ((row, times),) = far
        when = f"{float(measurement.times[row]):.6g}"
        return f"the value at t = {when} is off by {times:.0f} times the deviation of the others"
    listed = ", ".join(f"{float(measurement.times[row]):.6g}" for row, _ in far[:_LISTED])
    more = f" and {len(far) - _LISTED} more" if len(far) > _LISTED else ""
    least, most = (f(times for _, times in far) for f in (min, max))
    return (
        f"{len(far)} values are off by {least:.0f} to {most:.0f} times the deviation of the others, at t = "
        f"{listed}{more}"
    )


def _outliers(rows: np.ndarray) -> list[tuple[int, float]]:
    """The rows that are far off, and the distance of each in units of the usual deviation."""
    sizes = np.abs(rows)
    if np.sum(np.isfinite(sizes)) < FEW:
        return []
    usual = np.nanmedian(sizes, axis=0) / 0.6745
    if len(sizes) < _MANY:  # the median of few values may be small by chance
        usual = np.maximum(usual, np.nanmedian(sizes) / 0.6745)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.max(np.where(np.isfinite(sizes), sizes / usual, 0.0), axis=1)
    far = _SPREAD * ndtri(1 - _CHANCE / 2 / np.sum(np.isfinite(sizes)))
    return [(int(row), float(relative[row])) for row in np.flatnonzero(relative > far)]


def _correlation(rows: np.ndarray) -> float | None:
    """The mean correlation with the next row, or with the next eight, if chance does not explain it; else None."""
    complete = rows[np.all(np.isfinite(rows), axis=1)]
    if len(complete) < FEW:
        return None
    for lags in _LAGS:
        if len(complete) <= 4 * lags:
            continue
        mean = float(np.mean([_at(complete, lag) for lag in range(1, lags + 1)]))
        if mean * np.sqrt(lags * complete.size) > SIGNIFICANT:
            return mean
    return None


def _narrowness(rows: np.ndarray) -> float:
    """The factor by which the correlation of the residuals makes standard deviations too small.

    It is the root of 1 + 2 (r_1 + r_2 + ...), with the correlations r_k at the lags k up to five times this sum.
    """
    complete = rows[np.all(np.isfinite(rows), axis=1)]
    total = 1.0
    for lag in range(1, len(complete) // 2):
        total += 2 * _at(complete, lag)
        if lag >= _WINDOW * total:
            break
    return float(np.sqrt(max(total, 1.0)))


def _at(rows: np.ndarray, lag: int) -> float:
    """The correlation at a lag."""
    return float(np.sum(rows[lag:] * rows[:-lag]) / np.sum(rows**2))
