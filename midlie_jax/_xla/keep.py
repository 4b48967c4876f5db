"""Chooses what a reverse derivative stores to recompute a function from: its arguments, or values within it.

A step that begins with a kick reads momentum, pose and force. All that follows the kick reads the momentum after it and
the pose. If `kept` marks these two, `recomputed` stores them instead of the arguments, and so no force. That saves
arrays that the forward pass writes and the reverse pass reads, which takes a large part of the time of a gradient.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
from jax.ad_checkpoint import checkpoint_name

T = TypeVar("T")
_KEPT = "midlie_jax kept"


def kept(tree: T) -> T:
    """The tree with its values unchanged; `recomputed` stores them instead of the arguments that they come from."""
    return jax.tree.map(lambda leaf: checkpoint_name(leaf, _KEPT), tree)


def recomputed(function: Callable[..., Any], middle: bool) -> Callable[..., Any]:
    """The function; reverse mode stores its arguments, or with `middle` what is `kept`, and recomputes the rest.

    Arguments that are not needed in addition to the `kept` values are not stored.

    There are two checkpoints, because each reverse derivative removes one: so a gradient of a gradient stores no more,
    either.
    """
    policy = jax.checkpoint_policies.save_only_these_names(_KEPT) if middle else None
    for _ in range(2):
        function = jax.checkpoint(function, prevent_cse=False, policy=policy)
    return function
