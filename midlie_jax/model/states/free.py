"""`FreeState` and `FreeAxisState`: a body that rotates and translates."""

# Static methods of other states are class methods here, because they read the kind of rotation or of the member.
# pyright: reportIncompatibleMethodOverride=false

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, require_finite
from ..._math import components as cp
from ..bath import InBody
from ..free_body import FreeBody, FreeInertia, Momenta, Place
from ..state import AnyState, Described, State
from ..wrench import Wrench
from .axis import AxisState
from .rigid import RigidState


class TravellingState(State[Momenta, Place]):
    """A rotational state with, in the space frame, the linear momentum and the position of the centre of mass.

    Methods apply the rotational state's method and add vector arithmetic.

    Attributes:
        rotation: the class of the rotational state.
        oriented: the name of the field with its pose, shared with that class.
    """

    linear: eqx.AbstractVar[Array]
    position: eqx.AbstractVar[Array]
    body: ClassVar[type] = FreeBody
    momenta: ClassVar[tuple[str, ...]] = ("momentum", "linear")
    rotation: ClassVar[type[AnyState]]  # pyright: ignore[reportIncompatibleVariableOverride]
    oriented: ClassVar[str]

    @classmethod
    def made(cls, turning: Any, linear: Any, position: Any) -> Any:
        made: Any = cls
        return made(turning.momentum, getattr(turning, cls.oriented), linear, position)

    @classmethod
    def belongs_to(cls, body: Any) -> bool:
        return isinstance(body, FreeBody) and cls.rotation.belongs_to(body.body)

    @property
    def turning(self) -> Any:
        """The rotational state, about the centre of mass; unchecked, because a failed run may hold NaN."""
        return self.rotation.unchecked(**{name: getattr(self, name) for name in ("momentum", self.oriented)})

    def parts(self) -> tuple[Momenta, Place]:
        momentum, orientation = self.turning.parts()
        return Momenta(momentum, cp.vector(self.linear)), Place(orientation, cp.vector(self.position))

    @classmethod
    def join(cls, momentum: Momenta, pose: Place) -> Any:
        turning = cls.rotation.join(momentum.angular, pose.orientation)
        return cls.made(turning, cp.pack(momentum.linear), cp.pack(pose.position))

    @classmethod
    def rotate(cls, pose: Place, increment: Place) -> Place:
        orientation = cls.rotation.rotate(pose.orientation, increment.orientation)
        return Place(orientation, cp.add(pose.position, increment.position))

    @classmethod
    def turn(cls, pose: Place, increment: Place, no_step: Array) -> Place:
        orientation = cls.rotation.turn(pose.orientation, increment.orientation, no_step)
        return Place(orientation, cp.add(pose.position, increment.position))

    @classmethod
    def shift(cls, pose: Place, change: Place, no_step: Array) -> Place:
        orientation = cls.rotation.shift(pose.orientation, change.orientation, no_step)
        return Place(orientation, cp.add(pose.position, change.position))

    @classmethod
    def rate(cls, pose: Place, velocity: Momenta) -> Place:
        return Place(cls.rotation.rate(pose.orientation, velocity.angular), velocity.linear)

    @classmethod
    def momentum_rate(cls, momentum: Momenta, velocity: Momenta, force: Momenta) -> Momenta:
        return Momenta(cls.rotation.momentum_rate(momentum.angular, velocity.angular, force.angular), force.linear)

    @classmethod
    def rates(
        cls, inertia: FreeInertia, h: Array, momentum: Momenta, pose: Place, force: Momenta | None
    ) -> tuple[Momenta, Place]:
        torque = None if force is None else force.angular
        angular, orientation = cls.rotation.rates(inertia.rotation, h, momentum.angular, pose.orientation, torque)
        linear = cp.scale(0, momentum.linear) if force is None else cp.scale(h, force.linear)
        return Momenta(angular, linear), Place(orientation, cp.scale(h * inertia.per_mass, momentum.linear))

    @classmethod
    def bathed(cls, exposure: Momenta, root: Any, momentum: Momenta, pose: Place, noise: Momenta) -> Momenta:
        turning, travel = cls.rotation, exposure.linear
        angular = turning.bathed(exposure.angular, root, momentum.angular, pose.orientation, noise.angular)
        if not isinstance(travel, InBody):
            return Momenta(angular, travel.change(root, momentum.linear, noise.linear))
        own = travel.own, root, momentum.linear, pose.orientation, noise.linear
        return Momenta(angular, turning.bathed_in_space(*own))

    @classmethod
    def force_of(cls, value: Any) -> Any:
        """The torque and force of a `Wrench`; an array is a torque without a force."""
        if isinstance(value, Wrench):
            return Momenta(value.torque, value.force)
        return Momenta(value, jnp.zeros_like(value)) if eqx.is_array(value) else value

    @classmethod
    def returned(cls, force: Momenta) -> Wrench:
        return Wrench(force.angular, force.linear)

    @classmethod
    def vector_in(cls, frame: cp.Quaternion, vector: Momenta) -> Momenta:
        """The torque or angular momentum in another body frame; space-frame vectors are unchanged."""
        return Momenta(cls.rotation.vector_in(frame, vector.angular), vector.linear)

    @classmethod
    def pose_in(cls, frame: cp.Quaternion, pose: Place) -> Place:
        return Place(cls.rotation.pose_in(frame, pose.orientation), pose.position)

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        return self.turning.seen_from_body(vector)

    def vertical(self) -> cp.Vector:
        return self.turning.vertical()

    def in_one_frame(self, of_body: Any, of_space: cp.Vector | None = None) -> tuple[Any, Any]:
        return self.turning.in_one_frame(of_body, of_space)

    def to_space(self, vector: cp.Vector) -> cp.Vector:
        return self.turning.to_space(vector)

    def spatial_momentum(self) -> Array:
        return jnp.cross(self.position, self.linear) + self.turning.spatial_momentum()

    def normalised(self) -> Any:
        return self.made(self.turning.normalised(), self.linear, self.position)

    def plus(self, increment: Array) -> Any:
        """The state moved by an increment: first the numbers of the rotation, then six of the translation."""
        turning = self.turning.plus(increment[..., :-6])
        return self.made(turning, self.linear + increment[..., -6:-3], self.position + increment[..., -3:])

    def minus(self, other: Any) -> Array:
        turn = self.turning.minus(other.turning)
        return jnp.concatenate([turn, self.linear - other.linear, self.position - other.position], axis=-1)

    def sizes(self) -> tuple[Array, ...]:
        linear, position = (jnp.sqrt(jnp.sum(x**2)) for x in (self.linear, self.position))
        return *self.turning.sizes(), linear, position

    @classmethod
    def described(cls) -> Described:
        linear = {"long_name": "linear momentum", "units": "mass length time-1", "frame": "space"}
        position = {"long_name": "position of the centre of mass", "units": "length", "frame": "space"}
        travel = {"linear": (("space_axis",), linear), "position": (("space_axis",), position)}
        return cls.rotation.described() | travel


def _checked_travel(linear: Any, position: Any) -> tuple[Array, Array]:
    linear, position = as_floats("linear", linear, (3,)), as_floats("position", position, (3,))
    require_finite("linear", linear)
    require_finite("position", position)
    return linear, position


class FreeState(TravellingState):
    """The state of a rigid body that rotates and translates: thirteen numbers.

    Attributes:
        momentum: angular momentum Pi about the centre of mass, body frame, (..., 3).
        attitude: unit quaternion (w, x, y, z) that takes body components to space components, (..., 4).
        linear: linear momentum p = m v, space frame, (..., 3).
        position: position x of the centre of mass, space frame, (..., 3).

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, or an attitude whose length is not 1 to 1e-3.

    Examples:
        >>> body = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.6]), mass=3.0)
        >>> weight = ml.torques.UniformGravity([0.0, 0.0, -9.81])
        >>> level = [1.0, 0.0, 0.0, 0.0]
        >>> start = ml.FreeState([0.1, 3.0, 0.2], level, linear=[12.0, 0.0, 9.0], position=[0.0, 0.0, 1.5])
        >>> path = ml.integrate("JACOBI[EA]", body, weight, start, dt=0.01, steps=100)
        >>> path.states.position[-1].round(3)
        Array([ 4.   ,  0.   , -0.405], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    attitude: Float[Array, "*batch 4"]
    linear: Float[Array, "*batch 3"]
    position: Float[Array, "*batch 3"]
    rotation: ClassVar[type[AnyState]] = RigidState
    oriented: ClassVar[str] = "attitude"

    def __init__(self, momentum: Any, attitude: Any, linear: Any, position: Any):
        turning = RigidState(momentum, attitude)
        self.momentum, self.attitude = turning.momentum, turning.attitude
        self.linear, self.position = _checked_travel(linear, position)
        self.check_batch()


class FreeAxisState(TravellingState):
    """The state of a symmetric body that rotates and translates, with an axis as its pose: twelve numbers.

    Attributes:
        momentum: angular momentum pi about the centre of mass, space frame, (..., 3).
        axis: unit vector along the axis of symmetry, space frame, (..., 3).
        linear: linear momentum p = m v, space frame, (..., 3).
        position: position x of the centre of mass, space frame, (..., 3).

    Raises:
        ValueError: wrong shapes or dtypes, different leading axes, or an axis whose length is not 1 to 1e-3.

    Examples:
        >>> molecule = ml.FreeBody(ml.Rotor(1.3, along=0.0), mass=28.0)
        >>> start = ml.FreeAxisState(  # without spin: momentum and axis at right angles
        ...     momentum=[0.0, 2.6, 0.0], axis=[1.0, 0.0, 0.0], linear=[0.0, 0.0, 14.0], position=[0.0, 0.0, 0.0]
        ... )
        >>> ml.velocity(molecule, start)
        Array([0. , 0. , 0.5], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    axis: Float[Array, "*batch 3"]
    linear: Float[Array, "*batch 3"]
    position: Float[Array, "*batch 3"]
    rotation: ClassVar[type[AnyState]] = AxisState
    oriented: ClassVar[str] = "axis"

    def __init__(self, momentum: Any, axis: Any, linear: Any, position: Any):
        turning = AxisState(momentum, axis)
        self.momentum, self.axis = turning.momentum, turning.axis
        self.linear, self.position = _checked_travel(linear, position)
        self.check_batch()

    @classmethod
    def of(cls, state: FreeState) -> "FreeAxisState":
        """The state of a body symmetric about its third axis."""
        return cls.made(AxisState.of(state.turning), state.linear, state.position)

    def with_attitude(self) -> FreeState:
        """A `FreeState` with this momentum, axis and position; for its spin angle see `AxisState.with_attitude`."""
        return FreeState.made(self.turning.with_attitude(), self.linear, self.position)
