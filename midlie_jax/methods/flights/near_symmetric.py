"""Near-symmetric splitting: the exact flight of a symmetric body, and what the third moment adds to it.

The kinetic energy is that of a body with moments (I2, I2, I3) plus (1/I1 - 1/I2) Pi1^2 / 2, and the flow of the latter
a rotation about axis 1. Dullweber, Leimkuhler & McLachlan, J. Chem. Phys. 107 (1997) 5840, section III.
"""

from typing import ClassVar

from jax import Array

from ..._kernel import components as cp
from ..._kernel.short_series import LARGEST_SQUARE, spin
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight
from .symmetric import symmetric_turn, within_reach


class NearSymmetric(Flight):
    """Half a rotation about axis 1, the symmetric flight, half a rotation: order 2, symplectic, no solve.

    Its error is proportional to the difference of the first two moments: name the axes so that these are nearest.
    Says False where it turned by more than 2.4 radians in one of its parts.
    """

    name: ClassVar[str] = "NEARSYM"
    use: ClassVar[str] = "bodies whose first two moments are nearly equal; as fast as JACOBI, which is exact"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 4

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        # 1/I1 - 1/I2, from the difference of the moments themselves.
        gap = -inertia.gaps[2] * inertia.per_unit

        def about_first(momentum: cp.Vector) -> tuple[Array, tuple[Array, Array]]:
            """The square of half the angle, and its cosine and sine."""
            half = h / 4 * gap * momentum[0]
            return half * half, spin(half)

        zero = h * 0
        first, before = about_first(momentum)
        turned = cp.rotate_back_about(0, *before, momentum)
        _, b, c = inertia.inverses
        increment, about_third = symmetric_turn(h, b, c, turned)
        ok = within_reach(h, b, c, turned)
        turned = cp.rotate_back_about(2, *about_third, turned)
        last, after = about_first(turned)
        increment = cp.multiply((*before, zero, zero), cp.multiply_about(increment, 0, *after))
        # By the whole turn at once, which is rounded once; those between serve for the next angle alone.
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok & (first + last <= LARGEST_SQUARE)
