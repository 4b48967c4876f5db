"""Rotating unit vectors: `DirectionState`, momentum and one space direction; and what it shares with `AxisState`."""

from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_floats, is_unit, require
from ..._math import components as cp
from ..bodies import RigidBody
from ..kind import Leaves
from ..leaf import BodyLeaf, Described, Leaf, length_correction
from ..state import State
from .rigid import BODY_MOMENTUM


class UnitVector(Leaf):
    freedom: ClassVar[int] = 5

    @staticmethod
    def shift(pose: cp.Vector, change: cp.Vector, no_step: Array) -> cp.Vector:
        moved = cp.add(pose, change)
        correction = length_correction(cp.dot(moved, moved), no_step)
        return cp.add(pose, cp.add(change, cp.scale(correction, moved)))

    @staticmethod
    def normalised(*arrays: Array) -> tuple[Array, ...]:
        momentum, v = arrays
        return momentum, v / jnp.sqrt(jnp.sum(v**2, axis=-1, keepdims=True))

    @staticmethod
    def plus(increment: Array, *arrays: Array) -> tuple[Array, ...]:
        return arrays[0] + increment[..., :3], turned(arrays[1], increment[..., 3:])

    @staticmethod
    def minus(arrays: tuple[Array, ...], others: tuple[Array, ...]) -> Array:
        return jnp.concatenate([arrays[0] - others[0], turn_between(others[1], arrays[1])], axis=-1)


def changed(v: cp.Vector, change: cp.Vector, no_step: Array) -> cp.Vector:
    correction = length_correction(cp.dot(v, v), no_step)
    # The correction points along the new vector; otherwise errors of the length would grow.
    return cp.add(v, cp.add(change, cp.scale(correction, cp.add(v, change))))


def turned(v: Array, turn: Array) -> Array:
    first, second = _across(v)
    across = turn[..., 0:1] * first + turn[..., 1:2] * second
    angle = cp.root(jnp.sum(across**2, axis=-1, keepdims=True))
    return jnp.cos(angle) * v + jnp.sinc(angle / jnp.pi) * across


def turn_between(start: Array, end: Array) -> Array:
    axes = _across(start)
    cosine = jnp.sum(end * start, axis=-1, keepdims=True)
    across = end - cosine * start
    sine = cp.root(jnp.sum(across**2, axis=-1, keepdims=True))
    parallel, one = sine <= 8 * cp.epsilon(sine), jnp.ones_like(sine)  # then `across` is only rounding
    turn = across * jnp.where(parallel, one, jnp.arctan2(sine, cosine) / jnp.where(parallel, one, sine))
    turn = jnp.where(parallel & (cosine < 0), jnp.pi * axes[0], turn)
    return jnp.concatenate([jnp.sum(turn * axis, axis=-1, keepdims=True) for axis in axes], axis=-1)


def _across(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors perpendicular to a unit vector and each other; both jump where its z component changes sign.

    T. Duff et al., J. Comput. Graph. Tech. 6 (2017) 1.
    """
    x, y, z = (direction[..., i : i + 1] for i in range(3))
    sign = jnp.where(z < 0, -1, 1).astype(direction.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    first = jnp.concatenate([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    return first, jnp.concatenate([b, sign + y * y * a, -y], axis=-1)


class Direction(UnitVector, BodyLeaf):
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
        return pose


class DirectionState(State):
    """The state of a rigid body in a field with one fixed direction d in space: six numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        direction: the unit vector d in body components, R^T d, (..., 3). For `HeavyTop` d is the upward vertical, for
            `DipoleInField` the direction of the field.

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
        self.momentum = as_finite("momentum", momentum, (3,))
        self.direction = as_floats("direction", direction, (3,))
        require("direction", self.direction, is_unit, "must be a unit vector", "divide it by its norm.")
