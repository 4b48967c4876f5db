"""`Estimate`: the result of a fit as arrays, for one data set or, with leading axes, for many."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri, stdtrit  # SciPy comes with JAX

from .identifiability import Spectrum
from .misfit import explained, remainders_of, within_sigmas
from .residuals import Data
from .result import code_of

CONFIDENCE = 0.95


class Estimate(eqx.Module):
    """The parameters that fit best, and how well the data determine them.

    Attributes:
        vector: (p,), the unconstrained numbers.
        values: the physical values, a pytree of the structure of the guess.
        coordinates: (k,), the physical numbers of all values in one vector.
        covariance: (k, k), of the coordinates, to first order; infinite for coordinates that the data do not determine.
        intervals: (k, 2), the 95 % confidence intervals of the coordinates.
        residuals: (r,), model minus measurement over sigma; zero where a measurement is missing.
        rms: the root mean square of the residuals that are present.
        dof: the number of residuals that are present, minus the number of unconstrained numbers.
        quantile: half the width of an interval over the standard deviation.
        unconstrained: (p, p), the covariance of the unconstrained numbers, restricted to the combinations that are
            determined.
        spectrum: singular values and vectors of the Jacobian, see `Spectrum`.
        steps: the number of steps of the optimiser.
        converged: whether the optimiser converged and every step of the run was good.
        result: how the fit ended, the `code` of a `Result`.
        ok: whether it ended as it should: `result` is 0.

    Examples:
        >>> def model(values):  # values of the parameters -> body, torque, start
        ...     return ml.RigidBody([1.0, 1.0, 1.0]), None, ml.MomentumState(values["momentum"])
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


def estimate_at(
    data: Data,
    vector: Float[Array, " p"],
    residuals: tuple[Float[Array, " r"], Bool[Array, ""], Float[Array, "n p"]],
    steps: Array,
    converged: Array,
    absolute_sigma: bool,
) -> Estimate:
    """The estimate for a vector at which the sum of squares has a minimum.

    Args:
        data: the data, without multiple shooting.
        vector: (p,), the unconstrained numbers.
        residuals: the residuals at the vector, whether every step of the run was good, and the Jacobian or its factor
            R.
        steps, converged: how many steps the optimiser took, and whether it converged.
        absolute_sigma: whether the sigmas of the measurements are known; otherwise they are known up to a common
            factor, which is estimated from the residuals.
    """
    found, good, jacobian = residuals
    spectrum = Spectrum.of(jacobian)
    present = jnp.concatenate([m.present.reshape(-1) for m in data.measurements])
    count, squares = jnp.sum(present), jnp.sum(found**2)
    dof = count - vector.size
    one = jnp.ones_like(squares)
    spread = one if absolute_sigma else squares / jnp.maximum(dof, 1).astype(one.dtype)
    unconstrained = spread * spectrum.covariance()
    slopes = jax.jacfwd(data.layout.coordinates)(vector)
    covariance = slopes @ unconstrained @ slopes.T
    unknown = spectrum.undetermined(slopes)
    covariance = jnp.where(unknown[:, None] | unknown[None, :], jnp.full_like(covariance, jnp.inf), covariance)
    good = good & jnp.all(jnp.isfinite(found))
    enough = jnp.maximum(dof, 1).astype(one.dtype)
    values = data.layout.values(vector)
    if absolute_sigma:
        fits = within_sigmas(squares, enough)
    else:
        fits = explained(remainders_of(data.measurements, found, values))
    result = code_of(good, converged, fits, jnp.all(spectrum.determined) & (dof >= 1))
    quantile = one * ndtri(0.5 + CONFIDENCE / 2) if absolute_sigma else _quantile(dof, found.size, one)
    coordinates = data.layout.coordinates(vector)
    half = quantile * jnp.sqrt(jnp.diagonal(covariance))
    return Estimate(
        vector=vector,
        values=values,
        coordinates=coordinates,
        covariance=covariance,
        intervals=jnp.stack([coordinates - half, coordinates + half], axis=-1),
        residuals=found,
        rms=jnp.sqrt(squares / count.astype(one.dtype)),
        dof=dof,
        quantile=quantile,
        unconstrained=unconstrained,
        spectrum=spectrum,
        steps=steps,
        converged=converged & good,
        result=result,
        ok=result == 0,
    )


def _quantile(dof: Array, most: int, one: Array) -> Array:
    """Student's t quantile of the intervals, from a table of all degrees of freedom that can occur."""
    table = np.concatenate([[np.inf], stdtrit(np.arange(1, most + 1), 0.5 + CONFIDENCE / 2)])
    return jnp.asarray(table, one.dtype)[jnp.clip(dof, 0, most)]
