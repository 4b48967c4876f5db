"""`Series`: the base class of statistics over consecutive values of bodies, and the standard errors of their means.

The values of a body are processed in blocks, in the order of time, and the necessary results of earlier blocks are
carried along. A run in several time spans therefore has the same statistic as a run in one.

For body i, s_i is a sum of N_i terms, such as the products x(t) x(t + lag) or the power in the segments of its motion.
The mean over all terms is C = sum s_i / sum N_i. Bodies are independent and times are not, so the error of C is the
error of a ratio of two sums over bodies: error^2 = n / (n - 1) sum (s_i - C N_i)^2 / (sum N_i)^2 (W. G. Cochran,
Sampling Techniques, 1977, section 6.4). If all N_i are equal, it is the standard deviation of s_i / N_i over sqrt(n).

If the mean of x is removed from the products, it is available only after all bodies. Each group of bodies therefore
keeps second moments about its own mean, from which the moments about another mean follow.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from ..._checks.arguments import as_floats, described, require
from ..._math.sums import total
from .statistics import Statistic


class Sums(NamedTuple):
    """Sums over some bodies, for each of r rows: the lags, or the frequencies.

    For a body and a row, z = (q, N, a), where q = s - value N, and a (m,) is the sum over the products of both factors;
    s and a are sums for x - mean. If the mean is not removed, m is 0.

    If the result is the value divided by the first row, z = (u, N, a, q0, N0, a0). The last three belong to the first
    row, and u = q - slope q0 with slope = value N / (value0 N0) is small if the ratio hardly varies over the bodies.
    """

    number: Int[Array, "*batch r"]  # of bodies with terms
    value: Float[Array, "*batch r"]  # the mean of all terms; 0 if there is none
    mean: Float[Array, "*batch m"]  # of x over bodies and times
    weight: Float[Array, "*batch"]  # the number of values in this mean
    first: Float[Array, "*batch r p"]  # the sum of z over the bodies
    second: Float[Array, "*batch r p p"]  # and of z z^T


class Series(Statistic):
    """A statistic over times and bodies; only the values before the first bad state of a body count."""

    fields: ClassVar[tuple[str, ...]]  # the names of the results of `of_sums`, beginning with its rows

    def _begun(self, bodies: int, x: Any) -> Any:
        """The initial carry of these bodies for one array, a NamedTuple with the field `counted`."""
        raise NotImplementedError

    def _taken(self, before: Any, x: Array, good: Array) -> Any:
        """The carry after the values (bodies, k, m) at the next k times; none counts after one that is not `good`."""
        raise NotImplementedError

    def _sums(self, carried: Any, counted: Array) -> Sums:
        """`Sums` of the bodies that are `counted`, for one array."""
        raise NotImplementedError

    def begun(self, bodies: int, values: Any) -> Any:
        """The initial carry of these bodies; `values` are of one body at one time."""
        return jax.tree.map(lambda x: self._begun(bodies, x), values)

    def taken(self, carried: Any, values: Any, good: Array) -> Any:
        return jax.tree.map(lambda x, before: self._taken(before, x.reshape(*good.shape, -1), good), values, carried)

    def sums(self, carried: Any, counted: Array) -> Any:
        return jax.tree.map(lambda one: self._sums(one, counted), carried, is_leaf=lambda x: hasattr(x, "counted"))

    @abstractmethod
    def of_sums(self, sums: Sums, interval: Array) -> Any:
        """The statistic of one observed array; `interval` is the time between two values, ()."""

    def part(self, values: Any, good: Array) -> Any:
        """The part of a group of bodies, from all their values (bodies, k, ...); only `good` values count."""
        one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[2:], x.dtype), values)
        carried = self.taken(self.begun(len(good), one), values, good)
        return self.sums(carried, jnp.ones(len(good), bool))

    def parts(self, values: Any, good: Array) -> Any:
        return self.part(values, good)

    def merged(self, parts: Any) -> Any:
        return jax.tree.map(merged_sums, parts, is_leaf=lambda x: isinstance(x, Sums))

    def result(self, merged: Any, interval: Array) -> Any:
        return jax.tree.map(
            lambda sums: self.of_sums(sums, jnp.abs(interval)), merged, is_leaf=lambda x: isinstance(x, Sums)
        )

    def finished(self, merged: Any) -> Any:
        return jax.tree.map(lambda found: found._asdict(), merged, is_leaf=lambda x: hasattr(x, "_asdict"))

    def row_of(self, name: str) -> str:
        """The name of the rows of a variable of the file: `observed_lag` for `observed_error`."""
        field = next(field for field in self.fields if name.endswith(field))
        return name.removesuffix(field) + self.fields[0]

    def of_bodies(self, values: Any, good: Array, interval: Array) -> Any:
        alone = jax.tree.map(lambda x: x[None], self.part(values, good))
        return self.result(self.merged(alone), interval)


def unused(t: Any, state: Any) -> Any:
    """The observable of a statistic of values in memory."""
    raise AssertionError


def of_values(statistic: Series, values: Any, interval: Any, first_bad: Any) -> Any:
    """The statistic of values in memory; checks the arguments of `autocorrelation` and `spectrum`."""
    x = as_floats("values", values)
    if x.ndim not in (2, 3):
        raise ValueError(
            f"values must be (bodies, times) or (bodies, times, components), got {x.shape}; of one body give "
            "values[None]."
        )
    statistic.check(x.shape[1])
    step = as_floats("interval", interval)
    if step.ndim:
        raise ValueError(f"interval must be one number, got shape {step.shape}.")
    cure = "give the time between two values."
    require("interval", step, lambda h: np.isfinite(h) & (h != 0), "must be finite and not zero", cure)
    count = jnp.full(x.shape[0], x.shape[1], jnp.int32) if first_bad is None else jnp.asarray(first_bad)
    if count.shape != x.shape[:1] or not jnp.issubdtype(count.dtype, jnp.integer):
        raise ValueError(f"first_bad must be one integer for each body, {x.shape[:1]}, got {described(first_bad)}.")
    return _of_values(statistic, x, count.astype(jnp.int32), step)


@eqx.filter_jit
def _of_values(statistic: Series, values: Array, first_bad: Array, interval: Array) -> Any:
    good = jnp.arange(values.shape[1], dtype=jnp.int32)[None] < first_bad[:, None]
    return statistic.of_bodies(values, good, interval)


def sums_of(s: Array, a: Array, terms: Array, mean: Array, weight: Array, *, relative: bool) -> Sums:
    """The sums of some bodies; s, a and terms are zero for a body that does not count."""
    terms_of_all = total(terms, -1)
    value = _ratio(total(s, -1), terms_of_all)
    slope = _slope(value, terms_of_all)

    def z(row: Array) -> Array:
        return jnp.concatenate([(s[row] - value[row] * terms[row])[None], terms[row][None], a[row]])

    of_first = z(jnp.int32(0))

    def of_row(row: Array) -> tuple[Array, Array]:
        own = z(row)
        if relative:
            own = jnp.concatenate([own.at[0].add(-slope[row] * of_first[0]), of_first])
        return total(own, -1), total(own[:, None] * own[None], -1)

    first, second = jax.lax.map(of_row, jnp.arange(len(s), dtype=jnp.int32))
    return Sums(jnp.sum(terms > 0, axis=-1, dtype=jnp.int32), value, mean, weight, first, second)


def merged_sums(parts: Sums) -> Sums:
    """The sums of the union of several groups, from their sums stacked along the first axis.

    They are joined one after the other, so groups without bodies at the end, which pad a mesh, change no bit.
    """
    none = jax.tree.map(lambda x: jnp.zeros_like(x[0]), parts)
    return jax.lax.scan(lambda sums, part: (_joined(sums, part), None), none, parts)[0]


def _joined(a: Sums, b: Sums) -> Sums:
    weight = a.weight + b.weight
    mean = a.mean + (b.mean - a.mean) * _ratio(b.weight, weight)
    terms = a.first[:, 1] + b.first[:, 1]
    value_a, value_b = _value_about(mean, a), _value_about(mean, b)
    value = value_a + (value_b - value_a) * _ratio(b.first[:, 1], terms)
    moved = [_moved(part, mean, value, _slope(value, terms)) for part in (a, b)]
    (first_a, second_a), (first_b, second_b) = moved
    return Sums(a.number + b.number, value, mean, weight, first_a + first_b, second_a + second_b)


def _value_about(mean: Array, part: Sums) -> Array:
    shift, terms = mean - part.mean, part.first[:, 1]
    factors = part.first[:, 2 : 2 + len(shift)]
    return part.value + jnp.where(terms > 0, jnp.sum(shift**2) - _ratio(jnp.sum(shift[None] * factors, -1), terms), 0)


def _moved(part: Sums, mean: Array, value: Array, slope: Array) -> tuple[Array, Array]:
    """`first` and `second` about another mean and value, and with another slope."""
    shift = mean - part.mean
    m, squared = len(shift), jnp.sum(shift**2)

    def move_own(change: Array) -> Array:
        """The matrix that takes (q, N, a) to the other mean and value."""
        move = jnp.eye(2 + m, dtype=shift.dtype)
        return move.at[0, 1].set(squared + change).at[0, 2:].set(-shift).at[2:, 1].set(-2 * shift)

    def move_both(own: Array, before: Array, after: Array) -> Array:
        """The same for z with the first row appended, whose matrix is `of_first`; the slope changes as well."""
        move = jax.scipy.linalg.block_diag(own, of_first)
        return move.at[0, 2 + m].add(before).at[0, 2 + m :].add(-after * of_first[0])

    move = jax.vmap(move_own)(part.value - value)
    of_first = move[0]
    if part.first.shape[-1] > 2 + m:
        move = jax.vmap(move_both)(move, _slope(part.value, part.first[:, 1]), slope)
    second = _product(_product(move, part.second), jnp.swapaxes(move, -1, -2))
    return _product(move, part.first[..., None])[..., 0], second


def mean_and_error(sums: Sums, *, relative: bool) -> tuple[Array, Array]:
    """The mean of all terms and its standard error, (r,) each, or NaN; with `relative`, divided by the first row."""
    scale = sums.value[0] if relative else jnp.ones_like(sums.value[0])
    bodies = sums.number.astype(scale.dtype)
    freedom = jnp.where(bodies > 1, bodies - 1, jnp.nan)
    square = jnp.maximum(sums.second[:, 0, 0], 0)  # rounding may make it negative if all bodies are equal
    if relative:
        square = square.at[0].set(0)  # a ratio of 1 has no error
    error = jnp.sqrt(bodies / freedom * square) / (sums.first[:, 1] * scale)
    return jnp.where(bodies > 0, sums.value, jnp.nan) / scale, error


def _slope(value: Array, terms: Array) -> Array:
    return _ratio(value * terms, value[0] * terms[0])


def _ratio(a: Array, b: Array) -> Array:
    return jnp.where(b > 0, a / jnp.where(b > 0, b, 1), 0)


def _product(a: Array, b: Array) -> Array:
    """The product of small matrices, with a fixed order of addition and in full precision."""
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)
