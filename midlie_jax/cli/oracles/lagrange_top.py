"""The symmetric heavy top (Lagrange's top) in closed form."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._elliptic import Elliptic, Point
from ._exact import ArrayLike, decimal_size, fractions, fresh_context, quaternion_product, read, real
from .free_body import free_body

_ROOT_DIGITS = 320  # enough to separate all unequal roots; see `_roots`


def lagrange_top(
    moments: ArrayLike, mgl: float, momentum: ArrayLike, attitude: ArrayLike, times: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Momentum and attitude of the symmetric heavy top at the given times.

    The top starts at time 0 and obeys Pi' = Pi x I^-1 Pi + mgl (R^T e_z) x e3, R' = R skew(I^-1 Pi). Its axis is the
    third body axis, and its potential is mgl (R e3).z.

    **Arguments:**

    - `moments`: (3,) positive principal moments about the fixed point, the first two equal.
    - `mgl`: weight times distance from the fixed point to the centre of mass; negative if the centre lies on -e3.
    - `momentum`: (3,) angular momentum Pi in the body frame at time 0.
    - `attitude`: (4,) quaternion (w, x, y, z), body to space, at time 0; need not be normalised.
    - `times`: (n,) in any order, may be negative.

    **Returns:** momenta (n, 3) in the body frame and unit quaternions (n, 4), body to space. The quaternion follows
    the motion continuously from `attitude`: it does not jump to its negative.

    **Accuracy:** a few units in the last place of float64 for every start: nutation, regular precession, the sleeping
    top (stable or not) and the motions that approach it, the pendulum without spin, and an axis that passes through the
    vertical or arbitrarily near to it. The inputs are treated as exact fractions; near an unstable motion, which
    depends strongly on the inputs, the result is the motion of exactly these float64 numbers. No numerical integration
    is used. Each time takes about 5 ms.

    **Raises:** `ValueError` for wrong shapes, non-finite numbers, moments that are not positive or whose first two
    differ, a zero quaternion; `ImportError` without mpmath.

    **Sources:** F. Klein, A. Sommerfeld, The Theory of the Top, vol. II: in z-x-z Euler angles the Cayley-Klein
    parameter cos(theta/2) exp(i (phi + psi)/2) has only the lower pole in its phase and sin(theta/2)
    exp(i (phi - psi)/2) only the upper pole; each phase is an elliptic integral of the third kind. Whittaker,
    Analytical Dynamics, section 71, for the cubic; B. C. Carlson, Numer. Algorithms 10 (1995) 13 for R_J.
    """
    inertia, start, quaternion, instants = read(moments, momentum, attitude, times)
    (weight,) = fractions("mgl", [mgl], 1)
    if inertia[0] != inertia[1]:
        raise ValueError(f"moments must have the first two moments equal for Lagrange's top, got {moments!r}.")
    if weight == 0:
        return free_body(moments, momentum, attitude, times)
    if weight > 0:
        return _Top(inertia, weight, start, quaternion).motion(instants)
    # With the centre of mass on -e3, rotate the body axes by pi about the first axis; the centre is then on e3.
    half_turn = (0, 1, 0, 0)
    turned = [start[0], -start[1], -start[2]]
    momenta, attitudes = _Top(inertia, -weight, turned, list(quaternion_product(quaternion, half_turn))).motion(
        instants
    )
    attitudes = np.stack(quaternion_product(attitudes.T, (0, -1, 0, 0)), axis=-1)
    return momenta * np.array([1.0, -1.0, -1.0]), attitudes


class _Top:
    """A motion with mgl > 0: its exact invariants, and the cubic whose roots bound the nutation."""

    def __init__(self, inertia: list[Fraction], weight: Fraction, start: list[Fraction], quaternion: list[Fraction]):
        self.inertia, self.weight, self.start, self.quaternion = inertia, weight, start, quaternion
        w, x, y, z = quaternion
        norm = w * w + x * x + y * y + z * z
        row = [2 * (x * z - w * y) / norm, 2 * (y * z + w * x) / norm, (w * w - x * x - y * y + z * z) / norm]
        self.height = row[2]
        self.spin = start[2]
        self.vertical = sum((r * p for r, p in zip(row, start, strict=True)), Fraction(0))
        self.rise = (row[0] * start[1] - row[1] * start[0]) / inertia[0]
        # (I1 z')^2 = f(z) = a z^3 + b z^2 + c z + d, z the height of the axis.
        a = 2 * inertia[0] * weight
        e = start[0] ** 2 + start[1] ** 2 + a * self.height
        self.cubic = (a, -e - self.spin**2, 2 * self.vertical * self.spin - a, e - self.vertical**2)

    def motion(self, times: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        a, b, c, _ = self.cubic
        steady = self.rise == 0 and 3 * a * self.height**2 + 2 * b * self.height + c == 0
        momenta, attitudes = np.empty((len(times), 3)), np.empty((len(times), 4))
        solution = _Steady(self, times) if steady else _Nutation(self, times)
        for pi, q, t in zip(momenta, attitudes, times.tolist(), strict=True):
            pi[:], q[:] = solution.at(t)
        return momenta, attitudes / np.linalg.norm(attitudes, axis=-1, keepdims=True)


class _Frame:
    """Base of steady and nutating motions: momentum and quaternion from half-angle functions and phases."""

    def __init__(self, top: _Top, times: NDArray[np.float64]):
        self.top, self.ctx = top, fresh_context(36)
        ctx, (i1, _, i3) = self.ctx, top.inertia
        fastest = real(ctx, max(abs(p) for p in top.start) / min(i1, i3) + abs(top.vertical) / i1)
        self.longest = ctx.mpf(max(map(abs, times.tolist()), default=0.0))
        ctx.dps += decimal_size(ctx, fastest * self.longest)
        self.lower = top.vertical + top.spin  # weight of the lower pole, z = -1
        self.upper = top.vertical - top.spin  # weight of the upper pole, z = 1
        self.drift = real(ctx, top.spin * (1 / i3 - 1 / i1) / 2)
        w, x, y, z = (real(ctx, v) for v in top.quaternion)
        norm = ctx.sqrt(w * w + x * x + y * y + z * z)
        self.alpha, self.beta = ctx.mpc(w, z) / norm, ctx.mpc(x, y) / norm

    def unit(self, value: Any) -> Any:
        return value / abs(value) if value != 0 else self.ctx.mpc(1)

    def assemble(self, c: Any, s: Any, alpha: Any, beta: Any, dip: Any) -> tuple[list[float], list[float]]:
        """Momentum and quaternion.

        Args:
            c, s: signed cos and sin of theta/2.
            alpha, beta: phases, as complex numbers of modulus 1.
            dip: I1 theta'.
        """
        ctx, top = self.ctx, self.top
        across = ctx.zero  # I1 phi' sin(theta)
        if self.upper != 0:
            across += real(ctx, self.upper) * c / s / 2
        if self.lower != 0:
            across += real(ctx, self.lower) * s / c / 2
        flat = ctx.mpc(dip, across) * ctx.conj(alpha) * beta
        alpha, beta = c * alpha, s * beta
        quaternion = [float(v) for v in (alpha.real, beta.real, beta.imag, alpha.imag)]
        return [float(flat.real), float(flat.imag), float(top.spin)], quaternion


class _Steady(_Frame):
    """The height of the axis is constant: regular precession, or the sleeping top."""

    def __init__(self, top: _Top, times: NDArray[np.float64]):
        super().__init__(top, times)
        ctx, twice = self.ctx, 2 * top.inertia[0]
        self.low = real(ctx, self.lower / (twice * (1 + top.height))) if top.height != -1 else ctx.zero
        self.high = real(ctx, self.upper / (twice * (1 - top.height))) if top.height != 1 else ctx.zero

    def at(self, t: float) -> tuple[list[float], list[float]]:
        ctx, time = self.ctx, self.ctx.mpf(t)
        alpha = self.unit(self.alpha) * ctx.expj((self.low + self.drift) * time)
        beta = self.unit(self.beta) * ctx.expj((self.high - self.drift) * time)
        return self.assemble(abs(self.alpha), abs(self.beta), alpha, beta, ctx.zero)


class _Nutation(_Frame):
    """The height of the axis oscillates between the two lower roots: z = z1 + (z2 - z1) sn^2 u."""

    def __init__(self, top: _Top, times: NDArray[np.float64]):
        super().__init__(top, times)
        ctx = self.ctx
        wide = fresh_context(_ROOT_DIGITS)
        z1, z2, z3 = _roots(wide, top.cubic, self.lower == 0, self.upper == 0)
        z0, swing, reach = real(wide, top.height), z2 - z1, z3 - z1
        m1 = (z3 - z2) / reach
        rate = wide.sqrt(real(wide, top.weight / top.inertia[0]) * reach / 2)
        # Phase per unit of u, for each pole with a weight that is not zero.
        unit = 2 * real(wide, top.inertia[0]) * rate
        low = real(wide, self.lower) / unit / (1 + z1) if self.lower else wide.zero
        high = real(wide, self.upper) / unit / (1 - z1) if self.upper else wide.zero
        ctx.dps += decimal_size(ctx, 1 / m1 if m1 else 1) + decimal_size(ctx, low, high)
        ctx.dps += decimal_size(ctx, rate * self.longest)

        def narrow(value: Any) -> Any:
            """The value rounded to `ctx`; differences of roots are computed before, in `wide`, and lose no digits."""
            return +ctx.convert(value)

        self.swing, self.rate = narrow(swing), narrow(rate)
        self.below, self.above = (narrow(1 + z1), narrow(1 + z2)), (narrow(1 - z1), narrow(1 - z2))
        self.functions = Elliptic(ctx, narrow(swing / reach), narrow(m1))
        sn = wide.sqrt(max(0, min(1, (z0 - z1) / swing))) * (-1 if top.rise < 0 else 1)
        cn = wide.sqrt(max(0, min(1, (z2 - z0) / swing)))
        dn = wide.sqrt(m1 + swing / reach * cn * cn)
        self.u0 = self.functions.argument(narrow(sn), narrow(cn), narrow(dn))
        # n, 1 - n and weight of the two integrals.
        self.low = (narrow(-swing / (1 + z1)), narrow((1 + z2) / (1 + z1)), narrow(low)) if self.lower else None
        self.high = (narrow(swing / (1 - z1)), narrow((1 - z2) / (1 - z1)), narrow(high)) if self.upper else None
        first = self.functions.at(self.u0)
        c, s = self.halves(first)
        self.low0, self.high0 = self.phase(self.low, first), self.phase(self.high, first)
        # Phases at the start. On a pole a Cayley-Klein parameter is zero, and its phase is the phase of its time
        # derivative.
        w1, w2 = (real(ctx, p / top.inertia[0]) for p in top.start[:2])
        alpha = self.alpha / c if self.alpha != 0 else -self.beta * ctx.mpc(w1, -w2)
        beta = self.beta / s if self.beta != 0 else -self.alpha * ctx.mpc(w1, w2)
        self.alpha, self.beta = self.unit(alpha), self.unit(beta)

    def phase(self, pole: tuple[Any, Any, Any] | None, p: Point) -> Any:
        if pole is None:
            return self.ctx.zero
        n, n1, weight = pole
        return weight * self.functions.third_kind(n, n1, p)

    def halves(self, p: Point) -> tuple[Any, Any]:
        """cos and sin of theta/2; if the axis passes through a pole, the one that vanishes has the sign of sn or cn."""
        root, cn2, sn2 = self.ctx.sqrt, p.cn * p.cn, p.sn * p.sn
        c = root((self.below[0] * cn2 + self.below[1] * sn2) / 2)
        s = root((self.above[0] * cn2 + self.above[1] * sn2) / 2)
        return (-c if self.below[0] == 0 and p.sn < 0 else c), (-s if self.above[1] == 0 and p.cn < 0 else s)

    def at(self, t: float) -> tuple[list[float], list[float]]:
        ctx, time = self.ctx, self.ctx.mpf(t)
        p = self.functions.at(self.u0 + self.rate * time)
        c, s = self.halves(p)
        alpha = self.alpha * ctx.expj(self.phase(self.low, p) - self.low0 + self.drift * time)
        beta = self.beta * ctx.expj(self.phase(self.high, p) - self.high0 - self.drift * time)
        # theta' = -z' / sin(theta); sn / c and cn / s stay finite on a pole.
        sn_over_c = 1 / ctx.sqrt(self.below[1] / 2) if self.below[0] == 0 else p.sn / c
        cn_over_s = 1 / ctx.sqrt(self.above[0] / 2) if self.above[1] == 0 else p.cn / s
        dip = -real(ctx, self.top.inertia[0]) * self.swing * self.rate * sn_over_c * cn_over_s * p.dn
        return self.assemble(c, s, alpha, beta, dip)


def _roots(ctx: Any, cubic: tuple[Fraction, ...], lower_pole: bool, upper_pole: bool) -> tuple[Any, Any, Any]:
    """The three real roots in increasing order; equal roots are exactly equal, and a root at a pole is exactly 1 or -1.

    For nearly equal roots Viete's formula is accurate to half of the digits. That is enough: the coefficients come from
    float64 inputs, so unequal roots differ by far more than 1e-100.
    """
    a, b, c, d = cubic
    b, c, d = b / a, c / a, d / a
    p, q = c - b * b / 3, 2 * b**3 / 27 - b * c / 3 + d
    if 4 * p**3 + 27 * q**2 == 0:
        exact = [-b / 3] * 3 if p == 0 else [3 * q / p - b / 3] + [-3 * q / (2 * p) - b / 3] * 2
        roots = [real(ctx, r) for r in sorted(exact)]
    else:
        radius = ctx.sqrt(real(ctx, -p) / 3)
        third = ctx.acos(max(-1, min(1, real(ctx, -q) / (2 * radius**3)))) / 3
        shift = real(ctx, -b / 3)
        roots = sorted(2 * radius * ctx.cos(third - 2 * ctx.pi * k / 3) + shift for k in range(3))
    for pole, present in ((-1, lower_pole), (1, upper_pole)):
        if present:
            roots = [ctx.mpf(pole) if abs(r - pole) < ctx.mpf(10) ** -100 else r for r in roots]
    return roots[0], roots[1], roots[2]
