"""Whether the residuals of a fit can be noise: by the sigmas where these are known, otherwise by what was measured.

Known sigmas are tested by chi-squared. If sigmas are known up to a factor only, the residuals must be small relative to
the signal. Residuals that are not small relative to the changes of the signal must at least not be correlated, because
noise of any size is not.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from ..model import so3
from .measurements import Accelerations, Attitudes, Directions, Measurement, Rates
from .of_body import OfBody

FEW = 12  # with fewer rows, the correlation of neighbours is not tested
SIGNIFICANT = 5.0  # standard deviations
_LARGE = 0.3  # residuals above this share are not small
_QUANTILE = 4.753424  # of the normal distribution, for a chance of 1e-6
_INACCURATE = 1.1  # the factor by which known sigmas may be too small


class Remainder(NamedTuple):
    """What a fit leaves of one measurement: sums of squares over the present values, all over sigma.

    Attributes:
        left: of the residuals; zero if they are no larger than the tolerance of the optimiser.
        signal: of what was measured: rates and accelerations without their bias, angles of one radian, and all other
            values relative to their mean.
        spread: of what was measured, relative to its mean.
        correlated: whether neighbouring residuals are correlated.
        angles: whether the residuals are angles.
    """

    left: Float[Array, ""]
    signal: Float[Array, ""]
    spread: Float[Array, ""]
    correlated: Bool[Array, ""]
    angles: bool

    @property
    def structured(self) -> Bool[Array, ""]:
        """Whether the model leaves out a large share of how the signal changes."""
        return (self.left > _LARGE**2 * self.spread) & self.correlated

    @property
    def turned(self) -> Bool[Array, ""]:
        """Whether the residuals are angles that are not small."""
        return (self.left > _LARGE**2 * self.signal) & self.angles


def within_sigmas(squares: Float[Array, ""], dof: Float[Array, ""]) -> Bool[Array, ""]:
    """Whether chi-squared, the sum of squares over known sigmas, can be due to chance, by Wilson and Hilferty."""
    share = 2 / (9 * dof)
    return squares <= dof * _INACCURATE**2 * (1 - share + _QUANTILE * jnp.sqrt(share)) ** 3


def explained(remainders: Sequence[Remainder]) -> Bool[Array, ""]:
    """Whether the residuals of all measurements are small, or can be noise."""
    left, signal = (sum(getattr(r, name) for r in remainders) for name in ("left", "signal"))
    return (left <= _LARGE**2 * signal) & ~jnp.any(jnp.stack([r.structured | r.turned for r in remainders]))


def remainders_of(
    measurements: Sequence[Measurement], residuals: Float[Array, " r"], parameters: Any
) -> list[Remainder]:
    """What a fit leaves of each measurement.

    Args:
        measurements: the measurements.
        residuals: those of all measurements, over sigma; zero where missing.
        parameters: the values of the parameters.
    """
    found: list[Remainder] = []
    begin = 0
    for measurement in measurements:
        end = begin + measurement.present.size
        over_sigma = residuals[begin:end].reshape(measurement.present.shape)
        found.append(_remainder(measurement, over_sigma, parameters))
        begin = end
    return found


def negligible(dtype: Any) -> float:
    """Residuals below this share of the measured values come from the tolerance of the optimiser."""
    return max(1e-6, 1e3 * float(jnp.finfo(dtype).eps))


def _remainder(measurement: Measurement, over_sigma: Array, parameters: Any) -> Remainder:
    m = measurement.measurement if isinstance(measurement, OfBody) else measurement
    present, sigma = m.present, m.sigma

    def squares(x: Array) -> Array:
        return jnp.sum(jnp.where(present, x, jnp.zeros_like(x)) ** 2)

    angles = isinstance(m, Attitudes | Directions)
    bias = getattr(m, "bias", None)
    values = m.values if bias is None else m.values - bias(parameters)[None]
    spread = squares(_relative_to_mean(m, values) / sigma)
    if angles:
        signal = squares(1 / sigma)
    else:
        signal = squares(values / sigma) if isinstance(m, Rates | Accelerations) else spread
    left, size = squares(over_sigma), jnp.sqrt(jnp.mean(m.values**2))
    none = jnp.sum(present).astype(sigma.dtype) * (negligible(sigma.dtype) * size) ** 2
    left = jnp.where(squares(over_sigma * sigma) <= none, jnp.zeros_like(left), left)
    return Remainder(left, signal, spread, _correlated(over_sigma, present), angles)


def _relative_to_mean(m: Measurement, values: Array) -> Array:
    """The values relative to their mean, in the unit and shape of the residuals."""
    if isinstance(m, Attitudes):
        first = values[jnp.argmax(m.present[:, 0])]
        same = jnp.where((values @ first)[:, None] < 0, -values, values)
        mean = jnp.sum(jnp.where(m.present[:, :1], same, jnp.zeros_like(same)), axis=0, keepdims=True)
        return so3.log(so3.multiply(so3.conjugate(mean / jnp.linalg.norm(mean)), same))
    if isinstance(m, Directions):  # each of the two angles has half of the square
        unit = values / jnp.maximum(jnp.linalg.norm(values, axis=-1, keepdims=True), jnp.finfo(values.dtype).tiny)
        off = jnp.linalg.norm(_centred(unit, m.present[:, :1]), axis=-1, keepdims=True)
        return jnp.broadcast_to(off / jnp.sqrt(jnp.asarray(2, off.dtype)), m.present.shape)
    if values.shape != m.present.shape:  # residuals of another form, of a measurement of the user's own
        return jnp.broadcast_to(jnp.sqrt(jnp.mean(values**2)), m.present.shape)
    return _centred(values, m.present)


def _centred(values: Array, present: Array) -> Array:
    count = jnp.maximum(jnp.sum(present, axis=0, keepdims=True), 1).astype(values.dtype)
    return values - jnp.sum(jnp.where(present, values, jnp.zeros_like(values)), axis=0, keepdims=True) / count


def _correlated(over_sigma: Array, present: Array) -> Bool[Array, ""]:
    """Whether neighbouring rows are correlated beyond chance."""
    rows, whole = over_sigma.reshape(len(over_sigma), -1), jnp.all(present.reshape(len(present), -1), axis=1)
    if len(rows) < FEW:
        return jnp.zeros((), bool)
    both = whole[1:] & whole[:-1]
    products = jnp.sum(jnp.where(both, jnp.sum(rows[1:] * rows[:-1], axis=1), jnp.zeros_like(rows[1:, 0])))
    pairs, count = (jnp.sum(x).astype(rows.dtype) for x in (both, whole))
    own = jnp.sum(jnp.where(whole, jnp.sum(rows**2, axis=1), jnp.zeros_like(rows[:, 0])))
    enough = pairs >= FEW - 1
    # correlation * sqrt(pairs * columns) > SIGNIFICANT, without a division by zero
    chance = own * pairs / jnp.maximum(count, 1)
    return enough & (products * jnp.sqrt(pairs * rows.shape[1]) > SIGNIFICANT * chance)
