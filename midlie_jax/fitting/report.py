"""`Fit`: the result of a fit with the names of its numbers; it prints as a table."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from .estimate import CONFIDENCE, Estimate
from .layout import Layout
from .measurements import Measurement
from .parameters import InertiaTensor, Moments, flatness

_FLAT = 1e-3  # of a share of I1 + I2 - I3 below this the optimum may not be reached, and the interval says nothing


class Fit:
    """The result of `midlie_jax.fit`.

    Attributes:
        estimate: all of it as arrays, see `Estimate`.
        values: the values of the parameters, of the structure of the guess.
        names: (k,), the names of the coordinates, such as "moments[0]".
        coordinates, covariance, intervals: (k,), (k, k) and (k, 2), see `Estimate`.
        rms: root mean square of the residuals over sigma; near 1 if model and sigmas are right.
        dof: degrees of freedom.
        steps: number of steps of the optimiser.
        rank, condition: of the Jacobian with columns of length one.
        confounded: the groups of unconstrained numbers that cannot be told apart; empty if all are determined.
        flat: the names of the inertias that the data hardly tell from that of a flat body.
        ok: whether the fit converged to determined parameters.
    """

    def __init__(
        self,
        estimate: Estimate,
        layout: Layout,
        measurements: tuple[Measurement, ...],
        confounded: list[list[str]],
        complaint: str,
    ):
        self.estimate, self.confounded, self.complaint = estimate, confounded, complaint
        self._layout, self._measurements = layout, measurements
        self.values: Any = estimate.values
        self.names = layout.names()
        self.coordinates, self.covariance, self.intervals = (
            np.asarray(x) for x in (estimate.coordinates, estimate.covariance, estimate.intervals)
        )
        self.rms, self.dof, self.steps = float(estimate.rms), int(estimate.dof), int(estimate.steps)
        self.rank, self.condition = int(estimate.spectrum.rank), float(estimate.spectrum.condition)
        self.ok = bool(estimate.ok)

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
    def flat(self) -> list[str]:
        """The names of the inertias that the data hardly tell from that of a flat body, I3 = I1 + I2.

        They are those whose I1 + I2 - I3 is less than twice the half width of its interval, or than 1e-3 of the sum.
        Such a body is the limit of the parameters: the optimiser goes on towards it in ever smaller steps and may end
        without having converged. Where the body is flat, make two `Positive` moments the parameters, and their sum the
        third.
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
            The quantity, and its interval with a last axis (2,). Where the data do not determine the quantity, the
            interval is infinite; a ratio of moments can be determined where the moments are not.
        """
        return derived(self.estimate, self._layout, function)

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
        state = "ok" if self.ok else "NOT ok: " + (self.complaint or "the optimiser did not converge, or a run failed")
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

    shape = np.shape(function(estimate.values))
    value, slopes = flat(estimate.vector), jax.jacfwd(flat)(estimate.vector)
    variance = np.asarray(jax.numpy.sum((slopes @ estimate.unconstrained) * slopes, axis=-1))
    unknown = np.asarray(estimate.spectrum.undetermined(slopes))
    half = np.where(unknown, np.inf, float(estimate.quantile) * np.sqrt(variance))
    centre = np.asarray(value)
    return centre.reshape(shape), np.stack([centre - half, centre + half], axis=-1).reshape(*shape, 2)
