"""`DirectionState`: momentum and one space direction."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, is_unit, require, require_finite
from ..._math import components as cp
from ..state import BodyState, Described
from .momentum import BODY_MOMENTUM
from .unit_vector import changed, of_unit_length, shifted, turn_between, turned


class DirectionState(BodyState[cp.Vector]):
    """The state of a rigid body in a field with one fixed direction d in space: six numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        direction: the unit vector d in body components, R^T d, (..., 3). For `HeavyTop` d is the upward vertical, for
            `DipoleInField` the direction of the field.

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, or a direction whose length is not 1 to 1e-3.

    Examples:
        >>> start = ml.DirectionState([0.0, 0.0, 50.0], [0.0, np.sin(0.3), np.cos(0.3)])  # upward vertical, body frame
        >>> ml.energy(body, torque, start).round(4)
        Array(1269.1067, dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    direction: Float[Array, "*batch 3"]

    def __init__(self, momentum: Any, direction: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        self.direction = as_floats("direction", direction, (3,))
        self.check_batch()
        require_finite("momentum", self.momentum)
        require("direction", self.direction, is_unit, "must be a unit vector", "divide it by its norm.")

    def parts(self) -> tuple[cp.Vector, cp.Vector]:
        return cp.vector(self.momentum), cp.vector(self.direction)

    @classmethod
    def join(cls, momentum: cp.Vector, pose: cp.Vector) -> "DirectionState":
        return cls(cp.pack(momentum), cp.pack(pose))

    @staticmethod
    def rotate(pose: cp.Vector, increment: cp.Quaternion) -> cp.Vector:
        return cp.rotate_back(increment, pose)

    @staticmethod
    def turn(pose: cp.Vector, increment: cp.Quaternion, no_step: Array) -> cp.Vector:
        return changed(pose, cp.rotation_change(cp.conjugate(increment), pose), no_step)

    @staticmethod
    def shift(pose: cp.Vector, change: cp.Vector, no_step: Array) -> cp.Vector:
        return shifted(pose, change, no_step)

    @staticmethod
    def rate(pose: cp.Vector, velocity: cp.Vector) -> cp.Vector:
        return cp.cross(pose, velocity)

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """The body components of a space vector, which must point along the direction d of the field."""
        return cp.scale(cp.norm(vector), cp.vector(self.direction))

    def vertical(self) -> cp.Vector:
        """The space z axis in body components, provided that the direction d is the space z axis."""
        return cp.vector(self.direction)

    def fixed_direction(self) -> cp.Vector:
        return cp.vector(self.direction)

    def normalised(self) -> "DirectionState":
        return eqx.tree_at(lambda s: s.direction, self, of_unit_length(self.direction))

    def plus(self, increment: Array) -> "DirectionState":
        """The state with momentum changed by increment[..., :3] and direction rotated by increment[..., 3:], (2,).

        The second part lies in the plane perpendicular to the direction; its two axes depend on the direction alone.
        """
        return DirectionState(self.momentum + increment[..., :3], turned(self.direction, increment[..., 3:]))

    def minus(self, other: Any) -> Array:
        """The change of the momentum, and the rotation (2,) of the direction, from another state to this one.

        Between opposite directions, the rotation along the first axis is returned.
        """
        turn = turn_between(other.direction, self.direction)
        return jnp.concatenate([self.momentum - other.momentum, turn], axis=-1)

    @classmethod
    def described(cls) -> Described:
        direction = {"long_name": "space z axis in body components", "units": "1", "frame": "body"}
        return {"momentum": (("axis",), BODY_MOMENTUM), "direction": (("axis",), direction)}
