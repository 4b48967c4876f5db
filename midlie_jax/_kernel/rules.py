"""How single operations are replayed on scalars: the rules of `replay.py`, one for each primitive of JAX.

A rule says which parameters of its primitive it understands, and with which values. An operation with any other
parameter or value has no rule, and is replayed as it is: a parameter that a later JAX adds is never ignored. Tried with
JAX 0.10.0, 0.10.1, 0.11.2 and 0.12.0.

The results are those of the primitive but for the sign of a zero, which XLA does not keep either, and the order in
which a sum is taken.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray, Tracer
from jax.extend.core import ClosedJaxpr

from .internals import axes_of, is_number, promoted
from .moves import INDEXED, MOVES, Places

# Arrays of more entries than this stay arrays.
_LARGEST = 64

Parameters = Mapping[str, Any]


class Pool:
    """The scalars that arrays are made of while they are replayed; an array is an integer array of places here."""

    def __init__(self) -> None:
        self.scalars: list[Any] = []

    def store(self, scalars: Sequence[Any], shape: tuple[int, ...]) -> Places:
        first = len(self.scalars)
        self.scalars.extend(scalars)
        return np.arange(first, len(self.scalars)).reshape(shape)

    def at(self, places: Any) -> list[Any]:
        return [self.scalars[i] for i in np.ravel(places)]

    def constants(self, places: Places, dtype: Any) -> np.ndarray | None:
        """The numbers themselves, where they are known while tracing."""
        numbers = self.at(places)
        if any(isinstance(n, Tracer) for n in numbers):
            return None
        return np.array([np.asarray(n) for n in numbers], dtype).reshape(places.shape)


class Rule(NamedTuple):
    """How one primitive is replayed.

    Attributes:
        replay: `replay(pool, equation, operands)`, from the places of the operands to those of the results; None where
            it cannot be done.
        understood: for each parameter that the rule knows, whether it understands a value.
        cheap: whether XLA's CPU compiler will repeat the operation rather than store its result.
        takes: whether the rule applies to operands and results of these dtypes.
    """

    replay: Callable[[Pool, Any, list[Places]], list[Places] | None]
    understood: Mapping[str, Callable[[Any], bool]]
    cheap: bool
    takes: Callable[[list[Any]], bool] = lambda dtypes: True


def rule_for(equation: Any) -> Rule | None:
    """The rule by which an equation can be replayed, whatever the size of its arrays."""
    rule = RULES.get(equation.primitive.name)
    if rule is None or not _understands(rule.understood, equation.params):
        return None
    dtypes = [atom.aval.dtype for atom in (*equation.invars, *equation.outvars)]
    return rule if rule.takes(dtypes) else None


def body_of(equation: Any) -> ClosedJaxpr | None:
    """What a call computes, where calling is all that it does."""
    if equation.primitive.name != "jit" or not _understands(_JIT, equation.params):
        return None
    return equation.params["jaxpr"]


def fits(kind: Any) -> bool:
    """Whether values of this type are taken apart: small arrays of numbers, not keys, references and the like."""
    return isinstance(kind, ShapedArray) and is_number(kind) and math.prod(kind.shape) <= _LARGEST


def bind(equation: Any, operands: Sequence[Any]) -> list[Any]:
    """The operation itself."""
    primitive = equation.primitive
    results = primitive.bind(*operands, **primitive.get_bind_params(equation.params))
    return list(results) if primitive.multiple_results else [results]


# Parameters and their values.


def _understands(understood: Mapping[str, Callable[[Any], bool]], parameters: Parameters) -> bool:
    return all(name in understood and understood[name](value) for name, value in parameters.items())


def _any(*names: str) -> dict[str, Callable[[Any], bool]]:
    return {name: lambda value: True for name in names}


def _only(accepted: Any, *names: str) -> dict[str, Callable[[Any], bool]]:
    return {name: lambda value: type(value) is type(accepted) and value == accepted for name in names}


def _precision(value: Any) -> bool:
    """At most what the scalars are computed with; a named algorithm asks for something else."""
    pair = value if isinstance(value, tuple) else (value,)
    return all(part is None or isinstance(part, jax.lax.Precision) for part in pair)


@cache
def _plain_jit() -> Parameters:
    """What `jax.jit` without any option writes."""
    return jax.make_jaxpr(jax.jit(lambda x: x))(0.0).eqns[0].params


def _as_plain(name: str) -> dict[str, Callable[[Any], bool]]:
    return {name: lambda value: all(part == plain for part in value for plain in _plain_jit()[name])}


# Donated arguments and inlining are nothing inside of another jit.
_JIT = {
    **_any("jaxpr", "name", "donated_invars", "ctx_mesh", "keep_unused", "inline"),
    **_as_plain("in_shardings"),
    **_as_plain("out_shardings"),
    **_as_plain("in_layouts"),
    **_as_plain("out_layouts"),
    **_only((), "compiler_options_kvs"),
}


def _one_kind_of_number(dtypes: list[Any]) -> bool:
    """Sums of small floats are taken in a larger dtype, and those of truth values are something else."""
    return all(d == dtypes[0] for d in dtypes) and (
        dtypes[0] in (np.float32, np.float64) or jnp.issubdtype(dtypes[0], np.integer)
    )


# Entry by entry: the operation itself, with all its parameters.


def _each(pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    shape = equation.outvars[0].aval.shape
    columns = zip(*(np.broadcast_to(p, shape).flat for p in operands), strict=True)
    return [pool.store([_on_scalars(equation, pool.at(column)) for column in columns], shape)]


def _on_scalars(equation: Any, scalars: list[Any]) -> Any:
    axes = axes_of(*scalars)
    (result,) = bind(equation, [promoted(s, axes) for s in scalars])
    return result


def _pvary(pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    """A constant stays what it is, lest an index be lost from sight; operations promote it where they must."""
    axes = frozenset(equation.params["axes"])
    scalars = [promoted(s, axes) if isinstance(s, Tracer) else s for s in pool.at(operands[0])]
    return [pool.store(scalars, operands[0].shape)]


# Moving entries.


def _moved(move: Callable[..., Any], pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    del pool
    result = move(operands, equation.params, equation.outvars[0].aval.shape)
    return result if isinstance(result, list) else [result]


def _moved_by(
    indices: slice, move: Callable[..., Any], pool: Pool, equation: Any, operands: list[Places]
) -> list[Places] | None:
    """Where the indices are known."""
    numbers = [
        pool.constants(p, a.aval.dtype) for p, a in zip(operands[indices], equation.invars[indices], strict=True)
    ]
    if any(n is None for n in numbers):
        return None
    result = move(operands, numbers, equation.params, equation.outvars[0].aval.shape)
    return None if result is None else [result]


def _iota(pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    del operands
    parameters, kind = equation.params, equation.outvars[0].aval
    counted = np.indices(kind.shape)[parameters["dimension"]].astype(parameters["dtype"])
    return [pool.store(list(counted.flat), kind.shape)]


# Sums and their like.


def _fold(operation: Callable[[Any, Any], Any], pool: Pool, equation: Any, operands: list[Places]) -> Any:
    if not operands[0].size:
        return None
    axes, shape = equation.params["axes"], equation.outvars[0].aval.shape
    layers = np.moveaxis(operands[0], axes, range(len(axes))).reshape(-1, math.prod(shape))
    return [pool.store([reduce(operation, pool.at(column)) for column in layers.T], shape)]


def _dot_general(pool: Pool, equation: Any, operands: list[Places]) -> Any:
    if not operands[0].size:
        return None
    contract, batch = equation.params["dimension_numbers"]

    def arranged(value: Places, contracted: Any, batched: Any) -> Places:
        free = [a for a in range(value.ndim) if a not in (*contracted, *batched)]
        sizes = [math.prod(value.shape[a] for a in axes) for axes in (batched, free, contracted)]
        return value.transpose((*batched, *free, *contracted)).reshape(sizes)

    left, right = (arranged(p, c, b) for p, c, b in zip(operands, contract, batch, strict=True))
    sums = [
        reduce(jax.lax.add, map(jax.lax.mul, pool.at(row), pool.at(column)))
        for rows, columns in zip(left, right, strict=True)
        for row in rows
        for column in columns
    ]
    return [pool.store(sums, equation.outvars[0].aval.shape)]


# The rules.


def _elementwise(names: str, cheap: bool, *parameters: str) -> dict[str, Rule]:
    return {name: Rule(_each, _any(*parameters), cheap) for name in names.split()}


def _folding(operation: Callable[[Any, Any], Any]) -> Rule:
    understood = {**_any("axes"), **_only(None, "out_sharding")}
    return Rule(partial(_fold, operation), understood, cheap=True, takes=_one_kind_of_number)


RULES: dict[str, Rule] = {
    **_elementwise(
        "abs add add_any and ceil clamp copy eq floor ge gt is_finite le lt max min ne neg not or select_n sign square "
        "stop_gradient sub xor",
        True,
    ),
    **_elementwise("cos sin", True, "accuracy"),
    **_elementwise("mul", True, "out_dtype"),
    **_elementwise("acos acosh asin asinh atan atan2 atanh cosh div erf erf_inv lgamma nextafter pow rem sinh", False),
    **_elementwise("cbrt erfc exp exp2 expm1 log log1p logistic rsqrt sqrt tan tanh", False, "accuracy"),
    **_elementwise("integer_pow", True, "y"),
    **_elementwise("reduce_precision", False, "exponent_bits", "mantissa_bits"),
    **_elementwise("round", False, "rounding_method"),
    "convert_element_type": Rule(_each, {**_any("new_dtype", "weak_type"), **_only(None, "sharding")}, cheap=True),
    "pvary": Rule(_pvary, _any("axes"), cheap=True),
    **{
        name: Rule(partial(_moved, move), {**_any(*parameters), **_only(None, "sharding")}, cheap=True)
        for name, (move, parameters) in MOVES.items()
    },
    **{
        name: Rule(
            partial(_moved_by, indices, move),
            {**_any(*parameters), **_only(None, "update_jaxpr"), **_only((), "update_consts")},
            cheap=name.startswith("dynamic"),
        )
        for name, (move, indices, parameters) in INDEXED.items()
    },
    "iota": Rule(_iota, {**_any("dtype", "shape", "dimension"), **_only(None, "sharding")}, cheap=True),
    "dot_general": Rule(
        _dot_general,
        {
            **_any("dimension_numbers", "preferred_element_type"),  # the latter shows in the dtype of the result
            "precision": _precision,
            **_only(None, "out_sharding"),
        },
        cheap=True,
        takes=_one_kind_of_number,
    ),
    "reduce_max": _folding(jax.lax.max),
    "reduce_min": _folding(jax.lax.min),
    "reduce_prod": _folding(jax.lax.mul),
    "reduce_sum": _folding(jax.lax.add),
}
