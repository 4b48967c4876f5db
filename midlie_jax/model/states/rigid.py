"""States of a rigid body: its momentum alone, with the attitude, or also with the rounding errors of their sums."""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_floats, is_unit, require
from ..._math import components as cp
from .. import so3
from ..bodies import RigidBody
from ..kind import Kind, Leaves
from ..leaf import BodyLeaf, Described, NoPose, length_correction
from ..state import State

BODY_MOMENTUM = {
    "long_name": "angular momentum in the body frame, about the fixed point or the centre of mass",
    "units": "mass length2 time-1",
    "frame": "body",
}


class BodyMomentum(NoPose, BodyLeaf):
    about: ClassVar[tuple[Described, ...]] = ((("axis",), BODY_MOMENTUM),)


class MomentumState(State):
    """The state of a rigid body without its attitude: the body-frame angular momentum Pi, (..., 3).

    Examples:
        >>> body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.MomentumState([0.01, 2.0, 0.01])
        >>> path = ml.free_motion(body, start, [0.0, 5.0, 10.0])
        >>> jnp.linalg.norm(path.states.momentum, axis=-1).round(4)
        Array([2., 2., 2.], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    body: ClassVar[type] = RigidBody
    leaves: ClassVar[Leaves] = (BodyMomentum,)

    def __init__(self, momentum: Any):
        self.momentum = as_finite("momentum", momentum, (3,))


class Rotation(BodyLeaf):
    about: ClassVar[tuple[Described, ...]] = (
        (("axis",), BODY_MOMENTUM),
        (
            ("quaternion",),
            {
                "long_name": "unit quaternion, scalar first, that takes body components to space components",
                "units": "1",
                "frame": "body to space",
            },
        ),
    )

    @staticmethod
    def act(pose: cp.Quaternion, increment: cp.Quaternion, no_step: Array | None = None) -> cp.Quaternion:
        return cp.multiply(pose, increment) if no_step is None else _turn(pose, increment, no_step)

    @staticmethod
    def shift(pose: cp.Quaternion, change: cp.Quaternion, no_step: Array) -> cp.Quaternion:
        return cp.tree_add(pose, shift_change(pose, change, no_step))

    @staticmethod
    def rate(pose: cp.Quaternion, velocity: cp.Vector) -> cp.Quaternion:
        w, x, y, z = pose
        a, b, c = cp.scale(0.5, velocity)
        return (-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a)

    @classmethod
    def bathed_in_space(
        cls, exposure: Any, root: Any, vector: cp.Vector, pose: cp.Quaternion, noise: cp.Vector
    ) -> cp.Vector:
        return cp.rotate(pose, exposure.change(root, cp.rotate_back(pose, vector), noise))

    @staticmethod
    def to_body(owner: Any, pose: cp.Quaternion, vector: cp.Vector) -> cp.Vector:
        return cp.rotate_back(pose, vector)

    @classmethod
    def vertical(cls, owner: Any, pose: cp.Quaternion) -> cp.Vector:
        w, x, y, z = pose
        return 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z

    @staticmethod
    def to_space(owner: Any, pose: cp.Quaternion, vector: cp.Vector) -> cp.Vector:
        return cp.add(vector, cp.unit_rotation_change(pose, vector))

    @staticmethod
    def spatial_momentum(owner: Any, *arrays: Array) -> Array:
        momentum, attitude, *_ = arrays
        return so3.rotate(attitude, momentum)

    @staticmethod
    def normalised(*arrays: Array) -> tuple[Array, ...]:
        momentum, attitude, *others = arrays
        return momentum, attitude / jnp.sqrt(jnp.sum(attitude**2, axis=-1, keepdims=True)), *others

    @staticmethod
    def plus(increment: Array, *arrays: Array) -> tuple[Array, ...]:
        momentum, attitude, *_ = arrays
        turned = so3.multiply(attitude, so3.exp(increment[..., 3:]))
        return momentum + increment[..., :3], turned

    @staticmethod
    def minus(arrays: tuple[Array, ...], others: tuple[Array, ...]) -> Array:
        turn = so3.log(so3.multiply(so3.conjugate(others[1]), arrays[1]))
        return jnp.concatenate([arrays[0] - others[0], turn], axis=-1)

    @staticmethod
    def sizes(*arrays: Array) -> tuple[Array, ...]:
        """The angle is twice the length of the difference of the two unit quaternions."""
        return jnp.sqrt(jnp.sum(arrays[0] ** 2)), 2 * jnp.sqrt(jnp.sum(arrays[1] ** 2))


class RigidState(State):
    """The momentum and attitude of a rigid body: seven numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        attitude: unit quaternion (w, x, y, z) that takes body components to space components, (..., 4).

    Examples:
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))  # tilted by 0.3 rad
        >>> many = ml.RigidState(jnp.ones((1000, 3)), jnp.tile(start.attitude, (1000, 1)))  # for an ensemble
        >>> many.momentum.shape, many.attitude.shape
        ((1000, 3), (1000, 4))
    """

    momentum: Float[Array, "*batch 3"]
    attitude: Float[Array, "*batch 4"]
    body: ClassVar[type] = RigidBody
    leaves: ClassVar[Leaves] = (Rotation,)

    def __init__(self, momentum: Any, attitude: Any):
        self.momentum = as_finite("momentum", momentum, (3,))
        self.attitude = as_floats("attitude", attitude, (4,))
        require("attitude", self.attitude, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its norm.")


@jax.custom_jvp
def _turn(attitude: cp.Quaternion, increment: cp.Quaternion, no_step: Array) -> cp.Quaternion:
    """`Rotation.act`, with a derivative that needs no product of attitude and increment."""
    return cp.tree_add(attitude, turn_change(attitude, increment, no_step))


def _turn_tangent(primals: Any, tangents: Any) -> tuple[cp.Quaternion, cp.Quaternion]:
    """The tangent of the rotated attitude (1 + k) q Q, whose correction k of the length changes by -q . dq."""
    (q, increment, no_step), (dq, d_increment, _) = primals, tangents
    k = length_correction(_square(q), no_step)
    along = jnp.where(no_step, jnp.zeros_like(k), q[0] * dq[0] + cp.dot(q[1:], dq[1:]))
    factor = 1 + k
    w, x, y, z = (factor * dot - along * part for part, dot in zip(q, dq, strict=True))
    turned, own = cp.multiply((w, x, y, z), increment), cp.multiply(q, d_increment)
    w, x, y, z = (a + factor * b for a, b in zip(turned, own, strict=True))
    return _turn(q, increment, no_step), (w, x, y, z)


_turn.defjvp(_turn_tangent)


def turn_change(attitude: cp.Quaternion, increment: cp.Quaternion, no_step: Array) -> cp.Quaternion:
    """The change of the attitude by `Rotation.act`, rounded only once.

    Rounding the product and then its length would rotate the attitude in the same direction at every step. The
    correction of the length accounts for the lengths of both factors.
    """
    correction = length_correction(_square(attitude), no_step) + 0.5 * jax.lax.stop_gradient(cp.norm_defect(increment))
    w, x, y, z = increment
    factor = 1 + correction
    return cp.multiply(attitude, ((w - 1) * factor + correction, factor * x, factor * y, factor * z))


def shift_change(attitude: cp.Quaternion, change: cp.Quaternion, no_step: Array) -> cp.Quaternion:
    w, x, y, z = (p + c for p, c in zip(attitude, change, strict=True))
    k = length_correction(_square((w, x, y, z)), no_step)
    a, b, c, d = change
    return a + k * w, b + k * x, c + k * y, d + k * z


def _square(q: cp.Quaternion) -> Array:
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]


class CompensatedPose(NamedTuple):
    attitude: cp.Quaternion
    low_attitude: cp.Quaternion
    low_momentum: cp.Vector


_LOST = "rounding error of the {}, to be added to it"


class Compensated(Rotation):
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
    def evaluate(self, function: Any, t: Array, momentum: cp.Vector, pose: Any) -> tuple[Any, Any]:
        return Kind(RigidState, RigidState.leaves).evaluate(function, t, momentum, pose.attitude)


class CompensatedState(RigidState):
    """A `RigidState` with compensated summation: float32 with less rounding, for small steps.

    Torques read only momentum and attitude. A run resumed from a saved state equals the uninterrupted run, because the
    low parts are saved; `plus` sets them to zero.

    Attributes:
        momentum, attitude: as for `RigidState`.
        low_momentum: to be added to the momentum, at most half a unit in its last place, (..., 3); zero by default.
        low_attitude: to be added to the attitude, likewise, (..., 4).

    Examples:
        >>> momentum, attitude = jnp.array([0.0, 0.0, 50.0], "float32"), jnp.array([1.0, 0.0, 0.0, 0.0], "float32")
        >>> ml.CompensatedState(momentum, attitude).low_momentum  # no rounding errors yet
        Array([0., 0., 0.], dtype=float32)
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
    return jnp.zeros_like(of) if value is None else as_finite(name, value, of.shape[-1:])
