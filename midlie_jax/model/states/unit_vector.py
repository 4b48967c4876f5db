"""States whose pose is a unit vector: `DirectionState`, fixed in space; `AxisState`, fixed in the body."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_floats, is_unit, require
from ..._math import components as cp
from .. import so3
from ..bodies import RigidBody, SymmetricRotor
from ..exposure import InSpace
from ..kind import Leaves
from ..leaf import BodyLeaf, Described, Leaf, length_correction, needs_attitude
from ..state import State
from .rigid import BODY_MOMENTUM, RigidState

_NO_SPIN = 1e-6  # relative to the angular velocity, below which a part along the axis is rounding
SPATIAL_MOMENTUM = {
    "long_name": "angular momentum in space, about the fixed point or the centre of mass",
    "units": "mass length2 time-1",
    "frame": "space",
}
AXIS = {"long_name": "axis of symmetry in space", "units": "1", "frame": "space"}


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
        momentum, turn, v = arrays[0] + increment[..., :3], increment[..., 3:], arrays[1]
        first, second = _across(v)
        across = turn[..., 0:1] * first + turn[..., 1:2] * second
        angle = cp.root(jnp.sum(across**2, axis=-1, keepdims=True))
        return momentum, jnp.cos(angle) * v + jnp.sinc(angle / jnp.pi) * across

    @staticmethod
    def minus(arrays: tuple[Array, ...], others: tuple[Array, ...]) -> Array:
        (momentum, end), (before, start) = arrays, others
        change, axes = momentum - before, _across(start)
        cosine = jnp.sum(end * start, axis=-1, keepdims=True)
        across = end - cosine * start
        sine = cp.root(jnp.sum(across**2, axis=-1, keepdims=True))
        parallel, one = sine <= 8 * cp.epsilon(sine), jnp.ones_like(sine)  # then `across` is only rounding
        turn = across * jnp.where(parallel, one, jnp.arctan2(sine, cosine) / jnp.where(parallel, one, sine))
        turn = jnp.where(parallel & (cosine < 0), jnp.pi * axes[0], turn)
        turn = jnp.concatenate([jnp.sum(turn * axis, axis=-1, keepdims=True) for axis in axes], axis=-1)
        return jnp.concatenate([change, turn], axis=-1)


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
        change = cp.rotation_change(cp.conjugate(increment), pose)
        correction = length_correction(cp.dot(pose, pose), no_step)
        # The correction points along the new vector; otherwise errors of the length would grow.
        return cp.add(pose, cp.add(change, cp.scale(correction, cp.add(pose, change))))

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


class Swing(NamedTuple):
    """A rotation of an axis about u in space by 2 |u|: |u|^2, sin(2 |u|) / |u| and (1 - cos(2 |u|)) / |u|^2."""

    vector: cp.Vector
    square: Array
    sine: Array
    versine: Array

    @classmethod
    def of(cls, vector: cp.Vector, square: Array, cosine: Array, sinc: Array) -> "Swing":
        double = sinc + sinc
        return cls(vector, square, double * cosine, double * sinc)


class Axis(UnitVector):
    in_space: ClassVar[bool] = True
    about: ClassVar[tuple[Described, ...]] = ((("space_axis",), SPATIAL_MOMENTUM), (("space_axis",), AXIS))

    @staticmethod
    def act(pose: cp.Vector, increment: Swing, no_step: Array | None = None) -> cp.Vector:
        """e + sine (u x e) + versine ((u . e) u - |u|^2 e), with a correction of the length along the new axis.

        If it pointed elsewhere, errors would grow. For a small rotation also the rounding error is small.
        """
        u, square, sine, versine = increment
        correction = jnp.zeros_like(square) if no_step is None else length_correction(cp.dot(pose, pose), no_step)
        sine, versine = sine + correction * sine, versine + correction * versine
        along, back = versine * cp.dot(u, pose), correction - versine * square
        x, y, z = cp.cross(u, pose)
        change = (
            sine * x + along * u[0] + back * pose[0],
            sine * y + along * u[1] + back * pose[1],
            sine * z + along * u[2] + back * pose[2],
        )
        return cp.add(pose, change)

    @staticmethod
    def rate(pose: cp.Vector, velocity: cp.Vector) -> cp.Vector:
        return cp.cross(velocity, pose)

    @classmethod
    def bathed(cls, exposure: Any, root: Any, momentum: cp.Vector, pose: cp.Vector, noise: cp.Vector) -> cp.Vector:
        if not isinstance(exposure, InSpace):
            return cls.bathed_in_space(exposure, root, momentum, pose, noise)
        pushed = exposure.own.change(root, momentum, noise)
        along = jnp.where(exposure.thin, cp.dot(pose, pushed), jnp.zeros_like(pushed[0]))
        return cp.subtract(pushed, cp.scale(along, pose))

    @classmethod
    def bathed_in_space(
        cls, exposure: Any, root: Any, vector: cp.Vector, pose: cp.Vector, noise: cp.Vector
    ) -> cp.Vector:
        """The change of a vector across the axis, plus the difference along the axis."""
        (lost, _, lost_along), (spread, _, spread_along) = exposure.lost, exposure.spread
        own, pushed = (lost_along - lost) * cp.dot(pose, vector), (spread_along - spread) * cp.dot(pose, noise)
        if root is not None:
            spread, pushed = root * spread, root * pushed
        across = cp.subtract(cp.scale(spread, noise), cp.scale(lost, vector))
        return cp.add(across, cp.scale(pushed - own, pose))

    @staticmethod
    def vector_in(frame: cp.Quaternion, vector: cp.Vector) -> cp.Vector:
        return vector

    @staticmethod
    def to_body(owner: Any, pose: cp.Vector, vector: cp.Vector) -> cp.Vector:
        raise needs_attitude(owner)

    @staticmethod
    def from_body(owner: Any, pose: cp.Vector, vector: Any) -> cp.Vector:
        """NaN if the vector in the body is not along its axis of symmetry."""
        a, b, c = vector
        if not cp.is_traced(vector) and np.any((np.asarray(a) != 0) | (np.asarray(b) != 0)):
            raise ValueError("the state holds only the third axis of the body; for another direction use a RigidState.")
        along = c if isinstance(c, float) else jnp.where((a == 0) & (b == 0), c, jnp.nan)
        return cp.scale(along, pose)

    @staticmethod
    def to_space(owner: Any, pose: cp.Vector, vector: cp.Vector) -> cp.Vector:
        return vector

    @staticmethod
    def spatial_momentum(owner: Any, *arrays: Array) -> Array:
        return arrays[0]


class AxisState(State):
    """The angular momentum and the axis of a body with an axis of symmetry, both in space: six numbers.

    Torques and velocities are also in the space frame. The methods SYMMETRIC[...] and the Runge-Kutta methods support
    this state.

    Attributes:
        momentum: angular momentum pi in the space frame, (..., 3), including the spin, its part along the axis.
        axis: unit vector e along the axis of symmetry, space frame, (..., 3).

    Examples:
        >>> top = ml.AxisState.of(start)
        >>> top.momentum.round(4), top.axis.round(4)  # both in space
        (Array([  0.    , -14.776 ,  47.7668], dtype=float64), Array([ 0.    , -0.2955,  0.9553], dtype=float64))
    """

    momentum: Float[Array, "*batch 3"]
    axis: Float[Array, "*batch 3"]
    body: ClassVar[type] = SymmetricRotor
    leaves: ClassVar[Leaves] = (Axis,)

    def __init__(self, momentum: Any, axis: Any):
        self.momentum = as_finite("momentum", momentum, (3,))
        self.axis = as_floats("axis", axis, (3,))
        require("axis", self.axis, is_unit, "must be a unit vector", "divide it by its norm.")

    @classmethod
    def from_velocity(cls, body: Any, velocity: Any, *others: Any) -> Any:
        state = super().from_velocity(body, velocity, *others)
        axis, velocity = cp.vector(state.axis), cp.vector(as_floats("velocity", velocity, (3,)))
        spin = cp.dot(axis, velocity)
        if body.along is None and (cp.is_traced(spin) or np.any(abs(np.asarray(spin)) > _NO_SPIN * cp.norm(velocity))):
            raise ValueError("velocity has a part along the axis, the spin. Give SymmetricRotor(moment, along).")
        along = jnp.zeros_like(body.moment) if body.along is None else body.along
        momentum = cp.add(cp.vector(state.momentum), cp.scale((along - body.moment) * spin, axis))
        return cls(cp.pack(momentum), state.axis)

    @classmethod
    def of(cls, state: RigidState) -> "AxisState":
        """The state of a body symmetric about its third axis: R Pi and R e3."""
        e3 = jnp.zeros_like(state.momentum).at[..., 2].set(1)
        return cls(so3.rotate(state.attitude, state.momentum), so3.rotate(state.attitude, e3))

    def with_attitude(self) -> RigidState:
        """A `RigidState` with this momentum and axis; the smallest rotation from z defines its spin angle."""
        x, y, z = cp.vector(self.axis)
        upper = z >= 0
        larger = jnp.sqrt((1 + jnp.abs(z)) / 2)  # the larger of cosine and sine of half the angle
        across = cp.root(x * x + y * y)
        opposite = across == 0  # then about x
        safe = jnp.where(opposite, jnp.ones_like(across), across)
        u, v = jnp.where(opposite, jnp.ones_like(x), -y / safe), jnp.where(opposite, jnp.zeros_like(x), x / safe)
        smaller = across / (2 * larger)
        cosine, sine = jnp.where(upper, larger, smaller), jnp.where(upper, smaller, larger)
        attitude = jnp.stack([cosine, sine * u, sine * v, jnp.zeros_like(x)], axis=-1)
        return RigidState(so3.rotate(so3.conjugate(attitude), self.momentum), attitude)
