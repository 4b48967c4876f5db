"""Properties of a JAX type: whether its values are numbers, and along which axes of a device mesh they vary.

Inside `jax.shard_map` JAX makes the axes of the mesh along which a value varies part of its type. JAX's own functions
promote their operands to a common set of axes. The carry of a loop, a primitive that is bound directly and this
package's own primitives must be promoted explicitly. A promotion takes no time, but its transpose is a sum over
devices. A run therefore promotes all its arguments before its loop, and the loop contains no such sum.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import PartitionSpec as P

from .internals import traced, varying_axes

Axes = frozenset[str]
NONE: Axes = frozenset()
_ARRAYS = (Array, np.ndarray, np.generic)


def is_number(kind: Any) -> bool:
    """Whether values of this type are numbers or booleans; typed keys of `jax.random` are not."""
    return jnp.issubdtype(kind.dtype, np.number) or kind.dtype == np.bool_


def axes_of(*values: Any) -> Axes:
    """The axes along which any of the values, arrays or their types, varies; other values vary along none."""
    types = (jax.typeof(value) if isinstance(value, Array) else value for value in values)
    return NONE.union(*map(varying_axes, types))


def promoted(value: Any, axes: Axes) -> Any:
    """The number or array, promoted to vary along these axes as well."""
    missing = axes - axes_of(value)
    return jax.lax.pcast(value, tuple(sorted(missing)), to="varying") if missing else value


def is_spread(tree: Any) -> bool:
    """Whether the rows of any array lie on several devices of a mesh whose axes are part of the array's type."""
    return any(jax.typeof(x).sharding.spec[:1] not in ((), (None,)) for x in jax.tree.leaves(tree))


def row_of(x: Any, number: Any = 0) -> Array:
    """One row of an array, on every device if its rows are spread as in `is_spread`."""
    rows, *others = jax.typeof(x).sharding.spec
    return (x if rows is None else jax.sharding.reshard(x, P(None, *others)))[number]


def all_promoted(tree: Any, axes: Axes) -> Any:
    """The tree with its arrays promoted to these axes; other leaves are unchanged."""
    return jax.tree.map(lambda leaf: promoted(leaf, axes) if isinstance(leaf, _ARRAYS) else leaf, tree)


def axes_of_run(arguments: Any, *calls: tuple[Any, ...]) -> Axes:
    """The axes along which any array used by a run varies, including arrays that its functions close over.

    A call is a tuple of a function, or None, and the arguments with which it will be called.
    """
    if not jax.sharding.get_abstract_mesh().manual_axes:
        return NONE
    closed_over = [traced(function, *inputs).consts for function, *inputs in calls if function is not None]
    return axes_of(*jax.tree.leaves((arguments, closed_over)))
