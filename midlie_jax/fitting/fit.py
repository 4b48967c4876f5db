"""`fit`: parameters of a rigid body from measurements, by nonlinear least squares through the integrator."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..methods.base import Method
from .aliases import aliases_of
from .failure import UndeterminedError, message_of
from .identifiability import complaint, confounded
from .layout import Layout
from .measurements import Measurement
from .prepare import as_list, prepare
from .report import Fit
from .residuals import Data, Model
from .result import Result
from .run import solved
from .solve import Plan


def fit(
    model: Model,
    guess: Any,
    measurements: Measurement | Sequence[Measurement],
    *,
    dt: float,
    method: Method | str = "JACOBI[EA]",
    t0: float = 0.0,
    starts: int = 1,
    spread: float = 0.1,
    seed: int = 0,
    segments: int = 1,
    continuity: float = 1e3,
    first_span: float | None = None,
    absolute_sigma: bool = False,
    solver: Any = None,
    max_steps: int = 200,
    require_rank: bool = True,
    progress: bool | Callable[[int], Any] | None = None,
) -> Fit:
    """Fits the parameters of a rigid body to measurements, by default with Levenberg and Marquardt's method.

    The sum of the squares of all residuals over their sigmas is minimised. The Jacobian is computed in forward mode
    through `midlie_jax.integrate`. The first call compiles; pass the same `model` function again to reuse what was
    compiled.

    Args:
        model: model(values) -> (body, torque, start), where `values` has the structure of `guess` with arrays in place
            of the parameters. It must be pure and made of JAX operations.
        guess: a pytree, such as a dict, whose leaves are parameters from `midlie_jax.fitting`.
        measurements: one or several.
        dt: the step, as for `midlie_jax.integrate`; the error of the run must be below that of the measurements.
        method: the method of the run.
        t0: the time of `start`, not after the first measurement.
        starts: the number of starts. The first is the guess, the others are drawn around it; the best of all fits
            counts.
        spread: standard deviation of the drawn starts: relative, or for quaternions in radians.
        seed: seed of the drawn starts.
        segments: with more than one, multiple shooting: the time is cut into this many segments, each with a start of
            its own, taken from the nearest measured rate and attitude if there are any. Multiple shooting converges
            from guesses whose run departs from the data, as for chaotic motion or near the separatrix. A last fit
            without segments makes the estimate the same as with one segment.
        continuity: the weight of jumps between segments. A relative jump of the momentum, or a jump of the attitude in
            radians, of size 1 / `continuity` counts as much as a residual of one sigma.
        first_span: a length of time after t0. If given, the measurements of this span are fitted first, then those of
            twice the span, and so on to all of them, each fit starting from the result of the previous one. Like
            `segments`, but without further unknowns, this converges from guesses whose run departs from the data only
            later; the program is compiled once. The span should hold more measured numbers than there are unknowns.
        absolute_sigma: True if the sigmas are known. Otherwise they are known up to a common factor, which is estimated
            from the residuals, and intervals use Student's t.
        solver: an optimistix solver or minimiser in place of `optimistix.LevenbergMarquardt`, for example
            `optimistix.OptaxMinimiser(optax.adam(0.1), rtol=1e-6, atol=1e-6)`.
        max_steps: the largest number of steps of the optimiser from each start.
        require_rank: if False, data that do not determine all parameters give a result with `ok` False, and no error.
        progress: whether to show a line on stderr; by default only if stderr is a terminal. Or a function that is
            called with 1 after each step of the search.

    Returns:
        The result; print it for a table. `ok` is False if a run failed, the optimiser did not converge, or the
        residuals cannot be noise: with `absolute_sigma` by a chi-squared test of the sigmas, otherwise because they are
        not small relative to what was measured.

    Raises:
        ValueError: an argument is invalid, there are too few measurements, the rates are in another unit than the guess
            of a free body, or the attitudes follow another convention by the rates of the same body; these are raised
            before anything is traced.
        UndeterminedError: a ValueError. The fit converged and its residuals can be noise, but the measurements do not
            determine all parameters. The message names those that cannot be told apart; `result` of the error is what
            was found.

    Examples:
        >>> def model(values):  # values of the parameters -> body, torque, start
        ...     damping = ml.torques.Damping(values["damping"])
        ...     return ml.RigidBody([2.0, 2.0, 2.0]), damping, ml.MomentumState([1.0, 0.6, 0.4])
        >>> times = np.arange(0.0, 5.0)
        >>> rates = np.exp(-0.15 * times)[:, None] * np.array([0.5, 0.3, 0.2])  # (5, 3), as measured
        >>> guess = {"damping": ml.fitting.Positive(0.2)}
        >>> result = ml.fit(model, guess, ml.fitting.Rates(times, rates, sigma=1e-3), method="RK4", dt=0.5)
        >>> result.ok, round(float(result.values["damping"]), 4)  # 2 * 0.15
        (True, 0.3)
    """
    plan = prepare(
        model,
        guess,
        measurements,
        dt=dt,
        method=method,
        t0=t0,
        starts=starts,
        spread=spread,
        seed=seed,
        segments=segments,
        continuity=continuity,
        absolute_sigma=absolute_sigma,
        solver=solver,
        max_steps=max_steps,
    )
    data = Data(Layout(guess), tuple(as_list(measurements)))
    estimate = solved(plan, data, progress, _ends(first_span, plan, data))
    layout = data.layout
    groups = confounded(estimate.spectrum, layout.unconstrained_names(), layout.typical())
    message = message_of(plan, data, estimate, complaint(groups, layout.named()))
    found = Fit(
        estimate, layout, data.measurements, groups, message, aliases_of(model, data.measurements, estimate.values)
    )
    if groups and require_rank and found.result is Result.UNDETERMINED:
        raise UndeterminedError(found)
    return found


def _ends(first: Any, plan: Plan, data: Data) -> list[float]:
    """The ends of the time spans that are fitted before the fit of all measurements."""
    if first is None:
        return []
    if not (isinstance(first, (int, float)) and math.isfinite(first) and first > 0):
        raise ValueError(f"first_span must be a positive finite number, got {first!r}.")
    if plan.solver is not None:
        raise ValueError("first_span needs the default solver; leave out `solver`, or give segments instead.")
    t0 = plan.problem.grid.t0
    span = max(float(np.max(m.times)) for m in data.measurements) - t0
    count = max(0, math.ceil(math.log2(span / first))) if span > first else 0
    return [t0 + first * 2**k for k in range(count)]
