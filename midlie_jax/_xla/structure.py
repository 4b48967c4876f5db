"""Caches decisions that depend on the structure of arguments, because they take longer than a short run.

The structure is everything except the numbers: classes, functions, shapes and dtypes. Decisions that depend on numbers,
such as whether they are finite, must be made in every call.
"""

import weakref
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import jax
import numpy as np

from .internals import Tracer

R = TypeVar("R")
_KEPT = 1024  # entries of one cache; a torque made again for every call would fill more and more
_decisions: dict[Hashable, Any] = {}
_known: dict[Hashable, tuple[tuple[Any, ...] | None, Any]] = {}


def structure_of(tree: Any) -> Hashable:
    """Everything in a tree except the numbers in its arrays; None if a part of it cannot be compared."""
    return _structure(*jax.tree.flatten(tree))


def _structure(leaves: list[Any], structure: Any) -> Hashable:
    found = structure, tuple(map(kind_of, leaves))
    try:
        hash(found)
    except TypeError:
        return None
    return found


def is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def kind_of(leaf: Any) -> Any:
    """The type of an array, also of a traced one; for other objects type and value, so that 0.0 differs from -0.0."""
    if isinstance(leaf, jax.Array):
        return jax.typeof(leaf), isinstance(leaf, Tracer)
    if isinstance(leaf, np.ndarray | np.generic):
        return leaf.shape, leaf.dtype
    return type(leaf), repr(leaf) if isinstance(leaf, float | complex) else leaf


def once(decide: Callable[..., R], *arguments: Any) -> R:
    """`decide(*arguments)`, cached for all arguments of this structure; exceptions are not cached."""
    structure = structure_of(arguments)
    if structure is None:
        return decide(*arguments)
    key = decide, structure
    if key not in _decisions:
        remember(_decisions, key, decide(*arguments))
    return _decisions[key]


def remember(memory: dict[Any, Any], key: Hashable, value: Any) -> None:
    if len(memory) >= _KEPT:
        memory.pop(next(iter(memory)))
    memory[key] = value


def once_for_numbers(decide: Callable[..., R], *arguments: Any) -> R:
    """`decide(*arguments)`, cached for the same JAX arrays; not cached with NumPy arrays, which can change."""
    every, tree = jax.tree.flatten(arguments)
    structure, leaves = _structure(every, tree), [leaf for leaf in every if is_array(leaf)]
    if structure is None or any(isinstance(leaf, Tracer) or not isinstance(leaf, jax.Array) for leaf in leaves):
        return decide(*arguments)
    key = decide, structure, tuple(map(id, leaves))
    references, result = _known.get(key, (None, None))
    if references is not None and all(ref() is leaf for ref, leaf in zip(references, leaves, strict=True)):
        return result
    result = decide(*arguments)
    remember(_known, key, (tuple(map(weakref.ref, leaves)), result))
    return result
