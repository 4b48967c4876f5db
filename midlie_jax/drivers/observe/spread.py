"""Means over bodies with different numbers of terms, and their standard errors.

For body i, s_i is a sum of N_i terms, such as the products x(t) x(t + lag) or the power in the segments of its motion.
The mean over all terms is C = sum s_i / sum N_i. Bodies are independent and times are not, so the error of C is the
error of a ratio of two sums over bodies: error^2 = n / (n - 1) sum (s_i - C N_i)^2 / (sum N_i)^2 (W. G. Cochran,
Sampling Techniques, 1977, section 6.4). If all N_i are equal, it is the standard deviation of s_i / N_i over sqrt(n).

If the mean of x is removed from the products, it is available only after all bodies. Each group of bodies therefore
keeps second moments about its own mean, from which the moments about another mean follow.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from ..._math.sums import total


class Sums(NamedTuple):
    """Sums over some bodies, for each of r rows: the lags, or the frequencies.

    For a body and a row, z = (q, N, a), where q = s - value N, and a (m,) is the sum over the products of both factors;
    s and a are sums for x - mean. If the mean is not removed, m is 0.

    If the result is the value divided by the first row, z = (u, N, a, q0, N0, a0). The last three belong to the first
    row, and u = q - slope q0 with slope = value N / (value0 N0), of all these bodies. u is therefore small if the ratio
    is nearly the same for all bodies, and does not lose digits.

    Attributes:
        number: (r,), number of bodies with terms.
        value: (r,), the mean of all terms; 0 if there is none.
        mean: (m,), the mean of x over bodies and times.
        weight: (), the number of values in this mean.
        first, second: (r, p) and (r, p, p), the sums of z and of z z^T over the bodies.
    """

    number: Int[Array, "*batch r"]
    value: Float[Array, "*batch r"]
    mean: Float[Array, "*batch m"]
    weight: Float[Array, "*batch"]
    first: Float[Array, "*batch r p"]
    second: Float[Array, "*batch r p p"]


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

    They are joined one after the other by the same code. Groups without bodies at the end, which pad a mesh, therefore
    change no bit.
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
    """The mean of all terms and its standard error, (r,) each; with `relative`, divided by the first row.

    NaN if no body has terms; the error is NaN for fewer than two bodies.
    """
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
