"""`apart`: compiles a function separately from its surroundings, so that its rounding does not depend on them.

A force on many bodies must not be fused with the step around it. XLA would repeat its sums for every number of the step
that reads them (the step of two molecules then takes 7000 times longer). XLA's CPU compiler drops an
`optimization_barrier` before it fuses, but it never fuses across the border of a conditional. On CPUs the function is
therefore one branch of a conditional whose predicate no compiler can evaluate: whether the time is a number. Under
`jax.vmap` it is whether any of the times is one, because a conditional with one predicate per row becomes a select.

Compilers for accelerators keep a barrier. There the predicate is the constant True, and the function stands between two
barriers.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .fusion import barrier
from .internals import ShapedArray, make_primitive


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
