"""Trigonometric functions of small angles as short polynomials, which fuse into a step.

On a CPU, float64 sin and cos take several times the run time of the rest of a step, and do not vectorise. The
polynomials are economised Taylor polynomials: subtracting a Chebyshev polynomial removes each of the highest powers
(Lanczos, Applied Analysis, 1956, chapter VII). Two or three terms fewer then have the same error.
"""

from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from itertools import islice
from math import factorial

from jax import Array

from . import components as cp

# The polynomials below are exact to rounding for |w|^2 up to this bound, |w| <= 2.2.
WIDEST_SQUARE = 4.84
WIDEST_TURN = 2 * WIDEST_SQUARE**0.5  # radians; the quaternion of a rotation is made from half the rotation
# A smaller bound, |w| <= 1.22, for methods that solve an equation or are inaccurate for larger rotations.
LARGEST_SQUARE = 1.5
LARGEST_TURN = 2 * LARGEST_SQUARE**0.5
TERMS = {"float64": 9, "float32": 5}
SPIN_TERMS = {"float64": 10, "float32": 7}
STUMPFF_TERMS = {"float64": 11, "float32": 7}
_ECONOMISED = 12  # terms of a series that are economised; all later terms are far below rounding


@cache
def economised(shift: int, terms: int, bound: float = WIDEST_SQUARE) -> tuple[float, ...]:
    """Coefficients of an economised polynomial for the sum of (-x)^n / (2n + shift)!, 0 <= x <= bound.

    The first two coefficients come from the series, so that for small x the error is far below rounding.
    """
    # In powers of x / bound, the coefficients of the Chebyshev polynomials are integers.
    unit = Fraction(bound)
    series = [(-unit) ** n / factorial(2 * n + shift) for n in range(terms + _ECONOMISED)]
    exact, rest = series[:2], series[2:]
    for chebyshev in reversed(list(islice(_chebyshev(2, -1), terms - 2, len(rest)))):
        ratio = rest[-1] / chebyshev[-1]
        rest = [a - ratio * c for a, c in zip(rest, chebyshev, strict=True)][:-1]
    return tuple(float(c / unit**n) for n, c in enumerate(exact + rest))


def _chebyshev(slope: int, shift: int) -> Iterator[list[int]]:
    """The coefficients in x, lowest first, of the Chebyshev polynomials T_0, T_1, ... of slope x + shift."""
    before, last = [1], [shift, slope]
    yield before
    while True:
        yield last
        powers = zip([0, *last], [*last, 0], [*before, 0, 0], strict=True)
        before, last = last, [2 * (slope * lower + shift * same) - old for lower, same, old in powers]


def half_turn(w: cp.Vector) -> cp.Quaternion:
    """exp(w), the unit quaternion of a rotation by |w| about w, for |w|^2 <= WIDEST_SQUARE; its square is exp(2 w)."""
    cosine, sine = half_angle(cp.dot(w, w))
    return cosine, sine * w[0], sine * w[1], sine * w[2]


def spin(w: Array) -> tuple[Array, Array]:
    """(cos w, sin w) for w^2 <= WIDEST_SQUARE: the quaternion components of a rotation by 2 w about one axis."""
    cosine, sinc = cosine_and_sinc(w)
    return cosine, w * sinc


def cosine_and_sinc(w: Array) -> tuple[Array, Array]:
    """(cos w, sin(w)/w) for w^2 <= WIDEST_SQUARE."""
    return cosine_and_sinc_of_square(w * w)


def cosine_and_sinc_of_square(x: Array) -> tuple[Array, Array]:
    """(cos w, sin(w)/w) for w^2 = x <= WIDEST_SQUARE."""
    terms = SPIN_TERMS[str(x.dtype)]
    return cp.polynomial(economised(0, terms), x), cp.polynomial(economised(1, terms), x)


def half_angle(x: Array) -> tuple[Array, Array]:
    """cos(a/2) and sin(a/2)/a, with a^2 = x <= WIDEST_SQUARE."""
    cosine, sine = half_angle_polynomials(str(x.dtype))
    return cp.polynomial(cosine, x), cp.polynomial(sine, x)


@cache
def half_angle_polynomials(dtype: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The coefficients in x of both functions of `half_angle`."""
    terms = TERMS[dtype]
    cosine, sine = (economised(shift, terms, WIDEST_SQUARE / 4) for shift in (0, 1))
    return tuple(c / 4**n for n, c in enumerate(cosine)), tuple(c / (2 * 4**n) for n, c in enumerate(sine))


def stumpff(x: Array) -> tuple[Array, Array, Array, Array]:
    """Stumpff's functions c2, c3, c4 and c5 of x = a^2 <= 4 WIDEST_SQUARE.

    c_k = sum of (-x)^n / (2n + k)!: c2 = (1 - cos a)/a^2, c3 = (a - sin a)/a^3. It follows that
    c_k = 1/k! - x c_{k+2} and 2 dc_k/dx = k c_{k+2} - c_{k+1}.
    """
    four, five = (economised(k, STUMPFF_TERMS[str(x.dtype)], 4 * WIDEST_SQUARE) for k in (4, 5))
    c4, c5 = cp.polynomial(four, x), cp.polynomial(five, x)
    return 0.5 - x * c4, 1 / 6 - x * c5, c4, c5


# The bound for the arctangent series: tan(|w|/2)^2 with |w|^2 = LARGEST_SQUARE.
LARGEST_TANGENT_SQUARE = 0.4935
ARCTANGENT_TERMS = {"float64": 16, "float32": 8}
FEW_ARCTANGENT_TERMS = {"float64": 8, "float32": 5}


def _economised_arctangent(terms: int) -> tuple[float, ...]:
    """Coefficients of atan(t)/t in powers of t^2, from the truncated Chebyshev series on t^2 <= a^2.

    a^2 = LARGEST_TANGENT_SQUARE and atan(a c) = 2 sum (-1)^k r^(2k+1) / (2k+1) T_{2k+1}(c), r = (sqrt(1 + a^2) - 1)/a.
    The conversion to powers of c cancels strongly, so it is done in exact fractions.
    """
    a = Fraction(LARGEST_TANGENT_SQUARE**0.5)
    r = Fraction((1 + LARGEST_TANGENT_SQUARE) ** 0.5 - 1) / a
    total = [Fraction(0)] * (2 * terms)
    for degree, chebyshev in islice(enumerate(_chebyshev(1, 0)), 1, 2 * terms, 2):
        weight = 2 * (-1) ** (degree // 2) * r**degree / degree
        for n, c in enumerate(chebyshev):
            total[n] += weight * c
    return tuple(float(total[n] / a**n) for n in range(1, 2 * terms, 2))


ARCTANGENT = {name: _economised_arctangent(terms) for name, terms in ARCTANGENT_TERMS.items()}
FEW_ARCTANGENT = {name: _economised_arctangent(terms) for name, terms in FEW_ARCTANGENT_TERMS.items()}


def arctangent(x: Array, exact: bool) -> Array:
    """atan(t)/t, with t^2 = x <= LARGEST_TANGENT_SQUARE; if `exact` is False, to eight digits (float32: five)."""
    return cp.polynomial((ARCTANGENT if exact else FEW_ARCTANGENT)[str(x.dtype)], x)


def arctangent_slope(x: Array, exact: bool) -> Array:
    """The derivative of `arctangent(x, exact)` with respect to x."""
    coefficients = (ARCTANGENT if exact else FEW_ARCTANGENT)[str(x.dtype)]
    return cp.polynomial(tuple(n * c for n, c in enumerate(coefficients) if n), x)


def share_of_one(x: Array) -> Array:
    """1/(1 + x) for 0 <= x <= LARGEST_TANGENT_SQUARE, exact at zero: Newton steps from a quadratic first guess."""
    share = 1 - x * (0.942 - 0.559 * x)
    for _ in range(3 if x.dtype == "float64" else 2):
        share = share + share * (1 - share * (1 + x))
    return share
