"""Moves computations that depend on the step alone, and not on the moving state, out of a loop over steps.

The position of a satellite on its orbit is the same for all bodies of an ensemble, but XLA recomputes it in every chunk
of bodies. `hoist` splits the traced function of a step in two. `prepare` computes the values that are expensive and
change from step to step, from the index of the step and from shared inputs; `rest` is the step that accepts them. Cheap
values, such as the time, stay in the step. A loop within the step is split in the same way, and its values get an axis
of iterations.

A method of many stages evaluates the position on an orbit many times per step, by calls of one traced function with
other operands. `perform` makes one call of these, along a new axis of calls; XLA would otherwise compile the function,
which may have a thousand operations, for every call.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .internals import ClosedJaxpr, Literal, bind, context_of, loop_counts
from .mesh import is_number
from .rules import body_of, is_expensive

_SCAN, _FUSE = "scan", "fuse"


class Operation(NamedTuple):
    """An operation of a program; it refers to values by their numbers."""

    equation: Any
    inputs: list[int]
    outputs: list[int]


def hoist(closed: ClosedJaxpr, known: Sequence[bool], varying: Sequence[bool]) -> "Hoisted | None":
    """Splits a traced function; None if nothing is worth preparing.

    For each input, `known`: available when values are prepared; `varying`: changes from step to step.
    """
    if closed.effects:
        return None
    hoisted = Hoisted(closed, known, varying)
    return hoisted if hoisted.prepared or hoisted.loops else None


def _is_slow(equation: Any) -> bool:
    """Whether an operation takes much longer than an addition; XLA repeats a sine or cosine nevertheless."""
    body = body_of(equation)
    if body is not None:
        return any(map(_is_slow, body.jaxpr.eqns))
    return equation.primitive.name in ("sin", "cos") or is_expensive(equation)


def depends(closed: ClosedJaxpr, marked: Sequence[bool]) -> tuple[list[bool], bool, bool]:
    """For each output of a traced function, whether it depends on the marked inputs; whether an expensive operation
    does; whether a slow operation (`_is_slow`) does not.
    """
    values = dict(zip(closed.jaxpr.invars, marked, strict=True))
    within = without = False
    for equation in closed.jaxpr.eqns:
        operands = [not isinstance(atom, Literal) and values.get(atom, False) for atom in equation.invars]
        body = body_of(equation)
        if body is not None:
            results, body_within, body_without = depends(body, operands)
            within, without = within or body_within, without or body_without
        else:
            results = [any(operands)] * len(equation.outvars)
            if any(operands):
                within = within or is_expensive(equation)
            else:
                without = without or _is_slow(equation)
        values |= dict(zip(equation.outvars, results, strict=True))
    outputs = [not isinstance(atom, Literal) and values.get(atom, False) for atom in closed.jaxpr.outvars]
    return outputs, within, without


class Hoisted:
    """A function split in two: function(*inputs) = rest(prepare(*inputs), *inputs)."""

    def __init__(self, closed: ClosedJaxpr, known: Sequence[bool], varying: Sequence[bool]):
        self._operations: list[Operation] = []
        self._constants: dict[int, Any] = {}
        self._numbers: dict[int, int] = {}  # of the constants, by their ids
        self._new = count()
        self._inputs = [next(self._new) for _ in closed.jaxpr.invars]
        self._known = dict(zip(self._inputs, known, strict=True))
        self._varying = dict(zip(self._inputs, varying, strict=True))
        self._prepares = dict.fromkeys(self._inputs, False)
        self.loops: dict[int, Hoisted] = {}
        self._outputs = self._flatten(closed, self._inputs)
        wanted = {i for operation in self._operations for i in self._read_by_step(operation)} | set(self._outputs)
        self.prepared = sorted(i for i in wanted if self._prepares[i])
        types = {
            o: atom.aval for op in self._operations for o, atom in zip(op.outputs, op.equation.outvars, strict=True)
        }
        # Scalars of one type are stored in one array, so that the step reads one array instead of one per scalar.
        self._groups: dict[Any, list[int]] = {}
        for i in self.prepared:
            self._groups.setdefault(i if types[i].shape else types[i].dtype, []).append(i)

    def _constant(self, value: Any) -> int:
        if id(value) in self._numbers:
            return self._numbers[id(value)]
        number = self._numbers[id(value)] = next(self._new)
        self._constants[number] = value
        self._known[number], self._varying[number], self._prepares[number] = True, False, False
        return number

    def _flatten(self, closed: ClosedJaxpr, inputs: Iterable[int]) -> list[int]:
        """Lists and classifies the operations; calls of `jit` with unknown operands become their operations."""
        numbers = dict(zip(closed.jaxpr.invars, inputs, strict=True))
        numbers |= {
            variable: self._constant(c) for variable, c in zip(closed.jaxpr.constvars, closed.consts, strict=True)
        }

        def number(atom: Any) -> int:
            return self._constant(atom.val) if isinstance(atom, Literal) else numbers[atom]

        for equation in closed.jaxpr.eqns:
            operands = [number(atom) for atom in equation.invars]
            body = body_of(equation)
            if body is not None and not all(self._known[i] for i in operands):
                results = self._flatten(body, operands)
            else:
                results = [next(self._new) for _ in equation.outvars]
                self._operations.append(Operation(equation, operands, results))
                self._classify(len(self._operations) - 1, self._operations[-1])
            numbers |= dict(zip(equation.outvars, results, strict=True))
        return [number(atom) for atom in closed.jaxpr.outvars]

    def _classify(self, position: int, operation: Operation) -> None:
        equation, inputs, outputs = operation
        if equation.primitive.name == _FUSE:  # its outputs equal its inputs
            for i, o in zip(inputs, outputs, strict=True):
                for table in (self._known, self._varying, self._prepares):
                    table[o] = table[i]
            return
        known = all(self._known[i] for i in inputs)
        varying = any(self._varying[i] for i in inputs)
        prepares = known and (any(self._prepares[i] for i in inputs) or (varying and _is_slow(equation)))
        for o in outputs:
            self._known[o], self._varying[o], self._prepares[o] = known, varying, prepares
        counts = loop_counts(equation) if equation.primitive.name == _SCAN and not known else None
        if counts is not None:
            carried = range(counts[0], sum(counts))
            fixed = [self._known[i] and n not in carried for n, i in enumerate(inputs)]
            loop = hoist(equation.params["jaxpr"], fixed, [self._varying[i] for i in inputs])
            if loop is not None:
                self.loops[position] = loop

    def _read_by_step(self, operation: Operation) -> list[int]:
        if operation.equation.primitive.name == _FUSE:
            return [i for i in operation.inputs if not self._known[i]]
        return [] if all(self._prepares[o] for o in operation.outputs) else operation.inputs

    def prepare(self, *inputs: Any) -> list[Any]:
        """The prepared values; an unknown input may have any value."""
        needed = set(self.prepared)
        for position in self.loops:
            needed.update(i for i in self._operations[position].inputs if self._known[i])
        values = self._constants | dict(zip(self._inputs, inputs, strict=True))
        columns = perform([operation for _, operation in self._needed(needed, values)], values)
        own = (values[g[0]] if len(g) == 1 else packed(g, values, columns) for g in self._groups.values())
        return [*own, *(self._prepared_by_loop(position, values) for position in self.loops)]

    def _prepared_by_loop(self, position: int, values: dict[int, Any]) -> Any:
        """The prepared values of a loop within the step, with an axis of iterations."""
        equation, inputs, _ = self._operations[position]
        first = sum(loop_counts(equation) or ())
        fixed, columns = [values.get(i) for i in inputs[:first]], [values.get(i) for i in inputs[first:]]

        def row(_: None, columns: Any) -> tuple[None, list[Any]]:
            return None, self.loops[position].prepare(*fixed, *columns)

        return jax.lax.scan(row, None, columns, equation.params["length"], equation.params["reverse"])[1]

    def rest(self, prepared: Sequence[Any], *inputs: Any) -> list[Any]:
        """The outputs of the function, from the prepared values and the inputs."""
        given: dict[int, Any] = {}
        prepared = jax.lax.optimization_barrier(list(prepared))
        for group, array in zip(self._groups.values(), prepared, strict=False):
            given |= {group[0]: array} if len(group) == 1 else {i: array[k] for k, i in enumerate(group)}
        rows = dict(zip(self.loops, prepared[len(self._groups) :], strict=True))
        values = self._constants | dict(zip(self._inputs, inputs, strict=True)) | given
        for position, (equation, operands, outputs) in self._needed(set(self._outputs), values):
            arguments = [values[i] for i in operands]
            with context_of(equation):
                if position in rows:
                    results = self._loop_with_rows(position, equation, arguments, rows[position])
                else:
                    results = bind(equation, arguments)
            values.update(zip(outputs, results, strict=True))
        return [values[i] for i in self._outputs]

    def _needed(self, needed: set[int], values: dict[int, Any]) -> list[tuple[int, Operation]]:
        """The operations that lead from these values to the needed ones, with their positions."""
        wanted = set(needed) - values.keys()
        performed: list[tuple[int, Operation]] = []
        for position in reversed(range(len(self._operations))):
            operation = self._operations[position]
            if wanted.isdisjoint(operation.outputs):
                continue
            if operation.equation.primitive.name == _FUSE:
                pairs = [(i, o) for i, o in zip(operation.inputs, operation.outputs, strict=True) if o in wanted]
                operation = operation._replace(inputs=[i for i, _ in pairs], outputs=[o for _, o in pairs])
            performed.append((position, operation))
            wanted = (wanted - set(operation.outputs)) | (set(operation.inputs) - values.keys())
        return performed[::-1]

    def _loop_with_rows(self, position: int, equation: Any, arguments: list[Any], rows: Any) -> list[Any]:
        consts, carry = loop_counts(equation) or (0, 0)
        fixed, start, columns = arguments[:consts], arguments[consts : consts + carry], arguments[consts + carry :]

        def turn(carried: Any, row: Any) -> tuple[Any, Any]:
            prepared, columns = row
            results = self.loops[position].rest(prepared, *fixed, *carried, *columns)
            return results[:carry], results[carry:]

        options = {name: equation.params[name] for name in ("length", "reverse", "unroll")}
        carried, kept = jax.lax.scan(turn, start, (rows, columns), **options)
        return [*carried, *kept]


Columns = dict[tuple[int, ...], Any]  # results of one operation in several calls: their numbers, and one array of all


def perform(operations: Sequence[Operation], values: dict[int, Any]) -> Columns:
    """Performs operations, each after those whose results it reads, and adds their results to the values."""
    columns: Columns = {}
    for group in _in_order(operations):
        with context_of(group[0].equation):
            if len(group) > 1 and _are_of_numbers(group, values):
                _perform_together(group, values, columns)
                continue
            for equation, inputs, outputs in group:
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
    results = jax.vmap(lambda *operands: bind(equation, operands), axes)(*operands)
    for numbers, result in zip(zip(*(o.outputs for o in operations), strict=True), results, strict=True):
        columns[numbers] = result
        values.update(zip(numbers, result, strict=True))
