"""`fit_arrays`: the whole fit as one pure function of arrays, to be compiled, and mapped over data sets."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

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

_TOLERANCE = {"float64": 1e-8, "float32": 1e-3}


class Plan(eqx.Module):
    """A problem, and how it is solved: what `prepare` returns and `fit_arrays` takes.

    Attributes:
        problem: with the segments of multiple shooting.
        solver: an optimistix solver, or None for Levenberg-Marquardt.
        starts: (s, p), what is added to the unconstrained numbers of the guess, one row for each start.
        max_steps: the most steps of the optimiser.
        absolute_sigma: see `estimate_at`.
        show: called with the number and the loss of each step, or None.
    """

    problem: Problem
    solver: Any
    starts: Float[Array, "s p"]
    max_steps: int = eqx.field(static=True)
    absolute_sigma: bool = eqx.field(static=True)
    show: Callable[[Any, Any], None] | None = eqx.field(static=True)


def fit_arrays(plan: Plan, guess: Any, measurements: Measurement | Sequence[Measurement]) -> Estimate:
    """Fits one data set; compile it with `jax.jit` and map it over data sets with `jax.vmap`. Raises nothing.

    Args:
        plan: from `prepare`, for data of the same shapes.
        guess: a pytree of parameters.
        measurements: the measurements. Times may differ between data sets, but not lie after the last time, or off the
            grid if they lay on it, of those with which `prepare` was called.

    Returns:
        The estimate; check `ok`.
    """
    several = (measurements,) if isinstance(measurements, Measurement) else tuple(measurements)
    data = Data(Layout(guess), several)
    start = data.layout.start()
    if plan.starts.shape[0] == 1:
        vector, steps, ok = _best(plan, data, start + plan.starts[0].astype(start.dtype))[:3]
    else:
        one = jax.vmap(lambda offset: _best(plan, data, start + offset))
        vectors, counts, good, losses = one(plan.starts.astype(start.dtype))
        # A start that did not converge counts only if no other did.
        losses = jnp.where(jnp.isnan(losses), jnp.full_like(losses, jnp.inf), losses)
        order = jnp.lexsort((losses, ~good))
        vector, steps, ok = vectors[order[0]], counts[order[0]], good[order[0]]
    return estimate_at(_single(plan.problem), data, vector, steps, ok, plan.absolute_sigma)


def _best(plan: Plan, data: Data, vector: Float[Array, " p"]) -> tuple[Array, Array, Array, Array]:
    """From one start: the vector of the parameters, the number of steps, whether it converged, and the loss.

    With several segments the problem of multiple shooting is solved first; its parameters are the start of the problem
    with one segment, whose optimum is the estimate of maximum likelihood.
    """
    before: Array = jnp.zeros((), int)
    if plan.problem.grid.segments > 1:
        anchored = plan.problem.anchored(data, vector)
        many = jnp.concatenate([vector, unknowns(anchored)[vector.size :]])
        found, before, _, _ = _minimised(plan, plan.problem, anchored, many)
        vector = found[: vector.size]
    found, steps, ok, loss = _minimised(plan, _single(plan.problem), data, vector)
    return found, before + steps, ok, loss


def _minimised(
    plan: Plan, problem: Problem, data: Data, start: Float[Array, " u"]
) -> tuple[Float[Array, " u"], Int[Array, ""], Bool[Array, ""], Float[Array, ""]]:
    """The least sum of squares near a start.

    The unknowns are scaled such that a change by one changes the residuals by one standard deviation in all. So neither
    the units nor the number of data matter to the tolerances, nor to the damping, which starts at the diagonal of
    J^T J. A weaker damping saves steps near the optimum, and from guesses further off it ends in other minima.

    The optimiser works in JAX's default dtype, which optimistix takes for its own numbers, the run in that of the data.
    """
    _, _, jacobian = jacobian_of(start, data, problem)
    lengths = lengths_of(jacobian)

    def scaled(z: Array, args: tuple[Array, Array, Data]) -> Array:
        start, lengths, data = args
        return residuals(start + z.astype(start.dtype) / lengths, data, problem)[0].astype(z.dtype)

    solver = plan.solver
    if solver is None:
        tolerance = _TOLERANCE[start.dtype.name]
        solver = optx.LevenbergMarquardt(tolerance, _rounding(problem, data, tolerance), verbose=_shown(plan.show))
    solution = optx.least_squares(
        scaled,
        solver,
        jnp.zeros(start.size),
        (start, lengths, data),
        options={"jac": "fwd"} if isinstance(solver, optx.AbstractLeastSquaresSolver) else {},
        max_steps=plan.max_steps,
        throw=False,
    )
    found = start + solution.value.astype(start.dtype) / lengths
    loss = jnp.sum(problem.residuals(found, data)[0] ** 2)
    ok = (solution.result == optx.RESULTS.successful) & jnp.all(jnp.isfinite(found))
    return found, jnp.asarray(solution.stats["num_steps"], int), ok, loss


def _rounding(problem: Problem, data: Data, least: float) -> Any:
    """The change of a residual that counts as none: `least`, or where it is more what rounding leaves in a run.

    With sigmas that are small beside the rounding of the measured values the optimiser would otherwise never end.
    """
    noise = 4 * math.sqrt(problem.grid.steps * problem.grid.segments)
    sizes = [jnp.max(jnp.abs(m.values)) / jnp.min(m.sigma) for m in data.measurements]
    rounded = [noise * jnp.finfo(size.dtype).eps * size for size in sizes]
    return jnp.maximum(jnp.max(jnp.stack(rounded)), least).astype(float)


def _shown(show: Callable[[Any, Any], None] | None) -> Any:
    """The argument `verbose` of an optimistix solver."""
    if show is None:
        return False

    def report(**kwargs: tuple[str, Any]) -> None:
        jax.debug.callback(show, kwargs["num_steps"][1], kwargs["loss_this_step"][1])

    return report


def _single(problem: Problem) -> Problem:
    """The problem without multiple shooting."""
    return replace(problem, grid=problem.grid.whole())
