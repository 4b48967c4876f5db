"""`GravityGradient`: the torque of a central mass on a body along a known orbit."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_positive, vector_at
from .._math import components as cp
from ..model.bodies import RigidBody, TensorBody
from ..model.orbits import Orbit
from ..model.orbits.base import check_units
from ..model.state import AnyState, Time, require_all_directions
from ..model.torques.base import Torque
from ..model.torques.reads_body import ReadsBody
from ..model.torques.travel import G_TIMES_MASS


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
        >>> torque = ml.spacecraft.GravityGradient([10.0, 40.0, 45.0], orbit, mu)  # moments in kg m^2
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
        self.mu = as_positive("mu", mu, cure=G_TIMES_MASS)
        check_units(orbit, self.mu)

    def on(self, body: Any) -> Torque:
        if self.moments is None:
            return super().on(body)
        if isinstance(body, TensorBody):
            raise ValueError("moments refer to principal axes; give None to use the TensorBody.")
        return self

    def _local(self, t: Time, state: AnyState) -> tuple[Array, cp.Vector]:
        position = cp.vector(vector_at("orbit", self.orbit, t))
        square = cp.dot(position, position)
        inverse = 1 / jnp.sqrt(square)
        u = require_all_directions(state).seen_from_body(cp.scale(inverse, position))
        return 3 * self.mu * inverse * inverse * inverse, u

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
