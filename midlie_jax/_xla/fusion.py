"""`fuse` makes XLA's CPU compiler compute all outputs of a step in one loop.

By default XLA emits one loop per output of a step, and each of these loops repeats the whole step. With its
multi-output option, it emits a hundred small loops that pass intermediate results through memory. The only HLO
operation with many outputs that the CPU backend can fuse is a reduction of many operands. `fuse` therefore broadcasts
the outputs along a new axis of length two and reduces them along this axis by "take the last", which leaves the values
unchanged. LLVM recognises that both entries are equal and computes only one; `tests/test_compiled.py` counts the loops.
Leaves that are not arrays of numbers, such as the typed key of a random torque, are unchanged. On other platforms
`fuse` is the identity, because their compilers fuse many outputs by themselves (`benchmarks/kernels.py`).

A step, and the body of a loop within it, starts with `begin_step` and ends with `fuse`. `begin` is its counterpart
outside of loops. `split`, `cut`, `fuse_derivative` and `fuse_second_derivative` divide a step that does not fit one
loop; `barrier` is only for accelerators. All use one JAX primitive, which fuses tangents and cotangents as well.

XLA's CPU compiler compiles a short loop without vectors (`compiler.py`), unless it contains an operation that such a
function cannot contain. `begin_step` therefore sorts two equal numbers, and flips a bit of the state if the result is
in descending order, which never happens; the compiler cannot infer this. It takes about a tenth of a microsecond per
step. For few bodies, and if an option turns the pass off, `begin_step` is `begin`.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from . import budgets
from .internals import is_zero_tangent, make_primitive
from .mesh import axes_of, is_number

T = TypeVar("T")

# Uses of the primitive.
_BEGIN, _FUSE, _SPLIT, _CUT, _BARRIER = "begin", "fuse", "split", "cut", "barrier"
_DERIVATIVE, _SECOND = "fuse_derivative", "fuse_second_derivative"
_BEGIN_STEP, _BEGIN_TANGENTS, _FUSE_STEP = "begin_step", "begin_tangents", "fuse_step"
_SPLIT_DERIVATIVE = "split_derivative"
_OF_MANY = "of_many"  # followed by a number of leaves
_NOTHING = (_BEGIN, _BEGIN_STEP, _BEGIN_TANGENTS, _DERIVATIVE, _SECOND, _BARRIER)  # reduce nothing on a CPU
_PRIMALS = {_DERIVATIVE: _SPLIT_DERIVATIVE, _SECOND: _DERIVATIVE}  # in a derivative, else the use of the primals
_TANGENTS = {**_PRIMALS, _BEGIN_STEP: _BEGIN_TANGENTS, _FUSE_STEP: _FUSE}  # else the use of the primals
_COTANGENTS = {_BEGIN: _FUSE, _BEGIN_TANGENTS: _FUSE_STEP}

# Whether a compiler option already keeps the loops of the traced program in vectors.
vectors_by_option: ContextVar[bool] = ContextVar("vectors_by_option", default=False)


def fuse(tree: T) -> T:
    """The tree with its values unchanged, at the end of a step: its leaves of equal shape are computed in one loop."""
    return _bind(tree, _FUSE)


def begin(tree: T) -> T:
    """The tree with its values unchanged, at the beginning of a step; nothing in the step itself.

    Cotangents of a reverse derivative enter at `fuse` unchanged, and are fused where they leave, at `begin`.
    """
    return _bind(tree, _BEGIN)


def begin_step(tree: T) -> T:
    """`begin` in the body of a loop, which XLA's CPU compiler then computes in vectors for many bodies.

    The last leaf of many floats must be carried by the loop; the compiler would move the sort of a constant out.
    """
    return _bind(tree, _BEGIN if vectors_by_option.get() else _BEGIN_STEP)


def split(tree: T) -> T:
    """`fuse` in the middle of a step; the rest is a separate loop, also in the derivatives."""
    return _bind(tree, _SPLIT)


def cut(tree: T) -> T:
    """`split` on accelerators as well, whose compilers divide a long step into more kernels than necessary."""
    return _bind(tree, _CUT)


def fuse_derivative(tree: T) -> T:
    """`split` in a derivative, which is several times larger than the step; nothing in the step itself."""
    return _bind(tree, _DERIVATIVE)


def fuse_derivative_of_many(tree: T, few: int) -> T:
    """`fuse_derivative` for a derivative with respect to more than `few` leaves; nothing for any other."""
    return _bind(tree, f"{_OF_MANY} {few}")


def fuse_second_derivative(tree: T) -> T:
    """`fuse_derivative` in a derivative: second derivatives are split, and neither the step nor its derivative."""
    return _bind(tree, _SECOND)


def barrier(tree: T) -> T:
    """The tree with its values unchanged; on an accelerator the code before and after it is not fused."""
    return _bind(tree, _BARRIER)


def is_stored(primitive: Any, *types: Any, **parameters: Any) -> bool:
    """A policy of `jax.checkpoint`: keep the final values of a loop, which are in memory, and recompute the rest.

    A solve that ends with `split` is therefore not repeated. Without a checkpoint, each intermediate result that the
    derivative reads would be an output of its loop, which would then be divided.
    """
    return primitive is _fuse and _reduces(parameters["use"])


def _reduces(use: str) -> bool:
    return use not in _NOTHING and not use.startswith(_OF_MANY)


def _bind(tree: T, use: str) -> T:
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, _fuse_where(leaves, _is_number, use))


def _is_number(leaf: Any) -> bool:
    return isinstance(leaf, Array) and is_number(jax.typeof(leaf))


def _fuse_where(leaves: Sequence[Any], condition: Callable[[Any], bool], use: str) -> list[Any]:
    result = list(leaves)
    positions = [i for i, leaf in enumerate(leaves) if condition(leaf)]
    if positions:
        for i, leaf in zip(positions, _fuse.bind(*(leaves[i] for i in positions), use=use), strict=True):
            result[i] = leaf
    return result


def _reduce(*leaves: Array, use: str) -> list[Array]:
    """The lowering on CPUs: one reduction for the leaves of one shape that vary along the same mesh axes, or a few."""
    result = list(leaves)
    groups: dict[Any, list[int]] = defaultdict(list)
    for i, leaf in enumerate(leaves if _reduces(use) else ()):
        groups[leaf.shape, axes_of(leaf)].append(i)
    for group in groups.values():
        loops = -(-len(group) // budgets.LOOP_OUTPUTS) if use in (_FUSE_STEP, _SPLIT_DERIVATIVE) else 1
        for indices in (group[k::loops] for k in range(loops)):
            pairs = tuple(jnp.broadcast_to(leaves[i], (2, *leaves[i].shape)) for i in indices)
            zeros = tuple(jnp.zeros((), leaves[i].dtype) for i in indices)
            for i, value in zip(indices, jax.lax.reduce(pairs, zeros, lambda first, last: last, (0,)), strict=True):
                result[i] = value
    return _kept_in_vectors(result) if use in (_BEGIN_STEP, _FUSE_STEP) else result


def _kept_in_vectors(leaves: list[Array]) -> list[Array]:
    for i, leaf in reversed(list(enumerate(leaves))):
        if jnp.issubdtype(leaf.dtype, jnp.floating) and leaf.size >= budgets.VECTOR_NUMBERS:
            integer = jnp.dtype(f"int{8 * leaf.dtype.itemsize}")
            number = leaf.ravel()[0]
            pair = jax.lax.sort(jnp.stack([number, number]))
            flipped = jax.lax.bitcast_convert_type(leaf, integer) ^ (pair[1] < pair[0]).astype(integer)
            leaves[i] = jax.lax.bitcast_convert_type(flipped, leaf.dtype)
            break
    return leaves


def _separate(*leaves: Array, use: str) -> list[Array]:
    """The lowering on other platforms."""
    return list(jax.lax.optimization_barrier(leaves) if use in (_CUT, _BARRIER) else leaves)


def _is_nonzero(tangent: Any) -> bool:
    return not is_zero_tangent(tangent) and _is_number(tangent)


def _jvp(primals: Any, tangents: Any, *, use: str) -> tuple[list[Any], list[Any]]:
    if use.startswith(_OF_MANY) and sum(map(_is_nonzero, tangents)) > int(use.removeprefix(_OF_MANY)):
        use = _DERIVATIVE
    return _fuse.bind(*primals, use=_PRIMALS.get(use, use)), _fuse_where(tangents, _is_nonzero, _TANGENTS.get(use, use))


def _transpose(cotangents: Any, *primals: Any, use: str) -> list[Any]:
    if use in (_FUSE, _FUSE_STEP):  # the cotangents of a step enter here
        return list(cotangents)
    return _fuse_where(cotangents, _is_nonzero, _COTANGENTS.get(use, use))


def _batch(values: Any, axes: Any, *, use: str) -> tuple[list[Array], Any]:
    return _fuse.bind(*values, use=use), axes


_fuse = make_primitive("fuse", default=_separate, on_cpu=_reduce, jvp=_jvp, transpose=_transpose, batch=_batch)
