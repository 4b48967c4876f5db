"""What every flight is: a rule for motion under no torque."""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from .. import _components as cp
from ..bodies import Particles, RigidBody


class Inertia(NamedTuple):
    """A rigid body's principal moments as components, made ready once a run rather than once a step.

    Attributes:
        moments, inverses: I and 1/I.
        per_unit: 1 / the largest moment.
        relative: I * per_unit, in which solvers work so that no unit of mass or length overflows a determinant.
        bends: (I_k - I_j)^2 / (12 I_i) * per_unit, the second term of the free body's generating function.
        gaps: (1/I_k - 1/I_j) / per_unit, (i, j, k) cyclic: Euler's equations are Pi_i' = per_unit gaps_i Pi_j Pi_k.
        middle: one on the axis of the middle moment, zero on the others.
    """

    moments: cp.Vector
    inverses: cp.Vector
    per_unit: Array
    relative: cp.Vector
    bends: cp.Vector
    gaps: cp.Vector
    middle: cp.Vector

    @classmethod
    def of(cls, body: RigidBody) -> "Inertia":
        moments = cp.unpack(body.moments)
        per_unit = 1 / cp.largest(moments)
        inverses = (1 / moments[0], 1 / moments[1], 1 / moments[2])
        a, b, c = moments
        # Of the moments, not of their inverses: of two that are nearly equal the difference is exact.
        differences = (b - c, c - a, a - b)
        bends = cp.scale(per_unit / 12, cp.times(cp.times(differences, differences), inverses))
        products = (inverses[1] * inverses[2], inverses[2] * inverses[0], inverses[0] * inverses[1])
        gaps = cp.times(cp.scale(1 / per_unit, differences), products)
        first = differences[1] * differences[2] >= 0
        second = ~first & (differences[2] * differences[0] >= 0)
        middle = (first, second, ~first & ~second)
        one, zero = jnp.ones_like(a), jnp.zeros_like(a)
        axis = tuple(jnp.where(here, one, zero) for here in middle)
        return cls(moments, inverses, per_unit, cp.scale(per_unit, moments), bends, gaps, (axis[0], axis[1], axis[2]))


class Flight(eqx.Module):
    """A free flight; calling one flies.

    Attributes:
        name: its name in method names.
        order: its order of accuracy as a map; `None` when exact.
        symplectic: whether the map preserves the Lie-Poisson and symplectic structure to rounding.
        body: the kind of body it moves.
        per_loop: how many of it the compiler takes in one loop; a step of more is cut after each. A larger loop XLA's
            CPU emitter cuts into functions that call each other, and so repeats the work many times over.
    """

    name: ClassVar[str]
    order: ClassVar[int | None]
    symplectic: ClassVar[bool]
    body: ClassVar[type[RigidBody] | type[Particles]]
    per_loop: ClassVar[int]

    @abstractmethod
    def __call__(self, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
        """Flies for time h.

        Returns:
            The increment (for a rigid body a unit quaternion in the body frame), the new momentum, and a
            boolean: False where the result is not to be trusted.
        """
