"""Which values a reverse derivative keeps of a function that it computes again: the arguments, or values within it.

A step that begins with a kick reads momentum, pose and force. All that follows the kick reads the momentum after it and
the pose. With `kept` around these, `recomputed` keeps them and neither the force nor the momentum before: fewer arrays
to write on the way there and to read on the way back, which takes a large part of the time of a gradient.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
from jax.ad_checkpoint import checkpoint_name

T = TypeVar("T")
_KEPT = "midlie_jax kept"


def kept(tree: T) -> T:
    """The tree with its values unchanged; `recomputed` keeps them rather than the arguments they were computed from."""
    return jax.tree.map(lambda leaf: checkpoint_name(leaf, _KEPT), tree)


def recomputed(function: Callable[..., Any], middle: bool) -> Callable[..., Any]:
    """The function; reverse mode keeps its arguments, or with `middle` what is `kept`, and computes the rest again.

    Arguments that `kept` values make needless are not kept.

    There are two checkpoints, because each order of reverse mode removes one: so a gradient of a gradient, too, keeps
    no more.
    """
    policy = jax.checkpoint_policies.save_only_these_names(_KEPT) if middle else None
    for _ in range(2):
        function = jax.checkpoint(function, prevent_cse=False, policy=policy)
    return function
