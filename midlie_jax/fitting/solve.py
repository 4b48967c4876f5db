"""The search for the least sum of squares: the Levenberg-Marquardt method, one step as a pure function.

A run of a body and its derivative take seconds to compile, so the step holds their only copy, and computes the Jacobian
with the residuals. `solved` calls the compiled step from Python, where it can be stopped and show progress;
`fit_arrays` calls it in a loop, in one pure function. Hard problems are solved in stages, each from the last result.

The trust region follows N. I. M. Gould, D. Orban, A. Sartenaer, Ph. L. Toint, 4OR 3 (2005) 227.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri, stdtrit  # SciPy is a dependency of JAX

from .._checks.arguments import described, progress_line
from .._xla.compiler import exact_jit
from .estimate import CONFIDENCE, Estimate, Result, Spectrum, lengths_of
from .instruments import of_which
from .loss import Loss
from .measurements import Measurement
from .noise import explained, remainders_of, within_sigmas
from .parameters import Layout
from .problem import Data, Problem, jacobian_of, residuals

# solver(residuals, start, max_steps) -> (optimum, steps, converged)
Solver = Callable[[Callable[[Array], Array], Array, int], tuple[Array, Any, Any]]
_TOLERANCE = {"float64": 1e-8, "float32": 1e-3}
_GOOD, _POOR = 0.99, 0.01  # a step is judged by the decrease of the loss over the linear prediction
_WIDER, _NARROWER = 3.5, 0.25


class Plan(eqx.Module):
    """A problem and its solver: the result of `prepare` and the argument of `fit_arrays`.

    Attributes:
        problem: the problem, with the segments of multiple shooting if there are any.
        starts: (s, p), increments of the unconstrained numbers of the guess, one row per initial guess.
        solver, max_steps, absolute_sigma: as for `fit`.

    Examples:
        >>> model = lambda values: (ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"]))
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, gyroscope, method="RK4", dt=0.5, starts=4)
        >>> plan.starts.shape, plan.max_steps
        ((4, 3), 200)
    """

    problem: Problem
    solver: Solver | None
    starts: Float[Array, "s p"]
    max_steps: int = eqx.field(static=True)
    absolute_sigma: bool = eqx.field(static=True)


class Search(eqx.Module):
    """The state of a search for the least sum of squares; leading axes, if any, belong to several initial guesses.

    The unknowns are `start + place / lengths`: at the initial guess, a change of an entry of `place` by 1 changes the
    vector of residuals by a length of one standard deviation. Tolerances and damping are therefore independent of units
    and of the number of data. A damping weaker than the diagonal of J^T J would lead to more distant minima.
    """

    start: Float[Array, "*s u"]
    lengths: Float[Array, "*s u"]  # the scale
    place: Float[Array, "*s u"]  # the best one so far
    residuals: Float[Array, "*s r"]  # at the best place
    triangle: Float[Array, "*s u u"]  # the triangular factor R of the scaled Jacobian there, J = Q R
    turned: Float[Array, "*s u"]  # Q^T times the residuals
    good: Bool[Array, "*s"]  # whether every step of the run there was good
    trial: Float[Array, "*s u"]  # the place of the next evaluation of the residuals
    promised: Float[Array, "*s"]  # the change of the loss at the trial by the linear model; negative
    size: Float[Array, "*s"]  # one over the damping
    relative: float = eqx.field(static=True)  # changes that count as none, relative to a number
    absolute: Float[Array, "*s"]  # and in absolute terms
    steps: Int[Array, "*s"]  # number of evaluations of the residuals
    converged: Bool[Array, "*s"]
    finished: Bool[Array, "*s"]  # it converged, or the initial run is not finite

    @property
    def vector(self) -> Float[Array, "*s u"]:
        """The unknowns at the best place."""
        return self.start + self.place / self.lengths

    @property
    def loss(self) -> Float[Array, "*s"]:
        """Half the sum of squares."""
        return jnp.sum(self.residuals**2, axis=-1) / 2


def begin(problem: Problem, data: Data, start: Float[Array, " u"]) -> Search:
    """The search of a stage before any evaluation."""
    count = sum(m.present.size for m in data.measurements) + start.size - data.layout.size
    dtype, zeros = start.dtype, jnp.zeros_like(start)
    zero, no, least = jnp.zeros((), dtype), jnp.zeros((), bool), _TOLERANCE[dtype.name]
    # A change below the rounding error of a run counts as none. Otherwise the search would never end if sigmas are
    # small relative to the rounding of the measured values.
    noise = problem.grid.rounding
    sizes = [jnp.max(jnp.abs(m.values)) / jnp.min(m.sigma) for m in data.measurements]
    rounded = jnp.max(jnp.stack([noise * jnp.finfo(size.dtype).eps * size for size in sizes]))
    return Search(
        start, zeros + 1, zeros, jnp.zeros(count, dtype), jnp.zeros((start.size, start.size), dtype), zeros, no,
        zeros, zero, zero + 1, least, jnp.maximum(rounded, least).astype(dtype), jnp.zeros((), jnp.int32), no, no,
    )  # fmt: skip


def look(search: Search, data: Data, problem: Problem) -> Search:
    """The search after an evaluation of the residuals at its trial; unchanged if it was finished."""
    first = search.steps == 0
    trial = search.start + search.trial / search.lengths
    found, good, jacobian = jacobian_of(trial, data, problem)
    lengths = jnp.where(first, lengths_of(jacobian), search.lengths)
    change = jnp.sum(found**2) / 2 - search.loss
    finite = jnp.all(jnp.isfinite(found)) & jnp.all(jnp.isfinite(jacobian))
    accepted = finite & (first | (change <= _POOR * search.promised))

    factor = jnp.linalg.qr(jnp.concatenate([jacobian / lengths[None], found[:, None]], axis=1), mode="r")
    count = trial.size
    # If the start is not finite, neither is its loss: it must not count as a perfect fit among several starts.
    residuals = jnp.where(accepted | first, found, search.residuals)
    triangle = jnp.where(accepted, factor[:count, :count], search.triangle)
    turned = jnp.where(accepted, factor[:count, count], search.turned)
    place = jnp.where(accepted, search.trial, search.place)
    one = jnp.ones_like(search.size)
    wider = jnp.where((change < _GOOD * search.promised) & ~first, _WIDER * one, one)
    size = search.size * jnp.where(accepted, wider, _NARROWER * one)

    step = _damped(triangle, turned, size)
    ahead = triangle @ step + turned
    promised = jnp.sum(ahead**2) / 2 - jnp.sum(turned**2) / 2

    settled = accepted & ~first & _small(search.trial - search.place, search.trial, search)
    settled = settled & _small(found - search.residuals, found, search)
    # A further step could gain less than the rounding of the sum of squares.
    hidden = ~accepted & ~first & (jnp.abs(search.promised) <= 8 * jnp.finfo(trial.dtype).eps * search.loss)
    converged = settled | hidden
    after = Search(
        search.start, lengths, place, residuals, triangle, turned, jnp.where(accepted, good, search.good),
        place + step, promised, size, search.relative, search.absolute, search.steps + 1, converged,
        converged | (first & ~finite),
    )  # fmt: skip
    return jax.tree.map(lambda old, new: jnp.where(search.finished, old, new), search, after)


def _damped(triangle: Float[Array, "u u"], turned: Float[Array, " u"], size: Float[Array, ""]) -> Float[Array, " u"]:
    """The step d that minimises |R d + q|^2 + |d|^2 / size."""
    count = turned.size
    damping = jnp.eye(count, dtype=turned.dtype) / jnp.sqrt(size)
    stacked = jnp.concatenate(
        [jnp.concatenate([triangle, turned[:, None]], axis=1), jnp.pad(damping, ((0, 0), (0, 1)))], axis=0
    )
    factor = jnp.linalg.qr(stacked, mode="r")
    return -jax.scipy.linalg.solve_triangular(factor[:count, :count], factor[:count, count])


def _small(change: Array, value: Array, search: Search) -> Bool[Array, ""]:
    """Whether the change of every entry counts as none."""
    return jnp.all(jnp.abs(change) < search.absolute + search.relative * jnp.abs(value))


def _stages(plan: Plan, data: Data, ends: Sequence[float] = ()) -> list[tuple[Problem, Data]]:
    """The stages: multiple shooting with several segments, then the values up to each of the `ends`, then all."""

    def until(end: float) -> Data:
        return replace(data, measurements=within(data.measurements, -math.inf, end))

    single = plan.problem.single()
    shooting = [(plan.problem, data)] if plan.problem.grid.segments > 1 else []
    return [*shooting, *((single, until(end)) for end in ends), (single, data)]


def within(measurements: tuple[Measurement, ...], begin: float, end: float) -> tuple[Measurement, ...]:
    """The measurements with only the values from one time to another."""
    inside = [(np.asarray(m.times) >= begin) & (np.asarray(m.times) <= end) for m in measurements]
    present = [
        jnp.asarray(np.asarray(m.present) & x.reshape(-1, *[1] * (m.present.ndim - 1)))
        for m, x in zip(measurements, inside, strict=True)
    ]
    return eqx.tree_at(lambda ms: [of_which(m)[1].present for m in ms], measurements, present)


def _entered(problem: Problem, data: Data, vector: Float[Array, " p"]) -> tuple[Data, Float[Array, " u"]]:
    """The data of a stage, with the anchors of multiple shooting, and its unknowns for a vector of the parameters."""
    if problem.grid.segments == 1:
        return data, vector
    anchored = problem.anchored(data, vector)
    assert anchored.anchors is not None
    increments = jnp.zeros(anchored.anchors.minus(anchored.anchors).size, vector.dtype)
    return anchored, jnp.concatenate([vector, increments])


def _starts(plan: Plan, data: Data) -> Float[Array, "s p"]:
    start = data.layout.start()
    return start[None] + plan.starts.astype(start.dtype)


def _over_starts(several: bool, function: Any) -> Any:
    """A function of one initial guess, mapped over all; a single one is not mapped, which compiles faster."""
    if several:
        return jax.vmap(function)
    return lambda *rows: jax.tree.map(lambda x: x[None], function(*jax.tree.map(lambda x: x[0], rows)))


def fit_arrays(plan: Plan, guess: Any, measurements: Measurement | Sequence[Measurement]) -> Estimate:
    """Fits one data set, without exceptions (check `ok`); compile it with `jax.jit`, map over data sets by `jax.vmap`.

    The plan is from `prepare`, for data of the same shapes. The times of the measurements may differ, but must not lie
    after the last time given to `prepare`, and must lie on the grid if those did.

    Examples:
        >>> model = lambda values: (ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"]))
        >>> times, rates = np.arange(5.0), np.tile([0.5, 0.3, 0.2], (20, 5, 1))  # of 20 data sets
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, ml.fitting.Rates(times, rates[0], 1e-3), method="RK4", dt=0.5)
        >>> one = lambda seen: ml.fitting.fit_arrays(plan, guess, ml.fitting.Rates(times, seen, 1e-3))
        >>> many = jax.jit(jax.vmap(one))(rates)
        >>> many.values["momentum"].shape, bool(many.ok.all())
        ((20, 3), True)
    """
    listed = (measurements,) if isinstance(measurements, Measurement) else tuple(measurements)
    data = Data(Layout(guess), listed)

    def optimum(vector: Float[Array, " p"]) -> Search:
        taken: Any = 0
        found: Any = None
        for problem, part in _stages(plan, data):
            found = _minimised(plan, problem, *_entered(problem, part, vector))
            vector, taken = found.vector[: vector.size], taken + found.steps
        return replace(found, steps=taken)

    found = _over_starts(plan.starts.shape[0] > 1, optimum)(_starts(plan, data))
    return _best(plan.absolute_sigma, plan.problem.loss, data, found)


def _minimised(plan: Plan, problem: Problem, data: Data, start: Float[Array, " u"]) -> Search:
    if plan.solver is not None:
        return _by_solver(plan.solver, plan.max_steps, problem, data, start)
    return jax.lax.while_loop(
        lambda search: ~search.finished & (search.steps < plan.max_steps),
        lambda search: look(search, data, problem),
        begin(problem, data, start),
    )


def _by_solver(solver: Solver, max_steps: int, problem: Problem, data: Data, start: Float[Array, " u"]) -> Search:
    """By a custom solver, which uses the unknowns in the scale of `Search` and JAX's default dtype."""
    lengths = lengths_of(jacobian_of(start, data, problem)[2])

    def scaled(z: Array) -> Array:
        return residuals(start + z.astype(start.dtype) / lengths, data, problem).astype(z.dtype)

    found: Any = solver(scaled, jnp.zeros(start.size), max_steps)
    shapes = tuple(jnp.shape(part) for part in found) if isinstance(found, tuple | list) else ()
    if shapes != (start.shape, (), ()):
        got = f"shapes {', '.join(map(str, shapes))}" if shapes else described(found)
        raise ValueError(
            f"solver must return (optimum, steps, converged) of shapes {start.shape}, () and (), got {got}; return the "
            "optimum in the shape of start."
        )
    optimum, steps, converged = map(jnp.asarray, found)
    vector = start + optimum.astype(start.dtype) / lengths
    search = look(begin(problem, data, vector), data, problem)
    converged = converged.astype(bool) & jnp.all(jnp.isfinite(vector))
    return replace(search, steps=steps.astype(jnp.int32), converged=converged)


def _best(absolute_sigma: bool, loss: Loss | None, data: Data, found: Search) -> Estimate:
    """The estimate from the best of the searches (s, ...); of one that failed only if there is no other."""
    losses = jnp.where(jnp.isnan(found.loss), jnp.full_like(found.loss, jnp.inf), found.loss)
    first = jnp.lexsort((losses, ~found.good, ~(found.converged & found.good)))[0]
    best: Search = jax.tree.map(lambda x: x[first], found)
    jacobian, vector = best.triangle * best.lengths[None], best.vector
    spectrum = Spectrum.of(jacobian)
    raw = best.residuals if loss is None else loss.residuals(best.residuals)
    judged = raw if loss is None else loss.judged(raw)
    present = jnp.concatenate([m.present.reshape(-1) for m in data.measurements])
    count, squares = jnp.sum(present), jnp.sum(judged**2)
    dof = count - vector.size - sum(m.linear for m in data.measurements)
    one = jnp.ones_like(squares)
    enough = jnp.maximum(dof, 1).astype(one.dtype)
    unconstrained = (one if absolute_sigma else squares / enough) * spectrum.covariance()
    slopes = jax.jacfwd(data.layout.coordinates)(vector)
    covariance = slopes @ unconstrained @ slopes.T
    unknown = spectrum.undetermined(slopes)
    covariance = jnp.where(unknown[:, None] | unknown[None, :], jnp.full_like(covariance, jnp.inf), covariance)
    good = best.good & jnp.all(jnp.isfinite(judged))
    values = data.layout.values(vector)
    if absolute_sigma:
        fits, quantile = within_sigmas(squares, enough), one * ndtri(0.5 + CONFIDENCE / 2)
    else:
        fits = explained(remainders_of(data.measurements, judged, values))
        # Student's t, from a table of all possible degrees of freedom.
        table = np.concatenate([[np.inf], stdtrit(np.arange(1, judged.size + 1), 0.5 + CONFIDENCE / 2)])
        quantile = jnp.asarray(table, one.dtype)[jnp.clip(dof, 0, judged.size)]
    result = jnp.zeros((), jnp.int32)  # of the first condition from below that is False
    for ended, holds in (
        (Result.UNDETERMINED, jnp.all(spectrum.determined) & (dof >= 1)),
        (Result.MISFIT, fits),
        (Result.NOT_CONVERGED, best.converged),
        (Result.RUN_FAILED, good),
    ):
        result = jnp.where(holds, result, ended.code)
    coordinates = data.layout.coordinates(vector)
    half = quantile * jnp.sqrt(jnp.diagonal(covariance))
    intervals = jnp.stack([coordinates - half, coordinates + half], axis=-1)
    rms = jnp.sqrt(squares / count.astype(one.dtype))
    return Estimate(
        vector, values, coordinates, covariance, intervals, raw, rms, dof, quantile, unconstrained, spectrum,
        best.steps, best.converged & good, result, result == 0,
    )  # fmt: skip


def solved(
    plan: Plan, data: Data, progress: bool | Callable[[int], Any] | None, ends: Sequence[float] = ()
) -> Estimate:
    """The result of `fit_arrays`, computed step by step from Python; a custom solver shows no progress."""
    if plan.solver is not None:
        return jax.block_until_ready(_whole(plan, data.layout.guess, data.measurements))
    show = progress_line(progress)
    several, vectors, taken, search = plan.starts.shape[0] > 1, _starts(plan, data), np.zeros((), np.int32), None
    try:
        for problem, part in _stages(plan, data, ends):
            anchors, search = _begin(several, problem, part, vectors)
            while not np.all(search.finished) and np.max(search.steps) < plan.max_steps:
                search = _look(several, problem, part, anchors, search)
                if callable(progress):
                    progress(1)
                loss = np.nanmin(np.append(search.loss, np.inf))
                show(f"fit: step {np.max(search.steps + taken)}, loss {loss:.6g}")
            vectors, taken = search.vector[:, : data.layout.size], taken + search.steps
        assert search is not None
        return jax.block_until_ready(
            _estimate(plan.absolute_sigma, plan.problem.loss, data, replace(search, steps=taken))
        )
    finally:
        show("")


# The programs get only the parts of the plan that they need, because a change of any other part would compile them
# again.
_whole = exact_jit(fit_arrays)
_estimate = exact_jit(_best)


@exact_jit
def _begin(several: bool, problem: Problem, data: Data, vectors: Array) -> tuple[Any, Search]:
    def one(vector: Array) -> tuple[Any, Search]:
        entered, start = _entered(problem, data, vector)
        return entered.anchors, begin(problem, data, start)

    return _over_starts(several, one)(vectors)


@exact_jit
def _look(several: bool, problem: Problem, data: Data, anchors: Any, search: Search) -> Search:
    def one(anchors: Any, search: Search) -> Search:
        return look(search, eqx.tree_at(lambda d: d.anchors, data, anchors, is_leaf=lambda x: x is None), problem)

    return _over_starts(several, one)(anchors, search)
