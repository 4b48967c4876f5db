"""`RotationNorm`, the size of an error, with momentum and attitude measured separately."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ..model.state import State


class RotationNorm(eqx.Module):
    """A norm for `diffrax.PIDController(norm=...)` that measures momentum and attitude separately.

    The norm is the larger of two numbers: the length of the momentum's error in units of `momentum`, and the angle of
    the rotation between the two attitudes in units of `angle`. PIDController divides errors entry by entry by
    atol + rtol |y| before it calls the norm, and entries of a quaternion pass through zero. With rtol=0 the angle is
    therefore exact, and `atol` is the error allowed per step, in these units. With 0 < rtol <= atol the norm is right
    within a factor of 2. Of what `BacksolveAdjoint` solves for together, the state, its adjoint and more, the state
    alone is measured.

    Attributes:
        momentum: the unit of momentum error.
        angle: the unit of attitude error, in radians.
    """

    momentum: float | Array = 1.0
    angle: float | Array = 1.0

    def __call__(self, error: Any) -> Array:
        (state, *_) = [x for x in jax.tree.leaves(error, is_leaf=_is_state) if _is_state(x)]
        momentum, angle = state.sizes()
        return jnp.maximum(momentum / self.momentum, angle / self.angle)


def _is_state(part: Any) -> bool:
    return isinstance(part, State)
