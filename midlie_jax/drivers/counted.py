"""A number of steps that is an argument of a program, not a part of it: one compiled program serves every number.

JAX needs a fixed number for a reverse derivative, and an accelerator for launches without a question after each. So the
number is an argument on a CPU, outside of every other program (`jax.jit`, `jax.grad` and the like).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._xla.internals import bodies_at_once
from .._xla.platform import on_cpu
from ..methods.base import Progress
from .adjoints import Adjoint, Checkpointed

# An iteration of the loop holds `Method.unroll` steps, of which the last may be idle. Between saved states that are so
# close, idle steps would cost time, and a saved state is one more loop. So fewer steps are a part of the program.
_FEW = 32
_LEAST_TABLE = 64  # steps


def count_as_argument(every: int, steps: int, adjoint: Adjoint) -> Any:
    """The steps between two saved states: as an array, which becomes an argument, or as an int, a part of the program.

    An adjoint other than the default is checked when the program is made, with all its numbers.
    """
    default = isinstance(adjoint, Checkpointed) and adjoint.every is None
    free = default and (every == steps or every >= _FEW)
    return np.asarray(every, np.int32) if free and on_cpu() and bodies_at_once() else every


def prepared_steps(first: Any, intervals: int, every: Any) -> tuple[int, Any]:
    """For `shared_tables`: of how many steps it prepares the inputs, and the indices of the steps of zero length.

    If the number of steps is an argument, one table, and so one program, serves runs of up to four times as many steps.
    """
    if isinstance(every, int):
        return intervals * every, None
    steps = _LEAST_TABLE
    while steps < intervals * every:
        steps *= 4
    begin = first.astype(np.int32) - 1  # NumPy's where it can be, which makes small arrays faster than JAX
    return steps, begin + every * np.arange(intervals + 1, dtype=np.int32)


def take_counted(
    take: Callable[[Progress, Array, Array], Progress], progress: Progress, count: Array, unroll: int, idle: Array
) -> Progress:
    """The progress after `count` steps.

    Args:
        take: the progress after a step, from the progress before it, the number of the step, and whether it is taken;
            otherwise it is an idle step of length zero, and its number is -1 before the steps and `count - 1` after
            them.
        count: (), an argument of the program.
        unroll: steps per iteration of the loop.
        idle: (), the number of idle steps before the steps, 0 or 1.
    """

    def iteration(i: Array, progress: Progress) -> Progress:
        for k in range(unroll):
            number = i * unroll + k - idle
            progress = take(progress, jnp.minimum(number, count - 1), (number >= 0) & (number < count))
        return progress

    return jax.lax.fori_loop(0, (count + idle + unroll - 1) // unroll, iteration, progress)
