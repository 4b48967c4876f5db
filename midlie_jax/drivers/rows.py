"""Decides for `ensemble` which arrays have one row per body, and checks the number of rows.

For body, start, dt and t0 the number of axes decides. For a torque's parameters it cannot: with three bodies, (3,) may
be one shared vector or one number per body. Every reading is therefore tried on shapes, and if several work, the caller
must choose.
"""

from collections.abc import Sequence
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

    For "auto" every set of arrays of length `count` is tried; the only one for which the torque has the shape of one
    body's momentum is returned. Otherwise `RULE` applies. Raises a ValueError if several readings work or none does, if
    `axes` does not fit the torque, or if the torque does not act on one body in this reading.
    """
    readings = _Readings(torque, _of_one(start, True), _of_one(body, own_body))
    if isinstance(axes, str) and axes == AUTO:
        return readings.marks(readings.only(count))
    chosen = readings.by_axes(axes)
    count_rows(("torque",), (torque,), (readings.marks(chosen),), count)
    shape = readings.shape(chosen) if chosen else readings.momentum
    if shape != readings.momentum:
        read = ", ".join(f"{name} {leaf.shape[1:]}" for name, leaf in (readings.leaves[i] for i in chosen))
        error = shape if isinstance(shape, Exception) else None
        found = f"its torque has shape {shape} instead of {readings.momentum}"
        raise ValueError(
            f"with these torque_axes one body gets {read}, and "
            f"{found if error is None else f'the torque cannot use that: {error}'}; name only the parameters that have "
            "one row for each body, as in torque_axes=['weight']."
        ) from error
    return readings.marks(chosen)


def _of_one(tree: Any, rows: bool) -> Any:
    """The shapes of the arrays of a tree, or of their rows."""
    return jax.tree.map(
        lambda x: jax.ShapeDtypeStruct(x.shape[1:] if rows else x.shape, x.dtype) if eqx.is_array(x) else x, tree
    )


class _Readings(NamedTuple):
    """A torque on many bodies, and the shapes of one body and its state.

    A reading is a tuple with the indices of those leaves of the torque that have one row per body.
    """

    torque: Any
    state: Any
    body: Any

    @property
    def leaves(self) -> list[tuple[str, Any]]:
        """The leaves of the torque by name; the names of a bath begin with `bath.`."""
        own = ".torque" if isinstance(self.torque, WithBath) else ""
        leaves = jax.tree_util.tree_leaves_with_path(self.torque)
        return [(jax.tree_util.keystr(path).removeprefix(own).removeprefix("."), leaf) for path, leaf in leaves]

    @property
    def momentum(self) -> tuple[int, ...]:
        """The shape of one body's momentum, the first array of a state."""
        return jax.tree.leaves(self.state)[0].shape

    def marks(self, chosen: tuple[int, ...]) -> Any:
        leaves, structure = jax.tree.flatten(self.torque)
        return structure.unflatten([i in chosen for i in range(len(leaves))])

    def listed(self, chosen: Sequence[int]) -> str:
        """For messages: the names and shapes of these leaves."""
        return ", ".join(f"{name} {leaf.shape}" for name, leaf in (self.leaves[i] for i in chosen))

    def call(self, chosen: tuple[int, ...]) -> str:
        """For messages: the argument `torque_axes` for which these leaves have rows."""
        if not chosen:
            return "torque_axes=None"
        if set(chosen) == {i for i, (_, leaf) in enumerate(self.leaves) if eqx.is_array(leaf)}:
            return "torque_axes=0"
        return f"torque_axes={[self.leaves[i][0] for i in chosen]}"

    def shape(self, chosen: tuple[int, ...]) -> Any:
        """The shape of the torque on one body, with one row of each chosen leaf; the error if the torque raises."""
        torque = jax.tree.map(_of_one, self.torque, self.marks(chosen))
        arrays, rest = eqx.partition((torque, self.state, self.body), lambda x: isinstance(x, jax.ShapeDtypeStruct))

        def evaluated(arrays: Any) -> Any:
            torque, state, body = eqx.combine(arrays, rest)
            force = state.kind.force_of(on_body(torque, body)(jnp.zeros((), state.momentum.dtype), state))
            return force.angular if isinstance(force, Momenta) else force

        try:
            return getattr(jax.eval_shape(evaluated, arrays), "shape", None)
        except (TypeError, ValueError, IndexError, AttributeError) as error:
            return error

    def only(self, count: int) -> tuple[int, ...]:
        """The only reading that works."""
        candidates = [i for i, (_, leaf) in enumerate(self.leaves) if eqx.is_array(leaf) and leaf.shape[:1] == (count,)]
        if len(candidates) > _MOST_TRIED:
            raise ValueError(
                f"{len(candidates)} parameters of the torque have {count} rows, and so many are not read in every way: "
                f"{self.listed(candidates)}. If each of them has one row for each body, write "
                f"{self.call(tuple(candidates))}; if all bodies share them, write {self.call(())}."
            )
        subsets = (chosen for size in range(len(candidates) + 1) for chosen in combinations(candidates, size))
        found = list(islice((chosen for chosen in subsets if self.shape(chosen) == self.momentum), 2))
        if len(found) > 1:
            differing = sorted(set(found[0]) ^ set(found[1]))
            raise ValueError(
                f"there are {count} bodies in start, and the torque can be read in two ways: {self.listed(differing)} "
                f"may be one value for all bodies or one row for each. Write {self.call(found[0])}, or "
                f"{self.call(found[1])}: None means that all bodies share every parameter, 0 that every parameter has "
                "rows, and names say which have."
            )
        if found:
            return found[0]
        shape = self.shape(())  # the run reports other mistakes in a torque
        if isinstance(shape, tuple) and shape != self.momentum and shape[-len(self.momentum) :] == self.momentum:
            with_rows = candidates or [i for i, (_, x) in enumerate(self.leaves) if eqx.is_array(x) and x.shape]
            listed = f", from its parameters {self.listed(with_rows)}" if with_rows else ""
            raise ValueError(
                f"the torque on one body has shape {shape} instead of {self.momentum}{listed}; there are {count} "
                "bodies in start: give a parameter one row for each body, or one value for all."
            )
        return ()

    def by_axes(self, axes: Any) -> tuple[int, ...]:
        """The reading of a `torque_axes` other than "auto"."""
        names = [axes] if isinstance(axes, str) else axes
        if isinstance(names, (list, tuple)) and names and all(isinstance(name, str) for name in names):
            known = {name: i for i, (name, leaf) in enumerate(self.leaves) if eqx.is_array(leaf)}
            for name in names:
                if name not in known:
                    raise ValueError(
                        f"torque_axes names {name!r}, but the torque's parameters are {', '.join(known) or 'none'}."
                    )
            return tuple(sorted(known[name] for name in names))
        if isinstance(self.torque, WithBath) and isinstance(axes, tuple) and len(axes) == 2:
            axes = WithBath(*axes)
        if any(isinstance(axis, bool) or axis != 0 for axis in jax.tree.leaves(axes)):
            raise ValueError(f"{RULE}; got {axes!r}.")

        def marked(axis: Any, part: Any) -> Any:
            return jax.tree.map(lambda leaf: axis == 0 and eqx.is_array(leaf), part)

        try:
            marks = jax.tree.map(marked, axes, self.torque, is_leaf=lambda axis: axis is None)
        except ValueError as error:
            raise ValueError(f"{RULE}; it does not fit the torque: {error}") from error
        return tuple(i for i, mark in enumerate(jax.tree.leaves(marks)) if mark)
