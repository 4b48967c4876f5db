"""For `ensemble`: decides which arrays have one row for each body, and checks the number of rows."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.state import AnyState
from ..model.torques import on_body

_MOST_TRIED = 6  # with more parameters than this, not every subset is tried


def count_rows(names: Sequence[str], values: Sequence[Any], rows: Sequence[Any], count: int) -> None:
    """Raises unless every marked array has `count` rows; `rows` holds for each value a tree of booleans, the marks."""
    for name, value, marked in zip(names, values, rows, strict=True):
        leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(value, marked))
        for path, leaf in leaves:
            shape = jnp.shape(leaf)
            if not shape or shape[0] != count:
                size = f"{shape[0]} rows" if shape else "no rows"
                raise ValueError(
                    f"{name}{jax.tree_util.keystr(path)} has {size}, but there are {count} bodies in start; give one "
                    "row a body, or one for all."
                )


def torque_rows(torque: Any, axes: Any, body: Any, own_body: bool, start: AnyState, count: int) -> Any:
    """The torque's tree with True for each array that has one row for each body.

    Args:
        axes: None, 0, or a prefix of the torque's tree with leaves None and 0. If it contains no 0, the smallest set of
            arrays is chosen with which the torque has the shape of one body's momentum; only shapes are evaluated.
        body, own_body: the body on which the torque acts, and whether its arrays have one row for each body.

    Raises:
        ValueError: `axes` has other leaves, or does not fit the torque; or no choice fits and the torque acts on a
            number of bodies that is not `count`.
    """
    if jax.tree.leaves(axes):
        return _marked_by_axes(torque, axes)
    leaves, structure = jax.tree.flatten(torque)
    candidates = [i for i, leaf in enumerate(leaves) if eqx.is_array(leaf) and leaf.ndim and leaf.shape[0] == count]
    wanted = start.momentum.shape[1:]
    others = start, jax.tree.map(lambda leaf: _array_or_row(leaf, own_body), body)
    all_shared = _torque_shape(leaves, structure, (), *others)
    for chosen in ((), *_choices(candidates)):
        if (_torque_shape(leaves, structure, chosen, *others) if chosen else all_shared) == wanted:
            return structure.unflatten([i in chosen for i in range(len(leaves))])
    if all_shared is not None and all_shared[-len(wanted) :] == wanted:
        sizes = sorted({leaf.shape[0] for leaf in leaves if eqx.is_array(leaf) and leaf.ndim})
        raise ValueError(
            f"the torque acts on {all_shared[0]} bodies at once, from parameters with {' and '.join(map(str, sizes))} "
            f"rows, but there are {count} bodies in start; give one row a body, or one for all."
        )
    return structure.unflatten([False] * len(leaves))


def _marked_by_axes(torque: Any, axes: Any) -> Any:
    """The torque's tree with True for each array whose axis in `axes` is 0."""
    rule = "torque_axes must be None, 0, or a prefix of the torque's tree with leaves None and 0"
    if any(isinstance(axis, bool) or axis != 0 for axis in jax.tree.leaves(axes)):
        raise ValueError(f"{rule}, got {axes!r}.")

    def marked(axis: Any, part: Any) -> Any:
        return jax.tree.map(lambda leaf: axis == 0 and eqx.is_array(leaf), part)

    try:
        return jax.tree.map(marked, axes, torque, is_leaf=lambda axis: axis is None)
    except ValueError as error:
        raise ValueError(f"{rule}; it does not fit the torque: {error}") from error


def _array_or_row(leaf: Any, row: bool) -> Any:
    """The shape and dtype of an array, or of one of its rows; anything else unchanged."""
    return jax.ShapeDtypeStruct(leaf.shape[1:] if row else leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf


def _choices(candidates: list[int]) -> list[tuple[int, ...]]:
    """All nonempty subsets, the smallest first; only the full set if there are many candidates."""
    few = len(candidates) <= _MOST_TRIED
    some = [c for k in range(1, len(candidates)) for c in combinations(candidates, k)] if few else []
    return [*some, tuple(candidates)] if candidates else []


def _torque_shape(
    leaves: list[Any], structure: Any, chosen: tuple[int, ...], start: AnyState, body: Any
) -> tuple[int, ...] | None:
    """The shape of the torque on one body, with one row of each leaf in `chosen`; None if the torque refuses shapes."""
    parts = [_array_or_row(leaf, i in chosen) for i, leaf in enumerate(leaves)]
    state = jax.tree.map(lambda leaf: _array_or_row(leaf, True), start)
    arguments = structure.unflatten(parts), state, body
    arrays, rest = eqx.partition(arguments, lambda x: isinstance(x, jax.ShapeDtypeStruct))

    def evaluated(arrays: Any) -> Any:
        torque, state, body = eqx.combine(arrays, rest)
        return on_body(torque, body)(jnp.zeros((), start.momentum.dtype), state)

    try:
        return getattr(jax.eval_shape(evaluated, arrays), "shape", None)
    except (TypeError, ValueError, IndexError, AttributeError):
        return None  # the torque does not accept these shapes; if it accepts none, the run raises its error
