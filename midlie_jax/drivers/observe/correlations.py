"""`Autocorrelation`: how long a quantity of the bodies stays correlated with its past."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from ..._checks.arguments import as_count, described
from ..._math import components as cp
from ..._math.sums import total
from .series import Series
from .spread import Sums, mean_and_error, sums_of

_PIECE = 64  # times that are combined with all lags at once


class Correlation(NamedTuple):
    """Result of `Autocorrelation`.

    Attributes:
        lag: (lags + 1,), from 0, in units of time.
        correlation: (lags + 1,), in the square of the unit of x; without a unit if normalised.
        error: (lags + 1,), the standard error of the correlation, from its spread over the bodies; NaN for fewer than
            two bodies.
        number: (lags + 1,), number of bodies counted: bodies with values at two times separated by this lag.

    Examples:
        >>> x = np.random.default_rng(0).normal(size=(8, 100))  # of 8 bodies 100 values each
        >>> found = ml.observe.autocorrelation(x, lags=20, interval=0.5)
        >>> found.lag[-1].item(), found.correlation.shape, found.error.shape, found.number[0].item()
        (10.0, (21,), (21,), 8)
    """

    lag: Float[Array, "*batch lags"]
    correlation: Float[Array, "*batch lags"]
    error: Float[Array, "*batch lags"]
    number: Int[Array, "*batch lags"]


class Carried(NamedTuple):
    """The values carried for n bodies from one block of values to the next; m2 = m if the mean is removed, else 0.

    Attributes:
        counted: (n,), number of values counted.
        reference: (n, m2), the first value, which is subtracted from all.
        first, last: (n, lags, m2) and (n, lags, m), the first and the last values that counted.
        high, low: (n, lags + 1 + m2), the sums of the products and of the values, and the rounding errors of these
            sums.
    """

    counted: Array
    reference: Array
    first: Array
    last: Array
    high: Array
    low: Array


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
    """C(lag) is the mean of x(t) x(t + lag) over bodies and times t; for a vector, of x(t) . x(t + lag).

    Returns a `Correlation` for each array that the observable returns. An array counts as the vector of all its
    numbers; to get a correlation for each number, observe a dict. As usual in molecular dynamics (M. P. Allen and D. J.
    Tildesley, Computer Simulation of Liquids, 2017, section 8.2), no mean is removed, and each lag uses all available
    pairs of values. Only the values before the first bad state of a body count.

    The error assumes independent bodies, and nothing else: values of one body may be correlated.

    Attributes:
        observable: the observable x.
        lags: the largest lag, in intervals between saved values: lag k is the time k * save_every * abs(dt).
        centred: whether the mean of x over all bodies and times is removed first, which gives the autocovariance.
        normalised: whether C is divided by C(0); the error is then the error of the ratio.

    Raises:
        ValueError: `lags` is not a positive int; a driver raises it if the run has at most `lags` saved values.

    Examples:
        >>> body, start = ml.RigidBody([2.0, 2.0, 1.0]), ml.RigidState([1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0])
        >>> memory = ml.observe.Autocorrelation(ml.observe.Axis(), lags=20)
        >>> found = ml.integrate("SYMMETRIC[EA]", body, None, start, dt=0.1, steps=100, observe=memory).states
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
