"""Three-axis splitting: exact rotations about one body axis after the other.

The kinetic energy is a sum of Pi_i^2 / (2 I_i). The flow of each term is a rotation by h Pi_i / I_i about axis i.
Dullweber, Leimkuhler & McLachlan, J. Chem. Phys. 107 (1997) 5840.
"""

from typing import ClassVar

from jax import Array

from ..._math import components as cp
from ..._math.short_series import LARGEST_SQUARE, LARGEST_TURN, spin
from ...model.bodies import RigidBody
from ...model.inertia import Inertia
from ..verdict import verdict
from .base import JudgedFlight

# Index of the axis and fraction of h, for each rotation.
_SWEEP = ((2, 0.5), (1, 0.5), (0, 1.0), (1, 0.5), (2, 0.5))


class ThreeAxis(JudgedFlight):
    """Rotations about the axes 3, 2, 1, 2, 3: order 2, symplectic, no solve.

    The flight reports False in `ok` if it rotates by more than 2.4 radians about one axis.

    Examples:
        >>> turn, change, ok = ml.flights.ThreeAxis()(inertia, jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)
        (Array([ 0.9982,  0.0502,  0.019 , -0.0264], dtype=float64), True)
        >>> ml.method(ml.flights.ThreeAxis(), "EA").name
        'DLM[EA]'
    """

    name: ClassVar[str] = "DLM"
    use: ClassVar[str] = "comparison with the usual splitting of molecular dynamics (NO_SQUISH): no solve"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
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
        # The change of the momentum is computed from the whole increment, with one rounding; `turned` only gives the
        # next angle.
        change = cp.rotation_change(cp.conjugate(increment), momentum)
        return increment, change, verdict(True, (square_sum, LARGEST_SQUARE))
