"""`CompensatedState`: a state of a rigid body that also stores the rounding errors of its sums.

Every step adds small changes to momentum and attitude. Each sum is rounded, and these errors add up. Here each
component has a low part, the error of its last sum, which is added to the next change (O. Moller, BIT 5 (1965) 37).
Only the rounding errors of the changes themselves remain, and they decrease with the step.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, require_finite
from ..._math import components as cp
from ..kind import Kind, Leaves
from ..leaf import Described
from .momentum import BODY_MOMENTUM
from .rigid import RigidState, Rotation, shift_change, turn_change


class CompensatedPose(NamedTuple):
    """The pose of a `CompensatedState`: the attitude, and the low parts of attitude and momentum."""

    attitude: cp.Quaternion
    low_attitude: cp.Quaternion
    low_momentum: cp.Vector


_LOST = "rounding error of the {}, to be added to it"


class Compensated(Rotation):
    """A rotation that stores the rounding errors of its sums."""

    arrays: ClassVar[int] = 4
    compensated: ClassVar[bool] = True
    about: ClassVar[tuple[Described, ...]] = (
        *Rotation.about,
        (("axis",), BODY_MOMENTUM | {"long_name": _LOST.format("momentum")}),
        (("quaternion",), {"long_name": _LOST.format("attitude"), "units": "1", "frame": "body to space"}),
    )

    @classmethod
    def pose(cls, *arrays: Array) -> Any:
        attitude, low_momentum, low_attitude = arrays
        return CompensatedPose(cp.quaternion(attitude), cp.quaternion(low_attitude), cp.vector(low_momentum))

    @staticmethod
    def packed(momentum: cp.Vector, pose: Any) -> tuple[Array, ...]:
        attitude, low_attitude, low_momentum = map(cp.pack, pose)
        return cp.pack(momentum), attitude, low_momentum, low_attitude

    @staticmethod
    def push(momentum: cp.Vector, pose: Any, change: cp.Vector) -> tuple[cp.Vector, Any]:
        momentum, low = cp.compensated(momentum, pose.low_momentum, change)
        return momentum, pose._replace(low_momentum=low)

    @classmethod
    def bathed(cls, exposure: Any, root: Any, momentum: cp.Vector, pose: Any, noise: cp.Vector) -> cp.Vector:
        return super().bathed(exposure, root, momentum, pose.attitude, noise)

    @staticmethod
    def act(pose: Any, increment: cp.Quaternion, no_step: Array | None = None) -> Any:
        if no_step is not None:
            return _changed(pose, turn_change(pose.attitude, increment, no_step))
        low_momentum = cp.rotate_back(increment, pose.low_momentum)
        attitude, low_attitude = (cp.multiply(q, increment) for q in pose[:2])
        return CompensatedPose(attitude, low_attitude, low_momentum)

    @staticmethod
    def shift(pose: Any, change: Any, no_step: Array) -> Any:
        return _changed(pose, shift_change(pose.attitude, change.attitude, no_step))

    @staticmethod
    def rate(pose: Any, velocity: cp.Vector) -> Any:
        zero = jnp.zeros_like(velocity[0])
        return CompensatedPose(Rotation.rate(pose.attitude, velocity), (zero, zero, zero, zero), (zero, zero, zero))


class SeenAsRigid(Kind):
    """A kind whose torque receives a `RigidState`."""

    def evaluate(self, function: Any, t: Array, momentum: cp.Vector, pose: Any) -> tuple[Any, Any]:
        return Kind(RigidState, RigidState.leaves).evaluate(function, t, momentum, pose.attitude)


class CompensatedState(RigidState):
    """A `RigidState` with compensated summation: float32 with less rounding, for small steps.

    Torques read only momentum and attitude. A run resumed from a saved state equals the uninterrupted run, because the
    low parts are saved; `plus` sets them to zero.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        attitude: unit quaternion (w, x, y, z) that takes body components to space components, (..., 4).
        low_momentum: to be added to the momentum, at most half a unit in its last place, (..., 3); zero by default.
        low_attitude: to be added to the attitude, likewise, (..., 4).

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, NaN or infinity, or an attitude whose length is not
            1 to 1e-3.

    Examples:
        >>> momentum, attitude = jnp.array([0.0, 0.0, 50.0], "float32"), jnp.array([1.0, 0.0, 0.0, 0.0], "float32")
        >>> start = ml.CompensatedState(momentum, attitude)
        >>> start.low_momentum, start.low_attitude  # no rounding errors yet
        (Array([0., 0., 0.], dtype=float32), Array([0., 0., 0., 0.], dtype=float32))
    """

    low_momentum: Float[Array, "*batch 3"]
    low_attitude: Float[Array, "*batch 4"]
    leaves: ClassVar[Leaves] = (Compensated,)

    def __init__(self, momentum: Any, attitude: Any, low_momentum: Any = None, low_attitude: Any = None):
        momentum, attitude = as_floats("momentum", momentum, (3,)), as_floats("attitude", attitude, (4,))
        self.low_momentum = _low_part("low_momentum", low_momentum, momentum)
        self.low_attitude = _low_part("low_attitude", low_attitude, attitude)
        super().__init__(momentum, attitude)

    @property
    def _pose(self) -> cp.Quaternion:
        return cp.quaternion(self.attitude)

    @property
    def kind(self) -> Kind:
        return SeenAsRigid(type(self), self.leaves)


def _changed(pose: CompensatedPose, change: cp.Quaternion) -> CompensatedPose:
    attitude, low = cp.compensated(pose.attitude, pose.low_attitude, change)
    return pose._replace(attitude=attitude, low_attitude=low)


def _low_part(name: str, value: Any, of: Array) -> Array:
    if value is None:
        return jnp.zeros_like(of)
    low = as_floats(name, value, of.shape[-1:])
    require_finite(name, low)
    return low
