"""Trigonometry of small turns by short polynomials.

float64 sin and cos cost a CPU several times the rest of a step and do not vectorise. A step turns by a small
angle, whose half is smaller still: Taylor polynomials in its square are exact to rounding and fuse. The
quaternion of the whole turn is then the square of that of the half.
"""

from math import factorial

from jax import Array

from . import _components as cp

# |w|^2 for which the polynomials below are exact to rounding; |w| <= 1.22.
LARGEST_SQUARE = 1.5
_TERMS = {"float64": 9, "float32": 5}
_STUMPFF_TERMS = {"float64": 11, "float32": 6}
_FEW_TERMS = {"float64": 4, "float32": 3}


def _taylor(shift: int, scale: float, terms: int) -> tuple[float, ...]:
    """scale^(2n) (-1)^n / (2n + shift)!"""
    return tuple((-1) ** n * scale ** (2 * n) / factorial(2 * n + shift) for n in range(terms))


def half_turn(w: cp.Vector) -> cp.Quaternion:
    """exp(w) as a unit quaternion, for |w|^2 <= LARGEST_SQUARE; its square is exp(2 w)."""
    cosine, sine = half_angle(cp.dot(w, w))
    return cp.normalize_once((cosine, sine * w[0], sine * w[1], sine * w[2]))


def half_angle(x: Array) -> tuple[Array, Array]:
    """cos(a/2) and sin(a/2)/a at a^2 = x <= LARGEST_SQUARE."""
    terms = _TERMS[str(x.dtype)]
    sine = tuple(0.5 * c for c in _taylor(1, 0.5, terms))
    return cp.polynomial(_taylor(0, 0.5, terms), x), cp.polynomial(sine, x)


def dexp_weights(x: Array, exact: bool) -> tuple[Array, Array]:
    """(1 - cos a)/a^2 and (a - sin a)/a^3 at a^2 = x <= LARGEST_SQUARE; unless exact, to six digits (float32: four)."""
    terms = (_TERMS if exact else _FEW_TERMS)[str(x.dtype)]
    return cp.polynomial(_taylor(2, 1.0, terms), x), cp.polynomial(_taylor(3, 1.0, terms), x)


def stumpff(x: Array) -> tuple[Array, Array, Array, Array]:
    """Stumpff's c2, c3, c4, c5 at x = a^2 <= 4 LARGEST_SQUARE: c2 = (1 - cos a)/a^2, c3 = (a - sin a)/a^3.

    c_k = sum of (-x)^n / (2n + k)!, so that c_k = 1/k! - x c_{k+2} and 2 dc_k/dx = k c_{k+2} - c_{k+1}.
    """
    terms = _STUMPFF_TERMS[str(x.dtype)]
    four = cp.polynomial(_taylor(4, 1.0, terms), x)
    five = cp.polynomial(_taylor(5, 1.0, terms), x)
    return 0.5 - x * four, 1 / 6 - x * five, four, five
