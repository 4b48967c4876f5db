"""States: the numbers that say where a body is and how it moves.

A state holds the momentum and as much of the configuration as a scene needs: nothing (`MomentumState`), one direction
(`DirectionState`), the attitude (`RigidState`), or positions (`ParticleState`). Users see arrays. Steps see components:
`parts` gives a momentum of type P and a *pose*, the configuration, of type Q. The class of a state says how a rotation
carries the pose along (`turn`), how fast the pose and the momentum change (`rate`, `momentum_rate`), and how a function
written on states is evaluated on components (`evaluate`). No other part of the package needs to know which it is.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import fields
from typing import Any, ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._kernel import components as cp
from .._kernel.checks import as_floats, is_unit, require, require_finite, same_batch
from .._kernel.replay import Packed, by_components
from .bodies import Particles, RigidBody

P = TypeVar("P")  # a momentum as the steps hold it: components, or the array of particles
Q = TypeVar("Q")  # a pose as the steps hold it
Value = tuple[list[Any], jax.ShapeDtypeStruct]  # entries of an array (constants may be NumPy's), its shape and dtype


class State(eqx.Module, Generic[P, Q]):
    """What the steps and the torques need from a state."""

    momentum: eqx.AbstractVar[Array]
    body: ClassVar[type]  # the kind of body that this state belongs to
    own_axes: ClassVar[int] = 1  # axes of each array that belong to one body; those before them are a batch

    def check_batch(self) -> None:
        """Raises a ValueError unless all arrays have the same batch axes."""
        same_batch(**{field.name: (getattr(self, field.name), self.own_axes) for field in fields(self)})

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """A space vector in body components; a ValueError where the state knows no direction."""
        del vector
        raise ValueError(
            f"a {type(self).__name__} knows no direction; start from a DirectionState or a RigidState instead."
        )

    def vertical(self) -> cp.Vector:
        """The space z axis in body components; a ValueError where the state knows no direction."""
        return self.seen_from_body((jnp.zeros(()), jnp.zeros(()), jnp.ones(())))

    @abstractmethod
    def parts(self) -> tuple[P, Q]:
        """(momentum, pose) as the steps hold them."""

    @classmethod
    @abstractmethod
    def join(cls, momentum: P, pose: Q) -> "State[P, Q]":
        """The inverse of `parts`."""

    @classmethod
    @abstractmethod
    def of(cls, momentum: Array, pose: Any) -> "State[P, Q]":
        """The state of the momentum and pose given as arrays (the pose () where there is none)."""

    @staticmethod
    @abstractmethod
    def rotate(pose: Q, increment: Any) -> Q:
        """The pose after the body has turned by `increment`, a rotation in the body frame; of particles, a shift."""

    @staticmethod
    @abstractmethod
    def turn(pose: Q, increment: Any, still: Array, t: Array) -> Q:
        """The same for a pose that takes up a rotation at every step, this one at time t, as `accumulate` adds it.

        Corrects the length of the pose for what rounding changed before. Where `still`, no bit is changed.
        """

    @staticmethod
    @abstractmethod
    def shift(pose: Q, change: Q, still: Array, t: Array) -> Q:
        """pose + change, brought to the length of a pose, to second order; where `still`, no bit is changed."""

    @staticmethod
    @abstractmethod
    def rate(pose: Q, velocity: P) -> Q:
        """d pose / dt at a body-frame angular velocity; linear in it."""

    @staticmethod
    @abstractmethod
    def momentum_rate(momentum: P, velocity: P, force: P) -> P:
        """d momentum / dt, Euler's equation Pi' = Pi x Omega + T; linear in velocity and force together.

        Particles have p' = f.
        """

    @staticmethod
    @abstractmethod
    def commutator(velocity: P, force: P) -> P:
        """The part of the change of a force along the body's motion that comes from the turning of its axes."""

    @classmethod
    @abstractmethod
    def evaluate(cls, function: Callable[[Any, Any], Any], t: Array, momentum: P, pose: Q) -> Value:
        """The array `function(t, state)`, for a function written on states of arrays."""

    @staticmethod
    @abstractmethod
    def from_entries(entries: list[Any]) -> P:
        """A force, from the entries that `evaluate` gives."""

    @staticmethod
    @abstractmethod
    def pack(vector: P) -> Array:
        """A velocity or force as one array."""

    @staticmethod
    @abstractmethod
    def unpack(array: Array) -> P:
        """The inverse of `pack`."""


AnyState = State[Any, Any]


class BodyState(State[cp.Vector, Q]):
    """A state of one rigid body: what does not depend on how much of the attitude is followed."""

    body: ClassVar[type] = RigidBody

    @staticmethod
    def momentum_rate(momentum: cp.Vector, velocity: cp.Vector, force: cp.Vector) -> cp.Vector:
        return cp.add(cp.cross(momentum, velocity), force)

    @staticmethod
    def commutator(velocity: cp.Vector, force: cp.Vector) -> cp.Vector:
        return cp.cross(velocity, force)

    @classmethod
    def evaluate(cls, function: Callable[[Any, Any], Any], t: Array, momentum: cp.Vector, pose: Q) -> Value:
        boxed = tuple(Packed(tuple(part)) if part else () for part in (momentum, pose))  # pyright: ignore
        return by_components(lambda t, momentum, pose: function(t, cls.of(momentum, pose)), t, *boxed)

    @staticmethod
    def from_entries(entries: list[Any]) -> Any:
        return entries[0], entries[1], entries[2]

    @staticmethod
    def pack(vector: cp.Vector) -> Array:
        return cp.pack(vector)

    @staticmethod
    def unpack(array: Array) -> cp.Vector:
        return cp.vector(array)


class MomentumState(BodyState[tuple[()]]):
    """A body whose attitude nobody asks for: three numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
    """

    momentum: Float[Array, "*batch 3"]

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
    def turn(pose: tuple[()], increment: cp.Quaternion, still: Array, t: Array) -> tuple[()]:
        del increment, still, t
        return pose

    @staticmethod
    def shift(pose: tuple[()], change: tuple[()], still: Array, t: Array) -> tuple[()]:
        del change, still, t
        return pose

    @staticmethod
    def rate(pose: tuple[()], velocity: cp.Vector) -> tuple[()]:
        del velocity
        return pose


class DirectionState(BodyState[cp.Vector]):
    """A body in a field that depends on one space direction only: six numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        direction: the field's unit direction seen from the body, R^T d, (..., 3). For `HeavyTop` d is the
            upward vertical, for `DipoleInField` the direction of the field.
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
    def turn(pose: cp.Vector, increment: cp.Quaternion, still: Array, t: Array) -> cp.Vector:
        share = _missing(cp.dot(pose, pose), still)
        change = cp.rotation_change(cp.conjugate(increment), pose)
        # Along the pose as it will be: what is missing of its length would grow if it were added along another.
        return cp.accumulate(pose, cp.add(change, cp.scale(share, cp.add(pose, change))), t)

    @staticmethod
    def shift(pose: cp.Vector, change: cp.Vector, still: Array, t: Array) -> cp.Vector:
        there = cp.add(pose, change)
        share = _missing(cp.dot(there, there), still)
        return cp.accumulate(pose, cp.add(change, cp.scale(share, there)), t)

    @staticmethod
    def rate(pose: cp.Vector, velocity: cp.Vector) -> cp.Vector:
        return cp.cross(pose, velocity)

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """A space vector along the field's direction, in body components."""
        return cp.scale(cp.norm(vector), cp.vector(self.direction))

    def vertical(self) -> cp.Vector:
        """The space z axis in body components, which the direction then is."""
        return cp.vector(self.direction)


class RigidState(BodyState[cp.Quaternion]):
    """A body's momentum and attitude: seven numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).
        attitude: unit quaternion (w, x, y, z), body components to space components, (..., 4).
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
    def turn(pose: cp.Quaternion, increment: cp.Quaternion, still: Array, t: Array) -> cp.Quaternion:
        # As a change of the pose, so that it is rounded once. Rounding the product, and then the length, would turn the
        # attitude a little, and at every step the same way. The share is that of both factors' lengths.
        share = _missing(_square(pose), still) + 0.5 * cp.missing(increment)
        w, x, y, z = increment
        factor = 1 + share
        change = cp.multiply(pose, ((w - 1) * factor + share, factor * x, factor * y, factor * z))
        return cp.accumulate(pose, change, t)

    @staticmethod
    def shift(pose: cp.Quaternion, change: cp.Quaternion, still: Array, t: Array) -> cp.Quaternion:
        w, x, y, z = (p + c for p, c in zip(pose, change, strict=True))
        share = _missing(_square((w, x, y, z)), still)
        a, b, c, d = change
        return cp.accumulate(pose, (a + share * w, b + share * x, c + share * y, d + share * z), t)

    @staticmethod
    def rate(pose: cp.Quaternion, velocity: cp.Vector) -> cp.Quaternion:
        w, x, y, z = pose
        a, b, c = velocity
        half = (-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a)
        return (0.5 * half[0], 0.5 * half[1], 0.5 * half[2], 0.5 * half[3])

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """A space vector in body components, R^T vector."""
        return cp.rotate_back(cp.quaternion(self.attitude), vector)

    def vertical(self) -> cp.Vector:
        """The space z axis in body components: the last row of R."""
        w, x, y, z = cp.quaternion(self.attitude)
        return 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z


class ParticleState(State[Array, Array]):
    """Positions and momenta of particles.

    Attributes:
        momentum: p, (n,) or any shape.
        position: u, the same shape.
    """

    momentum: Float[Array, "..."]
    position: Float[Array, "..."]
    body: ClassVar[type] = Particles
    own_axes: ClassVar[int] = 0  # of any shape, the same for both

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
    def turn(pose: Array, increment: Array, still: Array, t: Array) -> Array:
        del still
        return cp.accumulate(pose, increment, t)

    @staticmethod
    def shift(pose: Array, change: Array, still: Array, t: Array) -> Array:
        del still
        return cp.accumulate(pose, change, t)

    @staticmethod
    def rate(pose: Array, velocity: Array) -> Array:
        del pose
        return velocity

    @staticmethod
    def momentum_rate(momentum: Array, velocity: Array, force: Array) -> Array:
        del momentum, velocity
        return force

    @staticmethod
    def commutator(velocity: Array, force: Array) -> Array:
        del velocity
        return jnp.zeros_like(force)

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
    def unpack(array: Array) -> Array:
        return array


def attitude_of(state: State[Any, Any]) -> Array:
    """The attitude (..., 4); a ValueError for a state without one."""
    if not isinstance(state, RigidState):
        raise ValueError(f"this needs the attitude; a {type(state).__name__} has none: use a RigidState.")
    return state.attitude


def _square(q: cp.Quaternion) -> Array:
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]


def _missing(square: Array, still: Array) -> Array:
    """The share by which something of this squared length must grow to have length 1, by one step of Newton's."""
    return jnp.where(still, jnp.zeros_like(square), 0.5 - 0.5 * square)
