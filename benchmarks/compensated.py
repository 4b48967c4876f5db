"""Compensated summation of momentum and attitude, which the library does not have, for the benchmarks of rounding.

Every component of the momentum and the attitude carries a low part: what the rounding of its sums has lost so far.
Flights and torques take the component without the low part. Their change and the low part are added to the component,
and the error of this sum is the next low part (O. Moller, BIT 5 (1965) 37). So errors of sums no longer add up, and
what remains are errors of the changes themselves. `rounding_growth.py` measures the errors, `rounding_cost.py` the cost.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from midlie_jax._kernel import components
from midlie_jax._kernel.fusion import begin, fuse
from midlie_jax._kernel.width import vector_width_options
from midlie_jax.bench.runner import Rows
from midlie_jax.drivers.clock import ends_of_step, time_of
from midlie_jax.methods.base import Method, Progress
from midlie_jax.methods.system import System
from midlie_jax.model.states import RigidState

Lows = dict[int, tuple[Any, ...]]  # low parts, by their number: 3 of the momentum, 4 of the attitude


@contextmanager
def sums(accumulate: Callable[[Any, Any, Array], Any]) -> Iterator[None]:
    """While it is open, steps that are traced add a change to a momentum or pose by this function."""
    library = components.accumulate
    components.accumulate = accumulate
    try:
        yield
    finally:
        components.accumulate = library


def to_nearest(x: Any, change: Any, t: Array) -> Any:
    """x + change, rounded to nearest in float32, too."""
    del t
    return jax.tree.map(jnp.add, x, change)


def two_sum(x: Array, change: Array) -> tuple[Array, Array]:
    """x + change and its rounding error, by six sums (D. E. Knuth, The Art of Computer Programming 2, 4.2.2)."""
    total = x + change
    added = total - x
    return total, (x - (total - added)) + (change - added)


class Compensated:
    """A method on a batch of bodies with compensated sums; the counterpart of `midlie_jax.bench.runner.Runner`."""

    def __init__(self, method: Method, body: Any):
        self.method = method.fitted(body)
        run = jax.vmap(partial(_run, self.method), in_axes=(0, 0, None, None))
        self._run = jax.jit(run, compiler_options=vector_width_options())

    def run(self, rows: Rows, lows: Lows, steps: int, first: int = 0) -> tuple[RigidState, Lows, Array]:
        """The states after `steps` steps without their low parts, the low parts, and `ok` for each row."""
        return self._run(rows, lows, jnp.int32(first), jnp.int32(steps))


def no_lows(start: RigidState) -> Lows:
    """The low parts at the start of a run."""
    zero = jnp.zeros_like(start.momentum[:, 0])
    return {3: (zero,) * 3, 4: (zero,) * 4}


def whole(state: RigidState, lows: Lows) -> RigidState:
    """The states with their low parts, in float64."""
    return RigidState(
        *(
            np.asarray(x, float) + np.stack([np.asarray(low, float) for low in lows[x.shape[-1]]], axis=-1)
            for x in (state.momentum, state.attitude)
        )
    )


def _run(method: Method, row: Rows, lows: Lows, first: Array, steps: Array) -> tuple[RigidState, Lows, Array]:
    zero = jnp.zeros_like(row.dt)
    system = System.of(row.body, row.torque, row.start, zero)
    motion = system.motion(row.start)
    force = system.force(time_of(zero, row.dt, first), motion) if method.keeps_force(system) else None

    def advance(n: Array, carry: tuple[Progress, Lows]) -> tuple[Progress, Lows]:
        constants, h, (progress, lows) = begin((system, row.dt, carry))
        t0, t1, _ = ends_of_step(n, (zero, h))
        lows = dict(lows)

        def accumulate(x: Any, change: Any, t: Array) -> Any:
            del t
            pairs = [two_sum(a, b + low) for a, b, low in zip(x, change, lows[len(x)], strict=True)]
            lows[len(x)] = tuple(low for _, low in pairs)
            return tuple(total for total, _ in pairs)

        with sums(accumulate):
            motion, force, ok = method.step(constants, t0, t1, h, progress.motion, progress.force)
        return fuse((Progress(motion, force, progress.ok & ok), lows))

    progress, lows = jax.lax.fori_loop(
        first, first + steps, advance, (Progress(motion, force, jnp.array(True)), lows)
    )
    return system.state(progress.motion), lows, progress.ok & components.all_finite(progress.motion)
