"""Near-symmetric splitting: the exact flight of a symmetric body, with a correction for the unequal moment.

The kinetic energy is the energy of a body with moments (I2, I2, I3) plus (1/I1 - 1/I2) Pi1^2 / 2. The flow of the
second term is a rotation about axis 1. Dullweber, Leimkuhler & McLachlan, J. Chem. Phys. 107 (1997) 5840, section III.
"""

from typing import ClassVar

from jax import Array

from ..._math import components as cp
from ..._math.short_series import WIDEST_SQUARE, WIDEST_TURN, spin
from ...model.bodies import RigidBody
from ...model.inertia import Inertia
from ..verdict import verdict
from .base import JudgedFlight
from .symmetric import bounded, larger_rate, symmetric_turn


class NearSymmetric(JudgedFlight):
    """Half a rotation about axis 1, the symmetric flight, half a rotation: order 2, symplectic, no solve.

    The error is proportional to the difference of the first two moments: number the axes so that these two are closest.
    The flight reports False in `ok` if one of its rotations exceeds 4.4 radians.

    Examples:
        >>> momentum = ml.flights.components.vector(jnp.array([1.0, 0.8, -1.3]))  # a tuple of scalars
        >>> inertia = ml.RigidBody([1.0, 1.1, 2.0]).inertia()
        >>> turn, change, ok = ml.flights.NearSymmetric()(inertia, jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)
        (Array([ 0.9976,  0.051 ,  0.0348, -0.0326], dtype=float64), True)
        >>> ml.method(ml.flights.NearSymmetric(), "EA").name
        'NEARSYM[EA]'
    """

    name: ClassVar[str] = "NEARSYM"
    use: ClassVar[str] = "bodies whose first two moments are nearly equal; the same speed as JACOBI, which is exact"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
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
        # The change of the momentum is computed from the whole increment, with one rounding; `turned` only gives the
        # next angle.
        return (
            increment,
            cp.rotation_change(cp.conjugate(increment), momentum),
            verdict(True, *sizes, (before_square + after_square, WIDEST_SQUARE)),
        )
