"""Chooses what a reverse derivative stores to recompute a function: its arguments, or values within it.

A step that begins with a kick reads momentum, pose and force; everything after the kick reads the new momentum and the
pose. If `kept` marks these two, `recomputed` stores them instead of the arguments, and therefore no force, whose
writing and reading would take a large part of the run time of a gradient.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
from jax.ad_checkpoint import checkpoint_name

T = TypeVar("T")
_KEPT = "midlie_jax kept"


def kept(tree: T) -> T:
    """The tree with its values unchanged; `recomputed` stores them instead of the arguments."""
    return jax.tree.map(lambda leaf: checkpoint_name(leaf, _KEPT), tree)


def recomputed(function: Callable[..., Any], middle: bool) -> Callable[..., Any]:
    """The function; reverse mode stores its arguments, or with `middle` the `kept` values, and recomputes the rest."""
    policy = jax.checkpoint_policies.save_only_these_names(_KEPT) if middle else None
    for _ in range(2):  # each reverse derivative removes one
        function = jax.checkpoint(function, prevent_cse=False, policy=policy)
    return function
