"""`fit_arrays`: the whole fit as one pure function of arrays, which can be compiled and mapped over data sets."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array
from jaxtyping import Bool, Float, Int

from .estimate import Estimate, estimate_at
from .identifiability import lengths_of
from .layout import Layout
from .measurements import Measurement
from .residuals import Data, Problem, jacobian_of, residuals, unknowns
from .search import Search, look

_TOLERANCE = {"float64": 1e-8, "float32": 1e-3}


class Plan(eqx.Module):
    """A problem, and how it is solved: what `prepare` returns and `fit_arrays` takes.

    Attributes:
        problem: the problem, with the segments of multiple shooting if there are any.
        solver: an optimistix solver, or None for Levenberg-Marquardt.
        starts: (s, p), increments of the unconstrained numbers of the guess, one row for each start.
        max_steps: the most steps of the optimiser.
        absolute_sigma: see `estimate_at`.

    Examples:
        >>> def model(values):  # values of the parameters -> body, torque, start
        ...     return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"])
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, gyroscope, method="RK4", dt=0.5, starts=4)
        >>> plan.starts.shape, plan.max_steps
        ((4, 3), 200)
    """

    problem: Problem
    solver: Any
    starts: Float[Array, "s p"]
    max_steps: int = eqx.field(static=True)
    absolute_sigma: bool = eqx.field(static=True)


class Optimum(NamedTuple):
    """What the optimiser found: the vector, and the residuals and the Jacobian (or its factor R) there."""

    vector: Float[Array, "*s u"]
    residuals: Float[Array, "*s r"]
    jacobian: Float[Array, "*s n u"]
    good: Bool[Array, "*s"]
    steps: Int[Array, "*s"]
    converged: Bool[Array, "*s"]

    @classmethod
    def of(cls, search: Search) -> "Optimum":
        jacobian = search.triangle * search.lengths[..., None, :]
        return cls(search.vector, search.residuals, jacobian, search.good, search.steps, search.converged)


def fit_arrays(plan: Plan, guess: Any, measurements: Measurement | Sequence[Measurement]) -> Estimate:
    """Fits one data set; compile it with `jax.jit` and map it over data sets with `jax.vmap`. Raises nothing.

    Args:
        plan: from `prepare`, for data of the same shapes.
        guess: a pytree of parameters.
        measurements: the measurements. Times may differ from those with which `prepare` was called, but must not lie
            after the last of those, and must lie on the grid if those did.

    Returns:
        The estimate; check `ok`.

    Examples:
        >>> def model(values):  # values of the parameters -> body, torque, start
        ...     return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"])
        >>> times, rates = np.arange(5.0), np.tile([0.5, 0.3, 0.2], (20, 5, 1))  # of 20 data sets
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, ml.fitting.Rates(times, rates[0], 1e-3), method="RK4", dt=0.5)
        >>> one = lambda seen: ml.fitting.fit_arrays(plan, guess, ml.fitting.Rates(times, seen, 1e-3))
        >>> many = jax.jit(jax.vmap(one))(rates)
        >>> many.values["momentum"].shape, bool(many.ok.all())
        ((20, 3), True)
    """
    several = (measurements,) if isinstance(measurements, Measurement) else tuple(measurements)
    data = Data(Layout(guess), several)
    found = over_starts(plan.starts.shape[0] > 1, lambda vector: _optimum(plan, data, vector))(starts_of(plan, data))
    return estimate_of(plan.absolute_sigma, data, found)


def starts_of(plan: Plan, data: Data) -> Float[Array, "s p"]:
    """The unconstrained numbers of all starts."""
    start = data.layout.start()
    return start[None] + plan.starts.astype(start.dtype)


def over_starts(several: bool, function: Any) -> Any:
    """A function of one start, mapped over all starts; a single start is not mapped, which compiles faster."""
    if several:
        return jax.vmap(function)
    return lambda *rows: jax.tree.map(lambda x: x[None], function(*jax.tree.map(lambda x: x[0], rows)))


def estimate_of(absolute_sigma: bool, data: Data, found: Optimum) -> Estimate:
    """The estimate from the best of the optima (s, ...); one that did not converge counts only if no other did."""
    losses = jnp.sum(found.residuals**2, axis=-1)
    losses = jnp.where(jnp.isnan(losses), jnp.full_like(losses, jnp.inf), losses)
    best = jnp.lexsort((losses, ~found.converged))[0]
    vector, residuals, jacobian, good, steps, converged = jax.tree.map(lambda x: x[best], found)
    return estimate_at(data, vector, (residuals, good, jacobian), steps, converged, absolute_sigma)


def _optimum(plan: Plan, data: Data, vector: Float[Array, " p"]) -> Optimum:
    """The optimum near one start.

    With several segments, multiple shooting is solved first. Its parameters are the start for the problem with one
    segment, whose optimum is the maximum-likelihood estimate.
    """
    *before, last = stages(plan)
    taken: Array = jnp.zeros((), jnp.int32)
    for problem in before:
        stage, start = stage_of(problem, data, vector)
        found = _minimised(plan, problem, stage, start)
        vector, taken = found.vector[: vector.size], taken + found.steps
    found = _minimised(plan, last, data, vector)
    return found._replace(steps=found.steps + taken)


def stages(plan: Plan) -> list[Problem]:
    """The problems that are solved one after the other: with the segments, if there are several, and without."""
    single = plan.problem.single()
    return [single] if plan.problem.grid.segments == 1 else [plan.problem, single]


def stage_of(problem: Problem, data: Data, vector: Float[Array, " p"]) -> tuple[Data, Float[Array, " u"]]:
    """The data of a stage, and its unknowns at a vector of the parameters."""
    if problem.grid.segments == 1:
        return data, vector
    anchored = problem.anchored(data, vector)
    return anchored, jnp.concatenate([vector, unknowns(anchored)[vector.size :]])


def begin(problem: Problem, data: Data, start: Float[Array, " u"]) -> Search:
    """The search of a stage before its first step."""
    count = sum(m.present.size for m in data.measurements) + start.size - data.layout.size
    tolerance = _TOLERANCE[start.dtype.name]
    return Search.begin(start, count, tolerance, _rounding(problem, data, tolerance))


def _minimised(plan: Plan, problem: Problem, data: Data, start: Float[Array, " u"]) -> Optimum:
    """The minimum of the sum of squares near a start."""
    if plan.solver is not None:
        return _by_optimistix(plan, problem, data, start)

    def unfinished(search: Search) -> Array:
        return ~search.finished & (search.steps < plan.max_steps)

    search = begin(problem, data, start)
    return Optimum.of(jax.lax.while_loop(unfinished, lambda s: look(s, data, problem), search))


def _by_optimistix(plan: Plan, problem: Problem, data: Data, start: Float[Array, " u"]) -> Optimum:
    """The same minimum by a solver of optimistix, which sees the unknowns in the scale of `Search`.

    The solver works in JAX's default dtype, which optimistix uses for its own numbers; the run, in that of the data.
    """
    _, _, jacobian = jacobian_of(start, data, problem)
    lengths = lengths_of(jacobian)

    def scaled(z: Array, args: tuple[Array, Array, Data]) -> Array:
        start, lengths, data = args
        return residuals(start + z.astype(start.dtype) / lengths, data, problem)[0].astype(z.dtype)

    solution = optx.least_squares(
        scaled,
        plan.solver,
        jnp.zeros(start.size),
        (start, lengths, data),
        options={"jac": "fwd"} if isinstance(plan.solver, optx.AbstractLeastSquaresSolver) else {},
        max_steps=plan.max_steps,
        throw=False,
    )
    vector = start + solution.value.astype(start.dtype) / lengths
    converged = (solution.result == optx.RESULTS.successful) & jnp.all(jnp.isfinite(vector))
    found, good, jacobian = jacobian_of(vector, data, problem)
    return Optimum(vector, found, jacobian, good, jnp.asarray(solution.stats["num_steps"], jnp.int32), converged)


def _rounding(problem: Problem, data: Data, least: float) -> Array:
    """The change of a residual that counts as none: `least`, or the rounding error of a run if that is larger.

    Otherwise the optimiser would never end if sigmas are small relative to the rounding of the measured values.
    """
    noise = 4 * math.sqrt(problem.grid.steps * problem.grid.segments)
    sizes = [jnp.max(jnp.abs(m.values)) / jnp.min(m.sigma) for m in data.measurements]
    rounded = [noise * jnp.finfo(size.dtype).eps * size for size in sizes]
    return jnp.maximum(jnp.max(jnp.stack(rounded)), least)
