"""`Members`: a few coupled bodies unrolled into scalars in a step, as a tuple with the numbers of one body each.

The whole step, including the torque function, is then written on scalars and compiles to one loop over many replicas,
as for a single body. Every method applies the method of the one-body state to each body.
"""

# Static methods of other states are class methods here, because they read the kind of rotation or of the member.
# pyright: reportIncompatibleMethodOverride=false

from collections.abc import Callable
from functools import reduce
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._xla.replay import Packed, by_components
from ..state import State

MEMBERS_MOST = 3  # bodies unrolled into scalars; four are faster side by side
OPERATIONS_MOST = 2500  # scalar operations of the torque function; more take over ten seconds to compile


class Inertias(NamedTuple):
    """Constants of a run of several bodies.

    Attributes:
        members: the constants of each body.
    """

    members: tuple[Any, ...]

    def velocity(self, momentum: Any) -> Any:
        return self._each("velocity", momentum)

    def commutator(self, force: Any) -> Any:
        return self._each("commutator", force)

    def square_of_turn(self, h: Any, momentum: Any) -> Array:
        return reduce(jnp.maximum, [own.square_of_turn(h, p) for own, p in zip(self.members, momentum, strict=True)])

    def nutation(self, momentum: Any) -> Array:
        return reduce(jnp.maximum, self._each("nutation", momentum))

    def _each(self, name: str, vector: Any) -> Any:
        return tuple(getattr(own, name)(v) for own, v in zip(self.members, vector, strict=True))


class Members(State[Any, Any]):
    """Coupled bodies unrolled into scalars; the class is never instantiated.

    Attributes:
        whole: the public class of the states of all bodies.
        member: the class of the state of one body.
    """

    own_axes: ClassVar[int] = 2
    several: ClassVar[bool] = True
    whole: ClassVar[Any]
    member: ClassVar[Any]

    @classmethod
    def parts_of(cls, state: Any) -> tuple[Any, Any]:
        parts = [state.of_body(i).parts() for i in range(state.count)]
        return tuple(momentum for momentum, _ in parts), tuple(pose for _, pose in parts)

    @classmethod
    def join(cls, momentum: Any, pose: Any) -> Any:
        rows = [cls.member.join(p, q) for p, q in zip(momentum, pose, strict=True)]
        arrays = [jnp.stack([getattr(row, name) for row in rows], axis=-2) for name in cls.member.described()]
        return cls.whole(*arrays)

    @classmethod
    def each_inertia(cls, inertia: Any, state: Any) -> Inertias:
        """The constants of each body, from constants that have an axis (N,) or serve every body."""
        return Inertias(tuple(_entry(inertia, i) for i in range(state.count)))

    @classmethod
    def each_frame(cls, frame: Any, state: Any) -> Any:
        return None if frame is None else tuple(_entry(frame, i) for i in range(state.count))

    @classmethod
    def rotate(cls, pose: Any, increment: Any) -> Any:
        return _map(cls.member.rotate, pose, increment)

    @classmethod
    def turn(cls, pose: Any, increment: Any, no_step: Array) -> Any:
        return _map(lambda q, turn: cls.member.turn(q, turn, no_step), pose, increment)

    @classmethod
    def rate(cls, pose: Any, velocity: Any) -> Any:
        return _map(cls.member.rate, pose, velocity)

    @classmethod
    def momentum_rate(cls, momentum: Any, velocity: Any, force: Any) -> Any:
        return _map(cls.member.momentum_rate, momentum, velocity, force)

    @classmethod
    def push(cls, momentum: Any, pose: Any, change: Any) -> tuple[Any, Any]:
        pushed = [cls.member.push(*each) for each in zip(momentum, pose, change, strict=True)]
        return tuple(p for p, _ in pushed), tuple(q for _, q in pushed)

    @classmethod
    def shift(cls, pose: Any, change: Any, no_step: Array) -> Any:
        return _map(lambda q, change: cls.member.shift(q, change, no_step), pose, change)

    @classmethod
    def rates(cls, inertia: Inertias, h: Array, momentum: Any, pose: Any, force: Any) -> tuple[Any, Any]:
        forces = (None,) * len(momentum) if force is None else force
        rates = [
            cls.member.rates(own, h, p, q, f)
            for own, p, q, f in zip(inertia.members, momentum, pose, forces, strict=True)
        ]
        return tuple(p for p, _ in rates), tuple(q for _, q in rates)

    @classmethod
    def evaluate(cls, function: Callable[[Any, Any], Any], t: Array, momentum: Any, pose: Any) -> tuple[Any, Any]:
        entries = cp.wrapped((momentum, pose), Packed)
        return by_components(lambda t, p, q: function(t, cls.of_arrays(p, q)), t, *entries, on_scalars=True)

    @classmethod
    def force_of(cls, value: Any) -> Any:
        force = cls.whole.force_of(value)
        leaves = jax.tree.leaves(force)
        if any(jnp.ndim(leaf) != 2 for leaf in leaves) or len({len(leaf) for leaf in leaves}) != 1:
            return force  # of a wrong form, which a run rejects
        return tuple(jax.tree.map(lambda x, i=i: x[i], force) for i in range(len(leaves[0])))

    @classmethod
    def vector_in(cls, frame: Any, vector: Any) -> Any:
        return _map(cls.member.vector_in, frame, vector)

    @classmethod
    def pose_in(cls, frame: Any, pose: Any) -> Any:
        return _map(cls.member.pose_in, frame, pose)


def _map(function: Callable[..., Any], *vectors: Any) -> Any:
    return tuple(function(*each) for each in zip(*vectors, strict=True))


def _entry(tree: Any, i: int) -> Any:
    """The entry of one body in a tree of numbers (N,), or of single numbers that serve every body."""
    return jax.tree.map(lambda x: x[i] if jnp.ndim(x) else x, tree)
