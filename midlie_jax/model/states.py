"""The states: momentum and nothing, one direction, the attitude, or the positions of particles.

What every state offers to steps and torques is in `state.py`.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._kernel import components as cp
from .._kernel.checks import as_floats, is_unit, require, require_finite
from .bodies import Particles
from .state import AnyState, BodyState, State, Value


class MomentumState(BodyState[tuple[()]]):
    """The state of a rigid body without its attitude: three numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
    """

    momentum: Float[Array, "*batch 3"]
    has_pose: ClassVar[bool] = False

    def __init__(self, momentum: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        require_finite("momentum", self.momentum)

    def parts(self) -> tuple[cp.Vector, tuple[()]]:
        return cp.vector(self.momentum), ()

    @classmethod
    def join(cls, momentum: cp.Vector, pose: tuple[()]) -> "MomentumState":
        del pose
        return cls(cp.pack(momentum))

    @classmethod
    def of(cls, momentum: Array, pose: Any) -> "MomentumState":
        del pose
        return cls(momentum)

    @staticmethod
    def rotate(pose: tuple[()], increment: cp.Quaternion) -> tuple[()]:
        del increment
        return pose

    @staticmethod
    def turn(pose: tuple[()], increment: Any, no_step: Array) -> tuple[()]:
        del increment, no_step
        return pose

    @staticmethod
    def shift(pose: tuple[()], change: tuple[()], no_step: Array) -> tuple[()]:
        del change, no_step
        return pose

    @staticmethod
    def rate(pose: tuple[()], velocity: cp.Vector) -> tuple[()]:
        del velocity
        return pose


class DirectionState(BodyState[cp.Vector]):
    """The state of a rigid body in a field with one fixed direction d in space: six numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        direction: the unit vector d in body components, R^T d, (..., 3). For `HeavyTop` d is the upward vertical, for
            `DipoleInField` the direction of the field.

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, or a direction whose length is not 1 to 1e-3.
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

    @classmethod
    def of(cls, momentum: Array, pose: Array) -> "DirectionState":
        return cls(momentum, pose)

    @staticmethod
    def rotate(pose: cp.Vector, increment: cp.Quaternion) -> cp.Vector:
        return cp.rotate_back(increment, pose)

    @staticmethod
    def turn(pose: cp.Vector, increment: cp.Quaternion, no_step: Array) -> cp.Vector:
        correction = _length_correction(cp.dot(pose, pose), no_step)
        change = cp.rotation_change(cp.conjugate(increment), pose)
        # The length is corrected along the new pose; along another direction, errors of the length would grow.
        return cp.add(pose, cp.add(change, cp.scale(correction, cp.add(pose, change))))

    @staticmethod
    def shift(pose: cp.Vector, change: cp.Vector, no_step: Array) -> cp.Vector:
        new_pose = cp.add(pose, change)
        correction = _length_correction(cp.dot(new_pose, new_pose), no_step)
        return cp.add(pose, cp.add(change, cp.scale(correction, new_pose)))

    @staticmethod
    def rate(pose: cp.Vector, velocity: cp.Vector) -> cp.Vector:
        return cp.cross(pose, velocity)

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """The body components of a space vector, which must point in the direction d of the field."""
        return cp.scale(cp.norm(vector), cp.vector(self.direction))

    def vertical(self) -> cp.Vector:
        """The space z axis in body components, provided that the direction d is the space z axis."""
        return cp.vector(self.direction)


class RigidState(BodyState[cp.Quaternion]):
    """The momentum and attitude of a rigid body: seven numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        attitude: unit quaternion (w, x, y, z) that takes body components to space components, (..., 4).

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, or an attitude whose length is not 1 to 1e-3.
    """

    momentum: Float[Array, "*batch 3"]
    attitude: Float[Array, "*batch 4"]

    def __init__(self, momentum: Any, attitude: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        self.attitude = as_floats("attitude", attitude, (4,))
        self.check_batch()
        require_finite("momentum", self.momentum)
        require("attitude", self.attitude, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its norm.")

    def parts(self) -> tuple[cp.Vector, cp.Quaternion]:
        return cp.vector(self.momentum), cp.quaternion(self.attitude)

    @classmethod
    def join(cls, momentum: cp.Vector, pose: cp.Quaternion) -> "RigidState":
        return cls(cp.pack(momentum), cp.pack(pose))

    @classmethod
    def of(cls, momentum: Array, pose: Array) -> "RigidState":
        return cls(momentum, pose)

    @staticmethod
    def rotate(pose: cp.Quaternion, increment: cp.Quaternion) -> cp.Quaternion:
        return cp.multiply(pose, increment)

    @staticmethod
    def turn(pose: cp.Quaternion, increment: cp.Quaternion, no_step: Array) -> cp.Quaternion:
        return _turn(pose, increment, no_step)

    @staticmethod
    def shift(pose: cp.Quaternion, change: cp.Quaternion, no_step: Array) -> cp.Quaternion:
        return cp.tree_add(pose, shift_change(pose, change, no_step))

    @staticmethod
    def rate(pose: cp.Quaternion, velocity: cp.Vector) -> cp.Quaternion:
        w, x, y, z = pose
        a, b, c = cp.scale(0.5, velocity)
        return (-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a)

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """The body components of a vector in the space frame, R^T vector."""
        return cp.rotate_back(cp.quaternion(self.attitude), vector)

    def vertical(self) -> cp.Vector:
        """The space z axis in body components: the last row of R."""
        w, x, y, z = cp.quaternion(self.attitude)
        return 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z


class ParticleState(State[Array, Array]):
    """Positions and momenta of particles.

    Attributes:
        momentum: p, of any shape, such as (n,).
        position: u, of the same shape.

    Raises:
        ValueError: different shapes, wrong dtypes, or NaN or infinity.
    """

    momentum: Float[Array, "..."]
    position: Float[Array, "..."]
    body: ClassVar[type] = Particles
    own_axes: ClassVar[int] = 0  # the arrays can have any shape, so no axes are known to be a batch

    def __init__(self, momentum: Any, position: Any):
        self.momentum = as_floats("momentum", momentum)
        self.position = as_floats("position", position)
        require_finite("momentum", self.momentum)
        require_finite("position", self.position)
        if self.momentum.shape != self.position.shape:
            raise ValueError(f"momentum {self.momentum.shape} and position {self.position.shape} must have one shape.")

    def parts(self) -> tuple[Array, Array]:
        return self.momentum, self.position

    @classmethod
    def join(cls, momentum: Array, pose: Array) -> "ParticleState":
        return cls(momentum, pose)

    @classmethod
    def of(cls, momentum: Array, pose: Array) -> "ParticleState":
        return cls(momentum, pose)

    @staticmethod
    def rotate(pose: Array, increment: Array) -> Array:
        return pose + increment

    @staticmethod
    def turn(pose: Array, increment: Array, no_step: Array) -> Array:
        del no_step
        return pose + increment

    @staticmethod
    def shift(pose: Array, change: Array, no_step: Array) -> Array:
        del no_step
        return pose + change

    @staticmethod
    def rate(pose: Array, velocity: Array) -> Array:
        del pose
        return velocity

    @staticmethod
    def momentum_rate(momentum: Array, velocity: Array, force: Array) -> Array:
        del momentum, velocity
        return force

    @classmethod
    def evaluate(cls, function: Callable[[Any, Any], Any], t: Array, momentum: Array, pose: Array) -> Value:
        value = function(t, cls.join(momentum, pose))
        return [value], jax.ShapeDtypeStruct(jnp.shape(value), jnp.result_type(value))

    @staticmethod
    def from_entries(entries: list[Any]) -> Any:
        return entries[0]

    @staticmethod
    def pack(vector: Array) -> Array:
        return vector

    @staticmethod
    def pack_pose(pose: Array) -> Array:
        return pose

    @staticmethod
    def unpack(array: Array) -> Array:
        return array


def with_attitude(state: AnyState) -> RigidState:
    """The state itself, if it is a `RigidState`; a ValueError for any other state."""
    if not isinstance(state, RigidState):
        raise ValueError(f"this needs the attitude; a {type(state).__name__} has none: use a RigidState.")
    return state


def attitude_of(state: AnyState) -> Array:
    """The attitude (..., 4) of a `RigidState`; a ValueError for any other state."""
    return with_attitude(state).attitude


@jax.custom_jvp
def _turn(attitude: cp.Quaternion, increment: cp.Quaternion, no_step: Array) -> cp.Quaternion:
    """`RigidState.turn`, whose derivative needs no product of attitude and increment."""
    return cp.tree_add(attitude, turn_change(attitude, increment, no_step))


def _turn_tangent(primals: Any, tangents: Any) -> tuple[cp.Quaternion, cp.Quaternion]:
    """The turned attitude is (1 + k) q Q, where the correction k of the length changes by -q . dq."""
    (q, increment, no_step), (dq, d_increment, _) = primals, tangents
    k = _length_correction(_square(q), no_step)
    along = jnp.where(no_step, jnp.zeros_like(k), q[0] * dq[0] + cp.dot(q[1:], dq[1:]))
    factor = 1 + k
    w, x, y, z = (factor * dot - along * part for part, dot in zip(q, dq, strict=True))
    turned, own = cp.multiply((w, x, y, z), increment), cp.multiply(q, d_increment)
    w, x, y, z = (a + factor * b for a, b in zip(turned, own, strict=True))
    return _turn(q, increment, no_step), (w, x, y, z)


_turn.defjvp(_turn_tangent)


def turn_change(attitude: cp.Quaternion, increment: cp.Quaternion, no_step: Array) -> cp.Quaternion:
    """What `RigidState.turn` adds to the attitude.

    The product is computed as a change of the attitude and rounded only once. Rounding the product and then its length
    would turn the attitude slightly, and in the same direction at every step. The correction accounts for the lengths
    of both factors.
    """
    correction = _length_correction(_square(attitude), no_step) + 0.5 * jax.lax.stop_gradient(cp.norm_defect(increment))
    w, x, y, z = increment
    factor = 1 + correction
    return cp.multiply(attitude, ((w - 1) * factor + correction, factor * x, factor * y, factor * z))


def shift_change(attitude: cp.Quaternion, change: cp.Quaternion, no_step: Array) -> cp.Quaternion:
    """What `RigidState.shift` adds to the attitude: the change, and a correction of the length."""
    w, x, y, z = (p + c for p, c in zip(attitude, change, strict=True))
    k = _length_correction(_square((w, x, y, z)), no_step)
    a, b, c, d = change
    return a + k * w, b + k * x, c + k * y, d + k * z


def _square(q: cp.Quaternion) -> Array:
    """The squared length |q|^2."""
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]


def _length_correction(square: Array, no_step: Array) -> Array:
    """The c for which (1 + c) v has length 1 when |v|^2 = square, by one Newton step; zero where `no_step` is True."""
    return jnp.where(no_step, jnp.zeros_like(square), 0.5 - 0.5 * square)
