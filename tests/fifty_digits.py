"""A JAX function in arithmetic of fifty digits: an oracle for derivatives, as differences of what it returns.

`in_fifty_digits` writes each operation of a trace as a line of Python on numbers of gmpy2, in arrays of objects.
"""

# pyright: reportAttributeAccessIssue=false
# gmpy2 says nothing of its names to a type checker.
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import gmpy2
import jax
import numpy as np
from jax.extend import core

from midlie_jax._xla.internals import loop_counts

BITS = 200  # 60 digits, so that differences of values over 1e-20 have forty


def in_fifty_digits(function: Callable[..., Any], *arguments: Any) -> Callable[..., list[Any]]:
    """The function in fifty digits, of numbers or object arrays; it returns the leaves of results."""
    closed = jax.make_jaxpr(function)(*arguments)
    gmpy2.get_context().precision = BITS
    return _Code().function(closed.jaxpr, closed.consts)


def exact(array: Any) -> Any:
    return _elementwise(_number)(np.array(array)) if np.ndim(array) else _number(array)


def _number(value: Any) -> Any:
    value = np.asarray(value).item()
    return gmpy2.mpfr(value) if isinstance(value, float) else value


def _elementwise(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of numbers, also for arrays of objects, which it broadcasts."""

    def call(*values: Any) -> Any:
        if any(isinstance(x, np.ndarray) for x in values):
            return np.frompyfunc(function, len(values), 1)(*values)
        return function(*values)

    return call


def _bits(x: Any, dtype: Any) -> Any:
    """The 64 bits of a float as an integer, or the reverse."""
    if np.issubdtype(dtype, np.floating):
        return gmpy2.mpfr(struct.unpack("d", struct.pack("q", x))[0])
    return struct.unpack("q", struct.pack("d", float(x)))[0]


def _converted(x: Any, dtype: Any) -> Any:
    if np.issubdtype(dtype, np.floating):
        return gmpy2.mpfr(x)
    return bool(x) if np.issubdtype(dtype, np.bool_) else int(x)


def _signed(x: int) -> int:
    """An integer with the overflow of 64 bits."""
    return (x + 2**63) % 2**64 - 2**63


# Operations on scalars that Python can write; everything else is called.
_INFIX = {
    "add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/",
    "eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">=",
}  # fmt: skip
_OF_NUMBERS = {
    "abs": abs,
    "neg": lambda x: -x,
    "max": max,
    "min": min,
    "and": lambda x, y: x & y,
    "or": lambda x, y: x | y,
    "not": lambda x: not x if isinstance(x, bool) else ~x,
    "is_finite": lambda x: bool(gmpy2.is_finite(x)),
    "shift_left": lambda x, y: _signed(x << y),
    "shift_right_arithmetic": lambda x, y: x >> y,
    "select_n": lambda which, *cases: cases[int(which)],
}


def _slice(x: Any, start_indices: Any, limit_indices: Any, strides: Any) -> Any:
    steps = strides or [1] * len(start_indices)
    return x[tuple(slice(*part) for part in zip(start_indices, limit_indices, steps, strict=True))]


def _broadcast(x: Any, shape: Any, broadcast_dimensions: Any, **_: Any) -> Any:
    inner = [1] * len(shape)
    for size, dimension in zip(np.shape(x), broadcast_dimensions, strict=True):
        inner[dimension] = size
    return np.broadcast_to(np.asarray(x, object).reshape(inner), shape)


def _stacked(rows: Any, axis: int = 0) -> Any:
    return np.stack([np.asarray(x, object) for x in rows], axis)


def _scalar(x: Any) -> Any:
    """The number in an array without dimensions."""
    return x if x.ndim else x.item()


_OF_ARRAYS: dict[str, Callable[..., Any]] = {
    "slice": _slice,
    "squeeze": lambda x, dimensions: _scalar(np.squeeze(x, dimensions)),
    "reshape": lambda x, new_sizes, **_: _scalar(np.reshape(x, new_sizes)),
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda *x, dimension: np.concatenate(x, dimension),
    "stack": lambda *x, axis: _stacked(x, axis),
    "iota": lambda shape, dimension, **_: _broadcast(np.array(range(shape[dimension]), object), shape, [dimension]),
    "reduce_and": lambda x, axes, **_: _scalar(np.asarray(np.all(np.asarray(x, bool), tuple(axes)), object)),
    "reduce_sum": lambda x, axes, **_: _scalar(np.asarray(np.sum(np.asarray(x, object), tuple(axes)), object)),
    "reduce_max": lambda x, axes, **_: _scalar(np.asarray(np.max(np.asarray(x, object), tuple(axes)), object)),
    "reduce_min": lambda x, axes, **_: _scalar(np.asarray(np.min(np.asarray(x, object), tuple(axes)), object)),
    "convert_element_type": lambda x, new_dtype, **_: _elementwise(partial(_converted, dtype=new_dtype))(x),
    "bitcast_convert_type": lambda x, new_dtype: _elementwise(partial(_bits, dtype=new_dtype))(x),
}
_CALLS = {"jit": "jaxpr", "remat2": "jaxpr", "custom_jvp_call": "call_jaxpr"}
_AS_IT_IS = {"fuse", "name", "stop_gradient", "of_rows"}  # the first operands are the results


def _scan(body: Callable[..., list[Any]], count: int, carried: int, order: range, *values: Any) -> list[Any]:
    constants, carry, inputs = values[:count], values[count : count + carried], values[count + carried :]
    rows: list[Any] = [None] * len(order)
    for i in order:
        result = body(*constants, *carry, *(x[i] for x in inputs))
        carry, rows[i] = result[:carried], result[carried:]
    return [*carry, *(_stacked(column) for column in zip(*rows, strict=True))]


class _Code:
    """Python code of a trace. Constants and functions that the code calls are the globals `g...`."""

    def __init__(self) -> None:
        self.globals: dict[str, Any] = {}
        self.names: dict[Any, str] = {}
        self.lines: list[str] = []
        self.count = 0

    def function(self, jaxpr: Any, constants: Any) -> Callable[..., list[Any]]:
        bound = [self.kept(exact(constant)) for constant in constants]
        arguments = [self.fresh() for _ in jaxpr.invars]
        outer, self.lines = self.lines, []
        results = self.write(jaxpr, bound + arguments)
        text = "\n    ".join([f"def run({', '.join(arguments)}):", *self.lines, f"return [{', '.join(results)}]"])
        self.lines = outer
        local: dict[str, Any] = {}
        exec(compile(text, "<trace>", "exec"), self.globals, local)
        return local["run"]

    def write(self, jaxpr: Any, given: list[str]) -> list[str]:
        """Writes the lines of a trace; returns the names of its results."""
        self.names.update(zip([*jaxpr.constvars, *jaxpr.invars], given, strict=True))
        for equation in jaxpr.eqns:
            results = self.results(equation, [self.name(x) for x in equation.invars])
            self.names.update(zip(equation.outvars, results, strict=True))
        return [self.name(x) for x in jaxpr.outvars]

    def name(self, variable: Any) -> str:
        return self.kept(exact(variable.val)) if isinstance(variable, core.Literal) else self.names[variable]

    def fresh(self) -> str:
        self.count += 1
        return f"v{self.count}"

    def kept(self, value: Any) -> str:
        self.count += 1
        self.globals[f"g{self.count}"] = value
        return f"g{self.count}"

    def results(self, equation: Any, given: list[str]) -> list[str]:
        """Writes one operation; returns the names of its results."""
        kind, parameters = equation.primitive.name, equation.params
        if kind in _AS_IT_IS:
            return given[: len(equation.outvars)]
        if kind in _CALLS:
            inner = parameters[_CALLS[kind]]
            jaxpr, constants = (inner.jaxpr, inner.consts) if hasattr(inner, "consts") else (inner, ())
            return self.write(jaxpr, [self.kept(exact(constant)) for constant in constants] + given)
        if kind == "scan":
            body = self.function(parameters["jaxpr"].jaxpr, parameters["jaxpr"].consts)
            order = range(parameters["length"])
            order = order[::-1] if parameters["reverse"] else order
            call = partial(_scan, body, *loop_counts(equation), order)
            results = [self.fresh() for _ in equation.outvars]
            self.lines.append(f"[{', '.join(results)}] = {self.kept(call)}({', '.join(given)})")
            return results
        scalar = not any(x.aval.shape for x in (*equation.invars, *equation.outvars))
        result = self.fresh()
        if scalar and kind in _INFIX and np.issubdtype(equation.invars[0].aval.dtype, np.floating):
            self.lines.append(f"{result} = {given[0]} {_INFIX[kind]} {given[1]}")
            return [result]
        if kind in _INFIX:
            operation = _elementwise(eval(f"lambda x, y: x {_INFIX[kind]} y"))
        elif kind in _OF_NUMBERS:
            operation = _OF_NUMBERS[kind] if scalar else _elementwise(_OF_NUMBERS[kind])
        elif kind in _OF_ARRAYS:
            operation = partial(_OF_ARRAYS[kind], **parameters)
        else:
            raise NotImplementedError(f"the oracle has no rule for JAX's operation {kind!r}; add it to `_OF_ARRAYS`")
        self.lines.append(f"{result} = {self.kept(operation)}({', '.join(given)})")
        return [result]
