"""Weierstrass's sigma function as polynomials in the invariants g2 and g3, for `JACOBI`.

Four entire functions of time, at time one and with the parameter v,

    S = sigma,    W = sigma^2 wp,    F = sigma(v - 1) exp(zeta(v)) / sigma(v) = even + wp'(v) odd

and T = sigma(2) / (2 sigma(1)), the product of the three E_l = S (wp(1) - e_l)^(1/2) with e_l the roots of 4 x^3 - g2 x
- g3, have Taylor coefficients that are polynomials in g2, g3 and p = wp(v). The coefficients are computed by exact
recurrences, and the sums are exact to rounding for |p| <= 2/3 r^2, |g2| <= 4/3 r^4, |g3| <= 8/27 r^6. These bounds hold
if p and the three roots of 4 x^3 - g2 x - g3 are real and within r^2 of each other. The method uses neither periods nor
the nome, so two equal roots are not a special case.

E. T. Whittaker & G. N. Watson, A Course of Modern Analysis, chapter XX; DLMF 23.
"""

from collections import defaultdict
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from math import factorial
from typing import Any, NamedTuple

from jax import Array

from . import components as cp

# Terms of a sum below _TRUNCATION eps are dropped; no term of a higher power of time than _DEGREE is needed.
_TRUNCATION = 1 / 8
_DEGREE = 30

# The coefficients of a polynomial by its powers of (p, g2, g3), which count as 2, 4 and 6 powers of time.
Polynomial = dict[tuple[int, int, int], Fraction]
_ZERO: Polynomial = {}
_ONE: Polynomial = {(0, 0, 0): Fraction(1)}
_G2: Polynomial = {(0, 1, 0): Fraction(1)}
_G3: Polynomial = {(0, 0, 1): Fraction(1)}
# wp'^2 = 4 p^3 - g2 p - g3 and wp'' = 6 p^2 - g2 / 2
_WP_PRIME_SQUARED: Polynomial = {(3, 0, 0): Fraction(4), (1, 1, 0): Fraction(-1), (0, 0, 1): Fraction(-1)}
_WP_SECOND: Polynomial = {(2, 0, 0): Fraction(6), (0, 1, 0): Fraction(-1, 2)}


def _sum(*terms: tuple[Fraction | int, Polynomial]) -> Polynomial:
    total: dict[tuple[int, int, int], Fraction] = defaultdict(Fraction)
    for factor, polynomial in terms:
        for powers, c in polynomial.items():
            total[powers] += factor * c
    return {powers: c for powers, c in total.items() if c}


def _product(a: Polynomial, b: Polynomial) -> Polynomial:
    """a b, without powers of time above `_DEGREE`."""
    total: dict[tuple[int, int, int], Fraction] = defaultdict(Fraction)
    weighted = [(powers, y, _weight(powers)) for powers, y in b.items()]
    for (i, j, k), x in a.items():
        room = _DEGREE - _weight((i, j, k))
        for (p, q, r), y, weight in weighted:
            if weight <= room:
                total[i + p, j + q, k + r] += x * y
    return {powers: c for powers, c in total.items() if c}


class _Pair(NamedTuple):
    even: Polynomial
    odd: Polynomial

    def times(self, other: "_Pair") -> "_Pair":
        odd_odd = _product(_product(self.odd, other.odd), _WP_PRIME_SQUARED)
        even = _sum((1, _product(self.even, other.even)), (1, odd_odd))
        return _Pair(even, _sum((1, _product(self.even, other.odd)), (1, _product(self.odd, other.even))))

    def derivative(self) -> "_Pair":
        even, odd = _derivative_in_p(self.even), _derivative_in_p(self.odd)
        return _Pair(_sum((1, _product(odd, _WP_PRIME_SQUARED)), (1, _product(self.odd, _WP_SECOND))), even)


def _derivative_in_p(polynomial: Polynomial) -> Polynomial:
    return {(i - 1, j, k): i * c for (i, j, k), c in polynomial.items() if i}


def _exponential(logarithm: dict[int, _Pair]) -> list[_Pair]:
    """The power series f = exp(l) from the coefficients l_k: n f_n = sum of k l_k f_(n-k)."""
    series = [_Pair(_ONE, _ZERO)]
    for n in range(1, _DEGREE + 1):
        terms = [(Fraction(k, n), logarithm[k].times(series[n - k])) for k in logarithm if k <= n]
        series.append(_Pair(_sum(*((c, pair.even) for c, pair in terms)), _sum(*((c, pair.odd) for c, pair in terms))))
    return series


@cache
def coefficients() -> tuple[Polynomial, Polynomial, Polynomial, Polynomial]:
    """S, W, the odd part of F, and T; the power of time of a term is the `_weight` of its powers."""
    laurent = {0: _ONE, 2: _sum((Fraction(1, 20), _G2)), 3: _sum((Fraction(1, 28), _G3))}  # of t^2 wp(t), in t^2
    for n in range(4, _DEGREE // 2 + 1):
        products = [(1, _product(laurent[k], laurent[n - k])) for k in range(2, n - 1)]
        laurent[n] = _sum((Fraction(3, (2 * n + 1) * (n - 3)), _sum(*products)))
    sigma = _exponential(
        {2 * n: _Pair(_sum((Fraction(-1, 2 * n * (2 * n - 1)), c)), _ZERO) for n, c in laurent.items() if n}
    )
    s = _sum(*((1, pair.even) for pair in sigma))
    w = _product(_product(s, s), _sum(*((1, c) for c in laurent.values())))

    shift, wp = {}, _Pair({(1, 0, 0): Fraction(1)}, _ZERO)
    for n in range(2, _DEGREE + 1):
        factor = Fraction(-((-1) ** n), factorial(n))
        shift[n] = _Pair(_sum((factor, wp.even)), _sum((factor, wp.odd)))
        wp = wp.derivative()
    return s, w, _sum(*((1, pair.odd) for pair in _exponential(shift))), _quotient(_twice_as_long(s), s)


def _twice_as_long(polynomial: Polynomial) -> Polynomial:
    return {powers: 2 ** _weight(powers) * c for powers, c in polynomial.items()}


def _quotient(above: Polynomial, below: Polynomial) -> Polynomial:
    """above / below as a series in time, for a divisor that begins with 1."""
    total: Polynomial = {}
    for weight in range(0, _DEGREE + 1, 2):
        rest = _sum((1, above), (-1, _product(total, below)))
        total |= {powers: c for powers, c in rest.items() if _weight(powers) == weight}
    return total


def _weight(powers: tuple[int, int, int]) -> int:
    """The power of time that belongs to these powers of (p, g2, g3)."""
    return 2 * powers[0] + 4 * powers[1] + 6 * powers[2]


def _slope(polynomial: Polynomial, shift: int = 0) -> Polynomial:
    """(d/dt + shift) of the polynomial at time one."""
    return {powers: (shift + _weight(powers)) * c for powers, c in polynomial.items()}


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
    squared = _product(s, s)
    fourth = _product(squared, squared)
    z = _slope(s, 1)
    v = _sum((1, _product(_slope(w, -2), s)), (-2, _product(w, _slope(s))))
    a = _sum((2, _product(squared, w)), (2, _product(_product(squared, s), z)))
    b = _sum(
        (2, _product(w, w)),
        (Fraction(-1, 2), _product(_G2, fourth)),
        (-4, _product(_product(s, w), z)),
        (-1, _product(s, v)),
    )
    c = _sum(
        (Fraction(-1, 2), _product(_G2, _product(squared, w))),
        (-1, _product(_G3, fourth)),
        (1, _quotient(_sum((2, _product(z, _product(w, w))), (1, _product(v, w))), s)),
        (Fraction(1, 12), _product(_G2, a)),
    )
    g2_squared = _product(_G2, _G2)
    first = _sum((Fraction(1, 2), _product(g2_squared, b)), (-9, _product(_G3, c)))
    second = _sum((1, _product(_G2, c)), (Fraction(-3, 2), _product(_G3, b)))
    return a, _over_discriminant(first), _over_discriminant(second)


def _over_discriminant(polynomial: Polynomial) -> Polynomial:
    """polynomial / (g2^3 - 27 g3^2), for a polynomial that is divisible by the discriminant."""
    rest, total = polynomial, {}
    while rest:
        powers = max(rest, key=lambda powers: powers[1])
        _, j, k = powers
        total[0, j - 3, k] = rest[powers]
        rest = _sum((1, rest), (-rest[powers], {powers: Fraction(1), (0, j - 3, k + 2): Fraction(-27)}))
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
