"""The instruments: angular velocities, attitudes, directions, and positions of markers."""

from typing import Any

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, is_unit, require, require_finite
from ..._math import components as cp
from ...model import so3
from ...model.state import AnyState
from ...model.states import TravellingState, attitude_of
from .base import Expected, Recorded, deviations, rows
from .source import Part, Source, source

_SMALL_ANGLE = 1e-3  # below it, the quotient of an angle and its sine is computed by a series


class Rates(Expected):
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

    Examples:
        >>> times, seen = np.arange(3.0), np.deg2rad([[10.0, 20.0, 30.0], [-4.7, 22.9, 28.4], [-16.9, np.nan, 33.4]])
        >>> guess = {"bias": ml.fitting.Free([0.0, 0.0, 0.0])}
        >>> gyroscope = ml.fitting.Rates(times, seen, sigma=np.deg2rad(0.02), bias="bias")  # a parameter of the fit
        >>> gyroscope.present.sum().item()  # of nine numbers one is missing
        8
    """

    bias: Source | None

    def __init__(
        self, times: Any, values: Any, sigma: Any, bias: Part | Any = None, *, clock: Part | float | None = None
    ):
        self._record(times, values, sigma, (3,), clock)
        self.bias = source("bias", bias, (3,))

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        rates = body.velocity(state.momentum)
        return rates if self.bias is None else rates + self.bias(parameters)


class Attitudes(Recorded):
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

    Examples:
        >>> seen = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.0, 0.0, 0.6], [np.nan, 0.0, 0.0, 0.0]])  # none at the end
        >>> tracker = ml.fitting.Attitudes(np.arange(3.0), seen, sigma=[1e-4, 1e-4, 1e-3])  # worse about axis 3
        >>> tracker.present[:, 0]
        Array([ True,  True, False], dtype=bool)
    """

    def __init__(self, times: Any, values: Any, sigma: Any, *, clock: Part | float | None = None):
        self.clock = source("clock", clock, ())
        self.times, numbers, present = rows(times, values, (4,), whole=True)
        # A missing row must still hold a rotation, because derivatives read it.
        identity = jnp.eye(4, dtype=numbers.dtype)[:1]
        self.values = jnp.where(present, numbers, identity)
        require("values", self.values, is_unit, "must be unit quaternions (w, x, y, z)", "divide each by its norm.")
        self.present = present[:, :3]
        self.sigma = deviations(sigma, self.values[:, :3])

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        del parameters, body
        return so3.log(so3.multiply(so3.conjugate(self.values), attitude_of(states)))


class Directions(Recorded):
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

    Examples:
        >>> seen = np.array([[30.0, 5.0, 2.0], [28.0, 9.0, 1.0], [25.0, 14.0, 0.0]])  # microtesla, at three times
        >>> guess = {"iron": ml.fitting.Free([0.0, 0.0, 0.0])}  # a parameter of the fit
        >>> field = ml.fitting.Directions(np.arange(3.0), seen, sigma=0.01, reference=[0.6, 0.0, -0.8], bias="iron")
        >>> field.present.shape  # two angles at each time
        (3, 2)
    """

    reference: Float[Array, "n 3"]
    bias: Source | None

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
        self.bias, self.clock = source("bias", bias, (3,)), source("clock", clock, ())
        self.times, numbers, present = rows(times, values, (3,), whole=True)
        numbers = jnp.where(present, numbers, jnp.eye(3, dtype=numbers.dtype)[:1])
        self.values = _unit("values", numbers) if bias is None else numbers
        self.present = present[:, :2]
        self.sigma = deviations(sigma, self.values[:, :2])
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


class Positions(Expected):
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

    Examples:
        >>> times, seen = np.arange(3.0), np.zeros((3, 2, 3))  # two markers at three times
        >>> seen[1, 0] = np.nan  # a hidden marker
        >>> cameras = ml.fitting.Positions(times, seen, sigma=1e-3, markers=[[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
        >>> cameras.present[:, 0, 0]
        Array([ True, False,  True], dtype=bool)
    """

    markers: Source
    origin: Source | None

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
        array = as_floats("values", values)
        shape = (1, 3) if array.ndim == 2 else array.shape[1:]
        if array.ndim not in (2, 3) or shape[-1] != 3:
            raise ValueError(f"values must have shape (n, 3) or (n, m, 3), got {array.shape}.")
        self._record(times, array.reshape(array.shape[0], *shape), sigma, shape, clock)
        self.markers = Source.of("markers", markers, shape)
        self.origin = source("origin", origin, (3,))

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        expected = so3.rotate(attitude_of(state)[None], self.markers(parameters).reshape(-1, 3))
        if isinstance(state, TravellingState):
            expected = expected + state.position[None]
        return expected if self.origin is None else expected + self.origin(parameters).reshape(1, 3)


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
