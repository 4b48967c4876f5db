"""Why a fit failed, and a cure: computed after the fit, so that a successful fit does not pay for it."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from .estimate import Estimate
from .measurements import Accelerations, Attitudes, Measurement, Rates
from .misfit import Remainder, explained, remainders_of, within_sigmas
from .of_body import OfBody
from .report import Fit
from .residuals import Data
from .result import Result
from .solve import Plan

_SHARE = 0.5  # share of the method's reach that a step may use, because a body may later turn faster


class UndeterminedError(ValueError):
    """The measurements do not determine all parameters, and `fit` was not told that this is expected.

    Attributes:
        result: the `Fit`, with the values, the rms and what is determined; `require_rank=False` returns it instead.

    Examples:
        >>> def model(values):  # a start that depends on the sum of two parameters alone
        ...     return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["first"] + values["second"])
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"first": ml.fitting.Free([0.4, 0.4, 0.1]), "second": ml.fitting.Free([0.0, 0.0, 0.0])}
        >>> try:
        ...     ml.fit(model, guess, gyroscope, method="RK4", dt=0.5)
        ... except ml.fitting.UndeterminedError as error:
        ...     print(error.result.rank, (error.result.values["first"] + error.result.values["second"]).round(6))
        3 [0.5 0.3 0.2]
    """

    def __init__(self, result: Fit):
        super().__init__(
            f"{result.message} The rms of the residuals is {result.rms:.3g} sigma; the values are in the attribute "
            "`result` of this error, or returned with require_rank=False."
        )
        self.result = result


def message_of(plan: Plan, data: Data, estimate: Estimate, undetermined: str) -> str:
    """What `Fit.message` says.

    Args:
        plan, data, estimate: those of the fit.
        undetermined: the names of the parameters that are not determined, and the cure.
    """
    result = Result.of(int(estimate.result))
    if result is Result.RUN_FAILED:
        return _failed_run(plan, data, estimate)
    if result is Result.NOT_CONVERGED:
        left = "".join(f" {text}" for text in _misfit(plan, data, estimate))
        cure = "start nearer, give starts=8 or segments=10, or more max_steps."
        return f"the optimiser did not converge in {int(estimate.steps)} steps: {cure}{left}"
    if result is Result.MISFIT:
        told, check = _misfit(plan, data, estimate)
        more = f" At these values, {undetermined}" if undetermined else ""
        return f"{told} Start nearer, or give starts=8. {check}{more}"
    if result is Result.UNDETERMINED:
        return undetermined or "there are not more measured numbers than unknowns; give more measurements."
    return result.value


def _misfit(plan: Plan, data: Data, estimate: Estimate) -> list[str]:
    """How large the residuals are, and what to check; nothing if they can be noise."""
    listed = [m.measurement if isinstance(m, OfBody) else m for m in data.measurements]
    squares, dof = jnp.sum(estimate.residuals**2), max(int(estimate.dof), 1)
    if not jnp.isfinite(squares):
        return []
    check = "Check units, axes and times"
    if any(isinstance(m, Attitudes) for m in listed):
        check += ", and that quaternions are (w, x, y, z) from body to space"
    if plan.absolute_sigma:
        if within_sigmas(squares, jnp.asarray(dof, squares.dtype)):
            return []
        told = (
            f"the residuals are {float(estimate.rms):.3g} times the sigmas, which were said to be known: the model "
            "leaves something out, such as a bias or a torque, or the sigmas are too small."
        )
        return [told, f"{check}."]
    remainders = remainders_of(data.measurements, estimate.residuals, estimate.values)
    if explained(remainders):
        return []
    worst = max(range(len(listed)), key=lambda i: _rank(remainders[i]))
    share, of_what = _share(remainders[worst], listed[worst])
    told = (
        f"the residuals, with an rms of {float(estimate.rms):.3g} sigma, cannot be noise: those of the "
        f"{type(listed[worst]).__name__} are {share:.0%} of {of_what}."
    )
    return [told, f"{check}. If noise is so large, give its sigmas and absolute_sigma=True."]


def _rank(remainder: Remainder) -> tuple[bool, float]:
    """Measurements that cannot be noise on their own come last, then those with larger residuals."""
    return bool(remainder.structured | remainder.turned), float(remainder.left)


def _share(remainder: Remainder, measurement: Measurement) -> tuple[float, str]:
    """The size of the residuals relative to something, and what that is."""
    whole, of_what = remainder.spread, "the changes of what was measured"
    if remainder.angles and bool(remainder.turned | ~remainder.structured):
        whole, of_what = remainder.signal, "a radian"
    elif isinstance(measurement, Rates | Accelerations) and not bool(remainder.structured):
        whole, of_what = remainder.signal, "what was measured"
    return math.sqrt(float(remainder.left) / float(whole)) if whole > 0 else math.inf, of_what


def _failed_run(plan: Plan, data: Data, estimate: Estimate) -> str:
    """At which time the run of the best parameters failed, and a step with which it should not."""
    problem = plan.problem.single()
    dt, method = problem.grid.dt, problem.method
    _, body, (_, paths), _ = problem.run(estimate.vector, data)
    times, bad = np.asarray(paths.times[0]), int(paths.first_bad[0])
    if bad >= len(times):
        return "the model gives numbers that are not finite at a measured time, though its run is good; check the data."
    momenta = jax.tree.map(lambda x: x[0, : max(bad, 1)], paths.states.momentum)
    rates = jax.vmap(lambda momentum: jnp.linalg.norm(body.velocity(momentum)))(momenta)
    fastest = float(np.max(np.asarray(rates)[np.isfinite(rates)], initial=0.0))
    when = f"the run failed after t = {times[max(bad - 1, 0)]:.6g}"
    if math.isfinite(method.reach) and dt * fastest > method.reach * _SHARE:
        enough = _rounded_down(method.reach * _SHARE / fastest)
        return (
            f"{when}: the body turns {dt * fastest:.3g} radians in a step, and {method.name} takes at most "
            f"{method.reach:.3g}; dt = {enough:g} would do, unless the guess makes the body turn too fast."
        )
    return f"{when}; try half the step, dt = {dt / 2:g}, and check that the guess is near."


def _rounded_down(number: float) -> float:
    """The number, rounded down to one digit."""
    unit = 10.0 ** math.floor(math.log10(number))
    return math.floor(number / unit) * unit
