"""`State`: momentum and configuration of a body or of particles, as used by steps, torques and drivers.

A state holds the momentum and as much of the configuration as a problem needs: nothing (`MomentumState`), one direction
(`DirectionState`), the attitude (`RigidState`), or positions (`ParticleState`). Users work with arrays, the integration
steps with components: `parts` splits a state into a momentum of type P and a *pose*, the configuration, of type Q. The
class of a state defines how a flight changes the pose (`turn`) and the rates of change of pose and momentum (`rate`,
`momentum_rate`). The rest of the package therefore need not distinguish the kinds of state.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import fields
from typing import Any, ClassVar, Generic, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._checks.arguments import as_floats, described, same_batch
from .._math import components as cp
from .._xla.replay import Packed, Traits, by_components
from .bodies import Body, RigidBody

P = TypeVar("P")  # a momentum in a step: components, or an array for particles
Q = TypeVar("Q")  # a pose in a step: components, or an array for particles
Time = Array | float | int
Described = dict[str, tuple[tuple[str, ...], dict[str, str]]]


class State(eqx.Module, Generic[P, Q]):
    """Base class of states: momentum and configuration.

    A custom state is a subclass with arrays as fields, `momentum` first, the class variable `body`, and six short
    methods: `parts`, `join`, `rotate`, `turn`, `rate` and `momentum_rate`. The other methods follow from these and can
    be overridden. docs/extending.md shows an example with its body and flight.

    In a step, momentum and pose are tuples of scalars (x, y, z) and (w, x, y, z), or named tuples of such tuples.
    Velocities and forces have the form of the momentum.

    Attributes:
        momentum: the momentum, or one part of it. All arrays have its dtype and leading axes.
        body: the kind of body that this state belongs to.
        own_axes: the number of trailing axes of each array that belong to one body; the others are a batch. 0 if the
            number is not fixed.
        compensated: whether it stores the rounding errors of its sums; two flights with such sums do not fit one
            compiled loop.
        has_pose: whether there is a pose; without one, a flight need not compute the rotation.
        turns: whether an increment is a rotation in the body frame only, as a quaternion.
        pose_is_attitude: whether the pose is the attitude alone.
        momenta: the names of the fields that are momenta.
        several: whether it holds coupled bodies, with an axis (N,) in each array.
        apart: whether a torque is evaluated on arrays and compiled separately from the step.
        rotation: for a state that also translates, the class of the state of its rotation. Momentum, pose and inertia
            are then a `Momenta`, a `Place` and a `FreeInertia` (`model/free_body.py`).

    Examples:
        >>> start = ml.RigidState([0.0, 0.0, 50.0], [1.0, 0.0, 0.0, 0.0])
        >>> moved = start.plus(jnp.array([0.0, 0.0, 1.0, 0.1, 0.0, 0.0]))  # momentum, then 0.1 rad about e1
        >>> moved.minus(start).round(6)
        Array([0. , 0. , 1. , 0.1, 0. , 0. ], dtype=float64)
    """

    momentum: eqx.AbstractVar[Array]
    body: ClassVar[type]
    own_axes: ClassVar[int] = 1
    compensated: ClassVar[bool] = False
    has_pose: ClassVar[bool] = True
    turns: ClassVar[bool] = False
    pose_is_attitude: ClassVar[bool] = False
    momenta: ClassVar[tuple[str, ...]] = ("momentum",)
    several: ClassVar[bool] = False
    apart: ClassVar[bool] = False
    rotation: ClassVar["type[AnyState] | None"] = None

    @classmethod
    def belongs_to(cls, body: Any) -> bool:
        """Whether these states belong to a body, given in its principal axes."""
        return isinstance(body, cls.body)

    @classmethod
    def from_velocity(cls, body: Any, velocity: Any, *others: Any) -> Any:
        """The state with this angular velocity, from the arguments of the constructor with velocities for momenta.

        Args:
            body: the body of the run, which has the moments and the mass.
            velocity: the angular velocity (..., 3), in the frame of the momentum: body frame, or space frame for an
                `AxisState`. For particles their velocity.
            others: the other arguments of the constructor, in its order; `linear` is a velocity (..., 3), space frame.

        Raises:
            ValueError: the state does not belong to the body, or as for the constructor.

        Examples:
            >>> still = [1.0, 0.0, 0.0, 0.0]
            >>> ml.RigidState.from_velocity(ml.RigidBody([2.0, 3.0, 4.0]), [0.1, 0.2, 0.3], still).momentum
            Array([0.2, 0.6, 1.2], dtype=float64)
            >>> brick = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.6]), mass=3.0)
            >>> thrown = ml.FreeState.from_velocity(brick, [0.0, 1.5, 0.0], still, [4.0, 0.0, 3.0], [0.0, 0.0, 1.5])
            >>> thrown.linear
            Array([12.,  0.,  9.], dtype=float64)
        """
        if not (isinstance(body, Body) and cls.belongs_to(body.in_principal_axes())):
            raise ValueError(f"body must be a {cls.body.__name__} for a {cls.__name__}, got {described(body)}.")
        made, body = cast("Any", cls), cast("Any", body)
        if cls.rotation is None:
            return made(body.momentum(as_floats("velocity", velocity)), *others)
        orientation, linear, *position = others
        rotation = cls.rotation.from_velocity(body.turning, velocity, orientation)
        linear: Any = as_floats("linear", linear, (3,))
        return made(rotation.momentum, orientation, jnp.asarray(body.mass)[..., None] * linear, *position)

    @abstractmethod
    def parts(self) -> tuple[P, Q]:
        """(momentum, pose) in the form that the steps use."""

    @classmethod
    def unchecked(cls, **arrays: Any) -> Any:
        """The state with these arrays, unchecked, because the arrays of a failed run may hold NaN."""
        state = object.__new__(cls)
        for name, array in arrays.items():
            object.__setattr__(state, name, array)
        return state

    def kind_of_run(self, torque: Traits | None) -> "type[State[P, Q]]":
        """The class in whose form a run moves the state under a torque with these traits; by default its own."""
        del torque
        return type(self)

    @classmethod
    def parts_of(cls, state: "State[P, Q]") -> tuple[P, Q]:
        return state.parts()

    @classmethod
    def each_inertia(cls, inertia: Any, state: Any) -> Any:
        """The constants of a body in the form of this class."""
        del state
        return inertia

    @classmethod
    def each_frame(cls, frame: Any, state: Any) -> Any:
        del state
        return frame

    @classmethod
    @abstractmethod
    def join(cls, momentum: P, pose: Q) -> "State[P, Q]":
        """The inverse of `parts`."""

    @staticmethod
    @abstractmethod
    def rotate(pose: Q, increment: Any) -> Q:
        """The pose after an increment of a flight: a rotation in the body frame; for particles, a displacement."""

    @staticmethod
    @abstractmethod
    def turn(pose: Q, increment: Any, no_step: Array) -> Q:
        """`rotate` for a pose that is rotated at every step.

        It corrects the length of a quaternion or direction for earlier rounding errors. If `no_step` is True (a step of
        length zero), no bit changes.
        """

    @staticmethod
    @abstractmethod
    def rate(pose: Q, velocity: P) -> Q:
        """d pose / dt, a linear function of the body-frame angular velocity; for particles, the velocity itself."""

    @staticmethod
    @abstractmethod
    def momentum_rate(momentum: P, velocity: P, force: P) -> P:
        """d momentum / dt by Euler's equation, Pi' = Pi x Omega + T; for particles, p' = f.

        The rate is jointly linear in velocity and force.
        """

    @staticmethod
    def push(momentum: P, pose: Q, change: P) -> tuple[P, Q]:
        """Momentum and pose after the momentum changes by `change`.

        A compensated state stores the rounding error of this sum in the pose; for other states the pose is unchanged.
        """
        return cp.tree_add(momentum, change), pose

    @classmethod
    def bathed(cls, exposure: Any, root: Any, momentum: P, pose: Q, noise: P) -> P:
        """The change of the momentum in a stage of a heat bath, with standard normal numbers `noise`.

        Args:
            exposure, root: from a `Bath` (`model/bath.py`).
            momentum, pose, noise: components.
        """
        del exposure, root, momentum, pose, noise
        raise ValueError(f"a {cls.__name__} supports no heat bath.")

    @classmethod
    def bathed_in_space(cls, exposure: Any, root: Any, vector: cp.Vector, pose: Q, noise: cp.Vector) -> cp.Vector:
        """Ornstein-Uhlenbeck change of a space-frame vector under an exposure in the body frame."""
        raise needs_attitude(cls)

    @staticmethod
    def shift(pose: Q, change: Q, no_step: Array) -> Q:
        """pose + change, for Runge-Kutta methods; if `no_step` is True, no bit changes.

        If a part of the pose must have length one, one Newton step corrects its length.
        """
        del no_step
        return cp.tree_add(pose, change)

    @classmethod
    def rates(cls, inertia: Any, h: Array, momentum: P, pose: Q, force: P | None) -> tuple[P, Q]:
        """h times the right-hand side of the equations of motion, for momentum and pose."""

        def scaled(tree: P) -> P:
            return jax.tree.map(lambda x: h * x, tree)

        velocity = scaled(inertia.velocity(momentum))
        impulse: P = jax.tree.map(jnp.zeros_like, momentum) if force is None else scaled(force)
        return cls.momentum_rate(momentum, velocity, impulse), cls.rate(pose, velocity)

    @staticmethod
    def components(arrays: Any) -> Any:
        """A momentum, force or pose in the form that steps use: each array becomes a tuple of scalars."""
        return cp.unpacked(arrays)

    @classmethod
    def of_arrays(cls, momentum: Any, pose: Any) -> "State[P, Q]":
        """The state with the momentum and the pose of `parts`, each tuple of scalars as one array."""
        return cls.join(*cls.components((momentum, pose)))

    @classmethod
    def evaluate(cls, function: Callable[[Any, Any], Any], t: Array, momentum: P, pose: Q) -> tuple[Any, Any]:
        """The value `function(t, state)` of a function written on states with arrays, evaluated on components.

        Returns:
            The value, with a tuple of entries in place of each array; and the shape and dtype of each array.
        """
        entries = cp.wrapped((momentum, pose), Packed)
        return by_components(lambda t, momentum, pose: function(t, cls.of_arrays(momentum, pose)), t, *entries)

    @classmethod
    def force_of(cls, value: Any) -> Any:
        """The value of a torque function as arrays in the form of the momentum."""
        return value

    @classmethod
    def returned(cls, force: Any) -> Any:
        """A force as arrays in the form of the momentum: the inverse of `force_of`."""
        return force

    @classmethod
    def force_from(cls, potential: Callable[[Any], Array], state: Any) -> Any:
        """The torque or force of a potential V(state) -> (), by automatic differentiation, as a torque returns it.

        dV/dt = gradient . rate(pose, velocity) = -torque . velocity, and `rate` is linear in the velocity. So -torque
        is the transpose of `rate`, applied to the gradient.
        """
        momentum, pose = state.parts()
        gradient = jax.grad(lambda pose: potential(cls.join(momentum, pose)))(pose)
        (neg_torque,) = jax.linear_transpose(lambda velocity: cls.rate(pose, velocity), momentum)(gradient)
        return cls.returned(jax.tree.map(jnp.negative, cp.packed(neg_torque)))

    @staticmethod
    def vector_in(frame: cp.Quaternion, vector: P) -> P:
        """The components of a momentum or force in a frame rotated by `frame` from the present one."""
        del frame, vector
        raise ValueError("this kind of state supports only the principal frame; define `vector_in`.")

    @classmethod
    def pose_in(cls, frame: cp.Quaternion, pose: Q) -> Q:
        """The pose for a body frame rotated by `frame`."""
        return cls.rotate(pose, frame)

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        """The body components of a vector in the space frame; a ValueError if the state holds no direction."""
        del vector
        raise ValueError(f"a {type(self).__name__} holds no direction; use a DirectionState or a RigidState instead.")

    def vertical(self) -> cp.Vector:
        """The space z axis in body components; a ValueError if the state holds no direction."""
        return self.seen_from_body((jnp.zeros(()), jnp.zeros(()), jnp.ones(())))

    def in_one_frame(self, of_body: Any, of_space: cp.Vector | None = None) -> tuple[Any, Any]:
        """A vector fixed in the body and one fixed in space (default: the space z axis), in the frame of the momentum.

        Torques written with these two vectors also act on an `AxisState`, whose momentum is in the space frame.
        """
        return of_body, self.vertical() if of_space is None else self.seen_from_body(of_space)

    def to_space(self, vector: cp.Vector) -> cp.Vector:
        """The components in the space frame of a vector in the frame of the momentum; a ValueError if unknown."""
        raise needs_attitude(self)

    def spatial_momentum(self) -> Array:
        """The angular momentum in the space frame, about its origin, (..., 3); a ValueError without an attitude."""
        raise needs_attitude(self)

    def fixed_direction(self) -> cp.Vector | None:
        """The space direction that the state holds, in body components; None if it holds all directions or none."""
        return None

    def normalised(self) -> "State[P, Q]":
        """The state with unit vectors and quaternions rescaled to length one, for interpolated arrays."""
        return self

    def plus(self, increment: Array) -> "State[P, Q]":
        """The state moved by an increment (..., k): the change of the momentum, then the change of the pose in radians.

        By default the increment is added to the arrays. For an attitude, the second part is a rotation vector in the
        body frame, (..., 3). Increments can therefore be estimated, averaged and interpolated like any vector.
        """
        moved, begin = list[Array](), 0
        for leaf in jax.tree.leaves(self):
            end = begin + self._flat(leaf).shape[-1]
            moved.append(leaf + increment[..., begin:end].reshape(leaf.shape))
            begin = end
        return jax.tree.unflatten(jax.tree.structure(self), moved)

    def minus(self, other: Any) -> Array:
        """The increment (..., k) from another state to this one: `other.plus(self.minus(other))` is this state."""
        pairs = zip(jax.tree.leaves(self), jax.tree.leaves(other), strict=True)
        return jnp.concatenate([self._flat(a - b) for a, b in pairs], axis=-1)

    def _flat(self, leaf: Array) -> Array:
        return leaf.reshape(*leaf.shape[: leaf.ndim - self.own_axes], -1)

    def sizes(self) -> tuple[Array, ...]:
        """For a small difference of two states: the size of its momentum, and the size of the rest, in radians.

        For a state that translates, the sizes of linear momentum and position follow.
        """
        momentum, *others = [jnp.sum(leaf**2) for leaf in jax.tree.leaves(self)]
        return jnp.sqrt(momentum), jnp.sqrt(sum(others, start=jnp.zeros_like(momentum)))

    @classmethod
    def described(cls) -> Described:
        """For files: for each field, the name of its last dimension, and its long_name, units and frame."""
        return {}

    def batch_of(self, body: Any) -> tuple[int, ...]:
        """The sizes of those leading axes of a body that are a batch rather than an axis of coupled bodies."""
        return body.batch[:-1] if self.several else body.batch

    def check_batch(self) -> None:
        """Raises a ValueError unless all arrays have the same batch axes."""
        same_batch(**{field.name: (getattr(self, field.name), self.own_axes) for field in fields(self)})


AnyState = State[Any, Any]


def needs_attitude(state: AnyState | type[AnyState]) -> ValueError:
    """The error for a state, or a kind of state, without an attitude."""
    kind = state if isinstance(state, type) else type(state)
    return ValueError(f"this needs the attitude, which {kind.__name__} does not have; use a RigidState.")


StateT = TypeVar("StateT", bound=AnyState)  # the class of the states of a run


class BodyState(State[cp.Vector, Q]):
    """State of one rigid body: the methods that all three kinds of pose share."""

    body: ClassVar[type] = RigidBody
    turns: ClassVar[bool] = True

    @classmethod
    def bathed(cls, exposure: Any, root: Any, momentum: cp.Vector, pose: Q, noise: cp.Vector) -> cp.Vector:
        del pose
        return exposure.change(root, momentum, noise)

    @staticmethod
    def momentum_rate(momentum: cp.Vector, velocity: cp.Vector, force: cp.Vector) -> cp.Vector:
        return cp.add(cp.cross(momentum, velocity), force)

    @classmethod
    def rates(
        cls, inertia: Any, h: Array, momentum: cp.Vector, pose: Q, force: cp.Vector | None
    ) -> tuple[cp.Vector, Q]:
        """h times the right-hand side of the equations of motion, Pi' = Pi x I^-1 Pi + T and the rate of the pose.

        A Runge-Kutta method spends nearly all its time here. The products of h with the inverse moments and their gaps
        are therefore computed once per step.
        """
        change = inertia.gyroscopic(h, momentum)
        if force is not None:
            change = cp.add(change, cp.scale(h, force))
        return change, cls.rate(pose, cp.times(cp.scale(h, inertia.inverses), momentum))

    @staticmethod
    def vector_in(frame: cp.Quaternion, vector: cp.Vector) -> cp.Vector:
        return cp.rotate_back(frame, vector)
