"""`RotationNorm`, the size of an error, with momentum and attitude measured separately."""

from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ..model.state import State


class RotationNorm(eqx.Module):
    """A norm for `diffrax.PIDController(norm=...)` that measures momentum and attitude separately.

    The norm is the larger of two numbers: the length of the momentum error in units of `momentum`, and the angle of the
    rotation between the two attitudes in units of `angle`. For a body that translates it is the largest of four, with
    the errors of linear momentum and position in units of `linear` and `position`. PIDController divides errors entry
    by entry by atol + rtol |y| before it calls the norm, and entries of a quaternion pass through zero. With rtol=0 the
    angle is therefore exact, and `atol` is the error allowed per step, in these units. With 0 < rtol <= atol the norm
    is accurate within a factor of 2. `BacksolveAdjoint` solves for the state, its adjoint and more together; only the
    state is measured.

    Attributes:
        momentum: the unit of momentum error.
        angle: the unit of attitude error, in radians.
        linear: the unit of the error of the linear momentum.
        position: the unit of position error.

    Examples:
        >>> import diffrax
        >>> norm = ml.diffrax.RotationNorm(momentum=50.0)  # a momentum error of 50 has the weight of one radian
        >>> controller = diffrax.PIDController(rtol=0.0, atol=1e-6, norm=norm)
    """

    momentum: float | Array = 1.0
    angle: float | Array = 1.0
    linear: float | Array = 1.0
    position: float | Array = 1.0

    def __call__(self, error: Any) -> Array:
        (state, *_) = [x for x in jax.tree.leaves(error, is_leaf=_is_state) if _is_state(x)]
        units = self.momentum, self.angle, self.linear, self.position
        return reduce(jnp.maximum, (size / unit for size, unit in zip(state.kind.sizes(state), units, strict=False)))


def _is_state(part: Any) -> bool:
    return isinstance(part, State)
