"""The result of a fit as arrays: values with covariance, how the fit ended, and what the data determine.

The singular values of the Jacobian with columns of length one show what the data determine. A combination of
unconstrained numbers that changes no residual is a null vector, and its parameters are not identifiable.
"""

from collections.abc import Sequence
from enum import Enum
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components  # SciPy is a dependency of JAX

from .parameters import InertiaTensor, Moments, Parameter, UnitQuaternion

CONFIDENCE = 0.95
_SHARE = 0.1  # a number belongs to a null vector if its entry is at least this share of the largest


class Result(Enum):
    """How a fit ended, and what this means; `Fit.message` gives details of a particular fit.

    If several apply, the result is the first of RUN_FAILED, NOT_CONVERGED, MISFIT, UNDETERMINED.

    Examples:
        >>> ml.fitting.Result.NOT_CONVERGED.code, ml.fitting.Result.NOT_CONVERGED.value
        (2, 'the optimiser did not converge within its most steps')
    """

    FITTED = "the optimiser converged, the residuals can be noise, and the measurements determine all parameters"
    RUN_FAILED = "a run of the model failed: a solve, a turn too large for a step, or a number that is not finite"
    NOT_CONVERGED = "the optimiser did not converge within its most steps"
    UNDETERMINED = "the measurements do not determine all parameters"
    MISFIT = "the residuals cannot be noise: they exceed the known sigmas, or are not small relative to the signal"

    @property
    def code(self) -> int:
        """The number of this result in `Estimate.result`; 0 is FITTED."""
        return list(Result).index(self)

    @classmethod
    def of(cls, code: int) -> "Result":
        """The result for a number."""
        return list(cls)[code]


class Spectrum(NamedTuple):
    """The singular value decomposition of a Jacobian with columns of length one."""

    lengths: Float[Array, " p"]  # the original lengths of the columns; one where a column is zero
    singular: Float[Array, " p"]  # the singular values, descending
    directions: Float[Array, "p p"]  # the right singular vectors, one per row
    determined: Bool[Array, " p"]  # whether each singular value exceeds rounding

    @classmethod
    def of(cls, jacobian: Float[Array, "r p"]) -> "Spectrum":
        lengths = lengths_of(jacobian)
        _, singular, directions = jnp.linalg.svd(jacobian / lengths[None], full_matrices=False)
        smallest = jnp.finfo(jacobian.dtype).eps ** (2 / 3) * jnp.maximum(singular[0], jnp.ones_like(singular[0]))
        return cls(lengths, singular, directions, singular > smallest)

    @property
    def rank(self) -> Int[Array, ""]:
        """The number of combinations of parameters that the data determine."""
        return jnp.sum(self.determined)

    @property
    def condition(self) -> Float[Array, ""]:
        """The largest singular value over the smallest; infinite where the rank is not full."""
        full, last = self.determined[-1], self.singular[-1]
        return jnp.where(full, self.singular[0] / jnp.where(full, last, 1.0), jnp.inf)

    def covariance(self) -> Float[Array, "p p"]:
        """(J^T J)^-1 of the unconstrained numbers on the combinations that are determined; zero on the others."""
        inverse = jnp.where(self.determined, 1 / jnp.where(self.determined, self.singular, 1.0), 0.0)
        half = inverse[:, None] * self.directions / self.lengths[None]
        return half.T @ half

    def undetermined(self, slopes: Float[Array, "k p"]) -> Bool[Array, " k"]:
        """Which quantities change along a null vector, from their derivatives by the unconstrained numbers."""
        scaled = slopes / self.lengths[None]
        along = jnp.sum(jnp.where(self.determined[None], 0.0, (scaled @ self.directions.T) ** 2), axis=-1)
        whole = jnp.sum(scaled**2, axis=-1)
        return along > jnp.finfo(slopes.dtype).eps ** (2 / 3) * whole


def lengths_of(jacobian: Float[Array, "r p"]) -> Float[Array, " p"]:
    """The lengths of the columns, one where a column is zero."""
    lengths = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    return jnp.where(lengths == 0, jnp.ones_like(lengths), lengths)


class Estimate(eqx.Module):
    """The best-fit parameters, and how well the data determine them; with leading axes for many data sets.

    Attributes:
        vector: (p,), the unconstrained numbers.
        values: the physical values, of the structure of the guess.
        coordinates: (k,), the physical numbers of all values in one vector.
        covariance: (k, k), of the coordinates, to first order; infinite for coordinates that the data do not determine.
        intervals: (k, 2), the 95 % confidence intervals of the coordinates.
        residuals: (r,), model minus measurement over sigma; zero where a measurement is missing.
        rms: the root mean square of the residuals that are present; with a loss, of `Loss.judged`.
        dof: the number of residuals that are present, minus the number of unknowns.
        quantile: half the width of an interval over the standard deviation.
        unconstrained: (p, p), the covariance of the combinations of unconstrained numbers that are determined.
        spectrum: singular values and vectors of the Jacobian.
        steps: the number of steps of the optimiser.
        converged: whether the optimiser converged and every step of the run was good.
        result: how the fit ended, the `code` of a `Result`; 0 where `ok`.

    Examples:
        >>> model = lambda values: (ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"]))
        >>> gyroscope = ml.fitting.Rates(np.arange(5.0), np.tile([0.5, 0.3, 0.2], (5, 1)), sigma=1e-3)
        >>> guess = {"momentum": ml.fitting.Free([0.4, 0.4, 0.1])}
        >>> plan = ml.fitting.prepare(model, guess, gyroscope, method="RK4", dt=0.5)
        >>> found = jax.eval_shape(lambda: ml.fitting.fit_arrays(plan, guess, gyroscope))  # the shapes alone
        >>> found.values["momentum"].shape, found.covariance.shape, found.intervals.shape
        ((3,), (3, 3), (3, 2))
    """

    vector: Float[Array, "*batch p"]
    values: Any
    coordinates: Float[Array, "*batch k"]
    covariance: Float[Array, "*batch k k"]
    intervals: Float[Array, "*batch k 2"]
    residuals: Float[Array, "*batch r"]
    rms: Float[Array, "*batch"]
    dof: Int[Array, "*batch"]
    quantile: Float[Array, "*batch"]
    unconstrained: Float[Array, "*batch p p"]
    spectrum: Spectrum
    steps: Int[Array, "*batch"]
    converged: Bool[Array, "*batch"]
    result: Int[Array, "*batch"]
    ok: Bool[Array, "*batch"]


def confounded(spectrum: Spectrum, names: Sequence[str], typical: Any = None) -> list[list[str]]:
    """The groups of numbers that are not identifiable; a group of one name is a number without any effect.

    They are found from the matrix that projects on the space of the null vectors. Two numbers belong together if their
    common entry is not small relative to their diagonal entries. Numbers are measured by how much they change the
    residuals, and in units of `typical`: of moments that can change by a common factor, one may count little in the
    first way, but all count equally in the second.
    """
    null = np.asarray(spectrum.directions)[~np.asarray(spectrum.determined)]
    changes = null / np.asarray(spectrum.lengths) / (np.ones(len(names)) if typical is None else np.asarray(typical))
    together = _linked(null) | _linked(changes)
    inside = np.flatnonzero(np.diagonal(together))
    count, group = connected_components(together[np.ix_(inside, inside)], directed=False)
    return [[str(names[i]) for i in inside[group == k].tolist()] for k in range(count)]


def _linked(vectors: np.ndarray) -> np.ndarray:
    """(p, p), which pairs of numbers belong together in the span of vectors (m, p); diagonal: which are in it."""
    basis = np.linalg.qr(vectors.T)[0]
    projection = basis @ basis.T
    own = np.sqrt(np.diagonal(projection))
    inside = own > _SHARE * max(own.max(initial=0.0), 0.1)
    return (np.abs(projection) > _SHARE * np.outer(own, own)) & np.outer(inside, inside)


def complaint(groups: list[list[str]], named: Sequence[tuple[str, Parameter]]) -> str:
    """What cannot be determined, and the remedy, as a message; "" if everything is determined."""
    if not groups:
        return ""
    told = "; ".join(
        f"{group[0]} has no effect on them" if len(group) == 1 else f"{', '.join(group)} cannot be told apart"
        for group in groups
    )
    cures = dict.fromkeys(_cure(group, named) for group in groups)
    return f"the measurements do not determine all parameters: {told}. {' '.join(cures)}"


def _cure(group: list[str], named: Sequence[tuple[str, Parameter]]) -> str:
    inside = [(name, p) for name, p in named if any(f"{name}{label}" in group for label in p.unconstrained_labels())]
    for name, parameter in inside:
        if isinstance(parameter, UnitQuaternion):
            return (
                "Angular velocities do not determine an attitude, and one direction in space leaves the rotation about "
                f"it open. Fix {name}: make it a known quaternion inside the model; or, with one direction, start the "
                "model from a DirectionState whose direction is a UnitVector; or add Attitudes, Positions, or "
                "Directions with another reference."
            )
    if any(isinstance(p, Moments | InertiaTensor) and p.scale == "free" for _, p in inside):
        return (
            "Without a known torque that does not grow with the moments, data give their ratios only: fix the scale, "
            'such as Moments(..., scale="fixed"), and make the initial angular velocity a parameter instead of the '
            "momentum."
        )
    return "Make one of them a known number inside the model, or add measurements that depend on them differently."
