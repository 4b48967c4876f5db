"""Whether measured attitudes follow the convention of `Attitudes`: the test against measured angular velocities.

Two neighbouring quaternions give the angular velocity between them. If it is far from the measured one, and close to it
after the quaternions are conjugated or their components exchanged, they follow another convention.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation  # SciPy comes with JAX

from .measurements import Attitudes, Measurement, Rates
from .of_body import OfBody

_ANGLE = 1.5  # the most radians between two rows, so that the rotation between them is known
_FEWEST = 4  # rows
_AGREES, _DIFFERS, _BETTER = 0.4, 0.6, 3.0
_CONJUGATED = "conjugated, from space to body"
_LAST = "scalar-last, (x, y, z, w)"
_BOTH = "conjugated and scalar-last, (x, y, z, w) from space to body"
_MINUS = "np.array([1.0, -1.0, -1.0, -1.0])"
_READINGS = {  # how each becomes (w, x, y, z) from body to space, and how to write it
    _CONJUGATED: (lambda q: q * [1, -1, -1, -1], f"values * {_MINUS}"),
    _LAST: (lambda q: np.roll(q, 1, axis=1), "np.roll(values, 1, axis=-1)"),
    _BOTH: (lambda q: np.roll(q, 1, axis=1) * [1, -1, -1, -1], f"np.roll(values, 1, axis=-1) * {_MINUS}"),
}


def check_conventions(measurements: Sequence[Measurement], values: Any) -> None:
    """Raises a ValueError if attitudes contradict the rates of the same body, and agree with them in another reading.

    Args:
        measurements: all measurements; those of an instrument whose clock is fitted are not compared.
        values: the values of the parameters of the guess.
    """
    attitudes, rates = (
        [(b, m) for b, m in map(_of_body, measurements) if isinstance(m, k)] for k in (Attitudes, Rates)
    )
    for body, attitude in attitudes:
        for other, rate in rates:
            if body == other:
                _check(attitude, rate, values)


def _of_body(measurement: Measurement) -> tuple[int | None, Measurement]:
    return (measurement.body, measurement.measurement) if isinstance(measurement, OfBody) else (None, measurement)


def _check(attitudes: Any, rates: Any, values: Any) -> None:
    if any(m.clock is not None and m.clock.rule is not None for m in (attitudes, rates)):
        return
    rows, gaps, measured = _pairs(attitudes, rates, values)
    if len(rows) < _FEWEST:
        return
    fitted = rates.bias is not None and rates.bias.rule is not None
    size = _typical(_changes(measured) if fitted else measured)

    def disagreement(quaternions: np.ndarray) -> float:
        turned = Rotation.from_quat(quaternions, scalar_first=True)
        off = (turned[rows].inv() * turned[rows + 1]).as_rotvec() / gaps[:, None] - measured
        return _typical(_changes(off) if fitted else off) / size if size > 0 else 0.0

    quaternions = np.asarray(attitudes.values, np.float64)
    given = disagreement(quaternions)
    others = {name: disagreement(read(quaternions)) for name, (read, _) in _READINGS.items()}
    best = min(others, key=lambda name: others[name])
    if others[best] < _AGREES and given > max(_DIFFERS, _BETTER * others[best]):
        raise ValueError(
            f"Attitudes must be quaternions (w, x, y, z) from body to space; by the Rates, these are {best}: their own "
            f"rates differ from the Rates by {given:.0%}, and by {others[best]:.0%} in that reading. Pass "
            f"{_READINGS[best][1]}."
        )


def _pairs(attitudes: Any, rates: Any, values: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of neighbouring rows of attitudes: the first row, the time between them, and the measured rate.

    The rate is interpolated to the middle of the pair. The body turns little within each pair, and between the two rows
    of rates around it.
    """
    times = np.asarray(attitudes.times_of_model(values), np.float64)
    rows = np.flatnonzero(np.asarray(attitudes.present[:, 0]))
    rows = rows[:-1][np.diff(rows) == 1]
    complete = np.all(np.asarray(rates.present), axis=1)
    seen, first = np.unique(np.asarray(rates.times_of_model(values), np.float64)[complete], return_index=True)
    measured = np.asarray(rates.values, np.float64)[complete][first]
    if rates.bias is not None and rates.bias.rule is None:
        measured = measured - np.asarray(rates.bias(values))
    gaps, middles = times[rows + 1] - times[rows], (times[rows + 1] + times[rows]) / 2
    after = np.searchsorted(seen, middles)
    inside = (gaps > 0) & (after > 0) & (after < len(seen))
    rows, gaps, middles, after = rows[inside], gaps[inside], middles[inside], after[inside]
    speeds = np.linalg.norm(measured, axis=1)
    fastest = np.maximum(speeds[after], speeds[after - 1])
    slow = fastest * np.maximum(gaps, seen[after] - seen[after - 1]) < _ANGLE
    between = np.stack([np.interp(middles, seen, x) for x in measured.T], axis=1)
    return rows[slow], gaps[slow], between[slow]


def _typical(vectors: np.ndarray) -> float:
    """The median length, in which outliers do not count."""
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def _changes(vectors: np.ndarray) -> np.ndarray:
    """The vectors relative to their median: without a bias."""
    return vectors - np.median(vectors, axis=0)
