"""Rotating unit vectors: the direction of a `DirectionState` and the axis of an `AxisState`."""

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..leaf import Leaf
from .length import length_correction


class UnitVector(Leaf):
    """A momentum and a unit vector."""

    freedom: ClassVar[int] = 5

    @staticmethod
    def shift(pose: cp.Vector, change: cp.Vector, no_step: Array) -> cp.Vector:
        moved = cp.add(pose, change)
        correction = length_correction(cp.dot(moved, moved), no_step)
        return cp.add(pose, cp.add(change, cp.scale(correction, moved)))

    @staticmethod
    def normalised(*arrays: Array) -> tuple[Array, ...]:
        momentum, v = arrays
        return momentum, v / jnp.sqrt(jnp.sum(v**2, axis=-1, keepdims=True))

    @staticmethod
    def plus(increment: Array, *arrays: Array) -> tuple[Array, ...]:
        return arrays[0] + increment[..., :3], turned(arrays[1], increment[..., 3:])

    @staticmethod
    def minus(arrays: tuple[Array, ...], others: tuple[Array, ...]) -> Array:
        return jnp.concatenate([arrays[0] - others[0], turn_between(others[1], arrays[1])], axis=-1)


def changed(v: cp.Vector, change: cp.Vector, no_step: Array) -> cp.Vector:
    """v + change, the end of a rotation of v, with its length corrected for earlier rounding errors."""
    correction = length_correction(cp.dot(v, v), no_step)
    # The correction points along the new vector; otherwise errors of the length would grow.
    return cp.add(v, cp.add(change, cp.scale(correction, cp.add(v, change))))


def turned(v: Array, turn: Array) -> Array:
    """A unit vector (..., 3), rotated by the vector turn (..., 2) in the plane perpendicular to it."""
    first, second = _across(v)
    across = turn[..., 0:1] * first + turn[..., 1:2] * second
    angle = cp.root(jnp.sum(across**2, axis=-1, keepdims=True))
    return jnp.cos(angle) * v + jnp.sinc(angle / jnp.pi) * across


def turn_between(start: Array, end: Array) -> Array:
    """The rotation (..., 2) with `turned(start, turn)` = end. For opposite vectors, the one along the first axis."""
    axes = _across(start)
    cosine = jnp.sum(end * start, axis=-1, keepdims=True)
    across = end - cosine * start
    sine = cp.root(jnp.sum(across**2, axis=-1, keepdims=True))
    parallel, one = sine <= 8 * cp.epsilon(sine), jnp.ones_like(sine)  # then `across` is only rounding
    turn = across * jnp.where(parallel, one, jnp.arctan2(sine, cosine) / jnp.where(parallel, one, sine))
    turn = jnp.where(parallel & (cosine < 0), jnp.pi * axes[0], turn)
    return jnp.concatenate([jnp.sum(turn * axis, axis=-1, keepdims=True) for axis in axes], axis=-1)


def _across(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors perpendicular to a unit vector and each other; both jump where its z component changes sign.

    T. Duff et al., J. Comput. Graph. Tech. 6 (2017) 1.
    """
    x, y, z = (direction[..., i : i + 1] for i in range(3))
    sign = jnp.where(z < 0, -1, 1).astype(direction.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    first = jnp.concatenate([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    return first, jnp.concatenate([b, sign + y * y * a, -y], axis=-1)
