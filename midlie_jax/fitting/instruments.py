"""The classes of measurements: gyroscopes, star trackers, cameras and accelerometers.

`OfBody` is a measurement of one of several coupled bodies.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, described, is_unit, require, require_finite
from .._math import components as cp
from ..model import so3
from ..model.bodies import TensorBody
from ..model.free_body import Wrench
from ..model.state import AnyState, attitude_of
from ..model.states import TravellingState
from ..model.torques import Torque, TorqueLike, kept_terms, on_body, terms_of, without_gravity
from .loss import Loss
from .measurements import Expected, Measurement, Part, Recorded, Source, source

_SMALL_ANGLE = 1e-3  # below it, the quotient of an angle and its sine is a series
_GAUSS = 0.5 - math.sqrt(3) / 6  # the first of the two Gauss points on (0, 1)


class Rates(Expected):
    """Angular velocities in the body frame, as a gyroscope measures them.

    Args:
        times: (n,), ascending.
        values: (n, 3), radians per unit of time; NaN where missing.
        sigma: standard deviation in radians per unit of time: one number, (3,), or (n, 3).
        bias: the bias added to the true rate: the name of a parameter (3,) of the guess, a function of the values of
            the parameters that returns (3,), or a known array (3,). None means no bias.
        clock: how far the instrument's clock is ahead of the model's time, in the same three forms. None means no
            offset.

    Raises:
        ValueError: no rows, times not ascending, wrong shapes, no value present, infinite values, or a sigma that is
            not positive.

    Examples:
        >>> times, seen = np.arange(3.0), np.deg2rad([[10.0, 20.0, 30.0], [-4.7, 22.9, 28.4], [-16.9, np.nan, 33.4]])
        >>> gyroscope = ml.fitting.Rates(times, seen, sigma=np.deg2rad(0.02), bias="bias")  # a parameter of the fit
        >>> gyroscope.present.sum().item()  # of nine numbers one is missing
        8
    """

    def __init__(self, times: Any, values: Any, sigma: Any, bias: Part = None, *, clock: Part = None):
        self._record(times, values, sigma, (3,), clock, bias)

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        return body.velocity(state.momentum)


class Attitudes(Recorded):
    """Attitudes, as a star tracker or motion capture measures them.

    The residual is the rotation vector from the measured attitude to the model's attitude, in the body frame; its
    length is the geodesic distance. q and -q are the same attitude.

    Args:
        times, clock: as for `Rates`.
        values: (n, 4), unit quaternions (w, x, y, z) from body to space; a row with a NaN is missing.
        sigma: standard deviation of the rotation about each body axis in radians: one number, (3,), or (n, 3).

    Raises:
        ValueError: as for `Rates`, or the length of a quaternion is not 1 to 1e-3.

    Examples:
        >>> seen = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.0, 0.0, 0.6], [np.nan, 0.0, 0.0, 0.0]])  # none at the end
        >>> tracker = ml.fitting.Attitudes(np.arange(3.0), seen, sigma=[1e-4, 1e-4, 1e-3])  # worse about axis 3
        >>> tracker.present[:, 0]
        Array([ True,  True, False], dtype=bool)
    """

    def __init__(self, times: Any, values: Any, sigma: Any, *, clock: Part = None):
        self._record(times, values, sigma, (4,), clock, angles=3)
        require("values", self.values, is_unit, "must be unit quaternions (w, x, y, z)", "divide each by its norm.")

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        return so3.log(so3.multiply(so3.conjugate(self.values), attitude_of(states)))


class Directions(Recorded):
    """Directions known in the space frame and measured in the body frame, as by a sun sensor or a magnetometer.

    The residual is the angle from the measured to the model's direction, as two components perpendicular to the
    measured direction. Lengths have no effect, unless there is a bias.

    Args:
        times, clock: as for `Rates`.
        values: (n, 3), body frame, of any nonzero length; a row with a NaN is missing.
        sigma: standard deviation of each of the two angles in radians: one number, (2,), or (n, 2).
        reference: the direction in the space frame: known, (3,), or (n, 3) if it changes with time; the name of a
            parameter, such as a `UnitVector`; or a function of the values of the parameters.
        bias: the bias added to the vector, as for `Rates`, in the unit of `values`.

    Raises:
        ValueError: as for `Rates`, or a direction of length zero.

    Examples:
        >>> seen = np.array([[30.0, 5.0, 2.0], [28.0, 9.0, 1.0], [25.0, 14.0, 0.0]])  # microtesla, at three times
        >>> field = ml.fitting.Directions(np.arange(3.0), seen, sigma=0.01, reference=[0.6, 0.0, -0.8], bias="iron")
        >>> field.present.shape  # two angles at each time
        (3, 2)
    """

    reference: Source

    def __init__(self, times: Any, values: Any, sigma: Any, *, reference: Any, bias: Part = None, clock: Part = None):
        self._record(times, values, sigma, (3,), clock, bias, angles=2)
        if bias is None:
            self.values = _unit("values", self.values)
        if isinstance(reference, str) or callable(reference):
            self.reference = Source(reference, None)
            return
        known = as_floats("reference", reference).astype(self.values.dtype)
        if known.shape not in ((3,), (len(self.times), 3)):
            raise ValueError(f"reference must have shape (3,) or ({len(self.times)}, 3), got {known.shape}.")
        require_finite("reference", known)
        self.reference = Source(None, _unit("reference", jnp.broadcast_to(known, self.values.shape)))

    def differences(self, parameters: Any, body: Any, states: AnyState) -> Array:
        measured = self.unbiased(parameters)
        reference = jnp.broadcast_to(self.reference(parameters), measured.shape)
        expected = cp.pack(states.seen_from_body(cp.vector(reference)))
        if self.bias is not None:
            square = jnp.sum(measured**2, axis=-1, keepdims=True)
            measured = measured / jnp.sqrt(jnp.where(square > 0, square, jnp.ones_like(square)))
        first, second = perpendicular(measured)
        x, y = jnp.sum(expected * first, axis=-1), jnp.sum(expected * second, axis=-1)
        cosine, square = jnp.sum(expected * measured, axis=-1), x * x + y * y
        small = (square < _SMALL_ANGLE**2) & (cosine > 0)
        safe = jnp.where(small, jnp.ones_like(square), square)
        series = 1 + square / 6 + 3 * square**2 / 40
        factor = jnp.where(small, series, jnp.arctan2(jnp.sqrt(safe), cosine) / jnp.sqrt(safe))
        return jnp.stack([factor * x, factor * y], axis=-1)


def _unit(name: str, vectors: Array) -> Array:
    length = jnp.linalg.norm(vectors, axis=-1, keepdims=True)
    require(name, length, lambda x: x > 0, "must not be zero", "mark a missing direction by NaN.")
    return vectors / length


def perpendicular(directions: Float[Array, "n 3"]) -> tuple[Array, Array]:
    """Two unit vectors that are perpendicular to each direction and to each other."""
    axes = jnp.eye(3, dtype=directions.dtype)[jnp.argmin(jnp.abs(directions), axis=-1)]
    first = jnp.cross(directions, axes)
    first = first / jnp.linalg.norm(first, axis=-1, keepdims=True)
    return first, jnp.cross(directions, first)


class Positions(Expected):
    """Positions in the space frame of markers fixed in the body; if it translates, relative to the centre of mass.

    Args:
        times, clock: as for `Rates`.
        values: (n, 3) of one marker, or (n, m, 3), length; NaN where missing.
        sigma: standard deviation in the same unit of length, broadcast to the shape of `values`.
        markers: body-frame coordinates of the markers, (3,) or (m, 3): a known array, the name of a parameter, or a
            function of the values of the parameters.
        origin: position in space of the point about which the body rotates, (3,), in the same three forms; None for the
            origin, or for a body that translates.

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

    def __init__(self, times: Any, values: Any, sigma: Any, *, markers: Part, origin: Part = None, clock: Part = None):
        array = as_floats("values", values)
        shape = (1, 3) if array.ndim == 2 else array.shape[1:]
        if array.ndim not in (2, 3) or shape[-1] != 3:
            raise ValueError(f"values must have shape (n, 3) or (n, m, 3), got {array.shape}.")
        self._record(times, array.reshape(array.shape[0], *shape), sigma, shape, clock)
        self.markers, self.origin = Source.of("markers", markers, shape), source("origin", origin, (3,))

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        expected = so3.rotate(attitude_of(state)[None], self.markers(parameters).reshape(-1, 3))
        if isinstance(state, TravellingState):
            expected = expected + state.position[None]
        return expected if self.origin is None else expected + self.origin(parameters).reshape(1, 3)


class Accelerations(Expected):
    """Specific forces in the body frame, as from an accelerometer: the acceleration without gravity.

    The model is R^T (a - g) + Omega' x r + Omega x (Omega x r). a is the acceleration of the centre of mass of a body
    that translates, and zero for one that rotates about a fixed point. r is the position of the instrument, and Omega'
    is from Euler's equations with the torque of the model. g is the gravity at the instrument: in orbit it differs from
    gravity at the centre of mass by the tidal term, (grad g) R r to first order. The fields of the torque give it, also
    their sum. A `GravityGradient` gives it to first order, if no other term of the torque is gravity.

    Args:
        times, bias, clock: as for `Rates`.
        values: (n, 3), length/time^2; NaN where missing.
        sigma: standard deviation in the same unit: one number, (3,), or (n, 3).
        lever: the position r of the instrument, from the centre of mass or the fixed point, body frame, (3,): a known
            array, the name of a parameter, or a function of the values of the parameters.
        gravity: the acceleration g of gravity at the centre of mass or the fixed point, space frame, (3,), in the same
            three forms; zeros in free fall. None if terms of the torque on a body that translates are gravity:
            `UniformGravity`, `PointMass` and `Oblateness`, and no others.

    Raises:
        ValueError: as for `Rates`.

    Examples:
        >>> times, felt = np.arange(5.0), np.tile([0.0, 0.3, 9.8], (5, 1))  # m/s^2
        >>> instrument = ml.fitting.Accelerations(times, felt, sigma=0.05, lever="lever", gravity=[0.0, 0.0, -9.81])
        >>> instrument.values.shape
        (5, 3)
    """

    lever: Source
    gravity: Source | None
    run: tuple[TorqueLike | None] | None  # the torque of the model, if available

    def __init__(
        self,
        times: Any,
        values: Any,
        sigma: Any,
        *,
        lever: Part,
        gravity: Part = None,
        bias: Part = None,
        clock: Part = None,
    ):
        self._record(times, values, sigma, (3,), clock, bias)
        self.lever, self.gravity = Source.of("lever", lever, (3,)), source("gravity", gravity, (3,))
        self.run = None

    def of_run(self, torque: TorqueLike | None) -> "Accelerations":
        return eqx.tree_at(lambda m: m.run, self, (torque,), is_leaf=lambda x: x is None)

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        assert self.run is not None
        (torque,) = self.run
        bound, pushing = on_body(torque, body), on_body(without_gravity(torque), body)
        zeros, rates, lever = jnp.zeros_like(state.momentum), body.velocity(state.momentum), self.lever(parameters)
        travels = isinstance(state, TravellingState)
        moment = zeros if bound is None else Wrench.of(bound(t, state)).torque
        change = body.velocity(jnp.cross(state.momentum, rates) + moment)
        felt = zeros if self.gravity is None else -self.gravity(parameters).reshape(3)
        if travels and pushing is not None:
            felt = felt + Wrench.of(pushing(t, state)).force / body.mass
        fields = kept_terms(torque, lambda term: isinstance(term, Torque) and term.gravitational) if travels else None
        if fields is not None:
            felt = felt + _fall(fields, t, state, body, lever)
        of_turning = jnp.cross(change, lever) + jnp.cross(rates, jnp.cross(rates, lever))
        measured = cp.pack(state.seen_from_body(cp.vector(felt))) + of_turning
        for term in terms_of(torque) if fields is None else []:
            tide = term.tide(t, state, cp.vector(lever)) if isinstance(term, Torque) else None
            if tide is not None:
                measured = measured - cp.pack(tide)
        return measured


def _fall(fields: TorqueLike, t: Array, state: Any, body: Any, lever: Array) -> Array:
    """The acceleration of a body by gravity, minus the gravity at a point of the body, space frame.

    Both are derivatives, not a difference of nearly equal accelerations: of the force by the moments, in which it is
    linear, and of the field along the lever, at two Gauss points.
    """
    place, along = state.position, so3.rotate(attitude_of(state), lever)
    one = jnp.ones_like(body.mass)

    def field(position: Array, share: Array) -> Array:
        """The acceleration at a position of the body with this share of its moments."""
        principal = isinstance(body.body, TensorBody)
        changed = eqx.tree_at(
            lambda b: b.body.principal if principal else b.body,
            body,
            replace_fn=lambda x: jax.tree.map(lambda m: share * m, x),
        )
        moved = eqx.tree_at(lambda s: s.position, state, position)
        return Wrench.of(on_body(fields, changed)(t, moved)).force / body.mass

    def slope(share: float) -> Array:
        return jax.jvp(lambda x: field(x, 0 * one), (place + share * along,), (along,))[1]

    of_shape = jax.jvp(lambda share: field(place, share), (0 * one,), (one,))[1]
    return of_shape - (slope(_GAUSS) + slope(1 - _GAUSS)) / 2


class OfBody(Measurement):
    """A measurement of the body with this index of a `CoupledState`, such as the attitude of a secondary, index 1.

    Raises:
        ValueError: the index is not a nonnegative integer; or the measurement is an `OfBody` or `Accelerations`.

    Examples:
        >>> times, seen = np.arange(3.0), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
        >>> moon = ml.fitting.OfBody(1, ml.fitting.Attitudes(times, seen, sigma=0.01))  # the second body
        >>> moon.body, moon.values.shape
        (1, (3, 4))
    """

    body: int = eqx.field(static=True)
    measurement: Measurement

    def __init__(self, body: Any, measurement: Any):
        if isinstance(body, bool) or not isinstance(body, int | np.integer) or body < 0:
            raise ValueError(f"body must be the index of a body, from 0, got {body!r}.")
        if not isinstance(measurement, Measurement) or isinstance(measurement, OfBody | Accelerations):
            raise ValueError(
                "measurement must be one of Rates, Attitudes, Directions, Positions and Observed, got "
                f"{described(measurement)}."
            )
        self.body, self.measurement = int(body), measurement

    # The fields of other measurements are read from the inner measurement.
    times, values, sigma, present, clock = (  # pyright: ignore[reportAssignmentType]
        property(lambda self, name=name: getattr(self.measurement, name))
        for name in ("times", "values", "sigma", "present", "clock")
    )

    def subject(self, body: Any, states: Any) -> tuple[Any, Any, Any]:
        if not states.several:
            raise ValueError(
                f"OfBody must be of coupled bodies, got a {type(states).__name__} as the start of the model."
            )
        if self.body >= states.count:
            raise ValueError(f"body of OfBody must be below the {states.count} bodies of the model, got {self.body}.")
        one = jax.tree.map(lambda x: x[self.body], body) if body.batch else body
        return self.measurement, one, states.of_body(self.body)

    @property
    def linear(self) -> int:
        return self.measurement.linear

    def eliminated(self, residuals: Array, loss: Loss | None) -> tuple[Array, Array]:
        return self.measurement.eliminated(residuals, loss)

    def differences(self, parameters: Any, body: Any, states: Any) -> Array:
        measurement, body, states = self.subject(body, states)
        return measurement.differences(parameters, body, states)


def of_which(measurement: Measurement) -> tuple[int | None, Measurement]:
    """The index of the body in an `OfBody`, and the inner measurement; None and the measurement for all others."""
    return (measurement.body, measurement.measurement) if isinstance(measurement, OfBody) else (None, measurement)
