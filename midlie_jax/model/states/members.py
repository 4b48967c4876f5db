"""`Unrolled`: `count` coupled bodies unrolled into scalars in a step, as a tuple with the numbers of one body each.

The whole step, including the torque function, then compiles to one loop over many replicas, as for a single body.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._xla.replay import Packed, by_components
from ..kind import Kind, both


class Inertias(NamedTuple):
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


@dataclass(frozen=True)
class Unrolled(Kind):
    count: int
    several: ClassVar[bool] = True

    @property
    def member(self) -> Kind:
        """The kind of one body; its states are not made."""
        return Kind(self.of, self.leaves)

    @property
    def turns(self) -> bool:
        return False

    @property
    def rotation(self) -> None:
        return None

    def constants(self, inertia: Any, frame: Any) -> tuple[Any, Any]:
        each = range(self.count)
        frames = None if frame is None else tuple(_entry(frame, i) for i in each)
        return Inertias(tuple(_entry(inertia, i) for i in each)), frames

    def parts(self, state: Any) -> tuple[Any, Any]:
        parts = [state.of_body(i).parts() for i in range(self.count)]
        return tuple(momentum for momentum, _ in parts), tuple(pose for _, pose in parts)

    def packed(self, momentum: Any, pose: Any) -> list[Array]:
        rows = [self.member.packed(*own) for own in zip(momentum, pose, strict=True)]
        return [jnp.stack(column, axis=-2) for column in zip(*rows, strict=True)]

    def evaluate(self, function: Callable[[Any, Any], Any], t: Array, momentum: Any, pose: Any) -> tuple[Any, Any]:
        entries = cp.wrapped((momentum, pose), Packed)
        return by_components(lambda t, p, q: function(t, self.of_arrays(p, q)), t, *entries, on_scalars=True)

    def force_of(self, value: Any) -> Any:
        force = super().force_of(value)
        leaves = jax.tree.leaves(force)
        if any(jnp.ndim(leaf) != 2 for leaf in leaves) or len({len(leaf) for leaf in leaves}) != 1:
            return force  # of a wrong form, which a run rejects
        return tuple(jax.tree.map(lambda x, i=i: x[i], force) for i in range(len(leaves[0])))

    def _map(self, form: Callable[..., Any], function: Callable[..., Any], *trees: Any) -> Any:
        rows = [Kind._map(self, form, function, *own) for own in _each(self.count, trees)]
        return tuple(zip(*rows, strict=True)) if form is both else tuple(rows)

    def vector_in(self, frame: Any, vector: Any) -> Any:
        return tuple(map(self.member.vector_in, frame, vector))

    def pose_in(self, frame: Any, pose: Any) -> Any:
        return tuple(map(self.member.pose_in, frame, pose))


def _each(count: int, trees: tuple[Any, ...]) -> Any:
    nothing = (None,) * count
    columns = (nothing if tree is None else tree.members if isinstance(tree, Inertias) else tree for tree in trees)
    return zip(*columns, strict=True)


def _entry(tree: Any, i: int) -> Any:
    """The entry of one body in a tree of numbers (N,), or of single numbers that serve every body."""
    return jax.tree.map(lambda x: x[i] if jnp.ndim(x) else x, tree)
