"""`DirectionState`: momentum and one space direction."""

from typing import Any, ClassVar

from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, is_unit, require, require_finite
from ..._math import components as cp
from ..bodies import RigidBody
from ..kind import Leaves
from ..leaf import BodyLeaf, Described
from ..state import State
from .momentum import BODY_MOMENTUM
from .unit_vector import UnitVector, changed


class Direction(UnitVector, BodyLeaf):
    """A momentum in the body frame, and one space direction in the body frame."""

    about: ClassVar[tuple[Described, ...]] = (
        (("axis",), BODY_MOMENTUM),
        (("axis",), {"long_name": "space z axis in body components", "units": "1", "frame": "body"}),
    )

    @staticmethod
    def act(pose: cp.Vector, increment: cp.Quaternion, no_step: Array | None = None) -> cp.Vector:
        if no_step is None:
            return cp.rotate_back(increment, pose)
        return changed(pose, cp.rotation_change(cp.conjugate(increment), pose), no_step)

    @staticmethod
    def rate(pose: cp.Vector, velocity: cp.Vector) -> cp.Vector:
        return cp.cross(pose, velocity)

    @staticmethod
    def to_body(owner: Any, pose: cp.Vector, vector: cp.Vector) -> cp.Vector:
        """The body components of a space vector, which must point along the direction of the field."""
        return cp.scale(cp.norm(vector), pose)

    @classmethod
    def vertical(cls, owner: Any, pose: cp.Vector) -> cp.Vector:
        """The space z axis in body components, provided that the direction is the space z axis."""
        return pose


class DirectionState(State):
    """The state of a rigid body in a field with one fixed direction d in space: six numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        direction: the unit vector d in body components, R^T d, (..., 3). For `HeavyTop` d is the upward vertical, for
            `DipoleInField` the direction of the field.

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, or a direction whose length is not 1 to 1e-3.

    Examples:
        >>> start = ml.DirectionState([0.0, 0.0, 50.0], [0.0, np.sin(0.3), np.cos(0.3)])  # upward vertical, body frame
        >>> ml.observe.energy(body, torque, start).round(4)
        Array(1269.1067, dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    direction: Float[Array, "*batch 3"]
    body: ClassVar[type] = RigidBody
    leaves: ClassVar[Leaves] = (Direction,)

    def __init__(self, momentum: Any, direction: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        self.direction = as_floats("direction", direction, (3,))
        require_finite("momentum", self.momentum)
        require("direction", self.direction, is_unit, "must be a unit vector", "divide it by its norm.")
