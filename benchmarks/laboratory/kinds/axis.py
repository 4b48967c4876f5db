"""The axis of a top with two equal moments, in six numbers: the momentum pi and the axis e, both in space.

pi' = T, e' = pi x e / I1. Whoever asks for the axis alone would write these equations, whatever the program.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from midlie_jax.cli.scenes import Scene
from midlie_jax.model import torques

from . import rigid
from .kind import Kind, no_closed_form
from .vectors import cross, matrices


def rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """The equations of motion; a ValueError for another torque than a heavy top's."""
    if not (isinstance(scene.torque, torques.HeavyTop) and scene.torque.axis == (0.0, 0.0, 1.0)):
        raise ValueError(f"scene {scene.name!r} is an axis, for which the rivals have the torque HeavyTop alone.")
    body: Any = scene.body
    moment, weight = float(body.moment), float(scene.torque.mgl)

    def field(state: Any, place: Any = None) -> tuple[Any, ...]:
        del place
        momentum, axis = state[:3], state[3:]
        velocity = tuple((1 / moment) * p for p in momentum)
        return (-weight * axis[1], weight * axis[0], 0.0 * momentum[2], *cross(velocity, axis))

    return field


def errors(ends: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """|e - e*|, of axes of any length."""
    return np.linalg.norm(_unit(ends[:, 3:]) - _unit(exact[:, 3:]), axis=1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def errors_of_attitudes(ends: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The same of momenta and attitudes (n, 7), whose third columns are the axes."""
    return np.linalg.norm(matrices(ends[:, 3:])[:, :, 2] - _unit(exact[:, 3:]), axis=1)


_MEASURED = "the axis, |e - e*|"
AXIS = Kind(rates, errors, _MEASURED, no_closed_form)
# The same top as a body with an attitude, whose spin angle is integrated, too, but not judged.
SPINNING = Kind(rigid.rates, errors_of_attitudes, _MEASURED, no_closed_form)
