"""Performs a list of operations and compiles a function that is called many times only once.

A method of many stages evaluates the position on an orbit many times per step. Its program calls one traced function
each time, so it contains the same equation once per call, with other operands. Here these calls are performed in one,
along a new axis of calls. XLA would otherwise compile the function, which may have a thousand operations, for every
call.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .internals import bind, context_of
from .mesh import is_number
from .rules import body_of


class Operation(NamedTuple):
    """An operation of a program; it refers to values by their numbers."""

    equation: Any
    inputs: list[int]
    outputs: list[int]


Columns = dict[tuple[int, ...], Any]  # results of one operation in several calls: their numbers, and one array of all


def perform(operations: Sequence[Operation], values: dict[int, Any]) -> Columns:
    """Performs operations, each after those whose results it reads, and adds their results to the values."""
    columns: Columns = {}
    for alike in _in_order(operations):
        with context_of(alike[0].equation):
            if len(alike) > 1 and _are_of_numbers(alike, values):
                _perform_together(alike, values, columns)
                continue
            for equation, inputs, outputs in alike:
                values.update(zip(outputs, bind(equation, [values[i] for i in inputs]), strict=True))
    return columns


def packed(numbers: Sequence[int], values: dict[int, Any], columns: Columns) -> Any:
    """An array of the scalars with these numbers; whole columns of `perform` are not split."""
    wanted = set(numbers)
    used = [column for column in columns if wanted.issuperset(column)]
    place = {i: k for k, i in enumerate(i for column in used for i in column)}
    alone = [i for i in numbers if i not in place]
    if not place:
        return jnp.stack([values[i] for i in alone])
    place |= {i: len(place) + k for k, i in enumerate(alone)}
    parts = [*(columns[column] for column in used), *(jnp.reshape(values[i], 1) for i in alone)]
    return jnp.concatenate(parts)[jnp.array([place[i] for i in numbers])]


def _in_order(operations: Sequence[Operation]) -> Iterator[list[Operation]]:
    """The operations, each after those whose results it reads; equal equations and calls are grouped where possible."""
    groups: dict[Any, list[Operation]] = {}
    for operation in operations:
        function = body_of(operation.equation) or operation.equation
        groups.setdefault((id(function), len(operation.inputs)), []).append(operation)
    missing = {i for operation in operations for i in operation.outputs}

    def performed(group: list[Operation]) -> list[Operation]:
        missing.difference_update(i for operation in group for i in operation.outputs)
        return group

    while groups:
        before = len(groups)
        for key, group in list(groups.items()):
            if all(missing.isdisjoint(operation.inputs) for operation in group):
                yield performed(groups.pop(key))
        if len(groups) == before:  # calls that wait for each other: one of them is first
            key, first = next(
                (key, one) for key, group in groups.items() for one in group if missing.isdisjoint(one.inputs)
            )
            groups[key] = [one for one in groups[key] if one is not first]
            yield performed([first])


def _are_of_numbers(operations: Sequence[Operation], values: dict[int, Any]) -> bool:
    """Whether the operands of the operations are numbers, of the same types in all of them."""
    types = [[jax.typeof(values[i]) for i in operation.inputs] for operation in operations]
    return all(own == types[0] for own in types) and all(map(is_number, types[0]))


def _perform_together(operations: Sequence[Operation], values: dict[int, Any], columns: Columns) -> None:
    """Performs one operation of several calls along an axis of calls; shared operands have no such axis."""
    operands: list[Any] = []
    axes: list[int | None] = []
    for numbers in zip(*(operation.inputs for operation in operations), strict=True):
        shared = all(values[i] is values[numbers[0]] for i in numbers)
        column = None if shared else columns.get(numbers)
        if column is None and not shared:
            column = jnp.stack([jnp.asarray(values[i]) for i in numbers])
        operands.append(values[numbers[0]] if shared else column)
        axes.append(None if shared else 0)
    equation = operations[0].equation
    if 0 not in axes:
        results = bind(equation, operands)
        for operation in operations:
            values.update(zip(operation.outputs, results, strict=True))
        return
    results = jax.vmap(partial(_bound, equation), axes)(*operands)
    for numbers, result in zip(zip(*(o.outputs for o in operations), strict=True), results, strict=True):
        columns[numbers] = result
        values.update(zip(numbers, result, strict=True))


def _bound(equation: Any, *operands: Any) -> list[Any]:
    return bind(equation, operands)
