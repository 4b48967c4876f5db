"""`repeat`: applies a step to each body of a batch, with a number of repetitions per body.

A loop that ends with the last body of the batch has no reverse derivative. Values therefore come from such a loop, and
derivatives from a loop of fixed length. In both, a body that has taken its steps does not change.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .fusion import begin_step, fuse

Step = Callable[[Any, Any], Any]


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def repeat(step: Step, most: int, constants: Any, carry: Any, count: Array) -> Any:
    """The result of `count` times carry = step(constants, carry), on pytrees of scalars.

    The step closes over no arrays, and is compiled to one loop over the bodies. A derivative takes `most` steps.
    """
    last = _largest(count)

    def turn(state: tuple[Array, Any]) -> tuple[Array, Any]:
        number, carry = state
        return number + 1, _again(step, constants, carry, number < count)

    return jax.lax.while_loop(lambda state: state[0] < last, turn, (jnp.zeros_like(last), carry))[1]


@repeat.defjvp
def _repeat_jvp(step: Step, most: int, primals: Any, tangents: Any) -> tuple[Any, Any]:
    constants, carry, count = primals

    def repeated(constants: Any, carry: Any) -> Any:
        numbers = jnp.arange(most, dtype=count.dtype)
        return jax.lax.scan(lambda c, number: (_again(step, constants, c, number < count), None), carry, numbers)[0]

    return jax.jvp(repeated, (constants, carry), tangents[:2])


def _again(step: Step, constants: Any, carry: Any, needed: Array) -> Any:
    """The carry after one more step if needed; otherwise the carry itself."""
    constants, carry = begin_step((constants, carry))
    return fuse(jax.tree.map(lambda new, old: jnp.where(needed, new, old), step(constants, carry), carry))


@jax.custom_batching.custom_vmap
def _largest(count: Array) -> Array:
    """The largest count of a batch: a scalar under any number of `jax.vmap`s, so that the loop has one end for all."""
    return count


@_largest.def_vmap
def _largest_of_batch(size: int, batched: list[bool], count: Array) -> tuple[Array, bool]:
    return _largest(jnp.max(count, axis=0, initial=0)), False
