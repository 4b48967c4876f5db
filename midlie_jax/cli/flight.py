"""The free flight in a record of angular velocities, by integrals of the rates over windows.

A free body satisfies Euler's equations, Omega1' = k1 Omega2 Omega3 and so on, with three constant factors. The flight
is the part with the largest rotation in which one set of factors explains the changes of the rates in all windows of
half a radian, to 5 % of the usual speed or to 6 standard deviations of the noise. The rates are about principal axes:
the test allows 5 degrees between them and the columns, and at 10 degrees parts of a flight, or one in ten, are lost.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline  # SciPy comes with JAX
from scipy.ndimage import median_filter

FINE = 0.05  # radians between two points of an integral
MOST_POINTS = 200_000
_PER_WINDOW = 8  # windows that begin within the length of one
_GAP = 0.3  # radians: with denser rows elsewhere, a longer rotation between two rows is a gap in the record
_TURN = 0.5  # radians per window of the search
_LEFT, _NOISE = 0.05, 6.0  # unexplained changes: the share of the usual speed, and standard deviations of the noise
_SLOW = 0.2  # no flight is searched where the speed is below this share of the largest
_WHOLE = 2 * np.pi  # the least rotation in a flight, radians


class Windows(NamedTuple):
    """Windows of one length: beginning and end (m,), the change of the rates, and integrals, (m, 3).

    `products` are the integrals of Omega2 Omega3, Omega3 Omega1 and Omega1 Omega2, `linear` the integrals of the rates.
    """

    first: np.ndarray
    last: np.ndarray
    changes: np.ndarray
    products: np.ndarray
    linear: np.ndarray

    @property
    def spans(self) -> np.ndarray:
        return self.last - self.first


def windows(times: np.ndarray, rates: np.ndarray, turn: float) -> Windows:
    """Windows in which the body rotates by at most `turn` radians, without those over a gap between the rows."""
    speeds = np.linalg.norm(rates, axis=1)
    fastest, gaps = np.max(speeds), np.diff(times)
    count = int(np.clip((times[-1] - times[0]) * fastest / FINE, 4 * len(times), MOST_POINTS))
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

    Args:
        times, rates: (n,) and (n, 3), in seconds and rad/s, finite, and ascending without repetition.
    """
    noise = float(np.median(np.abs(np.diff(rates, 2, axis=0)))) / 0.6745 / np.sqrt(6)
    seen = windows(times, median_filter(rates, (3, 1), mode="nearest"), _TURN)
    speeds = np.linalg.norm(seen.linear, axis=1) / seen.spans
    turned = np.concatenate([[0.0], np.cumsum(speeds * np.diff(seen.first, append=seen.last[-1]))])
    count, best, searched = len(speeds), (0, 0), np.zeros(len(speeds), bool)

    def unexplained(fitted: slice, asked: slice) -> np.ndarray:
        """The places of the windows that contradict the factors of other windows."""
        squares = np.sum(seen.products[fitted] ** 2, axis=0)
        factors = np.sum(seen.changes[fitted] * seen.products[fitted], axis=0) / np.maximum(squares, 1e-300)
        off = np.max(np.abs(seen.changes[asked] - factors * seen.products[asked]), axis=1)
        return asked.start + np.flatnonzero(off > max(_LEFT * np.median(speeds[fitted]), _NOISE * noise))

    for seed in np.flatnonzero(speeds > _SLOW * np.max(speeds))[:: _PER_WINDOW // 2]:
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
