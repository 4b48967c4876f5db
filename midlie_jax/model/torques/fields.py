"""Torques of force fields with a potential: uniform gravity on a top, and a dipole in a field."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_function_of_time, is_unit, require, vector_at
from ..._math import components as cp
from ..state import AnyState, Time, require_all_directions
from .base import Torque


class HeavyTop(Torque):
    """A top in uniform gravity with potential V = mgl * (R axis)_z; z points upward in the space frame.

    Attributes:
        mgl: m g l, mass times gravity times the distance l from the pivot to the centre of mass, (), torque; not m g.
        axis: unit vector from the pivot to the centre of mass, body frame, a tuple of three numbers.

    Examples:
        >>> ml.torques.HeavyTop(mgl=20.0)(0.0, start).round(4)[0]  # the weight rotates the top further about x
        Array(5.9104, dtype=float64)
    """

    mgl: Float[Array, "*batch"]
    axis: tuple[float, float, float] = eqx.field(static=True)

    def __init__(self, mgl: Any, axis: Any = (0.0, 0.0, 1.0)):
        self.mgl = as_finite("mgl", mgl)
        if np.shape(axis) != (3,):
            raise ValueError(f"axis must have shape (3,), got {np.shape(axis)}.")
        self.axis = (float(axis[0]), float(axis[1]), float(axis[2]))
        require("axis", self.axis, is_unit, "must be a unit vector", "divide it by its norm.")

    def __call__(self, t: Time, state: AnyState) -> Array:
        lever, up = state.in_one_frame(self.axis)
        return cp.pack(_cross(up, lever, self.mgl))

    def potential(self, t: Time, state: AnyState) -> Array:
        lever, up = state.in_one_frame(self.axis)
        return self.mgl * (lever[0] * up[0] + lever[1] * up[1] + lever[2] * up[2])

    def fixed_axis(self, state: AnyState) -> cp.Vector:
        return state.in_one_frame(self.axis)[1]


def _cross(a: Any, b: Any, factor: Any) -> cp.Vector:
    """factor a x b without products with a zero number; XLA would keep them, because they could be NaN."""

    def zero(x: Any) -> bool:
        return isinstance(x, float) and not x

    def minor(i: int, j: int) -> Any:
        total: Any = None
        if not (zero(a[i]) or zero(b[j])):
            total = a[i] * b[j]
        if not (zero(a[j]) or zero(b[i])):
            total = -a[j] * b[i] if total is None else total - a[j] * b[i]
        return jnp.zeros_like(factor * a[0] * b[0]) if total is None else factor * total

    return minor(1, 2), minor(2, 0), minor(0, 1)


class DipoleInField(Torque):
    """A dipole fixed in the body, in an external field: V = -moment . R^T field; for example a compass needle.

    Attributes:
        moment: dipole moment, body frame, (3,).
        field: the field in the space frame, (3,), in units such that moment x field is a torque; or a function
            `field(t) -> (3,)`, such as `midlie_jax.orbits.DipoleField` along an orbit, for states with an attitude.

    Examples:
        >>> compass = ml.torques.DipoleInField(moment=[2.0, 0.0, 0.0], field=[0.5, 0.0, 0.0])
        >>> compass.potential(0.0, start).item()  # parallel
        -1.0
    """

    moment: Float[Array, "*batch 3"]
    field: Float[Array, "*batch 3"] | Callable[[Any], Array]

    def __init__(self, moment: Any, field: Any):
        self.moment = as_finite("moment", moment, (3,))
        self.field = as_function_of_time("field", field)

    def check(self, state: AnyState) -> None:
        state.in_one_frame(cp.vector(self.moment))

    def _together(self, t: Time, state: AnyState) -> tuple[cp.Vector, cp.Vector]:
        field = self.field
        if callable(field):
            require_all_directions(state)
        return state.in_one_frame(cp.vector(self.moment), cp.vector(vector_at("field", field, t)))

    def __call__(self, t: Time, state: AnyState) -> Array:
        return cp.pack(cp.cross(*self._together(t, state)))

    def potential(self, t: Time, state: AnyState) -> Array:
        return -cp.dot(*self._together(t, state))

    def fixed_axis(self, state: AnyState) -> cp.Vector | None:
        return None if callable(self.field) else state.in_one_frame(cp.vector(self.moment), cp.vector(self.field))[1]


def to_body_components(name: str, vector: Array | Callable[[Any], Array], t: Time, state: AnyState) -> cp.Vector:
    if callable(vector):
        return require_all_directions(state).seen_from_body(cp.vector(vector_at(name, vector, t)))
    return state.seen_from_body(cp.vector(vector))
