"""Position and velocity from orbital elements, of every eccentricity."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import as_finite, as_floats, require
from ..._math import components as cp

_SIZES = ("periapsis", "semi_major_axis", "semi_latus_rectum")
_ROUNDED = 1e-5  # radians by which an inclination may leave its range
_PLACES = ("time_of_periapsis", "true_anomaly", "mean_anomaly")


def of_elements(
    mu: Array, eccentricity: Array, sizes: tuple[Any, ...], angles: tuple[Any, ...], places: tuple[Any, ...], epoch: Any
) -> tuple[Array, Array, Array]:
    """Position and velocity, and their time; the arguments are those of `KeplerOrbit.from_elements`."""
    e = eccentricity
    require(
        "eccentricity", e, lambda x: np.isfinite(x) & (x >= 0), "must be finite and not negative", "check its sign."
    )
    size_name, size = _only_one(_SIZES, sizes, "the size of the orbit")
    place_name, place = _only_one(_PLACES, places, "where the body is")
    if size_name == "semi_major_axis":
        fits = _pair(lambda a, e: (a * (1 - e) > 0) & (e != 1), e)
        cure = "give periapsis, which every orbit has."
        require(
            size_name, size, fits, "must be positive on an ellipse, negative on a hyperbola; a parabola has none", cure
        )
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
    inclination, node, argument = (
        as_finite(name, value)
        for name, value in zip(("inclination", "ascending_node", "argument_of_periapsis"), angles, strict=True)
    )
    radians = "give radians, for example by np.deg2rad."
    require("inclination", inclination, _is_inclination, "must be between 0 and pi", radians)
    for name, value in (("ascending_node", node), ("argument_of_periapsis", argument)):
        require(name, value, _within_a_turn, "must be between -2 pi and 2 pi", radians)
    q, e, cosine, sine, inclination, node, argument, mu = jnp.broadcast_arrays(
        *(jnp.asarray(x) for x in (q, e, cosine, sine, inclination, node, argument, mu))
    )
    towards, across = _axes(inclination, node, argument)
    parameter = q * (1 + e)
    distance, speed = parameter / (1 + e * cosine), jnp.sqrt(mu / parameter)
    position = cp.add(cp.scale(distance * cosine, towards), cp.scale(distance * sine, across))
    velocity = cp.add(cp.scale(-speed * sine, towards), cp.scale(speed * (e + cosine), across))
    return cp.pack(position), cp.pack(velocity), time


def _is_inclination(angle: np.ndarray) -> Any:
    return (angle >= -_ROUNDED) & (angle <= np.pi + _ROUNDED)


def _within_a_turn(angle: np.ndarray) -> Any:
    return np.abs(angle) <= 2 * np.pi + _ROUNDED


def _axes(inclination: Array, node: Array, argument: Array) -> tuple[cp.Vector, cp.Vector]:
    """The unit vectors towards the periapsis, and across it in the direction of motion there."""
    (ci, si), (cn, sn), (ca, sa) = ((jnp.cos(x), jnp.sin(x)) for x in (inclination, node, argument))
    towards = (cn * ca - sn * sa * ci, sn * ca + cn * sa * ci, sa * si)
    return towards, (-cn * sa - sn * ca * ci, -sn * sa + cn * ca * ci, ca * si)


def _pair(holds: Any, e: Array) -> Any:
    """A condition on an element and the eccentricity; not checked if the eccentricity is traced."""
    return lambda x: True if cp.is_traced(e) else holds(x, np.asarray(e))


def _only_one(names: tuple[str, ...], values: tuple[Any, ...], what: str) -> tuple[str, Array]:
    given = [(name, value) for name, value in zip(names, values, strict=True) if value is not None]
    if len(given) != 1:
        got = " and ".join(name for name, _ in given) or "none"
        raise ValueError(f"exactly one of {', '.join(names)} must set {what}, got {got}; give one.")
    return given[0][0], as_finite(*given[0])
