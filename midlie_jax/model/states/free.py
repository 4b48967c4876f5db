"""`FreeState` and `FreeAxisState`: a body that rotates and translates."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_floats
from ..._math import components as cp
from ..free_body import FreeBody
from ..kind import Leaves
from ..leaf import Described, Leaf
from ..state import State, require_own
from .rigid import RigidState, Rotation
from .unit_vector import Axis, AxisState


class Translation(Leaf):
    about: ClassVar[tuple[Described, ...]] = (
        (("space_axis",), {"long_name": "linear momentum", "units": "mass length time-1", "frame": "space"}),
        (("space_axis",), {"long_name": "position of the centre of mass", "units": "length", "frame": "space"}),
    )

    @classmethod
    def rates(
        cls, inertia: Array, h: Array, momentum: cp.Vector, pose: cp.Vector, force: cp.Vector | None
    ) -> tuple[cp.Vector, cp.Vector]:
        push = cp.scale(0, momentum) if force is None else cp.scale(h, force)
        return push, cp.scale(h * inertia, momentum)

    @staticmethod
    def vector_in(frame: cp.Quaternion, vector: cp.Vector) -> cp.Vector:
        return vector

    @classmethod
    def pose_in(cls, frame: cp.Quaternion, pose: cp.Vector) -> cp.Vector:
        return pose

    @staticmethod
    def sizes(*arrays: Array) -> tuple[Array, ...]:
        linear, position = (jnp.sqrt(jnp.sum(x**2)) for x in arrays)
        return linear, position


class TravellingState(State):
    """A rotational state, of the class `rotation`, with the linear momentum and the position of the centre of mass in
    space.
    """

    linear: eqx.AbstractVar[Array]
    position: eqx.AbstractVar[Array]
    body: ClassVar[type] = FreeBody
    rotation: ClassVar[type[Any]]

    @classmethod
    def made(cls, turning: Any, linear: Any, position: Any) -> Any:
        made: Any = cls
        return made(*(getattr(turning, name) for name in cls.rotation.described()), linear, position)

    @classmethod
    def belongs_to(cls, body: Any) -> bool:
        return isinstance(body, FreeBody) and cls.rotation.belongs_to(body.body)

    @classmethod
    def from_velocity(cls, body: Any, velocity: Any, *others: Any) -> Any:
        orientation, linear, *position = others
        require_own(body, cls)
        rotation = cls.rotation.from_velocity(body.turning, velocity, orientation)
        momentum = jnp.asarray(body.mass)[..., None] * as_floats("linear", linear, (3,))
        made: Any = cls
        return made(rotation.momentum, orientation, momentum, *position)

    @property
    def turning(self) -> Any:
        """The rotational state, about the centre of mass; unchecked, because a failed run may hold NaN."""
        return self.rotation.unchecked(**{name: getattr(self, name) for name in self.rotation.described()})

    def spatial_momentum(self) -> Array:
        return jnp.cross(self.position, self.linear) + super().spatial_momentum()


class FreeState(TravellingState):
    """The state of a rigid body that rotates and translates: thirteen numbers.

    Attributes:
        momentum, attitude: as for `RigidState`, about the centre of mass.
        linear: linear momentum p = m v, space frame, (..., 3).
        position: position x of the centre of mass, space frame, (..., 3).

    Examples:
        >>> body, weight = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.6]), 3.0), ml.torques.UniformGravity([0.0, 0.0, -9.81])
        >>> start = ml.FreeState([0.1, 3.0, 0.2], [1.0, 0.0, 0.0, 0.0], [12.0, 0.0, 9.0], position=[0.0, 0.0, 1.5])
        >>> ml.integrate("JACOBI[EA]", body, weight, start, dt=0.01, steps=100).states.position[-1].round(3)
        Array([ 4.   ,  0.   , -0.405], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    attitude: Float[Array, "*batch 4"]
    linear: Float[Array, "*batch 3"]
    position: Float[Array, "*batch 3"]
    leaves: ClassVar[Leaves] = (Rotation, Translation)
    rotation: ClassVar[type[Any]] = RigidState

    def __init__(self, momentum: Any, attitude: Any, linear: Any, position: Any):
        turning = RigidState(momentum, attitude)
        self.momentum, self.attitude = turning.momentum, turning.attitude
        self.linear, self.position = as_finite("linear", linear, (3,)), as_finite("position", position, (3,))


class FreeAxisState(TravellingState):
    """The state of a symmetric body that rotates and translates, with an axis as its pose: twelve numbers.

    Attributes:
        momentum, axis: as for `AxisState`, about the centre of mass.
        linear, position: as for `FreeState`.

    Examples:
        >>> molecule, still = ml.FreeBody(ml.SymmetricRotor(1.3, along=0.0), mass=28.0), [0.0, 0.0, 0.0]
        >>> start = ml.FreeAxisState([0.0, 2.6, 0.0], axis=[1.0, 0.0, 0.0], linear=[0.0, 0.0, 14.0], position=still)
        >>> ml.observe.linear_velocity(molecule, start)
        Array([0. , 0. , 0.5], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    axis: Float[Array, "*batch 3"]
    linear: Float[Array, "*batch 3"]
    position: Float[Array, "*batch 3"]
    leaves: ClassVar[Leaves] = (Axis, Translation)
    rotation: ClassVar[type[Any]] = AxisState

    def __init__(self, momentum: Any, axis: Any, linear: Any, position: Any):
        turning = AxisState(momentum, axis)
        self.momentum, self.axis = turning.momentum, turning.axis
        self.linear, self.position = as_finite("linear", linear, (3,)), as_finite("position", position, (3,))

    @classmethod
    def of(cls, state: FreeState) -> "FreeAxisState":
        """The state of a body symmetric about its third axis."""
        return cls.made(AxisState.of(state.turning), state.linear, state.position)

    def with_attitude(self) -> FreeState:
        """A `FreeState` with this momentum, axis and position; for its spin angle see `AxisState.with_attitude`."""
        return FreeState.made(self.turning.with_attitude(), self.linear, self.position)
