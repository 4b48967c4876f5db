"""The derivative of the flight of a symmetric body, with moments that may become unequal; axis 3 is that of symmetry.

The formulas of `symmetric.py` hold for equal moments only, so the derivative with respect to the difference of the two
moments follows by variation of constants. With inverse moments a + e, a - e, c the energy is that of the symmetric body
plus e H1, H1 = (Pi1^2 - Pi2^2)/2. To first order in e, the motion is the flow of e K followed by the motion of the
symmetric body, where K is the integral of H1 along the motion of the symmetric body:

    K(Pi0) = h/2 sinc(b) Re(z^2 exp(-i b)),    z = Pi1 + i Pi2,    b = h (c - a) Pi3,    sinc(b) = sin(b)/b

The flow of e K changes the momentum by e Pi x grad K. The motion that follows turns the momentum by -b about axis 3.
The derivative of the rotation of the body follows from that of its momentum (`turn_tangent`), with

    lag = h^2 Pi3/2 (Im(z^2) sinc(b)^2 / 2 - Re(z^2) (b - sin(b) cos(b)) / (2 b^2))
"""

from typing import NamedTuple

from jax import Array

from ..._kernel import components as cp
from ..._kernel.short_series import cosine_and_sinc, stumpff
from .turn_tangent import Changes


class Turning(NamedTuple):
    """The flight of a symmetric body.

    Attributes:
        h: the time.
        gap: c - a in units of the largest moment.
        per_unit: 1 / the largest moment.
        momentum, scaled: the momentum at the start, and in units of the largest moment.
        angle: b.
        cosine, sinc: of b/2.
    """

    h: Array
    gap: Array
    per_unit: Array
    momentum: cp.Vector
    scaled: cp.Vector
    angle: Array
    cosine: Array
    sinc: Array

    @classmethod
    def of(cls, h: Array, gap: Array, per_unit: Array, momentum: cp.Vector) -> "Turning":
        scaled = cp.scale(per_unit, momentum)
        angle = h * (gap * scaled[2])
        return cls(h, gap, per_unit, momentum, scaled, angle, *cosine_and_sinc(angle / 2))

    def momentum_tangent(self, changes: Changes) -> cp.Vector:
        """The tangent of the change of the momentum."""
        start, shift, along = changes.momentum, None, self.scaled[2]
        if changes.spins is not None:
            a, b, _ = changes.spins
            shift = cp.scale(a - b, cp.cross(self.momentum, cp.scale(0.5, self._gradient())))
            start = cp.add(start, shift)
        angle = self.h * self.gap * self.per_unit * start[2]
        if changes.h is not None:
            angle = angle + changes.h * (self.gap * along)
        if changes.spins is not None:
            a, b, c = changes.spins
            angle = angle + (self.h * along) * (c - 0.5 * (a + b))
        x, y, _ = self._turned(self.momentum)
        u, v, w = cp.rotation_change_about(2, self.cosine, self.angle / 2 * self.sinc, start)
        change = u + angle * y, v - angle * x, w
        return change if shift is None else cp.add(change, shift)

    def _turned(self, vector: cp.Vector) -> cp.Vector:
        """The vector, turned by -b."""
        return cp.rotate_back_about(2, self.cosine, self.angle / 2 * self.sinc, vector)

    def _whole_angle(self) -> tuple[Array, Array, Array]:
        """sin(b)/b, (1 - cos b)/b^2 and (b - sin b)/b^3."""
        _, three, _, _ = stumpff(self.angle * self.angle)
        return self.cosine * self.sinc, 0.5 * self.sinc * self.sinc, three

    def _gradient(self) -> cp.Vector:
        """The gradient of K with respect to the momentum."""
        x, y, _ = self.scaled
        sinc, two, three = self._whole_angle()
        u, v, _ = self._turned(self.scaled)  # z exp(-i b)
        along = self.angle * (three - two) * (x * u - y * v) + sinc * (x * v + y * u)
        return self.h * sinc * u, -self.h * sinc * v, 0.5 * self.h * self.h * self.gap * along

    def lag(self) -> Array:
        """The integral of (h - t) Pi_1 Pi_2 Pi_3, with momenta in units of the largest moment."""
        x, y, z = self.scaled
        sinc, two, three = self._whole_angle()
        even, odd = x * y * (sinc * sinc), 0.5 * (x * x - y * y) * self.angle * (three + sinc * two)
        return 0.5 * self.h * self.h * z * (even - odd)
