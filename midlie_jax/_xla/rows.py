"""`sum_over_rows`: a sum over the rows of a table within a step, such as that of forces on the facets of a surface.

Written on arrays, (rows, bodies) numbers would pass through memory. As one reduction of many operands, XLA's CPU
compiler computes body after body without vectors: 1000 rows of 10,000 bodies took 11 ms in both dtypes. A loop whose
turn adds a block of rows, written out on scalars, is a vectorised loop over the bodies; with 4, 8, 16 and 32 rows in a
block it took 7.4, 6.2, 5.4 and 5.2 ms in float64 and half of that in float32, where C takes 4.3 ms. The time to compile
grows with the block. A whole step beside C: `benchmarks/surfaces.py`.
"""

import operator
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .fusion import begin, fuse
from .mesh import all_promoted, axes_of

BLOCK = 16  # rows that are written out


def sum_over_rows(term: Callable[[Any, Any], Any], columns: Sequence[Array], argument: Any) -> Any:
    """The sum over rows of `term(row, argument)`.

    A reverse derivative computes the terms anew and keeps none. With respect to the columns it is slow: a sum over the
    bodies for each number of the table.

    Args:
        term: returns a pytree of scalars. For a row of zeros, with which the table is filled up, it is zero, and so is
            its derivative.
        columns: of the table, (n,) each. Up to 16 rows are written out, and become part of the loop around them.
        argument: a pytree of scalars.
    """
    n = columns[0].shape[0]
    if n <= BLOCK:
        return _sum([term(tuple(column[k] for column in columns), argument) for k in range(n)])
    # One table, so that no part of it is as small as the arrays that a torque is split into (`replay.py`).
    table = jnp.stack(columns, axis=1)
    blocks = jnp.pad(table, ((0, -n % BLOCK), (0, 0))).reshape(-1, BLOCK, len(columns))

    def block(rows: Array, argument: Any) -> Any:
        within = begin(argument)
        return _sum([term(tuple(rows[k, i] for i in range(len(columns))), within) for k in range(BLOCK)])

    # Without it, a reverse derivative would keep the intermediate results of each row.
    again = jax.checkpoint(block, prevent_cse=False)

    def turn(total: Any, rows: Array) -> tuple[Any, None]:
        return fuse(_sum([begin(total), again(rows, argument)])), None

    shapes = jax.eval_shape(block, blocks[0], argument)
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    axes = axes_of(blocks, *jax.tree.leaves(argument))
    return jax.lax.scan(turn, all_promoted(zeros, axes), all_promoted(blocks, axes))[0]


def _sum(terms: list[Any]) -> Any:
    return jax.tree.map(lambda *parts: reduce(operator.add, parts), *terms)
