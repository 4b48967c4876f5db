"""`State`: momentum and configuration of a body or of particles, as used by steps, torques and drivers.

Users work with arrays, the integration steps with components: `parts` splits a state into a momentum and a *pose*, the
configuration. The leaves of a state (`leaf.py`) define their motion, and its `Kind` combines them. The rest of the
package therefore need not distinguish the kinds of state.
"""

from dataclasses import fields
from itertools import chain
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import as_floats, described
from .._checks.brief_help import BriefHelp
from .._math import components as cp
from .bodies import Body
from .kind import Kind, Leaves, arrays_by_leaf
from .leaf import Described, needs_attitude

P = TypeVar("P")  # a momentum in a step: components, or an array for particles
Q = TypeVar("Q")  # a pose in a step: components, or an array for particles
Time = Array | float | int


class State(eqx.Module, metaclass=BriefHelp):
    """Base class of states: momentum and configuration.

    A custom state is a subclass with arrays as fields and the class variables `body` and `leaves`. With two leaves, the
    second one is the translation of the centre of mass. docs/extending.md shows an example with its body and flight.

    Attributes:
        momentum: the momentum of the first leaf. All arrays have its dtype and leading axes.
        body: the kind of body that this state belongs to.
        leaves: the leaves, in the order of their fields: for each leaf its momentum, then its pose.
        own_axes: the number of trailing axes of each array that belong to one state: 1 for one body, 2 for coupled
            bodies, 0 if the number is not fixed. The others are a batch.

    Raises:
        ValueError: for every state: wrong shapes or dtypes, NaN or infinity, different leading axes, or a quaternion or
            unit vector whose length is not 1 to 1e-3.

    Examples:
        >>> moved = start.plus(jnp.array([0.0, 0.0, 1.0, 0.1, 0.0, 0.0]))  # momentum, then 0.1 rad about e1
        >>> moved.minus(start).round(6)
        Array([0. , 0. , 1. , 0.1, 0. , 0. ], dtype=float64)
    """

    momentum: eqx.AbstractVar[Array]
    body: ClassVar[type]
    leaves: ClassVar[Leaves]
    own_axes: ClassVar[int] = 1

    def __check_init__(self) -> None:
        self.kind.check_shapes({field.name: np.shape(getattr(self, field.name)) for field in fields(self)})

    @property
    def kind(self) -> Kind:
        return Kind(type(self), self.leaves)

    @property
    def several(self) -> bool:
        """Whether it holds coupled bodies, with an axis (N,) in each array."""
        return self.own_axes == 2

    @classmethod
    def from_velocity(cls, body: Any, velocity: Any, *others: Any) -> Any:
        """The state with this angular velocity, from the arguments of the constructor with velocities for momenta.

        Args:
            body: the body of the run, which has the moments and the mass.
            velocity: the angular velocity (..., 3), in the frame of the momentum. For particles their velocity.
            others: the other arguments of the constructor, in its order; `linear` is a velocity (..., 3), space frame.

        Raises:
            ValueError: the state does not belong to the body, or as for the constructor.

        Examples:
            >>> body, still = ml.RigidBody([2.0, 3.0, 4.0]), [1.0, 0.0, 0.0, 0.0]
            >>> ml.RigidState.from_velocity(body, [0.1, 0.2, 0.3], still).momentum
            Array([0.2, 0.6, 1.2], dtype=float64)
        """
        require_own(body, cls)
        made: Any = cls
        return made(body.momentum(as_floats("velocity", velocity)), *others)

    def parts(self) -> tuple[Any, Any]:
        """(momentum, pose) in the form that steps use: tuples of scalars (x, y, z) and (w, x, y, z).

        With two leaves they are a `Momenta` and a `Place` of such tuples.
        """
        return self.kind.parts(self)

    @classmethod
    def unchecked(cls, **arrays: Any) -> Any:
        """The state with these arrays, unchecked, because the arrays of a failed run may hold NaN."""
        state = object.__new__(cls)
        vars(state).update(arrays)
        return state

    @classmethod
    def belongs_to(cls, body: Any) -> bool:
        """Whether these states belong to a body, given in its principal axes."""
        return isinstance(body, cls.body)

    def _by_leaf(self) -> Any:
        return arrays_by_leaf(self.leaves, self)

    @property
    def _pose(self) -> Any:
        return self.leaves[0].pose(*self._by_leaf()[0][1:])

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """The body components of a vector in the space frame; a ValueError if the state holds no direction."""
        return self.leaves[0].to_body(self, self._pose, vector)

    def vertical(self) -> cp.Vector:
        """The space z axis in body components; a ValueError if the state holds no direction."""
        return self.leaves[0].vertical(self, self._pose)

    def in_one_frame(self, of_body: Any, of_space: cp.Vector | None = None) -> tuple[Any, Any]:
        """A vector fixed in the body and one fixed in space (default: the space z axis), in the frame of the momentum.

        Torques written with these two vectors also act on an `AxisState`, whose momentum is in the space frame.
        """
        if not self.leaves[0].in_space:
            return of_body, self.vertical() if of_space is None else self.seen_from_body(of_space)
        along = self.leaves[0].from_body(self, self._pose, of_body)
        return along, (0.0, 0.0, 1.0) if of_space is None else of_space

    def to_space(self, vector: cp.Vector) -> cp.Vector:
        """The components in the space frame of a vector in the frame of the momentum; a ValueError if unknown."""
        return self.leaves[0].to_space(self, self._pose, vector)

    def spatial_momentum(self) -> Array:
        """The angular momentum in the space frame, about its origin, (..., 3); a ValueError without an attitude."""
        return self.leaves[0].spatial_momentum(self, *self._by_leaf()[0])

    def plus(self: "StateT", increment: Array) -> "StateT":
        """The state moved by an increment (..., k): for each leaf the change of the momentum, then of the pose.

        For an attitude, the second part is a rotation vector in the body frame, (..., 3), radians. For a direction or
        an axis it is a rotation vector in the plane perpendicular to it, (..., 2), along two axes that depend on the
        direction alone.
        """
        made: Any = type(self)
        ends = np.cumsum([leaf.freedom for leaf in self.leaves[:-1]], dtype=int)
        each = zip(self.leaves, jnp.split(increment, ends, axis=-1), self._by_leaf(), strict=True)
        return made(*chain.from_iterable(leaf.plus(part, *own) for leaf, part, own in each))

    def minus(self, other: Any) -> Array:
        """The increment (..., k) from another state to this one: `other.plus(self.minus(other))` is this state.

        Between opposite directions, the rotation along the first of its two axes is returned.
        """
        each = zip(self.leaves, self._by_leaf(), other._by_leaf(), strict=True)
        increments = [leaf.minus(own, before) for leaf, own, before in each]
        return increments[0] if len(increments) == 1 else jnp.concatenate(increments, axis=-1)

    @classmethod
    def described(cls) -> dict[str, Described]:
        """For files: for each field, the name of its last dimension, and its long_name, units and frame."""
        about = chain.from_iterable(leaf.about for leaf in cls.leaves)
        return {field.name: own for field, own in zip(fields(cls), about, strict=False)}

    @property
    def batch(self) -> tuple[int, ...]:
        """The sizes of the leading axes of a batch; () if the number of own axes is not fixed."""
        shape = self.momentum.shape
        return shape[: -self.own_axes] if self.own_axes else ()


AnyState = State
StateT = TypeVar("StateT", bound=State)  # the class of the states of a run


def require_own(body: Any, states: type[State]) -> None:
    if not (isinstance(body, Body) and states.belongs_to(body.in_principal_axes())):
        raise ValueError(f"body must be a {states.body.__name__} for a {states.__name__}, got {described(body)}.")


def attitude_of(state: AnyState) -> Array:
    attitude: Any = getattr(state, "attitude", None)
    if attitude is None:
        raise needs_attitude(state)
    return attitude


def require_all_directions(state: AnyState) -> Any:
    if hasattr(state, "direction"):
        raise ValueError("a DirectionState holds one fixed direction; use a RigidState if the direction changes.")
    return state
