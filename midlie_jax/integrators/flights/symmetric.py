"""The exact flight of a body with two equal moments: two rotations and no solve. With I1 = I2,

b = h (1/I3 - 1/I1) Pi3,    R1 = R0 exp(h Pi0/I1) exp(b e3),    Pi1 = exp(-b e3) Pi0

Their derivatives, with moments that may become unequal, are in `symmetric_tangent`.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._math import components as cp
from ..._math.short_series import WIDEST_SQUARE, WIDEST_TURN, cosine_and_sinc, half_angle
from ...model.bodies import Body
from ...model.inertia import Inertia
from ...model.rotor import SymmetricRotor
from ..verdict import verdict
from .axis_turn import AxisTurn
from .base import Flight
from .exact import ExactFlight, Flown
from .symmetric_tangent import Functions, Turning
from .turn_tangent import Changes, is_zero, with_zeros

_EQUALITY_TOLERANCE = 8  # units of eps by which inverse moments may differ and still count as equal


class Symmetric(ExactFlight):
    """The exact flight of bodies with two equal moments; symplectic; conserves energy and spatial momentum to rounding.

    The flight reports False in `ok` if no two inverse moments agree to 8 eps, or if one of its rotations exceeds 4.4
    radians. Its derivatives with respect to the moments allow unequal moments. They exist to first order only; a second
    derivative with respect to the moments raises a ValueError (use JACOBI).

    Attributes:
        axis: the index of the axis of symmetry, 0, 1 or 2; None to find the axis in every flight, at a small cost.

    Examples:
        >>> momentum = ml.flights.components.vector(jnp.array([1.0, 0.8, -1.3]))  # a tuple of scalars
        >>> top = ml.RigidBody([2.0, 2.0, 1.0])
        >>> turn, change, ok = ml.flights.Symmetric(axis=2)(top.inertia(), jnp.array(0.1), momentum)
        >>> jnp.stack(turn).round(4), bool(ok)
        (Array([ 0.9974,  0.0243,  0.0208, -0.0649], dtype=float64), True)
        >>> ml.method(ml.flights.Symmetric(axis=2), "EA").name
        'SYMMETRIC[EA]'
    """

    axis: int | None = eqx.field(static=True, default=None)

    name: ClassVar[str] = "SYMMETRIC"
    use: ClassVar[str] = "bodies with two equal moments: exact, 3 times faster than JACOBI, 6 times on an AxisState"
    equal_moments: ClassVar[bool] = True
    also: ClassVar[tuple[type[Body], ...]] = (SymmetricRotor,)
    per_loop: ClassVar[int] = 4
    per_kernel: ClassVar[int] = 4
    reach: ClassVar[float] = WIDEST_TURN

    def fitted(self, body: Body) -> Flight:
        """This flight with the axis of symmetry fixed, if all of a batch of rigid bodies share an axis.

        The flight of a `SymmetricRotor` is an `AxisTurn`.

        Raises:
            ValueError: no two moments of a body are equal.
        """
        if isinstance(body, SymmetricRotor):
            return AxisTurn()
        moments = getattr(body, "moments", None)
        if moments is None or cp.is_traced(moments):
            return self
        a, b, c = (1 / np.asarray(moments)[..., k] for k in range(3))
        equal = {2: _equal(a, b), 0: _equal(b, c), 1: _equal(c, a)}  # axis 2 comes first and is chosen for a ball
        if not np.all(equal[0] | equal[1] | equal[2]):
            raise ValueError(
                "method SYMMETRIC needs bodies with two equal moments, got moments "
                f"{np.array2string(np.asarray(moments), threshold=12)}; use JACOBI for any body."
            )
        return Symmetric(next((axis for axis, holds in equal.items() if np.all(holds)), None))

    def verdict(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Array:
        numbering = _Numbering.of(inertia.inverses, self.axis)
        inverses = numbering.renumbered(inertia.inverses)
        sizes = bounded(h, inverses[0], inverses[2], numbering.renumbered(momentum))
        return verdict(_equal(inverses[0], inverses[1]), *sizes)

    def formula(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Flown:
        numbering = _Numbering.of(inertia.inverses, self.axis)
        a, _, c = numbering.renumbered(inertia.inverses)
        renumbered = numbering.renumbered(momentum)
        (w, *u), about_third, functions = symmetric_turn(h, a, c, renumbered)
        change = cp.rotation_change_about(2, *about_third, renumbered)
        return Flown((w, *numbering.restored((u[0], u[1], u[2]))), numbering.restored(change), functions)

    def tangent(
        self, inertia: Inertia, h: Array, momentum: cp.Vector, flown: Flown, changes: Changes
    ) -> tuple[cp.Vector, cp.Vector, Functions]:
        inertia = _first_derivatives_only(inertia)
        numbering = _Numbering.of(inertia.inverses, self.axis)
        spin, gap = numbering.renumbered(inertia.spins)[0], numbering.renumbered(inertia.gaps)[0]
        flight = Turning.of(h, spin, gap, inertia.per_unit, numbering.renumbered(momentum), flown.parts)
        renumbered = changes._replace(
            spins=None if changes.spins is None else numbering.renumbered(changes.spins),
            momentum=numbering.renumbered(changes.momentum),
        )
        w, *u = flown.increment
        change, chi, functions = flight.tangent(renumbered, (w, *numbering.renumbered((u[0], u[1], u[2]))))
        return numbering.restored(change), numbering.restored(chi), functions

    def turn_rate(self, inertia: Inertia, momentum: cp.Vector) -> Array:
        numbering = _Numbering.of(inertia.inverses, self.axis)
        inverses = numbering.renumbered(inertia.inverses)
        return larger_rate(inverses[0], inverses[2], numbering.renumbered(momentum))


def _equal(a: Any, b: Any) -> Any:
    return abs(a - b) <= _EQUALITY_TOLERANCE * float(np.finfo(a.dtype).eps) * a


class _Numbering(NamedTuple):
    """The axes renumbered cyclically, so that the axis of symmetry becomes the third; `was_first`: it is the first of
    the body.

    The attributes are Python bools, or arrays if the axis is unknown before tracing.
    """

    was_first: Any
    was_second: Any

    @classmethod
    def of(cls, inverses: cp.Vector, axis: int | None) -> "_Numbering":
        if axis is not None:
            return cls(axis == 0, axis == 1)
        a, b, c = inverses
        third, first = _equal(a, b), _equal(b, c)
        return cls(~third & first, ~third & ~first & _equal(c, a))

    def renumbered(self, v: cp.Vector) -> cp.Vector:
        return self._select((v[1], v[2], v[0]), (v[2], v[0], v[1]), v)

    def restored(self, v: cp.Vector) -> cp.Vector:
        return self._select((v[2], v[0], v[1]), (v[1], v[2], v[0]), v)

    def _select(self, first: cp.Vector, second: cp.Vector, third: cp.Vector) -> cp.Vector:
        if isinstance(self.was_first, bool):
            return first if self.was_first else second if self.was_second else third
        x, y, z = (
            jnp.where(self.was_first, a, jnp.where(self.was_second, b, c))
            for a, b, c in zip(first, second, third, strict=True)
        )
        return x, y, z


def _rotations(h: Array, a: Array, c: Array, momentum: cp.Vector) -> tuple[cp.Vector, Array]:
    """Half of the rotation vector along the momentum, and half of the angle about axis 3."""
    return cp.scale(h / 2, cp.scale(a, momentum)), h / 2 * ((c - a) * momentum[2])


def symmetric_turn(
    h: Array, a: Array, c: Array, momentum: cp.Vector
) -> tuple[cp.Quaternion, tuple[Array, Array], Functions]:
    """The rotation in time h of a body with 1/I1 = 1/I2 = a and 1/I3 = c.

    Also the cosine and sine of half the angle b (in the body frame, the momentum rotates by -b about axis 3), and the
    functions of both angles.
    """
    turn, angle = _rotations(h, a, c, momentum)
    cosine, sinc = cosine_and_sinc(angle)
    sine = angle * sinc
    w, s = half_angle(cp.dot(turn, turn))  # the cosine of |v|/4, and its sine over |v|/2
    increment = cp.multiply_about(cp.square((w, *cp.scale(s, turn))), 2, cosine, sine)
    return increment, (cosine, sine), Functions(cosine, sinc, 2 * (w * s) * (w * s))


def larger_rate(a: Array, c: Array, momentum: cp.Vector) -> Array:
    return jnp.maximum(a * cp.norm(momentum), abs((c - a) * momentum[2]))


def bounded(h: Array, a: Array, c: Array, momentum: cp.Vector) -> list[tuple[Array, float]]:
    turn, angle = _rotations(h, a, c, momentum)
    return [(cp.dot(turn, turn), WIDEST_SQUARE), (angle * angle, WIDEST_SQUARE)]


@jax.custom_jvp
def _first_derivatives_only(inertia: Inertia) -> Inertia:
    """The inertia unchanged, for a derivative that is wrong in second order: differentiating again raises."""
    return inertia


def _refuse_second_derivatives(primals: Any, tangents: Any) -> Any:
    if all(map(is_zero, jax.tree.leaves(tangents[0], is_leaf=is_zero))):
        return primals[0], with_zeros(tangents[0], primals[0])
    raise ValueError(
        "the flight SYMMETRIC has only first derivatives with respect to the moments; use JACOBI, which has all orders."
    )


_first_derivatives_only.defjvp(_refuse_second_derivatives, symbolic_zeros=True)
