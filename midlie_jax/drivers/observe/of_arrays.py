"""`autocorrelation` and `spectrum` of values in memory, such as the saved values of a run."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import as_floats, described, require
from .correlations import Autocorrelation, Correlation
from .series import Series
from .spectra import Density, Spectrum


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
        ValueError: an argument does not fit; the message names it and the remedy.

    Examples:
        >>> x = np.cos(np.pi * np.arange(100.0) / 4) * np.ones((8, 1))  # (bodies, times), a wave of 8 values
        >>> found = ml.observe.autocorrelation(x, lags=20, interval=0.5)
        >>> found.lag[8].item(), round(float(found.correlation[8]), 2)
        (4.0, 0.5)
    """
    return _of(Autocorrelation(_values, lags, centred=centred, normalised=normalised), values, interval, first_bad)


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
        ValueError: an argument does not fit; the message names it and the remedy.

    Examples:
        >>> x = np.cos(np.pi * np.arange(100.0) / 4) * np.ones((8, 1))  # (bodies, times), a wave of 8 values
        >>> found = ml.observe.spectrum(x, segment=32, interval=0.5)
        >>> found.frequency[jnp.argmax(found.density)].item()  # 1 / (8 * 0.5)
        0.25
    """
    statistic = Spectrum(_values, segment, overlap=overlap, window=window, detrend=detrend)
    return _of(statistic, values, interval, first_bad)


def _values(t: Any, state: Any) -> Any:
    """A placeholder for an observable whose values exist already."""
    raise AssertionError


def _of(statistic: Series, values: Any, interval: Any, first_bad: Any) -> Any:
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
    require(
        "interval",
        step,
        lambda h: np.isfinite(h) & (h != 0),
        "must be finite and not zero",
        "give the time between two values.",
    )
    count = jnp.full(x.shape[0], x.shape[1], jnp.int32) if first_bad is None else jnp.asarray(first_bad)
    if count.shape != x.shape[:1] or not jnp.issubdtype(count.dtype, jnp.integer):
        raise ValueError(f"first_bad must be one integer for each body, {x.shape[:1]}, got {described(first_bad)}.")
    return _of_values(statistic, x, count.astype(jnp.int32), step)


@eqx.filter_jit
def _of_values(statistic: Series, values: Array, first_bad: Array, interval: Array) -> Any:
    good = jnp.arange(values.shape[1], dtype=jnp.int32)[None] < first_bad[:, None]
    return statistic.of_bodies(values, good, interval)
