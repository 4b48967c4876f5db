"""Two splittings of the kinetic energy, whose parts rotate the body about fixed axes: no solve.

The flow of each term of Pi_i^2 / (2 I_i) is a rotation by h Pi_i / I_i about axis i. Or the energy is the energy of a
body with moments (I2, I2, I3), whose flow is exact, plus (1/I1 - 1/I2) Pi1^2 / 2, a rotation about axis 1. Dullweber,
Leimkuhler & McLachlan, J. Chem. Phys. 107 (1997) 5840.

The change of the momentum is computed from the whole increment, with one rounding; the momentum after a part only gives
the next angle.
"""

from typing import ClassVar

from jax import Array

from ..._math import components as cp
from ..._math.short_series import LARGEST_SQUARE, LARGEST_TURN, WIDEST_SQUARE, WIDEST_TURN, spin
from ...model.inertia import Inertia
from ..verdict import verdict
from .base import JudgedFlight
from .symmetric import bounded, larger_rate, symmetric_turn

# Index of the axis and fraction of h, for each rotation.
_SWEEP = ((2, 0.5), (1, 0.5), (0, 1.0), (1, 0.5), (2, 0.5))


class ThreeAxis(JudgedFlight):
    """Rotations about the axes 3, 2, 1, 2, 3: order 2, symplectic, no solve.

    The flight reports False in `ok` if it rotates by more than 2.4 radians about one axis.

    Examples:
        >>> ml.method(ml.flights.ThreeAxis(), "EA").name
        'DLM[EA]'
    """

    name: ClassVar[str] = "DLM"
    use: ClassVar[str] = "comparison with the usual splitting of molecular dynamics (NO_SQUISH): no solve"
    order: ClassVar[int | None] = 2
    per_loop: ClassVar[int] = 4
    per_kernel: ClassVar[int] = 2
    reach: ClassVar[float] = LARGEST_TURN

    def turn_rate(self, inertia: Inertia, momentum: cp.Vector) -> Array:
        """The root of the sum of the squares of all rates of rotation, each times its fraction of the flight."""
        x, y, z = (sum(fraction**2 for i, fraction in _SWEEP if i == axis) ** 0.5 for axis in range(3))
        a, b, c = inertia.velocity(momentum)
        return cp.norm((x * a, y * b, z * c))

    def judged(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        zero = h * 0
        increment: cp.Quaternion = (zero + 1, zero, zero, zero)
        square_sum, turned = zero, momentum
        for axis, fraction in _SWEEP:
            half = fraction * h / 2 * (inertia.inverses[axis] * turned[axis])
            square_sum = square_sum + half * half
            cosine, sine = spin(half)
            increment = cp.multiply_about(increment, axis, cosine, sine)
            turned = cp.rotate_back_about(axis, cosine, sine, turned)
        change = cp.rotation_change(cp.conjugate(increment), momentum)
        return increment, change, verdict(True, (square_sum, LARGEST_SQUARE))


class NearSymmetric(JudgedFlight):
    """Half a rotation about axis 1, the symmetric flight, half a rotation: order 2, symplectic, no solve.

    The error is proportional to the difference of the first two moments: number the axes so that these two are closest.
    The flight reports False in `ok` if one of its rotations exceeds 4.4 radians.

    Examples:
        >>> inertia = ml.RigidBody([1.0, 1.1, 2.0]).inertia()
        >>> turn, change, ok = ml.flights.NearSymmetric()(inertia, jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)
        (Array([ 0.9976,  0.051 ,  0.0348, -0.0326], dtype=float64), True)
    """

    name: ClassVar[str] = "NEARSYM"
    use: ClassVar[str] = "bodies whose first two moments are nearly equal; the same speed as JACOBI, which is exact"
    order: ClassVar[int | None] = 2
    per_loop: ClassVar[int] = 4
    per_kernel: ClassVar[int] = 2
    reach: ClassVar[float] = WIDEST_TURN

    def turn_rate(self, inertia: Inertia, momentum: cp.Vector) -> Array:
        return larger_rate(inertia.inverses[1], inertia.inverses[2], momentum)

    def judged(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        # 1/I1 - 1/I2, computed from the difference of the moments.
        gap = -inertia.gaps[2] * inertia.per_unit

        def about_first(momentum: cp.Vector) -> tuple[Array, tuple[Array, Array]]:
            half = h / 4 * gap * momentum[0]
            return half * half, spin(half)

        zero = h * 0
        before_square, before = about_first(momentum)
        turned = cp.rotate_back_about(0, *before, momentum)
        _, b, c = inertia.inverses
        increment, about_third, _ = symmetric_turn(h, b, c, turned)
        sizes = bounded(h, b, c, turned)
        turned = cp.rotate_back_about(2, *about_third, turned)
        after_square, after = about_first(turned)
        increment = cp.multiply((*before, zero, zero), cp.multiply_about(increment, 0, *after))
        change = cp.rotation_change(cp.conjugate(increment), momentum)
        return increment, change, verdict(True, *sizes, (before_square + after_square, WIDEST_SQUARE))
