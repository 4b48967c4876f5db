"""The torque-free rigid body in closed form, by elliptic functions in as many digits as the motion needs (mpmath).

Unlike the Taylor series of `midlie_jax.cli.oracle`, it reaches any time in a few milliseconds. The inputs are exact
fractions, so that `== 0` detects a degenerate motion without a tolerance.
"""

from fractions import Fraction
from typing import Any, NamedTuple

import mpmath
import numpy as np
from numpy.typing import NDArray


def free_body(
    moments: Any, momentum: Any, attitude: Any, times: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Momenta (n, 3) in the body frame and unit quaternions (n, 4), w first, body to space, at times in any order.

    The body starts at time 0 and obeys Pi' = Pi x I^-1 Pi, R' = R skew(I^-1 Pi). Moments are positive, in any order;
    the attitude need not be normalised, and the quaternions follow it continuously. The inputs are treated as exact, so
    large times lose no accuracy; the result is good to a few units in the last place, also near and on the separatrix.

    The momentum is by Jacobi's elliptic functions, the angle about the spatial momentum by an elliptic integral of the
    third kind. E. Celledoni, F. Fasso, N. Safstrom, A. Zanna, SIAM J. Sci. Comput. 30 (2008) 2084; R. van Zon,
    J. Schofield, J. Comput. Phys. 225 (2007) 145; B. C. Carlson, Numer. Algorithms 10 (1995) 13 for R_F and R_J.
    """
    inertia, start, quaternion = ([Fraction(float(x)) for x in values] for values in (moments, momentum, attitude))
    instants = np.asarray(times, dtype=np.float64)
    ctx = mpmath.mp.clone()  # neither reads nor changes the precision of the caller
    ctx.dps = 36  # digits; float64 has 16. Digits are added below for each known loss of precision
    length = ctx.sqrt(_real(ctx, sum((c * c for c in quaternion), Fraction(0))))
    first = [_real(ctx, c) / length for c in quaternion]

    spin = [p / i for p, i in zip(start, inertia, strict=True)]
    if all(start[j] * spin[k] == start[k] * spin[j] for j, k in ((0, 1), (1, 2), (2, 0))):
        turns = _steady_turns(ctx, spin, instants)
        constant = np.array([float(p) for p in start])
        return np.tile(constant, (len(instants), 1)), _attitudes(first, turns)
    axes = _labelled_axes(inertia, start)
    momenta, turns = _tumble(ctx, [inertia[k] for k, _ in axes], [sign * start[k] for k, sign in axes], instants)
    # From the axes of the formulas back to the body axes. The map is a proper rotation, so the vector part of the
    # quaternions transforms like the momenta.
    pi, turn = np.empty_like(momenta), turns.copy()
    for j, (k, sign) in enumerate(axes):
        pi[:, k] = sign * momenta[:, j]
        turn[:, 1 + k] = sign * turns[:, 1 + j]
    return pi, _attitudes(first, turn)


def _attitudes(first: list[Any], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    quaternions = np.stack(_quaternion_product([float(c) for c in first], turns.T), axis=-1)
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)


def _steady_turns(ctx: Any, spin: list[Fraction], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations since the start, as quaternions (n, 4), of a body that spins about a fixed axis."""
    rate = ctx.sqrt(_real(ctx, sum((w * w for w in spin), Fraction(0))))
    axis = [float(_real(ctx, w) / rate) if rate else 0.0 for w in spin]
    turns = np.empty((len(times), 4))
    ctx.dps += _decimal_size(ctx, rate * max(map(abs, times.tolist()), default=0.0))
    for row, t in zip(turns, times, strict=True):
        c, s = ctx.cos_sin(rate * ctx.mpf(float(t)) / 2)
        row[0], row[1:] = float(c), [float(s) * a for a in axis]
    return turns


def _labelled_axes(inertia: list[Fraction], start: list[Fraction]) -> list[tuple[int, int]]:
    """Right-handed axes, as (index, sign), such that Pi circles the third axis on its positive side.

    The second is the axis of the middle moment. Then Pi_3 never vanishes, so at every energy the first axis can be the
    pole of the angle phi in `_tumble`.
    """
    low, middle, high = sorted(range(3), key=lambda k: inertia[k])
    twice_energy = sum((p * p / i for p, i in zip(start, inertia, strict=True)), Fraction(0))
    square = sum((p * p for p in start), Fraction(0))
    order = [low, middle, high] if twice_energy * inertia[middle] <= square else [high, middle, low]
    third_sign = 1 if start[order[2]] >= 0 else -1
    handedness = 1 if order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]) else -1
    return [(order[0], 1), (order[1], handedness * third_sign), (order[2], third_sign)]


def _tumble(
    ctx: Any, inertia: list[Fraction], start: list[Fraction], times: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Momenta (n, 3) and rotations since the start (n, 4), in the axes of `_labelled_axes`."""
    i1, i2, i3 = inertia
    twice_energy = sum((p * p / i for p, i in zip(start, inertia, strict=True)), Fraction(0))
    square = sum((p * p for p in start), Fraction(0))
    # Pi = (A1 cn u, A2 sn u, A3 dn u), u = u0 + rate t.
    above, below = twice_energy * i3 - square, square - twice_energy * i1
    nearness = (square - twice_energy * i2) * (i3 - i1) / (below * (i3 - i2))
    speed = below * (i3 - i2) / (i1 * i2 * i3)
    # Digits are lost near the separatrix (small 1 - m), near equal moments (a large phase in one period of Pi), and at
    # large times.
    lever = ctx.sqrt(_real(ctx, square)) * _real(ctx, 1 / i1 + 1 / i3)
    rate = ctx.sqrt(_real(ctx, speed))
    latest = max(map(abs, times.tolist()), default=0.0)
    ctx.dps += _decimal_size(ctx, 1 / _real(ctx, nearness) if nearness else ctx.one)
    ctx.dps += _decimal_size(ctx, lever / rate) + _decimal_size(ctx, lever * latest, rate * latest)
    m = _real(ctx, above * (i2 - i1) / (below * (i3 - i2)))
    rate = ctx.sqrt(_real(ctx, speed))
    a1 = ctx.sqrt(_real(ctx, i1 * above / (i3 - i1)))
    a2 = ctx.sqrt(_real(ctx, i2 * above / (i3 - i2)))
    a3 = ctx.sqrt(_real(ctx, i3 * below / (i3 - i1)))
    total = ctx.sqrt(_real(ctx, square))
    # Euler's equations require sign(A1 A2 A3) = sign(I3 - I1); of the two remaining choices, use the one with cn u0 >=
    # 0.
    sign = -1 if start[0] < 0 else 1
    a1, a2 = sign * a1, (sign if i3 > i1 else -sign) * a2
    functions = _Elliptic(ctx, m, _real(ctx, nearness))
    p1, p2, p3 = (_real(ctx, p) for p in start)
    u0 = functions.argument(p2 / a2, p1 / a1, p3 / a3)

    # The first axis circles the spatial momentum with phi' = |Pi| (2H - Pi1^2/I1) / (Pi2^2 + Pi3^2), where
    # Pi2^2 + Pi3^2 = A3^2 (1 - n sn^2) with n <= 0: no pole, no cancellation, no branch to follow.
    n = -((a1 / a3) ** 2)
    steady = total / _real(ctx, i1)
    swing = total * _real(ctx, 1 / i3 - 1 / i1) / rate
    before = functions.third_kind(n, 1 - n, functions.at(u0))
    momenta, angles = np.empty((len(times), 3)), np.empty((len(times), 2))
    for row, angle, t in zip(momenta, angles, times.tolist(), strict=True):
        p = functions.at(u0 + rate * ctx.mpf(t))
        row[:] = float(a1 * p.cn), float(a2 * p.sn), float(a3 * p.dn)
        phi = steady * ctx.mpf(t) + swing * (functions.third_kind(n, 1 - n, p) - before)
        angle[:] = [float(v) for v in ctx.cos_sin(phi / 2)]
    first = _to_momentum_frame(np.array([[float(p1), float(p2), float(p3)]]))
    about = np.zeros((4, len(times)))
    about[0], about[3] = angles.T
    turns = _quaternion_product(first * np.array([[1.0], [-1.0], [-1.0], [-1.0]]), about)
    return momenta, np.stack(_quaternion_product(turns, _to_momentum_frame(momenta)), axis=-1)


def _to_momentum_frame(momenta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (4, n) of the rotations that take Pi to e3 and leave the first body axis in the plane of e1 and e3.

    Pi3 > 0 throughout, so both angles stay within a right angle and the quaternion is continuous.
    """
    p1, p2, p3 = momenta.T
    side, lift = np.arctan2(p2, p3) / 2, np.arctan2(-p1, np.hypot(p2, p3)) / 2
    zero = np.zeros_like(side)
    about_second = (np.cos(lift), zero, np.sin(lift), zero)
    return np.stack(_quaternion_product(about_second, (np.cos(side), np.sin(side), zero, zero)))


class _Point(NamedTuple):
    """An argument u = 2 K turns + rest with |rest| <= K, and Jacobi's functions of u and of rest (sine)."""

    u: Any
    turns: int
    rest: Any
    sine: Any  # sn(rest), of the reduced argument, for Carlson's form
    sn: Any
    cn: Any
    dn: Any


class _Elliptic:
    """The functions for a parameter m, which is passed with its complement m1 = 1 - m.

    Near the separatrix m1 is tiny and cannot be computed from m: the rounding of 1 - m would be larger than m1.
    """

    def __init__(self, ctx: Any, m: Any, m1: Any):
        self.ctx, self.m, self.m1 = ctx, m, m1
        a, b, c = ctx.one, ctx.sqrt(m1), ctx.sqrt(m)
        self.ladder: list[Any] = []  # c_n / a_n of the arithmetic-geometric mean (Abramowitz & Stegun 16.4)
        if m1 != 0:
            while abs(c) > ctx.eps * a:
                a, b, c = (a + b) / 2, ctx.sqrt(a * b), (a - b) / 2
                self.ladder.append(c / a)
        self.limit = a
        self.quarter = ctx.pi / (2 * a) if m1 != 0 else ctx.inf
        self.complete: dict[Any, Any] = {}

    def argument(self, sn: Any, cn: Any, dn: Any) -> Any:
        """The u in [-K, K] with these values of Jacobi's functions; cn >= 0."""
        ctx = self.ctx
        return ctx.asinh(sn / cn) if self.m1 == 0 else sn * ctx.elliprf(cn * cn, dn * dn, 1)

    def at(self, u: Any) -> _Point:
        ctx = self.ctx
        if self.m1 == 0:
            sech = ctx.sech(u)
            sine = ctx.tanh(u)
            return _Point(u, 0, u, sine, sine, sech, sech)
        turns = int(ctx.nint(u / (2 * self.quarter)))
        rest = u - 2 * turns * self.quarter
        angle = ctx.ldexp(self.limit * rest, len(self.ladder))
        for ratio in reversed(self.ladder):
            angle = (angle + ctx.asin(ratio * ctx.sin(angle))) / 2
        cosine, sine = ctx.cos_sin(angle)
        dn = ctx.sqrt(self.m1 + self.m * cosine * cosine)
        sign = -1 if turns % 2 else 1
        return _Point(u, turns, rest, sine, sign * sine, sign * cosine, dn)

    def third_kind(self, n: Any, n1: Any, p: _Point) -> Any:
        """The integral of 1 / (1 - n sn^2) from 0 to u, n <= 0, n1 = 1 - n, by Carlson's R_J (DLMF 19.25.14)."""
        ctx = self.ctx
        if n == 0:
            return p.u
        if self.m1 == 0:
            root = ctx.sqrt(-n)
            return (p.u + root * ctx.atan(root * p.sine)) / n1
        value = p.u
        square = p.cn * p.cn
        if p.sine != 0:
            value += n / 3 * p.sine**3 * ctx.elliprj(square, p.dn * p.dn, 1, square + n1 * p.sine**2)
        if p.turns:
            if n not in self.complete:
                self.complete[n] = n / 3 * ctx.elliprj(0, self.m1, 1, n1)
            value += 2 * p.turns * self.complete[n]
        return value


def _real(ctx: Any, value: Fraction) -> Any:
    return ctx.mpf(value.numerator) / value.denominator


def _quaternion_product(p: Any, q: Any) -> tuple[Any, Any, Any, Any]:
    """Hamilton's product of quaternions, scalar first, for any type of numbers."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def _decimal_size(ctx: Any, *values: Any) -> int:
    """The number of digits before the decimal point of the largest value, the required increase of precision."""
    return max(0, *(int(ctx.mag(v) * 0.30103) + 1 for v in values if v != 0), 0)
