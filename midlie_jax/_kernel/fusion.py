"""One loop for many outputs: how a step is kept whole by XLA's CPU compiler.

A step has seven outputs or more, and XLA's CPU backend fuses towards one output at a time. Left alone, XLA emits a loop
for each output, and every one of these loops repeats the whole step; with its multi-output option on, it emits a
hundred small loops that pass their intermediate results through memory. A reduction of many operands at once is the one
HLO operation with many outputs that its fusion understands. So the outputs are broadcast along a new axis of length two
and reduced again by "take the last", which is an identity. LLVM sees that both turns of this reduction are equal and
computes one. The whole step becomes one vectorised loop, and compiles several times faster; `tests/test_compiled.py`
counts the loops. Leaves that are no arrays of numbers, such as the typed key of a random torque, pass unchanged.

The reduction is written for CPUs alone. On other platforms `fuse` is the identity: a GPU's compiler fuses many outputs
by itself, and the reduction would cut the step in two.

`fuse` is a primitive, so that it is the identity for autodiff, while tangents and cotangents are fused too.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from .internals import axes_of, is_number

T = TypeVar("T")


def fuse(tree: T) -> T:
    """The tree unchanged; in the compiled program its leaves of equal shape come out of one loop."""
    return _bind(tree, always=True)


def fuse_derivative(tree: T) -> T:
    """The tree unchanged, without a trace in the compiled program unless it is differentiated: then as `fuse`.

    For the places between the parts of a step. The step alone is one loop. Its derivative is several times larger, and
    is cut here into loops of a size that the compiler can handle.
    """
    return _bind(tree, always=False)


def _bind(tree: T, always: bool) -> T:
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, _on_some(leaves, _is_number, always))


def _is_number(leaf: Any) -> bool:
    return isinstance(leaf, Array) and is_number(jax.typeof(leaf))


def _on_some(leaves: Sequence[Any], which: Callable[[Any], bool], always: bool) -> list[Any]:
    """The others as they are."""
    result = list(leaves)
    places = [i for i, leaf in enumerate(leaves) if which(leaf)]
    if places:
        for i, leaf in zip(places, _fuse.bind(*(leaves[i] for i in places), always=always), strict=True):
            result[i] = leaf
    return result


def _reduce(*leaves: Array, always: bool) -> list[Array]:
    result = list(leaves)
    alike: dict[Any, list[int]] = defaultdict(list)
    for i, leaf in enumerate(leaves if always else ()):
        alike[leaf.shape, axes_of(leaf)].append(i)
    for indices in alike.values():
        pairs = tuple(jnp.broadcast_to(leaves[i], (2, *leaves[i].shape)) for i in indices)
        zeros = tuple(jnp.zeros((), leaves[i].dtype) for i in indices)
        for i, value in zip(indices, jax.lax.reduce(pairs, zeros, lambda kept, new: new, (0,)), strict=True):
            result[i] = value
    return result


def _same(*leaves: Array, always: bool) -> list[Array]:
    del always
    return list(leaves)


def _is_nonzero(tangent: Any) -> bool:
    return not isinstance(tangent, ad.Zero) and _is_number(tangent)


def _jvp(primals: Any, tangents: Any, *, always: bool) -> tuple[list[Any], list[Any]]:
    del always
    return _fuse.bind(*primals, always=True), _on_some(tangents, _is_nonzero, always=True)


def _transpose(cotangents: Any, *primals: Any, always: bool) -> list[Any]:
    del primals, always
    return _on_some(cotangents, _is_nonzero, always=True)


def _batch(values: Any, axes: Any, *, always: bool) -> tuple[list[Array], Any]:
    return _fuse.bind(*values, always=always), axes


_fuse = Primitive("fuse")
_fuse.multiple_results = True
_fuse.def_impl(_same)
_fuse.def_abstract_eval(lambda *avals, always: list(avals))
ad.primitive_jvps[_fuse] = _jvp
ad.primitive_transposes[_fuse] = _transpose
batching.primitive_batchers[_fuse] = _batch
mlir.register_lowering(_fuse, mlir.lower_fun(_same, multiple_results=True))
mlir.register_lowering(_fuse, mlir.lower_fun(_reduce, multiple_results=True), platform="cpu")
