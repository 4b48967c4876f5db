"""An orbit about a point mass, of every eccentricity: ellipse, parabola or hyperbola."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_floats, as_not_negative, as_positive, require
from ..._math import components as cp
from ..._math import universal
from ..._math.universal import Place
from ..._xla.fusion import split
from .base import Orbit, Units, check_units

_NEARLY_ROUND = 0.5  # below this eccentricity nothing uses the direction of the periapsis


class KeplerOrbit(Orbit):
    """An orbit about a focus at the origin, from a position and a velocity: ellipse, parabola or hyperbola.

    It uses Lagrange's f and g functions in universal variables, from the periapsis, with a fixed number of operations
    and no branches (R. H. Battin, An Introduction to the Mathematics and Methods of Astrodynamics (1999), section 4.5).
    The result is the exact orbit of inputs (position, velocity, mu, time) perturbed by a few eps; on an ellipse by some
    eps per revolution. The first three derivatives with respect to time, and those with respect to the inputs, are
    equally accurate, including on a circle and on a parabola.

    Attributes:
        position, velocity: at the epoch, (3,), length and length/time.
        mu: gravitational parameter, (), length^3/time^2.
        epoch: the time at which the orbit has this position and velocity, (), by default 0.

    Raises:
        ValueError: wrong shapes, numbers that are not finite, mu not positive, a radial velocity, or a speed too small
            in the units of mu. If such numbers are traced, the positions are NaN, so `path.ok` is False.

    Examples:
        >>> orbit = ml.orbits.KeplerOrbit(position=[7000.0, 0.0, 0.0], velocity=[0.0, 8.0, 0.0], mu=3.986e5)  # km, s
        >>> round(float(jnp.linalg.norm(orbit(600.0))), 3)  # km, ten minutes after the periapsis
        7173.18
    """

    position: Float[Array, "*batch 3"]
    velocity: Float[Array, "*batch 3"]
    mu: Float[Array, "*batch"]
    epoch: Float[Array, "*batch"]

    def __init__(self, position: Any, velocity: Any, mu: Any, epoch: Any = 0.0):
        self.position = as_finite("position", position, (3,))
        self.velocity = as_finite("velocity", velocity, (3,))
        self.mu, self.epoch = as_positive("mu", mu), as_finite("epoch", epoch).astype(self.position.dtype)
        if not cp.is_traced(self.position, self.velocity):
            areas = np.cross(np.asarray(self.position), np.asarray(self.velocity))
            if not np.all(np.any(areas != 0, axis=-1)):
                raise ValueError("velocity must not be along the position, or zero; give it a part across it.")
        # A flight past a small asteroid may have the speed of a table in other units.
        check_units(self, self.mu, np.inf, "start nearer to the periapsis")

    @classmethod
    def from_elements(
        cls,
        *,
        mu: Any,
        eccentricity: Any,
        inclination: Any,
        ascending_node: Any,
        argument_of_periapsis: Any,
        periapsis: Any = None,
        semi_major_axis: Any = None,
        semi_latus_rectum: Any = None,
        time_of_periapsis: Any = None,
        true_anomaly: Any = None,
        mean_anomaly: Any = None,
        epoch: Any = None,
    ) -> "KeplerOrbit":
        """The orbit with these elements; numbers, or arrays (...) of the elements of several orbits.

        Give one of `periapsis`, `semi_major_axis` and `semi_latus_rectum`, and one of `time_of_periapsis`,
        `true_anomaly` and `mean_anomaly`; otherwise, or for an element out of range, a ValueError is raised. The time
        of the periapsis and the mean anomaly give the most accurate result, as `position` and `velocity` are then taken
        at the periapsis.

        Args:
            mu: gravitational parameter, length^3/time^2.
            eccentricity: 0 for a circle, below 1 for an ellipse, 1 for a parabola, above for a hyperbola.
            inclination: angle between the orbit normal and z, radians, between 0 and pi.
            ascending_node: angle about z from x to the upward crossing of the xy plane, radians.
            argument_of_periapsis: angle from the node to the periapsis, in the direction of motion, radians.
            periapsis: distance of the periapsis, length.
            semi_major_axis: length, negative on a hyperbola; not for a parabola.
            semi_latus_rectum: length, h^2/mu.
            time_of_periapsis: a time at which the body is at the periapsis.
            true_anomaly: angle from the periapsis to the body at the epoch, radians.
            mean_anomaly: time since the periapsis at the epoch times sqrt(mu / |a|^3), radians; not for a parabola.
            epoch: the time of the anomaly, by default 0.

        Examples:
            >>> shape = {"eccentricity": 0.1, "inclination": 0.9, "ascending_node": 0.0, "argument_of_periapsis": 0.0}
            >>> orbit = ml.orbits.KeplerOrbit.from_elements(mu=4e5, periapsis=7e3, time_of_periapsis=60.0, **shape)
        """
        mu, e = as_floats("mu", mu), as_not_negative("eccentricity", eccentricity, cure="check its sign.")
        sizes = {"periapsis": periapsis, "semi_major_axis": semi_major_axis, "semi_latus_rectum": semi_latus_rectum}
        places = {"time_of_periapsis": time_of_periapsis, "true_anomaly": true_anomaly, "mean_anomaly": mean_anomaly}
        angles = inclination, ascending_node, argument_of_periapsis
        position, velocity, time = _of_elements(mu, e, sizes, places, angles, epoch)
        return cls(position, velocity, mu, time)

    def known(self) -> tuple[Array, Array]:
        return self.position, self.velocity

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        return cp.pack(_place(cp.vector(self.position), cp.vector(self.velocity), self.mu, t - self.epoch))


@jax.jit
def _place(position: cp.Vector, velocity: cp.Vector, mu: Array, t: Array) -> cp.Vector:
    """The position at a time since the epoch: a thousand operations, traced once for all calls, in three loops."""
    dtype = jnp.result_type(mu, *position, *velocity)
    position, velocity, mu = jax.tree.map(lambda x: x.astype(dtype), (position, velocity, mu))
    return split(split(_Orbit.of(position, velocity, mu)).at(t))


class _Orbit(NamedTuple):
    """An orbit in units of its periapsis q, from a position that is the periapsis up to rounding; all but the last
    three fields are differentiated, including through the units.
    """

    place: Place
    position: cp.Vector
    velocity: cp.Vector
    since: Array  # time of the epoch since that position
    per_r: Array
    rate: Array  # sqrt(mu / q^3), with a constant q
    q: Array  # constants: these only set the units and the first guess
    eccentricity: Array
    alpha: Array

    @classmethod
    def of(cls, position: cp.Vector, velocity: cp.Vector, mu: Array) -> "_Orbit":
        stop = jax.lax.stop_gradient
        units = Units.of(position, mu)
        position, velocity = cp.scale(units.per_length, position), cp.scale(units.per_speed, velocity)
        mu = units.of_mu * mu
        q, eccentricity = stop(_shape(position, velocity, mu))
        rate = jnp.sqrt(mu / q) / q
        r, v = cp.scale(1 / q, position), cp.scale(1 / (rate * q), velocity)
        square = cp.dot(r, r)
        per_distance = cp.inverse_root(square)
        distance, sigma = square * per_distance, cp.dot(r, v)
        alpha = 2 * per_distance - cp.dot(v, v)
        # The way back to the periapsis is differentiated as if s were a constant there; Lagrange's functions allow any
        # s.
        s = split(_from_periapsis(*stop((alpha, eccentricity, distance, sigma))))
        u = universal.powers(alpha, -s)
        epoch = Place(alpha, distance, sigma)
        per_near = cp.reciprocal(epoch.slopes(u)[0])
        f, g = 1 - u.u2 * per_distance, distance * u.u1 + sigma * u.u2
        f_rate, g_rate = -u.u1 * per_distance * per_near, 1 - u.u2 * per_near
        back = (
            cp.add(cp.scale(f, r), cp.scale(g, v)),
            cp.add(cp.scale(f_rate, r), cp.scale(g_rate, v)),
            -epoch.time(u),
        )
        # Far out these are small differences of large numbers. The conserved vectors of the periapsis have no such
        # differences, but they do not exist on a circle.
        exact = _periapsis(*stop((r, v, distance, sigma, alpha, eccentricity, s)))
        far = eccentricity > _NEARLY_ROUND

        def valued(formula: Array, value: Array) -> Array:
            return jnp.where(far, value + (formula - stop(formula)), formula)

        place, speed, since = jax.tree.map(valued, back, exact)
        square = cp.dot(place, place)
        per_r = cp.inverse_root(square)
        here = Place(alpha, square * per_r, cp.dot(place, speed))
        rate, q = rate * units.per_time, q * units.length
        return cls(here, place, speed, since, per_r, rate, q, eccentricity, stop(alpha))

    def at(self, t: Array) -> cp.Vector:
        stop = jax.lax.stop_gradient
        time = self._within_a_turn(self.rate * t + self.since)
        place, known, constant = self.place, stop(self.place), stop(time)
        s = universal.first_guess(self.alpha, self.eccentricity, constant)
        s = s + known.first_correction(universal.powers(self.alpha, s), constant)
        s = s + known.last_correction(universal.powers(self.alpha, s), constant)
        s = split(s)
        # The root; only the next step is differentiated (see `last_correction`).
        u = universal.powers(place.alpha, s)
        u = universal.moved(place.alpha, u, place.last_correction(u, time))
        f, g = self.q * (1 - u.u2 * self.per_r), self.q * (place.r * u.u1 + place.sigma * u.u2)
        return cp.add(cp.scale(f, self.position), cp.scale(g, self.velocity))

    def _within_a_turn(self, time: Array) -> Array:
        ellipse = self.alpha > _least(self.alpha)
        alpha = jnp.where(ellipse, self.place.alpha, jnp.ones_like(self.alpha))
        motion = alpha * jnp.sqrt(alpha)
        turns = jnp.where(ellipse, jnp.round(motion * time / (2 * jnp.pi)), jnp.zeros_like(time))
        return time - 2 * jnp.pi * jax.lax.stop_gradient(turns) / motion


def _least(x: Array) -> float:
    """Added to an alpha, in units of the periapsis, to keep roots of it positive."""
    return cp.epsilon(x) ** 2


def _shape(position: cp.Vector, velocity: cp.Vector, mu: Array) -> tuple[Array, Array]:
    """The distance of the periapsis, and the eccentricity, which is wrong by sqrt(eps) on a circle."""
    area = cp.cross(position, velocity)
    parameter = cp.dot(area, area) / mu
    alpha = 2 / jnp.sqrt(cp.dot(position, position)) - cp.dot(velocity, velocity) / mu
    eccentricity = jnp.sqrt(jnp.maximum(1 - alpha * parameter, jnp.zeros_like(alpha)))
    return parameter / (1 + eccentricity), eccentricity


def _from_periapsis(alpha: Array, eccentricity: Array, distance: Array, sigma: Array) -> Array:
    root = jnp.sqrt(jnp.abs(alpha) + _least(alpha))
    ellipse = jnp.arctan2(sigma * root, 1 - distance * alpha)
    hyperbola = jnp.arcsinh(sigma * root / jnp.maximum(eccentricity, jnp.asarray(_NEARLY_ROUND, root.dtype)))
    return jnp.where(alpha > 0, ellipse, hyperbola) / root


def _periapsis(
    r: cp.Vector, v: cp.Vector, distance: Array, sigma: Array, alpha: Array, eccentricity: Array, s: Array
) -> tuple[cp.Vector, cp.Vector, Array]:
    along = _direction(cp.subtract(cp.scale(cp.dot(v, v) - 1 / distance, r), cp.scale(sigma, v)))
    across = _direction(cp.cross(cp.cross(r, v), along))
    u = universal.powers(alpha, s)
    return along, cp.scale(jnp.sqrt(1 + eccentricity), across), u.u1 + u.u3


def _direction(v: cp.Vector) -> cp.Vector:
    square = cp.dot(v, v)
    return cp.scale(1 / jnp.sqrt(jnp.maximum(square, jnp.finfo(square.dtype).tiny)), v)


_ROUNDED = 1e-5  # radians by which an inclination may leave its range
_ANGLES = "inclination", "ascending_node", "argument_of_periapsis"


def _of_elements(mu: Array, e: Array, sizes: Any, places: Any, angles: Any, epoch: Any) -> tuple[Array, Array, Array]:
    size_name, size = _only_one(sizes, "the size of the orbit")
    place_name, place = _only_one(places, "where the body is")
    if size_name == "semi_major_axis":
        fits = _pair(lambda a, e: (a * (1 - e) > 0) & (e != 1), e)
        cure = "a parabola has none: give periapsis."
        require(size_name, size, fits, "must be positive on an ellipse, negative on a hyperbola", cure)
        q = size * (1 - e)
    else:
        require(size_name, size, lambda x: x > 0, "must be positive", "give a length.")
        q = size / (1 + e) if size_name == "semi_latus_rectum" else size
    if place_name == "time_of_periapsis" and epoch is not None:
        raise ValueError("epoch is the time of an anomaly and has no effect with time_of_periapsis; leave out epoch.")
    epoch = as_floats("epoch", 0.0 if epoch is None else epoch)
    cosine, sine = jnp.ones_like(q), jnp.zeros_like(q)
    if place_name == "true_anomaly":
        require(place_name, place, _within_a_turn, "must be between -2 pi and 2 pi", "give radians.")
        fits = _pair(lambda anomaly, e: 1 + e * np.cos(anomaly) > 0, e)
        require(place_name, place, fits, "must be where the orbit is", "a hyperbola has 1 + e cos(anomaly) > 0.")
        cosine, sine, time = jnp.cos(place), jnp.sin(place), epoch
    elif place_name == "mean_anomaly":
        fits = _pair(lambda _, e: e != 1, e)
        require(place_name, place, fits, "has no meaning on a parabola", "give time_of_periapsis.")
        axis = q / jnp.abs(1 - e)
        time = epoch - place * (axis * jnp.sqrt(axis / mu))
    else:
        time = place
    inclination, node, argument = map(as_finite, _ANGLES, angles)
    radians, half = "give radians, for example by np.deg2rad.", np.pi / 2
    require("inclination", inclination, lambda x: abs(x - half) <= half + _ROUNDED, "must be between 0 and pi", radians)
    for name, value in zip(_ANGLES[1:], (node, argument), strict=True):
        require(name, value, _within_a_turn, "must be between -2 pi and 2 pi", radians)
    q, e, cosine, sine, inclination, node, argument, mu = jnp.broadcast_arrays(
        *(jnp.asarray(x) for x in (q, e, cosine, sine, inclination, node, argument, mu))
    )
    (ci, si), (cn, sn), (ca, sa) = ((jnp.cos(x), jnp.sin(x)) for x in (inclination, node, argument))
    towards = (cn * ca - sn * sa * ci, sn * ca + cn * sa * ci, sa * si)  # the periapsis
    across = (-cn * sa - sn * ca * ci, -sn * sa + cn * ca * ci, ca * si)
    parameter = q * (1 + e)
    distance, speed = parameter / (1 + e * cosine), jnp.sqrt(mu / parameter)
    position = cp.add(cp.scale(distance * cosine, towards), cp.scale(distance * sine, across))
    velocity = cp.add(cp.scale(-speed * sine, towards), cp.scale(speed * (e + cosine), across))
    return cp.pack(position), cp.pack(velocity), time


def _within_a_turn(angle: np.ndarray) -> Any:
    return np.abs(angle) <= 2 * np.pi + _ROUNDED


def _pair(holds: Any, e: Array) -> Any:
    return lambda x: True if cp.is_traced(e) else holds(x, np.asarray(e))


def _only_one(values: dict[str, Any], what: str) -> tuple[str, Array]:
    given = [name for name, value in values.items() if value is not None]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        raise ValueError(f"exactly one of {', '.join(values)} must set {what}, got {got}; give one.")
    return given[0], as_finite(given[0], values[given[0]])
