"""`Measurement`: values at times, each with its residual; and the checks of what all measurements hold."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from ..._checks.arguments import as_floats, require, require_finite, require_resolved
from ..._math import components as cp
from ...model.state import AnyState
from ...model.torques import TorqueLike
from .source import Source, source


class Measurement(eqx.Module):
    """Values at times.

    Attributes:
        times: (n,), ascending, in the unit of time of the model.
        values: (n, ...), zero where missing.
        sigma: standard deviations of the residuals' entries, broadcast to their shape (n, ...).
        present: (n, ...), False where a value is missing.
        clock: how far the clock of the instrument is ahead of the model's time; None if both agree.

    Examples:
        >>> seen = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, np.nan]])
        >>> gyroscope = ml.fitting.Rates(np.array([0.0, 1.0]), seen, sigma=0.1)
        >>> states = ml.MomentumState([[0.2, 0.2, 0.3], [0.1, 0.2, 0.3]])  # of the model at these times
        >>> gyroscope.residuals({}, ml.RigidBody([1.0, 1.0, 1.0]), states).round(6)  # (6,)
        Array([1., 0., 0., 0., 0., 0.], dtype=float64)
    """

    times: eqx.AbstractVar[Float[Array, " n"]]
    values: eqx.AbstractVar[Array]
    sigma: eqx.AbstractVar[Array]
    present: eqx.AbstractVar[Bool[Array, "..."]]
    clock: eqx.AbstractVar[Source | None]

    def times_of_model(self, parameters: Any) -> Float[Array, " n"]:
        """The times at which the values were measured, on the model's clock."""
        return self.times if self.clock is None else self.times - self.clock(parameters).reshape(())

    @abstractmethod
    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        """Model minus measurement, of the shape of `present`.

        Args:
            parameters: the values of all parameters.
            body: the body of the model.
            states: the model's states at `times`.
        """

    def subject(self, body: Any, states: Any) -> tuple[Any, Any, Any]:
        """The measurement of one body, that body, and its states; a ValueError if the model holds several."""
        if states.several:
            raise ValueError(
                f"the model starts from a {type(states).__name__} of several bodies: say of which the "
                f"{type(self).__name__} are, as in midlie_jax.fitting.OfBody(0, ...)."
            )
        return self, body, states

    def of_run(self, torque: TorqueLike | None, times: Float[Array, " n"]) -> "Measurement":
        """The measurement for a run under this torque; `times` are those of the states. By default, itself."""
        del torque, times
        return self

    def residuals(self, parameters: Any, body: Any, states: AnyState) -> Float[Array, " r"]:
        """The differences over sigma, flat; zero where a value is missing."""
        differences = self.differences(parameters, body, states)
        return jnp.where(self.present, differences / self.sigma, jnp.zeros_like(differences)).reshape(-1)


class Recorded(Measurement):
    """A measurement that holds its own values: the fields of all instruments."""

    times: Float[Array, " n"]
    values: Float[Array, "n ..."]
    sigma: Float[Array, "n ..."]
    present: Bool[Array, "n ..."]
    clock: Source | None

    def _record(self, times: Any, values: Any, sigma: Any, shape: tuple[int, ...], clock: Any) -> None:
        """Checks and keeps the arguments of an instrument, with values of this shape at each time."""
        self.times, self.values, self.present = rows(times, values, shape)
        self.sigma, self.clock = deviations(sigma, self.values), source("clock", clock, ())


class Expected(Recorded):
    """A measurement whose residual is the difference from what the model lets expect at each time alone."""

    @abstractmethod
    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        """What the instrument should show at one time, of the shape of one value."""

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        times = self.times_of_model(parameters)
        return jax.vmap(lambda t, state: self.expected(t, state, body, parameters))(times, states) - self.values


def rows(times: Any, values: Any, shape: tuple[int, ...], whole: bool = False) -> tuple[Array, Array, Array]:
    """Times, values with zeros where missing, and which are present; with `whole`, only rows without a NaN are."""
    t, array = as_floats("times", times), as_floats("values", values)
    if t.ndim != 1 or not t.size:
        raise ValueError(f"times must have shape (n,) with n >= 1, got {t.shape}; give at least one row.")
    if array.shape != (t.size, *shape):
        raise ValueError(f"values must have shape {(t.size, *shape)}, one row for each time, got {array.shape}.")
    require_finite("times", t)
    require_resolved("times", times, array.dtype)
    require("times", t, lambda x: np.diff(x) >= 0, "must ascend", "sort the rows by time, for example with np.argsort.")
    present = ~jnp.isnan(array)
    array = jnp.where(present, array, jnp.zeros_like(array))
    require("values", array, np.isfinite, "must be finite, or NaN where missing", "check the rows with infinities.")
    if whole:
        present = jnp.broadcast_to(jnp.all(present, axis=-1, keepdims=True), present.shape)
    if not cp.is_traced(present) and not np.any(present):
        raise ValueError("values are NaN in every row, so there is nothing to fit; check the columns of the data.")
    return t.astype(array.dtype), array, present


def deviations(sigma: Any, like: Array) -> Array:
    """Sigma as an array, checked and broadcast to the shape of the residuals."""
    array = as_floats("sigma", sigma).astype(like.dtype)
    cure = "give the standard deviation in the unit of the residual."
    require("sigma", array, lambda s: np.isfinite(s) & (s > 0), "must be positive and finite", cure)
    try:
        np.broadcast_shapes(array.shape, like.shape)
        fits = array.ndim <= like.ndim
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(f"sigma must broadcast to {like.shape}, got {array.shape}; give one number for all rows.")
    return jnp.broadcast_to(array, like.shape)


def check_parts(measurement: Measurement, names: set[str]) -> None:
    """Raises a ValueError for a `Part` that names no parameter."""
    for field in ("bias", "markers", "origin", "lever", "gravity", "clock"):
        source = getattr(measurement, field, None)
        rule = source.rule if isinstance(source, Source) else None
        if isinstance(rule, str) and rule not in names:
            raise ValueError(
                f"{field} of {type(measurement).__name__} names the parameter {rule!r}, which is not in the guess; "
                f"add it: guess = {{..., {rule!r}: Free({'0.0' if field == 'clock' else '[0.0, 0.0, 0.0]'})}}."
            )
