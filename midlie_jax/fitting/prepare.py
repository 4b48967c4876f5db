"""`prepare`: the checks of a fit, made before anything is traced."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count, described
from ..drivers.arguments import as_method, check_system
from ..methods.base import Method
from ..model.bodies import RigidBody, principal_of
from ..model.state import AnyState
from ..model.torques import without_gravity
from .conventions import check_conventions
from .layout import Layout
from .measurements import Accelerations, Attitudes, Directions, Measurement, Observed, Positions, Rates, check_parts
from .residuals import Model, Problem
from .sampling import Grid, check_grid
from .solve import Plan

_FACTOR = 20.0  # measured and guessed speeds that differ by a larger factor are in different units, such as degrees
_MOST_STEPS = 2**31 - 1  # they are counted in int32


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

    Examples:
        >>> def model(values):  # values of the parameters -> body, torque, start
        ...     return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"])
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, gyroscope, method="RK4", dt=0.5)  # for fit_arrays
        >>> plan.starts.shape  # (s, p): one start, three unconstrained numbers
        (1, 3)
    """
    listed = as_list(measurements)
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
    method, several = _checked_model(model, layout, listed, method)
    if several and segments > 1:
        raise ValueError("coupled bodies are fitted in one segment; leave segments out.")
    grid = Grid.of(times, float(dt), float(t0), segments, moving=any(m.clock is not None for m in listed))
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
    return Plan(problem, solver, rows, max_steps, absolute_sigma)


def as_list(measurements: Any) -> list[Measurement]:
    """One or several measurements as a list; a ValueError for anything else."""
    listed = [measurements] if isinstance(measurements, Measurement) else list(measurements)
    wrong = [m for m in listed if not isinstance(m, Measurement)]
    if wrong or not listed:
        raise ValueError(
            "measurements must be one or several of Rates, Attitudes, Directions, Positions, Accelerations, Observed "
            f"and OfBody, got {described(wrong[0]) if wrong else 'none'}."
        )
    return listed


def _checked_model(
    model: Any, layout: Layout, measurements: Sequence[Measurement], method: Method
) -> tuple[Method, bool]:
    """The fitted method, and whether the model holds several bodies.

    Raises:
        ValueError: the model does not give a body, a torque and a start that suit the measurements.
    """
    values = layout.values(layout.start())
    try:
        body, torque, start = model(values)
    except TypeError as error:
        raise ValueError(
            f"model must take the values of the guess and return (body, torque, start): {error}"
        ) from error
    refused = "fit compares one motion with the measurements, and in a heat bath there are many"
    method = check_system(method, body, torque, start, bath=refused)
    if not start.own_axes:
        raise ValueError("model returned Particles; the measurements here are of rigid bodies.")
    if start.momentum.dtype != layout.start().dtype:
        raise ValueError(f"the guess is {layout.start().dtype} but the start of the model {start.momentum.dtype}.")
    for measurement in measurements:
        subject = measurement.subject(body, start)
        _check_measurement(*subject, torque)
        if isinstance(subject[0], Observed):
            subject[0].check(values, *subject[1:])
    check_conventions(measurements, values)
    if torque is None and not start.several:
        _check_speeds(body, start, measurements)
    return method, start.several


def _check_measurement(m: Measurement, body: Any, start: Any, torque: Any) -> None:
    """Raises unless the measurement can be of this body."""
    kind = type(m).__name__
    if isinstance(m, Rates) and not isinstance(principal_of(body).turning, RigidBody):
        raise ValueError(f"Rates are of rigid bodies, but the model returned a {type(body).__name__}.")
    suits = hasattr(start, "attitude") or (isinstance(m, Directions) and hasattr(start, "direction"))
    if isinstance(m, Attitudes | Positions | Directions | Accelerations) and not suits:
        raise ValueError(
            f"{kind} need the attitude, but the model starts from a {type(start).__name__}; return a RigidState."
        )
    if isinstance(m, Positions) and m.origin is not None and start.rotation is not None:
        raise ValueError("Positions of a body that travels have no origin but its own position; leave origin out.")
    if isinstance(m, Accelerations):
        in_model = torque is not None and without_gravity(torque) is not torque
        if m.gravity is None and (start.rotation is None or not in_model):
            raise ValueError(
                "Accelerations need gravity=, such as (0, 0, -9.81), or zeros where there is none; on a body that "
                "travels it can be a term of the torque instead, such as UniformGravity."
            )
        if in_model and m.gravity is not None:
            raise ValueError("gravity is a term of the model's torque already: leave gravity out of Accelerations.")
    if m.values.dtype != start.momentum.dtype:
        raise ValueError(f"{kind} are {m.values.dtype} but the start of the model is {start.momentum.dtype}.")


def _check_speeds(body: Any, start: AnyState, measurements: Sequence[Measurement]) -> None:
    """Raises if a free body cannot turn as fast or as slowly as measured; the units are then not the same.

    Its speed changes by at most the ratio of the largest moment to the smallest.
    """
    guessed = float(jnp.linalg.norm(body.velocity(start.momentum)))
    moments = principal_of(body).turning.moments
    allowed = max(_FACTOR, 2 * float(jnp.max(moments) / jnp.min(moments)))
    for measurement in measurements:
        if not isinstance(measurement, Rates):
            continue
        complete = np.all(np.asarray(measurement.present), axis=1)
        rates = np.asarray(measurement.values)[complete]
        unknown = measurement.bias is not None
        # An unknown bias may have any size, so only the changes of the rates count, and these may be small.
        rates = rates - np.median(rates, axis=0) if unknown and len(rates) else rates
        speeds = np.linalg.norm(rates, axis=1)
        measured = float(np.median(speeds)) if speeds.size else 0.0
        slow = 0 < measured <= guessed / allowed and not unknown
        if slow or measured >= guessed * (allowed / 2 if unknown else allowed) > 0:
            if not unknown and speeds.min() <= guessed <= speeds.max():
                raise ValueError(
                    f"Rates: the measured speeds go from {speeds.min():.3g} to {speeds.max():.3g}, which no free body "
                    "does; fit only the rows in which no torque acts, or give the torque in the model."
                )
            seen = f"change by {measured:.3g}" if unknown else f"turn at {measured:.3g}"
            raise ValueError(
                f"Rates: the body was measured to {seen}, and the free body of the guess turns at {guessed:.3g} "
                "radians per unit of time; give both in radians per unit of time of dt, such as np.deg2rad(values)."
            )
