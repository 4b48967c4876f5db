"""`RigidState`: momentum and attitude."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, is_unit, require, require_finite
from ..._math import components as cp
from .. import so3
from ..bodies import RigidBody
from ..kind import Leaves
from ..leaf import BodyLeaf, Described
from ..state import State
from .length import length_correction
from .momentum import BODY_MOMENTUM


class Rotation(BodyLeaf):
    """A momentum in the body frame, and the attitude as a unit quaternion."""

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
        """The momentum changed by increment[..., :3], and the attitude rotated by increment[..., 3:]."""
        momentum, attitude, *_ = arrays
        turned = so3.multiply(attitude, so3.exp(increment[..., 3:]))
        return momentum + increment[..., :3], turned

    @staticmethod
    def minus(arrays: tuple[Array, ...], others: tuple[Array, ...]) -> Array:
        turn = so3.log(so3.multiply(so3.conjugate(others[1]), arrays[1]))
        return jnp.concatenate([arrays[0] - others[0], turn], axis=-1)

    @staticmethod
    def sizes(*arrays: Array) -> tuple[Array, ...]:
        """The two sizes; the angle is twice the length of the difference of the two unit quaternions."""
        return jnp.sqrt(jnp.sum(arrays[0] ** 2)), 2 * jnp.sqrt(jnp.sum(arrays[1] ** 2))


class RigidState(State):
    """The momentum and attitude of a rigid body: seven numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        attitude: unit quaternion (w, x, y, z) that takes body components to space components, (..., 4).

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, or an attitude whose length is not 1 to 1e-3.

    Examples:
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))  # tilted by 0.3 rad
        >>> ml.observe.spatial_momentum(start).round(4)
        Array([  0.    , -14.776 ,  47.7668], dtype=float64)
        >>> many = ml.RigidState(jnp.ones((1000, 3)), jnp.tile(start.attitude, (1000, 1)))  # for an ensemble
        >>> many.momentum.shape, many.attitude.shape
        ((1000, 3), (1000, 4))
    """

    momentum: Float[Array, "*batch 3"]
    attitude: Float[Array, "*batch 4"]
    body: ClassVar[type] = RigidBody
    leaves: ClassVar[Leaves] = (Rotation,)

    def __init__(self, momentum: Any, attitude: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        self.attitude = as_floats("attitude", attitude, (4,))
        require_finite("momentum", self.momentum)
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
    """The change of the attitude by `Rotation.act`.

    The product is computed as a change of the attitude and rounded only once. If the product and then its length were
    rounded, the attitude would rotate slightly, in the same direction at every step. The correction of the length
    accounts for the lengths of both factors.
    """
    correction = length_correction(_square(attitude), no_step) + 0.5 * jax.lax.stop_gradient(cp.norm_defect(increment))
    w, x, y, z = increment
    factor = 1 + correction
    return cp.multiply(attitude, ((w - 1) * factor + correction, factor * x, factor * y, factor * z))


def shift_change(attitude: cp.Quaternion, change: cp.Quaternion, no_step: Array) -> cp.Quaternion:
    """The change of the attitude by `Rotation.shift`: the given change, and a correction of the length."""
    w, x, y, z = (p + c for p, c in zip(attitude, change, strict=True))
    k = length_correction(_square((w, x, y, z)), no_step)
    a, b, c, d = change
    return a + k * w, b + k * x, c + k * y, d + k * z


def _square(q: cp.Quaternion) -> Array:
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
