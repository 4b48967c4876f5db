"""`Fit`: the result of a fit with the names of its numbers; it prints as a table."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from .._checks.arguments import as_count
from .doubts import Doubt, doubts
from .estimate import CONFIDENCE, Estimate
from .layout import Layout
from .measurements import Measurement
from .parameters import InertiaTensor, Moments, flatness
from .result import Result

_FLAT = 1e-3  # if I1 + I2 - I3 is a smaller share of the sum, the optimum may not be reached, nor its interval valid


class Fit:
    """The result of `midlie_jax.fit`.

    Attributes:
        estimate: the whole result as arrays, see `Estimate`.
        values: the values of the parameters, of the structure of the guess.
        names: (k,), the names of the coordinates, such as "moments[0]".
        coordinates, covariance, intervals: (k,), (k, k) and (k, 2), see `Estimate`.
        rms: root mean square of the residuals over sigma; near 1 if model and sigmas are right.
        dof: degrees of freedom.
        steps: number of steps of the optimiser.
        rank, condition: those of the Jacobian with columns of length one.
        confounded: the groups of unconstrained numbers that cannot be told apart; empty if all are determined.
        aliases: how often the body turns between rows, if by more than half a revolution, so that other values may fit
            as well; "" otherwise.
        flat: the names of the inertias that the data hardly distinguish from the inertia of a flat body.
        ok: whether the fit ended as it should: `result` is `Result.FITTED`.
        result: how the fit ended, a `Result`.
        message: what went wrong, with the time, the names or the numbers, and a cure.

    Examples:
        >>> def model(values):  # values of the parameters -> body, torque, start
        ...     return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"])
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> result = ml.fit(model, guess, gyroscope, method="RK4", dt=0.5)  # print it for a table
        >>> result.ok, result.names, result.intervals.shape
        (True, ['momentum[0]', 'momentum[1]', 'momentum[2]'], (3, 2))
    """

    def __init__(
        self,
        estimate: Estimate,
        layout: Layout,
        measurements: tuple[Measurement, ...],
        confounded: list[list[str]],
        message: str,
        aliases: str = "",
    ):
        self.estimate, self.confounded, self.message, self.aliases = estimate, confounded, message, aliases
        self._layout, self._measurements = layout, measurements
        self.values: Any = estimate.values
        self.names = layout.names()
        self.coordinates, self.covariance, self.intervals = (
            np.asarray(x) for x in (estimate.coordinates, estimate.covariance, estimate.intervals)
        )
        self.rms, self.dof, self.steps = float(estimate.rms), int(estimate.dof), int(estimate.steps)
        self.rank, self.condition = int(estimate.spectrum.rank), float(estimate.spectrum.condition)
        self.result = Result.of(int(estimate.result))
        self.ok = self.result is Result.FITTED

    def residuals(self) -> list[np.ndarray]:
        """The residuals over sigma of each measurement, of the shape of its `present`; NaN where missing."""
        found: list[np.ndarray] = []
        flat, begin = np.asarray(self.estimate.residuals), 0
        for m in self._measurements:
            present = np.asarray(m.present)
            found.append(np.where(present, flat[begin : begin + present.size].reshape(present.shape), np.nan))
            begin += present.size
        return found

    @property
    def doubts(self) -> list[str]:
        """Why the values or the intervals may be wrong even if `ok` is True; empty if nothing speaks against them.

        It names all values that are far off the others; neighbouring residuals that are correlated, and the factor by
        which this makes the intervals too narrow; and rows so far apart that other values may fit as well.
        """
        return [doubt.text for doubt in self.doubtful()]

    def doubtful(self) -> list[Doubt]:
        """The doubts with the measurement and the rows that each concerns."""
        found = doubts(self.residuals(), self._measurements)
        return [*found, Doubt(self.aliases, None)] if self.aliases else found

    @property
    def flat(self) -> list[str]:
        """The names of the inertias that the data hardly distinguish from the inertia of a flat body, I3 = I1 + I2.

        For these, I1 + I2 - I3 is less than the width of its interval, or than 1e-3 of the sum of the moments. A flat
        body is a limit that the parameters cannot reach: the optimiser approaches it in ever smaller steps and may end
        without having converged. If the body is flat, make two `Positive` moments the parameters, and their sum the
        third moment.
        """
        found: list[str] = []
        for place, (name, parameter) in enumerate(self._layout.named()):
            if isinstance(parameter, Moments | InertiaTensor):
                gap, (low, _) = self.derived(lambda values, i=place: flatness(jax.tree.leaves(values)[i]))
                if gap < max(_FLAT, 2 * (gap - low)):
                    found.append(name)
        return found

    def derived(self, function: Callable[[Any], Any]) -> tuple[np.ndarray, np.ndarray]:
        """A quantity that depends on the parameters, and its 95 % interval to first order.

        Args:
            function: from `values` to an array of any shape, for example a ratio of two moments.

        Returns:
            The quantity, and its interval with a last axis (2,). The interval is infinite if the data do not determine
            the quantity; they may determine a ratio of moments and not the moments.
        """
        return derived(self.estimate, self._layout, function)

    def draws(self, count: int, seed: int = 0) -> Any:
        """Values that the data allow, for what is predicted from them: `jax.vmap(predicted)(result.draws(1000))`.

        They are drawn from a normal distribution of the unconstrained numbers about the estimate, with the covariance
        of the fit: right to first order, as the intervals are. Where sigmas are estimated from few data, the intervals,
        by Student's t, are wider than these draws.

        Args:
            count: how many are drawn.
            seed: of NumPy's generator.

        Returns:
            The values, of the structure of the guess, with a leading axis (count,).

        Raises:
            ValueError: count is no positive int, or the data do not determine all parameters.
        """
        if self.rank < self._layout.size:
            raise ValueError(
                f"the data determine {self.rank} of {self._layout.size} unknowns, so the others could be anything; fix "
                "some, or use `derived` for what is determined."
            )
        estimate = self.estimate
        root = np.linalg.cholesky(np.asarray(estimate.unconstrained))
        offsets = np.random.default_rng(seed).standard_normal((as_count("count", count), len(root))) @ root.T
        vectors = estimate.vector[None] + jax.numpy.asarray(offsets, estimate.vector.dtype)
        return jax.jit(jax.vmap(self._layout.values))(vectors)

    def __str__(self) -> str:
        deviations = np.sqrt(np.diagonal(self.covariance))
        heads = ["parameter", "estimate", "std. deviation", f"{CONFIDENCE:.0%} interval"]
        rows = [
            [name, f"{x:.10g}", f"{s:.2g}", f"[{low:.10g}, {high:.10g}]"]
            for name, x, s, (low, high) in zip(self.names, self.coordinates, deviations, self.intervals, strict=True)
        ]
        widths = [max(len(row[i]) for row in [heads, *rows]) for i in range(4)]
        lines = [
            "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [heads, *rows]
        ]
        lines.insert(1, "  ".join("-" * w for w in widths))
        if flat := self.flat:
            lines.append(f"{', '.join(flat)}: the data hardly tell this body from a flat one, see Fit.flat")
        lines += [f"doubtful: {doubt}" for doubt in self.doubts]
        state = "NOT ok: " + self.message if not self.ok else "doubtful" if self.doubts else "ok"
        lines.append(
            f"rms of residuals / sigma {self.rms:.4g}, {self.dof} degrees of freedom, {self.steps} steps, "
            f"rank {self.rank} of {self._layout.size}, condition {self.condition:.2g}; {state}"
        )
        return "\n".join(lines)

    __repr__ = __str__


def derived(estimate: Estimate, layout: Layout, function: Callable[[Any], Any]) -> tuple[np.ndarray, np.ndarray]:
    """See `Fit.derived`."""

    def flat(vector: jax.Array) -> jax.Array:
        return function(layout.values(vector)).reshape(-1)

    @jax.jit  # one small program instead of one for each operation
    def both(vector: jax.Array) -> tuple[jax.Array, jax.Array]:
        return flat(vector), jax.jacfwd(flat)(vector)

    shape = jax.eval_shape(function, estimate.values).shape
    centre, slopes = (np.asarray(x) for x in both(estimate.vector))
    variance = np.sum((slopes @ np.asarray(estimate.unconstrained)) * slopes, axis=-1)
    unknown = np.asarray(estimate.spectrum.undetermined(jax.numpy.asarray(slopes)))
    half = np.where(unknown, np.inf, float(estimate.quantile) * np.sqrt(variance))
    return centre.reshape(shape), np.stack([centre - half, centre + half], axis=-1).reshape(*shape, 2)
