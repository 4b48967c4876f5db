"""The result of `fit`: the estimate with names, and in words the failures and doubts.

The words are computed after the fit, so that a successful fit takes no time for them.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count
from .estimate import CONFIDENCE, Estimate, Result, complaint, confounded
from .instruments import Attitudes, of_which
from .measurements import parted
from .noise import Doubt, aliases_of, doubts, explained, outliers_of, remainders_of, within_sigmas
from .parameters import InertiaTensor, Moments, flatness
from .problem import Data, linear_unknowns
from .sampling import Closed
from .search import Minimum
from .solve import Plan

_FLAT = 1e-3  # for a smaller share I1 + I2 - I3 of the sum, optimum and interval may be invalid
_TOLD = 5  # minima in a table
_SIGMAS = 5.0  # of two minima within so many, chance may decide which is the better one
_SAME, _TINY = 1e-4, 1e-300  # a smaller difference of chi-squared is the one of a copy
_SHARE = 0.5  # share of the method's reach for a step, because a body may later rotate faster


class Fit:
    """The result of `midlie_jax.fit`.

    Attributes:
        estimate: the whole result as arrays, see `Estimate`.
        values: the values of the parameters, of the structure of the guess.
        names: (k,), the names of the coordinates, such as "moments[0]".
        coordinates, covariance, intervals: (k,), (k, k) and (k, 2), see `Estimate`.
        rms: root mean square of the residuals over sigma; near 1 if model and sigmas are correct.
        dof: degrees of freedom.
        steps: number of steps of the optimiser.
        rank, condition: rank and condition number of the Jacobian with columns of length one.
        confounded: the groups of unconstrained numbers that are not identifiable.
        aliases: how often the body rotates between rows, if by more than half a revolution, so that other values may
            fit as well; "" otherwise.
        minima: the distinct minima of a search over `ranges`, each a `Minimum`, in ascending order; otherwise empty.
        ok: whether the fit ended normally: `result` is `Result.FITTED`.
        result: how the fit ended, a `Result`.
        message: what failed, with the time, the names or the numbers, and a remedy.

    Examples:
        >>> model = lambda values: (ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"]))
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> result = ml.fit(model, guess, gyroscope, method="RK4", dt=0.5)  # print it for a table
        >>> result.ok, result.names, result.intervals.shape
        (True, ['momentum[0]', 'momentum[1]', 'momentum[2]'], (3, 2))
    """

    def __init__(self, plan: Plan, data: Data, estimate: Estimate, minima: list[Minimum]):
        self.estimate, self.minima = estimate, minima
        self._data, self._problem, self._loss = data, plan.problem, plan.problem.loss
        self._layout = layout = data.layout
        self.values: Any = estimate.values
        self.names = layout.names()
        self.confounded = confounded(estimate.spectrum, layout.unconstrained_names(), layout.typical())
        self.message = _message(plan, data, estimate, complaint(self.confounded, layout.named()))
        self.aliases = aliases_of(plan.problem.model, data.measurements, estimate.values)
        self.coordinates, self.covariance, self.intervals = (
            np.asarray(x) for x in (estimate.coordinates, estimate.covariance, estimate.intervals)
        )
        self.rms, self.dof, self.steps = float(estimate.rms), int(estimate.dof), int(estimate.steps)
        self.rank, self.condition = int(estimate.spectrum.rank), float(estimate.spectrum.condition)
        self.result = Result.of(int(estimate.result))
        self.ok = self.result is Result.FITTED

    def residuals(self) -> list[np.ndarray]:
        """The residuals over sigma of each measurement, of the shape of its `present`; NaN where missing."""
        parts = parted(self._data.measurements, self.estimate.residuals)
        return [np.where(m.present, part, np.nan) for m, part in zip(self._data.measurements, parts, strict=True)]

    def zero_points(self) -> list[np.ndarray]:
        """For each measurement its linear unknowns, such as the zero points of the `nights` of a `Photometry`."""
        return [np.asarray(x) for x in linear_unknowns(self._problem, self._data, self.estimate.vector)]

    @property
    def outliers(self) -> list[np.ndarray]:
        """For each measurement the rows of values that are too far off for noise; with a loss they count less."""
        found = [outliers_of(x.reshape(len(x), -1)) for x in self.residuals()]
        return [np.array([row for row, _ in far], int) for far in found]

    @property
    def doubts(self) -> list[str]:
        """Why the values or the intervals may be wrong even if `ok` is True; empty if there is no reason to doubt.

        Outliers, unless the fit has a loss; correlated neighbouring residuals, and the factor by which they make the
        intervals too narrow; and rows so far apart that other values may fit as well. After a search also correlated
        residuals as the sign of a wrong minimum, and another minimum within 5 sigma, unless it is a copy with the same
        chi-squared.
        """
        return [doubt.text for doubt in self.doubtful()]

    def doubtful(self) -> list[Doubt]:
        """The doubts with the measurement and the rows that each concerns."""
        residuals = self.residuals()
        if self._loss is not None:  # which outliers do not disturb, nor must they hide a correlation
            residuals = [np.asarray(self._loss.judged(jnp.asarray(x))) for x in residuals]
        found = [d for d in doubts(residuals, self._data.measurements) if self._loss is None or not d.rows]
        of_search = self._rivals() if self.minima else []
        if self.minima and any(not doubt.rows for doubt in found):
            of_search.append("the search may have ended in a wrong minimum; give more starts, or another first_span")
        return [*found, *(Doubt(text, None) for text in (*of_search, self.aliases) if text)]

    def _rivals(self) -> list[str]:
        """The minima that chance may have made worse than the best one."""
        best, deviations = self.minima[0].chi_squared, np.sqrt(np.diagonal(self.covariance))
        found: list[str] = []
        for k, (chi_squared, values, _) in enumerate(self.minima):
            worse = (chi_squared - best) / max(self.rms**2, _TINY)
            leaves = zip(self._layout.parameters, jax.tree.leaves(values), strict=True)
            off = np.concatenate([np.asarray(p.coordinates(jnp.asarray(x))) for p, x in leaves]) - self.coordinates
            same = chi_squared - best <= _SAME * (1 + best) or np.all(np.abs(off) <= 2 * _SIGMAS * deviations)
            if worse < _SIGMAS**2 and not same:
                found.append(f"minima[{k}] ({math.sqrt(worse):.2g})")
        told = ", ".join(found[:_TOLD])
        return [f"chance may decide which minimum is the best; less than 5 sigma worse: {told}"] if found else []

    @property
    def flat(self) -> list[str]:
        """The names of the inertias that the data hardly distinguish from the inertia of a flat body, I3 = I1 + I2.

        For these, I1 + I2 - I3 is less than the width of its interval, or than 1e-3 of the sum of the moments. The
        parameters cannot reach this limit, and the optimiser may end without convergence. If the body is flat, make two
        `Positive` moments the parameters, and their sum the third moment.
        """
        found: list[str] = []
        for place, (name, parameter) in enumerate(self._layout.named()):
            if isinstance(parameter, Moments | InertiaTensor):
                gap, (low, _) = self.derived(lambda values, i=place: flatness(jax.tree.leaves(values)[i]))
                if gap < max(_FLAT, 2 * (gap - low)):
                    found.append(name)
        return found

    def derived(self, function: Callable[[Any], Any]) -> tuple[np.ndarray, np.ndarray]:
        """A quantity, and its 95 % interval to first order, with a last axis (2,); infinite if it is not determined.

        The function takes `values` and returns an array of any shape, for example a ratio of two moments.
        """
        estimate = self.estimate

        def flat(vector: jax.Array) -> jax.Array:
            return function(self._layout.values(vector)).reshape(-1)

        @jax.jit  # one small program instead of one per operation
        def both(vector: jax.Array) -> tuple[jax.Array, jax.Array]:
            return flat(vector), jax.jacfwd(flat)(vector)

        shape = jax.eval_shape(function, estimate.values).shape
        centre, slopes = (np.asarray(x) for x in both(estimate.vector))
        variance = np.sum((slopes @ np.asarray(estimate.unconstrained)) * slopes, axis=-1)
        unknown = np.asarray(estimate.spectrum.undetermined(jnp.asarray(slopes)))
        half = np.where(unknown, np.inf, float(estimate.quantile) * np.sqrt(variance))
        return centre.reshape(shape), np.stack([centre - half, centre + half], axis=-1).reshape(*shape, 2)

    def draws(self, count: int, seed: int = 0) -> Any:
        """`count` values consistent with the data, for predictions that follow from them, with a leading axis (count,).

        They are drawn from a normal distribution of the unconstrained numbers about the estimate, with the covariance
        of the fit, and are correct to first order. `jax.vmap(predicted)(result.draws(1000))` maps a prediction over
        them. If sigmas are estimated from few data, the intervals, by Student's t, are wider than these draws.

        Raises:
            ValueError: count is not a positive int, or the data do not determine all parameters.
        """
        if self.rank < self._layout.size:
            raise ValueError(
                f"data must determine all {self._layout.size} unknowns for draws, got a rank of {self.rank}. Fix some, "
                "or use `derived`."
            )
        estimate = self.estimate
        root = np.linalg.cholesky(np.asarray(estimate.unconstrained))
        offsets = np.random.default_rng(seed).standard_normal((as_count("count", count), len(root))) @ root.T
        vectors = estimate.vector[None] + jnp.asarray(offsets, estimate.vector.dtype)
        return jax.jit(jax.vmap(self._layout.values))(vectors)

    def __str__(self) -> str:
        deviations = np.sqrt(np.diagonal(self.covariance))
        table = [["parameter", "estimate", "std. deviation", f"{CONFIDENCE:.0%} interval"]]
        for name, x, s, (low, high) in zip(self.names, self.coordinates, deviations, self.intervals, strict=True):
            table.append([name, f"{x:.10g}", f"{s:.2g}", f"[{low:.10g}, {high:.10g}]"])
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
        lines.insert(1, "  ".join("-" * w for w in widths))
        if flat := self.flat:
            lines.append(f"{', '.join(flat)}: the data hardly tell this body from a flat one, see Fit.flat")
        if self._loss is not None:
            far = [d.text for d in doubts(self.residuals(), self._data.measurements) if d.rows]
            lines += [f"outliers, which the loss counts less: {text}" for text in far]
        if self.minima:
            told = ", ".join(f"{found.chi_squared:.6g} ({found.starts} starts)" for found in self.minima[:_TOLD])
            lines.append(f"chi-squared of the best of {len(self.minima)} minima: {told}")
        doubtful = self.doubts
        lines += [f"doubtful: {doubt}" for doubt in doubtful]
        state = "NOT ok: " + self.message if not self.ok else "doubtful" if doubtful else "ok"
        lines.append(
            f"rms of residuals / sigma {self.rms:.4g}, {self.dof} degrees of freedom, {self.steps} steps, "
            f"rank {self.rank} of {self._layout.size}, condition {self.condition:.2g}; {state}"
        )
        return "\n".join(lines)

    __repr__ = __str__


class UndeterminedError(ValueError):
    """The measurements do not determine all parameters; `result` is the `Fit` that `require_rank=False` returns.

    Examples:
        >>> model = lambda values: (ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["a"] + values["b"]))
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"a": ml.fitting.Free([0.4, 0.4, 0.1]), "b": ml.fitting.Free([0.0, 0.0, 0.0])}
        >>> try:
        ...     ml.fit(model, guess, gyroscope, method="RK4", dt=0.5)
        ... except ml.fitting.UndeterminedError as error:
        ...     print(error.result.rank, (error.result.values["a"] + error.result.values["b"]).round(6))
        3 [0.5 0.3 0.2]
    """

    def __init__(self, result: Fit):
        super().__init__(
            f"{result.message} The rms of the residuals is {result.rms:.3g} sigma; the values are in the attribute "
            "`result` of this error, or returned with require_rank=False."
        )
        self.result = result


def _message(plan: Plan, data: Data, estimate: Estimate, undetermined: str) -> str:
    """The text of `Fit.message`; `undetermined` is from `complaint`."""
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
    """The size of the residuals, and what to check; nothing if they can be noise."""
    listed = [of_which(m)[1] for m in data.measurements]
    dof, count = max(int(estimate.dof), 1), sum(int(np.sum(np.asarray(m.present))) for m in data.measurements)
    squares = count * estimate.rms**2
    if not jnp.isfinite(squares):
        return []
    check = "Check units, axes and times"
    if any(isinstance(m, Attitudes) for m in listed):
        check += ", and that quaternions are (w, x, y, z) from body to space"
    if plan.absolute_sigma:
        if within_sigmas(squares, jnp.asarray(dof, squares.dtype)):
            return []
        told = (
            f"the residuals are {float(estimate.rms):.3g} times the sigmas, which were given as known: the model "
            "leaves something out, such as a bias or a torque, or the sigmas are too small."
        )
        return [told, f"{check}."]
    loss = plan.problem.loss
    judged = estimate.residuals if loss is None else loss.judged(estimate.residuals)
    remainders = remainders_of(data.measurements, judged, estimate.values)
    if explained(remainders):
        return []
    # Measurements that cannot be noise on their own are listed first, then measurements with larger residuals.
    worst, kind = max(
        zip(remainders, listed, strict=True), key=lambda x: (bool(x[0].structured | x[0].turned), float(x[0].left))
    )
    share, of_what = worst.share()
    told = (
        f"the residuals, with an rms of {float(estimate.rms):.3g} sigma, cannot be noise: those of the "
        f"{type(kind).__name__} are {share:.0%} of {of_what}."
    )
    return [told, f"{check}. If noise is so large, give its sigmas and absolute_sigma=True."]


def _failed_run(plan: Plan, data: Data, estimate: Estimate) -> str:
    """The time at which the run of the best parameters failed, and a step that should work."""
    problem = plan.problem.single()
    if isinstance(problem.grid, Closed):
        return "the closed form of the free motion gave numbers that are not finite, or the times are too long for it"
    dt, method = problem.grid.dt, problem.method
    try:
        _, body, (_, paths), _ = problem.run(estimate.vector, data)
    except ValueError as error:
        return f"the model refuses the values at the end of the search: {error}"
    times, bad = np.asarray(paths.times[0]), int(paths.first_bad[0])
    if bad >= len(times):
        return "the model gives numbers that are not finite at a measured time, though its run is good; check the data."
    momenta = jax.tree.map(lambda x: x[0, : max(bad, 1)], paths.states.momentum)
    rates = jax.vmap(lambda momentum: jnp.linalg.norm(body.velocity(momentum)))(momenta)
    fastest = float(np.max(np.asarray(rates)[np.isfinite(rates)], initial=0.0))
    when = f"the run failed after t = {times[max(bad - 1, 0)]:.6g}"
    if math.isfinite(method.reach) and dt * fastest > method.reach * _SHARE:
        enough = method.reach * _SHARE / fastest
        unit = 10.0 ** math.floor(math.log10(enough))
        return (
            f"{when}: the body turns {dt * fastest:.3g} radians in a step, and {method.name} takes at most "
            f"{method.reach:.3g}; dt = {math.floor(enough / unit) * unit:g} would do, unless the guess makes the body "
            "turn too fast."
        )
    return f"{when}; try half the step, dt = {dt / 2:g}, and check that the guess is near."
