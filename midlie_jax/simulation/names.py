"""Names for the arrays of a pytree, by their position in it, and for parameters; conversion to NumPy."""

from typing import Any

import jax
import numpy as np

from .._checks.arguments import is_key

ALONE = "observed"  # the name if the tree is a single array


def named(tree: Any, separator: str = "_") -> dict[str, Any]:
    """The leaves of a tree, named by their position in it: {"momentum": ..., "attitude": ...}."""
    places = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator=separator) or ALONE: leaf for path, leaf in places}


def parameter(name: str) -> str:
    """The name of the array of a parameter of a run, such as "body.moments"."""
    return f"parameter_{name.replace('.', '_')}"


def numbers(array: Any) -> np.ndarray:
    """The NumPy array; for random keys, their data."""
    if is_key(array):
        array = jax.random.key_data(array)
    return np.asarray(array)
