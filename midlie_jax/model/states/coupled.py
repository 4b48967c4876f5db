"""States of N coupled bodies, with an axis (N,) before the last one, under one torque function of all."""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from ..._checks.arguments import described
from ..._math import components as cp
from ..._xla import budgets
from ..._xla.apart import apart
from ..._xla.fusion import split
from ..._xla.replay import Traits
from ..kind import Kind, Unrolled
from ..leaf import Described
from ..state import State
from .free import FreeAxisState, FreeState
from .rigid import RigidState
from .unit_vector import AxisState


class SideBySide(Kind):
    several: ClassVar[bool] = True
    apart: ClassVar[bool] = True

    def check_shapes(self, shapes: dict[str, tuple[int, ...]]) -> None:
        for name, shape in shapes.items():
            if len(shape) < 2 or not shape[-2]:
                own = sum(shape[-1:])
                raise ValueError(
                    f"{name} must be (..., N, {own}) for N bodies, got {shape}; for one body use a "
                    f"{self.of.member().__name__}."
                )
        super().check_shapes(shapes)
        counts = {name: shape[-2] for name, shape in shapes.items()}
        if len(set(counts.values())) > 1:
            raise ValueError(f"the arrays must have one number N of bodies, got {counts}.")

    def batch_of(self, body: Any) -> tuple[int, ...]:
        return body.batch[:-1]

    def of_run(self, state: Any, torque: Traits | None) -> Kind:
        short = torque is None or (torque.on_scalars and torque.scalars <= budgets.UNROLLED_OPERATIONS)
        return Unrolled(self.of, self.leaves, state.count) if state.count <= budgets.UNROLLED_BODIES and short else self

    def evaluate(self, function: Callable[[Any, Any], Any], t: Array, momentum: Any, pose: Any) -> tuple[Any, Any]:
        # If stacked directly, the preceding flight and its parts would be repeated for each number of the arrays.
        state = self.join(*split((momentum, pose)))
        value = apart(lambda t, state: jax.tree.map(jnp.asarray, function(t, state)), t, state)
        entries = jax.tree.map(lambda x: cp.unpacked(x) if x.ndim else (x,), value)
        return entries, jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), value)


class Coupled(State):
    """Common part of the states of coupled bodies, mixed into a one-body state: `class Pairs(Coupled, RigidState)`.

    Each array has an axis (N,) for the bodies before its last axis; a ValueError is raised for different numbers N.
    """

    own_axes: ClassVar[int] = 2

    @classmethod
    def member(cls) -> type[Any]:
        """The class of the state of one body."""
        return cls.__mro__[cls.__mro__.index(Coupled) + 1]

    @property
    def kind(self) -> Kind:
        return SideBySide(type(self), self.leaves)

    @property
    def count(self) -> int:
        """The number N of bodies."""
        return self.momentum.shape[-2]

    @classmethod
    def of_bodies(cls, bodies: Any) -> Any:
        """The state of N bodies, from their states as one batch, such as a `FreeState` with arrays (..., N, 3)."""
        wanted, made = cls.member(), cls
        if type(bodies) is not wanted:
            raise ValueError(f"bodies must be a {wanted.__name__} with arrays (..., N, 3), got {described(bodies)}.")
        return made(*(getattr(bodies, name) for name in cls.described()))

    def of_body(self, i: Any) -> Any:
        """The state of body i alone, such as a `FreeState`; for slice(None), the states of all bodies as a batch."""
        return self.member().unchecked(**{name: getattr(self, name)[..., i, :] for name in self.described()})

    @property
    def _pose(self) -> Any:
        raise ValueError("this torque acts on one body; for coupled bodies use midlie_jax.torques.OnEach(torque).")

    def spatial_momentum(self) -> Array:
        return jnp.sum(super().spatial_momentum(), axis=-2)

    def plus(self, increment: Array) -> Any:
        """The state moved by an increment (..., k N): k numbers per body, body after body."""
        return super().plus(increment.reshape(*increment.shape[:-1], self.count, -1))

    def minus(self, other: Any) -> Array:
        increment = super().minus(other)
        return increment.reshape(*increment.shape[:-2], -1)

    @classmethod
    def described(cls) -> dict[str, Described]:
        return {name: (("member", *axes), about) for name, (axes, about) in super().described().items()}


class CoupledState(Coupled, FreeState):
    """N coupled rigid bodies that rotate and translate: 13 N numbers.

    The arrays are as for `FreeState`, (..., N, 3) and (..., N, 4). One function returns the wrenches on all bodies,
    `torque(t, state) -> Wrench((N, 3), (N, 3))`, or `midlie_jax.torques.FromPotential` holds a potential energy. The
    body is a `FreeBody` with moments (N, 3) and masses (N,), or one for all.

    Examples:
        >>> still, upright = jnp.zeros((2, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1))
        >>> places = jnp.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
        >>> start = ml.CoupledState(still, upright, linear=still, position=places)
        >>> body, gravity = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.5]), mass=4.0), ml.asteroids.MutualGravity(1.0)
        >>> ml.observe.energy(body, gravity, start).round(2)  # -4 x 4 / 10
        Array(-1.61, dtype=float64)
    """

    def __init__(self, momentum: Any, attitude: Any, linear: Any, position: Any):
        FreeState.__init__(self, momentum, attitude, linear, position)


class CoupledRigidState(Coupled, RigidState):
    """N coupled rigid bodies that rotate, each about a fixed point: 7 N numbers.

    The arrays are as for `RigidState`, (..., N, 3) and (..., N, 4). The function returns the torques (N, 3), each in
    the frame of its body. The body is a `RigidBody` with moments (N, 3), or one for all.

    Examples:
        >>> def spring(t, state):
        ...     tips = ml.so3.to_matrix(state.attitude)[:, :, 2]  # the third axis of each, in space
        ...     return jnp.sum((tips[1] - tips[0]) ** 2)
        >>> tops = ml.CoupledRigidState(jnp.full((2, 3), 0.5), jnp.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.6, 0.0, 0.0]]))
        >>> ml.observe.energy(ml.RigidBody([1.0, 1.0, 0.5]), ml.torques.FromPotential(spring), tops).round(4)
        Array(2.44, dtype=float64)
    """

    def __init__(self, momentum: Any, attitude: Any):
        RigidState.__init__(self, momentum, attitude)


class CoupledAxisState(Coupled, AxisState):
    """N coupled symmetric bodies that rotate, each about a fixed point, such as dipoles: 6 N numbers.

    The arrays are as for `AxisState`, (..., N, 3). The function returns the torques (N, 3) in the space frame. The body
    is a `SymmetricRotor` with moments (N,), or one for all.

    Examples:
        >>> def align(t, state):
        ...     return -jnp.sum(state.axis[1:] * state.axis[:-1])  # of neighbours
        >>> chain = ml.CoupledAxisState(jnp.zeros((4, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0]), (4, 1)))
        >>> ml.observe.energy(ml.SymmetricRotor(1.0), ml.torques.FromPotential(align), chain)
        Array(-3., dtype=float64)
    """

    def __init__(self, momentum: Any, axis: Any):
        AxisState.__init__(self, momentum, axis)


class CoupledFreeAxisState(Coupled, FreeAxisState):
    """N coupled symmetric bodies that rotate and translate, such as linear molecules: 12 N numbers.

    The arrays are as for `FreeAxisState`, (..., N, 3). The function returns a `Wrench` of torques and forces (N, 3),
    both in the space frame. The body is a `FreeBody` of a `SymmetricRotor`, with moments and masses () or (N,).

    Examples:
        >>> still, axes = jnp.zeros((2, 3)), jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        >>> pair = ml.CoupledFreeAxisState(still, axes, linear=still, position=jnp.array([[0.0] * 3, [0.0, 0.0, 3.0]]))
        >>> ml.molecules.sites(pair, [[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]])[1]  # two atoms of the second body
        Array([[ 0. , -0.5,  3. ],
               [ 0. ,  0.5,  3. ]], dtype=float64)
    """

    def __init__(self, momentum: Any, axis: Any, linear: Any, position: Any):
        FreeAxisState.__init__(self, momentum, axis, linear, position)
