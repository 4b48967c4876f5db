"""`Leaf`: the arithmetic of a momentum and of the pose that it moves, on components."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .exposure import InSpace

Described = tuple[tuple[str, ...], dict[str, str]]


class Leaf:
    """A momentum of a state and the pose that it moves; never instantiated.

    By default it is a vector space: the pose moves by sums, and the force is the rate of the momentum. A custom leaf
    overrides `act`, `rate` and `momentum_rate`. Momentum and pose are tuples of scalars. Velocities and forces have the
    form of the momentum.

    Attributes:
        arrays: the number of arrays in a state: the momentum, and the arrays of the pose.
        freedom: the numbers of an increment: of the momentum, then of the pose.
        has_pose: whether there is a pose; without one, a flight need not compute the rotation.
        turns: whether an increment is a rotation in the body frame, as a quaternion.
        in_space: whether the momentum is in the space frame although the body rotates.
        compensated: whether it stores rounding errors; two flights with such sums do not fit one compiled loop.
        about: for files: for each array, the name of its last dimension, and its long_name, units and frame.

    Examples:
        >>> ml.RigidState.leaves[0].freedom, [leaf.arrays for leaf in ml.FreeState.leaves]
        (6, [2, 2])
    """

    arrays: ClassVar[int] = 2
    freedom: ClassVar[int] = 6
    has_pose: ClassVar[bool] = True
    turns: ClassVar[bool] = False
    in_space: ClassVar[bool] = False
    compensated: ClassVar[bool] = False
    about: ClassVar[tuple[Described, ...]] = ()

    # Components and arrays

    @staticmethod
    def components(arrays: Any) -> Any:
        """Arrays in the form that steps use: each as a tuple of scalars."""
        return cp.unpacked(arrays)

    @classmethod
    def pose(cls, *arrays: Array) -> Any:
        """The pose of the arrays after the momentum."""
        return cls.components(arrays[0])

    @staticmethod
    def packed(momentum: Any, pose: Any) -> tuple[Array, ...]:
        """All arrays of a momentum and a pose."""
        return cp.pack(momentum), cp.pack(pose)

    # Steps

    @staticmethod
    def act(pose: Any, increment: Any, no_step: Array | None = None) -> Any:
        """The pose after an increment of a flight: a rotation, or a displacement.

        With `no_step`, earlier rounding errors of the length of a quaternion or direction are corrected; if it is True
        (a step of length zero), no bit changes.
        """
        return cp.tree_add(pose, increment)

    @staticmethod
    def rate(pose: Any, velocity: Any) -> Any:
        """d pose / dt, a linear function of the velocity."""
        return velocity

    @staticmethod
    def momentum_rate(momentum: Any, velocity: Any, force: Any) -> Any:
        """d momentum / dt, jointly linear in velocity and force; Pi' = Pi x Omega + T for a rigid body."""
        return force

    @staticmethod
    def shift(pose: Any, change: Any, no_step: Array) -> Any:
        """pose + change, for Runge-Kutta methods; if `no_step` is True, no bit changes.

        If a part of the pose must have length one, one Newton step corrects its length.
        """
        return cp.tree_add(pose, change)

    @classmethod
    def rates(cls, inertia: Any, h: Array, momentum: Any, pose: Any, force: Any) -> tuple[Any, Any]:
        """h times the right-hand side of the equations of motion, for momentum and pose; no force is None."""
        velocity = jax.tree.map(lambda x: h * x, inertia.velocity(momentum))
        impulse = jax.tree.map(jnp.zeros_like, momentum) if force is None else jax.tree.map(lambda x: h * x, force)
        return cls.momentum_rate(momentum, velocity, impulse), cls.rate(pose, velocity)

    @staticmethod
    def push(momentum: Any, pose: Any, change: Any) -> tuple[Any, Any]:
        """Momentum and pose after the momentum changes by `change`.

        A compensated leaf stores the rounding error of this sum in the pose; for others the pose is unchanged.
        """
        return cp.tree_add(momentum, change), pose

    @classmethod
    def bathed(cls, exposure: Any, root: Any, momentum: Any, pose: Any, noise: Any) -> Any:
        """The change of the momentum in a stage of a heat bath (`model/exposure.py`), with normal numbers `noise`."""
        raise ValueError(f"{cls.__name__} supports no heat bath.")

    @classmethod
    def bathed_in_space(cls, exposure: Any, root: Any, vector: cp.Vector, pose: Any, noise: cp.Vector) -> cp.Vector:
        """The change of a space-frame vector under an exposure in the body frame."""
        raise ValueError(f"{cls.__name__} supports no heat bath.")

    # Frames

    @staticmethod
    def vector_in(frame: cp.Quaternion, vector: Any) -> Any:
        """The components of a momentum or force in a frame rotated by `frame` from the present one."""
        raise ValueError("this kind of state supports only the principal frame; define `vector_in`.")

    @classmethod
    def pose_in(cls, frame: cp.Quaternion, pose: Any) -> Any:
        """The pose for a body frame rotated by `frame`."""
        return cls.act(pose, frame)

    @staticmethod
    def to_body(owner: Any, pose: Any, vector: cp.Vector) -> cp.Vector:
        """The body components of a vector in the space frame; `owner` is the state, for messages."""
        raise ValueError(f"a {type(owner).__name__} holds no direction; use a DirectionState or a RigidState instead.")

    @classmethod
    def vertical(cls, owner: Any, pose: Any) -> cp.Vector:
        """The space z axis in body components."""
        return cls.to_body(owner, pose, (jnp.zeros(()), jnp.zeros(()), jnp.ones(())))

    @staticmethod
    def from_body(owner: Any, pose: Any, vector: Any) -> Any:
        """The components, in the frame of the momentum, of a vector fixed in the body."""
        return vector

    @staticmethod
    def to_space(owner: Any, pose: Any, vector: cp.Vector) -> cp.Vector:
        """The space components of a vector in the frame of the momentum."""
        raise needs_attitude(owner)

    @staticmethod
    def spatial_momentum(owner: Any, *arrays: Array) -> Array:
        """The angular momentum in the space frame, about the fixed point or the centre of mass, (..., 3)."""
        raise needs_attitude(owner)

    # Arrays

    @staticmethod
    def normalised(*arrays: Array) -> tuple[Array, ...]:
        """The arrays with unit vectors and quaternions rescaled to length one."""
        return arrays

    @staticmethod
    def plus(increment: Array, *arrays: Array) -> tuple[Array, ...]:
        """The arrays moved by an increment (..., freedom): by default a sum."""
        moved, begin = list[Array](), 0
        for array in arrays:
            end = begin + array.shape[-1]
            moved.append(array + increment[..., begin:end])
            begin = end
        return tuple(moved)

    @staticmethod
    def minus(arrays: tuple[Array, ...], others: tuple[Array, ...]) -> Array:
        """The increment (..., freedom) from `others` to `arrays`: by default a difference."""
        return jnp.concatenate([a - b for a, b in zip(arrays, others, strict=True)], axis=-1)

    @staticmethod
    def sizes(*arrays: Array) -> tuple[Array, ...]:
        """For a small difference of arrays: the size of its momentum, and of the rest, in radians."""
        momentum, *others = [jnp.sum(array**2) for array in arrays]
        return jnp.sqrt(momentum), jnp.sqrt(sum(others, start=jnp.zeros_like(momentum)))


class BodyLeaf(Leaf):
    """A leaf whose momentum is in the frame of a rigid body: what all three kinds of pose share."""

    turns: ClassVar[bool] = True

    @classmethod
    def bathed(cls, exposure: Any, root: Any, momentum: cp.Vector, pose: Any, noise: cp.Vector) -> cp.Vector:
        if isinstance(exposure, InSpace):
            return cls.to_body(cls, pose, exposure.own.change(root, momentum, noise))
        return exposure.change(root, momentum, noise)

    @staticmethod
    def momentum_rate(momentum: cp.Vector, velocity: cp.Vector, force: cp.Vector) -> cp.Vector:
        return cp.add(cp.cross(momentum, velocity), force)

    @classmethod
    def rates(cls, inertia: Any, h: Array, momentum: cp.Vector, pose: Any, force: cp.Vector | None) -> tuple[Any, Any]:
        """`Leaf.rates`; the products of h with the inverse moments and their gaps are computed once per step."""
        change = inertia.gyroscopic(h, momentum)
        if force is not None:
            change = cp.add(change, cp.scale(h, force))
        return change, cls.rate(pose, cp.times(cp.scale(h, inertia.inverses), momentum))

    @staticmethod
    def vector_in(frame: cp.Quaternion, vector: cp.Vector) -> cp.Vector:
        return cp.rotate_back(frame, vector)


class NoPose(Leaf):
    arrays: ClassVar[int] = 1
    freedom: ClassVar[int] = 3
    has_pose: ClassVar[bool] = False

    @classmethod
    def pose(cls, *arrays: Array) -> tuple[()]:
        return ()

    @staticmethod
    def packed(momentum: Any, pose: tuple[()]) -> tuple[Array, ...]:
        return (cp.pack(momentum),)

    @staticmethod
    def act(pose: tuple[()], increment: Any, no_step: Array | None = None) -> tuple[()]:
        return pose

    @staticmethod
    def rate(pose: tuple[()], velocity: cp.Vector) -> tuple[()]:
        return pose


class Flat(Leaf):
    """A leaf with arrays of any shape; an increment holds all their numbers, (k,)."""

    @staticmethod
    def plus(increment: Array, *arrays: Array) -> tuple[Array, ...]:
        each = jnp.split(increment, len(arrays), axis=-1)
        return tuple(array + own.reshape(array.shape) for array, own in zip(arrays, each, strict=True))

    @staticmethod
    def minus(arrays: tuple[Array, ...], others: tuple[Array, ...]) -> Array:
        return jnp.concatenate([(a - b).ravel() for a, b in zip(arrays, others, strict=True)])


def needs_attitude(state: Any) -> ValueError:
    return ValueError(f"this needs the attitude, which {type(state).__name__} does not have; use a RigidState.")


def length_correction(square: Array, no_step: Array) -> Array:
    return jnp.where(no_step, jnp.zeros_like(square), 0.5 - 0.5 * square)
