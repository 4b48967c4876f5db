"""What every implicit method is, and when a solve counts as converged."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..._kernel import components as cp
from ...model.bodies import RigidBody
from ..base import Method
from ..system import System

# Newton steps with the exact Jacobian; |Psi| = 1.5 needs five.
ITERATIONS = 5
# Units of rounding of the largest term; a torque that cancels within itself is rounded more coarsely than its size.
_RESIDUAL_LIMIT = 1024


class Implicit(Method):
    """A step of order 2 that solves for three unknowns by Newton's method, with the torque in the residual."""

    name: eqx.AbstractVar[str]
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=True)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=True)
    bodies: type[Any] = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=4 * ITERATIONS + 2)

    def keeps_force(self, system: System) -> bool:
        return False


def converged(residual: Array, *terms: cp.Vector) -> Array:
    """Whether the residual is rounding, next to the largest of the terms that it balances."""
    size = cp.largest(terms[0])
    for term in terms[1:]:
        size = jnp.maximum(size, cp.largest(term))
    return residual <= _RESIDUAL_LIMIT * cp.epsilon(size) * size
