"""The search for all minima: many starts over ranges of the parameters, most of them given up early.

A motion of many rotations has a minimum for every miscounted rotation. The search therefore fits a short span of time
first, then twice the span, and so on to all measurements. All starts take a few steps; the better ones take more, and
copies of the same minimum are removed after each stage. Derivatives are differences, which compile and run faster;
`fit` then converges the best minimum with exact ones.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Int

from .._checks.arguments import progress_line
from .._xla.compiler import exact_jit
from .measurements import Measurement
from .parameters import Layout
from .problem import Data, Problem
from .solve import begin, look, within

_BATCH = {"cpu": 64}  # starts in one call; 1024 on other devices
_GLANCES, _LOOKS, _LAST_LOOKS = 12, 20, 60  # steps of all starts, of the better ones, and of the last stage
_KEPT, _LEAST = 4, 64  # a stage keeps one of so many starts, but at least this many
_DISTINCT = 0.01  # in a number of `Parameter.compared`


class Minimum(NamedTuple):
    """One of the minima that a search found.

    Attributes:
        chi_squared: the sum of squares of the residuals over sigma, as the loss counts them.
        values: of the parameters, of the structure of the guess.
        starts: how many of the starts led to it; if one or two, other minima may have been missed.

    Examples:
        >>> model = lambda values: (ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState([0.0, 0.0, 1.0]))
        >>> wave = lambda t, state, body, values: jnp.sin(values["frequency"] * t)  # of no body
        >>> times = np.linspace(0.0, 20.0, 60)
        >>> seen = ml.fitting.Observed(times, np.sin(2 * times), sigma=0.1, function=wave)
        >>> guess = {"frequency": ml.fitting.Positive(1.7)}
        >>> found = ml.fit(model, guess, seen, method="free_motion", starts=50, ranges={"frequency": 0.3})
        >>> found.values["frequency"].round(6).item(), len(found.minima) > 1
        (2.0, True)
    """

    chi_squared: float
    values: Any
    starts: int


def minima_of(
    problem: Problem,
    layout: Layout,
    measurements: tuple[Measurement, ...],
    values: Any,
    first_span: float | None,
    progress: bool | Callable[[int], Any] | None,
) -> list[Minimum]:
    """All minima that differ by over `_DISTINCT`, in ascending order, from starting values with a leading axis."""
    problem = replace(problem.single(), differences=True)
    windows = _windows(measurements, first_span)
    reached = [1] * len(jax.tree.leaves(values)[0])
    losses = np.full(len(reached), np.inf)
    for k, window in enumerate(windows):
        part = within(measurements, *window)
        last = k + 1 == len(windows)
        for looks in [_GLANCES] * (k == 0) + [_LAST_LOOKS if last else _LOOKS]:
            values, losses = _improved(problem, layout.guess, part, values, looks, progress)
            order, reached = _distinct(layout, values, losses, reached)
            order = order[: max(_LEAST, len(losses) // _KEPT)]
            values, losses = jax.tree.map(lambda x, o=order: x[o], values), losses[order]
            if not len(order):
                return []
    return [
        Minimum(float(loss), jax.tree.map(lambda x, i=i: x[i], values), reached[i]) for i, loss in enumerate(losses)
    ]


def _windows(measurements: Sequence[Measurement], first_span: float | None) -> list[tuple[float, float]]:
    """The spans of time to fit, each twice the last about the same centre; the first holds the most values."""
    times = np.sort(np.concatenate([np.asarray(m.times, np.float64) for m in measurements]))
    if first_span is None:
        return [(-math.inf, math.inf)]
    inside = np.searchsorted(times, times + first_span, side="right") - np.arange(len(times))
    begin = int(np.argmax(inside))
    centre = (times[begin] + times[begin + inside[begin] - 1]) / 2
    found: list[tuple[float, float]] = []
    half, whole = first_span / 2, max(centre - times[0], times[-1] - centre)
    while half < whole:
        found.append((centre - half, centre + half))
        half *= 2
    return [*found, (-math.inf, math.inf)]


def _improved(
    problem: Problem, guess: Any, measurements: Any, values: Any, looks: int, progress: Any
) -> tuple[Any, np.ndarray]:
    """The values (s, ...) after so many steps, and their losses (s,), infinite where a run failed."""
    count, size = len(jax.tree.leaves(values)[0]), _BATCH.get(jax.default_backend(), 1024)
    found, show = list[Any](), progress_line(progress)
    for first in range(0, count, size):
        chosen = np.minimum(np.arange(first, first + size), count - 1)  # always as many, for one program
        batch = jax.tree.map(lambda x, c=chosen: jnp.asarray(x[c]), values)
        found.append(jax.tree.map(np.asarray, _steps(problem, guess, measurements, batch, jnp.asarray(looks))))
        if callable(progress):
            progress(1)
        best = min(float(np.min(losses)) for _, losses in found)
        show(f"fit: {min(first + size, count)} of {count} starts, chi-squared {best:.6g}")
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *found)


@exact_jit
def _steps(problem: Problem, guess: Any, measurements: Any, values: Any, looks: Int[Array, ""]) -> tuple[Any, Array]:
    def one(start: Any) -> tuple[Any, Array]:
        layout = Layout(guess).placed(start)
        data = Data(layout, measurements)
        search = begin(problem, data, layout.start())
        search = jax.lax.fori_loop(0, looks, lambda _, search: look(search, data, problem), search)
        good = search.good & jnp.isfinite(search.loss) & (search.steps > 0)
        return layout.values(search.vector), jnp.where(good, 2 * search.loss, jnp.inf)

    return jax.vmap(one)(values)


def _distinct(layout: Layout, values: Any, losses: np.ndarray, reached: Sequence[int]) -> tuple[np.ndarray, list[int]]:
    """The indices of distinct values with finite losses, the smallest loss first, and how many starts led to each."""
    leaves = [np.asarray(x) for x in jax.tree.leaves(values)]
    compared = np.concatenate(
        [np.stack([np.ravel(p.compared(x)) for x in leaf]) for p, leaf in zip(layout.parameters, leaves, strict=True)],
        axis=1,
    )
    found: list[int] = []
    counts: list[int] = []
    for i in (int(i) for i in np.argsort(losses) if np.isfinite(losses[i])):
        apart = np.max(np.abs(compared[found] - compared[i]), axis=1) if found else np.array([np.inf])
        if np.min(apart) > _DISTINCT:
            found.append(i)
            counts.append(reached[i])
        else:
            counts[int(np.argmin(apart))] += reached[i]
    return np.asarray(found, int), counts


def starts_over(layout: Layout, ranges: Mapping[str, Any], count: int, seed: int) -> Any:
    """Values (count, ...) of the parameters, drawn from the named ranges; all others stay at the guess."""
    rng = np.random.default_rng(seed)
    names = [name for name, _ in layout.named()]
    if unknown := [name for name in ranges if name not in names]:
        raise ValueError(f"ranges must name parameters of the guess ({', '.join(names)}), got {unknown[0]!r}.")
    drawn = [
        parameter.draw(name, rng, count, ranges[name])
        if name in ranges
        else np.broadcast_to(np.asarray(parameter.initial), (count, *parameter.initial.shape))
        for name, parameter in layout.named()
    ]
    dtype = layout.start().dtype
    return jax.tree.unflatten(layout.structure, [np.asarray(x, dtype) for x in drawn])
