"""Evaluates a function of small arrays entry by entry, so that it fuses into a step on scalars.

A user's torque is written for (3,) and (4,) arrays. Inside a fused loop XLA evaluates each stacked array once for every
entry that is read, and nested stacks multiply the run time: a torque of ten lines can run a thousand times slower than
necessary, or never finish compiling. The function is therefore traced once, and its operations are replayed on scalars.
Moving entries takes no time, and matrix products become sums of products of scalars. Operations without a rule (loops,
solvers, large tables) are executed on arrays. The same holds for a whole function that would need too many scalars,
such as a neural network; its loops are separate from the loop of the step.

During the replay an array is represented by the positions of its entries in a pool of scalars, an integer array of list
indices. Operations that move entries become NumPy indexing of the positions; only arithmetic adds scalars to the pool.
The rules for single operations are in `rules.py`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from . import budgets
from .fusion import split
from .internals import ClosedJaxpr, Literal, Tracer, bind, context_of, run_program, traced, used_inputs
from .mesh import axes_of, promoted
from .rules import (
    Pool,
    body_of,
    count_operations,
    count_scalar_operations,
    fits,
    has_rules,
    is_expensive,
    is_on_scalars,
    rule_for,
)


class Traits(NamedTuple):
    """Properties of a function, from its trace."""

    costly: bool  # whether it contains an operation that XLA treats as expensive or that has no rule
    # operations, scalars: number of operations, where one on arrays counts as one, and of operations on scalars in its
    # replay
    operations: int
    scalars: int
    on_scalars: bool  # whether it can be replayed completely on scalars
    reads: Any  # the arguments, with True for each leaf on which the result depends


def traits(function: Callable[..., Any], *arguments: Any) -> Traits:
    """The traits of a function called with these arguments; it is traced once and not run."""
    return _traits(traced(function, *arguments), arguments)


def _traits(closed: ClosedJaxpr, arguments: tuple[Any, ...]) -> Traits:
    used = used_inputs(closed)
    reads = jax.tree.unflatten(jax.tree.structure(arguments), used)
    costly, scalars = any(map(is_expensive, closed.jaxpr.eqns)), count_scalar_operations(closed)[0]
    return Traits(costly, count_operations(closed), scalars, has_rules(closed), reads)


class Traced(eqx.Module):
    """A function from its trace, with its arrays and the traced arrays that it closes over as leaves.

    A step reads small arrays by their entries (`by_entries`). Their cotangents are then numbers per body and leave the
    derivative of the step in the loop of the motion. For each entry of an array, XLA would compute the whole derivative
    again. The arrays in `given` are the same for all calls within a step.
    """

    constants: list[Any]
    given: list[Any]
    _program: "_Program" = eqx.field(static=True)

    @classmethod
    def of(cls, function: Callable[..., Any], given: Any, *arguments: Any) -> "tuple[Traced, Traits]":
        """function(given, *arguments) as a function of the arguments, and its traits; it is traced once and not run."""
        closed, result = jax.make_jaxpr(lambda *every: function(*every), return_shape=True)(given, *arguments)
        own = {id(x) for x in jax.tree.leaves(function)}
        marks = [isinstance(x, Tracer) or id(x) in own for x in closed.consts]
        constants = [x for x, mark in zip(closed.consts, marks, strict=True) if mark]

        def run(constants: list[Any], leaves: list[Any]) -> list[Any]:
            own = iter(constants)
            values = [next(own) if mark else x for x, mark in zip(closed.consts, marks, strict=True)]
            return run_program(closed, values, leaves)

        # The program must not hold the tracers: it outlives their trace in JAX's caches.
        first = jax.tree.leaves(given)
        program = jax.make_jaxpr(run)(constants, [*first, *jax.tree.leaves(arguments)])
        known = _Program(program, jax.tree.structure(result), _types(arguments), _suits_arrays(closed))
        found = _traits(closed, (given, *arguments))
        return cls(constants, first, known), found._replace(reads=found.reads[1:])

    def by_entries(self) -> "Traced":
        return Traced(self._spread(self.constants), self.given, self._program)

    def with_given(self, given: Any) -> "Traced":
        return Traced(self.constants, split(self._spread(jax.tree.leaves(given))), self._program)

    def _spread(self, arrays: list[Any]) -> list[Any]:
        # A function with its own loops keeps its arrays.
        return arrays if self._program.on_arrays else list(map(_Spread.of, arrays))

    def takes(self, *arguments: Any) -> bool:
        return _types(arguments) == self._program.types

    def __call__(self, *arguments: Any) -> Any:
        closed = self._program.closed
        arrays = [x.array() if isinstance(x, _Spread) else x for x in (*self.constants, *self.given)]
        results = run_program(closed, closed.consts, [*arrays, *jax.tree.leaves(arguments)])
        return self._program.structure.unflatten(results)


class _Program:
    """Compared by identity, as a static field must be."""

    def __init__(self, closed: ClosedJaxpr, structure: Any, types: Any, on_arrays: bool):
        self.closed, self.structure, self.types, self.on_arrays = closed, structure, types, on_arrays


def _types(arguments: tuple[Any, ...]) -> Any:
    leaves, structure = jax.tree.flatten(arguments)
    return [jax.typeof(x).strip_weak_type() for x in leaves], structure


class _Spread(eqx.Module):
    """A small array by its entries."""

    entries: list[Array]
    shape: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, array: Array) -> "Array | _Spread":
        small = eqx.is_inexact_array(array) and array.ndim > 0 and fits(jax.typeof(array))
        return cls(_scalars(array), array.shape) if small else array

    def array(self) -> Array:
        return jnp.stack(self.entries).reshape(self.shape)


def _scalars(array: Array) -> list[Array]:
    """The entries in row-major order, by `jax.lax.split`, whose transpose is one concatenation."""
    if not array.ndim:
        return [array]
    return [x.reshape(()) for x in jax.lax.split(array.reshape(-1), [1] * array.size)] if array.size else []


def _suits_arrays(closed: ClosedJaxpr) -> bool:
    """Whether a function is evaluated on arrays: few operations on arrays give many on scalars, as in a network.

    The limits come from `benchmarks/speed.py networks`. A function of vectors has a ratio of up to 3, so it stays on
    scalars unless it is long. A long formula written entry by entry stays as well.
    """
    scalars, arrays = count_scalar_operations(closed)
    return any(scalars > least and scalars > entries * arrays for least, entries in budgets.ON_ARRAYS)


def _on_arrays(function: Callable[..., Any], arguments: Any) -> Any:
    """The result of a function on arrays, in loops that begin and end with scalars; one that ended with an array would
    repeat all earlier work for each entry.
    """

    def is_vector(leaf: Any) -> bool:
        return isinstance(leaf, Packed)

    arrays = jax.tree.map(
        lambda x: jnp.stack(x.entries) if is_vector(x) else jnp.asarray(x), split(arguments), is_leaf=is_vector
    )
    result = split(function(*arrays))
    return jax.tree.map(lambda x: split(tuple(x[i] for i in np.ndindex(x.shape))), result)


class Packed(NamedTuple):
    entries: tuple[Array, ...]


class _Entries(NamedTuple):
    places: np.ndarray


def by_components(function: Callable[..., Any], *arguments: Any, on_scalars: bool = False) -> tuple[Any, Any]:
    """The result of a function of arrays, on pytrees of scalars and `Packed` vectors.

    With `on_scalars` it is replayed whatever the number of scalars. Each array is a tuple of its entries, in row-major
    order; the second result has their shapes and dtypes.
    """
    pool = Pool()
    leaves, structure = jax.tree.flatten(arguments, is_leaf=lambda x: isinstance(x, Packed))
    inputs: list[Any] = []
    avals: list[Any] = []
    for leaf in leaves:
        vector = isinstance(leaf, Packed)
        # The full JAX type of the array, including weak typing and mesh axes.
        traced = jax.make_jaxpr(lambda x=leaf, v=vector: jnp.stack(x.entries) if v else jnp.asarray(x))()
        aval: Any = traced.out_avals[0]
        inputs.append(_Entries(pool.store(leaf.entries if vector else [leaf], aval.shape)))
        avals.append(aval)
    closed, out = jax.make_jaxpr(function, return_shape=True)(*jax.tree.unflatten(structure, avals))
    if not on_scalars and _suits_arrays(closed):
        return _on_arrays(function, arguments), out
    results = [x if isinstance(x, _Entries) else _to_entries(pool, x) for x in _replay(pool, closed, inputs)]
    return jax.tree.unflatten(jax.tree.structure(out), [tuple(pool.at(x.places)) for x in results]), out


def _to_entries(pool: Pool, value: Any) -> _Entries:
    shape = jnp.shape(value)
    if isinstance(value, Tracer):
        return _Entries(pool.store(_scalars(value), shape))
    value = np.asarray(value)
    return _Entries(pool.store([value[i] if i else value for i in np.ndindex(shape)], shape))


def _to_entries_if_small(pool: Pool, value: Any) -> Any:
    """A small array of numbers split into its entries; other values are unchanged."""
    return _to_entries(pool, value) if fits(jax.typeof(value)) else value


def _to_array(pool: Pool, value: Any, aval: Any) -> Any:
    if isinstance(value, _Entries):
        scalars = [jnp.asarray(scalar, aval.dtype) for scalar in pool.at(value.places)]
        if not aval.shape:
            (value,) = scalars
        else:
            value = jnp.stack(scalars).reshape(aval.shape) if scalars else jnp.zeros(aval.shape, aval.dtype)
    return promoted(value, axes_of(aval))


def _replay(pool: Pool, closed: ClosedJaxpr, inputs: Sequence[Any]) -> list[Any]:
    """The outputs of a traced function; inputs and outputs are `_Entries`, or arrays if they are not small."""
    jaxpr = closed.jaxpr
    environment: dict[Any, Any] = {}

    def read(atom: Any) -> Any:
        return _to_entries_if_small(pool, np.asarray(atom.val)) if isinstance(atom, Literal) else environment[atom]

    environment.update(zip(jaxpr.constvars, (_to_entries_if_small(pool, c) for c in closed.consts), strict=True))
    environment.update(zip(jaxpr.invars, inputs, strict=True))
    for equation in jaxpr.eqns:
        results = _apply(pool, equation, [read(atom) for atom in equation.invars])
        environment.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _apply(pool: Pool, equation: Any, values: list[Any]) -> list[Any]:
    """The results of one operation: replayed by its rule if it has one, otherwise executed on arrays."""
    body = body_of(equation)
    if body is not None and not is_on_scalars(equation):
        return _replay(pool, body, values)
    with context_of(equation):
        if all(isinstance(v, _Entries) for v in values) and all(fits(atom.aval) for atom in equation.outvars):
            rule = rule_for(equation)
            places = None if rule is None else rule.replay(pool, equation, [v.places for v in values])
            if places is not None:
                return [_Entries(p) for p in places]
        arrays = [_to_array(pool, v, atom.aval) for v, atom in zip(values, equation.invars, strict=True)]
        return [_to_entries_if_small(pool, result) for result in bind(equation, arrays)]
