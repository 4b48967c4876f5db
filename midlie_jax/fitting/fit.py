"""`fit`: parameters of a rigid body from measurements, by nonlinear least squares through the integrator."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._kernel.checks import as_count, described
from ..drivers.arguments import as_method, check_system
from ..methods.base import Method
from ..model.bodies import Particles, RigidBody, TensorBody, principal_of
from ..model.state import AnyState
from ..model.states import DirectionState, RigidState
from .identifiability import complaint, confounded
from .layout import Layout
from .measurements import Attitudes, Directions, Measurement, Positions, Rates, check_parts
from .report import Fit
from .residuals import Model, Problem
from .sampling import Grid, check_grid
from .solve import Plan, fit_arrays

_run = eqx.filter_jit(fit_arrays)
_FACTOR = 20.0  # measured and guessed speeds that differ by more are in different units: degrees, hertz, minutes
_MOST_STEPS = 2**31 - 1  # they are counted in int32


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
    absolute_sigma: bool = False,
    solver: Any = None,
    max_steps: int = 200,
    require_rank: bool = True,
    progress: bool | None = None,
) -> Fit:
    """Fits the parameters of a rigid body to measurements, by default with Levenberg and Marquardt's method.

    The sum of the squares of all residuals over their sigmas is made least. The Jacobian is by forward mode through
    `midlie_jax.integrate`. The first call compiles; pass the same `model` function again to reuse what was compiled.

    Args:
        model: model(values) -> (body, torque, start), where `values` has the structure of `guess` with arrays in place
            of the parameters. It must be pure and made of JAX operations.
        guess: a pytree, such as a dict, of the parameters in this package.
        measurements: one or several.
        dt: the step; as for `midlie_jax.integrate`, its error must be below that of the measurements.
        method: of the run.
        t0: the time of `start`, not after the first measurement.
        starts: the number of starts. Beyond the first, which is the guess, they are drawn around it; the best fit of
            all counts.
        spread: standard deviation of the drawn starts: relative, of quaternions in radians.
        seed: of the drawn starts.
        segments: with more than one, multiple shooting: the time is cut into as many segments, each with a start of its
            own, taken from the nearest measured rate and attitude where there are any. It converges from guesses whose
            run departs from the data, as for chaotic motion or near the separatrix. The result is polished without
            segments, so that it is the same estimate.
        continuity: with segments, one over the relative jump of the momentum and the jump of the attitude in radians
            between two segments that counts as much as a residual of one sigma.
        absolute_sigma: True if the sigmas are known. Otherwise they are taken as known up to a common factor, which is
            estimated from the residuals, and intervals use Student's t.
        solver: an optimistix solver or minimiser in place of `optimistix.LevenbergMarquardt`, for example
            `optimistix.OptaxMinimiser(optax.adam(0.1), rtol=1e-6, atol=1e-6)`.
        max_steps: the most steps of the optimiser, from each start.
        require_rank: False returns a result with `ok` False where the data do not determine all parameters.
        progress: whether to show a line on stderr; by default if stderr is a terminal.

    Returns:
        The result; print it for a table. `ok` is False if the optimiser did not converge or a run failed.

    Raises:
        ValueError: an argument is invalid, there are too few measurements, or the rates are in another unit than the
            guess of a free body; raised before anything is traced. Or the fit converged and the measurements do not
            determine all parameters; the message names those that cannot be told apart.
    """
    shown = sys.stderr.isatty() if progress is None else progress
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
    if shown and starts == 1:
        plan = replace(plan, show=_line)
    listed = _listed(measurements)
    estimate = jax.block_until_ready(_run(plan, guess, tuple(listed)))
    if shown:
        jax.effects_barrier()
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    layout = Layout(guess)
    groups = confounded(estimate.spectrum, layout.unconstrained_names(), layout.typical())
    problem = complaint(groups, layout.parameters)
    if problem and require_rank and bool(estimate.converged):
        raise ValueError(problem)
    return Fit(estimate, layout, tuple(listed), groups, problem)


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
    solver: Any = None,
    max_steps: int = 200,
) -> Plan:
    """Checks a problem and returns what `fit_arrays` needs to solve it for any data of the same shapes.

    Args and errors are those of `fit`.
    """
    listed = _listed(measurements)
    layout = Layout.checked(guess)
    method = as_method(method)
    for name, number in (("spread", spread), ("continuity", continuity)):
        if not (isinstance(number, (int, float)) and np.isfinite(number) and number > 0):
            raise ValueError(f"{name} must be a positive finite number, got {number!r}.")
    starts, segments, max_steps = (
        as_count(name, n) for name, n in (("starts", starts), ("segments", segments), ("max_steps", max_steps))
    )
    names = set(guess) if isinstance(guess, dict) else set[str]()
    for measurement in listed:
        check_parts(measurement, names)
    times = np.concatenate([np.asarray(m.times) for m in listed])
    check_grid(times, dt, t0)
    count = sum(int(np.sum(np.asarray(m.present))) for m in listed)
    if count <= layout.size:
        raise ValueError(
            f"{count} measured numbers are too few for {layout.size} unknowns "
            f"({', '.join(layout.unconstrained_names())}); give at least {layout.size + 1}."
        )
    method = _checked_model(model, layout, listed, method)
    grid = Grid.of(times, float(dt), float(t0), segments)
    if grid.steps * segments > _MOST_STEPS:
        raise ValueError(
            f"the last time, {times.max():g}, is {(times.max() - t0) / dt:.2g} steps after t0; give times in the unit"
            " of time of dt and of the model."
        )
    if segments > 1 and grid.steps * (segments - 1) * dt >= times.max() - t0:
        raise ValueError(f"{segments} segments are too many for the steps; give fewer, or a smaller dt.")
    offsets = np.random.default_rng(seed).standard_normal((starts, layout.size)) * spread
    offsets[0] = 0
    problem = Problem(model, method, grid, float(continuity))
    rows = jnp.asarray(offsets * np.asarray(layout.typical()), layout.start().dtype)
    return Plan(problem, solver, rows, max_steps, absolute_sigma, None)


def _listed(measurements: Any) -> list[Measurement]:
    listed = [measurements] if isinstance(measurements, Measurement) else list(measurements)
    wrong = [m for m in listed if not isinstance(m, Measurement)]
    if wrong or not listed:
        raise ValueError(
            "measurements must be one or several of Rates, Attitudes, Directions and Positions, got "
            f"{described(wrong[0]) if wrong else 'none'}."
        )
    return listed


def _checked_model(model: Any, layout: Layout, measurements: Sequence[Measurement], method: Method) -> Method:
    """Raises unless the model gives a body, a torque and a start that suit the measurements; the fitted method."""
    try:
        body, torque, start = model(layout.values(layout.start()))
    except TypeError as error:
        raise ValueError(
            f"model must take the values of the guess and return (body, torque, start): {error}"
        ) from error
    method = check_system(method, body, torque, start)
    if isinstance(body, Particles):
        raise ValueError("model returned Particles; the measurements here are of rigid bodies.")
    if torque is None:
        _check_speeds(body, start, measurements)
    if start.momentum.dtype != layout.start().dtype:
        raise ValueError(f"the guess is {layout.start().dtype} but the start of the model {start.momentum.dtype}.")
    for m in measurements:
        kind = type(m).__name__
        suits = isinstance(start, RigidState) or (isinstance(m, Directions) and isinstance(start, DirectionState))
        if isinstance(m, Attitudes | Positions | Directions) and not suits:
            raise ValueError(
                f"{kind} need the attitude, but the model starts from a {type(start).__name__}; return a RigidState."
            )
        if m.values.dtype != start.momentum.dtype:
            raise ValueError(f"{kind} are {m.values.dtype} but the start of the model is {start.momentum.dtype}.")
    return method


def _line(step: Any, loss: Any) -> None:
    print(f"\r\033[Kfit: step {int(step)}, loss {float(loss):.6g}", end="", file=sys.stderr, flush=True)


def _check_speeds(body: RigidBody | TensorBody, start: AnyState, measurements: Sequence[Measurement]) -> None:
    """Raises if a free body cannot turn as fast or as slowly as measured; the units are then not the same.

    Its speed changes by at most the ratio of the largest moment to the smallest.
    """
    guessed = float(jnp.linalg.norm(body.velocity(start.momentum)))
    moments = principal_of(body).moments
    allowed = max(_FACTOR, 2 * float(jnp.max(moments) / jnp.min(moments)))
    for measurement in measurements:
        if not isinstance(measurement, Rates) or measurement.bias is not None:
            continue
        complete = np.all(np.asarray(measurement.present), axis=1)
        speeds = np.linalg.norm(np.asarray(measurement.values)[complete], axis=1)
        measured = float(np.median(speeds)) if speeds.size else 0.0
        if guessed > 0 and measured > 0 and not 1 / allowed < measured / guessed < allowed:
            raise ValueError(
                f"Rates: the body was measured to turn at {measured:.3g}, and the free body of the guess turns at "
                f"{guessed:.3g} radians per unit of time; give both in radians per unit of time of dt, such as "
                "np.deg2rad(values)."
            )
