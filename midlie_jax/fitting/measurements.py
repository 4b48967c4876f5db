"""Measurements of a rotating body, each with its residual: the difference from a model, in units of its sigma.

A value that is NaN is missing: its residual is zero and it is not counted. Shapes are those of one data set; to fit
many data sets at once, map over the arrays of a measurement with `jax.vmap`.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from .._checks.arguments import as_floats, is_unit, require, require_finite
from .._math import components as cp
from ..model import so3
from ..model.state import AnyState
from ..model.states import TravellingState, attitude_of
from ..model.torques import TorqueLike, on_body, without_gravity
from ..model.wrench import Wrench

Part = str | Callable[[Any], Array] | Array  # a name in the values, a function of the values, or a known array
_SMALL_ANGLE = 1e-3  # below it, the quotient of an angle and its sine is computed by a series


class Source(eqx.Module):
    """Where a quantity of an instrument comes from: see `Part`.

    Attributes:
        rule: the name of a parameter, a function of the values of the parameters, or None if the quantity is known.
        known: the known quantity, or None.
    """

    rule: str | Callable[..., Any] | None = eqx.field(static=True)
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
        """The quantity for these values of the parameters."""
        if isinstance(self.rule, str):
            return parameters[self.rule]
        return self.known if self.rule is None else self.rule(parameters)


class Measurement(eqx.Module):
    """Values at times.

    Attributes:
        times: (n,), ascending, in the unit of time of the model.
        values: (n, ...), zero where missing.
        sigma: standard deviations of the residuals' entries, broadcast to their shape (n, ...).
        present: (n, ...), False where a value is missing.
        clock: how far the clock of the instrument is ahead of the model's time; None if both agree.
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


class Rates(Measurement):
    """Angular velocities in the body frame, as a gyroscope measures them.

    Args:
        times: (n,), ascending.
        values: (n, 3), radians per unit of time; NaN where missing.
        sigma: standard deviation in radians per unit of time: one number, (3,), or (n, 3).
        bias: what the gyroscope adds to the true rate: the name of a parameter (3,) of the guess, a function of the
            values of the parameters that returns (3,), or a known array (3,). None means no bias.
        clock: how far the instrument's clock is ahead of the model's time, in the unit of time: the name of a parameter
            (), a function of the values of the parameters, or a known number. None means that both agree.

    Raises:
        ValueError: no rows, times not ascending, wrong shapes, no value present, infinite values, or a sigma that is
            not positive.
    """

    times: Float[Array, " n"]
    values: Float[Array, "n 3"]
    sigma: Float[Array, "n 3"]
    present: Bool[Array, "n 3"]
    bias: Source | None
    clock: Source | None

    def __init__(
        self, times: Any, values: Any, sigma: Any, bias: Part | Any = None, *, clock: Part | float | None = None
    ):
        self.times, self.values, self.present = _rows(times, values, (3,))
        self.sigma = _deviations(sigma, self.values)
        self.bias, self.clock = _source("bias", bias, (3,)), _source("clock", clock, ())

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        rates = velocities(body, states)
        return rates - self.values if self.bias is None else rates + self.bias(parameters)[None] - self.values


class Attitudes(Measurement):
    """Attitudes, as a star tracker or motion capture measures them.

    The residual is the rotation vector from the measured attitude to that of the model, in the body frame; its length
    is the geodesic distance. q and -q are the same attitude.

    Args:
        times: (n,), ascending.
        values: (n, 4), unit quaternions (w, x, y, z) from body to space; a row with a NaN is missing.
        sigma: standard deviation of the rotation about each body axis in radians: one number, (3,), or (n, 3).
        clock: as for `Rates`.

    Raises:
        ValueError: as for `Rates`, or a quaternion whose length is not 1 to 1e-3.
    """

    times: Float[Array, " n"]
    values: Float[Array, "n 4"]
    sigma: Float[Array, "n 3"]
    present: Bool[Array, "n 3"]
    clock: Source | None

    def __init__(self, times: Any, values: Any, sigma: Any, *, clock: Part | float | None = None):
        self.clock = _source("clock", clock, ())
        self.times, numbers, present = _rows(times, values, (4,), whole=True)
        # A missing row must still hold a rotation, because derivatives read it.
        identity = jnp.eye(4, dtype=numbers.dtype)[:1]
        self.values = jnp.where(present, numbers, identity)
        require("values", self.values, is_unit, "must be unit quaternions (w, x, y, z)", "divide each by its norm.")
        self.present = present[:, :3]
        self.sigma = _deviations(sigma, self.values[:, :3])

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        del parameters, body
        return so3.log(so3.multiply(so3.conjugate(self.values), attitude_of(states)))


class Directions(Measurement):
    """Directions known in the space frame and measured in the body frame, as a sun sensor or a magnetometer does.

    The residual is the angle from the measured direction to that of the model, as two components perpendicular to the
    measured direction. Lengths do not matter, unless there is a bias.

    Args:
        times: (n,), ascending.
        values: (n, 3), body frame, of any length but zero; a row with a NaN is missing.
        sigma: standard deviation of each of the two angles in radians: one number, (2,), or (n, 2).
        reference: the known direction in the space frame, (3,), or (n, 3) if it changes with time.
        bias: what the instrument adds to the vector, in the unit of `values`, such as the field of iron that turns with
            a magnetometer; given in the three forms of the bias of `Rates`. None means no bias.
        clock: as for `Rates`.

    Raises:
        ValueError: as for `Rates`, or a direction of length zero.
    """

    times: Float[Array, " n"]
    values: Float[Array, "n 3"]
    sigma: Float[Array, "n 2"]
    present: Bool[Array, "n 2"]
    reference: Float[Array, "n 3"]
    bias: Source | None
    clock: Source | None

    def __init__(
        self,
        times: Any,
        values: Any,
        sigma: Any,
        *,
        reference: Any,
        bias: Part | Any = None,
        clock: Part | float | None = None,
    ):
        self.bias, self.clock = _source("bias", bias, (3,)), _source("clock", clock, ())
        self.times, numbers, present = _rows(times, values, (3,), whole=True)
        numbers = jnp.where(present, numbers, jnp.eye(3, dtype=numbers.dtype)[:1])
        self.values = _unit("values", numbers) if bias is None else numbers
        self.present = present[:, :2]
        self.sigma = _deviations(sigma, self.values[:, :2])
        known = as_floats("reference", reference).astype(numbers.dtype)
        if known.shape not in ((3,), (len(self.times), 3)):
            raise ValueError(f"reference must have shape (3,) or ({len(self.times)}, 3), got {known.shape}.")
        require_finite("reference", known)
        self.reference = _unit("reference", jnp.broadcast_to(known, self.values.shape))

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        del body
        expected = cp.pack(states.seen_from_body(cp.vector(self.reference)))
        measured = self.values
        if self.bias is not None:
            measured = measured - self.bias(parameters)[None]
            square = jnp.sum(measured**2, axis=-1, keepdims=True)
            measured = measured / jnp.sqrt(jnp.where(square > 0, square, jnp.ones_like(square)))
        first, second = _perpendicular(measured)
        x, y = jnp.sum(expected * first, axis=-1), jnp.sum(expected * second, axis=-1)
        cosine, square = jnp.sum(expected * measured, axis=-1), x * x + y * y
        small = (square < _SMALL_ANGLE**2) & (cosine > 0)
        safe = jnp.where(small, jnp.ones_like(square), square)
        series = 1 + square / 6 + 3 * square**2 / 40
        factor = jnp.where(small, series, jnp.arctan2(jnp.sqrt(safe), cosine) / jnp.sqrt(safe))
        return jnp.stack([factor * x, factor * y], axis=-1)


class Positions(Measurement):
    """Positions in the space frame of markers fixed in the body.

    On a body that travels, markers are seen from its centre of mass; a marker (0, 0, 0) is that centre.

    Args:
        times: (n,), ascending.
        values: (n, 3) of one marker, or (n, m, 3), length; NaN where missing.
        sigma: standard deviation in the same unit of length, broadcast to the shape of `values`.
        markers: body-frame coordinates of the markers, (3,) or (m, 3): a known array, the name of a parameter, or a
            function of the values of the parameters.
        origin: position in space of the point about which the body turns, (3,), in the same three forms; None for the
            origin, or for a body that travels.
        clock: as for `Rates`.

    Raises:
        ValueError: as for `Rates`.
    """

    times: Float[Array, " n"]
    values: Float[Array, "n m 3"]
    sigma: Float[Array, "n m 3"]
    present: Bool[Array, "n m 3"]
    markers: Source
    origin: Source | None
    clock: Source | None

    def __init__(
        self,
        times: Any,
        values: Any,
        sigma: Any,
        *,
        markers: Part | Any,
        origin: Part | Any = None,
        clock: Part | float | None = None,
    ):
        self.clock = _source("clock", clock, ())
        array = as_floats("values", values)
        shape = (1, 3) if array.ndim == 2 else array.shape[1:]
        if array.ndim not in (2, 3) or shape[-1] != 3:
            raise ValueError(f"values must have shape (n, 3) or (n, m, 3), got {array.shape}.")
        self.times, self.values, self.present = _rows(times, array.reshape(array.shape[0], *shape), shape)
        self.sigma = _deviations(sigma, self.values)
        self.markers = Source.of("markers", markers, shape)
        self.origin = _source("origin", origin, (3,))

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        del body
        markers = self.markers(parameters).reshape(1, -1, 3)
        expected = so3.rotate(attitude_of(states)[:, None], markers)
        if isinstance(states, TravellingState):
            expected = expected + states.position[:, None]
        if self.origin is not None:
            expected = expected + self.origin(parameters).reshape(1, 1, 3)
        return expected - self.values


class Accelerations(Measurement):
    """Specific forces in the body frame, as an accelerometer measures them: its acceleration without that of gravity.

    The model is R^T (a - g) + Omega' x r + Omega x (Omega x r), with the acceleration a of the centre of mass of a body
    that travels, zero for one that turns about a fixed point; r is the place of the instrument, and Omega' is from
    Euler's equations with the torque of the model.

    Args:
        times: (n,), ascending.
        values: (n, 3), length/time^2; NaN where missing.
        sigma: standard deviation in the same unit: one number, (3,), or (n, 3).
        lever: the place r of the instrument, from the centre of mass or the fixed point, body frame, (3,): a known
            array, the name of a parameter, or a function of the values of the parameters.
        gravity: the acceleration g of gravity, space frame, (3,), in the same three forms. None if terms of the torque
            on a body that travels are gravity: `UniformGravity`, `PointMass` and `Oblateness`, and no others.
        bias: what the instrument adds, (3,), in the same three forms. None means no bias.
        clock: as for `Rates`.

    Raises:
        ValueError: as for `Rates`.
    """

    times: Float[Array, " n"]
    values: Float[Array, "n 3"]
    sigma: Float[Array, "n 3"]
    present: Bool[Array, "n 3"]
    lever: Source
    gravity: Source | None
    bias: Source | None
    clock: Source | None
    run: tuple[TorqueLike | None, Array] | None

    def __init__(
        self,
        times: Any,
        values: Any,
        sigma: Any,
        *,
        lever: Part | Any,
        gravity: Part | Any = None,
        bias: Part | Any = None,
        clock: Part | float | None = None,
    ):
        self.times, self.values, self.present = _rows(times, values, (3,))
        self.sigma = _deviations(sigma, self.values)
        self.lever, self.gravity = Source.of("lever", lever, (3,)), _source("gravity", gravity, (3,))
        self.bias, self.clock = _source("bias", bias, (3,)), _source("clock", clock, ())
        self.run = None

    def of_run(self, torque: TorqueLike | None, times: Float[Array, " n"]) -> "Accelerations":
        return eqx.tree_at(lambda m: m.run, self, (torque, times), is_leaf=lambda x: x is None)

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        assert self.run is not None
        torque, times = self.run
        bound, pushing = on_body(torque, body), on_body(without_gravity(torque), body)
        lever = self.lever(parameters).reshape(3)
        gravity = None if self.gravity is None else self.gravity(parameters).reshape(3)

        def measured(t: Array, state: Any) -> Array:
            zeros, rates = jnp.zeros_like(state.momentum), body.velocity(state.momentum)
            moment = zeros if bound is None else Wrench.of(bound(t, state)).torque
            change = body.velocity(jnp.cross(state.momentum, rates) + moment)
            felt = zeros if gravity is None else -gravity
            if isinstance(state, TravellingState) and pushing is not None:
                felt = felt + Wrench.of(pushing(t, state)).force / body.mass
            of_turning = jnp.cross(change, lever) + jnp.cross(rates, jnp.cross(rates, lever))
            return cp.pack(state.seen_from_body(cp.vector(felt))) + of_turning

        expected = jax.vmap(measured)(times, states)
        return expected - self.values if self.bias is None else expected + self.bias(parameters)[None] - self.values


def _source(name: str, part: Any, shape: tuple[int, ...]) -> Source | None:
    return None if part is None else Source.of(name, part, shape)


def velocities(body: Any, states: AnyState) -> Float[Array, "n 3"]:
    """The angular velocities (n, 3) of several states of one body, body frame."""
    return jax.vmap(body.velocity)(states.momentum)


def _rows(times: Any, values: Any, shape: tuple[int, ...], whole: bool = False) -> tuple[Array, Array, Array]:
    """Times, values with zeros where missing, and which are present; with `whole`, only rows without a NaN are."""
    t, array = as_floats("times", times), as_floats("values", values)
    if t.ndim != 1 or not t.size:
        raise ValueError(f"times must have shape (n,) with n >= 1, got {t.shape}; give at least one row.")
    if array.shape != (t.size, *shape):
        raise ValueError(f"values must have shape {(t.size, *shape)}, one row for each time, got {array.shape}.")
    require_finite("times", t)
    require("times", t, lambda x: np.diff(x) >= 0, "must ascend", "sort the rows by time, for example with np.argsort.")
    present = ~jnp.isnan(array)
    array = jnp.where(present, array, jnp.zeros_like(array))
    require("values", array, np.isfinite, "must be finite, or NaN where missing", "check the rows with infinities.")
    if whole:
        present = jnp.broadcast_to(jnp.all(present, axis=-1, keepdims=True), present.shape)
    if not cp.is_traced(present) and not np.any(present):
        raise ValueError("values are NaN in every row, so there is nothing to fit; check the columns of the data.")
    return t.astype(array.dtype), array, present


def _deviations(sigma: Any, like: Array) -> Array:
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


def _unit(name: str, vectors: Array) -> Array:
    length = jnp.linalg.norm(vectors, axis=-1, keepdims=True)
    require(name, length, lambda x: x > 0, "must not be zero", "mark a missing direction by NaN.")
    return vectors / length


def _perpendicular(directions: Float[Array, "n 3"]) -> tuple[Array, Array]:
    """Two unit vectors that are perpendicular to each direction and to each other."""
    axes = jnp.eye(3, dtype=directions.dtype)[jnp.argmin(jnp.abs(directions), axis=-1)]
    first = jnp.cross(directions, axes)
    first = first / jnp.linalg.norm(first, axis=-1, keepdims=True)
    return first, jnp.cross(directions, first)


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
