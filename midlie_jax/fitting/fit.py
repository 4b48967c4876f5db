"""`fit`: parameters of a rigid body from measurements, by nonlinear least squares through the integrator.

`prepare` checks all arguments before anything is traced. `fit` then searches for the optimum, and describes the result
in words.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count, described, require_function
from ..drivers.arguments import as_method
from ..integrators.base import Method
from .checks import checked_model
from .estimate import Result
from .instruments import of_which
from .loss import Loss, as_loss
from .measurements import Measurement, check_parts
from .parameters import Layout
from .problem import Data, Model, Problem
from .report import Fit, UndeterminedError
from .sampling import Closed, Grid, check_grid, require_positive
from .search import Minimum, minima_of, starts_over
from .solve import Plan, Solver, solved

_MOST_STEPS = 2**31 - 1  # int32 counts them


def fit(
    model: Model,
    guess: Any,
    measurements: Measurement | Sequence[Measurement],
    *,
    dt: float | None = None,
    method: Method | str = "JACOBI[EA]",
    t0: float = 0.0,
    starts: int = 1,
    ranges: Mapping[str, Any] | None = None,
    spread: float = 0.1,
    seed: int = 0,
    segments: int = 1,
    continuity: float = 1e3,
    first_span: float | None = None,
    absolute_sigma: bool = False,
    loss: Loss | str | None = None,
    solver: Solver | None = None,
    max_steps: int = 200,
    require_rank: bool = True,
    progress: bool | Callable[[int], Any] | None = None,
) -> Fit:
    """Fits the parameters of a rigid body to measurements, by default with the Levenberg-Marquardt method.

    The sum of the squares of all residuals over their sigmas is minimised. Pass the same `model` function to reuse the
    compiled program.

    Args:
        model: model(values) -> (body, torque, start), where `values` has the structure of `guess` with arrays instead
            of the parameters. It must be pure and made of JAX operations.
        guess: a pytree, such as a dict, whose leaves are parameters from `midlie_jax.fitting`.
        measurements: one or several.
        dt: the step, as for `midlie_jax.integrate`; the error of the run must be smaller than the errors of the
            measurements. Not needed for "free_motion".
        method: the method of the run; or "free_motion" for `midlie_jax.free_motion` of a body without torque.
        t0: the time of `start`, not after the first measurement (at any time for "free_motion").
        starts: the number of initial guesses. The first is the guess, the others are drawn around it; the best of all
            fits is returned.
        ranges: ranges of parameters, by name, from which all starts are drawn uniformly instead; the others start at
            the guess. A range is (low, high); or a number, which is relative to the guess, such as 0.3 for 30 %. For a
            `UnitVector` or `UnitQuaternion` a number is the largest angle from the guess in radians, for a `Periodic`
            a share of the period; these three allow "all". All starts are fitted by a few steps, the better ones by
            more. With `first_span` they begin with the span of this length that holds the most values. `Fit.minima` has
            all distinct minima: those in which a number differs by more than 1 % (of a `Free`, 1 % of the guess; 0.01
            radians for angles). The result is the best.
        spread: standard deviation of the drawn guesses: relative, or for quaternions in radians.
        seed: seed of the drawn guesses.
        segments: with more than one, multiple shooting: the time is cut into this many segments. Each has its own
            initial state, taken from the nearest measured rate and attitude if available. This converges from guesses
            whose run departs from the data, as for chaotic motion. A last fit has no segments.
        continuity: the weight of jumps between segments. A relative jump of the momentum, or a jump of the attitude in
            radians, of size 1 / `continuity` counts as much as a residual of one sigma.
        first_span: a length of time after t0. If given, the measurements of this span are fitted first, then the
            measurements of twice the span, and so on to all of them, each from the previous result. This converges from
            guesses whose run departs from the data only later. The span should hold more measured numbers than there
            are unknowns.
        absolute_sigma: True if the sigmas are known. Otherwise they are known up to a common factor, which is estimated
            from the residuals, and intervals use Student's t.
        loss: "huber" or "cauchy", or a `Loss` with another scale, against outliers, which `Fit.outliers` lists. The
            sigmas must have the right size.
        solver: a function solver(residuals, start, max_steps) -> (optimum, steps, converged) instead of the
            Levenberg-Marquardt method. It minimises the sum of the squares of residuals(x), x (u,), from x = start,
            with JAX operations; derivatives of `residuals` are computed in forward mode. Pass the same function again
            to reuse compiled code.
        max_steps: the largest number of steps of the optimiser from each initial guess.
        require_rank: if False, data that do not determine all parameters give a result with `ok` False, and no error.
        progress: whether to show a line on stderr; by default only if stderr is a terminal. Or a function that is
            called with 1 after each step of the search, but not with a `solver`.

    Returns:
        The result; print it for a table. `ok` is False if a run failed, the optimiser did not converge, or the
        residuals cannot be noise: by a chi-squared test with `absolute_sigma`, else relative to the measured values.

    Raises:
        ValueError: an argument is invalid, there are too few measurements, the rates have another unit than the guess
            of a free body, or the attitudes follow another convention according to the rates of the same body.
        UndeterminedError: the measurements do not determine all parameters. The message names those that are not
            identifiable; `result` of the error holds the fit.

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
    count = starts if ranges is None else 1
    plan = prepare(
        model, guess, measurements, dt=dt, method=method, t0=t0, starts=count, spread=spread, seed=seed,
        segments=segments, continuity=continuity, absolute_sigma=absolute_sigma, loss=loss, solver=solver,
        max_steps=max_steps,
    )  # fmt: skip
    data, minima = Data(Layout(guess), tuple(_as_list(measurements))), list[Minimum]()
    ends = _ends(first_span, plan, data)
    if ranges is not None:
        drawn = starts_over(data.layout, ranges, as_count("starts", starts), seed)
        minima = minima_of(plan.problem, data.layout, data.measurements, drawn, first_span, progress)
        if not minima:
            raise ValueError(
                f"ranges must allow a run that does not fail, got none in {starts} starts; check the model."
            )
        data, ends = replace(data, layout=data.layout.placed(minima[0].values)), []
    found = Fit(plan, data, solved(plan, data, progress, ends), minima)
    if found.confounded and require_rank and found.result is Result.UNDETERMINED:
        raise UndeterminedError(found)
    return found


def prepare(
    model: Model,
    guess: Any,
    measurements: Measurement | Sequence[Measurement],
    *,
    dt: float | None = None,
    method: Method | str = "JACOBI[EA]",
    t0: float = 0.0,
    starts: int = 1,
    spread: float = 0.1,
    seed: int = 0,
    segments: int = 1,
    continuity: float = 1e3,
    absolute_sigma: bool = False,
    loss: Loss | str | None = None,
    solver: Solver | None = None,
    max_steps: int = 200,
) -> Plan:
    """The checked plan with which `fit_arrays` solves a problem for data of the same shapes; arguments as for `fit`.

    Examples:
        >>> model = lambda values: (ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"]))
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, gyroscope, method="RK4", dt=0.5)  # for fit_arrays
        >>> plan.starts.shape  # (s, p): one start, three unconstrained numbers
        (1, 3)
    """
    listed = _as_list(measurements)
    layout = Layout.checked(guess)
    free = method == "free_motion"
    if dt is None and not free:
        raise ValueError('dt must be a positive finite number, got None; only method="free_motion" needs none.')
    method = as_method("JACOBI[EA]" if free else method)
    for name, number in (("spread", spread), ("continuity", continuity)):
        require_positive(name, number)
    if solver is not None:
        require_function("solver", solver, "residuals, start, max_steps")
    starts, segments, max_steps = (
        as_count(name, n) for name, n in (("starts", starts), ("segments", segments), ("max_steps", max_steps))
    )
    names = set(guess) if isinstance(guess, dict) else set[str]()
    for measurement in listed:
        check_parts(of_which(measurement)[1], names)
    times = np.concatenate([np.asarray(m.times) for m in listed])
    if not free:
        check_grid(times, dt, t0)
    count = sum(int(np.sum(np.asarray(m.present))) for m in listed)
    linear = sum(m.linear for m in listed)
    if count <= layout.size + linear:
        more = f" and {linear} zero points" if linear else ""
        raise ValueError(
            f"measurements must hold more numbers than the {layout.size + linear} unknowns "
            f"({', '.join(layout.unconstrained_names())}{more}), got {count}; give at least {layout.size + linear + 1}."
        )
    method, several = checked_model(model, layout, listed, method, free)
    if (several or free) and segments > 1:
        of_what = "coupled bodies" if several else '"free_motion"'
        raise ValueError(f"segments must be 1 for {of_what}, got {segments}; leave segments out.")
    grid = Closed(float(t0)) if free else _grid_of(listed, times, float(dt or 0), float(t0), segments)
    offsets = np.random.default_rng(seed).standard_normal((starts, layout.size)) * spread
    offsets[0] = 0
    problem = Problem(model, method, grid, float(continuity), as_loss(loss))
    rows = jnp.asarray(offsets * np.asarray(layout.typical()), layout.start().dtype)
    return Plan(problem, solver, rows, max_steps, absolute_sigma)


def _grid_of(listed: Sequence[Measurement], times: np.ndarray, dt: float, t0: float, segments: int) -> Grid:
    grid = Grid.of(times, dt, t0, segments, moving=any(m.clock is not None for m in listed))
    if grid.steps * segments > _MOST_STEPS:
        raise ValueError(
            f"times must be at most {_MOST_STEPS:.2g} steps after t0, got {times.max():g} after "
            f"{(times.max() - t0) / dt:.2g} steps. Give times in the unit of time of dt."
        )
    if segments > 1 and grid.steps * (segments - 1) * dt >= times.max() - t0:
        raise ValueError(f"segments must not be too many for the steps, got {segments}; give fewer, or a smaller dt.")
    return grid


def _as_list(measurements: Any) -> list[Measurement]:
    listed = [measurements] if isinstance(measurements, Measurement) else list(measurements)
    wrong = [m for m in listed if not isinstance(m, Measurement)]
    if wrong or not listed:
        raise ValueError(
            "measurements must be one or several of Rates, Attitudes, Directions, Positions, Accelerations, Observed "
            f"and OfBody, got {described(wrong[0]) if wrong else 'none'}."
        )
    return listed


def _ends(first: Any, plan: Plan, data: Data) -> list[float]:
    """The ends of the time spans that are fitted before the fit of all measurements."""
    if first is None:
        return []
    require_positive("first_span", first)
    if plan.solver is not None:
        raise ValueError("first_span must be None if a solver is given, got both; leave out `solver`.")
    t0 = plan.problem.grid.t0
    span = max(float(np.max(m.times)) for m in data.measurements) - t0
    found = list[float]()
    while first < span:
        found.append(t0 + first)
        first *= 2
    return found
