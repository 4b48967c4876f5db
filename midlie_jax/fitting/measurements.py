"""Measurements for a fit: values at times, and their residuals, model minus measurement in units of sigma.

A NaN value is missing: its residual is zero and it is not counted. Shapes are given for one data set. To fit many data
sets at once, map over the arrays of a measurement with `jax.vmap`.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from .._checks.arguments import as_floats, require, require_finite, require_function, require_resolved
from .._math import components as cp
from ..model.state import AnyState
from ..model.torques import TorqueLike
from .loss import Loss

Part = str | Callable[[Any], Array] | Any  # a name in the values, a function of the values, or a known array
_ARGUMENTS = "t, state, body, values"


class Source(eqx.Module):
    """The source of a quantity of an instrument, such as its bias: see `Part`."""

    rule: str | Callable[..., Any] | None = eqx.field(static=True)  # None for a known quantity
    known: Array | None

    @classmethod
    def of(cls, name: str, part: Any, shape: tuple[int, ...]) -> "Source":
        """The source, from an argument; the shape of a known array is checked."""
        if isinstance(part, str) or callable(part):
            return cls(part, None)
        array = as_floats(name, part)
        if array.size != int(np.prod(shape)):
            raise ValueError(f"{name} must have shape {shape}, got {array.shape}.")
        require_finite(name, array)
        return cls(None, array.reshape(shape))

    def __call__(self, parameters: Any) -> Any:
        if isinstance(self.rule, str):
            return parameters[self.rule]
        return self.known if self.rule is None else self.rule(parameters)


def source(name: str, part: Any, shape: tuple[int, ...]) -> Source | None:
    """The source, or None if there is no such quantity."""
    return None if part is None else Source.of(name, part, shape)


class Measurement(eqx.Module):
    """Values at times.

    Attributes:
        times: (n,), ascending, in the unit of time of the model.
        values: (n, ...), zero where missing.
        sigma: standard deviations of the residuals' entries, broadcast to their shape (n, ...).
        present: (n, ...), False where a value is missing.
        clock: how far the clock of the instrument is ahead of the model's time; None for no offset.

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
        """The times of the values on the model's clock."""
        return self.times if self.clock is None else self.times - self.clock(parameters).reshape(())

    @abstractmethod
    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        """Model minus measurement, of the shape of `present`, for the values of all parameters and the model's states
        at `times`.
        """

    def unbiased(self, parameters: Any) -> Array:
        """The values without the bias of the instrument, if it has one."""
        bias = getattr(self, "bias", None)
        return self.values if bias is None else self.values - bias(parameters)[None]

    def subject(self, body: Any, states: Any) -> tuple[Any, Any, Any]:
        """The measurement of one body, that body, and its states; raises a ValueError if the model holds several."""
        if states.several:
            raise ValueError(
                f"{type(self).__name__} must be of one body, got a {type(states).__name__} of several; name the body, "
                "as in midlie_jax.fitting.OfBody(0, ...)."
            )
        return self, body, states

    def of_run(self, torque: TorqueLike | None) -> "Measurement":
        """The measurement for a run under this torque; by default, itself."""
        return self

    @property
    def linear(self) -> int:
        """The number of linear unknowns, such as zero points, that are eliminated; by default none."""
        return 0

    def eliminated(self, residuals: Array, loss: Loss | None) -> tuple[Float[Array, " r"], Float[Array, " linear"]]:
        """The residuals (r,) at the best values of the linear unknowns, and these values."""
        return residuals, jnp.zeros(0, residuals.dtype)

    def residuals(self, parameters: Any, body: Any, states: AnyState) -> Float[Array, " r"]:
        """The differences over sigma, flat; zero where a value is missing."""
        differences = self.differences(parameters, body, states)
        return jnp.where(self.present, differences / self.sigma, jnp.zeros_like(differences)).reshape(-1)


class Recorded(Measurement):
    """A measurement that holds its values in arrays: the fields of all instruments."""

    times: Float[Array, " n"]
    values: Float[Array, "n ..."]
    sigma: Float[Array, "n ..."]
    present: Bool[Array, "n ..."]
    clock: Source | None
    bias: Source | None

    def _record(
        self, times: Any, values: Any, sigma: Any, shape: tuple[int, ...], clock: Any, bias: Any = None, angles: int = 0
    ) -> None:
        """Checks and stores the arguments of an instrument, with values of this shape at each time.

        If the residuals are `angles`, so many for each value, a value is present or missing as a whole.
        """
        self.times, self.values, self.present = rows(times, values, shape, whole=angles > 0)
        like = self.values
        if angles:
            # A missing row must still hold a rotation or direction, because derivatives read it.
            self.values = jnp.where(self.present, self.values, jnp.eye(*shape, dtype=like.dtype)[:1])
            self.present, like = self.present[:, :angles], like[:, :angles]
        self.sigma = deviations(sigma, like)
        self.clock, self.bias = source("clock", clock, ()), source("bias", bias, (3,))


class Expected(Recorded):
    """A measurement whose residual at each time depends only on the state at this time."""

    @abstractmethod
    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        """The expected value at one time without the bias of the instrument, of the shape of one value."""

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        times = self.times_of_model(parameters)
        found = jax.vmap(lambda t, state: self.expected(t, state, body, parameters))(times, states)
        return (found if self.bias is None else found + self.bias(parameters)[None]) - self.values


class Observed(Expected):
    """Any measurement of any quantity: the residual is (function - value) / sigma.

    `function(t, state, body, values)` is called for one time, and mapped over all:

    - `t` is the time, (), on the clock of the model.
    - `state` is the model's state at this time, such as a `RigidState`. For coupled bodies it holds all bodies; inside
      `OfBody(i, ...)` it holds body i only.
    - `body` is the body that the model returned; `body.velocity(state.momentum)` is the angular velocity, body frame.
    - `values` are the values of the parameters, of the structure of the guess.

    Write it with `jax.numpy`, as a pure function. The angular acceleration is `body.velocity(jnp.cross(state.momentum,
    rates) + moment)`, with the moment (3,) of the model's torque, zero for a free body. Pass the same function to reuse
    the compiled program. A function with arrays to be mapped over or differentiated is an `equinox.Module` with
    `__call__`, or a `jax.tree_util.Partial`.

    Args:
        times, clock: as for `Rates`.
        values: (n,) or (n, k), or with further axes, in any unit; NaN where missing.
        sigma: standard deviation in the unit of the values, broadcast to their shape.
        function: see above; its value has the shape of one of `values`: () or (k,).

    Raises:
        ValueError: as for `Rates`, or `function` cannot be called; in `fit` and `prepare`, its value has another shape
            or dtype than the values, or it uses an unknown parameter.

    Examples:
        >>> def range_rate(t, state, body, values):  # of a mark at (1, 0, 0) in the body, seen from far away on x
        ...     velocity = jnp.cross(body.velocity(state.momentum), jnp.array([1.0, 0.0, 0.0]))
        ...     return ml.so3.rotate(state.attitude, velocity)[0]
        >>> seen = np.array([0.02, 0.05, 0.01])
        >>> radar = ml.fitting.Observed(np.arange(3.0), seen, sigma=0.01, function=range_rate)  # for ml.fit
        >>> radar.values.shape
        (3,)
    """

    function: Callable[..., Any]

    def __init__(self, times: Any, values: Any, sigma: Any, function: Callable[..., Any] | Any, *, clock: Part = None):
        require_function("function", function, _ARGUMENTS)
        self._record(times, values, sigma, as_floats("values", values).shape[1:], clock)
        self.function = with_arrays(function)

    def subject(self, body: Any, states: Any) -> tuple[Any, Any, Any]:
        return self, body, states

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        return jnp.asarray(self.function(t, state, body, parameters))

    def check(self, parameters: Any, body: Any, start: AnyState) -> None:
        """Raises a ValueError unless the function fits the values, by its value for the first state."""
        try:
            found = jax.eval_shape(self.expected, self.times[0], start, body, parameters)
        except KeyError as error:
            raise ValueError(f"function must use parameters of the guess, got {error}, which is not in it.") from error
        except TypeError as error:
            raise ValueError(f"function must accept ({_ARGUMENTS}) and return an array: {error}") from error
        wanted = self.values.shape[1:]
        if found.shape != wanted:
            rest = "" if wanted else "; if it returns (1,), give values (n, 1)"
            raise ValueError(f"function must return shape {wanted}, as values at one time, got {found.shape}{rest}.")
        if found.dtype != self.values.dtype:
            raise ValueError(
                f"function must return {self.values.dtype}, as values are, got {found.dtype}; cast one of them, such "
                "as the arrays that the function holds."
            )


def with_arrays(function: Any) -> Callable[..., Any]:
    """A function whose arrays, if it holds any, are arrays of the measurement; a plain function is static."""
    holds = isinstance(function, eqx.Module | jax.tree_util.Partial)
    return cast(Callable[..., Any], function if holds else jax.tree_util.Partial(function))


def rows(times: Any, values: Any, shape: tuple[int, ...], whole: bool = False) -> tuple[Array, Array, Array]:
    """Times, values with zeros where missing, and which are present; with `whole`, only rows without a NaN."""
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
        raise ValueError("values must have a row that is present, got NaN in every row; check the columns of the data.")
    return t.astype(array.dtype), array, present


def deviations(sigma: Any, like: Array) -> Array:
    """Sigma as an array, checked and broadcast to the shape of the residuals."""
    array = as_floats("sigma", sigma).astype(like.dtype)
    cure = "give the standard deviation in the unit of the residual."
    require("sigma", array, lambda s: np.isfinite(s) & (s > 0), "must be positive and finite", cure)
    try:
        return jnp.broadcast_to(array, like.shape)
    except ValueError:
        raise ValueError(
            f"sigma must broadcast to {like.shape}, got {array.shape}; give one number for all rows."
        ) from None


def parted(measurements: Sequence[Measurement], residuals: Any) -> list[Array]:
    """All residuals (r,), cut into one array per measurement, of the shape of its `present`."""
    parts = jnp.split(residuals, np.cumsum([m.present.size for m in measurements])[:-1])
    return [part.reshape(m.present.shape) for m, part in zip(measurements, parts, strict=True)]


def check_parts(measurement: Measurement, names: set[str]) -> None:
    """Raises a ValueError for a `Part` that names no parameter."""
    for field in ("bias", "reference", "markers", "origin", "lever", "gravity", "clock"):
        rule = getattr(getattr(measurement, field, None), "rule", None)
        if isinstance(rule, str) and rule not in names:
            parts = {"clock": "Free(0.0)", "reference": "UnitVector([0.0, 0.0, 1.0])"}
            raise ValueError(
                f"{field} of {type(measurement).__name__} must name a parameter, got {rule!r}, which is not in the "
                f"guess; add it: guess = {{..., {rule!r}: {parts.get(field, 'Free([0.0, 0.0, 0.0])')}}}."
            )
