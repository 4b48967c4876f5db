"""`solved`: a fit run step by step from Python, so that it can show its progress and be interrupted."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._xla.compiler import exact_jit
from .estimate import Estimate
from .measurements import Measurement
from .residuals import Data, Problem
from .search import Search, look
from .solve import Optimum, Plan, begin, estimate_of, fit_arrays, over_starts, stage_of, stages, starts_of

_whole = exact_jit(fit_arrays)
_estimate = exact_jit(estimate_of)


def solved(
    plan: Plan, data: Data, progress: bool | Callable[[int], Any] | None, ends: Sequence[float] = ()
) -> Estimate:
    """The result of `fit_arrays`, computed step by step.

    Args:
        plan, data: the problem.
        ends: times up to which the measurements are fitted first, each fit starting from the result of the previous
            one; all use one program.
        progress: as for `fit`. With a solver of optimistix nothing is shown.
    """
    if plan.solver is not None:
        return jax.block_until_ready(_whole(plan, data.layout.guess, data.measurements))
    shown = sys.stderr.isatty() if progress is None else progress
    try:
        *before, last = stages(plan)
        vectors, taken = starts_of(plan, data), 0
        for problem in before:
            search = _searched(plan, problem, data, vectors, taken, shown)
            vectors, taken = search.vector[:, : data.layout.size], taken + search.steps
        for end in ends:
            search = _searched(plan, last, _until(data, end), vectors, taken, shown)
            vectors, taken = search.vector, taken + search.steps
        found = Optimum.of(_searched(plan, last, data, vectors, taken, shown))
        return jax.block_until_ready(_estimate(plan.absolute_sigma, data, found._replace(steps=found.steps + taken)))
    finally:
        if shown is True:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def _until(data: Data, end: float) -> Data:
    """The data without the values measured after `end`."""

    def earlier(m: Measurement) -> Any:
        late = np.asarray(m.times).reshape(-1, *[1] * (m.present.ndim - 1)) > end
        return np.asarray(m.present) & ~late

    present = [jnp.asarray(earlier(m)) for m in data.measurements]
    return eqx.tree_at(lambda d: [m.present for m in d.measurements], data, present)


def _searched(plan: Plan, problem: Problem, data: Data, vectors: jax.Array, taken: Any, shown: Any) -> Search:
    """The finished searches of one stage, from the vectors (s, p); `taken` are the steps of the previous stage."""
    several = plan.starts.shape[0] > 1
    anchors, starts = _stage(several, problem, data, vectors)
    search = _begin(several, problem, data, starts)
    while not np.all(search.finished) and np.max(search.steps) < plan.max_steps:
        search = _look(several, problem, data, anchors, search)
        if callable(shown):
            shown(1)
        elif shown:
            step, loss = np.max(search.steps + taken), np.nanmin(np.append(search.loss, np.inf))
            print(f"\r\033[Kfit: step {step}, loss {loss:.6g}", end="", file=sys.stderr, flush=True)
    return search


# The programs get only those parts of the plan that they need: for any change of another part they would be compiled
# again.


@exact_jit
def _stage(several: bool, problem: Problem, data: Data, vectors: jax.Array) -> tuple[Any, jax.Array]:
    """For each start, the anchors of multiple shooting, if there are any, and the unknowns."""

    def one(vector: jax.Array) -> tuple[Any, jax.Array]:
        stage, start = stage_of(problem, data, vector)
        return stage.anchors, start

    return over_starts(several, one)(vectors)


@exact_jit
def _begin(several: bool, problem: Problem, data: Data, starts: jax.Array) -> Search:
    return over_starts(several, lambda start: begin(problem, data, start))(starts)


@exact_jit
def _look(several: bool, problem: Problem, data: Data, anchors: Any, search: Search) -> Search:
    def one(anchors: Any, search: Search) -> Search:
        return look(search, eqx.tree_at(lambda d: d.anchors, data, anchors, is_leaf=lambda x: x is None), problem)

    return over_starts(several, one)(anchors, search)
