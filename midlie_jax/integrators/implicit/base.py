"""`Implicit`, the base class of the implicit methods, and the convergence test of a solve."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ...model.bodies import RigidBody
from ..base import Method
from ..system import System

# Newton steps with the exact Jacobian; five suffice up to a rotation of |Psi| = 1.5.
ITERATIONS = 5
# In units of eps times the largest term; large, because a torque whose terms cancel has large rounding errors.
_RESIDUAL_LIMIT = 1024


class Implicit(Method):
    """A method of order 2 whose step is solved by Newton's method, with the torque in the residual."""

    name: eqx.AbstractVar[str]
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=True)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=True)
    bodies: type[Any] = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=4 * ITERATIONS + 2)

    def stability_limit(self, direction: complex) -> float:
        """2: above, the equation of a step may have several solutions (`tests/test_limits.py`), and NMB is unstable."""
        del direction
        return 2.0

    @property
    def solves(self) -> int:
        return 1

    def keeps_force(self, system: System) -> bool:
        return False


def converged(residual: Array, *terms: cp.Vector) -> Array:
    """Whether the residual is at the level of rounding of the largest of its terms."""
    size = cp.largest(terms[0])
    for term in terms[1:]:
        size = jnp.maximum(size, cp.largest(term))
    return residual <= _RESIDUAL_LIMIT * cp.epsilon(size) * size
