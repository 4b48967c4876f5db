"""`bands`: the quantiles of an ensemble against time, named in the legend of the panel."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._checks.arguments import described
from .style import BLUE, name_in_legend

_OPACITY = 0.3  # of the widest band; narrower bands are drawn on top of it


class Bands(NamedTuple):
    """The quantiles drawn by `bands`.

    Attributes:
        median: (n,).
        edges: for each level the lower and the upper quantile, each (n,).
        bodies: the number of bodies in the quantiles.
        failed: the number of bodies left out because of a number that is not finite.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> values = np.random.default_rng(0).normal(size=(1000, 50))
        >>> found = ml.plot.bands(Figure().add_subplot(), np.arange(50.0), values)
        >>> lower, upper = found.edges[0.9]
        >>> lower.shape, found.bodies, found.failed
        ((50,), 1000, 0)
    """

    median: np.ndarray
    edges: dict[float, tuple[np.ndarray, np.ndarray]]
    bodies: int
    failed: int


def bands(
    axes: Any,
    times: ArrayLike,
    values: ArrayLike,
    *,
    levels: Sequence[float] = (0.5, 0.9),
    label: str | None = None,
    colour: str | None = None,
) -> Bands:
    """Draws the median of an ensemble against time, and bands that hold given fractions of the bodies.

    The band of level p lies between the quantiles (1 - p)/2 and (1 + p)/2 at each time. A legend names the lines and
    the bands.

    Args:
        axes: matplotlib's axes.
        times: (n,), ascending, with any unit.
        values: (bodies, n). A body with a number that is not finite is left out, because its run failed.
        levels: fractions of the bodies, each above 0 and below 1.
        label: name of the ensemble in the legend, which adds the numbers of bodies; by default "median".
        colour: colour of the line and the bands, any of matplotlib's.

    Raises:
        ValueError: the shapes do not fit, the times do not ascend, a level is not between 0 and 1, or no body is left.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> times, values = np.arange(50.0), np.random.default_rng(0).normal(size=(1000, 50))
        >>> found = ml.plot.bands(Figure().add_subplot(), times, values, levels=(0.5, 0.9), label="noise")
        >>> found.median.shape
        (50,)
    """
    try:
        t, numbers = np.asarray(times, float), np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"times and values must be arrays of numbers, got {described(times)} and {described(values)}."
        ) from error
    if t.ndim != 1 or numbers.ndim != 2 or numbers.shape[1:] != t.shape or not numbers.size:
        raise ValueError(
            f"times must be (n,) and values (bodies, n), got {t.shape} and {numbers.shape}. For a vector, pass one "
            "component, such as path.states.momentum[:, :, 2]."
        )
    if not np.all(np.diff(t) > 0):
        raise ValueError("times must ascend and be finite. Sort them, and the columns of values with them.")
    if not levels or not all(0 < level < 1 for level in levels):
        raise ValueError(f"levels must be fractions above 0 and below 1, got {levels}. Write 0.9 for 90 %.")
    good = numbers[np.isfinite(numbers).all(axis=1)]
    failed = len(numbers) - len(good)
    if not len(good):
        raise ValueError(
            f"values must have a finite row, got none in {len(numbers)} rows. Draw only times before first_bad "
            "of the path."
        )
    chosen, name = colour or BLUE, label or "median"
    edges = dict[float, tuple[np.ndarray, np.ndarray]]()
    # The widest first, so that narrower bands are drawn on top of it.
    for level in sorted(map(float, levels), reverse=True):
        low, high = np.quantile(good, [(1 - level) / 2, (1 + level) / 2], axis=0)
        axes.fill_between(t, low, high, color=chosen, alpha=_OPACITY, linewidth=0, label=f"{100 * level:.4g} %")
        edges[level] = (low, high)
    median = np.median(good, axis=0)
    count = f"{len(good):,} bodies" + (f", {failed:,} failed and left out" if failed else "")
    axes.plot(t, median, color=chosen, linewidth=2.0, label=f"{name}, {count}")
    axes.margins(x=0)
    name_in_legend(axes)
    return Bands(median, edges, len(good), failed)
