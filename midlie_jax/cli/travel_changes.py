"""The conserved momenta of a run of a translating body, and the errors of momenta and position."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..model.states import TravellingState
from ..model.torques import Oblateness, PointMass, Sum, UniformGravity
from ..plot.conservation import Change

_CHANGED = "not conserved: forces change it"


def angular_change(torque: Any, states: TravellingState) -> Change:
    """The change of the conserved angular momentum, otherwise of the angular momentum about the centre of mass.

    Weight alone exerts no torque, so the momentum about the centre of mass is conserved. In the field of a planet, the
    conserved momentum is about the planet, or its component along the pole.
    """
    terms, name = _terms(torque), "spatial momentum"
    # Compiled, because the states of a failed run must not be checked.
    about_centre = np.asarray(jax.jit(lambda s: s.turning.spatial_momentum())(states), np.float64)
    if all(isinstance(term, UniformGravity) or not getattr(term, "gradient", True) for term in terms):
        return Change(_relative(about_centre), name, "|π - π₀| / |π₀|", "all of it, about the centre of mass")
    if not all(isinstance(term, PointMass | Oblateness) for term in terms):
        return Change(_relative(about_centre), name, "|π - π₀| / |π₀|", reason="not conserved: the torque changes it")
    x, p = (np.asarray(v, np.float64) for v in (states.position, states.linear))
    whole = np.cross(x, p) + about_centre
    poles = [np.asarray(term.pole, np.float64) for term in terms if isinstance(term, Oblateness)]
    if not poles:
        return Change(_relative(whole), name, "|L - L₀| / |L₀|", "all of it, about the origin, with the orbit's")
    along = (whole @ poles[0])[..., None]
    scale = np.linalg.norm(whole[..., :1, :], axis=-1)
    note = "component along the pole, about the origin, with the orbit's"
    return Change(_relative(along, scale), name, "|Lₙ - Lₙ₀| / |L₀|", note)


def linear_change(torque: Any, states: TravellingState) -> Change:
    """The change of the linear momentum, or of its part across a uniform gravity, which is conserved."""
    p, terms = np.asarray(states.linear, np.float64), _terms(torque)
    name, formula = "linear momentum", "|p - p₀| / |p₀|"
    if not terms:
        return Change(_relative(p), name, formula, "all of it")
    if not all(isinstance(term, UniformGravity) for term in terms):
        return Change(_relative(p), name, formula, reason=_CHANGED)
    size, g = np.linalg.norm(p[..., :1, :], axis=-1), _gravity(terms)
    down = g / (np.linalg.norm(g) or 1.0)
    across = p - (p @ down)[..., None] * down
    return Change(_relative(across, size), name, formula, "part across gravity")


def place_change(mass: Any, torque: Any, times: np.ndarray, states: TravellingState) -> Change | None:
    """The distance from the parabola divided by the path length along its axes; None if the path has no closed form."""
    terms = _terms(torque)
    if not all(isinstance(term, UniformGravity) for term in terms):
        return None
    x, p = (np.asarray(v, np.float64) for v in (states.position, states.linear))
    t, v = np.asarray(times, np.float64)[:, None], p[..., :1, :] / float(mass)
    way, fall = v * t, _gravity(terms) * t**2 / 2
    size = np.max(np.abs(way) + np.abs(fall), axis=(-2, -1))[..., None]
    error = np.linalg.norm(x - (x[..., :1, :] + way + fall), axis=-1)
    return Change(error / np.where(size > 0, size, 1), "place", "|x - x(t)| / way", "from the parabola")


def _terms(torque: Any) -> tuple[Any, ...]:
    if isinstance(torque, Sum):
        return tuple(inner for term in torque.terms for inner in _terms(term))
    return () if torque is None else (torque,)


def _gravity(terms: tuple[Any, ...]) -> np.ndarray:
    return sum((np.asarray(term.acceleration, np.float64) for term in terms), start=np.zeros(3))


def _relative(vectors: np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
    """|v(t) - v(0)| over a scale, by default |v(0)|."""
    first = vectors[..., :1, :]
    size = np.asarray(np.linalg.norm(first, axis=-1) if scale is None else scale)
    return np.linalg.norm(vectors - first, axis=-1) / np.where(size > 0, size, 1)


def in_words(vector: Any) -> str:
    return ", ".join(f"{x:.6g}" for x in np.asarray(jnp.ravel(vector), np.float64))
