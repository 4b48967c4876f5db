"""What JAX knows of a value besides its numbers: whether it has any, and along which axes of a mesh it varies.

Inside `jax.shard_map` a value may vary from one device to the next along some axes of the mesh, which JAX makes part of
its type. JAX's functions promote their operands to the axes of all of them; the carry of a loop, a primitive bound
directly and one of our own are left to us. A promotion costs nothing, but its transpose sums over the devices. So a run
promotes all its arguments before its loop, which then holds no such sum.

The one name here that JAX does not document is `mat`, the attribute of a type that holds the axes. Tried with JAX
0.10.0, 0.10.1, 0.11.2 and 0.12.0.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

Axes = frozenset[str]
NONE: Axes = frozenset()
_ARRAYS = (Array, np.ndarray, np.generic)


def is_number(kind: Any) -> bool:
    """Whether arrays of this type hold numbers or truth values; typed keys of random numbers, for one, do not."""
    return jnp.issubdtype(kind.dtype, np.number) or kind.dtype == np.bool_


def axes_of(*values: Any) -> Axes:
    """The axes along which any of these varies, arrays or types of arrays; other values vary along none."""
    types = (jax.typeof(value) if isinstance(value, Array) else value for value in values)
    return NONE.union(*(kind.mat.varying for kind in types if hasattr(kind, "mat")))


def promoted(value: Any, axes: Axes) -> Any:
    """The number or array, varying along these axes too."""
    missing = axes - axes_of(value)
    return jax.lax.pcast(value, tuple(sorted(missing)), to="varying") if missing else value


def all_promoted(tree: Any, axes: Axes) -> Any:
    """The tree with its arrays promoted; what else it holds stays as it is."""
    return jax.tree.map(lambda leaf: promoted(leaf, axes) if isinstance(leaf, _ARRAYS) else leaf, tree)


def axes_of_run(arguments: Any, *calls: tuple[Any, ...]) -> Axes:
    """The axes along which any array varies that a run is given, or that one of its functions has closed over.

    Args:
        arguments: a tree.
        calls: functions with what they are called with, or None instead of a function.
    """
    if not jax.sharding.get_abstract_mesh().manual_axes:
        return NONE
    held = [jax.make_jaxpr(function)(*given).consts for function, *given in calls if function is not None]
    return axes_of(*jax.tree.leaves((arguments, held)))
