"""Runs a function written on small arrays entry by entry, so that it fuses into a step written on scalars.

A user's torque is written on (3,) and (4,) arrays: stacks, slices, cross products, small matrix products, perhaps
the gradient of a potential. Inside a fused loop XLA evaluates each stacked array once per entry read, which
multiplies at every stacking; a torque of ten lines can run a thousand times slower than it should, or never
finish compiling. So the function is traced once, and its operations are replayed on scalars: moving entries about
costs nothing, products become sums of scalars. Operations that have no rule here (loops, solvers, large tables)
are replayed as they are.

An array being replayed is an integer array of places in a pool of scalars. Moving entries is then indexing, done
by numpy; only arithmetic touches the pool.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Literal
from jax.interpreters import partial_eval

# Arrays of more entries than this stay arrays.
_LARGEST = 64

_CALLS = ("jit", "pjit", "closed_call")


def _names(*lines: str) -> frozenset[str]:
    return frozenset(name for line in lines for name in line.split())


_ELEMENTWISE = _names(
    "abs acos acosh add add_any and asin asinh atan atan2 atanh cbrt ceil clamp convert_element_type copy copy_p cos",
    "cosh div eq erf erf_inv erfc exp exp2 expm1 floor ge gt integer_pow is_finite le lgamma log log1p logistic lt",
    "max min mul ne neg nextafter not or pow reduce_precision rem round rsqrt select_n sign sin sinh sqrt square",
    "stop_gradient sub tan tanh xor",
)

# What XLA's CPU compiler will repeat rather than store; integer_pow where its exponent is positive.
_CHEAP = _names(
    "abs add add_any and broadcast_in_dim ceil clamp concatenate convert_element_type copy copy_p cos dot_general",
    "dynamic_slice dynamic_update_slice eq floor ge gt integer_pow iota is_finite le lt max min mul ne neg not or pad",
    "reduce_max reduce_min reduce_prod reduce_sum reshape rev select_n sign sin slice split square squeeze stack",
    "stop_gradient sub transpose unstack xor",
)


class Traits(NamedTuple):
    """What a function is like.

    Attributes:
        dear: whether it holds anything that XLA counts as expensive, or that is replayed as it is.
        reads: its arguments, with True for each leaf that the result depends on.
    """

    dear: bool
    reads: Any


def traits(function: Callable[..., Any], *arguments: Any) -> Traits:
    """Found by tracing the function once."""
    closed = jax.make_jaxpr(function)(*arguments)
    _, used = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    return Traits(_has_dear(closed), jax.tree.unflatten(jax.tree.structure(arguments), used))


def _has_dear(closed: ClosedJaxpr) -> bool:
    for equation in closed.jaxpr.eqns:
        name, inner = equation.primitive.name, equation.params.get("jaxpr")
        if name in _CALLS and isinstance(inner, ClosedJaxpr):
            dear = _has_dear(inner)
        else:
            dear = name not in _CHEAP or equation.params.get("y", 1) < 0
        if dear:
            return True
    return False


class Packed(NamedTuple):
    """A vector given by its entries."""

    entries: tuple[Array, ...]


class _Entries(NamedTuple):
    """A small array given by the places of its entries in the pool."""

    places: np.ndarray


def by_components(function: Callable[..., Array], *arguments: Any) -> tuple[list[Any], jax.ShapeDtypeStruct]:
    """Evaluates `function` on arguments whose vectors are given by their entries.

    Args:
        function: returns one array.
        arguments: pytrees whose leaves are scalars, or `Packed` vectors, which the function sees as arrays.

    Returns:
        The entries of the result in order, and its shape and dtype.
    """
    pool: list[Any] = []
    leaves, structure = jax.tree.flatten(arguments, is_leaf=lambda x: isinstance(x, Packed))
    inputs, shapes = [], []
    for leaf in leaves:
        scalars = list(leaf.entries) if isinstance(leaf, Packed) else [leaf]
        shape = (len(scalars),) if isinstance(leaf, Packed) else ()
        inputs.append(_Entries(_store(pool, scalars, shape)))
        shapes.append(jax.ShapeDtypeStruct(shape, jnp.result_type(scalars[0])))
    closed, out = jax.make_jaxpr(function, return_shape=True)(*jax.tree.unflatten(structure, shapes))
    if not isinstance(out, jax.ShapeDtypeStruct):
        raise ValueError(f"the torque must return one array, got {type(out).__name__}; use jnp.stack([...]).")
    (result,) = _replay(pool, closed, inputs)
    places = result.places if isinstance(result, _Entries) else _taken_apart(pool, result).places
    return [pool[i] for i in places.flat], out


def _store(pool: list[Any], scalars: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    first = len(pool)
    pool.extend(scalars)
    return np.arange(first, len(pool)).reshape(shape)


def _taken_apart(pool: list[Any], value: Any) -> _Entries:
    shape = jnp.shape(value)
    return _Entries(_store(pool, [value[i] if i else value for i in np.ndindex(shape)], shape))


def _small(pool: list[Any], value: Any) -> Any:
    return _taken_apart(pool, value) if np.prod(jnp.shape(value), dtype=int) <= _LARGEST else value


def _array(pool: list[Any], value: Any, dtype: Any) -> Any:
    """The array again, for an operation that needs it whole."""
    if not isinstance(value, _Entries):
        return value
    places = value.places
    scalars = [jnp.asarray(pool[i], dtype) for i in places.flat]
    if not places.ndim:
        return scalars[0]
    return jnp.stack(scalars).reshape(places.shape) if scalars else jnp.zeros(places.shape, dtype)


def _replay(pool: list[Any], closed: ClosedJaxpr, inputs: Sequence[Any]) -> list[Any]:
    jaxpr = closed.jaxpr
    environment: dict[Any, Any] = {}

    def read(atom: Any) -> Any:
        return _small(pool, atom.val) if isinstance(atom, Literal) else environment[atom]

    environment.update(zip(jaxpr.constvars, (_small(pool, c) for c in closed.consts), strict=True))
    environment.update(zip(jaxpr.invars, inputs, strict=True))
    for equation in jaxpr.eqns:
        results = _apply(pool, equation, [read(atom) for atom in equation.invars])
        environment.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _apply(pool: list[Any], equation: Any, values: list[Any]) -> list[Any]:
    name, parameters = equation.primitive.name, equation.params
    inner = parameters.get("jaxpr")
    if name in _CALLS and isinstance(inner, ClosedJaxpr):
        return _replay(pool, inner, values)
    shapes = [atom.aval.shape for atom in equation.outvars]
    if all(isinstance(v, _Entries) for v in values) and all(np.prod(s, dtype=int) <= _LARGEST for s in shapes):
        places = [v.places for v in values]
        if name in _ELEMENTWISE:
            return [_Entries(_each(pool, equation, places, shapes[0]))]
        if name in _MOVES:
            moved = _MOVES[name](places, parameters, shapes)
            return [_Entries(p) for p in (moved if isinstance(moved, list) else [moved])]
        if name in _INDEXED:
            which, rule = _INDEXED[name]
            indices = [_constants(pool, p) for p in places[which]]
            moved = None if any(i is None for i in indices) else rule(places, indices, parameters, shapes)
            if moved is not None:
                return [_Entries(moved)]
        if name == "iota":
            counted = np.indices(shapes[0])[parameters["dimension"]].astype(parameters["dtype"])
            return [_small(pool, counted)]
        if name in _SUMS and places[0].size:
            return [_Entries(_SUMS[name](pool, places, parameters, shapes[0]))]
    return _as_it_is(pool, equation, values)


def _as_it_is(pool: list[Any], equation: Any, values: list[Any]) -> list[Any]:
    arrays = [_array(pool, v, atom.aval.dtype) for v, atom in zip(values, equation.invars, strict=True)]
    primitive = equation.primitive
    with equation.ctx.manager:
        results = primitive.bind(*arrays, **primitive.get_bind_params(equation.params))
    return [_small(pool, r) for r in (results if primitive.multiple_results else [results])]


def _each(pool: list[Any], equation: Any, places: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    columns = zip(*(np.broadcast_to(p, shape).flat for p in places), strict=True)
    name, bind, parameters = equation.primitive.name, equation.primitive.bind, equation.params
    if name in ("add", "add_any", "mul"):
        neutral = 1 if name == "mul" else 0
        return _store(pool, [_binary(bind, parameters, neutral, *(pool[i] for i in c)) for c in columns], shape)
    return _store(pool, [bind(*(pool[i] for i in column), **parameters) for column in columns], shape)


def _binary(bind: Callable[..., Any], parameters: Any, neutral: int, left: Any, right: Any) -> Any:
    """A sum without the zeros, a product without the ones, that differentiation leaves behind; XLA keeps them."""
    for constant, other in ((left, right), (right, left)):
        if not isinstance(constant, Tracer) and np.asarray(constant) == neutral and isinstance(other, Tracer):
            return other
    return bind(left, right, **parameters)


def _constants(pool: list[Any], places: np.ndarray) -> np.ndarray | None:
    """The integers themselves, where they are known while tracing."""
    numbers = [pool[i] for i in places.flat]
    if any(isinstance(n, Tracer) for n in numbers):
        return None
    return np.array([int(n) for n in numbers], dtype=np.int32).reshape(places.shape)


# Moving entries: from places to places.


def _broadcast(places: list[np.ndarray], parameters: Any, shapes: Any) -> np.ndarray:
    expanded = [1] * len(shapes[0])
    for axis, size in zip(parameters["broadcast_dimensions"], places[0].shape, strict=True):
        expanded[axis] = size
    return np.broadcast_to(places[0].reshape(expanded), shapes[0])


def _slice(places: list[np.ndarray], parameters: Any, shapes: Any) -> np.ndarray:
    del shapes
    strides = parameters["strides"] or (None,) * places[0].ndim
    return places[0][tuple(map(slice, parameters["start_indices"], parameters["limit_indices"], strides))]


def _pad(places: list[np.ndarray], parameters: Any, shapes: Any) -> np.ndarray:
    del shapes
    with jax.ensure_compile_time_eval():
        return np.asarray(jax.lax.pad(jnp.asarray(places[0]), jnp.asarray(places[1]), parameters["padding_config"]))


def _split(places: list[np.ndarray], parameters: Any, shapes: Any) -> list[np.ndarray]:
    del shapes
    return list(np.split(places[0], np.cumsum(parameters["sizes"])[:-1], axis=parameters["axis"]))


def _unstack(places: list[np.ndarray], parameters: Any, shapes: Any) -> list[np.ndarray]:
    del shapes
    return [np.asarray(part) for part in np.moveaxis(places[0], parameters["axis"], 0)]


_MOVES: dict[str, Callable[..., Any]] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda places, p, shapes: np.concatenate(places, axis=p["dimension"]),
    "pad": _pad,
    "reshape": lambda places, p, shapes: places[0].reshape(shapes[0]),
    "rev": lambda places, p, shapes: np.flip(places[0], p["dimensions"]),
    "slice": _slice,
    "split": _split,
    "squeeze": lambda places, p, shapes: places[0].reshape(shapes[0]),
    "stack": lambda places, p, shapes: np.stack(places, axis=p["axis"]),
    "transpose": lambda places, p, shapes: places[0].transpose(p["permutation"]),
    "unstack": _unstack,
}


# Moving entries by indices that are operands: (which operands, rule).


def _window(source: np.ndarray, starts: list[Any], shape: tuple[int, ...]) -> tuple[slice, ...]:
    """XLA moves a window that would stick out back inside."""
    begin = [min(max(int(s), 0), n - m) for s, n, m in zip(starts, source.shape, shape, strict=True)]
    return tuple(slice(b, b + m) for b, m in zip(begin, shape, strict=True))


def _dynamic_slice(places: list[np.ndarray], numbers: Any, parameters: Any, shapes: Any) -> np.ndarray:
    del parameters
    return places[0][_window(places[0], numbers, shapes[0])]


def _dynamic_update_slice(places: list[np.ndarray], numbers: Any, parameters: Any, shapes: Any) -> np.ndarray:
    del parameters, shapes
    result = places[0].copy()
    result[_window(result, numbers, places[1].shape)] = places[1]
    return result


def _gather(places: list[np.ndarray], numbers: Any, parameters: Any, shapes: Any) -> np.ndarray | None:
    del shapes
    # Numbered from one, so that a place filled in from out of bounds shows as none of them.
    order = np.arange(1, places[0].size + 1, dtype=np.int32).reshape(places[0].shape)
    parameters = {**parameters, "fill_value": 0}
    with jax.ensure_compile_time_eval():
        taken = np.asarray(jax.lax.gather_p.bind(jnp.asarray(order), jnp.asarray(numbers[0]), **parameters))
    return None if np.any(taken == 0) else places[0].reshape(-1)[taken - 1]


def _scatter(places: list[np.ndarray], numbers: Any, parameters: Any, shapes: Any) -> np.ndarray:
    del shapes
    with jax.ensure_compile_time_eval():
        source, update = (jnp.asarray(places[i].astype(np.int32)) for i in (0, 2))
        return np.asarray(jax.lax.scatter_p.bind(source, jnp.asarray(numbers[0]), update, **parameters))


_INDEXED: dict[str, tuple[slice, Callable[..., Any]]] = {
    "dynamic_slice": (slice(1, None), _dynamic_slice),
    "dynamic_update_slice": (slice(2, None), _dynamic_update_slice),
    "gather": (slice(1, 2), _gather),
    "scatter": (slice(1, 2), _scatter),
}


# Sums and their like.


def _fold(operation: Callable[[Any, Any], Any]) -> Callable[..., np.ndarray]:
    def rule(pool: list[Any], places: list[np.ndarray], parameters: Any, shape: tuple[int, ...]) -> np.ndarray:
        axes = parameters["axes"]
        layers = np.moveaxis(places[0], axes, range(len(axes))).reshape(-1, int(np.prod(shape, dtype=int)))
        return _store(pool, [reduce(operation, (pool[i] for i in column)) for column in layers.T], shape)

    return rule


def _dot_general(pool: list[Any], places: list[np.ndarray], parameters: Any, shape: tuple[int, ...]) -> np.ndarray:
    contract, batch = parameters["dimension_numbers"]

    def arranged(value: np.ndarray, contracted: Any, batched: Any) -> np.ndarray:
        free = [a for a in range(value.ndim) if a not in (*contracted, *batched)]
        sizes = [int(np.prod([value.shape[a] for a in axes], dtype=int)) for axes in (batched, free, contracted)]
        return value.transpose((*batched, *free, *contracted)).reshape(sizes)

    left, right = (arranged(p, c, b) for p, c, b in zip(places, contract, batch, strict=True))
    sums = [
        reduce(add, (pool[i] * pool[j] for i, j in zip(row, column, strict=True)))
        for rows, columns in zip(left, right, strict=True)
        for row in rows
        for column in columns
    ]
    return _store(pool, sums, shape)


_SUMS: dict[str, Callable[..., np.ndarray]] = {
    "dot_general": _dot_general,
    "reduce_max": _fold(jnp.maximum),
    "reduce_min": _fold(jnp.minimum),
    "reduce_prod": _fold(lambda x, y: x * y),
    "reduce_sum": _fold(add),
}
