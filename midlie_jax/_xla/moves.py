"""NumPy versions of the JAX primitives that only move entries of arrays, such as reshape and concatenate.

`replay.py` represents an array by the positions of its entries in a pool of scalars, an integer array of list indices.
A move is called with the positions of its operands, the parameters of the primitive and the shape of its (first)
result. It returns the positions of the result, or a list of them for several results. The tables at the end list the
parameters that each move reads.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Places = np.ndarray  # integers: the positions of the entries of an array in the pool
Shape = tuple[int, ...]


def _broadcast(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    expanded = [1] * len(shape)
    for axis, size in zip(parameters["broadcast_dimensions"], operands[0].shape, strict=True):
        expanded[axis] = size
    return np.broadcast_to(operands[0].reshape(expanded), shape)


def _reshape(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    permutation = parameters["dimensions"]
    return (operands[0] if permutation is None else operands[0].transpose(permutation)).reshape(shape)


def _slice(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    strides = parameters["strides"] or (None,) * len(shape)
    return operands[0][tuple(map(slice, parameters["start_indices"], parameters["limit_indices"], strides))]


def _pad(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    """Negative padding removes entries at the edges; interior padding goes between the entries."""
    source, filling = operands
    targets, sources = [], []
    for (low, _, interior), size, out in zip(parameters["padding_config"], source.shape, shape, strict=True):
        positions = low + (interior + 1) * np.arange(size)
        sources.append(np.flatnonzero((positions >= 0) & (positions < out)))
        targets.append(positions[sources[-1]])
    result = np.full(shape, filling)
    result[np.ix_(*targets)] = source[np.ix_(*sources)]
    return result


def _split(operands: list[Places], parameters: Any, shape: Shape) -> list[Places]:
    return list(np.split(operands[0], np.cumsum(parameters["sizes"])[:-1], axis=parameters["axis"]))


def _unstack(operands: list[Places], parameters: Any, shape: Shape) -> list[Places]:
    return [np.asarray(part) for part in np.moveaxis(operands[0], parameters["axis"], 0)]


# Moves that depend on index operands: `move(operands, indices, parameters, shape)`.


def _window(source: Places, starts: list[Any], shape: Shape) -> tuple[slice, ...]:
    """The slices of a window of this shape. As in XLA, a window that would exceed the array is shifted back inside."""
    begin = [min(max(int(s), 0), n - m) for s, n, m in zip(starts, source.shape, shape, strict=True)]
    return tuple(slice(b, b + m) for b, m in zip(begin, shape, strict=True))


def _dynamic_slice(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places:
    return operands[0][_window(operands[0], indices, shape)]


def _dynamic_update_slice(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places:
    result = operands[0].copy()
    result[_window(result, indices, operands[1].shape)] = operands[1]
    return result


def _gather(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places | None:
    # Entries are numbered from 1; an out-of-bounds index reads the fill value 0.
    numbers = np.arange(1, operands[0].size + 1, dtype=np.int32).reshape(operands[0].shape)
    with jax.ensure_compile_time_eval():
        taken = jax.lax.gather_p.bind(jnp.asarray(numbers), jnp.asarray(indices[0]), **{**parameters, "fill_value": 0})
        taken = np.asarray(taken)
    return None if np.any(taken == 0) else operands[0].reshape(-1)[taken - 1]


def _scatter(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places:
    with jax.ensure_compile_time_eval():
        source, update = (jnp.asarray(operands[i].astype(np.int32)) for i in (0, 2))
        return np.asarray(jax.lax.scatter_p.bind(source, jnp.asarray(indices[0]), update, **parameters))


# For each primitive: its move, and the parameters that the move reads.
MOVES: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "broadcast_in_dim": (_broadcast, ("shape", "broadcast_dimensions")),
    "concatenate": (lambda operands, p, shape: np.concatenate(operands, axis=p["dimension"]), ("dimension",)),
    "pad": (_pad, ("padding_config",)),
    "reshape": (_reshape, ("new_sizes", "dimensions")),
    "rev": (lambda operands, p, shape: np.flip(operands[0], p["dimensions"]), ("dimensions",)),
    "slice": (_slice, ("start_indices", "limit_indices", "strides")),
    "split": (_split, ("sizes", "axis")),
    "squeeze": (lambda operands, p, shape: operands[0].reshape(shape), ("dimensions",)),
    "stack": (lambda operands, p, shape: np.stack(operands, axis=p["axis"]), ("axis",)),
    "transpose": (lambda operands, p, shape: operands[0].transpose(p["permutation"]), ("permutation",)),
    "unstack": (_unstack, ("axis",)),
}

_INDEXING = ("dimension_numbers", "unique_indices", "indices_are_sorted", "mode")

# For each primitive with index operands: its move, which of the operands are indices, and the parameters that it reads.
INDEXED: dict[str, tuple[Callable[..., Any], slice, tuple[str, ...]]] = {
    "dynamic_slice": (_dynamic_slice, slice(1, None), ("slice_sizes",)),
    "dynamic_update_slice": (_dynamic_update_slice, slice(2, None), ()),
    "gather": (_gather, slice(1, 2), ("slice_sizes", "fill_value", *_INDEXING)),
    "scatter": (_scatter, slice(1, 2), _INDEXING),
}
