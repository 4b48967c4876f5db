"""Jacobi's functions and the elliptic integral of the third kind, for real arguments and any parameter 0 <= m <= 1."""

from __future__ import annotations

from typing import Any, NamedTuple


class Point(NamedTuple):
    """An argument u = 2 K turns + rest with |rest| <= K, and Jacobi's functions of u and of rest (sine)."""

    u: Any
    turns: int
    rest: Any
    sine: Any  # sn(rest), of the reduced argument, for Carlson's form
    sn: Any
    cn: Any
    dn: Any


class Elliptic:
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

    def at(self, u: Any) -> Point:
        ctx = self.ctx
        if self.m1 == 0:
            sech = ctx.sech(u)
            sine = ctx.tanh(u)
            return Point(u, 0, u, sine, sine, sech, sech)
        turns = int(ctx.nint(u / (2 * self.quarter)))
        rest = u - 2 * turns * self.quarter
        angle = ctx.ldexp(self.limit * rest, len(self.ladder))
        for ratio in reversed(self.ladder):
            angle = (angle + ctx.asin(ratio * ctx.sin(angle))) / 2
        cosine, sine = ctx.cos_sin(angle)
        dn = ctx.sqrt(self.m1 + self.m * cosine * cosine)
        sign = -1 if turns % 2 else 1
        return Point(u, turns, rest, sine, sign * sine, sign * cosine, dn)

    def third_kind(self, n: Any, n1: Any, p: Point) -> Any:
        """The integral of 1 / (1 - n sn^2) from 0 to u, n1 = 1 - n > 0, by Carlson's R_J (DLMF 19.25.14)."""
        ctx = self.ctx
        if n == 0:
            return p.u
        if self.m1 == 0:
            if n > 0:
                raise AssertionError("the pole term of a homoclinic motion has no weight and must be dropped")
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
