"""The exact end of a scene with a known closed form; and the required renumbering of axes.

The exact flight of a symmetric body and the closed form of Lagrange's top need the axis of symmetry as third axis. The
formulas are in `oracles`.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..model import so3, torques
from ..model.bodies import RigidBody
from .scenes import Scene


class Numbering(NamedTuple):
    """A cyclic renumbering of the axes of a body.

    Attributes:
        order: the old number of each new axis.
        turn: unit quaternion from the new body frame to the old.
    """

    order: tuple[int, int, int]
    turn: tuple[float, float, float, float]

    @classmethod
    def of(cls, scene: Scene) -> "Numbering":
        """The numbering that makes the axis of symmetry the third; the identity if there is no such axis."""
        axis = symmetry_axis(scene)
        k = 2 if axis is None else axis
        turn = ((0.5, 0.5, 0.5, 0.5), (0.5, -0.5, -0.5, -0.5), (1.0, 0.0, 0.0, 0.0))[k]
        return cls(((k + 1) % 3, (k + 2) % 3, k), turn)

    def apply(self, scene: Scene) -> Scene | None:
        """The same scene with the new axes; None if torques of this class cannot be renumbered."""
        if self.order == (0, 1, 2):
            return scene
        pick, torque = jnp.array(self.order), scene.torque
        moments = scene.body.moments[pick]
        if isinstance(torque, torques.HeavyTop):
            a, b, c = (torque.axis[i] for i in self.order)
            torque = torques.HeavyTop(torque.weight, (a, b, c))
        elif isinstance(torque, torques.GravityGradient):
            torque = torques.GravityGradient(moments, torque.orbit, torque.mu)
        elif torque is not None:
            return None
        momentum, attitude = scene.start.momentum, scene.start.attitude
        start = type(scene.start)(momentum[pick], so3.multiply(attitude, jnp.array(self.turn, attitude.dtype)))
        return replace(scene, body=RigidBody(moments), torque=torque, start=start, axes=None)

    def undo(self, momentum: np.ndarray, attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Momentum (3,) and attitude (4,) for the old axes, from those for the new axes."""
        if self.order == (0, 1, 2):
            return momentum, attitude
        back = so3.multiply(jnp.asarray(attitude), so3.conjugate(jnp.array(self.turn, attitude.dtype)))
        return momentum[np.argsort(self.order)], np.asarray(back)


def symmetry_axis(scene: Scene) -> int | None:
    """The index of the axis of symmetry, about which the other two moments are equal; None if there is none.

    If there are several, it is the axis of the torque, otherwise the last.
    """
    moments, torque = np.asarray(scene.body.moments), scene.torque
    torque_axis = torque.axis if isinstance(torque, torques.HeavyTop) else (0.0, 0.0, 0.0)
    axes = [k for k in range(3) if moments[(k + 1) % 3] == moments[(k + 2) % 3]]
    return max(axes, key=lambda k: (abs(torque_axis[k]), k), default=None)


def axis_third(scene: Scene) -> Scene:
    """The scene with the axis of symmetry as third axis; unchanged if it has none or if `apply` gives None."""
    return Numbering.of(scene).apply(scene) or scene


class Ends(NamedTuple):
    """Momenta (n, 3), body frame, and attitudes (n, 4) at the end of a scene, and the name of the closed form."""

    momenta: np.ndarray
    attitudes: np.ndarray
    source: str


def exact_ends(scene: Scene, starts: Iterable[np.ndarray]) -> Ends | None:
    """The ends in closed form, for a body without torque or a top symmetric about its third axis; otherwise None.

    Each start is a momentum and an attitude, concatenated to (7,).
    """
    from . import oracles

    moments, times, top = np.asarray(scene.body.moments), [scene.duration], scene.torque
    if top is None:
        source, motions = (
            "closed form of the free body",
            [oracles.free_body(moments, s[:3], s[3:], times) for s in starts],
        )
    elif isinstance(top, torques.HeavyTop) and top.axis[:2] == (0, 0) and moments[0] == moments[1]:
        source, weight = "closed form of Lagrange's top", float(top.weight) * top.axis[2]
        motions = [oracles.lagrange_top(moments, weight, s[:3], s[3:], times) for s in starts]
    else:
        return None
    momenta, attitudes = zip(*motions, strict=True)
    return Ends(np.concatenate(momenta), np.concatenate(attitudes), source)
