"""The derivative of the flight of a body symmetric about axis 3, with moments that may become unequal.

The formulas of `symmetric.py` hold for equal moments only, so the derivative with respect to the difference of the two
moments follows by variation of constants. With inverse moments a + e, a - e, c the energy is the energy of the
symmetric body plus e H1, H1 = (Pi1^2 - Pi2^2)/2. To first order in e, the motion is the flow of e K followed by the
motion of the symmetric body, where K is the integral of H1 along the motion of the symmetric body:

    K(Pi0) = h/2 sinc(b) Re(z^2 exp(-i b)),    z = Pi1 + i Pi2,    b = h (c - a) Pi3,    sinc(b) = sin(b)/b

The flow of e K changes the momentum by e Pi x grad K and rotates the body by e grad K. The following motion rotates the
body by Q = exp(v) exp(b e3), v = h a Pi, and its momentum by -b about axis 3. The chi of `exact` is therefore

    chi = e grad K + dv + (1 - cos |v|)/|v|^2 v x dv + (|v| - sin |v|)/|v|^3 v x (v x dv) + db Q e3

with the derivative of the exponential, and with exp(v) e3 = Q e3, because the second rotation does not change e3.
"""

from typing import NamedTuple

import jax
from jax import Array

from ..._math import components as cp
from ..._math.short_series import cosine_and_sinc, stumpff
from .turn_tangent import Changes


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
        """The chi of the two rotations and the tangents of the functions, from those of b and of the momentum."""
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
