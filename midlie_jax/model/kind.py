"""`Kind`: how a run moves the states of a class, written once for all products of leaves; `Unrolled`, for a few coupled
bodies.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from functools import reduce
from itertools import chain, islice, repeat
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._checks.arguments import same_batch
from .._math import components as cp
from .._xla.replay import Packed, Traits, by_components
from .exposure import InBody
from .free_body import Momenta, Place, Wrench
from .leaf import Leaf

Leaves = tuple[type[Leaf], ...]


@dataclass(frozen=True)
class Kind:
    """The arithmetic of momentum and pose in a run: of the only leaf, or of a rotation and a translation.

    With two leaves, momenta, velocities and forces are a `Momenta`, poses and increments a `Place`.

    Attributes:
        several: whether momentum and pose hold coupled bodies.
        apart: whether a torque is evaluated on arrays and compiled separately from the step.
        constant_steps: for states that only drivers with constant steps move, what they hold, such as "spins".
    """

    of: type[Any]
    leaves: Leaves
    several: ClassVar[bool] = False
    apart: ClassVar[bool] = False
    constant_steps: ClassVar[str | None] = None

    @property
    def has_pose(self) -> bool:
        return any(leaf.has_pose for leaf in self.leaves)

    @property
    def turns(self) -> bool:
        return all(leaf.turns for leaf in self.leaves)

    @property
    def compensated(self) -> bool:
        return any(leaf.compensated for leaf in self.leaves)

    @property
    def rotation(self) -> "Kind | None":
        return Kind(self.of, self.leaves[:1]) if len(self.leaves) > 1 else None

    @property
    def momenta(self) -> tuple[str, ...]:
        """The names of the fields that are momenta; reading another field is not friction."""
        return tuple(names[0] for names in by_leaf(self.leaves, [field.name for field in fields(self.of)]))

    def of_run(self, state: Any, torque: Traits | None) -> "Kind":
        return self

    def constants(self, inertia: Any, frame: Any) -> tuple[Any, Any]:
        return inertia, frame

    # Shapes

    def check_shapes(self, shapes: dict[str, tuple[int, ...]]) -> None:
        same_batch(shapes, self.of.own_axes)

    def batch_of(self, body: Any) -> tuple[int, ...]:
        """The sizes of those leading axes of a body that are a batch rather than an axis of coupled bodies."""
        return body.batch

    # Components and arrays

    def parts(self, state: Any) -> tuple[Any, Any]:
        pairs = [(leaf.components(momentum), leaf.pose(*pose)) for leaf, (momentum, *pose) in self._arrays(state)]
        return pairs[0] if len(pairs) == 1 else both(*pairs)

    def join(self, momentum: Any, pose: Any) -> Any:
        return self.of(*self.packed(momentum, pose))

    def packed(self, momentum: Any, pose: Any) -> list[Array]:
        pairs = [(momentum, pose)] if len(self.leaves) == 1 else zip(momentum, pose, strict=True)
        return [x for leaf, pair in zip(self.leaves, pairs, strict=True) for x in leaf.packed(*pair)]

    def components(self, arrays: Any) -> Any:
        return self.leaves[0].components(arrays)

    def of_arrays(self, momentum: Any, pose: Any) -> Any:
        return self.join(*self.components((momentum, pose)))

    def normalised(self, state: Any) -> Any:
        arrays = chain.from_iterable(leaf.normalised(*own) for leaf, own in self._arrays(state))
        return self.of.unchecked(**{field.name: x for field, x in zip(fields(self.of), arrays, strict=True)})

    def sizes(self, difference: Any) -> tuple[Array, ...]:
        return tuple(chain.from_iterable(leaf.sizes(*own) for leaf, own in self._arrays(difference)))

    def _arrays(self, state: Any) -> Iterable[tuple[type[Leaf], tuple[Array, ...]]]:
        return zip(self.leaves, arrays_by_leaf(self.leaves, state), strict=True)

    # Torques

    def evaluate(self, function: Callable[[Any, Any], Any], t: Array, momentum: Any, pose: Any) -> tuple[Any, Any]:
        """The value `function(t, state)` of a function written on states with arrays, evaluated on components: a tuple
        of entries in place of each array; and the shape and dtype of each array.
        """
        entries = cp.wrapped((momentum, pose), Packed)
        return by_components(lambda t, momentum, pose: function(t, self.of_arrays(momentum, pose)), t, *entries)

    def force_of(self, value: Any) -> Any:
        """The value of a torque function as arrays in the form of the momentum; an array is a torque alone."""
        if len(self.leaves) == 1:
            return value
        if isinstance(value, Wrench):
            return Momenta(value.torque, value.force)
        return Momenta(value, jnp.zeros_like(value)) if eqx.is_array(value) else value

    def force_from(self, potential: Callable[[Any], Array], state: Any) -> Any:
        """The torque or force of a potential V(state) -> (), by automatic differentiation, as a torque returns it.

        dV/dt = gradient . rate(pose, velocity) = -torque . velocity: -torque is the transpose of `rate`.
        """
        momentum, pose = self.parts(state)
        gradient = jax.grad(lambda pose: potential(self.join(momentum, pose)))(pose)
        (neg_torque,) = jax.linear_transpose(lambda velocity: self.rate(pose, velocity), momentum)(gradient)
        force = jax.tree.map(jnp.negative, cp.packed(neg_torque))
        return Wrench(force.angular, force.linear) if isinstance(force, Momenta) else force

    # Steps, as for each leaf

    def _map(self, form: Callable[..., Any], function: Callable[..., Any], *trees: Any) -> Any:
        if len(self.leaves) == 1:
            return function(self.leaves[0], *trees)
        parts = zip(*(repeat(None) if tree is None else tree for tree in trees), strict=False)
        return form(*(function(leaf, *own) for leaf, own in zip(self.leaves, parts, strict=True)))

    def act(self, pose: Any, increment: Any, no_step: Array | None = None) -> Any:
        return self._map(Place, lambda leaf, q, own: leaf.act(q, own, no_step), pose, increment)

    def shift(self, pose: Any, change: Any, no_step: Array) -> Any:
        return self._map(Place, lambda leaf, q, change: leaf.shift(q, change, no_step), pose, change)

    def rate(self, pose: Any, velocity: Any) -> Any:
        return self._map(Place, lambda leaf, q, velocity: leaf.rate(q, velocity), pose, velocity)

    def momentum_rate(self, momentum: Any, velocity: Any, force: Any) -> Any:
        return self._map(Momenta, lambda leaf, *own: leaf.momentum_rate(*own), momentum, velocity, force)

    def push(self, momentum: Any, pose: Any, change: Any) -> tuple[Any, Any]:
        return self._map(both, lambda leaf, *own: leaf.push(*own), momentum, pose, change)

    def rates(self, inertia: Any, h: Array, momentum: Any, pose: Any, force: Any) -> tuple[Any, Any]:
        return self._map(both, lambda leaf, own, *more: leaf.rates(own, h, *more), inertia, momentum, pose, force)

    def vector_in(self, frame: Any, vector: Any) -> Any:
        return self._map(Momenta, lambda leaf, own: leaf.vector_in(frame, own), vector)

    def pose_in(self, frame: Any, pose: Any) -> Any:
        return self._map(Place, lambda leaf, own: leaf.pose_in(frame, own), pose)

    def bathed(self, exposure: Any, root: Any, momentum: Any, pose: Any, noise: Any) -> Any:
        """The change of the momentum in a stage of a heat bath; friction of a translation may be in the body frame."""
        turning = self.leaves[0]
        if len(self.leaves) == 1:
            return turning.bathed(exposure, root, momentum, pose, noise)
        angular = turning.bathed(exposure.angular, root, momentum.angular, pose.orientation, noise.angular)
        own, travel = (momentum.linear, noise.linear), exposure.linear
        if isinstance(travel, InBody):
            return Momenta(angular, turning.bathed_in_space(travel.own, root, own[0], pose.orientation, own[1]))
        return Momenta(angular, travel.change(root, *own))


def by_leaf(leaves: Leaves, items: Iterable[Any]) -> Sequence[tuple[Any, ...]]:
    rest = iter(items)
    return [tuple(islice(rest, leaf.arrays)) for leaf in leaves]


def arrays_by_leaf(leaves: Leaves, state: Any) -> Sequence[tuple[Array, ...]]:
    return by_leaf(leaves, [getattr(state, field.name) for field in fields(state)])


def both(*pairs: tuple[Any, Any]) -> tuple[Momenta, Place]:
    (angular, orientation), (linear, position) = pairs
    return Momenta(angular, linear), Place(orientation, position)


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
    """`count` coupled bodies unrolled into scalars in a step, as a tuple with the numbers of one body each.

    The whole step, including the torque function, then compiles to one loop over many replicas, as for a single body.
    """

    count: int
    several: ClassVar[bool] = True

    @property
    def member(self) -> Kind:
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
        nothing = (None,) * self.count
        each = (nothing if tree is None else tree.members if isinstance(tree, Inertias) else tree for tree in trees)
        rows = [Kind._map(self, form, function, *own) for own in zip(*each, strict=True)]
        return tuple(zip(*rows, strict=True)) if form is both else tuple(rows)

    def vector_in(self, frame: Any, vector: Any) -> Any:
        return tuple(map(self.member.vector_in, frame, vector))

    def pose_in(self, frame: Any, pose: Any) -> Any:
        return tuple(map(self.member.pose_in, frame, pose))


def _entry(tree: Any, i: int) -> Any:
    return jax.tree.map(lambda x: x[i] if jnp.ndim(x) else x, tree)
