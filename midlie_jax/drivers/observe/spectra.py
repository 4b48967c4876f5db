"""`Spectrum`: the power of a quantity over frequency, by Welch's method."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from ..._checks.arguments import as_count, as_finite, as_floats, described, require
from ..._math import components as cp
from ..._math.sums import total
from .series import Series, Sums, mean_and_error, of_values, sums_of, unused


class Density(NamedTuple):
    """Result of `Spectrum`; all are (segment // 2 + 1,).

    Attributes:
        frequency: from 0 to at most 1 / (2 interval), in cycles per unit of time.
        density: in the square of the unit of x per unit of frequency.
        error: the standard error of the density, from its spread over the bodies; NaN for fewer than two bodies.
        number: number of bodies counted: bodies with a whole segment.

    Examples:
        >>> found = ml.observe.spectrum(np.ones((8, 100)), segment=32, interval=0.5)  # of 8 bodies 100 values each
        >>> found.frequency[-1].item(), found.density.shape, found.error.shape, found.number[0].item()
        (1.0, (17,), (17,), 8)
    """

    frequency: Float[Array, "*batch f"]
    density: Float[Array, "*batch f"]
    error: Float[Array, "*batch f"]
    number: Int[Array, "*batch f"]


class Carried(NamedTuple):
    """The values carried for n bodies from one block of values to the next."""

    time: Array  # (n,), number of values so far, the same for all bodies
    counted: Array  # (n,), number of them that count
    last: Array  # (n, m, segment - 1), the last values
    high: Array  # (n, f), the sum of the densities of all segments
    low: Array  # the rounding error of this sum


class Spectrum(Series):
    """The one-sided power density over frequency: the mean periodogram over bodies and segments.

    The integral over frequency is the variance. Returns a `Density` for each array that the observable returns. The
    density of a vector is the sum over its components; to get a density for each number, observe a dict. The values of
    a body are cut into overlapping segments; the mean of each is removed, and it is multiplied by the window (P. D.
    Welch, IEEE Trans. Audio Electroacoust. 15, 70, 1967). The defaults are the defaults of `scipy.signal.welch`. Only
    whole segments before the first bad state of a body count. The error assumes independent bodies only: segments of
    one body may be correlated.

    Attributes:
        segment: number of saved values per segment, at least 2; frequencies are resolved to about 1 / (segment
            interval), where the interval between two saved values is save_every * abs(dt).
        overlap: number of values that two segments share; by default half of them.
        window: (segment,), the factor of each segment: "hann" (the default), "boxcar" for none, or numbers, for example
            from `scipy.signal.get_window`.
        detrend: whether the mean of each segment is removed.

    Raises:
        ValueError: one of these does not fit the others, or a run has fewer than `segment` saved values.

    Examples:
        >>> lines = ml.observe.Spectrum(ml.observe.Axis(), segment=64)
        >>> found = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=255, observe=lines).states
        >>> found.frequency.shape, found.density.shape
        ((33,), (33,))
    """

    fields = Density._fields
    segment: int = eqx.field(static=True)
    overlap: int = eqx.field(static=True)
    window: Array
    detrend: bool = eqx.field(static=True)

    def __init__(
        self, observable: Any, segment: int, *, overlap: int | None = None, window: Any = "hann", detrend: bool = True
    ):
        self.observable, self.segment = observable, as_count("segment", segment)
        if self.segment < 2:
            raise ValueError("segment must be at least 2 saved values, got 1.")
        overlap = self.segment // 2 if overlap is None else overlap
        self.overlap = 0 if type(overlap) is int and overlap == 0 else as_count("overlap", overlap)
        if self.overlap >= self.segment:
            raise ValueError(f"overlap ({overlap}) must be less than segment ({segment}).")
        if not isinstance(detrend, bool):
            raise ValueError(f"detrend must be True or False, got {described(detrend)}.")
        self.window, self.detrend = _as_window(window, self.segment), detrend

    def check(self, saves: int | None) -> None:
        if saves is None:
            raise ValueError("a Spectrum needs values at several times; give save_every.")
        if self.segment > saves:
            raise ValueError(
                f"segment ({self.segment}) must be at most the number of saved values ({saves}); take a shorter "
                "segment, a smaller save_every or more steps."
            )

    def _begun(self, bodies: int, x: Any) -> Carried:
        none, sums = jnp.zeros(bodies, jnp.int32), jnp.zeros((bodies, self.segment // 2 + 1), x.dtype)
        return Carried(none, none, jnp.zeros((bodies, x.size, self.segment - 1), x.dtype), sums, sums)

    def _taken(self, before: Carried, x: Array, good: Array) -> Carried:
        k, step = good.shape[1], self.segment - self.overlap
        x = jnp.where(good[..., None], x, 0)
        seen = jnp.concatenate([before.last, jnp.swapaxes(x, 1, 2)], axis=-1)
        first = before.time[0] - (self.segment - 1)  # the time of the first of these, possibly before the beginning
        begin = -(-jnp.maximum(first, 0) // step) * step - first  # the first segment that ends here, within `seen`

        def add(sums: tuple[Array, Array], begin: Array) -> tuple[tuple[Array, Array], None]:
            values = jax.lax.dynamic_slice_in_dim(seen, begin, self.segment, axis=-1)
            whole = (begin < k) & jax.lax.dynamic_index_in_dim(good, jnp.minimum(begin, k - 1), axis=1, keepdims=True)
            (high,), (low,) = cp.compensated((sums[0],), (sums[1],), (jnp.where(whole, self._periodogram(values), 0),))
            return (high, low), None

        begins = begin + step * jnp.arange((k - 1) // step + 1, dtype=jnp.int32)
        (high, low), _ = jax.lax.scan(add, (before.high, before.low), begins)
        count = before.counted + jnp.sum(good, axis=1, dtype=jnp.int32)
        return Carried(before.time + k, count, seen[..., k:], high, low)

    def _periodogram(self, values: Array) -> Array:
        """(bodies, f), for an interval of 1, of segments (bodies, m, segment)."""
        if self.detrend:
            values = values - (total(values, -1) / self.segment)[..., None]
        window = self.window.astype(values.dtype)
        window = window / jnp.sqrt(total(window**2))
        amplitude = jnp.fft.rfft(values * window[None, None])
        power = jnp.sum(jnp.real(amplitude) ** 2 + jnp.imag(amplitude) ** 2, axis=1)
        sides = np.full(self.segment // 2 + 1, 2)  # a frequency also stands for its negative, if they differ
        sides[0] = 1
        sides[-1] = 1 if self.segment % 2 == 0 else 2
        return power * jnp.asarray(sides, power.dtype)[None]

    def _sums(self, carried: Carried, counted: Array) -> Sums:
        dtype, rows = carried.high.dtype, self.segment // 2 + 1
        rest = jnp.where(counted, carried.counted, 0) - self.segment
        segments = jnp.where(rest >= 0, rest // (self.segment - self.overlap) + 1, 0).astype(dtype)
        power = jnp.where(counted[:, None], carried.high + carried.low, 0).T
        bodies = len(counted)
        none, no_mean = jnp.zeros((rows, 0, bodies), dtype), jnp.zeros(0, dtype)
        terms = jnp.broadcast_to(segments[None], (rows, bodies))
        return sums_of(power, none, terms, no_mean, jnp.zeros((), dtype), relative=False)

    def of_sums(self, sums: Sums, interval: Array) -> Density:
        density, error = mean_and_error(sums, relative=False)
        interval = interval.astype(density.dtype)
        frequency = jnp.arange(self.segment // 2 + 1, dtype=jnp.int32).astype(density.dtype) / (self.segment * interval)
        return Density(frequency, density * interval, error * interval, sums.number)


def spectrum(
    values: Any,
    segment: int,
    *,
    interval: Any,
    first_bad: Any = None,
    overlap: int | None = None,
    window: Any = "hann",
    detrend: bool = True,
) -> Density:
    """The spectrum of saved values, as computed by `Spectrum` during a run.

    Args:
        values, interval, first_bad: as for `autocorrelation`.
        segment, overlap, window, detrend: as for `Spectrum`.

    Raises:
        ValueError: an argument does not fit.

    Examples:
        >>> x = np.cos(np.pi * np.arange(100.0) / 4) * np.ones((8, 1))  # (bodies, times), a wave of 8 values
        >>> found = ml.observe.spectrum(x, segment=32, interval=0.5)
        >>> found.frequency[jnp.argmax(found.density)].item()  # 1 / (8 * 0.5)
        0.25
    """
    statistic = Spectrum(unused, segment, overlap=overlap, window=window, detrend=detrend)
    return of_values(statistic, values, interval, first_bad)


def _as_window(window: Any, segment: int) -> Array:
    if isinstance(window, str):
        if window == "hann":  # of the period `segment`, as for all spectra
            return as_floats("window", 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(segment) / segment))
        if window == "boxcar":
            return as_floats("window", np.ones(segment))
        raise ValueError(
            f"window must be 'hann', 'boxcar' or the numbers of another window, such as those of "
            f"scipy.signal.get_window, got {window!r}."
        )
    found = as_finite("window", window)
    if found.shape != (segment,):
        raise ValueError(f"window must be one number for each value of a segment, ({segment},), got {found.shape}.")
    require("window", jnp.any(found != 0), bool, "must not be zero everywhere", "give another one.")
    return found
