"""Test whether a record contains one free flight: the speed of a free body changes little."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter  # SciPy comes with JAX

from .fit_data import Table

_FACTOR = 20.0  # between the largest and the smallest speed; for a free body at most the ratio of its moments
_ROWS = 9  # of the running median, which ignores single wrong rows
_SLOW = 5.0  # percentage of the rows that may be slower than the smallest speed


def check_flight(path: str, table: Table, unit: float, moments: Sequence[float] | None) -> None:
    """Raises if the speed changes more than for a free body, because the body was held in a part of the record."""
    complete = np.all(np.isfinite(table.rates), axis=1)
    if complete.sum() < _ROWS:
        return
    times, speeds = table.times[complete] / unit, np.linalg.norm(table.rates[complete], axis=1)
    smooth = median_filter(speeds, _ROWS, mode="nearest")
    allowed = _FACTOR if moments is None else max(_FACTOR, 2 * max(moments) / min(moments))
    slow, fast = float(np.percentile(smooth, _SLOW)), int(np.argmax(smooth))
    if smooth[fast] <= allowed * slow:
        return
    below = np.flatnonzero(smooth < smooth[fast] / 2)
    first, last = below[below < fast].max(initial=-1) + 1, below[below > fast].min(initial=len(times)) - 1
    raise ValueError(
        f"{path}: the speed goes from {slow:.3g} to {smooth[fast]:.3g} rad/s, at t = "
        f"{times[fast]:g}, too much for a free body: the file holds more than a free flight. Give "
        "the first and the last time of the flight by --from and --to; the speed is above half "
        f"of its largest from t = {times[first]:g} to {times[last]:g}."
    )
