"""The exact end of a scene with a body in free fall, or with an axis in a uniform field."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..model.bodies import RigidBody
from ..model.free_body import FreeBody
from ..model.rotor import Rotor
from ..model.states import AxisState, FreeState, RigidState
from ..model.torques import HeavyTop, UniformGravity
from .closed_form import Ends, exact_ends
from .scenes import Scene


class End(NamedTuple):
    """The end of a motion.

    Attributes:
        state: momentum and pose of the rotation.
        position: of a translating body, (3,).
        source: the name of the closed form.
    """

    state: AxisState | RigidState
    position: np.ndarray | None
    source: str


def travelling_end(scene: Scene) -> End | None:
    """The end in closed form, or None if unknown."""
    body, torque, start = scene.body, scene.torque, scene.start
    if isinstance(body, Rotor) and isinstance(start, AxisState) and (torque is None or isinstance(torque, HeavyTop)):
        # Its axis and spatial momentum equal those of a body with three equal moments.
        ends = _ends(replace(scene, body=RigidBody(jnp.stack([body.moment] * 3))), start.with_attitude())
        if ends is None:
            return None
        state = AxisState.of(RigidState(jnp.asarray(ends.momenta[0]), jnp.asarray(ends.attitudes[0])))
        return End(state, None, ends.source)
    if not (isinstance(body, FreeBody) and isinstance(body.body, RigidBody) and isinstance(start, FreeState)):
        return None
    if torque is not None and not isinstance(torque, UniformGravity):
        return None
    ends = _ends(replace(scene, body=body.body, torque=None), start.turning)
    if ends is None:
        return None
    t, g = scene.duration, np.zeros(3) if torque is None else np.asarray(torque.acceleration, np.float64)
    x, p = (np.asarray(v, np.float64) for v in (start.position, start.linear))
    position = x + p / float(body.mass) * t + g * t**2 / 2
    state = RigidState(jnp.asarray(ends.momenta[0]), jnp.asarray(ends.attitudes[0]))
    return End(state, position, f"{ends.source}, and the parabola")


def _ends(scene: Scene, start: RigidState) -> Ends | None:
    return exact_ends(scene, [np.concatenate([np.asarray(start.momentum), np.asarray(start.attitude)])])
