"""Gravity, air and thrust on bodies that translate, as wrenches on the states of a `FreeBody`.

I is the inertia tensor about the centre of mass and J = R I R^T, u = x/r. The expansion of a potential V(x, R) in the
size of the body over r keeps the terms up to the second moments.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import (
    as_finite,
    as_floats,
    as_function_of_time,
    as_not_negative,
    as_positive,
    as_weak,
    is_unit,
    require,
    vector_at,
)
from ..._math import components as cp
from ..bodies import SymmetricRotor
from ..free_body import FreeBody, Wrench
from ..state import AnyState, Time
from ..states import TravellingState
from .base import Torque
from .fields import to_body_components
from .reads_body import ReadsBody, angular_velocity_of

_E3 = (0.0, 0.0, 1.0)  # the axis of symmetry, the only body direction that every state holds
G_TIMES_MASS = "pass G times the attracting mass."


def travelling(torque: Any, state: AnyState, body: Any) -> tuple[Any, Any]:
    if state.several:
        raise acts_on_one(torque)
    if not isinstance(state, TravellingState) or not isinstance(body, FreeBody | None):
        raise ValueError(
            f"{type(torque).__name__} acts on a body that translates, as a FreeState, got a {type(state).__name__}."
        )
    return state, body


def acts_on_one(torque: Any) -> ValueError:
    kind = type(torque).__name__
    return ValueError(f"{kind} acts on one body; for coupled bodies use midlie_jax.torques.OnEach({kind}(...)).")


class _Gravity(ReadsBody):
    @property
    def gravitational(self) -> bool:
        return True


class UniformGravity(_Gravity):
    """The weight m g of a body, V = -m g . x.

    Attributes:
        acceleration: g, space frame, (3,), length/time^2, such as (0, 0, -9.81).

    Examples:
        >>> body, still = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.5]), mass=10.0), [0.0, 0.0, 0.0]
        >>> state = ml.FreeState(still, [1.0, 0.0, 0.0, 0.0], still, position=[0.0, 0.0, 3.0])
        >>> round(float(ml.torques.UniformGravity([0.0, 0.0, -9.81]).on(body)(0.0, state).force[2]), 6)
        -98.1
    """

    acceleration: Float[Array, "*batch 3"]

    def __init__(self, acceleration: Any):
        self.acceleration = as_finite("acceleration", acceleration, (3,))

    def at(self, t: Time, state: AnyState, body: Any) -> Wrench:
        state, body = travelling(self, state, body)
        return Wrench(jnp.zeros_like(state.momentum), body.mass * self.acceleration)

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        moving, body = travelling(self, state, body)
        return -body.mass * cp.dot(cp.vector(self.acceleration), cp.vector(moving.position))


class _Place:
    """The position of a body in a field about the origin: 1/r, and the unit vector u in space and `here`, in the frame
    of the momentum.
    """

    def __init__(self, state: Any, body: FreeBody):
        x = cp.vector(state.position)
        self.inverse = cp.inverse_root(cp.dot(x, x))
        self.space = cp.scale(self.inverse, x)
        self.state, self.body = state, body
        self.here = self.seen(self.space)

    def seen(self, vector: cp.Vector) -> cp.Vector:
        return self.state.in_one_frame(_E3, vector)[1]

    def inertia_times(self, v: cp.Vector) -> cp.Vector:
        turning = self.body.body
        if not isinstance(turning, SymmetricRotor):
            return cp.vector(turning.momentum(cp.pack(v)))
        axis, _ = self.state.in_one_frame(_E3, self.space)
        gap = (turning.known_along - turning.moment) * cp.dot(axis, v)
        return cp.add(cp.scale(turning.moment, v), cp.scale(gap, axis))


class PointMass(_Gravity):
    """Gravity of a point mass at the origin: its force and its gravity gradient.

    V = -mu m/r - mu/(2 r^3) (tr I - 3 u . J u); the torque is 3 mu/r^3 u x I u, in the body frame (Hughes, Spacecraft
    Attitude Dynamics, section 8.1). Energy and the total angular momentum are conserved.

    Attributes:
        mu: gravitational parameter, (), length^3/time^2.
        gradient: whether the terms of second order act; without them, the body moves like a point and does not rotate.
            With them, a `SymmetricRotor` needs `along`.

    Examples:
        >>> earth = ml.torques.PointMass(mu=3.986e14)  # m^3/s^2
        >>> satellite = ml.FreeState([0.0] * 3, [1.0, 0.0, 0.0, 0.0], [0.0, 7.5e4, 0.0], position=[7e6, 0.0, 0.0])
        >>> round(float(earth.on(ml.FreeBody(body, mass=10.0))(0.0, satellite).force[0]), 4)  # N, -mu m / r^2
        -81.3469
    """

    mu: Float[Array, "*batch"]
    gradient: bool = eqx.field(static=True)

    @property
    def keeps_total_momentum(self) -> bool:
        return True

    def __init__(self, mu: Any, *, gradient: bool = True):
        self.gradient = gradient
        self.mu = as_positive("mu", mu, cure=G_TIMES_MASS)

    def at(self, t: Time, state: AnyState, body: Any) -> Wrench:
        place = _Place(*travelling(self, state, body))
        square, u = place.inverse * place.inverse, place.here
        if not self.gradient:
            pull = cp.pack(cp.scale(-self.mu * square * body.mass, place.space))
            return Wrench(jnp.zeros_like(state.momentum), pull)
        pull = place.inertia_times(u)
        along = body.mass + square * (1.5 * body.trace - 7.5 * cp.dot(u, pull))
        force = cp.add(cp.scale(along, u), cp.scale(3 * square, pull))
        strength = self.mu * square
        torque = cp.scale(3 * strength * place.inverse, cp.cross(u, pull))
        return Wrench(cp.pack(torque), cp.pack(state.to_space(cp.scale(-strength, force))))

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        place = _Place(*travelling(self, state, body))
        square, u = place.inverse * place.inverse, place.here
        if not self.gradient:
            return -self.mu * place.inverse * body.mass
        shape = body.trace - 3 * cp.dot(u, place.inertia_times(u))
        return -self.mu * place.inverse * (body.mass + square / 2 * shape)


class Oblateness(_Gravity):
    """The force and gravity gradient that the oblateness J2 of a planet at the origin adds to `PointMass`.

    With n the pole, s = n . u and k = mu J2 (radius/r)^2 / 2, the field is (k/r) (3 s^2 - 1), and

        V = m (k/r) (3 s^2 - 1)
            - k/(2 r^3) (6 n.Jn - 60 s n.Ju + (105 s^2 - 15) u.Ju - (15 s^2 - 3) tr I)

    Energy and the component of the total angular momentum along the pole are conserved.

    Attributes:
        mu: gravitational parameter of the planet, (), length^3/time^2.
        radius: equatorial radius, (), length.
        j2: the coefficient J2, (), such as 1.08263e-3 for the Earth.
        pole: unit vector along the axis of the planet, space frame, (3,); by default z.
        gradient: as for `PointMass`.

    Examples:
        >>> planet = ml.torques.Oblateness(mu=3.986e14, radius=6.378e6, j2=1.0826e-3)  # the Earth, m^3/s^2 and m
        >>> satellite = ml.FreeState([0.0] * 3, [1.0, 0.0, 0.0, 0.0], [0.0, 7.5e4, 0.0], position=[7e6, 0.0, 0.0])
        >>> round(float(planet.on(ml.FreeBody(body, mass=10.0))(0.0, satellite).force[0]), 4)  # N, above the equator
        -0.1097
    """

    mu: Float[Array, "*batch"]
    radius: Float[Array, "*batch"]
    j2: Float[Array, "*batch"]
    pole: Float[Array, "*batch 3"]
    gradient: bool = eqx.field(static=True)

    def __init__(self, mu: Any, radius: Any, j2: Any, pole: Any = None, *, gradient: bool = True):
        self.gradient = gradient
        self.mu, self.radius, self.j2 = as_positive("mu", mu), as_positive("radius", radius), as_finite("j2", j2)
        self.pole = as_weak(_E3) if pole is None else as_floats("pole", pole, (3,))
        require("pole", self.pole, is_unit, "must be a unit vector", "divide it by its norm.")

    def at(self, t: Time, state: AnyState, body: Any) -> Wrench:
        place = _Place(*travelling(self, state, body))
        square, u, n = place.inverse * place.inverse, place.here, place.seen(cp.vector(self.pole))
        k = self._strength(square)
        pole = cp.vector(self.pole)
        s = cp.dot(pole, place.space)
        if not self.gradient:
            parts = cp.scale(6 * s, pole), cp.scale(3 - 15 * s * s, place.space)
            return Wrench(jnp.zeros_like(state.momentum), cp.pack(cp.scale(-k * square * body.mass, cp.add(*parts))))
        of_u, of_n = place.inertia_times(u), place.inertia_times(n)
        nn, nu, uu, trace = cp.dot(n, of_n), cp.dot(n, of_u), cp.dot(u, of_u), body.trace
        s2 = s * s
        along_n = 6 * s * body.mass + square * (30 * nu + 15 * s * trace - 105 * s * uu)
        by_shape = -30 * nn + 420 * s * nu + (105 * s2 - 15) * trace - (945 * s2 - 105) * uu
        along_u = (3 - 15 * s2) * body.mass - square / 2 * by_shape
        pulls = cp.add(cp.scale(30 * s * square, of_n), cp.scale((15 - 105 * s2) * square, of_u))
        force = cp.add(pulls, cp.add(cp.scale(along_n, n), cp.scale(along_u, u)))
        first = cp.scale(15 - 105 * s2, cp.cross(u, of_u))
        second = cp.scale(30 * s, cp.add(cp.cross(u, of_n), cp.cross(n, of_u)))
        torque = cp.add(cp.add(first, second), cp.scale(-6, cp.cross(n, of_n)))
        torque = cp.scale(k * square * place.inverse, torque)
        return Wrench(cp.pack(torque), cp.pack(state.to_space(cp.scale(-k * square, force))))

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        place = _Place(*travelling(self, state, body))
        square, u, n = place.inverse * place.inverse, place.here, place.seen(cp.vector(self.pole))
        k, s = self._strength(square), cp.dot(cp.vector(self.pole), place.space)
        if not self.gradient:
            return k * place.inverse * body.mass * (3 * s * s - 1)
        of_u = place.inertia_times(u)
        nn, nu, uu = cp.dot(n, place.inertia_times(n)), cp.dot(n, of_u), cp.dot(u, of_u)
        shape = 6 * nn - 60 * s * nu + (105 * s * s - 15) * uu - (15 * s * s - 3) * body.trace
        return k * place.inverse * (body.mass * (3 * s * s - 1) - square / 2 * shape)

    def _strength(self, square: Array) -> Array:
        return self.mu * self.j2 / 2 * (self.radius * self.radius * square)


class Magnus(ReadsBody):
    """The lift of a spinning body in air, strength * Omega x v, with Omega and v in space.

    For a ball of radius a and cross section A in air of density rho it is 1/2 rho A a C_L. C_L is the lift coefficient
    per ratio a |Omega| / |v| of surface speed to flight speed.

    Attributes:
        strength: force per angular velocity and velocity, (), mass.
        wind: velocity of the air, space frame, (3,), or a function `wind(t) -> (3,)`; None for air at rest.

    Examples:
        >>> ball = ml.FreeBody(ml.RigidBody([0.5, 0.5, 0.5]), mass=2.0)
        >>> thrown = ml.FreeState([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0], position=[0.0, 0.0, 0.0])
        >>> ml.torques.Magnus(0.25).on(ball)(0.0, thrown).force[1].item()  # 0.25 (0, 0, 2) x (2, 0, 0)
        1.0
    """

    strength: Float[Array, "*batch"]
    wind: Float[Array, "*batch 3"] | Callable[[Any], Array] | None

    def __init__(self, strength: Any, wind: Any = None):
        self.strength = as_finite("strength", strength)
        self.wind = None if wind is None else as_function_of_time("wind", wind)

    @property
    def velocity_dependent(self) -> bool:
        return True

    def at(self, t: Time, state: AnyState, body: Any) -> Wrench:
        state, body = travelling(self, state, body)
        spin = state.to_space(angular_velocity_of(state, body))
        lift = cp.cross(spin, through_air(t, state, body, self.wind))
        return Wrench(jnp.zeros_like(state.momentum), cp.pack(cp.scale(self.strength, lift)))


class InAir(ReadsBody):
    """Base class of forces of air or gas on a body with a given velocity, or with the velocity of its state."""

    velocity: Float[Array, "*batch 3"] | Callable[[Any], Array] | None
    wind: Float[Array, "*batch 3"] | Callable[[Any], Array] | None

    def _set_flow(self, velocity: Any, wind: Any) -> None:
        self.velocity = None if velocity is None else as_function_of_time("velocity", velocity)
        self.wind = None if wind is None else as_function_of_time("wind", wind)
        if self.velocity is not None and self.wind is not None:
            raise ValueError("velocity is relative to the air: give velocity or wind, not both.")

    @property
    def velocity_dependent(self) -> bool:
        return self.velocity is None

    def on(self, body: Any) -> Torque:
        return super().on(body) if self.velocity is None else self

    def __call__(self, t: Time, state: AnyState) -> Any:
        if self.velocity is None:
            return super().__call__(t, state)
        return cp.pack(self.torque_in(t, to_body_components("velocity", self.velocity, t, state)))

    @abstractmethod
    def torque_in(self, t: Time, velocity: cp.Vector) -> cp.Vector:
        """The torque, from the velocity in the body frame."""


class Drag(InAir):
    """Air drag on a body whose cross section does not depend on the attitude: F = -1/2 rho A |v| v, and lever x F.

    This holds in free molecular flow (Hughes, section 8.2), and for a ball in air. With `velocity`, a known path, it is
    a torque alone. Without, it uses the velocity of a body that translates, and the drag is a wrench.

    Attributes:
        lever: vector from the centre of mass to the centre of pressure, body frame, (3,), length.
        area: drag coefficient times cross section A, (), length^2, not negative.
        density: density rho of the air, (), mass/length^3, not negative.
        velocity: velocity v of the body relative to the air, space frame, (3,), or a function `velocity(t) -> (3,)`,
            length/time; None for the velocity of a `FreeState`.
        wind: with `velocity` None, the velocity of the air, in the same forms; None for air at rest.

    Examples:
        >>> drag = ml.torques.Drag(lever=[0.0, 0.0, 0.5], area=2.0, density=1e-11, velocity=[7600.0, 0.0, 0.0])
        >>> state = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> round(1e6 * float(drag(0.0, state)[1]), 3)  # micro-N m: -lever * rho A v^2 / 2
        -288.8
    """

    lever: Float[Array, "*batch 3"]
    area: Float[Array, "*batch"]
    density: Float[Array, "*batch"]

    def __init__(self, lever: Any, area: Any, density: Any, velocity: Any = None, *, wind: Any = None):
        self.lever = as_finite("lever", lever, (3,))
        self.area, self.density = as_not_negative("area", area), as_not_negative("density", density)
        self._set_flow(velocity, wind)

    def check(self, state: AnyState) -> None:
        if isinstance(state, TravellingState):
            state.in_one_frame(cp.vector(self.lever))

    def torque_in(self, t: Time, velocity: cp.Vector) -> cp.Vector:
        return cp.cross(cp.vector(self.lever), self._force(velocity))

    def at(self, t: Time, state: AnyState, body: Any) -> Any:
        state, body = travelling(self, state, body)
        force = self._force(through_air(t, state, body, self.wind))
        return Wrench(cp.pack(cp.cross(*state.in_one_frame(cp.vector(self.lever), force))), cp.pack(force))

    def _force(self, velocity: cp.Vector) -> cp.Vector:
        return cp.scale(-self.density * self.area / 2 * cp.norm(velocity), velocity)


def through_air(t: Time, state: Any, body: FreeBody, wind: Array | Callable[[Any], Array] | None) -> cp.Vector:
    velocity = cp.vector(state.linear / body.mass)
    if wind is None:
        return velocity
    return cp.subtract(velocity, cp.vector(vector_at("wind", wind, t)))
