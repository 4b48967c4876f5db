"""Which arrays of an ensemble have one row a body, and whether there are as many rows as bodies."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.states import AnyState
from ..model.torques import on_body

_MOST_TRIED = 6  # parameters whose every choice is tried


def count_rows(names: Sequence[str], values: Sequence[Any], rows: Sequence[Any], count: int) -> None:
    """Raises unless every array marked in `rows`, a tree of booleans for each value, has `count` rows."""
    for name, value, marked in zip(names, values, rows, strict=True):
        leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(value, marked))
        for path, leaf in leaves:
            shape = jnp.shape(leaf)
            if not shape or shape[0] != count:
                found = f"{shape[0]} rows" if shape else "no rows"
                raise ValueError(
                    f"{name}{jax.tree_util.keystr(path)} has {found}, but there are {count} bodies in start; give one "
                    "row a body, or one for all."
                )


def torque_rows(torque: Any, axes: Any, body: Any, own_body: bool, start: AnyState, count: int) -> Any:
    """The torque's tree with True for each array that has one row a body.

    Args:
        axes: None, 0, or a prefix of the torque's tree with these. Where it is None throughout, the arrays are those
            which the torque cannot do without: as few as will do, tried on shapes alone.
        body, own_body: the body on which it acts, and whether its arrays have one row a body.

    Raises:
        ValueError: the axes are others, or do not fit the torque; whatever the choice, the torque acts on a number of
            bodies that is not `count`.
    """
    if jax.tree.leaves(axes):
        return _said(torque, axes)
    leaves, structure = jax.tree.flatten(torque)
    able = [i for i, leaf in enumerate(leaves) if eqx.is_array(leaf) and leaf.ndim and leaf.shape[0] == count]
    wanted = start.momentum.shape[1:]
    others = start, jax.tree.map(lambda leaf: _one(leaf, own_body), body)
    alone = _shape(leaves, structure, (), *others)
    for chosen in ((), *_choices(able)):
        if (_shape(leaves, structure, chosen, *others) if chosen else alone) == wanted:
            return structure.unflatten([i in chosen for i in range(len(leaves))])
    if alone is not None and alone[-len(wanted) :] == wanted:
        sizes = sorted({leaf.shape[0] for leaf in leaves if eqx.is_array(leaf) and leaf.ndim})
        raise ValueError(
            f"the torque acts on {alone[0]} bodies at once, from parameters with {' and '.join(map(str, sizes))} rows, "
            f"but there are {count} bodies in start; give one row a body, or one for all."
        )
    return structure.unflatten([False] * len(leaves))


def _said(torque: Any, axes: Any) -> Any:
    prefix = "torque_axes must be None, 0, or a prefix of the torque's tree with these"
    if any(isinstance(axis, bool) or axis != 0 for axis in jax.tree.leaves(axes)):
        raise ValueError(f"{prefix}, got {axes!r}.")

    def marked(axis: Any, part: Any) -> Any:
        return jax.tree.map(lambda leaf: axis == 0 and eqx.is_array(leaf), part)

    try:
        return jax.tree.map(marked, axes, torque, is_leaf=lambda axis: axis is None)
    except ValueError as error:
        raise ValueError(f"{prefix}; it does not fit the torque: {error}") from error


def _one(leaf: Any, row: bool) -> Any:
    """The shape of an array, or of one row of it."""
    return jax.ShapeDtypeStruct(leaf.shape[1:] if row else leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf


def _choices(able: list[int]) -> list[tuple[int, ...]]:
    """Some or all of these, fewest first."""
    some = [c for k in range(1, len(able)) for c in combinations(able, k)] if len(able) <= _MOST_TRIED else []
    return [*some, tuple(able)] if able else []


def _shape(
    leaves: list[Any], structure: Any, chosen: tuple[int, ...], start: AnyState, body: Any
) -> tuple[int, ...] | None:
    """The shape of the torque on one body, called with one row of the leaves chosen; None if it cannot be called so."""
    parts = [_one(leaf, i in chosen) for i, leaf in enumerate(leaves)]
    state = jax.tree.map(lambda leaf: _one(leaf, True), start)
    given = structure.unflatten(parts), state, body
    arrays, rest = eqx.partition(given, lambda x: isinstance(x, jax.ShapeDtypeStruct))

    def called(arrays: Any) -> Any:
        torque, state, body = eqx.combine(arrays, rest)
        return on_body(torque, body)(jnp.zeros((), start.momentum.dtype), state)

    try:
        return getattr(jax.eval_shape(called, arrays), "shape", None)
    except (TypeError, ValueError, IndexError, AttributeError):
        return None  # it cannot take these shapes; if it can take none, the run says why
