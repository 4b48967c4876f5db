"""`Autocorrelation`, how long a quantity stays correlated, and `Susceptibility`, its response to a weak field."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from ..._checks.arguments import as_count, as_floats, described, require
from ..._math import components as cp
from ..._math.sums import total
from .series import Series, Sums, mean_and_error, of_values, sums_of, unused

_PIECE = 64  # times that are combined with all lags at once


class Correlation(NamedTuple):
    """Result of `Autocorrelation`; all are (lags + 1,).

    Attributes:
        lag: from 0, in units of time.
        correlation: in the square of the unit of x; without a unit if normalised.
        error: the standard error of the correlation, from its spread over the bodies; NaN for fewer than two bodies.
        number: number of bodies counted: bodies with values at two times separated by this lag.

    Examples:
        >>> found = ml.observe.autocorrelation(np.ones((8, 100)), lags=20, interval=0.5)  # of 8 bodies 100 values each
        >>> found.lag[-1].item(), found.correlation.shape, found.error.shape, found.number[0].item()
        (10.0, (21,), (21,), 8)
    """

    lag: Float[Array, "*batch lags"]
    correlation: Float[Array, "*batch lags"]
    error: Float[Array, "*batch lags"]
    number: Int[Array, "*batch lags"]


class Carried(NamedTuple):
    """The values carried for n bodies from one block of values to the next; m2 = m if the mean is removed, else 0."""

    counted: Array  # (n,), number of values counted
    reference: Array  # (n, m2), the first value, which is subtracted from all
    first: Array  # (n, lags, m2), the first values that counted
    last: Array  # (n, lags, m)
    high: Array  # (n, lags + 1 + m2), the sums of the products and of the values
    low: Array  # the rounding errors of these sums


class Products(Series):
    """Sums of x(t) x(t + lag) of each body; attributes as for `Autocorrelation`."""

    lags: int = eqx.field(static=True)
    centred: bool = eqx.field(static=True)

    def check(self, saves: int | None) -> None:
        if saves is None:
            raise ValueError("a correlation needs values at several times; give save_every.")
        if self.lags >= saves:
            raise ValueError(
                f"lags ({self.lags}) must be less than the number of saved values ({saves}); take fewer lags, a "
                "smaller save_every or more steps."
            )

    def _begun(self, bodies: int, x: Any) -> Carried:
        removed = x.size if self.centred else 0
        last, sums = (bodies, self.lags, x.size), (bodies, self.lags + 1 + removed)
        shapes = (bodies, removed), (bodies, self.lags, removed), last, sums, sums
        return Carried(jnp.zeros(bodies, jnp.int32), *(jnp.zeros(shape, x.dtype) for shape in shapes))

    def _taken(self, before: Carried, x: Array, good: Array) -> Carried:
        n, k, m = x.shape
        size = min(k, _PIECE)
        pieces = -(-k // size)
        fill = pieces * size - k
        x = jnp.pad(x, [(0, 0), (0, fill), (0, 0)]).reshape(n, pieces, size, m)
        good = jnp.pad(good, [(0, 0), (0, fill)]).reshape(n, pieces, size)
        by_piece = jnp.moveaxis(x, 1, 0), jnp.moveaxis(good, 1, 0)
        return jax.lax.scan(lambda carried, piece: (self._piece_taken(carried, *piece), None), before, by_piece)[0]

    def _piece_taken(self, before: Carried, x: Array, good: Array) -> Carried:
        reference, first = before.reference, before.first
        if self.centred:
            begins = (before.counted == 0) & good[:, 0]
            reference = jnp.where(begins[:, None], x[:, 0], reference)
            x = x - reference[:, None]
        x = jnp.where(good[..., None], x, 0)
        seen = jnp.concatenate([before.last, x], axis=1)
        columns = jnp.moveaxis(seen, 0, -1)  # the bodies come last, so that each lag adds long contiguous rows
        later = columns[self.lags :]

        def of_lag(lag: Array) -> Array:
            earlier = jax.lax.dynamic_slice_in_dim(columns, self.lags - lag, len(later))
            return total(jnp.sum(later * earlier, axis=1))

        added = jax.lax.map(of_lag, jnp.arange(self.lags + 1, dtype=jnp.int32))
        if self.centred:
            added = jnp.concatenate([added, total(later)])
            places = jnp.arange(self.lags, dtype=jnp.int32)[None] - before.counted[:, None]
            new = jnp.take_along_axis(x, jnp.clip(places, 0, x.shape[1] - 1)[..., None], axis=1)
            first = jnp.where(((places >= 0) & (places < x.shape[1]))[..., None], new, first)
        (high,), (low,) = cp.compensated((before.high,), (before.low,), (added.T,))
        counted = jnp.sum(good, axis=1, dtype=jnp.int32)
        places = counted[:, None] + jnp.arange(self.lags, dtype=jnp.int32)[None]
        last = jnp.take_along_axis(seen, places[..., None], axis=1)
        return Carried(before.counted + counted, reference, first, last, high, low)

    def _terms(self, carried: Carried, counted: Array) -> tuple[Array, Array, Array, Array, Array]:
        """The arguments of `sums_of` but the last."""
        dtype = carried.high.dtype
        count = jnp.where(counted, carried.counted, 0)
        found = jnp.where(counted[:, None], carried.high + carried.low, 0).T
        terms = jnp.maximum(count[None] - jnp.arange(self.lags + 1, dtype=jnp.int32)[:, None], 0).astype(dtype)
        s, sum_of_all = found[: self.lags + 1], found[self.lags + 1 :]  # of x - reference
        a = jnp.where(terms[:, None] > 0, 2 * sum_of_all[None] - self._left_out(carried), 0)
        values = count.astype(dtype)
        weight = total(values)
        reference = carried.reference.T
        mean = total(values[None] * reference + sum_of_all, -1) / jnp.maximum(weight, 1)
        shift = jnp.where(counted[None], mean[:, None] - reference, 0)  # (m, bodies)
        s = s - jnp.sum(shift[None] * a, axis=1) + terms * jnp.sum(shift**2, axis=0)[None]
        a = a - 2 * terms[:, None] * shift[None]
        return s, a, terms, mean, weight

    def _left_out(self, carried: Carried) -> Array:
        """(lags + 1, m2, n): the sums of the values that are no later factor, and of values that are no earlier one."""
        last = carried.last[..., : carried.first.shape[-1]]
        ends = jnp.cumsum(carried.first, axis=1) + jnp.cumsum(last[:, ::-1], axis=1)
        return jnp.moveaxis(jnp.pad(ends, [(0, 0), (1, 0), (0, 0)]), 0, -1)


class Autocorrelation(Products):
    """C(lag) is the mean of x(t) x(t + lag) over bodies and times t, of an observable x; for vectors x(t) . x(t + lag).

    Returns a `Correlation` for each array that the observable returns. An array counts as the vector of all its
    numbers; to get a correlation for each number, observe a dict. As usual in molecular dynamics (M. P. Allen and D. J.
    Tildesley, Computer Simulation of Liquids, 2017, section 8.2), no mean is removed, and each lag uses all available
    pairs of values, up to the first bad state of a body. The error assumes independent bodies only: values of one body
    may be correlated.

    Attributes:
        lags: the largest lag, in intervals save_every * abs(dt) between saved values.
        centred: whether the mean of x over all bodies and times is removed first, which gives the autocovariance.
        normalised: whether C is divided by C(0); the error is then the error of the ratio.

    Raises:
        ValueError: `lags` is not a positive int, or a run has at most `lags` saved values.

    Examples:
        >>> memory = ml.observe.Autocorrelation(ml.observe.Axis(), lags=20)
        >>> found = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100, observe=memory).states
        >>> found.correlation.shape, round(float(found.correlation[0]), 6)  # axes have length 1
        ((21,), 1.0)
    """

    fields = Correlation._fields
    normalised: bool = eqx.field(static=True)

    def __init__(self, observable: Any, lags: int, *, centred: bool = False, normalised: bool = False):
        self.observable, self.lags = observable, as_count("lags", lags)
        for name, value in (("centred", centred), ("normalised", normalised)):
            if not isinstance(value, bool):
                raise ValueError(f"{name} must be True or False, got {described(value)}.")
        self.centred, self.normalised = centred, normalised

    def _sums(self, carried: Carried, counted: Array) -> Sums:
        return sums_of(*self._terms(carried, counted), relative=self.normalised)

    def of_sums(self, sums: Sums, interval: Array) -> Correlation:
        value, error = mean_and_error(sums, relative=self.normalised)
        lag = jnp.arange(self.lags + 1, dtype=jnp.int32).astype(value.dtype) * interval.astype(value.dtype)
        return Correlation(lag, value, error, sums.number)


def autocorrelation(
    values: Any,
    lags: int,
    *,
    interval: Any = 1.0,
    first_bad: Any = None,
    centred: bool = False,
    normalised: bool = False,
) -> Correlation:
    """The autocorrelation of saved values, as computed by `Autocorrelation` during a run.

    Args:
        values: (n, k) or (n, k, m): k consecutive values of each of n bodies, numbers or vectors.
        lags, centred, normalised: as for `Autocorrelation`.
        interval: the time between two values, ().
        first_bad: (n,), the number of values of each body that count, as in `Path.first_bad`; by default all.

    Raises:
        ValueError: an argument does not fit.

    Examples:
        >>> x = np.cos(np.pi * np.arange(100.0) / 4) * np.ones((8, 1))  # (bodies, times), a wave of 8 values
        >>> found = ml.observe.autocorrelation(x, lags=20, interval=0.5)
        >>> found.lag[8].item(), round(float(found.correlation[8]), 2)
        (4.0, 0.5)
    """
    statistic = Autocorrelation(unused, lags, centred=centred, normalised=normalised)
    return of_values(statistic, values, interval, first_bad)


class Response(NamedTuple):
    """Result of `Susceptibility`; all are (lags + 1,).

    Attributes:
        frequency: angular frequency, from 0 to pi / interval, in radians per unit of time.
        real, imag: chi' and chi''; chi = chi' + i chi''.
        real_error, imag_error: standard errors, as for `Correlation`.
        number: number of bodies counted: bodies with more than `lags` values.

    Examples:
        >>> response = ml.observe.Susceptibility(ml.observe.Axis(), lags=20, kT=0.5)
        >>> found = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100, observe=response).states
        >>> found.real.shape, found.imag[0].item(), found.number[0].item()
        ((21,), 0.0, 1)
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
        lags: as for `Autocorrelation`; also the number of frequencies above zero.
        kT: the temperature in units of energy, ().

    Raises:
        ValueError: as for `Autocorrelation`; or a temperature that is not one positive number.

    Examples:
        >>> debye = ml.observe.Susceptibility(ml.observe.Axis(), 100, kT=1.0)
        >>> run = {"dt": 0.05, "steps": 400, "observe": debye, "bath": ml.baths.Langevin(1.0, 1.0, jax.random.key(0))}
        >>> found = ml.integrate("BROWNIAN", ml.RigidBody([1.0, 1.0, 1.0]), None, start, **run).states
        >>> found.imag.shape, round(float(found.frequency[-1] * 0.05), 4)
        ((101,), 3.1416)
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
