"""Exact rotation of spins in a constant field: precession and damping in closed form."""

from typing import Any

import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._math.short_series import WIDEST_SQUARE, half_turn

_SMALL = 1e-4  # below, tanh(y)/y uses its series in y^2
_UNTOUCHED = 100  # roundings of |S|^2
_LEAST_DENOMINATOR = 0.05


def turned(spin: cp.Vector, angle: cp.Vector) -> cp.Vector:
    """Spins rotated by rotation vectors. Above `WIDEST_TURN` radians the result is NaN, so `ok` is False."""
    half = cp.scale(0.5, angle)
    w, x, y, z = cp.square(half_turn(half))
    within = jnp.where(cp.dot(half, half) <= WIDEST_SQUARE, jnp.ones_like(w), jnp.full_like(w, jnp.nan))
    return cp.add(spin, cp.rotation_change((within * w, x, y, z), spin))


def unit(spin: cp.Vector) -> cp.Vector:
    """Spins with lengths corrected if these differ from one by so much that compilation does not decide on it."""
    excess = cp.dot(spin, spin) - 1
    far = jnp.abs(excess) > _UNTOUCHED * cp.epsilon(excess)
    return cp.scale(jnp.where(far, 1 - excess / 2, jnp.ones_like(excess)), spin)


def damped(spin: cp.Vector, field: cp.Vector, mobility: Any) -> cp.Vector:
    """Spins after damping S' = (mobility / h) S x (B x S) in a constant field, for the time h.

    The component along the field goes to tanh(atanh(S . B/|B|) + mobility |B|). With c = tanh(mobility |B| / 2) / |B|

        S -> ((1 - c^2 B^2) S + 2 c (1 + c S . B) B) / (1 + c^2 B^2 + 2 c S . B).

    An error of the length grows by about the inverse square of the denominator. If that is less than
    `_LEAST_DENOMINATOR`, for a spin opposite to a field with mobility |B| > 2, the result is NaN and `ok` is False.
    """
    square, along = cp.dot(field, field), cp.dot(field, spin)
    half, argument = mobility / 2, mobility * mobility * square / 4
    small = argument < _SMALL
    y = jnp.sqrt(jnp.where(small, jnp.ones_like(argument), argument))
    series = 1 - argument * (1 / 3 - argument * (2 / 15 - argument * (17 / 315 - argument * (62 / 2835))))
    c = half * jnp.where(small, series, jnp.tanh(y) / y)
    bounded = c * c * square
    denominator = 1 + bounded + 2 * c * along
    factor = 1 / jnp.where(denominator >= _LEAST_DENOMINATOR, denominator, jnp.nan)
    kept = cp.scale((1 - bounded) * factor, spin)
    return cp.add(kept, cp.scale(2 * c * (1 + c * along) * factor, field))


def turned_by_own(spin: cp.Vector, axis: Any, ratio: Array, h: Array, damping: Array) -> cp.Vector:
    """Spins after the time h in a field ratio z along an axis, z = S . axis, times g, with damping alpha.

    z' = alpha ratio z (1 - z^2), so sinh(atanh z) grows by the factor E = exp(x), x = alpha ratio h. The angle about
    the axis is the change of atanh z divided by alpha, which for alpha = 0 is ratio z h.
    """
    z = cp.dot(axis, spin)
    x = damping * ratio * h
    grown = jnp.expm1(2 * x)
    length = jnp.sqrt(1 + z * z * grown)  # of S with its component along the axis times E
    size = jnp.abs(z)
    # The change of asinh(s), s = sinh(atanh |z|), without cancellation and without a pole at |z| = 1.
    change = jnp.log1p((size * jnp.expm1(x) + z * z * grown / (length + 1)) / (1 + size))
    still = damping == 0
    angle = jnp.where(still, ratio * z * h, jnp.sign(z) * change / jnp.where(still, jnp.ones_like(damping), damping))
    rotated = turned(spin, cp.scale(angle, axis))
    stretched = cp.add(rotated, cp.scale(jnp.expm1(x) * z, axis))
    return cp.scale(1 / length, stretched)
