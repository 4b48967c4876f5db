"""`Dense`, the base class of both kinds of dense output, with the interface of diffrax for states within a step."""

from abc import abstractmethod
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array


class Dense(diffrax.AbstractLocalInterpolation):
    """States between the times t0 and t1 of the ends of a step."""

    t0: eqx.AbstractVar[Any]
    t1: eqx.AbstractVar[Any]

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> Any:
        """The state at t0; with t1, the arrays at t1 minus the arrays at t0. `derivative` differentiates the arrays."""
        del left
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        # A Python number would be a constant of the compiled program, which would then be recompiled for each time.
        return self.state_at(t0 if eqx.is_array(t0) else jnp.asarray(t0, jnp.result_type(self.t0)))

    @abstractmethod
    def state_at(self, t: Array) -> Any:
        pass


def part_of_step(t0: Any, t1: Any, t: Any, dtype: Any) -> Array:
    """(t - t0) / (t1 - t0); zero in a step of no length."""
    length = t1 - t0
    no_step = length == 0
    s = jnp.where(no_step, jnp.zeros_like(length), t - t0) / jnp.where(no_step, jnp.ones_like(length), length)
    return s.astype(dtype)
