"""`Orbit`, the motion of one free body in closed form, for `free_motion`, and `Circle`, the motion of a free axis.

The momentum of a free body circles one of the body axes. With right-handed axes labelled so that the momentum circles
the third, on its positive side, and the second is the axis of the middle moment (`Labels`),

    Pi = (A1 cn u, A2 sn u, A3 dn u),    u = u0 + rate t,
    angle' = |Pi| / I1 + |Pi| (1/I3 - 1/I1) / (1 + n sn^2 u),    n = (A1 / A3)^2

where `angle` is the angle of the first axis about the spatial momentum. JACOBI's flight gives both for a short time
after u = 0, and `_math.elliptic` doubles this time as often as needed. Addition theorems then give both for the same
time after the start u0; with sn, cn and dn of the doubled u, r = cn/dn, s = sign sn / sqrt(below w1), `sign` the sign
of I3 - I1, and the momentum p at the start,

    D Pi_1 = (p1 r - w1 s p2 p3)/dn,    D Pi_2 = p2 r + w2 s p1 p3/dn^2,    D Pi_3 = (p3 - w3 s p1 p2 r)/dn,
    D = 1 + p1^2 w2 w3 (s/dn)^2

Here w_l = |1/I_m - 1/I_n| I1 I2 I3 for (l, m, n) cyclic, with w2 = w1 + w3. All constants are quotients and roots of

    above = p1^2 w2 + p2^2 w1,    below = p2^2 w3 + p3^2 w2,    nearness = p3^2 w1 - p1^2 w3 >= 0

The first vanishes if the momentum is along the third axis, the last on the separatrix.

R. van Zon, J. Schofield, J. Comput. Phys. 225 (2007) 145; E. T. Whittaker, Analytical Dynamics, section 69. The
doubling was derived for this package.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.elliptic import Complex, Modulus, Point, half_angle_of, normalised, product, smallest_complement
from ..._math.powers import exponent, power, unit
from ..._math.weierstrass import sigma_functions
from ..._xla.fusion import begin, fuse
from ..._xla.rows import repeat
from ...model.bodies import RigidBody
from ...model.inertia import Inertia, RotorInertia
from ...model.states.unit_vector import Swing
from .jacobi import LARGEST_TURN, Invariants, Jacobi
from .symmetric import Numbering


class Labels(NamedTuple):
    """The permutation from body axes to labelled axes."""

    forward: Array  # whether the axes of the body are counted from the next axis
    backward: Array  # or from the previous axis
    exchanged: Array  # whether the first and the third axis are then exchanged
    side: Array  # the sign of the third axis; the momentum is on its positive side

    @classmethod
    def of(cls, middle: cp.Vector, weights: cp.Vector, momentum: cp.Vector) -> "Labels":
        """Labels from the unit vector along the middle axis, the weights w of `free_orbit`, and the momentum."""
        one = jnp.ones_like(momentum[0])
        labels = cls(middle[2] > 0, middle[0] > 0, one < 0, one)
        (w1, _, w3), (p1, _, p3) = labels.placed(weights), labels.placed(momentum)
        before, after = p1 * p1 * w3, p3 * p3 * w1
        # On the separatrix the momentum circles neither axis; the choice with the smaller n magnifies rounding less.
        exchanged = (before > after) | ((before == after) & (w1 > w3))
        side = jnp.where(jnp.where(exchanged, p1, p3) < 0, -one, one)
        return labels._replace(exchanged=exchanged, side=side)

    def placed(self, v: cp.Vector) -> cp.Vector:
        """Numbers given for each axis of the body, rearranged for the labelled axes."""
        return self._exchange(Numbering(self.forward, self.backward).renumbered(v))

    def seen(self, v: cp.Vector) -> cp.Vector:
        """Components along the labelled axes."""
        return self._signed(self.placed(v))

    def back(self, v: cp.Vector) -> cp.Vector:
        """Components along the body axes."""
        return Numbering(self.backward, self.forward).renumbered(self._exchange(self._signed(v)))

    def _exchange(self, v: cp.Vector) -> cp.Vector:
        return jnp.where(self.exchanged, v[2], v[0]), v[1], jnp.where(self.exchanged, v[0], v[2])

    def _signed(self, v: cp.Vector) -> cp.Vector:
        return v[0], jnp.where(self.exchanged, -self.side, self.side) * v[1], self.side * v[2]


_TURN = 1.1  # the largest rotation of the first flight, in radians; less than JACOBI's `LARGEST_TURN`
_DOUBLINGS = {"float64": 52, "float32": 23}  # after more doublings, no digit of the phase is left
_LARGEST_LEVER = 64.0  # the largest magnification of rounding errors in the attitude


class Orbit(NamedTuple):
    """The motion of one free body on labelled axes, in units in which moments and momentum are near 1."""

    labels: Labels
    inertia: Inertia  # for the body axes
    size: Array  # the unit of momentum; zero for a body at rest
    per_time: Array  # the factor that converts a time to the units of the motion
    momentum: cp.Vector  # p, at the start
    amplitudes: tuple[Array, Array]  # A1 and A3
    pulls: cp.Vector  # w_l sign / sqrt(below w1)
    levers: tuple[Array, Array]  # n (cn u0 / p1)^2 and root (sn u0 / p2)^2, for the angle since the start
    modulus: Modulus  # of the elliptic functions
    rate: Array  # of u
    n: Array  # as in `_math.elliptic`
    root: Array  # likewise; the angle grows with its sign
    omega: Array  # a bound of the angular velocity

    @classmethod
    def of(cls, moments: Array, momentum: cp.Vector) -> "Orbit":
        zero, one = jnp.zeros_like(momentum[0]), jnp.ones_like(momentum[0])
        # The units are powers of two and round nothing.
        size, per_size = unit(cp.largest(momentum))
        at_rest = size == 0
        x, y, z = cp.scale(jnp.where(at_rest, zero, per_size), momentum)
        direction = x, y, jnp.where(at_rest, one, z)
        _, per_unit = unit(cp.largest(cp.vector(moments)))
        inertia = Inertia.of(RigidBody(moments * per_unit, physical=False))
        a, b, c = inertia.moments
        # The w of the module docstring, exact where two moments are close, and 1 / sqrt(w).
        weights = jnp.abs(b - c) * a, jnp.abs(c - a) * b, jnp.abs(a - b) * c
        labels = Labels.of(inertia.middle, weights, direction)
        p1, p2, p3 = p = labels.seen(direction)
        i1, _, i3 = labels.placed((a, b, c))
        w1, w2, w3 = labels.placed(weights)
        v1, v2, v3 = map(_inverse_root, weights)
        v1, v2, _ = labels.placed((v1, v2, v3))
        sign = jnp.where(i3 < i1, -one, one)

        above, below = p1 * p1 * w2 + p2 * p2 * w1, p2 * p2 * w3 + p3 * p3 * w2
        nearness = p3 * p3 * w1 - p1 * p1 * w3
        per_above, per_below = _inverse_root(above), _inverse_root(below)
        ball, steady = per_below == 0, below * w1 == 0
        n = above * per_below * per_below
        m = jnp.where(steady, zero, jnp.clip(n * w3 * v1 * v1, 0, 1))
        m1 = jnp.where(steady, one, jnp.clip(nearness * w2 * (per_below * v1) ** 2, 0, 1))
        modulus = Modulus(m, jnp.where(m1 < smallest_complement(m1), zero, m1))
        rate = (below * per_below) * (w1 * v1) * cp.reciprocal(a * b * c)

        a3 = jnp.where(ball, cp.fast_root(cp.dot(p, p)), below * per_below * v2)
        amplitudes = above * per_above * v2, a3
        pulls = cp.scale(sign * v1 * per_below, (w1, w2, w3))
        slope = (1 + n) * w2
        slope = sign * slope * _inverse_root(slope)
        root, levers = n * v1 * slope, (w2 * per_below * per_below, w1 * v1 * slope * per_below * per_below)
        energy = cp.dot(inertia.spins, cp.times(direction, direction)) * cp.largest(inertia.spins)
        omega = cp.fast_root(energy) * inertia.per_unit
        per_time = size * per_unit
        return cls(labels, inertia, size, per_time, p, amplitudes, pulls, levers, modulus, rate, n, root, omega)

    def at(self, t: Array, turns: bool) -> tuple[cp.Vector, cp.Quaternion, Array]:
        """The momentum after the time t, the rotation since the start, and whether the phase has digits left.

        If `turns` is False, the rotation is not computed.
        """
        t, most = t * self.per_time, _DOUBLINGS[str(t.dtype)]
        doublings = jnp.maximum(exponent(self.omega * jnp.abs(t) / _TURN) + 1, 0)
        ok, doublings = doublings <= most, jnp.minimum(doublings, most)
        point, half_angle, flight_ok = self._short(t * power(-doublings, t.dtype), turns)
        constants = self.modulus, self.n, self.root
        point, half_angle, doublings = fuse((point, half_angle, doublings))
        point, half_angle = repeat(_doubled, most, constants, (point, half_angle), doublings)
        point, half_angle = begin((point, half_angle))

        (x, y, z), (w1, w2, w3) = self.momentum, cp.scale(point.sn, self.pulls)
        ratio, per_dn = point.cn * point.per_dn, point.per_dn
        per = cp.reciprocal(1 + w2 * w3 * x * x * per_dn * per_dn)
        moved = (
            per * per_dn * (x * ratio - w1 * y * z),
            per * (y * ratio + w2 * x * z * per_dn * per_dn),
            per * per_dn * (z - w3 * x * y * ratio),
        )
        momentum = cp.scale(self.size, self.labels.back(moved))
        if half_angle is None:
            one, zero = jnp.ones_like(t), jnp.zeros_like(t)
            return momentum, (one, zero, zero, zero), ok & flight_ok
        across, along = self.levers
        last = half_angle_of(along * point.sn * y * moved[1], 1 + self.n - across * point.cn * x * moved[0])
        about = cp.multiply_about(cp.conjugate(_to_third(self.momentum)), 2, *product(half_angle, last))
        turn = cp.normalised(cp.multiply(about, _to_third(moved)))
        turn = turn[0], *self.labels.back(turn[1:])
        # A long lever magnifies rounding errors as the momentum passes the first axis.
        return momentum, turn, ok & flight_ok & (1 + self.n <= _LARGEST_LEVER**2)

    def _short(self, h: Array, turns: bool) -> tuple[Point, Complex | None, Array]:
        """The elliptic functions and half the angle a short time h after u = 0, and `ok`."""
        first = self.amplitudes[0], jnp.zeros_like(h), self.amplitudes[1]
        start = self.labels.back(first)
        invariants = Invariants.of(self.inertia, self.inertia.travel(h, start))
        s, w, _ = sigma_functions(invariants.g2, invariants.g3, LARGEST_TURN)
        v = w - invariants.wp * s * s
        d1, _, d3 = self.labels.placed(invariants.differences)
        point = self.modulus.point(self.rate * h * s, cp.fast_root(v + d3 * s * s))
        ok = (cp.largest(invariants.differences) <= LARGEST_TURN**2) & (v + d1 * s * s > 0)
        if not turns:
            return point, None, ok
        (w, x, y, z), change, _ = Jacobi().fly(self.inertia, h, start)
        increment = w, *self.labels.seen((x, y, z))
        after = cp.add(first, self.labels.seen(change))
        about = cp.multiply(cp.multiply(_to_third(first), increment), cp.conjugate(_to_third(after)))
        return point, normalised((about[0], about[3])), ok


def _doubled(constants: tuple[Modulus, Array, Array], carry: tuple[Point, Complex | None]) -> Any:
    (modulus, n, root), (point, half_angle) = constants, carry
    twice = modulus.doubled(point)
    if half_angle is None:
        return twice, None
    above = root * point.sn * point.sn * twice.sn
    more = half_angle_of(above, 1 + n * (1 - point.cn * point.cn * twice.cn))
    return twice, normalised(product(product(half_angle, half_angle), more))


def _inverse_root(x: Array) -> Array:
    """1 / sqrt(x); zero where x is zero or too small to be exact."""
    zero = x < smallest_complement(x)
    return jnp.where(zero, jnp.zeros_like(x), cp.inverse_root(jnp.where(zero, jnp.ones_like(x), x)))


def _to_third(p: cp.Vector) -> cp.Quaternion:
    """A multiple of the rotation that takes p to axis 3 and leaves axis 1 in the plane of axes 1 and 3.

    It is a rotation about the first axis followed by one about the second, each by at most pi/2, because p[2] is not
    negative. For the length r of (c, s), (r + c, s) is a positive multiple of cosine and sine of half its angle.
    """
    across = cp.fast_root(p[1] * p[1] + p[2] * p[2])
    length = cp.fast_root(cp.dot(p, p))
    # If p is along the first axis, as of a ball or with too long a lever, any rotation about this axis is valid.
    along = jnp.where(across <= cp.epsilon(across) * length, jnp.ones_like(across), across + p[2])
    lift = length + across
    return lift * along, lift * p[1], -p[0] * along, p[0] * p[1]


class Circle(NamedTuple):
    """The motion of a free axis: one rotation, about the unit vector along pi (zero at rest), at the rate |pi| / I1."""

    momentum: cp.Vector
    about: cp.Vector
    rate: Array

    @classmethod
    def of(cls, inertia: RotorInertia, momentum: cp.Vector) -> "Circle":
        size = cp.norm(momentum)
        still = size == 0
        per_size = jnp.where(still, jnp.zeros_like(size), 1 / jnp.where(still, jnp.ones_like(size), size))
        return cls(momentum, cp.scale(per_size, momentum), inertia.inverse * size)

    def at(self, t: Array, turns: bool) -> tuple[cp.Vector, Swing, Array]:
        """The momentum, the rotation in the time t, and whether rounding leaves digits of its angle."""
        half = self.rate * t / 2
        sine, one = jnp.sin(half), jnp.ones_like(half)
        swing = Swing(self.about, one, 2 * sine * jnp.cos(half), 2 * sine * sine)
        return self.momentum, swing, abs(half) * cp.epsilon(half) < 0.1
