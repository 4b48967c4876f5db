"""The exact flight of a body with two equal moments: two rotations and no solve. With I1 = I2,

b = h (1/I3 - 1/I1) Pi3,    R1 = R0 exp(h Pi0/I1) exp(b e3),    Pi1 = exp(-b e3) Pi0

Their derivatives allow moments that become unequal. The formulas hold for equal moments only, so the derivative with
respect to the difference of the two moments follows by variation of constants. With inverse moments a + e, a - e, c the
energy is the energy of the symmetric body plus e H1, H1 = (Pi1^2 - Pi2^2)/2. To first order in e, the motion is the
flow of e K followed by the motion of the symmetric body, where K is the integral of H1 along the motion of the
symmetric body:

    K(Pi0) = h/2 sinc(b) Re(z^2 exp(-i b)),    z = Pi1 + i Pi2,    b = h (c - a) Pi3,    sinc(b) = sin(b)/b

The flow of e K changes the momentum by e Pi x grad K and rotates the body by e grad K. The following motion rotates the
body by Q = exp(v) exp(b e3), v = h a Pi, and its momentum by -b about axis 3. The chi of `exact` is therefore

    chi = e grad K + dv + (1 - cos |v|)/|v|^2 v x dv + (|v| - sin |v|)/|v|^3 v x (v x dv) + db Q e3

with the derivative of the exponential, and with exp(v) e3 = Q e3, because the second rotation does not change e3.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._math import components as cp
from ..._math.short_series import WIDEST_SQUARE, WIDEST_TURN, cosine_and_sinc, half_angle, stumpff
from ...model.bodies import Body, SymmetricRotor
from ...model.inertia import Inertia
from ..verdict import verdict
from .axis_turn import AxisTurn
from .base import Flight
from .exact import Changes, ExactFlight, Flown, is_zero, with_zeros


class Functions(NamedTuple):
    """Functions of the angles of a flight, for value and tangent: cos and sinc of b/2; (1 - cos |v|)/|v|^2."""

    cosine: Array
    sinc: Array
    two: Array

    def tangent(self, half: Array, square: Array, half_change: Array, square_change: Array) -> "Functions":
        """The tangents, for tangents of half = b/2 and of square = |v|^2."""

        def functions(half: Array, square: Array) -> Functions:
            return Functions(*cosine_and_sinc(half), stumpff(square)[0])

        return jax.jvp(functions, (half, square), (half_change, square_change))[1]


class Turning(NamedTuple):
    """The flight of a symmetric body; `spin` and `gap` are a and c - a, and `scaled` the momentum, in units of the
    largest moment, and `angle` is b.
    """

    h: Array
    spin: Array
    gap: Array
    per_unit: Array
    momentum: cp.Vector
    scaled: cp.Vector
    angle: Array
    functions: Functions

    @classmethod
    def of(
        cls, h: Array, spin: Array, gap: Array, per_unit: Array, momentum: cp.Vector, functions: Functions
    ) -> "Turning":
        scaled = cp.scale(per_unit, momentum)
        return cls(h, spin, gap, per_unit, momentum, scaled, h * (gap * scaled[2]), functions)

    def tangent(self, changes: Changes, increment: cp.Quaternion) -> tuple[cp.Vector, cp.Vector, Functions]:
        """The tangent of the change of the momentum, chi, and the tangents of the functions."""
        start, shift, flow, along = changes.momentum, None, None, self.scaled[2]
        if changes.spins is not None:
            a, b, _ = changes.spins
            flow = cp.scale(0.5 * (a - b), self._gradient())
            shift = cp.cross(self.momentum, flow)
            start = cp.add(start, shift)
        angle = self.h * self.gap * self.per_unit * start[2]
        if changes.h is not None:
            angle = angle + changes.h * (self.gap * along)
        if changes.spins is not None:
            a, b, c = changes.spins
            angle = angle + (self.h * along) * (c - 0.5 * (a + b))
        x, y, _ = self._turned(self.momentum)
        u, v, w = self._turned(start)
        change = u - start[0] + angle * y, v - start[1] - angle * x, w - start[2]
        chi, functions = self._chi(changes, start, angle, increment)
        if shift is None or flow is None:
            return change, chi, functions
        return cp.add(change, shift), cp.add(chi, flow), functions

    def _chi(
        self, changes: Changes, start: cp.Vector, angle: Array, increment: cp.Quaternion
    ) -> tuple[cp.Vector, Functions]:
        """The chi of the two rotations and the tangents of the functions, from the tangents of b and the momentum."""
        turn = cp.scale(self.h * self.spin, self.scaled)
        change = cp.scale(self.h * self.spin * self.per_unit, start)
        rate = None if changes.h is None else changes.h * self.spin
        if changes.spins is not None:
            more = 0.5 * self.h * (changes.spins[0] + changes.spins[1])
            rate = more if rate is None else rate + more
        if rate is not None:
            change = cp.add(change, cp.scale(rate, self.scaled))
        square, growth = cp.dot(turn, turn), cp.dot(turn, change)
        _, three, _, _ = stumpff(square)
        across, along = cp.scale(self.functions.two, cp.cross(turn, change)), cp.scale(three * growth, turn)
        third = cp.scale(angle, _third_axis(increment))
        chi = cp.add(cp.add(cp.scale(1 - three * square, change), across), cp.add(along, third))
        return chi, self.functions.tangent(self.angle / 2, square, angle / 2, 2 * growth)

    def _turned(self, vector: cp.Vector) -> cp.Vector:
        return cp.rotate_back_about(2, self.functions.cosine, self.angle / 2 * self.functions.sinc, vector)

    def _whole_angle(self) -> tuple[Array, Array, Array]:
        """sin(b)/b, (1 - cos b)/b^2 and (b - sin b)/b^3."""
        _, three, _, _ = stumpff(self.angle * self.angle)
        cosine, sinc, _ = self.functions
        return cosine * sinc, 0.5 * sinc * sinc, three

    def _gradient(self) -> cp.Vector:
        x, y, _ = self.scaled
        sinc, two, three = self._whole_angle()
        u, v, _ = self._turned(self.scaled)  # z exp(-i b)
        along = self.angle * (three - two) * (x * u - y * v) + sinc * (x * v + y * u)
        return self.h * sinc * u, -self.h * sinc * v, 0.5 * self.h * self.h * self.gap * along


def _third_axis(q: cp.Quaternion) -> cp.Vector:
    w, x, y, z = q
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


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
