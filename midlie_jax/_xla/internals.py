"""All uses of parts of JAX without a stable documented interface.

Tested with JAX 0.10.0, 0.10.1, 0.11.2 and 0.12.0. `tests/test_structure.py` checks that no other file imports from
`jax.core`, `jax.extend` or `jax.interpreters`. The rules of `rules.py` also rely on the names and parameters of JAX's
primitives; a primitive with a parameter that its rule does not know is replayed unchanged.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray as ShapedArray
from jax.core import Tracer as Tracer
from jax.core import eval_jaxpr
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Literal as Literal
from jax.extend.core import Primitive as Primitive
from jax.extend.core import take_current_trace
from jax.interpreters import ad, batching, mlir, partial_eval

if TYPE_CHECKING:
    ClosedJaxpr = Any  # its type has no public import since jax 0.12
else:
    from jax.extend.core import ClosedJaxpr as ClosedJaxpr


def varying_axes(kind: Any) -> frozenset[str]:
    """The mesh axes along which values of a JAX type vary (`jax.shard_map`); none for other types."""
    return kind.mat.varying if hasattr(kind, "mat") else frozenset()


def bodies_at_once() -> int:
    """The product of the sizes of `jax.vmap`'s batch axes if JAX executes operations now; 0 if it records a program."""
    with take_current_trace() as innermost:
        trace: Any = innermost
        size = 1
        while type(trace).__name__ == "BatchTrace":
            size, trace = size * trace.axis_data.size, trace.parent_trace
        return size if type(trace).__name__ == "EvalTrace" else 0


def traced(function: Callable[..., Any], *arguments: Any) -> ClosedJaxpr:
    """The program of a function, from a new trace; to find an earlier one JAX would compare arrays of the function."""
    return jax.make_jaxpr(lambda *given: function(*given))(*arguments)


def run_program(closed: ClosedJaxpr, constants: Sequence[Any], arguments: Sequence[Any]) -> list[Any]:
    return eval_jaxpr(closed.jaxpr, constants, *arguments)


def used_inputs(closed: ClosedJaxpr) -> list[bool]:
    """For each input of a traced function, whether the outputs depend on it."""
    _, used = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    return list(used)


def bind(equation: Any, operands: Sequence[Any]) -> list[Any]:
    primitive = equation.primitive
    results = primitive.bind(*operands, **primitive.get_bind_params(equation.params))
    return list(results) if primitive.multiple_results else [results]


def loop_counts(equation: Any) -> tuple[int, int] | None:
    """The numbers of constant and of carried operands of a `scan`; None if its parameters are not known."""
    parameters = equation.params
    if "num_consts" in parameters:
        return parameters["num_consts"], parameters["num_carry"]
    if "ft_in" in parameters:  # from JAX 0.12 on
        constants, carried, _ = parameters["ft_in"].unpack()
        return len(constants), len(carried)
    return None


def context_of(equation: Any) -> Any:
    return equation.ctx.manager


def are_zero(tangents: Any) -> bool:
    """Whether all tangents of a custom derivative are symbolic zeros."""
    return all(map(_is_zero, jax.tree.leaves(tangents, is_leaf=_is_zero)))


def with_zeros(tangents: Any, primals: Any) -> Any:
    return jax.tree.map(lambda t, p: jnp.zeros_like(p) if _is_zero(t) else t, tangents, primals, is_leaf=_is_zero)


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def is_zero_tangent(tangent: Any) -> bool:
    return isinstance(tangent, ad.Zero)


def make_primitive(
    name: str,
    *,
    default: Callable[..., Any],
    on_cpu: Callable[..., Any],
    batch: Callable[..., Any],
    jvp: Callable[..., Any] | None = None,
    transpose: Callable[..., Any] | None = None,
    outputs: Callable[..., Any] = lambda types, **parameters: types,
) -> Primitive:
    """A primitive with many outputs, by default of the types of its inputs; the rules are as JAX expects them."""
    primitive = Primitive(name)
    primitive.multiple_results = True
    primitive.def_impl(default)
    primitive.def_abstract_eval(lambda *types, **parameters: list(outputs(types, **parameters)))
    if jvp is not None:
        ad.primitive_jvps[primitive] = jvp
    if transpose is not None:
        ad.primitive_transposes[primitive] = transpose
    batching.primitive_batchers[primitive] = batch
    mlir.register_lowering(primitive, mlir.lower_fun(default, multiple_results=True))
    mlir.register_lowering(primitive, mlir.lower_fun(on_cpu, multiple_results=True), platform="cpu")
    return primitive
