"""How large an error is: momentum and attitude each for what it is."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ..model.states import RigidState


class RotationNorm(eqx.Module):
    """A norm for `diffrax.PIDController(norm=...)` that takes momentum and attitude each for what it is.

    The larger of the momentum's error, by its length, in units of `momentum`, and of the attitude's, the angle of the
    rotation between the two, in units of `angle`. PIDController divides errors entry by entry by atol + rtol |y|
    before it asks for the norm, and entries of a quaternion pass through zero. So with rtol=0 the angle is exact, and
    `atol` is the error allowed a step, in those units; with an rtol of up to atol it is right within a factor of 2.

    Attributes:
        momentum: the size of momentum that counts as one.
        angle: the angle that counts as one, in radians.
    """

    momentum: float | Array = 1.0
    angle: float | Array = 1.0

    def __call__(self, error: Any) -> Array:
        first, *rest = [jnp.sqrt(jnp.sum(leaf**2)) for leaf in jax.tree.leaves(error)]
        # Half the angle is in a unit quaternion's difference, the whole in that of a direction.
        factor = 2.0 if isinstance(error, RigidState) else 1.0
        return jnp.maximum(first / self.momentum, factor * rest[0] / self.angle) if rest else first / self.momentum
