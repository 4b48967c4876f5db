"""Decides for `ensemble` which arrays have one row per body, and checks the number of rows.

For body, start, dt and t0 the number of axes decides. For a torque's parameters it cannot: with three bodies, (3,) may
be one shared vector or one number per body. Every reading is therefore tried on shapes, and if several work, the caller
must choose.
"""

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations, islice
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.free_body import Momenta
from ..model.state import AnyState
from ..model.torques import on_body
from ..model.torques.reads_body import WithBath

AUTO = "auto"
RULE = (
    'torque_axes must be "auto", None (all bodies share every parameter), 0 (every parameter has one row for each '
    "body), the names of the parameters with rows, or a tree like the torque's with leaves 0 and None"
)
_MOST_TRIED = 8  # arrays up to which every subset is tried: 2^8 readings take about a second, once
_KEPT = 64  # decisions remembered


def count_rows(names: Sequence[str], values: Sequence[Any], rows: Sequence[Any], count: int) -> None:
    """Raises unless every marked array has `count` rows; `rows` holds a tree of boolean marks for each value."""
    for name, value, marked in zip(names, values, rows, strict=True):
        if isinstance(value, WithBath):
            count_rows((name, "bath"), (value.torque, value.bath), (marked.torque, marked.bath), count)
            continue
        leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(value, marked))
        for path, leaf in leaves:
            shape = jnp.shape(leaf)
            if not shape or shape[0] != count:
                size = f"{shape[0]} rows" if shape else "no rows"
                raise ValueError(
                    f"{name}{jax.tree_util.keystr(path)} has {size}, but there are {count} bodies in start; give it "
                    "one row for each body, or one value for all."
                )


def torque_rows(torque: Any, axes: Any, body: Any, own_body: bool, start: AnyState, count: int) -> Any:
    """The torque's tree with True for each array with one row per body.

    For "auto" every set of arrays of length `count` is tried, evaluating only shapes. The only set for which the torque
    has the shape of one body's momentum is returned. Otherwise `RULE` applies. Raises a ValueError if several readings
    work or none does, if `axes` does not fit the torque, or if the torque does not act on one body in this reading.
    """
    others = _Shapes.of(start, rows=True), _Shapes.of(body, rows=own_body)
    shapes = _Shapes.of(torque)
    if isinstance(axes, str) and axes == AUTO:
        try:
            chosen = _only_reading(shapes, others, count)
        except TypeError:  # a part of the torque has no hash, so the decision cannot be cached
            chosen = _only_reading.__wrapped__(shapes, others, count)
    else:
        chosen = _marked_by_axes(torque, axes)
        count_rows(("torque",), (torque,), (_marks(torque, chosen),), count)
        if chosen:
            _require_one_torque(shapes, chosen, others)
    return _marks(torque, chosen)


class _Shapes(NamedTuple):
    """A tree with shapes instead of arrays: the key of cached decisions, which depend on shapes alone."""

    leaves: tuple[Any, ...]
    structure: Any

    @classmethod
    def of(cls, tree: Any, rows: bool = False) -> "_Shapes":
        leaves, structure = jax.tree.flatten(tree)
        return cls(tuple(_array_or_row(leaf, rows) for leaf in leaves), structure)

    @property
    def names(self) -> list[str]:
        return [name for name, _ in _named_leaves(self.structure.unflatten(self.leaves))]

    def listed(self, chosen: Sequence[int]) -> str:
        """For messages: the names and shapes of these leaves."""
        names = self.names
        return ", ".join(f"{names[i]} {self.leaves[i].shape}" for i in chosen)

    def call(self, chosen: tuple[int, ...]) -> str:
        """For messages: the argument `torque_axes` for which these leaves of a torque have rows."""
        if not chosen:
            return "torque_axes=None"
        if set(chosen) == {i for i, leaf in enumerate(self.leaves) if _is_array(leaf)}:
            return "torque_axes=0"
        names = self.names
        return f"torque_axes={[names[i] for i in chosen]}"


def _array_or_row(leaf: Any, row: bool) -> Any:
    """The shape and dtype of an array, or of one of its rows; other objects are unchanged."""
    return jax.ShapeDtypeStruct(leaf.shape[1:] if row else leaf.shape, leaf.dtype) if _is_array(leaf) else leaf


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.ShapeDtypeStruct) or eqx.is_array(leaf)


def _marks(torque: Any, chosen: tuple[int, ...]) -> Any:
    leaves, structure = jax.tree.flatten(torque)
    return structure.unflatten([i in chosen for i in range(len(leaves))])


@lru_cache(maxsize=_KEPT)
def _only_reading(torque: _Shapes, others: tuple[_Shapes, ...], count: int) -> tuple[int, ...]:
    """The indices of the leaves with rows, in the only reading that works."""
    leaves = torque.leaves
    candidates = [i for i, leaf in enumerate(leaves) if _is_array(leaf) and leaf.shape and leaf.shape[0] == count]
    if len(candidates) > _MOST_TRIED:
        raise ValueError(
            f"{len(candidates)} parameters of the torque have {count} rows, and so many are not read in every way: "
            f"{torque.listed(candidates)}. If each of them has one row for each body, write "
            f"{torque.call(tuple(candidates))}; if all bodies share them, write {torque.call(())}."
        )
    wanted = others[0].leaves[0].shape  # of one body's momentum, the first array of a state
    subsets = (chosen for size in range(len(candidates) + 1) for chosen in combinations(candidates, size))
    found = list(islice((chosen for chosen in subsets if _torque_shape(torque, chosen, others) == wanted), 2))
    if len(found) > 1:
        raise ValueError(_ambiguous(torque, found, count))
    if not found:
        _refuse(torque, candidates, others, count)
    return found[0] if found else ()


def _torque_shape(torque: _Shapes, chosen: tuple[int, ...], others: tuple[_Shapes, ...]) -> tuple[int, ...] | None:
    """The shape of the torque on one body, with one row of each leaf in `chosen`; None if the torque raises."""
    try:
        return getattr(_evaluated(torque, chosen, others), "shape", None)
    except (TypeError, ValueError, IndexError, AttributeError):
        return None


def _evaluated(torque: _Shapes, chosen: tuple[int, ...], others: tuple[_Shapes, ...]) -> Any:
    parts = torque.structure.unflatten([_array_or_row(leaf, i in chosen) for i, leaf in enumerate(torque.leaves)])
    arguments = parts, *(other.structure.unflatten(other.leaves) for other in others)
    arrays, rest = eqx.partition(arguments, _is_array)

    def evaluated(arrays: Any) -> Any:
        torque, state, body = eqx.combine(arrays, rest)
        force = state.kind.force_of(on_body(torque, body)(jnp.zeros((), state.momentum.dtype), state))
        return force.angular if isinstance(force, Momenta) else force

    return jax.eval_shape(evaluated, arrays)


def _refuse(torque: _Shapes, candidates: list[int], others: tuple[_Shapes, ...], count: int) -> None:
    """Raises if the torque acts on several bodies at once; the run reports other mistakes in a torque."""
    momentum = others[0].leaves[0].shape
    shape = _torque_shape(torque, (), others)
    if shape is None or shape == momentum or shape[-len(momentum) :] != momentum:
        return
    with_rows = candidates or [i for i, leaf in enumerate(torque.leaves) if _is_array(leaf) and leaf.shape]
    listed = f", from its parameters {torque.listed(with_rows)}" if with_rows else ""
    raise ValueError(
        f"the torque on one body has shape {shape} instead of {momentum}{listed}; there are {count} bodies in start: "
        "give a parameter one row for each body, or one value for all."
    )


def _ambiguous(torque: _Shapes, found: list[tuple[int, ...]], count: int) -> str:
    differing = sorted(set(found[0]) ^ set(found[1]))
    return (
        f"there are {count} bodies in start, and the torque can be read in two ways: {torque.listed(differing)} may "
        f"be one value for all bodies or one row for each. Write {torque.call(found[0])}, or {torque.call(found[1])}: "
        "None means that all bodies share every parameter, 0 that every parameter has rows, and names say which have."
    )


def _named_leaves(torque: Any) -> list[tuple[str, Any]]:
    """The leaves of a torque by name; the names of a bath begin with `bath.`."""
    own = ".torque" if isinstance(torque, WithBath) else ""
    leaves = jax.tree_util.tree_leaves_with_path(torque)
    return [(jax.tree_util.keystr(path).removeprefix(own).removeprefix("."), leaf) for path, leaf in leaves]


def _marked_by_axes(torque: Any, axes: Any) -> tuple[int, ...]:
    names = [axes] if isinstance(axes, str) else axes
    if isinstance(names, (list, tuple)) and names and all(isinstance(name, str) for name in names):
        return _named(torque, names)
    if isinstance(torque, WithBath) and isinstance(axes, tuple) and len(axes) == 2:
        axes = WithBath(*axes)
    if any(isinstance(axis, bool) or axis != 0 for axis in jax.tree.leaves(axes)):
        raise ValueError(f"{RULE}; got {axes!r}.")

    def marked(axis: Any, part: Any) -> Any:
        return jax.tree.map(lambda leaf: axis == 0 and eqx.is_array(leaf), part)

    try:
        marks = jax.tree.map(marked, axes, torque, is_leaf=lambda axis: axis is None)
    except ValueError as error:
        raise ValueError(f"{RULE}; it does not fit the torque: {error}") from error
    return tuple(i for i, mark in enumerate(jax.tree.leaves(marks)) if mark)


def _named(torque: Any, names: Sequence[str]) -> tuple[int, ...]:
    known = {name: i for i, (name, leaf) in enumerate(_named_leaves(torque)) if eqx.is_array(leaf)}
    for name in names:
        if name not in known:
            raise ValueError(
                f"torque_axes names {name!r}, but the torque's parameters are {', '.join(known) or 'none'}."
            )
    return tuple(sorted(known[name] for name in names))


def _require_one_torque(torque: _Shapes, chosen: tuple[int, ...], others: tuple[_Shapes, ...]) -> None:
    """Raises if the torque does not act on one body when the arrays in `chosen` have one row per body."""
    wanted = others[0].leaves[0].shape
    names = torque.names
    read = ", ".join(f"{names[i]} {torque.leaves[i].shape[1:]}" for i in chosen)
    try:
        shape = getattr(_evaluated(torque, chosen, others), "shape", None)
    except (TypeError, ValueError, IndexError, AttributeError) as error:
        raise ValueError(
            f"with these torque_axes one body gets {read}, and the torque cannot use that: {error}; name only the "
            "parameters that have one row for each body, as in torque_axes=['weight']."
        ) from error
    if shape != wanted:
        raise ValueError(
            f"with these torque_axes one body gets {read}, and its torque has shape {shape} instead of {wanted}; name "
            "only the parameters that have one row for each body, as in torque_axes=['weight']."
        )
