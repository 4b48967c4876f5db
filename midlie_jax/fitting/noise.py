"""Whether the residuals of a fit can be noise: a verdict in the compiled fit, and reasons for doubt.

Known sigmas are tested by chi-squared. If sigmas are known up to a factor only, the residuals must be small relative to
the signal, and either small relative to its changes or uncorrelated, like noise of any size.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float
from scipy.special import ndtri  # SciPy is a dependency of JAX

from ..model import so3
from ..model.bodies import principal_of
from .instruments import Accelerations, Attitudes, Directions, Rates, of_which
from .measurements import Measurement, Observed, parted
from .problem import Model

_FEW = 12  # with fewer rows, the correlation of neighbours is not tested
_SIGNIFICANT = 5.0  # standard deviations
_LARGE = 0.3  # residuals above this share are not small
_QUANTILE = 4.753424  # of the normal distribution, for a chance of 1e-6
_INACCURATE = 1.1  # the factor by which known sigmas may be too small
_LAGS = (1, 8)
_CHANCE = 1e-5  # the probability of an outlier in noise
_SPREAD = 1.15  # the factor by which the deviation of few values may be underestimated
_MANY = 50  # from this number of rows, each component has its own deviation
_WINDOW = 5.0  # correlation times over which the correlations are summed
_NARROW = 1.1  # smaller factors are not reported
_LISTED = 50  # the largest number of rows in a text
_MOST_TURNS = 0.5  # between two rows
_CHANGES = "the changes of what was measured"


class Remainder(NamedTuple):
    """The residuals of one measurement: sums of squares over the present values, all over sigma."""

    left: Float[Array, ""]  # of the residuals; zero if they are no larger than the tolerance of the optimiser
    # The measured values: rates and accelerations without their bias, angles of one radian, and all other values
    # relative to their mean.
    signal: Float[Array, ""]
    of_what: str  # the name of the signal
    spread: Float[Array, ""]  # of the measured values, relative to their mean
    structured: Bool[Array, ""]  # whether the model omits a large share of the changes of the signal
    turned: Bool[Array, ""]  # whether the residuals are angles that are not small

    def share(self) -> tuple[float, str]:
        """The size of the residuals relative to a reference, and the name of the reference."""
        whole, of_what = self.signal, self.of_what
        if bool(self.structured & ~self.turned):
            whole, of_what = self.spread, _CHANGES
        return math.sqrt(float(self.left) / float(whole)) if whole > 0 else math.inf, of_what


def within_sigmas(squares: Float[Array, ""], dof: Float[Array, ""]) -> Bool[Array, ""]:
    """Whether chi-squared, the sum of squares over known sigmas, can be due to chance, by Wilson and Hilferty."""
    share = 2 / (9 * dof)
    return squares <= dof * _INACCURATE**2 * (1 - share + _QUANTILE * jnp.sqrt(share)) ** 3


def explained(remainders: Sequence[Remainder]) -> Bool[Array, ""]:
    """Whether the residuals of all measurements are small, or can be noise."""
    left, signal = (sum(getattr(r, name) for r in remainders) for name in ("left", "signal"))
    return (left <= _LARGE**2 * signal) & ~jnp.any(jnp.stack([r.structured | r.turned for r in remainders]))


def remainders_of(measurements: Sequence[Measurement], residuals: Array, parameters: Any) -> list[Remainder]:
    """The remainder of each measurement, from all residuals over sigma (r,) and the values of the parameters."""
    parts = zip(measurements, parted(measurements, residuals), strict=True)
    return [_remainder(measurement, part, parameters) for measurement, part in parts]


def _negligible(dtype: Any) -> float:
    """Residuals below this share of the measured values come from the tolerance of the optimiser."""
    return max(1e-6, 1e3 * float(jnp.finfo(dtype).eps))


def _remainder(measurement: Measurement, over_sigma: Array, parameters: Any) -> Remainder:
    _, m = of_which(measurement)
    present, sigma = m.present, m.sigma

    def squares(x: Array) -> Array:
        return jnp.sum(jnp.where(present, x, jnp.zeros_like(x)) ** 2)

    values = m.unbiased(parameters)
    spread = squares(_relative_to_mean(m, values) / sigma)
    signal, of_what, angles = spread, _CHANGES, isinstance(m, Attitudes | Directions)
    if angles:
        signal, of_what = squares(1 / sigma), "a radian"
    if isinstance(m, Rates | Accelerations):
        signal, of_what = squares(values / sigma), "what was measured"
    left, size = squares(over_sigma), jnp.sqrt(jnp.mean(m.values**2))
    none = jnp.sum(present).astype(sigma.dtype) * (_negligible(sigma.dtype) * size) ** 2
    left = jnp.where(squares(over_sigma * sigma) <= none, jnp.zeros_like(left), left)
    structured = (left > _LARGE**2 * spread) & _correlated(over_sigma, present)
    return Remainder(left, signal, of_what, spread, structured, (left > _LARGE**2 * signal) & angles)


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
    if values.shape != m.present.shape:  # residuals of another form, from a custom measurement
        return jnp.broadcast_to(jnp.sqrt(jnp.mean(values**2)), m.present.shape)
    return _centred(values, m.present)


def _centred(values: Array, present: Array) -> Array:
    count = jnp.maximum(jnp.sum(present, axis=0, keepdims=True), 1).astype(values.dtype)
    return values - jnp.sum(jnp.where(present, values, jnp.zeros_like(values)), axis=0, keepdims=True) / count


def _correlated(over_sigma: Array, present: Array) -> Bool[Array, ""]:
    rows, whole = over_sigma.reshape(len(over_sigma), -1), jnp.all(present.reshape(len(present), -1), axis=1)
    if len(rows) < _FEW:
        return jnp.zeros((), bool)
    both = whole[1:] & whole[:-1]
    products = jnp.sum(jnp.where(both, jnp.sum(rows[1:] * rows[:-1], axis=1), jnp.zeros_like(rows[1:, 0])))
    pairs, count = (jnp.sum(x).astype(rows.dtype) for x in (both, whole))
    own = jnp.sum(jnp.where(whole, jnp.sum(rows**2, axis=1), jnp.zeros_like(rows[:, 0])))
    # correlation * sqrt(pairs * columns) > _SIGNIFICANT, without a division by zero
    chance = own * pairs / jnp.maximum(count, 1)
    return (pairs >= _FEW - 1) & (products * jnp.sqrt(pairs * rows.shape[1]) > _SIGNIFICANT * chance)


class Doubt(NamedTuple):
    """Why a fit may be wrong although it converged."""

    text: str  # the evidence in the residuals
    measurement: int | None  # the index of the measurement, or None if it concerns all
    rows: tuple[int, ...] = ()  # of the values in question; empty if there are no single values


def doubts(residuals: Sequence[np.ndarray], measurements: Sequence[Measurement]) -> list[Doubt]:
    """The reasons to doubt a fit, from the residuals of each measurement, see `Fit.residuals`."""
    found: list[Doubt] = []
    for i, (over_sigma, measurement) in enumerate(zip(residuals, measurements, strict=True)):
        kind = type(measurement).__name__
        if not np.any(np.isfinite(over_sigma)):
            continue
        size = np.sqrt(np.mean(np.asarray(measurement.values) ** 2))
        rms = np.sqrt(np.nanmean((over_sigma * np.asarray(measurement.sigma)) ** 2))
        if not np.isfinite(rms) or rms <= _negligible(measurement.sigma.dtype) * size:
            continue
        rows = over_sigma.reshape(len(over_sigma), -1)
        if far := outliers_of(rows):
            found.append(Doubt(f"{kind}: {_far(measurement, far)}", i, tuple(row for row, _ in far)))
        complete = rows[np.all(np.isfinite(rows), axis=1)]
        if (correlation := _correlation(complete)) is not None:
            factor = _narrowness(complete)
            by = f", by a factor of about {factor:.2g}" if factor > _NARROW else ""
            text = (
                f"{kind}: neighbouring residuals are correlated ({correlation:.2f}), unlike noise; the model leaves "
                f"something out, such as a bias or a torque, and the intervals are too narrow{by}"
            )
            found.append(Doubt(text, i))
    return found


def _far(measurement: Measurement, far: list[tuple[int, float]]) -> str:
    times = [f"{float(measurement.times[row]):.6g}" for row, _ in far]
    factors = [factor for _, factor in far]
    if len(far) == 1:
        return f"the value at t = {times[0]} is off by {factors[0]:.0f} times the deviation of the others"
    more = f" and {len(far) - _LISTED} more" if len(far) > _LISTED else ""
    return (
        f"{len(far)} values are off by {min(factors):.0f} to {max(factors):.0f} times the deviation of the others, at "
        f"t = {', '.join(times[:_LISTED])}{more}"
    )


def outliers_of(rows: np.ndarray) -> list[tuple[int, float]]:
    """The rows of outliers, and the distance of each in units of the usual deviation."""
    sizes = np.abs(rows)
    if np.sum(np.isfinite(sizes)) < _FEW:
        return []
    usual = np.nanmedian(sizes, axis=0) / 0.6745
    if len(sizes) < _MANY:  # the median of few values may be small by chance
        usual = np.maximum(usual, np.nanmedian(sizes) / 0.6745)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.max(np.where(np.isfinite(sizes), sizes / usual, 0.0), axis=1)
    far = _SPREAD * ndtri(1 - _CHANCE / 2 / np.sum(np.isfinite(sizes)))
    return [(int(row), float(relative[row])) for row in np.flatnonzero(relative > far)]


def _correlation(rows: np.ndarray) -> float | None:
    """The mean correlation with the next row, or with the next eight, if it exceeds chance; else None."""
    for lags in _LAGS:
        if len(rows) > 4 * lags and len(rows) >= _FEW:
            mean = float(np.mean([_at(rows, lag) for lag in range(1, lags + 1)]))
            if mean * np.sqrt(lags * rows.size) > _SIGNIFICANT:
                return mean
    return None


def _narrowness(rows: np.ndarray) -> float:
    """The factor by which the correlation of the residuals makes standard deviations too small."""
    total = 1.0  # 1 + 2 (r_1 + r_2 + ...), with the correlations r_k at the lags k up to five times this sum
    for lag in range(1, len(rows) // 2):
        total += 2 * _at(rows, lag)
        if lag >= _WINDOW * total:
            break
    return float(np.sqrt(max(total, 1.0)))


def _at(rows: np.ndarray, lag: int) -> float:
    return float(np.sum(rows[lag:] * rows[:-lag]) / np.sum(rows**2))


def aliases_of(model: Model, measurements: tuple[Measurement, ...], values: Any) -> str:
    """A message if a body rotates by more than half a revolution between rows, so that other values may fit; or ""."""
    try:
        body, torque, start = model(values)
    except ValueError:  # at the end of a failed run
        return ""
    if not np.all(np.isfinite(start.momentum)):
        return ""
    by_body: dict[int | None, list[Measurement]] = {}
    for m in measurements:
        by_body.setdefault(of_which(m)[0], []).append(m)
    for own in by_body.values():
        _, one, state = own[0].subject(body, start)
        inner = [of_which(m)[1] for m in own]
        if start.several and any(isinstance(m, Observed) for m in own):
            continue  # a quantity of all bodies, which has no rotation
        measured = [np.asarray(m.present).reshape(len(m.times), -1).any(axis=1) for m in inner]
        times = np.unique(np.concatenate([np.asarray(m.times)[x] for m, x in zip(inner, measured, strict=True)]))
        gap = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        speed = frequency = _speed(inner, one, state, values)
        if torque is None and all(isinstance(m, Rates) for m in inner):
            # The largest frequency at which the rates of a free body can change.
            moments = np.asarray(principal_of(one).turning.moments)
            frequency = min(speed, float(np.linalg.norm(state.momentum) * (1 / moments.min() - 1 / moments.max())))
        if frequency * gap > 2 * math.pi * _MOST_TURNS:
            return (
                f"the body turns {speed * gap / (2 * math.pi):.3g} times between rows, so other values may fit as well "
                "(aliases); check the units of time and of the rates, or give rows closer together"
            )
    return ""


def _speed(measurements: list[Measurement], body: Any, state: Any, values: Any) -> float:
    """The usual measured speed; the initial speed if no rates are measured."""
    for m in measurements:
        if isinstance(m, Rates):
            complete = np.all(np.asarray(m.present), axis=1)
            if complete.any():
                return float(np.median(np.linalg.norm(np.asarray(m.unbiased(values))[complete], axis=1)))
    return float(np.linalg.norm(jax.tree.leaves(body.velocity(state.momentum))[0]))
