"""Weierstrass's sigma function as polynomials in the invariants g2 and g3, for `JACOBI`.

Four entire functions of time, at time one and with the parameter v,

    S = sigma,    W = sigma^2 wp,    F = sigma(v - 1) exp(zeta(v)) / sigma(v) = even + wp'(v) odd

and T = sigma(2) / (2 sigma(1)), the product of the three E_l = S (wp(1) - e_l)^(1/2) with e_l the roots of 4 x^3 - g2 x
- g3, have Taylor coefficients that are polynomials in g2, g3 and p = wp(v). The coefficients are computed by exact
recurrences, and the sums are exact to rounding for |p| <= 2/3 r^2, |g2| <= 4/3 r^4, |g3| <= 8/27 r^6. These bounds hold
if p and the three roots of 4 x^3 - g2 x - g3 are real and within r^2 of each other. Two roots may be equal.

E. T. Whittaker & G. N. Watson, A Course of Modern Analysis, chapter XX; DLMF 23.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cache
from math import factorial
from typing import Any, NamedTuple

from jax import Array

from . import components as cp

# Terms of a sum below _TRUNCATION eps are dropped; no term of a higher power of time than _DEGREE is needed.
_TRUNCATION = 1 / 8
_DEGREE = 30


class Polynomial(dict[tuple[int, int, int], Fraction]):
    """Coefficients by the powers of (p, g2, g3), without those that count as more than `_DEGREE` powers of time."""

    def __add__(self, other: "Polynomial") -> "Polynomial":
        total = defaultdict(Fraction, self)
        for powers, c in other.items():
            total[powers] += c
        return Polynomial({powers: c for powers, c in total.items() if c})

    def __sub__(self, other: "Polynomial") -> "Polynomial":
        return self + other * -1

    def __mul__(self, other: "Polynomial | Fraction | int") -> "Polynomial":
        if not isinstance(other, Polynomial):
            return Polynomial({powers: c * other for powers, c in self.items()})
        total: dict[tuple[int, int, int], Fraction] = defaultdict(Fraction)
        weighted = [(powers, y, _weight(powers)) for powers, y in other.items()]
        for (i, j, k), x in self.items():
            room = _DEGREE - _weight((i, j, k))
            for (p, q, r), y, weight in weighted:
                if weight <= room:
                    total[i + p, j + q, k + r] += x * y
        return Polynomial({powers: c for powers, c in total.items() if c})

    def over(self, divisor: "Polynomial") -> "Polynomial":
        """The quotient as a series in time, for a divisor that begins with 1."""
        total = Polynomial()
        for weight in range(0, _DEGREE + 1, 2):
            rest = self - total * divisor
            total |= Polynomial({powers: c for powers, c in rest.items() if _weight(powers) == weight})
        return total

    def slope(self, shift: int = 0) -> "Polynomial":
        """(d/dt + shift) of the polynomial at time one."""
        return Polynomial({powers: (shift + _weight(powers)) * c for powers, c in self.items()})

    def derivative(self) -> "Polynomial":
        """The derivative in p."""
        return Polynomial({(i - 1, j, k): i * c for (i, j, k), c in self.items() if i})


def _weight(powers: tuple[int, int, int]) -> int:
    """The power of time that belongs to these powers of (p, g2, g3)."""
    return 2 * powers[0] + 4 * powers[1] + 6 * powers[2]


_ZERO, _ONE = Polynomial(), Polynomial({(0, 0, 0): Fraction(1)})
_P, _G2, _G3 = (Polynomial({powers: Fraction(1)}) for powers in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
_WP_PRIME_SQUARED = _P * _P * _P * 4 - _G2 * _P - _G3
_WP_SECOND = _P * _P * 6 - _G2 * Fraction(1, 2)


class _Pair(NamedTuple):
    """even + wp'(v) odd."""

    even: Polynomial
    odd: Polynomial

    def times(self, other: "_Pair") -> "_Pair":
        even = self.even * other.even + self.odd * other.odd * _WP_PRIME_SQUARED
        return _Pair(even, self.even * other.odd + self.odd * other.even)

    def scaled(self, factor: Fraction) -> "_Pair":
        return _Pair(self.even * factor, self.odd * factor)

    def derivative(self) -> "_Pair":
        return _Pair(self.odd.derivative() * _WP_PRIME_SQUARED + self.odd * _WP_SECOND, self.even.derivative())


def _sum(pairs: Iterable[_Pair]) -> _Pair:
    even, odd = zip(*pairs, strict=True)
    return _Pair(sum(even, _ZERO), sum(odd, _ZERO))


def _exponential(logarithm: dict[int, _Pair]) -> _Pair:
    """The power series f = exp(l) at time one from the coefficients l_k: n f_n = sum of k l_k f_(n-k)."""
    series = [_Pair(_ONE, _ZERO)]
    for n in range(1, _DEGREE + 1):
        terms = (logarithm[k].times(series[n - k]).scaled(Fraction(k, n)) for k in logarithm if k <= n)
        series.append(_sum([_Pair(_ZERO, _ZERO), *terms]))
    return _sum(series)


@cache
def coefficients() -> tuple[Polynomial, Polynomial, Polynomial, Polynomial]:
    """S, W, the odd part of F, and T; the power of time of a term is the `_weight` of its powers."""
    laurent = {0: _ONE, 2: _G2 * Fraction(1, 20), 3: _G3 * Fraction(1, 28)}  # of t^2 wp(t), in t^2
    for n in range(4, _DEGREE // 2 + 1):
        products = (laurent[k] * laurent[n - k] for k in range(2, n - 1))
        laurent[n] = sum(products, _ZERO) * Fraction(3, (2 * n + 1) * (n - 3))
    s = _exponential({2 * n: _Pair(c * Fraction(-1, 2 * n * (2 * n - 1)), _ZERO) for n, c in laurent.items() if n}).even
    twice_as_long = Polynomial({powers: 2 ** _weight(powers) * c for powers, c in s.items()})

    shift, wp = {}, _Pair(_P, _ZERO)
    for n in range(2, _DEGREE + 1):
        shift[n] = wp.scaled(Fraction(-((-1) ** n), factorial(n)))
        wp = wp.derivative()
    return s, s * s * sum(laurent.values(), _ZERO), _exponential(shift).odd, twice_as_long.over(s)


@cache
def moment_coefficients() -> tuple[Polynomial, Polynomial, Polynomial]:
    """A, B and C of `moment_functions`.

    With S, W, Z = sigma' and V = sigma^3 wp' at time one, the addition theorems make J (wp(1) - p)^2 a polynomial in p:

        (p + wp(1)) (2 p wp(1) - g2/2) - g3 + 2 zeta(1) (wp(1) - p)^2 + wp'(1) (wp(1) - p)

    Times S^4 its coefficients are A p^2 + b p + c - A g2/12. J vanishes where wp(v) does not change, that is at a
    double root of 4 x^3 - g2 x - g3. Therefore (b, c) is a combination of (2 g2, 3 g3) and (18 g3, g2^2), with factors
    that are the quotients below; both divisions leave no remainder.
    """
    s, w, _, _ = coefficients()
    squared, half = s * s, Fraction(1, 2)
    fourth = squared * squared
    z = s.slope(1)
    v = w.slope(-2) * s - w * s.slope() * 2
    a = (squared * w + squared * s * z) * 2
    b = w * w * 2 - _G2 * fourth * half - s * w * z * 4 - s * v
    c = (z * w * w * 2 + v * w).over(s) - _G2 * squared * w * half - _G3 * fourth + _G2 * a * Fraction(1, 12)
    first, second = _G2 * _G2 * b * half - _G3 * c * 9, _G2 * c - _G3 * b * Fraction(3, 2)
    return a, _over_discriminant(first), _over_discriminant(second)


def _over_discriminant(rest: Polynomial) -> Polynomial:
    """rest / (g2^3 - 27 g3^2), for a polynomial that is divisible by the discriminant."""
    total = Polynomial()
    while rest:
        powers = max(rest, key=lambda powers: powers[1])
        _, j, k = powers
        total[0, j - 3, k] = rest[powers]
        rest = rest - Polynomial({powers: rest[powers], (0, j - 3, k + 2): -27 * rest[powers]})
    return total


@cache
def _table(of: Callable[[], tuple[Polynomial, ...]], which: int, radius: float, eps: float) -> Any:
    """The coefficients for this radius and eps, as nested tuples: by powers of g3, then g2, then p."""
    terms = {
        powers: float(c)
        for powers, c in of()[which].items()
        if abs(c) * (2 / 3) ** powers[0] * (4 / 3) ** powers[1] * (8 / 27) ** powers[2] * radius ** _weight(powers)
        > _TRUNCATION * eps
    }
    return _nested(terms, 3)


def _nested(terms: dict[tuple[int, ...], float], depth: int) -> Any:
    """Coefficients by tuples of `depth` powers, as nested tuples; the outermost index is the last power."""
    if not depth:
        return terms[()]
    parts = defaultdict(dict)
    for powers, c in terms.items():
        parts[powers[-1]][powers[:-1]] = c
    return tuple(_nested(parts[n], depth - 1) if n in parts else 0.0 for n in range(max(parts) + 1))


def _horner(table: Any, x: tuple[Array, ...]) -> Any:
    """The polynomial with these nested coefficients at x, by Horner's rule in each variable."""
    if isinstance(table, float):
        return table
    total = _horner(table[-1], x[1:])
    for part in reversed(table[:-1]):
        total = total * x[0] + _horner(part, x[1:])
    return total


def step_tables(radius: float, eps: float) -> tuple[Any, Any, Any]:
    s, w, odd = (_table(coefficients, which, radius, eps) for which in range(3))
    return s, w, odd


def step_functions(p: Array, g2: Array, g3: Array, radius: float) -> tuple[Array, Array, Array]:
    """S, W and the odd part of F; exact to rounding if p and the three roots are within radius^2 of each other."""
    s, w, odd = (_horner(table, (g3, g2, p)) for table in step_tables(radius, cp.epsilon(p)))
    return s, w, odd


def sigma_functions(g2: Array, g3: Array, radius: float) -> tuple[Array, Array, Array]:
    """S, W and T, which do not depend on the parameter v; exact to rounding as in `step_functions`."""
    s, w, t = (_horner(_table(coefficients, which, radius, cp.epsilon(g2)), (g3, g2)) for which in (0, 1, 3))
    return s, w, t


def moment_functions(g2: Array, g3: Array, radius: float) -> tuple[Array, Array, Array]:
    """A, B and C, which give the first moment of wp' in time about the middle of an interval of length two,

        J = int_-1^1 t wp'(v + t) dt = (A (p^2 - g2/12) + B (2 g2 p + 3 g3) + C (18 g3 p + g2^2)) / (S^4 (wp(1) - p)^2)

    Exact to rounding as in `step_functions`.
    """
    a, b, c = (_horner(_table(moment_coefficients, k, radius, cp.epsilon(g2)), (g3, g2)) for k in range(3))
    return a, b, c
