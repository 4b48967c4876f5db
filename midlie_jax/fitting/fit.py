"""`fit`: parameters of a rigid body from measurements, by nonlinear least squares through the integrator.

`prepare` checks all arguments before anything is traced. `fit` then searches for the optimum, and describes the result
in words. `fit_arrays` (in `solve`) is the same search without words, for many data sets.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count, described, require_function
from ..drivers.arguments import as_method
from ..integrators.base import Method
from .checks import checked_model
from .estimate import Result, complaint, confounded
from .instruments import of_which
from .measurements import Measurement, check_parts
from .noise import aliases_of
from .parameters import Layout
from .problem import Data, Model, Problem
from .report import Fit, UndeterminedError, message_of
from .sampling import Grid, check_grid
from .solve import Plan, Solver, solved

_MOST_STEPS = 2**31 - 1  # int32 counts them


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
    solver: Solver | None = None,
    max_steps: int = 200,
    require_rank: bool = True,
    progress: bool | Callable[[int], Any] | None = None,
) -> Fit:
    """Fits the parameters of a rigid body to measurements, by default with the Levenberg-Marquardt method.

    The sum of the squares of all residuals over their sigmas is minimised. The Jacobian is computed in forward mode
    through `midlie_jax.integrate`. The first call compiles; pass the same `model` function to reuse the compiled
    program.

    Args:
        model: model(values) -> (body, torque, start), where `values` has the structure of `guess` with arrays instead
            of the parameters. It must be pure and made of JAX operations.
        guess: a pytree, such as a dict, whose leaves are parameters from `midlie_jax.fitting`.
        measurements: one or several.
        dt: the step, as for `midlie_jax.integrate`; the error of the run must be smaller than the errors of the
            measurements.
        method: the method of the run.
        t0: the time of `start`, not after the first measurement.
        starts: the number of initial guesses. The first is the guess, the others are drawn around it; the best of all
            fits is returned.
        spread: standard deviation of the drawn guesses: relative, or for quaternions in radians.
        seed: seed of the drawn guesses.
        segments: with more than one, multiple shooting: the time is cut into this many segments. Each has its own
            initial state, taken from the nearest measured rate and attitude if available. Multiple shooting converges
            from guesses whose run departs from the data, as for chaotic motion or near the separatrix. A last fit
            without segments makes the estimate the same as with one segment.
        continuity: the weight of jumps between segments. A relative jump of the momentum, or a jump of the attitude in
            radians, of size 1 / `continuity` counts as much as a residual of one sigma.
        first_span: a length of time after t0. If given, the measurements of this span are fitted first, then the
            measurements of twice the span, and so on to all of them. Each fit begins at the result of the previous one.
            Like `segments`, but without further unknowns, this converges from guesses whose run departs from the data
            only later. The program is compiled once. The span should hold more measured numbers than there are
            unknowns.
        absolute_sigma: True if the sigmas are known. Otherwise they are known up to a common factor, which is estimated
            from the residuals, and intervals use Student's t.
        solver: a function solver(residuals, start, max_steps) -> (optimum, steps, converged) instead of the
            Levenberg-Marquardt method. It minimises the sum of the squares of residuals(x), x (u,), from x = start,
            with JAX operations; derivatives of `residuals` are computed in forward mode. For example, it can call
            `optimistix.least_squares` with an optimiser of optax. Pass the same function again to reuse compiled code.
        max_steps: the largest number of steps of the optimiser from each initial guess.
        require_rank: if False, data that do not determine all parameters give a result with `ok` False, and no error.
        progress: whether to show a line on stderr; by default only if stderr is a terminal. Or a function that is
            called with 1 after each step of the search. With a `solver` there is no progress to show.

    Returns:
        The result; print it for a table. `ok` is False if a run failed, the optimiser did not converge, or the
        residuals cannot be noise. With `absolute_sigma` this is a chi-squared test of the sigmas; otherwise the
        residuals must be small relative to the measured values.

    Raises:
        ValueError: an argument is invalid, there are too few measurements, the rates have another unit than the guess
            of a free body, or the attitudes follow another convention according to the rates of the same body. It is
            raised before anything is traced.
        UndeterminedError: a ValueError. The fit converged and its residuals can be noise, but the measurements do not
            determine all parameters. The message names the parameters that are not identifiable; `result` of the error
            holds the fit.

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
        model, guess, measurements, dt=dt, method=method, t0=t0, starts=starts, spread=spread, seed=seed,
        segments=segments, continuity=continuity, absolute_sigma=absolute_sigma, solver=solver, max_steps=max_steps,
    )  # fmt: skip
    data = Data(Layout(guess), tuple(_as_list(measurements)))
    estimate = solved(plan, data, progress, _ends(first_span, plan, data))
    layout = data.layout
    groups = confounded(estimate.spectrum, layout.unconstrained_names(), layout.typical())
    message = message_of(plan, data, estimate, complaint(groups, layout.named()))
    aliases = aliases_of(model, data.measurements, estimate.values)
    found = Fit(estimate, layout, data.measurements, groups, message, aliases)
    if groups and require_rank and found.result is Result.UNDETERMINED:
        raise UndeterminedError(found)
    return found


def prepare(
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
    absolute_sigma: bool = False,
    solver: Solver | None = None,
    max_steps: int = 200,
) -> Plan:
    """Checks a problem and returns the plan with which `fit_arrays` solves it for any data of the same shapes.

    Arguments and errors are the same as for `fit`.

    Examples:
        >>> def model(values):  # values of the parameters -> body, torque, start
        ...     return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"])
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, gyroscope, method="RK4", dt=0.5)  # for fit_arrays
        >>> plan.starts.shape  # (s, p): one start, three unconstrained numbers
        (1, 3)
    """
    listed = _as_list(measurements)
    layout = Layout.checked(guess)
    method = as_method(method)
    for name, number in (("spread", spread), ("continuity", continuity)):
        _require_positive(name, number)
    if solver is not None:
        require_function("solver", solver, "residuals, start, max_steps")
    starts, segments, max_steps = (
        as_count(name, n) for name, n in (("starts", starts), ("segments", segments), ("max_steps", max_steps))
    )
    names = set(guess) if isinstance(guess, dict) else set[str]()
    for measurement in listed:
        check_parts(of_which(measurement)[1], names)
    times = np.concatenate([np.asarray(m.times) for m in listed])
    check_grid(times, dt, t0)
    count = sum(int(np.sum(np.asarray(m.present))) for m in listed)
    if count <= layout.size:
        raise ValueError(
            f"measurements must hold more numbers than the {layout.size} unknowns "
            f"({', '.join(layout.unconstrained_names())}), got {count}; give at least {layout.size + 1}."
        )
    method, several = checked_model(model, layout, listed, method)
    if several and segments > 1:
        raise ValueError(f"segments must be 1 for coupled bodies, got {segments}; leave segments out.")
    grid = Grid.of(times, float(dt), float(t0), segments, moving=any(m.clock is not None for m in listed))
    if grid.steps * segments > _MOST_STEPS:
        raise ValueError(
            f"times must be at most {_MOST_STEPS:.2g} steps after t0, got {times.max():g} after "
            f"{(times.max() - t0) / dt:.2g} steps. Give times in the unit of time of dt."
        )
    if segments > 1 and grid.steps * (segments - 1) * dt >= times.max() - t0:
        raise ValueError(f"segments must not be too many for the steps, got {segments}; give fewer, or a smaller dt.")
    offsets = np.random.default_rng(seed).standard_normal((starts, layout.size)) * spread
    offsets[0] = 0
    problem = Problem(model, method, grid, float(continuity))
    rows = jnp.asarray(offsets * np.asarray(layout.typical()), layout.start().dtype)
    return Plan(problem, solver, rows, max_steps, absolute_sigma)


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
    _require_positive("first_span", first)
    if plan.solver is not None:
        raise ValueError("first_span must be None if a solver is given, got both; leave out `solver`.")
    t0 = plan.problem.grid.t0
    span = max(float(np.max(m.times)) for m in data.measurements) - t0
    count = max(0, math.ceil(math.log2(span / first))) if span > first else 0
    return [t0 + first * 2**k for k in range(count)]


def _require_positive(name: str, number: Any) -> None:
    if not (isinstance(number, (int, float)) and math.isfinite(number) and number > 0):
        raise ValueError(f"{name} must be a positive finite number, got {number!r}.")
