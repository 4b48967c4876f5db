"""What the implicit methods share: the state half way, and when a solve counts as converged."""

import jax.numpy as jnp
from jax import Array

from ..._kernel import components as cp
from ..flights import Inertia
from ..stepper import Motion, System

# Newton steps with the exact Jacobian; |Psi| = 1.5 needs five.
ITERATIONS = 5
_REACH = 0.75  # radians of half the turn
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


def within_reach(inertia: Inertia, h: Array, w: cp.Vector, start: cp.Vector, end: cp.Vector) -> Array:
    """Whether a step that turns by 2 w has one root only: by 1.5 radians at most, and not too fast at either end.

    Beyond that a slender body, or one about its middle axis, may have several rotations by which the rule is satisfied.
    """
    ends = [inertia.on_first_root(inertia.travel(h, momentum)) for momentum in (start, end)]
    return (cp.dot(w, w) <= _REACH**2) & ends[0] & ends[1]


def middle(system: System, motion: Motion, h: Array, w: cp.Vector, half: cp.Quaternion) -> Motion:
    """The motion half way through a step that turns by 2 w: momentum 2 I w / h, pose turned by exp(w)."""
    still = h == 0
    rate = 2 / jnp.where(still, jnp.ones_like(h), h)
    momentum = cp.times(system.inertia.moments, cp.scale(rate, w))
    kept = tuple(jnp.where(still, p, m) for p, m in zip(motion.momentum, momentum, strict=True))
    return Motion(kept, system.kind.rotate(motion.pose, half))
