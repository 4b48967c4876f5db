"""Torques of force fields with a potential: gravity, magnetism, gravity gradient."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, as_function_of_time, is_unit, require, require_finite, vector_at
from ..._math import components as cp
from ..bodies import RigidBody, TensorBody
from ..orbits import Orbit
from ..orbits.base import check_units
from ..state import AnyState, Time
from .base import Torque
from .reads_body import ReadsBody


class HeavyTop(Torque):
    """A top in uniform gravity with potential V = weight * (R axis)_z; z points upward in the space frame.

    Attributes:
        weight: m g l, mass times gravity times the distance from the pivot to the centre of mass, (), torque.
        axis: unit vector from the pivot to the centre of mass, body frame, a tuple of three numbers.

    Raises:
        ValueError: weight not finite, or axis not a unit vector. When called: the state does not hold this direction.

    Examples:
        >>> torque = ml.torques.HeavyTop(weight=2.0)
        >>> lying = ml.RigidState([0.0, 0.0, 0.0], ml.so3.exp(jnp.array([np.pi / 2, 0.0, 0.0])))  # rotated about x
        >>> round(float(torque(0.0, lying)[0]), 6)  # the weight rotates the top further about x
        2.0
    """

    weight: Float[Array, "*batch"]
    axis: tuple[float, float, float] = eqx.field(static=True)

    def __init__(self, weight: Any, axis: Any = (0.0, 0.0, 1.0)):
        self.weight = as_floats("weight", weight)
        require_finite("weight", self.weight)
        if np.shape(axis) != (3,):
            raise ValueError(f"axis must have shape (3,), got {np.shape(axis)}.")
        self.axis = (float(axis[0]), float(axis[1]), float(axis[2]))
        require("axis", self.axis, is_unit, "must be a unit vector", "divide it by its norm.")

    def __call__(self, t: Time, state: AnyState) -> Array:
        del t
        lever, up = state.in_one_frame(self.axis)
        return cp.pack(_cross(up, lever, self.weight))

    def potential(self, t: Time, state: AnyState) -> Array:
        del t
        lever, up = state.in_one_frame(self.axis)
        return self.weight * (lever[0] * up[0] + lever[1] * up[1] + lever[2] * up[2])

    def fixed_axis(self, state: AnyState) -> cp.Vector:
        return state.in_one_frame(self.axis)[1]


def _cross(a: Any, b: Any, factor: Any) -> cp.Vector:
    """factor a x b without products with a zero number; XLA would keep them, because they could be NaN.

    A component without any product is zero for any factor, so all bodies share it.
    """

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
    """A dipole fixed in the body, in an external field: V = -moment . R^T field.

    Examples are a compass needle and the residual magnetic dipole of a satellite.

    Attributes:
        moment: dipole moment, body frame, (3,).
        field: the field in the space frame, (3,), in units such that moment x field is a torque. A time-dependent field
            is a function `field(t) -> (3,)`, such as `midlie_jax.orbits.DipoleField` along an orbit; the state must
            then be a `RigidState`.

    Raises:
        ValueError: moment or field not of shape (..., 3) or not finite. When called: the state holds no direction, or
            the field changes and the state is a `DirectionState`.

    Examples:
        >>> compass = ml.torques.DipoleInField(moment=[2.0, 0.0, 0.0], field=[0.0, 0.5, 0.0])
        >>> state = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> compass(0.0, state)[2].item()  # moment x field
        1.0
    """

    moment: Float[Array, "*batch 3"]
    field: Float[Array, "*batch 3"] | Callable[[Any], Array]

    def __init__(self, moment: Any, field: Any):
        self.moment = as_floats("moment", moment, (3,))
        require_finite("moment", self.moment)
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


class GravityGradient(ReadsBody):
    """The gravity-gradient torque of a point mass on an orbiting body, 3 mu/r^3 u x I u with u = R^T r/|r|.

    It is exact to first order in body size over r (Hughes, Spacecraft Attitude Dynamics, section 8.1). The state needs
    an attitude: a `RigidState`, or a `FreeState`. The torque ignores the position of a `FreeState`; `PointMass` uses
    it.

    Attributes:
        moments: principal moments of the body, (3,); None for the inertia of the body of the run, which can then be a
            `TensorBody`.
        orbit: the position r of the body relative to the attracting mass, `orbit(t) -> (3,)`, space frame, length: a
            `midlie_jax.orbits.CircularOrbit`, a `KeplerOrbit`, or any callable.
        mu: gravitational parameter of the attracting mass, (), length^3/time^2.

    Raises:
        ValueError: moments not positive and of shape (..., 3), or mu not positive and finite; moments with a
            `TensorBody`; an orbit of this package whose speeds do not fit mu, for example an orbit in kilometres with
            mu in SI units.

    Examples:
        >>> mu = 3.986e14  # of the Earth, m^3/s^2
        >>> orbit = ml.orbits.CircularOrbit(position=[6.8e6, 0.0, 0.0], direction=[0.0, 1.0, 0.0], mu=mu)
        >>> torque = ml.torques.GravityGradient([10.0, 40.0, 45.0], orbit, mu)  # moments in kg m^2
        >>> turned = ml.RigidState([0.0, 0.0, 0.0], ml.so3.exp(jnp.array([0.0, 0.0, 0.1])))
        >>> round(1e6 * float(torque(0.0, turned)[2]), 3)  # micro-N m; it rotates axis 1 back to the vertical
        -11.333
    """

    moments: Float[Array, "*batch 3"] | None
    orbit: Orbit | Callable[[Any], Array]
    mu: Float[Array, "*batch"]

    def __init__(self, moments: Any, orbit: Orbit | Callable[[Any], Array], mu: Any):
        self.moments = None if moments is None else RigidBody(moments, physical=False).moments
        self.orbit = orbit
        self.mu = as_floats("mu", mu)
        mass = "pass G times the attracting mass."
        require("mu", self.mu, lambda m: np.isfinite(m) & (m > 0), "must be positive and finite", mass)
        check_units(orbit, self.mu)

    def on(self, body: Any) -> Torque:
        if self.moments is None:
            return super().on(body)
        if isinstance(body, TensorBody):
            raise ValueError("moments refer to principal axes; give None to use the TensorBody.")
        return self

    def _local(self, t: Time, state: AnyState) -> tuple[Array, cp.Vector]:
        """3 mu/r^3, and the unit vector u in body components."""
        position = cp.vector(vector_at("orbit", self.orbit, t))
        square = cp.dot(position, position)
        inverse = 1 / jnp.sqrt(square)
        return 3 * self.mu * inverse * inverse * inverse, require_all_directions(state).seen_from_body(
            cp.scale(inverse, position)
        )

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        strength, u = self._local(t, state)
        return cp.pack(cp.scale(strength, cp.cross(u, cp.vector(body.momentum(cp.pack(u))))))

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        """The potential energy up to terms independent of the attitude, (3 mu/2r^3) (u . I u - tr I / 3)."""
        strength, u = self._local(t, state)
        return strength / 2 * (cp.dot(u, cp.vector(body.momentum(cp.pack(u)))) - body.trace / 3)

    def tide(self, t: Time, state: AnyState, place: cp.Vector) -> cp.Vector:
        """The gravity at a position in the body minus the gravity at the centre of mass, body frame, to first order."""
        strength, u = self._local(t, state)
        return cp.subtract(cp.scale(strength * cp.dot(u, place), u), cp.scale(strength / 3, place))

    def __call__(self, t: Time, state: AnyState) -> Array:
        return super().__call__(t, state) if self.moments is None else self.at(t, state, self._own_body())

    def potential(self, t: Time, state: AnyState) -> Array:
        return super().potential(t, state) if self.moments is None else self.potential_at(t, state, self._own_body())

    def _own_body(self) -> RigidBody:
        return RigidBody(self.moments, physical=False)


def to_body_components(name: str, vector: Array | Callable[[Any], Array], t: Time, state: AnyState) -> cp.Vector:
    """The body components of a space vector, given as an array (3,) or as a function of time."""
    if callable(vector):
        return require_all_directions(state).seen_from_body(cp.vector(vector_at(name, vector, t)))
    return state.seen_from_body(cp.vector(vector))


def require_all_directions(state: AnyState) -> Any:
    """The state; a ValueError for a `DirectionState`, which holds one direction only."""
    if state.fixed_direction() is not None:
        raise ValueError("a DirectionState holds one fixed direction; use a RigidState if the direction changes.")
    return state
