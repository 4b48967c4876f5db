"""`Susceptibility`: the response of a quantity to a weak field, from its fluctuations."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from ..._checks.arguments import as_count, as_floats, require
from .correlations import Carried, Products
from .spread import Sums, mean_and_error, sums_of


class Response(NamedTuple):
    """Result of `Susceptibility`.

    Attributes:
        frequency: (lags + 1,), angular frequency, from 0 to pi / interval, in radians per unit of time.
        real, imag: (lags + 1,), chi' and chi''; chi = chi' + i chi''.
        real_error, imag_error: (lags + 1,), standard errors, from the spread over the bodies; NaN for fewer than two
            bodies.
        number: (lags + 1,), number of bodies counted: bodies with more than `lags` values.

    Examples:
        >>> values = jnp.asarray(np.random.default_rng(0).normal(size=(8, 100)))  # of 8 bodies 100 values each
        >>> response = ml.observe.Susceptibility(ml.observe.energy, lags=20, kT=0.5)  # given to a run as observe=
        >>> found = response.of_bodies(values, jnp.ones((8, 100), bool), jnp.asarray(0.1))
        >>> found.real.shape, found.imag[0].item(), found.number[0].item()
        ((21,), 0.0, 8)
    """

    frequency: Float[Array, "*batch f"]
    real: Float[Array, "*batch f"]
    imag: Float[Array, "*batch f"]
    real_error: Float[Array, "*batch f"]
    imag_error: Float[Array, "*batch f"]
    number: Int[Array, "*batch f"]


class Susceptibility(Products):
    """chi(omega) of x under an energy -x f(t), by the fluctuation-dissipation theorem (R. Kubo 1957).

    With the autocorrelation C, chi = -(1/kT) times the integral of C'(t) exp(i omega t) over t > 0, with C linear
    between the lags. A constant in C, such as the square of a mean, has no effect. C must have decayed at the largest
    lag. For a vector, chi is the sum over its components: three times chi of one component if all directions are
    equal. The error is exact for independent bodies, although values at different lags are correlated.

    Attributes:
        observable: the observable x.
        lags: the largest lag, in intervals between saved values, and the number of frequencies above zero.
        kT: the temperature in units of energy, ().

    Raises:
        ValueError: as for `Autocorrelation`; or a temperature that is not one positive number.

    Examples:
        >>> start = ml.RigidState(jnp.zeros((4, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (4, 1)))
        >>> bath = ml.baths.Langevin(1.0, 1.0, jax.random.split(jax.random.key(0), 4))
        >>> debye = ml.observe.Susceptibility(ml.observe.Axis(), 100, kT=1.0)
        >>> run = {"dt": 0.05, "steps": 400, "save_every": 1, "observe": debye, "bath": bath}
        >>> found = ml.ensemble("BROWNIAN", ml.RigidBody([1.0, 1.0, 1.0]), None, start, **run).states
        >>> found.imag.shape, found.imag_error.shape, round(float(found.frequency[-1] * 0.05), 4)
        ((101,), (101,), 3.1416)
    """

    fields = Response._fields
    kT: Array

    def __init__(self, observable: Any, lags: int, *, kT: Any):
        self.observable, self.lags, self.centred = observable, as_count("lags", lags), False
        self.kT = as_floats("kT", kT)
        if self.kT.shape:
            raise ValueError(f"kT must be a number, got shape {self.kT.shape}.")
        require("kT", self.kT, lambda x: np.isfinite(x) & (x > 0), "must be positive", "check its sign and its unit.")

    def _sums(self, carried: Carried, counted: Array) -> Sums:
        products, none, pairs, *mean = self._terms(carried, counted)
        whole = jnp.all(pairs > 0, axis=0)
        correlations = jnp.where(whole, products / jnp.where(pairs > 0, pairs, 1), 0)
        steps = correlations[:-1] - correlations[1:]
        rows = jnp.asarray(_weights(self.lags), steps.dtype)
        response = jax.lax.map(lambda row: jnp.sum(row[:, None] * steps, axis=0), rows)
        terms = jnp.broadcast_to(whole.astype(steps.dtype), response.shape)
        return sums_of(response, jnp.zeros((len(response), *none.shape[1:]), steps.dtype), terms, *mean, relative=False)

    def of_sums(self, sums: Sums, interval: Array) -> Response:
        value, error = (x / self.kT.astype(x.dtype) for x in mean_and_error(sums, relative=False))
        rows = self.lags + 1
        frequency = jnp.arange(rows, dtype=jnp.int32).astype(value.dtype) * (jnp.pi / self.lags)
        parts = value[:rows], value[rows:], error[:rows], error[rows:]
        return Response(frequency / interval.astype(value.dtype), *parts, sums.number[:rows])


def _weights(lags: int) -> np.ndarray:
    """Real and imaginary parts, (2 lags + 2, lags), of the mean of exp(i omega t) between two lags, by frequency."""
    angle = np.pi * np.arange(lags + 1)[:, None] / lags
    means = np.exp(1j * angle * (np.arange(lags) + 0.5)) * np.sinc(angle / (2 * np.pi))
    return np.concatenate([means.real, means.imag])
