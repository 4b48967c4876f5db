"""Why a fit failed, and a cure: computed after the fit, so that a successful fit does not pay for it."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from .estimate import Estimate
from .residuals import Data
from .result import Result
from .solve import Plan

_SHARE = 0.5  # share of the method's reach that a step may use, because a body may later turn faster


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
        cure = "start nearer, give starts=8 or segments=10, or more max_steps."
        return f"the optimiser did not converge in {int(estimate.steps)} steps: {cure}"
    if result is Result.UNDETERMINED:
        return undetermined or "there are not more measured numbers than unknowns; give more measurements."
    if result is Result.MISFIT:
        return (
            f"the residuals are {float(estimate.rms):.3g} times the sigmas, which were said to be known: the model "
            "leaves something out, such as a bias or a torque, or the sigmas are too small."
        )
    return result.value


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
