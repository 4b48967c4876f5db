"""Three-axis splitting: rotations about the body's axes in turn, each exact.

The kinetic energy is a sum of Pi_i^2 / (2 I_i), and the flow of each term a rotation by h Pi_i / I_i about axis i.
Dullweber, Leimkuhler & McLachlan, J. Chem. Phys. 107 (1997) 5840.
"""

from typing import ClassVar

from jax import Array

from ..._kernel import components as cp
from ..._kernel.short_series import LARGEST_SQUARE, spin
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight

# Axis 2 and 3 by halves around axis 1.
_SWEEP = ((2, 0.5), (1, 0.5), (0, 1.0), (1, 0.5), (2, 0.5))


class ThreeAxis(Flight):
    """Rotations about the axes 3, 2, 1, 2, 3: order 2, symplectic, no solve.

    Says False where it turned by more than 2.4 radians about an axis.
    """

    name: ClassVar[str] = "DLM"
    use: ClassVar[str] = "comparison with the usual splitting of molecular dynamics (NO_SQUISH): no solve"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 4

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        zero = h * 0
        increment: cp.Quaternion = (zero + 1, zero, zero, zero)
        largest, turned = zero, momentum
        for axis, part in _SWEEP:
            half = part * h / 2 * (inertia.inverses[axis] * turned[axis])
            largest = largest + half * half
            cosine, sine = spin(half)
            increment = cp.multiply_about(increment, axis, cosine, sine)
            turned = cp.rotate_back_about(axis, cosine, sine, turned)
        # By the whole turn at once, which is rounded once; those between serve for the next angle alone.
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), largest <= LARGEST_SQUARE
