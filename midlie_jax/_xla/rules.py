"""The rules by which `replay.py` computes single operations on scalars, one rule per JAX primitive.

A rule lists the parameters of its primitive and their supported values. An operation with any other parameter or value
is executed on arrays instead, so a parameter added by a later version of JAX is never ignored. A rule gives the same
result as its primitive, except for the sign of a zero (which XLA does not preserve either) and the order in which the
terms of a sum are added.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from . import budgets
from .internals import ClosedJaxpr, ShapedArray, Tracer, bind
from .mesh import axes_of, is_number, promoted

Parameters = Mapping[str, Any]
Places = np.ndarray  # integers: the positions of the entries of an array in a pool of scalars
Shape = tuple[int, ...]


class Pool:
    """The scalars of a replay; an array is represented by positions, an integer array of indices into `scalars`."""

    def __init__(self) -> None:
        self.scalars: list[Any] = []

    def store(self, scalars: Sequence[Any], shape: Shape) -> Places:
        """Adds the entries of an array of this shape, in row-major order, and returns their positions."""
        first = len(self.scalars)
        self.scalars.extend(scalars)
        return np.arange(first, len(self.scalars)).reshape(shape)

    def at(self, places: Any) -> list[Any]:
        """The scalars at these positions, in row-major order."""
        return [self.scalars[i] for i in np.ravel(places)]

    def constants(self, places: Places, dtype: Any) -> np.ndarray | None:
        """The entries at these positions as a NumPy array; None if any of them is traced."""
        numbers = self.at(places)
        if any(isinstance(n, Tracer) for n in numbers):
            return None
        return np.array([np.asarray(n) for n in numbers], dtype).reshape(places.shape)


class Rule(NamedTuple):
    """How one primitive is replayed."""

    # maps positions of the operands to positions of the results, or to None if it must be executed on arrays
    replay: Callable[[Pool, Any, list[Places]], list[Places] | None]
    # for each supported parameter, a predicate for its supported values
    understood: Mapping[str, Callable[[Any], bool]]
    cheap: bool  # whether XLA's CPU compiler repeats the operation instead of storing its result
    # whether the rule applies to operands and results with these dtypes
    accepts: Callable[[list[Any]], bool] = lambda dtypes: True
    moves: bool = False  # whether the operation only moves entries, which takes no time


def rule_for(equation: Any) -> Rule | None:
    """The rule for an operation, or None; the sizes of its arrays are not considered."""
    rule = RULES.get(equation.primitive.name)
    if rule is None or not _understands(rule.understood, equation.params):
        return None
    dtypes = [atom.aval.dtype for atom in (*equation.invars, *equation.outvars)]
    return rule if rule.accepts(dtypes) else None


def body_of(equation: Any) -> ClosedJaxpr | None:
    """The function that a plain `jit` call executes; None for any other operation."""
    if equation.primitive.name != "jit" or not _understands(_JIT, equation.params):
        return None
    return equation.params["jaxpr"]


def is_expensive(equation: Any) -> bool:
    """Whether XLA's CPU compiler stores the result of an operation instead of repeating it, or it has no rule.

    A function with a custom derivative, such as a reciprocal root without a root, counts by its operations.
    """
    own = equation.params.get("call_jaxpr") if equation.primitive.name == "custom_jvp_call" else None
    body = body_of(equation) or own
    if body is not None:
        return any(map(is_expensive, body.jaxpr.eqns))
    rule = rule_for(equation)
    return rule is None or not rule.cheap or equation.params.get("y", 1) < 0  # `y` is the exponent of integer_pow


def has_rules(closed: ClosedJaxpr) -> bool:
    """Whether every operation of a traced function has a rule and small arrays, or operates on scalars only."""

    def has_rule(equation: Any) -> bool:
        body = body_of(equation)
        if body is not None:
            return has_rules(body)
        return is_on_scalars(equation) or (rule_for(equation) is not None and _all_fit(equation))

    return all(map(has_rule, closed.jaxpr.eqns))


def is_on_scalars(equation: Any) -> bool:
    """Whether an operation has only scalar operands; for a plain `jit` call, every operation in it."""
    body = body_of(equation)
    if body is not None:
        return all(map(is_on_scalars, body.jaxpr.eqns))
    return all(getattr(atom.aval, "shape", None) == () for atom in (*equation.invars, *equation.outvars))


def count_operations(closed: ClosedJaxpr) -> int:
    bodies = ((equation, body_of(equation)) for equation in closed.jaxpr.eqns)
    return sum(1 if body is None else count_operations(body) for _, body in bodies)


def count_scalar_operations(closed: ClosedJaxpr) -> tuple[int, int]:
    """The number of operations on scalars in the replay of a traced function, and of the operations they replace.

    Moves are not counted. An operation on an array that is too large to split counts as its number of entries.
    """
    scalars = operations = 0
    for equation in closed.jaxpr.eqns:
        body = body_of(equation)
        if body is not None:
            inner, number = count_scalar_operations(body)
        elif (rule := RULES.get(equation.primitive.name)) and rule.moves and _all_fit(equation):
            continue
        else:
            inner, number = _scalar_operations(equation), 1
        scalars, operations = scalars + inner, operations + number
    return scalars, operations


def _all_fit(equation: Any) -> bool:
    return all(fits(atom.aval) for atom in (*equation.invars, *equation.outvars))


def _entries(atoms: Any) -> int:
    return sum(math.prod(atom.aval.shape) for atom in atoms if fits(atom.aval))


def _scalar_operations(equation: Any) -> int:
    if not _all_fit(equation):
        return _entries(equation.invars) + _entries(equation.outvars)
    if equation.primitive.name == "dot_general":
        (contracted, _), _ = equation.params["dimension_numbers"]
        terms = math.prod(equation.invars[0].aval.shape[axis] for axis in contracted)
        return 2 * terms * _entries(equation.outvars)
    if equation.primitive.name.startswith("reduce_"):
        return _entries(equation.invars)
    return _entries(equation.outvars)


def fits(aval: Any) -> bool:
    """Whether values of this type are split into scalars: small arrays of numbers, but not keys or references."""
    return isinstance(aval, ShapedArray) and is_number(aval) and math.prod(aval.shape) <= budgets.SCALAR_ENTRIES


# Predicates for the values of parameters.


def _understands(understood: Mapping[str, Callable[[Any], bool]], parameters: Parameters) -> bool:
    return all(name in understood and understood[name](value) for name, value in parameters.items())


def _any(*names: str) -> dict[str, Callable[[Any], bool]]:
    return {name: lambda value: True for name in names}


def _exactly(accepted: Any, *names: str) -> dict[str, Callable[[Any], bool]]:
    return {name: lambda value: type(value) is type(accepted) and value == accepted for name in names}


def _unsharded(name: str) -> dict[str, Callable[[Any], bool]]:
    """No sharding, or one that divides no axis of the array, which JAX records within `jax.shard_map`."""
    return {name: lambda value: value is None or all(part is None for part in getattr(value, "spec", (True,)))}


def _is_plain_precision(value: Any) -> bool:
    """Whether scalars meet the requested precision, which may be any `jax.lax.Precision` but not a named algorithm."""
    pair = value if isinstance(value, tuple) else (value,)
    return all(part is None or isinstance(part, jax.lax.Precision) for part in pair)


@cache
def _plain_jit() -> Parameters:
    return jax.make_jaxpr(jax.jit(lambda x: x))(0.0).eqns[0].params


def _as_plain_jit(*names: str) -> dict[str, Callable[[Any], bool]]:
    return {n: lambda value, n=n: all(part == plain for part in value for plain in _plain_jit()[n]) for n in names}


# The parameters of a jit call that can be replayed. Donation and inlining have no effect inside another jit.
_JIT = {
    **_any("jaxpr", "name", "donated_invars", "ctx_mesh", "keep_unused", "inline"),
    **_as_plain_jit("in_shardings", "out_shardings", "in_layouts", "out_layouts"),
    **_exactly((), "compiler_options_kvs"),
}


def _same_summable_dtype(dtypes: list[Any]) -> bool:
    """Whether all dtypes are equal, and float32, float64 or an integer; JAX adds smaller floats in a larger dtype."""
    return all(d == dtypes[0] for d in dtypes) and (
        dtypes[0] in (np.float32, np.float64) or jnp.issubdtype(dtypes[0], np.integer)
    )


# Elementwise operations: the operation is applied to each entry, with all its parameters.


def _replay_entries(pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    shape = equation.outvars[0].aval.shape
    columns = zip(*(np.broadcast_to(p, shape).flat for p in operands), strict=True)
    results: list[Any] = []
    for column in columns:
        scalars = pool.at(column)
        axes = axes_of(*scalars)
        results += bind(equation, [promoted(s, axes) for s in scalars])
    return [pool.store(results, shape)]


def _replay_pvary(pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    """Promotes only the traced entries: a constant stays a NumPy value, which can be an index."""
    axes = frozenset(equation.params["axes"])
    scalars = [promoted(s, axes) if isinstance(s, Tracer) else s for s in pool.at(operands[0])]
    return [pool.store(scalars, operands[0].shape)]


# Operations that only move entries of arrays, on positions. A move is called with the positions of its operands, the
# parameters of the primitive and the shape of its (first) result, and returns the positions of the results.


def _broadcast(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    expanded = [1] * len(shape)
    for axis, size in zip(parameters["broadcast_dimensions"], operands[0].shape, strict=True):
        expanded[axis] = size
    return np.broadcast_to(operands[0].reshape(expanded), shape)


def _reshape(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    permutation = parameters["dimensions"]
    return (operands[0] if permutation is None else operands[0].transpose(permutation)).reshape(shape)


def _slice(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    strides = parameters["strides"] or (None,) * len(shape)
    return operands[0][tuple(map(slice, parameters["start_indices"], parameters["limit_indices"], strides))]


def _pad(operands: list[Places], parameters: Any, shape: Shape) -> Places:
    """Negative padding removes entries at the edges; interior padding goes between the entries."""
    source, filling = operands
    targets, sources = [], []
    for (low, _, interior), size, out in zip(parameters["padding_config"], source.shape, shape, strict=True):
        positions = low + (interior + 1) * np.arange(size)
        sources.append(np.flatnonzero((positions >= 0) & (positions < out)))
        targets.append(positions[sources[-1]])
    result = np.full(shape, filling)
    result[np.ix_(*targets)] = source[np.ix_(*sources)]
    return result


def _split(operands: list[Places], parameters: Any, shape: Shape) -> list[Places]:
    return list(np.split(operands[0], np.cumsum(parameters["sizes"])[:-1], axis=parameters["axis"]))


def _unstack(operands: list[Places], parameters: Any, shape: Shape) -> list[Places]:
    return [np.asarray(part) for part in np.moveaxis(operands[0], parameters["axis"], 0)]


# Moves that depend on index operands: `move(operands, indices, parameters, shape)`.


def _window(source: Places, starts: list[Any], shape: Shape) -> tuple[slice, ...]:
    """The slices of a window of this shape. As in XLA, a window that would exceed the array is shifted back inside."""
    begin = [min(max(int(s), 0), n - m) for s, n, m in zip(starts, source.shape, shape, strict=True)]
    return tuple(slice(b, b + m) for b, m in zip(begin, shape, strict=True))


def _dynamic_slice(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places:
    return operands[0][_window(operands[0], indices, shape)]


def _dynamic_update_slice(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places:
    result = operands[0].copy()
    result[_window(result, indices, operands[1].shape)] = operands[1]
    return result


def _gather(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places | None:
    # Entries are numbered from 1; an out-of-bounds index reads the fill value 0.
    numbers = np.arange(1, operands[0].size + 1, dtype=np.int32).reshape(operands[0].shape)
    with jax.ensure_compile_time_eval():
        taken = jax.lax.gather_p.bind(jnp.asarray(numbers), jnp.asarray(indices[0]), **{**parameters, "fill_value": 0})
        taken = np.asarray(taken)
    return None if np.any(taken == 0) else operands[0].reshape(-1)[taken - 1]


def _scatter(operands: list[Places], indices: Any, parameters: Any, shape: Shape) -> Places:
    with jax.ensure_compile_time_eval():
        source, update = (jnp.asarray(operands[i].astype(np.int32)) for i in (0, 2))
        return np.asarray(jax.lax.scatter_p.bind(source, jnp.asarray(indices[0]), update, **parameters))


def _replay_move(move: Callable[..., Any], pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    result = move(operands, equation.params, equation.outvars[0].aval.shape)
    return result if isinstance(result, list) else [result]


def _replay_indexed_move(
    indices: slice, move: Callable[..., Any], pool: Pool, equation: Any, operands: list[Places]
) -> list[Places] | None:
    """A move that depends on index operands; None if the indices are not known while tracing."""
    index_values = [
        pool.constants(p, a.aval.dtype) for p, a in zip(operands[indices], equation.invars[indices], strict=True)
    ]
    if any(value is None for value in index_values):
        return None
    result = move(operands, index_values, equation.params, equation.outvars[0].aval.shape)
    return None if result is None else [result]


def _replay_iota(pool: Pool, equation: Any, operands: list[Places]) -> list[Places]:
    parameters, aval = equation.params, equation.outvars[0].aval
    positions = np.indices(aval.shape)[parameters["dimension"]].astype(parameters["dtype"])
    return [pool.store(list(positions.flat), aval.shape)]


# Reductions and matrix products.


def _replay_reduction(operation: Callable[[Any, Any], Any], pool: Pool, equation: Any, operands: list[Places]) -> Any:
    if not operands[0].size:
        return None
    axes, shape = equation.params["axes"], equation.outvars[0].aval.shape
    layers = np.moveaxis(operands[0], axes, range(len(axes))).reshape(-1, math.prod(shape))
    return [pool.store([reduce(operation, pool.at(column)) for column in layers.T], shape)]


def _replay_dot_general(pool: Pool, equation: Any, operands: list[Places]) -> Any:
    if not operands[0].size:
        return None
    contract, batch = equation.params["dimension_numbers"]

    def arranged(value: Places, contracted: Any, batched: Any) -> Places:
        """The positions with three axes: batch, free and contracted."""
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


# The table of rules.


def _elementwise(names: str, cheap: bool, *parameters: str) -> dict[str, Rule]:
    return {name: Rule(_replay_entries, _any(*parameters), cheap) for name in names.split()}


def _move(move: Callable[..., Any], *parameters: str) -> Rule:
    understood = {**_any(*parameters), **_unsharded("sharding")}
    return Rule(partial(_replay_move, move), understood, cheap=True, moves=True)


def _indexed_move(move: Callable[..., Any], indices: slice, cheap: bool, *parameters: str) -> Rule:
    understood = {**_any(*parameters), **_exactly(None, "update_jaxpr"), **_exactly((), "update_consts")}
    return Rule(partial(_replay_indexed_move, indices, move), understood, cheap, moves=True)


_INDEXING = "dimension_numbers", "unique_indices", "indices_are_sorted", "mode"


def _reduction_rule(operation: Callable[[Any, Any], Any]) -> Rule:
    understood = {**_any("axes"), **_unsharded("out_sharding")}
    return Rule(partial(_replay_reduction, operation), understood, cheap=True, accepts=_same_summable_dtype)


RULES: dict[str, Rule] = {
    **_elementwise(
        "abs add add_any and ceil clamp copy eq floor ge gt is_finite le lt max min ne neg not or select_n sign square "
        "stop_gradient sub xor",
        True,
    ),
    **_elementwise("shift_left shift_right_arithmetic shift_right_logical", True),
    **_elementwise("bitcast_convert_type", True, "new_dtype"),
    **_elementwise("cos sin", True, "accuracy"),
    **_elementwise("mul", True, "out_dtype"),
    **_elementwise("acos acosh asin asinh atan atan2 atanh cosh div erf erf_inv lgamma nextafter pow rem sinh", False),
    **_elementwise("cbrt erfc exp exp2 expm1 log log1p logistic rsqrt sqrt tan tanh", False, "accuracy"),
    **_elementwise("integer_pow", True, "y"),
    **_elementwise("name", True, "name"),  # marks a value that a derivative may store
    **_elementwise("reduce_precision", False, "exponent_bits", "mantissa_bits"),
    **_elementwise("round", False, "rounding_method"),
    "convert_element_type": Rule(
        _replay_entries, {**_any("new_dtype", "weak_type"), **_unsharded("sharding")}, cheap=True
    ),
    "pvary": Rule(_replay_pvary, _any("axes"), cheap=True, moves=True),
    "iota": Rule(
        _replay_iota, {**_any("dtype", "shape", "dimension"), **_unsharded("sharding")}, cheap=True, moves=True
    ),
    "broadcast_in_dim": _move(_broadcast, "shape", "broadcast_dimensions"),
    "concatenate": _move(lambda operands, p, shape: np.concatenate(operands, axis=p["dimension"]), "dimension"),
    "pad": _move(_pad, "padding_config"),
    "reshape": _move(_reshape, "new_sizes", "dimensions"),
    "rev": _move(lambda operands, p, shape: np.flip(operands[0], p["dimensions"]), "dimensions"),
    "slice": _move(_slice, "start_indices", "limit_indices", "strides"),
    "split": _move(_split, "sizes", "axis"),
    "squeeze": _move(lambda operands, p, shape: operands[0].reshape(shape), "dimensions"),
    "stack": _move(lambda operands, p, shape: np.stack(operands, axis=p["axis"]), "axis"),
    "transpose": _move(lambda operands, p, shape: operands[0].transpose(p["permutation"]), "permutation"),
    "unstack": _move(_unstack, "axis"),
    "dynamic_slice": _indexed_move(_dynamic_slice, slice(1, None), True, "slice_sizes"),
    "dynamic_update_slice": _indexed_move(_dynamic_update_slice, slice(2, None), True),
    "gather": _indexed_move(_gather, slice(1, 2), False, "slice_sizes", "fill_value", *_INDEXING),
    "scatter": _indexed_move(_scatter, slice(1, 2), False, *_INDEXING),
    "dot_general": Rule(
        _replay_dot_general,
        {
            **_any("dimension_numbers", "preferred_element_type"),  # the second is the dtype of the result
            "precision": _is_plain_precision,
            **_unsharded("out_sharding"),
        },
        cheap=True,
        accepts=_same_summable_dtype,
    ),
    "reduce_max": _reduction_rule(jax.lax.max),
    "reduce_min": _reduction_rule(jax.lax.min),
    "reduce_prod": _reduction_rule(jax.lax.mul),
    "reduce_sum": _reduction_rule(jax.lax.add),
}
