"""What the implicit methods share: the state half way, and when a solve counts as converged."""

import jax.numpy as jnp
from jax import Array

from .. import _components as cp
from ..stepper import Motion, System

# Newton steps with the exact Jacobian; |Psi| = 1.5 needs five.
ITERATIONS = 5
# Units of rounding of the largest term; a torque that cancels within itself is rounded more coarsely than its size.
_RESIDUAL_LIMIT = 1024


def converged(residual: Array, *terms: cp.Vector) -> Array:
    """Whether the residual is rounding, next to the largest of the terms that it balances."""
    size = cp.largest(terms[0])
    for term in terms[1:]:
        size = jnp.maximum(size, cp.largest(term))
    return residual <= _RESIDUAL_LIMIT * cp.epsilon(size) * size


def carried(momentum: cp.Vector, half: cp.Quaternion, impulse: cp.Vector, t: Array) -> cp.Vector:
    """The momentum at the end of a step from time t that turns by twice `half`.

    The impulse acts in the middle of the step, and is given in the body's frame there.
    """
    turned = cp.rotation_change(cp.conjugate(cp.square(half)), momentum)
    return cp.accumulate(momentum, cp.add(turned, cp.rotate_back(half, impulse)), t)


def middle(system: System, motion: Motion, h: Array, w: cp.Vector, half: cp.Quaternion) -> Motion:
    """The motion half way through a step that turns by 2 w: momentum 2 I w / h, pose turned by exp(w)."""
    still = h == 0
    rate = 2 / jnp.where(still, jnp.ones_like(h), h)
    momentum = cp.times(system.inertia.moments, cp.scale(rate, w))
    kept = tuple(jnp.where(still, p, m) for p, m in zip(motion.momentum, momentum, strict=True))
    return Motion(kept, system.kind.rotate(motion.pose, half))
