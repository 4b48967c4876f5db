"""A rigid body's principal moments as components, with all that flights compute from them once a run."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from ..model.bodies import RigidBody

_LARGEST_START = 12.0  # radians of h |Omega| at the start of a flight


class Inertia(NamedTuple):
    """A rigid body's principal moments as components, made ready once a run rather than once a step.

    Flights work in units of the largest moment, so that no unit of mass or length can make a product overflow, or
    vanish: moments, momentum and torque multiplied by a power of two change no bit of the attitude.

    Attributes:
        moments, inverses: I and 1/I.
        per_unit: 1 / the largest moment.
        relative: I * per_unit.
        spins: 1 / relative, at least 1: angular velocity is spins * per_unit * momentum.
        bends: (I_k - I_j)^2 / (12 I_i) * per_unit, the second term of the free body's generating function.
        gaps: (1/I_k - 1/I_j) / per_unit, (i, j, k) cyclic: Euler's equations are Pi_i' = per_unit gaps_i Pi_j Pi_k.
        middle: one on the axis of the middle moment, zero on the others.
    """

    moments: cp.Vector
    inverses: cp.Vector
    per_unit: Array
    relative: cp.Vector
    spins: cp.Vector
    bends: cp.Vector
    gaps: cp.Vector
    middle: cp.Vector

    @classmethod
    def of(cls, body: RigidBody) -> "Inertia":
        a, b, c = moments = cp.vector(body.moments)
        largest = cp.largest(moments)
        per_unit = 1 / largest
        spins = (largest / a, largest / b, largest / c)
        # Of the moments, not of their inverses: of two that are nearly equal the difference is exact.
        differences = cp.scale(per_unit, (b - c, c - a, a - b))
        bends = cp.scale(1 / 12, cp.times(cp.times(differences, differences), spins))
        gaps = cp.times(differences, (spins[1] * spins[2], spins[2] * spins[0], spins[0] * spins[1]))
        first = differences[1] * differences[2] >= 0
        second = ~first & (differences[2] * differences[0] >= 0)
        one, zero = jnp.ones_like(a), jnp.zeros_like(a)
        x, y, z = (jnp.where(here, one, zero) for here in (first, second, ~first & ~second))
        inverses, relative = (1 / a, 1 / b, 1 / c), cp.scale(per_unit, moments)
        return cls(moments, inverses, per_unit, relative, spins, bends, gaps, (x, y, z))

    def on_first_root(self, y: cp.Vector) -> Array:
        """Whether a flight of travel y begins slowly enough for its equation to have one small root.

        The momentum of a slender body may lie so near its thin axis that it begins with many turns about it, and has
        more than one rotation by which a midpoint rule is satisfied: from 30 radians on, as a search found.
        """
        turn = cp.times(self.spins, y)
        return cp.dot(turn, turn) <= _LARGEST_START**2

    def velocity(self, momentum: cp.Vector) -> cp.Vector:
        """The angular velocity I^-1 Pi."""
        return cp.times(self.inverses, momentum)

    def travel(self, h: Array, momentum: cp.Vector) -> cp.Vector:
        """h times the momentum, in units of the largest moment: the turn of a ball of that moment."""
        return cp.scale(h, cp.scale(self.per_unit, momentum))
