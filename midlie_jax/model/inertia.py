"""`Inertia`: the principal moments of a rigid body, and constants of the flights; `RotorInertia`, for a rotor."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp

_LARGEST_START = 12.0  # the largest h |Omega| at the start of a flight, in radians


class Inertia(NamedTuple):
    """The principal moments of a rigid body and constants derived from them, computed once per run, not once per step.

    Flights use the largest moment as the unit, so no choice of units makes a product overflow or underflow. Multiplying
    moments, momentum and torque by the same power of two changes no bit of the attitude.

    Attributes:
        moments, inverses: I and 1/I.
        per_unit: 1 / the largest moment.
        relative, spins: I * per_unit, and its inverses, at least 1; the velocity is spins * per_unit * momentum.
        quartic: (I_k - I_j)^2 / (12 I_i) * per_unit, of the second term of the free body's generating function
            (`flights/symplectic_midpoint.py`).
        gaps: (1/I_k - 1/I_j) / per_unit, (i, j, k) cyclic; Euler's equations are Pi_i' = per_unit gaps_i Pi_j Pi_k.
        middle: the unit vector along the axis of the middle moment.

    Examples:
        >>> jnp.stack(ml.flights.Inertia.of(ml.RigidBody([1.0, 2.0, 2.5])).velocity(momentum)).round(4)
        Array([ 1.  ,  0.4 , -0.52], dtype=float64)
    """

    moments: cp.Vector
    inverses: cp.Vector
    per_unit: Array
    relative: cp.Vector
    spins: cp.Vector
    quartic: cp.Vector
    gaps: cp.Vector
    middle: cp.Vector

    @classmethod
    def of(cls, body: Any) -> "Inertia":
        a, b, c = moments = cp.vector(body.moments)
        largest = cp.largest(moments)
        per_unit = 1 / largest
        spins = (largest / a, largest / b, largest / c)
        # The gaps use differences of moments, not of inverses: the difference of two nearly equal moments is exact.
        differences = cp.scale(per_unit, (b - c, c - a, a - b))
        quartic = cp.scale(1 / 12, cp.times(cp.times(differences, differences), spins))
        gaps = cp.times(differences, (spins[1] * spins[2], spins[2] * spins[0], spins[0] * spins[1]))
        first = differences[1] * differences[2] >= 0
        second = ~first & (differences[2] * differences[0] >= 0)
        ones, zeros = jnp.ones_like(a), jnp.zeros_like(a)
        x, y, z = (jnp.where(is_middle, ones, zeros) for is_middle in (first, second, ~first & ~second))
        inverses, relative = (1 / a, 1 / b, 1 / c), cp.scale(per_unit, moments)
        return cls(moments, inverses, per_unit, relative, spins, quartic, gaps, (x, y, z))

    def tied(self) -> "Inertia":
        """The same numbers, of which a reverse derivative has cotangents for the moments alone."""
        return _tied(self.moments, self)

    def change(self, by: cp.Vector) -> "Inertia":
        (a, b, c), (da, db, dc), unit = self.moments, by, self.per_unit
        one, zero = jnp.ones_like(a), jnp.zeros_like(a)
        first = jnp.where((a >= b) & (a >= c), one, zero)
        second = jnp.where((b > a) & (b >= c), one, zero)
        largest = unit * cp.dot((first, second, 1 - first - second), by)  # the relative change of the largest moment
        each = cp.times(self.inverses, by)  # the relative changes of the moments
        differences = cp.scale(unit, (b - c, c - a, a - b))
        changes = cp.subtract(cp.scale(unit, (db - dc, dc - da, da - db)), cp.scale(largest, differences))
        x, y, z = self.spins
        dx, dy, dz = spins = cp.times(self.spins, (largest - each[0], largest - each[1], largest - each[2]))
        products, of_products = (y * z, z * x, x * y), (dy * z + y * dz, dz * x + z * dx, dx * y + x * dy)
        quartic = cp.add(
            cp.times(cp.scale(1 / 6, cp.times(differences, changes)), self.spins),
            cp.times(cp.scale(1 / 12, cp.times(differences, differences)), spins),
        )
        return Inertia(
            moments=by,
            inverses=cp.scale(-1.0, cp.times(self.inverses, each)),
            per_unit=-unit * largest,
            relative=cp.scale(unit, cp.subtract(by, cp.scale(largest, self.moments))),
            spins=spins,
            quartic=quartic,
            gaps=cp.add(cp.times(changes, products), cp.times(differences, of_products)),
            middle=cp.scale(0.0, by),
        )

    def bound_of_first_root(self, y: cp.Vector) -> tuple[Array, float]:
        """(h |Omega|)^2 at the start, for y = `travel(h, momentum)`, and its limit for one small root of a midpoint.

        A numerical search found several roots above 30 radians, about the thin axis of a slender body.
        """
        turn = cp.times(self.spins, y)
        return cp.dot(turn, turn), _LARGEST_START**2

    def velocity(self, momentum: cp.Vector) -> cp.Vector:
        return cp.times(self.inverses, momentum)

    def commutator(self, force: cp.Vector) -> cp.Vector:
        """I^-1 T x T, the rate of change of the components of a torque T under rotation with the velocity I^-1 T."""
        return self.gyroscopic(-1, force)

    def gyroscopic(self, h: Array | int, momentum: cp.Vector) -> cp.Vector:
        """h Pi x I^-1 Pi, the change of the momentum by Euler's equations in a short time h, from the gaps.

        It is zero where two moments agree. As h is applied first, nothing overflows unless the change itself does.
        """
        scaled = cp.scale(h * self.per_unit, self.gaps)
        return cp.times(
            cp.times(scaled, (momentum[1], momentum[2], momentum[0])), (momentum[2], momentum[0], momentum[1])
        )

    def square_of_turn(self, h: Array | float, momentum: cp.Vector) -> Array:
        turn = cp.scale(h, self.velocity(momentum))
        return cp.dot(turn, turn)

    def nutation(self, momentum: cp.Vector) -> Array:
        moments = jnp.sort(cp.pack(self.moments))
        low, middle, high = cp.vector(moments)
        mean = jnp.where(middle - low < high - middle, low + middle, middle + high) / 2
        return cp.norm(momentum) / mean

    def travel(self, h: Array, momentum: cp.Vector) -> cp.Vector:
        """h times the momentum, in units of the largest moment: the rotation vector of a ball with that moment."""
        return cp.scale(h, cp.scale(self.per_unit, momentum))


@jax.custom_jvp
def _tied(moments: cp.Vector, inertia: Inertia) -> Inertia:
    return inertia._replace(moments=moments)


@_tied.defjvp
def _tied_jvp(primals: Any, tangents: Any) -> tuple[Inertia, Inertia]:
    inertia = _tied(*primals)  # of which the change is a function, for second derivatives
    return inertia, inertia.change(tangents[0])


class RotorInertia(NamedTuple):
    """Constants of a run: 1 / moment. Momentum and torque are in the space frame."""

    inverse: Array

    def velocity(self, momentum: cp.Vector) -> cp.Vector:
        return cp.scale(self.inverse, momentum)

    def commutator(self, force: cp.Vector) -> cp.Vector:
        return cp.scale(0, force)

    def square_of_turn(self, h: Array | float, momentum: cp.Vector) -> Array:
        turn = cp.scale(h, self.velocity(momentum))
        return cp.dot(turn, turn)

    def nutation(self, momentum: cp.Vector) -> Array:
        return cp.norm(self.velocity(momentum))
