"""The motion of a rigid body without torque, or under its weight, by Taylor series in fixed-point integers.

The series shares no error with the integrators: it uses neither JAX nor floating-point numbers. It has 45 digits and no
special cases; a rotation by 100 radians takes about 0.1 s. `tests/test_oracles.py` compares it with published
figures and, for a free body, with the closed form.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import reduce
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

DIGITS = 30  # of the result, before it is rounded to float64
_BITS = 150  # of the fraction of a fixed-point number
_ORDER = 32
_LEAST = 1e-40  # stands for a coefficient that is zero


def exact_motion(
    moments: Any, momentum: Any, attitude: Any, times: Any, *, weight: float = 0.0, axis: Any = (0.0, 0.0, 1.0)
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Momentum and attitude of a rigid body at the given times.

    The body starts at time 0 and obeys Pi' = Pi x I^-1 Pi + weight (R^T e_z) x axis, R' = R skew(I^-1 Pi).

    Args:
        moments: (3,) positive principal moments, in any order.
        momentum: (3,) angular momentum Pi in the body frame at time 0.
        attitude: (4,) quaternion (w, x, y, z), body to space, at time 0; need not be normalised.
        times: (n,) in any order, may be negative.
        weight, axis: as in `HeavyTop`; the potential is weight (R axis).z.

    Returns:
        Momenta (n, 3) in the body frame and unit quaternions (n, 4), body to space, accurate to the last place of
        float64. The quaternion follows the motion continuously from `attitude`: it does not jump to its negative.
    """
    inertia, start = _fractions("moments", moments, 3), _fractions("momentum", momentum, 3)
    quaternion, pull = _fractions("attitude", attitude, 4), _fractions("weight and axis", [weight, *axis], 4)
    instants = _fractions("times", times)
    if min(inertia) <= 0:
        raise ValueError(f"moments must be positive, got {moments!r}.")
    if not any(quaternion):
        raise ValueError("attitude must not be the zero quaternion; the identity is (1, 0, 0, 0).")
    # Units of moment and time, powers of 2, in which no number is large.
    mass = _power(max(inertia))
    rate = max(*(abs(p / i) for p, i in zip(start, inertia, strict=True)), _root(abs(pull[0]) / min(inertia)))
    second = 1 / _power(rate) if rate else Fraction(1)
    w, x, y, z = (q / _root(sum(q * q for q in quaternion)) for q in quaternion)
    up = [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]
    at_start = [*map(_fixed, (*(p * second / mass for p in start), *up, w, x, y, z))]
    slow = [_fixed(mass / i) for i in inertia]
    torque = [_fixed(pull[0] * a * second**2 / mass) for a in pull[1:]]
    found: dict[Fraction, list[int]] = {Fraction(0): at_start}
    for sign in (1, -1):
        values, now = at_start, Fraction(0)
        for t in sorted({abs(t) for t in instants if t * sign > 0}):
            values = _advance(values, slow, torque, _fixed((t - now) / second), sign)
            found[sign * t], now = values, t
    rows = [[float(Fraction(v, 1 << _BITS)) for v in found[t]] for t in instants]
    numbers = np.array(rows, np.float64).reshape(-1, 10)
    return numbers[:, :3] * float(mass / second), numbers[:, 6:]


def _fractions(name: str, values: Any, count: int | None = None) -> list[Fraction]:
    array = np.asarray(values, np.float64)
    if array.ndim != 1 or count not in (None, array.size) or not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be {count or 'a list of'} finite numbers, got {values!r}.")
    return [Fraction(v) for v in array.tolist()]


def _power(value: Fraction) -> Fraction:
    return Fraction(2) ** math.frexp(value)[1]


def _root(square: Fraction | int) -> Fraction:
    return Fraction(math.isqrt(int(square * 4 ** (_BITS + 8))), 2 ** (_BITS + 8))


def _fixed(value: Fraction) -> int:
    return (value.numerator << _BITS) // value.denominator


def _advance(values: list[int], slow: list[int], torque: list[int], left: int, sign: int) -> list[int]:
    """Momentum, vertical direction in the body, and quaternion after a time, in steps as long as the series allows."""
    while left > 0:
        series = [[v] for v in values]
        p, up, w, v = series[:3], series[3:6], series[6], series[7:]
        spin: list[list[int]] = [[], [], []]
        for n in range(_ORDER):
            for o, one, i in zip(spin, p, slow, strict=True):
                o.append(one[n] * i >> _BITS)
            pulls = _cross([u[n] for u in up], torque, mul)
            rates = [
                *(turn + pull for turn, pull in zip(_cross(p, spin, _convolved), pulls, strict=True)),
                *_cross(up, spin, _convolved),
                -sum(map(_convolved, v, spin)) >> 1,
                *(_convolved(w, o) + turn >> 1 for o, turn in zip(spin, _cross(v, spin, _convolved), strict=True)),
            ]
            for one, change in zip(series, rates, strict=True):
                one.append(sign * (change >> _BITS) // (n + 1))
        sizes = [(n, max(_LEAST, max(abs(s[n]) for s in series) / 2.0**_BITS)) for n in (_ORDER - 1, _ORDER)]
        step = min(_fixed(Fraction(min((0.1 ** (DIGITS + 1) / size) ** (1 / n) for n, size in sizes))), left)
        values = [
            reduce(lambda value, coefficient: coefficient + (value * step >> _BITS), reversed(one)) for one in series
        ]
        left -= step
    return values


def _convolved(a: Sequence[int], b: Sequence[int]) -> int:
    """The last Taylor coefficient of a product."""
    return sum(map(mul, a, reversed(b)))


def _cross(a: Sequence[Any], b: Sequence[Any], product: Any) -> list[int]:
    return [product(a[i], b[j]) - product(a[j], b[i]) for i, j in ((1, 2), (2, 0), (0, 1))]
