"""Loops within a step: `sum_over_rows` of a table, such as forces on facets, and `repeat`, with a count for each body.

On arrays, the (rows, bodies) numbers of a sum would pass through memory. For one reduction of many operands, XLA's CPU
compiler computes body after body without vectors. A loop that adds a block of rows per iteration, written out on
scalars, is vectorised over the bodies, and half as long with 16 rows in a block (`benchmarks/surfaces.py`). The
compilation time grows with the block.

A loop that ends with the last body of the batch has no reverse derivative. The values of `repeat` therefore come from
such a loop, and its derivatives from a loop of fixed length, in which a body that has taken its steps does not change.
"""

import operator
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from . import budgets
from .fusion import begin, begin_step, fuse
from .internals import are_zero, with_zeros
from .mesh import all_promoted, axes_of

Term = Callable[[Any, Any], Any]


def sum_over_rows(term: Term, columns: Sequence[Array], argument: Any, tables: Sequence[Array] = ()) -> Any:
    """The sum over rows of `term(row, argument)`, pytrees of scalars. A reverse derivative recomputes the terms.

    For a row of zeros, which pads the table, term and derivative must be zero. The columns are (n,) each; up to 16 rows
    are written out, and become part of the surrounding loop. The row of `tables` (n, K), which have no derivative, is
    the last part of a row, as arrays (K,).
    """
    n = columns[0].shape[0]
    tables = tuple(map(jax.lax.stop_gradient, tables))
    if n <= budgets.WRITTEN_ROWS:
        return _sum([term(tuple(column[k] for column in (*columns, *tables)), argument) for k in range(n)])
    # One table, so that no part of it is small enough to be split like the arrays of a torque (`replay.py`).
    table = jnp.stack(columns, axis=1)
    blocks, *others = (
        jnp.pad(x, ((0, -n % budgets.WRITTEN_ROWS), (0, 0))).reshape(-1, budgets.WRITTEN_ROWS, x.shape[1])
        for x in (table, *tables)
    )
    # Closed-over values of the term, such as the parameters of a law, become an argument, because `_block` has its own
    # derivative.
    converted, closed_over = jax.closure_convert(term, tuple(column[0] for column in (*columns, *tables)), argument)

    def function(row: Any, argument: Any) -> Any:
        own, closed_over = argument
        return converted(row, own, *closed_over)

    argument = argument, closed_over
    # Without it, a reverse derivative would keep the intermediate results of each row.
    again = jax.checkpoint(lambda rows, argument: _block(function, *rows, begin(argument)), prevent_cse=False)

    def turn(total: Any, rows: Any) -> tuple[Any, None]:
        return fuse(_sum([begin(total), again(rows, argument)])), None

    scanned = blocks, tuple(others)
    shapes = jax.eval_shape(lambda rows: _block(function, *rows, argument), jax.tree.map(lambda x: x[0], scanned))
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    axes = axes_of(*jax.tree.leaves((scanned, argument)))
    return jax.lax.scan(turn, all_promoted(zeros, axes), all_promoted(scanned, axes))[0]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _block(term: Term, rows: Array, tables: tuple[Array, ...], argument: Any) -> Any:
    return _written_out(term, rows, tables, argument)


def _block_tangent(term: Term, primals: Any, tangents: Any) -> tuple[Any, Any]:
    """With respect to the rows on arrays; on scalars, a reverse derivative would be one sum over the bodies per row."""
    (rows, tables, argument), (d_rows, _, d_argument) = primals, tangents
    value, change = _tangent(lambda a: _written_out(term, rows, tables, a), argument, d_argument)
    if not are_zero(d_rows):
        along_rows = _tangent(lambda r: _on_arrays(term, r, tables, argument), rows, d_rows)[1]
        change = along_rows if change is None else _sum([change, along_rows])
    return value, jax.tree.map(jnp.zeros_like, value) if change is None else change


_block.defjvp(_block_tangent, symbolic_zeros=True)


def _written_out(term: Term, rows: Array, tables: tuple[Array, ...], argument: Any) -> Any:
    def row(k: int) -> tuple[Array, ...]:
        return *(rows[k, i] for i in range(rows.shape[1])), *(table[k] for table in tables)

    return _sum([term(row(k), argument) for k in range(budgets.WRITTEN_ROWS)])


def _on_arrays(term: Term, rows: Array, tables: tuple[Array, ...], argument: Any) -> Any:
    parts = jax.vmap(lambda row, own: term((*(row[i] for i in range(len(row))), *own), argument))(rows, tables)
    return jax.tree.map(lambda part: jnp.sum(part, axis=0), parts)


def _tangent(function: Callable[[Any], Any], x: Any, tangent: Any) -> tuple[Any, Any]:
    """The value and its tangent; None if the tangent of the argument is zero."""
    return (function(x), None) if are_zero(tangent) else jax.jvp(function, (x,), (with_zeros(tangent, x),))


def _sum(terms: list[Any]) -> Any:
    return jax.tree.map(lambda *parts: reduce(operator.add, parts), *terms)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def repeat(step: Term, most: int, constants: Any, carry: Any, count: Array) -> Any:
    """The result of `count` times carry = step(constants, carry), on pytrees of scalars.

    The step closes over no arrays, and is compiled to one loop over the bodies. A derivative takes `most` steps.
    """
    last = _largest(count)

    def turn(state: tuple[Array, Any]) -> tuple[Array, Any]:
        number, carry = state
        return number + 1, _again(step, constants, carry, number < count)

    return jax.lax.while_loop(lambda state: state[0] < last, turn, (jnp.zeros_like(last), carry))[1]


@repeat.defjvp
def _repeat_jvp(step: Term, most: int, primals: Any, tangents: Any) -> tuple[Any, Any]:
    constants, carry, count = primals

    def repeated(constants: Any, carry: Any) -> Any:
        numbers = jnp.arange(most, dtype=count.dtype)
        return jax.lax.scan(lambda c, number: (_again(step, constants, c, number < count), None), carry, numbers)[0]

    return jax.jvp(repeated, (constants, carry), tangents[:2])


def _again(step: Term, constants: Any, carry: Any, needed: Array) -> Any:
    constants, carry = begin_step((constants, carry))
    return fuse(jax.tree.map(lambda new, old: jnp.where(needed, new, old), step(constants, carry), carry))


@jax.custom_batching.custom_vmap
def _largest(count: Array) -> Array:
    """The largest count of a batch: a scalar under any number of `jax.vmap`s, so that the loop has one end for all."""
    return count


@_largest.def_vmap
def _largest_of_batch(size: int, batched: list[bool], count: Array) -> tuple[Array, bool]:
    return _largest(jnp.max(count, axis=0, initial=0)), False
