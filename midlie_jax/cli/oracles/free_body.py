"""The torque-free rigid body in closed form."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._elliptic import Elliptic
from ._exact import ArrayLike, decimal_size, fresh_context, quaternion_product, read, real


def free_body(
    moments: ArrayLike, momentum: ArrayLike, attitude: ArrayLike, times: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Momentum and attitude of a torque-free rigid body at the given times.

    The body starts at time 0 and obeys Pi' = Pi x I^-1 Pi, R' = R skew(I^-1 Pi).

    **Arguments:**

    - `moments`: (3,) positive principal moments in any order. They need not obey the triangle inequality.
    - `momentum`: (3,) angular momentum Pi in the body frame at time 0.
    - `attitude`: (4,) quaternion (w, x, y, z), body to space, at time 0; need not be normalised.
    - `times`: (n,) in any order, may be negative.

    **Returns:** momenta (n, 3) in the body frame and unit quaternions (n, 4), body to space. The quaternion follows
    the motion continuously from `attitude`: it does not jump to its negative.

    **Accuracy:** a few units in the last place of float64, at any distance from the separatrix, on it, and for bodies
    with two or three moments equal, exactly or to rounding. The inputs are treated as exact fractions, so large times
    lose no accuracy. Near an unstable spin, where the motion depends strongly on the inputs, the result is the motion
    of exactly these float64 numbers. Each time takes a few ms.

    **Raises:** `ValueError` for wrong shapes, non-finite numbers, moments that are not positive, a zero quaternion;
    `ImportError` without mpmath.

    **Sources:** momentum by Jacobi's elliptic functions; the angle about the conserved spatial momentum is an
    elliptic integral of the third kind. E. Celledoni, F. Fasso, N. Safstrom, A. Zanna, SIAM J. Sci. Comput. 30
    (2008) 2084; R. van Zon, J. Schofield, J. Comput. Phys. 225 (2007) 145; B. C. Carlson, Numer. Algorithms 10
    (1995) 13 for R_F and R_J; E. T. Whittaker, Analytical Dynamics, section 69.
    """
    inertia, start, quaternion, instants = read(moments, momentum, attitude, times)
    ctx = fresh_context(36)  # digits; float64 has 16. Digits are added below for each known loss of precision
    length = ctx.sqrt(real(ctx, sum((c * c for c in quaternion), Fraction(0))))
    first = [real(ctx, c) / length for c in quaternion]

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
    quaternions = np.stack(quaternion_product([float(c) for c in first], turns.T), axis=-1)
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)


def _steady_turns(ctx: Any, spin: list[Fraction], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations since the start, as quaternions (n, 4), of a body that spins about a fixed axis."""
    rate = ctx.sqrt(real(ctx, sum((w * w for w in spin), Fraction(0))))
    axis = [float(real(ctx, w) / rate) if rate else 0.0 for w in spin]
    turns = np.empty((len(times), 4))
    ctx.dps += decimal_size(ctx, rate * max(map(abs, times.tolist()), default=0.0))
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
    lever = ctx.sqrt(real(ctx, square)) * real(ctx, 1 / i1 + 1 / i3)
    rate = ctx.sqrt(real(ctx, speed))
    latest = max(map(abs, times.tolist()), default=0.0)
    ctx.dps += decimal_size(ctx, 1 / real(ctx, nearness) if nearness else ctx.one)
    ctx.dps += decimal_size(ctx, lever / rate) + decimal_size(ctx, lever * latest, rate * latest)
    m = real(ctx, above * (i2 - i1) / (below * (i3 - i2)))
    rate = ctx.sqrt(real(ctx, speed))
    a1 = ctx.sqrt(real(ctx, i1 * above / (i3 - i1)))
    a2 = ctx.sqrt(real(ctx, i2 * above / (i3 - i2)))
    a3 = ctx.sqrt(real(ctx, i3 * below / (i3 - i1)))
    total = ctx.sqrt(real(ctx, square))
    # Euler's equations require sign(A1 A2 A3) = sign(I3 - I1); of the two remaining choices, use the one with cn u0 >=
    # 0.
    sign = -1 if start[0] < 0 else 1
    a1, a2 = sign * a1, (sign if i3 > i1 else -sign) * a2
    functions = Elliptic(ctx, m, real(ctx, nearness))
    p1, p2, p3 = (real(ctx, p) for p in start)
    u0 = functions.argument(p2 / a2, p1 / a1, p3 / a3)

    # The first axis circles the spatial momentum with phi' = |Pi| (2H - Pi1^2/I1) / (Pi2^2 + Pi3^2), where
    # Pi2^2 + Pi3^2 = A3^2 (1 - n sn^2) with n <= 0: no pole, no cancellation, no branch to follow.
    n = -((a1 / a3) ** 2)
    steady = total / real(ctx, i1)
    swing = total * real(ctx, 1 / i3 - 1 / i1) / rate
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
    turns = quaternion_product(first * np.array([[1.0], [-1.0], [-1.0], [-1.0]]), about)
    return momenta, np.stack(quaternion_product(turns, _to_momentum_frame(momenta)), axis=-1)


def _to_momentum_frame(momenta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (4, n) of the rotations that take Pi to e3 and leave the first body axis in the plane of e1 and e3.

    Pi3 > 0 throughout, so both angles stay within a right angle and the quaternion is continuous.
    """
    p1, p2, p3 = momenta.T
    side, lift = np.arctan2(p2, p3) / 2, np.arctan2(-p1, np.hypot(p2, p3)) / 2
    zero = np.zeros_like(side)
    about_second = (np.cos(lift), zero, np.sin(lift), zero)
    return np.stack(quaternion_product(about_second, (np.cos(side), np.sin(side), zero, zero)))
