"""Where a step evaluates its torque: `Placement`, and `apart`, which compiles a function separately from the step.

A force on many bodies must not be fused with the step around it: XLA would repeat its sums for every number of the step
that reads them. XLA's CPU compiler drops an `optimization_barrier` before it fuses, but it never fuses across the
border of a conditional. On CPUs the function is therefore one branch of a conditional whose predicate no compiler can
evaluate: whether the time is a number, or under `jax.vmap` any of the times. Compilers for accelerators keep a barrier;
there the predicate is the constant True, and the function stands between two barriers.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from .fusion import barrier, fuse_derivative, split
from .internals import ShapedArray, make_primitive

T = TypeVar("T")


def apart(function: Callable[..., Any], t: Array, *arguments: Any) -> Any:
    """function(t, *arguments), compiled separately; NaN where the time t is NaN."""

    def nothing(t: Array, *arguments: Any) -> Any:
        shapes = jax.eval_shape(function, t, *arguments)
        return jax.tree.map(lambda x: jnp.full(x.shape, jnp.nan, x.dtype), shapes)

    (is_time,) = _is_time.bind(jax.lax.stop_gradient(t))
    return barrier(jax.lax.cond(is_time, function, nothing, t, *barrier(arguments)))


_is_time = make_primitive(
    "is_time",
    default=lambda t: [jnp.any(jnp.ones_like(t).astype(bool))],
    on_cpu=lambda t: [jnp.any(t == t)],
    batch=lambda values, axes: (_is_time.bind(*values), [None]),
    outputs=lambda types: [ShapedArray((), jnp.bool_)],
)


class Placement(IntEnum):
    """Where a step evaluates its torque, from the least to the most separate.

    XLA treats a division, root or exponential as too expensive to repeat, and ends a loop with such an operation at
    every value that is used twice. A torque with such an operation therefore has separate loops.
    """

    INLINE = 0  # in the loop of the step
    OWN_DERIVATIVE = 1  # the same, but its derivative is too long for one loop with the derivative of the flight
    OWN_LOOP = 2  # in a separate loop
    LONG_LOOP = 3  # the same, and long: a loop that holds one copy of it is equally fast and compiles much faster
    APART = 4  # on arrays, compiled separately from the step (`apart`), which already ends the loops around it

    @classmethod
    def of(cls, *, costly: bool, long: bool, apart: bool = False) -> "Placement":
        return cls.APART if apart else cls(2 * costly + long)

    def if_costly(self, costly: bool) -> "Placement":
        """The placement of the torque when a part of it is prepared, and the rest has expensive operations or none."""
        return Placement.of(costly=costly, long=self.is_long, apart=self is Placement.APART)

    @property
    def is_long(self) -> bool:
        return self in (Placement.OWN_DERIVATIVE, Placement.LONG_LOOP)

    @property
    def has_own_loop(self) -> bool:
        return self in (Placement.OWN_LOOP, Placement.LONG_LOOP)

    @property
    def is_compiled_once(self) -> bool:
        """Whether a step should hold one copy of the torque."""
        return self >= Placement.LONG_LOOP

    def after_flight(self, tree: T) -> T:
        """The tree unchanged; marks the border between two parts of a step."""
        return split(tree) if self.has_own_loop else fuse_derivative(tree) if self.is_long else tree

    def around_torque(self, tree: T) -> T:
        """The tree unchanged; ends the loop before and after a torque in a separate loop."""
        return split(tree) if self.has_own_loop else tree
