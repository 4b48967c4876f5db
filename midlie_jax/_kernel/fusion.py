"""One loop for many outputs: how a step is kept whole by XLA's CPU compiler.

A step has seven outputs or more, and XLA's CPU backend fuses towards one output at a time: left alone it emits a
loop for each, every one of them repeating the whole step, or (with its multi-output option on) a hundred small
loops that pass their intermediate results through memory. A reduction of many operands at once is the one HLO
operation with many outputs that its fusion understands. So the outputs are broadcast along a new axis of length
two and reduced again by "take the last": an identity, whose two turns LLVM sees to be equal and computes once.
The whole step becomes one vectorised loop, and compiles several times faster; `tests/test_compiled.py` counts.
Leaves that are no numbers, such as the typed key of a random torque, pass by untouched.

It is a primitive of its own, so that it stays the identity for autodiff while tangents and cotangents, which have
the same trouble and more of it, are kept together too.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from .internals import axes_of, is_number


def together(tree: Any) -> Any:
    """The tree unchanged; on compiling, its leaves of equal shape come out of one loop."""
    return _bind(tree, always=True)


def seam(tree: Any) -> Any:
    """The tree unchanged, and nothing on compiling unless it is differentiated: then as `together`.

    For the joints between the parts of a step. The step alone is one loop; its derivative, several times larger, is
    cut here into loops of a size that the compiler can digest.
    """
    return _bind(tree, always=False)


def _bind(tree: Any, always: bool) -> Any:
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, _on_some(leaves, _is_number, always))


def _is_number(leaf: Any) -> bool:
    return is_number(jax.typeof(leaf))


def _on_some(leaves: Sequence[Any], which: Callable[[Any], bool], always: bool) -> list[Any]:
    """The others as they are."""
    result = list(leaves)
    places = [i for i, leaf in enumerate(leaves) if which(leaf)]
    if places:
        for i, leaf in zip(places, _together.bind(*(leaves[i] for i in places), always=always), strict=True):
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


def _is_there(tangent: Any) -> bool:
    return not isinstance(tangent, ad.Zero) and _is_number(tangent)


def _jvp(primals: Any, tangents: Any, *, always: bool) -> tuple[list[Any], list[Any]]:
    del always
    return _together.bind(*primals, always=True), _on_some(tangents, _is_there, always=True)


def _transpose(cotangents: Any, *primals: Any, always: bool) -> list[Any]:
    del primals, always
    return _on_some(cotangents, _is_there, always=True)


def _batch(values: Any, axes: Any, *, always: bool) -> tuple[list[Array], Any]:
    return _together.bind(*values, always=always), axes


_together = Primitive("together")
_together.multiple_results = True
_together.def_impl(_reduce)
_together.def_abstract_eval(lambda *avals, always: list(avals))
ad.primitive_jvps[_together] = _jvp
ad.primitive_transposes[_together] = _transpose
batching.primitive_batchers[_together] = _batch
mlir.register_lowering(_together, mlir.lower_fun(_reduce, multiple_results=True))
