"""`Autocorrelation`: how long a quantity of the bodies remembers what it was."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from ..._checks.arguments import as_count, described
from ..._math import components as cp
from ..._math.sums import blocks, total
from .series import Series
from .spread import Sums, mean_and_error, sums_of


class Correlation(NamedTuple):
    """What `Autocorrelation` finds.

    Attributes:
        lag: (lags + 1,), from 0, in units of time.
        correlation: (lags + 1,), in the square of the unit of x; without a unit if normalised.
        error: (lags + 1,), the standard error of the correlation, from its spread over the bodies; NaN for fewer than
            two bodies.
        number: (lags + 1,), how many bodies were counted: those with values at two times so far apart.
    """

    lag: Float[Array, "*batch lags"]
    correlation: Float[Array, "*batch lags"]
    error: Float[Array, "*batch lags"]
    number: Int[Array, "*batch lags"]


class Carried(NamedTuple):
    """What is carried of n bodies from one block of values to the next.

    Attributes:
        count: (n,), how many values counted so far.
        reference: (n, m), subtracted from all values: the first value if the mean is removed; else m is 0 here.
        last: (n, lags, m), the last values.
        high, low: (n, lags + 1, 1 + m), the sums of the products, and where the mean is removed of their factors; the
            low parts are what the high parts have rounded away.
    """

    count: Array
    reference: Array
    last: Array
    high: Array
    low: Array


class Autocorrelation(Series):
    """C(lag) = the mean of x(t) x(t + lag) over bodies and times t; of a vector, the mean of x(t) . x(t + lag).

    For each array that the observable returns a `Correlation`; an array is taken as the vector of all its numbers, so
    observe a dict of numbers to have one for each. As is usual in molecular dynamics (M. P. Allen and D. J. Tildesley,
    Computer Simulation of Liquids, 2017, section 8.2), no mean is removed, and each lag has all the pairs of values
    that there are. Of a body only the values before its first bad state count.

    The error takes bodies as independent, and nothing else: values of one body may depend on each other as they will.

    Attributes:
        observable: the observable x.
        lags: the largest lag, in intervals between saved values: lag k is the time k * save_every * abs(dt).
        centred: whether the mean of x over all bodies and times is removed first, so that C is the autocovariance.
        normalised: whether C is divided by C(0); the error is then that of the ratio.

    Raises:
        ValueError: `lags` is not a positive int; a driver raises it if the run has no more than `lags` saved values.
    """

    fields = Correlation._fields
    lags: int = eqx.field(static=True)
    centred: bool = eqx.field(static=True)
    normalised: bool = eqx.field(static=True)

    def __init__(self, observable: Any, lags: int, *, centred: bool = False, normalised: bool = False):
        self.observable, self.lags = observable, as_count("lags", lags)
        for name, value in (("centred", centred), ("normalised", normalised)):
            if not isinstance(value, bool):
                raise ValueError(f"{name} must be True or False, got {described(value)}.")
        self.centred, self.normalised = centred, normalised

    def check(self, saves: int | None) -> None:
        if saves is None:
            raise ValueError("an Autocorrelation needs values at several times; give save_every.")
        if self.lags >= saves:
            raise ValueError(
                f"lags ({self.lags}) must be less than the number of saved values ({saves}); take fewer lags, a "
                "smaller save_every or more steps."
            )

    def begun(self, bodies: int, values: Any) -> Any:
        def of_array(x: Any) -> Carried:
            removed = x.size if self.centred else 0
            sums = jnp.zeros((bodies, self.lags + 1, 1 + removed), x.dtype)
            last = jnp.zeros((bodies, self.lags, x.size), x.dtype)
            return Carried(jnp.zeros(bodies, jnp.int32), jnp.zeros((bodies, removed), x.dtype), last, sums, sums)

        return jax.tree.map(of_array, values)

    def taken(self, carried: Any, values: Any, good: Array) -> Any:
        return jax.tree.map(lambda x, before: self._taken(before, x.reshape(*good.shape, -1), good), values, carried)

    def _taken(self, before: Carried, x: Array, good: Array) -> Carried:
        _, k, m = x.shape
        reference = before.reference
        if self.centred:
            begins = (before.count == 0) & good[:, 0]
            reference = jnp.where(begins[:, None], x[:, 0], reference)
            x = x - reference[:, None]
        x = jnp.where(good[..., None], x, 0)
        seen = jnp.concatenate([before.last, x], axis=1)
        rows, width = blocks(k)
        # The bodies come last, and each lag adds long rows of numbers side by side.
        padded = jnp.moveaxis(jnp.pad(seen, [(0, 0), (0, rows * width - k), (0, 0)]), 0, -1)
        later, good = padded[self.lags :], jnp.pad(good.T, [(0, rows * width - k), (0, 0)])[:, None]
        times = before.count[None] + jnp.arange(rows * width, dtype=jnp.int32)[:, None]  # (times, bodies)

        def of_lag(lag: Array) -> Array:
            earlier = jax.lax.dynamic_slice_in_dim(padded, self.lags - lag, rows * width)
            products = later * earlier
            found = total(products.reshape(rows, width * m, -1).sum(axis=0))[None]
            if not self.centred:
                return found
            factors = jnp.where((times >= lag)[:, None], later, 0) + jnp.where(good, earlier, 0)
            return jnp.concatenate([found, total(factors)])

        added = jnp.moveaxis(jax.lax.map(of_lag, jnp.arange(self.lags + 1, dtype=jnp.int32)), -1, 0)
        (high,), (low,) = cp.compensated((before.high,), (before.low,), (added,))
        count = before.count + jnp.sum(good, axis=(0, 1), dtype=jnp.int32)
        return Carried(count, reference, seen[:, k:], high, low)

    def sums(self, carried: Any, counted: Array) -> Any:
        return jax.tree.map(
            lambda of_array: self._sums(of_array, counted), carried, is_leaf=lambda x: isinstance(x, Carried)
        )

    def _sums(self, carried: Carried, counted: Array) -> Sums:
        dtype = carried.high.dtype
        count = jnp.where(counted, carried.count, 0)
        found = jnp.moveaxis(jnp.where(counted[:, None, None], carried.high + carried.low, 0), 0, -1)
        terms = jnp.maximum(count[None] - jnp.arange(self.lags + 1, dtype=jnp.int32)[:, None], 0).astype(dtype)
        s, a = found[:, 0], found[:, 1:]  # of x - reference
        values = count.astype(dtype)
        weight = total(values)
        reference = carried.reference.T
        mean = total(values[None] * reference + a[0] / 2, -1) / jnp.maximum(weight, 1)
        shift = jnp.where(counted[None], mean[:, None] - reference, 0)  # (m, bodies)
        s = s - jnp.sum(shift[None] * a, axis=1) + terms * jnp.sum(shift**2, axis=0)[None]
        a = a - 2 * terms[:, None] * shift[None]
        return sums_of(s, a, terms, mean, weight, relative=self.normalised)

    def of_sums(self, sums: Sums, interval: Array) -> Correlation:
        value, error = mean_and_error(sums, relative=self.normalised)
        lag = jnp.arange(self.lags + 1, dtype=jnp.int32).astype(value.dtype) * interval.astype(value.dtype)
        return Correlation(lag, value, error, sums.number)
