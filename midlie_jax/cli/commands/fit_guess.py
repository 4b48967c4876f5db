"""A guess for `midlie fit` from the measured rates alone, without a run: Euler's equations, integrated over windows.

I (Omega(t + w) - Omega(t)) = integral of (I Omega) x Omega from t to t + w, for all windows of one length w, is a small
least-squares problem in the ratios of the moments and, if requested, the bias. No motion is integrated, so the distant
minima of a fit of the whole motion do not occur.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline  # SciPy comes with JAX
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from .fit_data import Table

ORDERS = ((1.0, 2.0, 2.5), (2.5, 1.0, 2.0), (2.0, 2.5, 1.0), (2.0, 1.0, 2.5), (1.0, 2.5, 2.0), (2.5, 2.0, 1.0))
_TOTAL = 5.5  # the sum of the moments
_WINDOW = 1.0  # rotation of the body per window, radians
_FINE = 0.05  # radians between two points of an integral
_MOST_POINTS = 200_000


class Guess(NamedTuple):
    """Moments (3,) with the sum 5.5, and the bias (3,), zero unless it was requested."""

    moments: np.ndarray
    bias: np.ndarray


def guess(times: np.ndarray, rates: np.ndarray, bias: bool) -> Guess:
    """The best solution of the window equations, from starts with all six permutations of the moments.

    Args:
        times, rates: (n,) and (n, 3), seconds and rad/s; rows with a NaN are left out.
        bias: whether the bias of the rates is also estimated.
    """
    times, first = np.unique(times[np.all(np.isfinite(rates), axis=1)], return_index=True)
    rates = rates[np.all(np.isfinite(rates), axis=1)][first]
    if len(times) < 3:
        return Guess(np.array(ORDERS[0]), np.zeros(3))
    changes, products, linear, spans = _windows(times, rates)
    size = np.sqrt(np.mean(rates**2))

    def residuals(x: np.ndarray) -> np.ndarray:
        moments, b = _moments(x[:2]), (x[2:] if bias else np.zeros(3))
        # The integrals of the products of rates minus the bias.
        mixed = np.roll(linear, -1, 1) * np.roll(b, -2) + np.roll(linear, -2, 1) * np.roll(b, -1)
        without = products - mixed + spans[:, None] * np.roll(b, -1) * np.roll(b, -2)
        slopes = (np.roll(moments, -1) - np.roll(moments, -2)) / moments
        return ((changes - slopes * without) / size).ravel()

    found: list[tuple[float, np.ndarray]] = []
    for order in ORDERS:
        second = np.log(_TOTAL / 2 - np.array(order))
        start = np.concatenate([second[:2] - second[2], np.zeros(3 * bias)])
        scale = np.concatenate([np.ones(2), np.full(3 * bias, size)])
        solution = least_squares(residuals, start, x_scale=scale, loss="soft_l1", f_scale=0.1, max_nfev=200)
        found.append((solution.cost, solution.x))
    best = min(found, key=lambda one: one[0])[1]
    return Guess(_moments(np.clip(best[:2], -4, 4)), best[2:] if bias else np.zeros(3))


def turned_back(table: Table, bias: np.ndarray, vector: np.ndarray, begin: float, end: float) -> np.ndarray:
    """A space-fixed vector, (3,), in the body frame at `begin`, from its components at `end`.

    The body rotates with the measured rates between the rows, and before the first row with its rate.
    """
    known = np.all(np.isfinite(table.rates), axis=1)
    rates = table.rates[known] - bias
    count = int(np.clip((end - begin) * np.linalg.norm(rates, axis=1).max() / _FINE, 1, _MOST_POINTS))
    middles = begin + (end - begin) * (np.arange(count) + 0.5) / count
    turns = np.stack([np.interp(middles, table.times[known], rates[:, i]) for i in range(3)], axis=1)
    for turn in Rotation.from_rotvec(turns[::-1] * (end - begin) / count):
        vector = turn.apply(vector)
    return vector


def _moments(logs: np.ndarray) -> np.ndarray:
    """Moments with the sum 5.5 from log(a/c) and log(b/c), as in `midlie_jax.fitting.Moments`."""
    second = np.exp(np.append(logs, 0.0))
    second = second * (_TOTAL / 2 / second.sum())
    return second.sum() - second


def _windows(times: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """For each window: the change of the rates, the integrals of their products, their integrals, and the length."""
    fastest = np.max(np.linalg.norm(rates, axis=1))
    count = int(np.clip((times[-1] - times[0]) * fastest / _FINE, 4 * len(times), _MOST_POINTS))
    fine = np.linspace(times[0], times[-1], count)
    values = CubicSpline(times, rates)(fine)
    products = np.roll(values, -1, 1) * np.roll(values, -2, 1)
    h = fine[1] - fine[0]
    of_products, of_rates = (
        np.vstack([np.zeros(3), np.cumsum((x[1:] + x[:-1]) * h / 2, axis=0)]) for x in (products, values)
    )
    width = int(np.clip(_WINDOW / fastest / h, 1, count // 3))
    first = np.arange(0, count - width, max(1, width // 8))
    last = first + width
    changes = values[last] - values[first]
    return changes, of_products[last] - of_products[first], of_rates[last] - of_rates[first], fine[last] - fine[first]
