"""`sum_over_rows`: a sum over the rows of a table within a step, for example of forces on facets.

On arrays, (rows, bodies) numbers would pass through memory. For one reduction of many operands, XLA's CPU compiler
computes body after body without vectors. A loop that adds a block of rows per iteration, written out on scalars, is
vectorised over the bodies, and half as long with 16 rows in a block (`benchmarks/surfaces.py`). The compilation time
grows with the block.
"""

import operator
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero

from . import budgets
from .fusion import begin, fuse
from .mesh import all_promoted, axes_of


def sum_over_rows(
    term: Callable[[Any, Any], Any], columns: Sequence[Array], argument: Any, tables: Sequence[Array] = ()
) -> Any:
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
    function = _Term(converted)
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


class _Term:
    def __init__(self, converted: Callable[..., Any]):
        self.converted = converted

    def __call__(self, row: Any, argument: Any) -> Any:
        own, closed_over = argument
        return self.converted(row, own, *closed_over)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _block(term: _Term, rows: Array, tables: tuple[Array, ...], argument: Any) -> Any:
    return _written_out(term, rows, tables, argument)


def _block_tangent(term: _Term, primals: Any, tangents: Any) -> tuple[Any, Any]:
    """With respect to the rows on arrays; on scalars, a reverse derivative would be one sum over the bodies per row."""
    (rows, tables, argument), (d_rows, _, d_argument) = primals, tangents
    value, change = _tangent(lambda a: _written_out(term, rows, tables, a), argument, d_argument)
    if not isinstance(d_rows, SymbolicZero):
        along_rows = _tangent(lambda r: _on_arrays(term, r, tables, argument), rows, d_rows)[1]
        change = along_rows if change is None else _sum([change, along_rows])
    return value, jax.tree.map(jnp.zeros_like, value) if change is None else change


_block.defjvp(_block_tangent, symbolic_zeros=True)


def _written_out(term: _Term, rows: Array, tables: tuple[Array, ...], argument: Any) -> Any:
    def row(k: int) -> tuple[Array, ...]:
        return *(rows[k, i] for i in range(rows.shape[1])), *(table[k] for table in tables)

    return _sum([term(row(k), argument) for k in range(budgets.WRITTEN_ROWS)])


def _on_arrays(term: _Term, rows: Array, tables: tuple[Array, ...], argument: Any) -> Any:
    parts = jax.vmap(lambda row, own: term((*(row[i] for i in range(len(row))), *own), argument))(rows, tables)
    return jax.tree.map(lambda part: jnp.sum(part, axis=0), parts)


def _tangent(function: Callable[[Any], Any], x: Any, tangent: Any) -> tuple[Any, Any]:
    """The value and its tangent; None if the tangent of the argument is zero."""
    leaves, structure = jax.tree.flatten(x)
    tangents = structure.flatten_up_to(tangent)
    if all(isinstance(leaf, SymbolicZero) for leaf in tangents):
        return function(x), None
    filled = [
        jnp.zeros_like(leaf) if isinstance(t, SymbolicZero) else t for leaf, t in zip(leaves, tangents, strict=True)
    ]
    return jax.jvp(function, (x,), (structure.unflatten(filled),))


def _sum(terms: list[Any]) -> Any:
    return jax.tree.map(lambda *parts: reduce(operator.add, parts), *terms)
