"""`FreeBody`: a body that also translates, with its momentum and pose in a step; `Wrench`, its load."""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, described
from .._math import components as cp
from . import so3
from .bodies import Body, RigidBody, SymmetricRotor, TensorBody, all_positive, require_possible


class Momenta(NamedTuple):
    """Momentum, velocity or load of a body that translates: in the frame of the rotational state, and in space."""

    angular: Any
    linear: Any


class Place(NamedTuple):
    """Pose of a body that translates: its attitude or axis, and the position of its centre of mass in space."""

    orientation: Any
    position: Any


class Wrench(eqx.Module):
    """A torque in the body frame and a force in the space frame: the value of a torque function for a `FreeState`.

    Wrenches add; an array added to a wrench is a torque. For a `FreeAxisState` the torque is in the space frame.

    Attributes:
        torque: about the centre of mass, body frame, (..., 3).
        force: space frame, (..., 3).

    Examples:
        >>> def engine(t, state):
        ...     force = ml.so3.rotate(state.attitude, jnp.array([0.0, 0.0, 2.0]))
        ...     return ml.torques.Wrench(torque=jnp.zeros(3), force=force)
        >>> engine(0.0, ml.RigidState([0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0])).force[2]  # upside down
        Array(-2., dtype=float64)
    """

    torque: Float[Array, "*batch 3"]
    force: Float[Array, "*batch 3"]
    __array_ufunc__: ClassVar[None] = None  # so that NumPy arrays leave the sum to `__radd__`

    def __init__(self, torque: Any, force: Any):
        self.torque, self.force = as_floats("torque", torque, (3,)), as_floats("force", force, (3,))

    @classmethod
    def of(cls, value: Any) -> "Wrench":
        """A wrench unchanged; an array as a torque without a force."""
        return value if isinstance(value, Wrench) else cls(jnp.asarray(value), jnp.zeros_like(value))

    def __add__(self, other: Any) -> "Wrench":
        other = Wrench.of(other)
        return Wrench(self.torque + other.torque, self.force + other.force)

    __radd__ = __add__


class FreeInertia(NamedTuple):
    rotation: Any
    per_mass: Array

    def velocity(self, momentum: Momenta) -> Momenta:
        return Momenta(self.rotation.velocity(momentum.angular), cp.scale(self.per_mass, momentum.linear))

    def commutator(self, force: Momenta) -> Momenta:
        return Momenta(self.rotation.commutator(force.angular), cp.scale(0, force.linear))

    def square_of_turn(self, h: Any, momentum: Momenta) -> Array:
        return self.rotation.square_of_turn(h, momentum.angular)

    def nutation(self, momentum: Momenta) -> Array:
        return self.rotation.nutation(momentum.angular)


class FreeBody(Body):
    """A body that rotates about its centre of mass and translates.

    Attributes:
        body: the rotating body: a `RigidBody`, a `TensorBody` or a `SymmetricRotor`; otherwise a ValueError.
        mass: its mass, (), or (...) with the batch of the body, positive. One mass serves all bodies of a batch.

    Examples:
        >>> brick = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.6]), mass=3.0)
        >>> brick.momentum(jnp.array([1.0, 1.0, 1.0]))  # of an angular velocity
        Array([1. , 2. , 2.6], dtype=float64)
    """

    body: RigidBody | TensorBody | SymmetricRotor
    mass: Float[Array, "*batch"]

    def __init__(self, body: Any, mass: Any):
        if not isinstance(body, RigidBody | TensorBody | SymmetricRotor):
            raise ValueError(
                f"body must be a midlie_jax.RigidBody, TensorBody or SymmetricRotor, got {described(body)}; "
                "for principal moments write FreeBody(RigidBody(moments), mass)."
            )
        mass = as_floats("mass", mass)
        require_possible("mass", mass, "mass")
        if mass.shape not in ((), body.batch):
            raise ValueError(f"mass must be () or {body.batch}, one for each body, got {mass.shape}.")
        self.body, self.mass = body, jnp.broadcast_to(mass, body.batch)

    def inertia(self) -> FreeInertia:
        return FreeInertia(self.body.inertia(), 1 / self.mass)

    def is_possible(self) -> Array:
        return self.body.is_possible() & all_positive(self.mass)

    def velocity(self, momentum: Any) -> Any:
        """The velocity for a momentum; for an array (..., 3), the angular velocity for an angular momentum."""
        if isinstance(momentum, Momenta):
            return Momenta(
                self.body.velocity(momentum.angular), cp.pack(cp.scale(1 / self.mass, cp.vector(momentum.linear)))
            )
        return self.body.velocity(momentum)

    def momentum(self, velocity: Any) -> Any:
        """The momentum for a velocity; for an array (..., 3), the angular momentum for an angular velocity."""
        if isinstance(velocity, Momenta):
            return Momenta(
                self.body.momentum(velocity.angular), cp.pack(cp.scale(self.mass, cp.vector(velocity.linear)))
            )
        return self.body.momentum(velocity)

    @classmethod
    def joined(cls, parts: Any) -> tuple["FreeBody", Float[Array, "3"]]:
        """The rigid body made of several bodies, by the parallel-axis rule.

        Args:
            parts: a list of (body, mass, position) or (body, mass, position, attitude) in one common frame. `body` is a
                `RigidBody` or `TensorBody` with the moments about its own centre of mass, or None for a point mass.
                `position` (3,) is its centre of mass, `attitude` the quaternion from the part's frame to the common
                frame, by default none. A batch, or another form, is a ValueError.

        Returns:
            The body, a `FreeBody` of a `TensorBody` in the directions of the common frame, and its centre of mass (3,).

        Examples:
            >>> panel = ml.RigidBody([60.0, 4.0, 56.0])
            >>> sides = [(panel, 20.0, [0.0, y, 0.0]) for y in (-2.0, 2.0)]
            >>> satellite, centre = ml.FreeBody.joined([(ml.RigidBody([90.0] * 3), 100.0, [0.0] * 3), *sides])
            >>> np.diag(satellite.body.tensor).round(2), satellite.mass.item()
            (array([370.,  98., 362.]), 140.0)
        """
        parts = [tuple(part) for part in parts]
        if not parts or not {len(part) for part in parts} <= {3, 4}:
            raise ValueError("parts must be one or more (body, mass, position) or (body, mass, position, attitude).")
        tensors, masses, places = zip(*(_part(f"parts[{i}]", *part) for i, part in enumerate(parts)), strict=True)
        mass, place = jnp.stack(masses), jnp.stack(places)
        total = jnp.sum(mass)
        centre = jnp.sum(mass[:, None] * place, axis=0) / total
        arms = place - centre[None, :]
        squares = jnp.sum(arms**2, axis=1)[:, None, None] * jnp.eye(3, dtype=arms.dtype)[None]
        tensor = sum(tensors) + jnp.sum(mass[:, None, None] * (squares - arms[:, :, None] * arms[:, None, :]), axis=0)
        return cls(TensorBody(tensor), total), centre

    @property
    def trace(self) -> Float[Array, "*batch"]:
        """The sum of the three principal moments."""
        return self.body.trace

    @property
    def batch(self) -> tuple[int, ...]:
        return self.body.batch

    @property
    def turning(self) -> Body:
        return self.body

    def in_principal_axes(self) -> "FreeBody":
        principal = self.body.in_principal_axes()
        return self if principal is self.body else FreeBody(principal, self.mass)

    def frame_of_user(self) -> cp.Quaternion | None:
        return self.body.frame_of_user()


def _part(name: str, body: Any, mass: Any, position: Any, attitude: Any = None) -> tuple[Array, Array, Array]:
    mass, position = as_floats(f"{name} mass", mass), as_floats(f"{name} position", position, (3,))
    if mass.shape or position.shape != (3,):
        raise ValueError(f"{name} must have one mass () and one position (3,), got {mass.shape} and {position.shape}.")
    if body is None:
        return jnp.zeros((3, 3), position.dtype), mass, position
    if not isinstance(body, RigidBody | TensorBody) or body.batch:
        raise ValueError(f"{name} must begin with one RigidBody, one TensorBody or None, got {described(body)}.")
    tensor = body.tensor if isinstance(body, TensorBody) else jnp.diag(body.moments)
    if attitude is not None:
        turn = so3.to_matrix(as_floats(f"{name} attitude", attitude, (4,)))
        tensor = turn @ tensor @ turn.T
    return tensor, mass, position
