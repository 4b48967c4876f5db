"""`fuse` makes XLA's CPU compiler compute all outputs of a step in one loop.

A step has seven or more outputs, and XLA's CPU backend fuses operations for one output at a time. By default XLA emits
one loop per output, and each of these loops repeats the whole step; with its multi-output option on, it emits a hundred
small loops that pass intermediate results through memory. The one HLO operation with many outputs that the backend can
fuse is a reduction of many operands. So `fuse` broadcasts the outputs along a new axis of length two and reduces them
along this axis by "take the last", which leaves the values unchanged. LLVM recognises that both entries are equal and
computes only one. The whole step becomes one vectorised loop and compiles several times faster;
`tests/test_compiled.py` counts the loops. Leaves that are not arrays of numbers, such as the typed key of a random
torque, pass unchanged.

The reduction is emitted on CPUs only. On other platforms `fuse` is the identity: a GPU's compiler fuses many outputs
by itself, and the reduction would split the step in two.

`fuse` is a JAX primitive. To automatic differentiation it is the identity, and it fuses tangents and cotangents too.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from .internals import is_zero_tangent, make_primitive
from .mesh import axes_of, is_number

T = TypeVar("T")


def fuse(tree: T) -> T:
    """The tree with its values unchanged; the compiled program computes all leaves of equal shape in one loop."""
    return _bind(tree, always=True)


def fuse_derivative(tree: T) -> T:
    """The tree with its values unchanged; in a derivative it acts as `fuse`, otherwise it compiles to nothing.

    Use it between the parts of a step. The step itself remains one loop; its derivative, which is several times larger,
    is split there into loops of a size that the compiler can handle.
    """
    return _bind(tree, always=False)


def _bind(tree: T, always: bool) -> T:
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, _fuse_where(leaves, _is_number, always))


def _is_number(leaf: Any) -> bool:
    return isinstance(leaf, Array) and is_number(jax.typeof(leaf))


def _fuse_where(leaves: Sequence[Any], condition: Callable[[Any], bool], always: bool) -> list[Any]:
    """Fuses the leaves for which the condition holds; the others are returned unchanged."""
    result = list(leaves)
    positions = [i for i, leaf in enumerate(leaves) if condition(leaf)]
    if positions:
        for i, leaf in zip(positions, _fuse.bind(*(leaves[i] for i in positions), always=always), strict=True):
            result[i] = leaf
    return result


def _reduce(*leaves: Array, always: bool) -> list[Array]:
    """The lowering on CPUs: one reduction for all leaves of one shape that vary along the same mesh axes."""
    result = list(leaves)
    groups: dict[Any, list[int]] = defaultdict(list)
    for i, leaf in enumerate(leaves if always else ()):
        groups[leaf.shape, axes_of(leaf)].append(i)
    for indices in groups.values():
        pairs = tuple(jnp.broadcast_to(leaves[i], (2, *leaves[i].shape)) for i in indices)
        zeros = tuple(jnp.zeros((), leaves[i].dtype) for i in indices)
        for i, value in zip(indices, jax.lax.reduce(pairs, zeros, lambda first, last: last, (0,)), strict=True):
            result[i] = value
    return result


def _identity(*leaves: Array, always: bool) -> list[Array]:
    del always
    return list(leaves)


def _is_nonzero(tangent: Any) -> bool:
    return not is_zero_tangent(tangent) and _is_number(tangent)


def _jvp(primals: Any, tangents: Any, *, always: bool) -> tuple[list[Any], list[Any]]:
    del always
    return _fuse.bind(*primals, always=True), _fuse_where(tangents, _is_nonzero, always=True)


def _transpose(cotangents: Any, *primals: Any, always: bool) -> list[Any]:
    del primals, always
    return _fuse_where(cotangents, _is_nonzero, always=True)


def _batch(values: Any, axes: Any, *, always: bool) -> tuple[list[Array], Any]:
    return _fuse.bind(*values, always=always), axes


_fuse = make_primitive("fuse", default=_identity, on_cpu=_reduce, jvp=_jvp, transpose=_transpose, batch=_batch)
