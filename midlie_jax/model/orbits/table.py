"""Tables at given times: an orbit from positions, such as an ephemeris, and a field along an orbit."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, require_resolved
from ..._math import components as cp
from ..._math.powers import unit
from ..._xla.fusion import split
from .base import Orbit, Timed

_EVEN = 1e-5  # times closer than this fraction of an interval to even ones are found by arithmetic
_SLACK = 16  # units in the last place by which a time computed as t0 + n dt may leave the table
_UNLIKELY = 100.0  # speed times interval over the distance of two rows; kilometres for metres change it by 1000
_NEIGHBOURS = 5  # positions from which a slope is computed


class _Table(Timed):
    times: Float[Array, " k"]
    even: bool = eqx.field(static=True)

    @property
    def span(self) -> tuple[Array, Array]:
        return self.times[0], self.times[-1]

    def _between(self, t: Any, values: Array, slopes: Array) -> Array:
        times, first, last = self.times, self.times[0], self.times[-1]
        count = times.shape[0]
        if self.even:
            row = jnp.floor((t - first) * ((count - 1) / (last - first))).astype(jnp.int32)
        else:
            row = jnp.searchsorted(times, t, side="right").astype(jnp.int32) - 1
        row = jnp.clip(row, 0, count - 2)
        begin, end = times[row], times[row + 1]
        h = end - begin
        x = (t - begin) / h
        y = 1 - x
        a, b = (cp.vector(values[..., n, :]) for n in (row, row + 1))
        va, vb = (cp.vector(slopes[..., n, :]) for n in (row, row + 1))
        slack = _SLACK * cp.epsilon(first) * jnp.maximum(jnp.abs(first), jnp.abs(last))
        outside = (t < first - slack) | (t > last + slack)
        x = jnp.where(outside, jnp.full_like(x, jnp.nan), x)
        rise = cp.subtract(b, a)
        place = cp.add(a, cp.scale(x * x * (1 + 2 * y), rise))
        bend = cp.subtract(cp.scale(y, va), cp.scale(x, vb))
        # The loop ends here, so a torque rounds the same way however the compiler reads the rows.
        return cp.pack(split(cp.add(place, cp.scale(h * x * y, bend))))


class TableOrbit(_Table, Orbit):
    """An orbit by cubic Hermite interpolation of positions, and velocities, at given times.

    The error of the position is h^4 |r''''| / 384, with h the time between two rows; the error of the velocity is
    proportional to h^3. On a circle, 100 rows per revolution give the position to 4e-8 of the radius. Without
    velocities the slopes come from the polynomial of fourth degree through the five nearest positions, and the error is
    at most 1.2 times as large. Accelerations jump at the rows; a method of high order therefore needs close rows.

    Outside its times the position is NaN. A run raises an error before it starts if its times are known.

    Attributes:
        times: ascending, (k,), at least 2.
        positions: (k, 3), length; with leading axes for several orbits at the same times.
        velocities: of the same shape, length/time: as given, or the slopes.

    Raises:
        ValueError: times not ascending, fewer than 2, too close for their dtype, or wrong shapes; a value that is not
            finite; or velocities that are everywhere 100 times smaller or larger than the changes of the positions.

    Examples:
        >>> times = np.arange(0.0, 601.0, 60.0)
        >>> angle = 0.001 * times
        >>> rows = 7000.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)  # (11, 3), from an ephemeris
        >>> round(float(jnp.linalg.norm(ml.orbits.TableOrbit(times, rows)(90.0))), 2)
        7000.0
    """

    positions: Float[Array, "*batch k 3"]
    velocities: Float[Array, "*batch k 3"]

    def __init__(self, times: Any, positions: Any, velocities: Any = None):
        self.times, self.even = _as_times(times)
        shape = (self.times.size, 3)
        self.positions = as_finite("positions", positions, shape)
        if velocities is None:
            self.velocities = _slopes(self.times, self.positions)
        else:
            self.velocities = as_finite("velocities", velocities, shape)
            if self.velocities.shape != self.positions.shape:
                raise ValueError(f"velocities must be {self.positions.shape}, got {self.velocities.shape}.")
            _require_fitting(self.times, self.positions, self.velocities)

    def known(self) -> tuple[Array, Array]:
        return self.positions, self.velocities

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        return self._between(t, self.positions, self.velocities)


class TableField(_Table):
    """A vector field along an orbit from its values at given times, such as the magnetic field of a model.

    It is interpolated like a `TableOrbit` without velocities, with an error of order 4 in the time between two rows.

    Attributes:
        times: as for `TableOrbit`.
        values: the field at these times, space frame, (k, 3); with leading axes for several orbits.
        slopes: its derivatives at these times, computed from the values.

    Examples:
        >>> times = jnp.arange(0.0, 601.0, 30.0)
        >>> field = ml.orbits.TableField(times, jnp.stack([jnp.cos(0.01 * times), 0 * times, 0 * times], axis=-1))
        >>> bool(abs(field(95.0)[0] - np.cos(0.95)) < 1e-4)
        True
    """

    values: Float[Array, "*batch k 3"]
    slopes: Float[Array, "*batch k 3"]

    def __init__(self, times: Any, values: Any):
        self.times, self.even = _as_times(times)
        self.values = as_finite("values", values, (self.times.size, 3))
        self.slopes = _slopes(self.times, self.values)

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        return self._between(t, self.values, self.slopes)


def _as_times(times: Any) -> tuple[Array, bool]:
    found = as_finite("times", times)
    if found.ndim != 1 or found.size < 2:
        raise ValueError(f"times must have shape (k,) with k at least 2, got {found.shape}.")
    require_resolved("times", times, found.dtype)
    if cp.is_traced(found):
        return found, False
    numbers = np.asarray(found, np.float64)
    steps = np.diff(numbers)
    if not np.all(steps > 0):
        n = int(np.argmin(steps > 0))
        got = f"times[{n + 1}] = {numbers[n + 1]} follows {numbers[n]}"
        raise ValueError(f"times must ascend, but {got}; sort the rows.")
    even = np.linspace(numbers[0], numbers[-1], len(numbers))
    return found, bool(np.all(np.abs(numbers - even) < _EVEN * steps.min()))


def _require_fitting(times: Array, positions: Array, velocities: Array) -> None:
    if cp.is_traced(times, positions, velocities):
        return
    way = np.linalg.norm(np.diff(np.asarray(positions, np.float64), axis=-2), axis=-1)
    speeds = np.linalg.norm(np.asarray(velocities, np.float64), axis=-1)
    covered = np.maximum(speeds[..., 1:], speeds[..., :-1]) * np.diff(np.asarray(times, np.float64))
    moves = way > 0
    if not moves.any():
        return
    ratios = covered[moves] / way[moves]
    if ratios.max() < 1 / _UNLIKELY or ratios.min() > _UNLIKELY:
        raise ValueError(
            "velocities must be in the units of positions and times, got speed * interval / distance from "
            f"{ratios.min():.2g} to {ratios.max():.2g}; convert them."
        )


def _slopes(times: Array, positions: Array) -> Array:
    """The derivative at each row of the polynomial through the five nearest rows, or through all if there are fewer."""
    count = times.shape[0]
    width = min(_NEIGHBOURS, count)
    begin = np.clip(np.arange(count) - width // 2, 0, count - width)
    rows = begin[:, None] + np.arange(width)
    here = np.arange(count) - begin  # the index of the row among its neighbours
    _, per_span = unit(times[-1] - times[0])  # a power of two, so products of four intervals stay in range
    times = times * per_span
    near = times[rows]
    # Lagrange's polynomials in barycentric form (J.-P. Berrut, L. N. Trefethen, SIAM Rev. 46 (2004) 501, section 9.3).
    gaps = near[:, :, None] - near[:, None, :] + jnp.eye(width, dtype=times.dtype)[None]
    weight = 1 / jnp.prod(gaps, axis=-1)
    own = np.arange(width)[None] == here[:, None]
    distance = jnp.where(own, jnp.ones_like(near), times[:, None] - near)
    factor = jnp.where(own, jnp.zeros_like(near), weight / (weight[np.arange(count), here][:, None] * distance))
    # Differences from the row itself, whose factor is minus the sum of the other factors.
    steps = positions[..., rows, :] - positions[..., :, None, :]
    factor = jnp.expand_dims(factor, (*range(steps.ndim - 3), -1))
    return jnp.sum(factor * steps, axis=-2) * per_span
