"""States: the momentum of a body or of particles, and its configuration.

A state holds the momentum and as much of the configuration as a problem needs: nothing (`MomentumState`), one direction
(`DirectionState`), the attitude (`RigidState`), or positions (`ParticleState`). Users work with arrays, the integration
steps with components: `parts` splits a state into a momentum of type P and a *pose*, the configuration, of type Q. The
class of a state defines how a rotation changes the pose (`turn`), the rates of change of the pose and the momentum
(`rate`, `momentum_rate`), and how a function written on states is evaluated on components (`evaluate`). So the rest of
the package need not distinguish the kinds of state.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import fields
from typing import Any, ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.checks import same_batch
from .._kernel.replay import Packed, by_components
from .bodies import RigidBody

P = TypeVar("P")  # a momentum in a step: components, or an array for particles
Q = TypeVar("Q")  # a pose in a step: components, or an array for particles
Time = Array | float | int
# The value of a function: the entries of an array (constants can be NumPy values), and its shape and dtype.
Value = tuple[list[Any], jax.ShapeDtypeStruct]


class State(eqx.Module, Generic[P, Q]):
    """The interface of a state to the steps and the torques."""

    momentum: eqx.AbstractVar[Array]
    body: ClassVar[type]  # the kind of body that this state belongs to
    own_axes: ClassVar[int] = 1  # how many trailing axes of each array belong to one body; the others are a batch
    long_sums: ClassVar[bool] = False  # whether its sums are so long that two flights do not fit one compiled loop
    has_pose: ClassVar[bool] = True  # without a pose, a flight need not compute how the body turns

    def check_batch(self) -> None:
        """Raises a ValueError unless all arrays have the same batch axes."""
        same_batch(**{field.name: (getattr(self, field.name), self.own_axes) for field in fields(self)})

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """The body components of a vector in the space frame; a ValueError if the state holds no direction."""
        del vector
        raise ValueError(
            f"a {type(self).__name__} knows no direction; start from a DirectionState or a RigidState instead."
        )

    def vertical(self) -> cp.Vector:
        """The space z axis in body components; a ValueError if the state holds no direction."""
        return self.seen_from_body((jnp.zeros(()), jnp.zeros(()), jnp.ones(())))

    @abstractmethod
    def parts(self) -> tuple[P, Q]:
        """(momentum, pose) in the form that the steps use."""

    @classmethod
    @abstractmethod
    def join(cls, momentum: P, pose: Q) -> "State[P, Q]":
        """The inverse of `parts`."""

    @classmethod
    @abstractmethod
    def of(cls, momentum: Array, pose: Any) -> "State[P, Q]":
        """The state with this momentum and pose as arrays; the pose of a `MomentumState` is ()."""

    @staticmethod
    @abstractmethod
    def rotate(pose: Q, increment: Any) -> Q:
        """The pose after the body turns by `increment`, a rotation in the body frame; for particles, a displacement."""

    @staticmethod
    def push(momentum: P, pose: Q, change: P) -> tuple[P, Q]:
        """Momentum and pose after the momentum changes by `change`.

        A state that keeps what the rounding of this sum loses has it in the pose; for all others the pose is unchanged.
        """
        return cp.tree_add(momentum, change), pose

    @staticmethod
    @abstractmethod
    def turn(pose: Q, increment: Any, no_step: Array) -> Q:
        """`rotate` for a pose that is turned at every step.

        The length of the pose is corrected for earlier rounding errors. Where `no_step` is True (a step of size zero),
        no bit is changed.
        """

    @staticmethod
    @abstractmethod
    def shift(pose: Q, change: Q, no_step: Array) -> Q:
        """pose + change, normalised by one Newton step; where `no_step` is True, no bit is changed."""

    @staticmethod
    @abstractmethod
    def rate(pose: Q, velocity: P) -> Q:
        """d pose / dt for a body-frame angular velocity, in which it is linear; for particles, the velocity."""

    @staticmethod
    @abstractmethod
    def momentum_rate(momentum: P, velocity: P, force: P) -> P:
        """d momentum / dt by Euler's equation, Pi' = Pi x Omega + T; for particles, p' = f.

        It is jointly linear in velocity and force.
        """

    @classmethod
    @abstractmethod
    def evaluate(cls, function: Callable[[Any, Any], Any], t: Array, momentum: P, pose: Q) -> Value:
        """The value `function(t, state)` of a function written on states with arrays, evaluated on components."""

    @staticmethod
    @abstractmethod
    def from_entries(entries: list[Any]) -> P:
        """A force from the entries that `evaluate` returns."""

    @staticmethod
    @abstractmethod
    def pack(vector: P) -> Array:
        """A velocity or force as one array."""

    @staticmethod
    @abstractmethod
    def pack_pose(pose: Q) -> Any:
        """A pose, or its rate of change, as one array; () where there is none."""

    @staticmethod
    @abstractmethod
    def unpack(array: Array) -> P:
        """The inverse of `pack`."""


AnyState = State[Any, Any]
StateT = TypeVar("StateT", bound=AnyState)  # the class of the states of a run


class BodyState(State[cp.Vector, Q]):
    """A state of one rigid body: the methods that are the same for all three kinds of pose."""

    body: ClassVar[type] = RigidBody

    @staticmethod
    def momentum_rate(momentum: cp.Vector, velocity: cp.Vector, force: cp.Vector) -> cp.Vector:
        return cp.add(cp.cross(momentum, velocity), force)

    @classmethod
    def evaluate(cls, function: Callable[[Any, Any], Any], t: Array, momentum: cp.Vector, pose: Q) -> Value:
        packed = tuple(Packed(tuple(part)) if part else () for part in (momentum, pose))  # pyright: ignore
        return by_components(lambda t, momentum, pose: function(t, cls.of(momentum, pose)), t, *packed)

    @staticmethod
    def from_entries(entries: list[Any]) -> Any:
        return entries[0], entries[1], entries[2]

    @staticmethod
    def pack(vector: cp.Vector) -> Array:
        return cp.pack(vector)

    @staticmethod
    def pack_pose(pose: Any) -> Any:
        return cp.pack(pose) if pose else ()

    @staticmethod
    def unpack(array: Array) -> cp.Vector:
        return cp.vector(array)
