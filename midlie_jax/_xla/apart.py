"""`apart`: a function that XLA compiles apart from what is around it, so that it rounds the same wherever it stands.

A force of many bodies must not be fused with the step around it: XLA would repeat its sums for every number of the step
that reads them (the step of two molecules then takes 7000 times as long). XLA's CPU compiler drops an
`optimization_barrier` before it fuses, but it fuses nothing across the border of a conditional. So there the function
is one branch of a conditional, whose predicate no compiler knows: whether the time is a number. Under `jax.vmap` the
predicate is whether any of the times is, because a conditional with a predicate for each row becomes a select, which
is fused like everything else.

Compilers for accelerators keep a barrier, and a conditional would wait for its predicate there; so on other platforms
than the CPU the predicate is the constant True, and the function stands between two barriers.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .fusion import barrier
from .internals import make_predicate


def apart(function: Callable[..., Any], t: Array, *arguments: Any) -> Any:
    """function(t, *arguments), compiled apart; NaN where the time t is NaN."""

    def nothing(t: Array, *arguments: Any) -> Any:
        shapes = jax.eval_shape(function, t, *arguments)
        return jax.tree.map(lambda x: jnp.full(x.shape, jnp.nan, x.dtype), shapes)

    return barrier(jax.lax.cond(_is_time(t), function, nothing, t, *barrier(arguments)))


_is_time = make_predicate("is_time", default=jnp.ones_like, on_cpu=lambda t: t == t)
