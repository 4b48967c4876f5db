"""Inputs of `oracles` as exact fractions, so that `== 0` detects a degenerate motion without a tolerance."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
else:
    ArrayLike = Any  # with numpy's own alias, run-time type checkers reject a plain tuple of floats


def fresh_context(digits: int) -> Any:
    """A private mpmath context, which neither reads nor changes the global precision of the caller."""
    try:
        import mpmath
    except ImportError as error:
        raise ImportError(
            "The closed-form motions need mpmath, which comes with the extra: pip install 'midlie_jax[oracle]'."
        ) from error
    ctx = mpmath.mp.clone()
    ctx.dps = digits
    return ctx


def fractions(name: str, values: ArrayLike, length: int) -> list[Fraction]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (length,) or not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be {length} finite numbers, got {values!r}.")
    return [Fraction(float(v)) for v in array]


def read(
    moments: ArrayLike, momentum: ArrayLike, attitude: ArrayLike, times: ArrayLike
) -> tuple[list[Fraction], list[Fraction], list[Fraction], NDArray[np.float64]]:
    inertia = fractions("moments", moments, 3)
    if min(inertia) <= 0:
        raise ValueError(f"moments must be positive, got {moments!r}.")
    quaternion = fractions("attitude", attitude, 4)
    if not any(quaternion):
        raise ValueError("attitude must not be the zero quaternion; the identity is (1, 0, 0, 0).")
    instants = np.asarray(times, dtype=np.float64)
    if instants.ndim != 1 or not np.all(np.isfinite(instants)):
        raise ValueError(f"times must be a one-dimensional array of finite numbers, got shape {instants.shape}.")
    return inertia, fractions("momentum", momentum, 3), quaternion, instants


def real(ctx: Any, value: Fraction) -> Any:
    return ctx.mpf(value.numerator) / value.denominator


def quaternion_product(p: Any, q: Any) -> tuple[Any, Any, Any, Any]:
    """Hamilton's product of quaternions, scalar first, for any type of numbers."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def decimal_size(ctx: Any, *values: Any) -> int:
    """The number of digits before the decimal point of the largest value, the required increase of precision."""
    return max(0, *(int(ctx.mag(v) * 0.30103) + 1 for v in values if v != 0), 0)
