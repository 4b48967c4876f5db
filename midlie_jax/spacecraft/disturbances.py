"""Disturbance torques: the gravity gradient along a known orbit, eddy currents, and a gas in free molecular flow."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_function_of_time, as_not_negative, as_positive, vector_at
from .._math import components as cp
from .._xla.rows import sum_over_rows
from ..model.baths.base import as_tensor
from ..model.bodies import RigidBody, TensorBody
from ..model.free_body import Wrench
from ..model.orbits import Orbit
from ..model.orbits.base import check_units
from ..model.state import AnyState, Time, require_all_directions
from ..model.surface import Surface, as_amount, as_fractions, as_lit_surface, lit, of_facets, unshadowed, with_horizon
from ..model.torques.base import Torque
from ..model.torques.fields import to_body_components
from ..model.torques.reads_body import ReadsBody, ReadsVelocity
from ..model.torques.travel import G_TIMES_MASS, InAir, through_air, travelling


class GravityGradient(ReadsBody):
    """The gravity-gradient torque of a point mass on an orbiting body, 3 mu/r^3 u x I u with u = R^T r/|r|.

    It is exact to first order in body size over r (Hughes, Spacecraft Attitude Dynamics, section 8.1). The state needs
    an attitude. The torque ignores the position of a `FreeState`; `PointMass` uses it.

    Attributes:
        moments: principal moments of the body, (3,); None for the inertia of the body of the run, which can then be a
            `TensorBody`.
        orbit: the position r of the body relative to the attracting mass, `orbit(t) -> (3,)`, space frame, length.
        mu: gravitational parameter of the attracting mass, (), length^3/time^2.

    Raises:
        ValueError: moments not positive and of shape (..., 3), or mu not positive and finite; moments with a
            `TensorBody`; an orbit of this package whose speeds do not fit mu, as in other units.

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
        inverse = 1 / jnp.sqrt(cp.dot(position, position))
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


class EddyCurrents(ReadsVelocity):
    """The torque of eddy currents, T = (M (Omega x B)) x B, which never increases the energy.

    M is the magnetic tensor of the body (N. Ortiz Gomez, S. J. I. Walker, Acta Astronaut. 114 (2015) 34), which is M =
    2 pi / 15 sigma R^5 for a solid sphere and 2 pi / 3 sigma R^4 e for a thin shell of thickness e, with the
    conductivity sigma. The field is uniform over the body and changes little during the decay time of the currents.

    Attributes:
        tensor: M, (), (3,) for the diagonal, or a symmetric tensor (3, 3); body frame, torque time / field^2: S m^4 in
            SI units, with the field in T. An array (3, 3) is always a tensor, and never the diagonals of three bodies.
        field: B, space frame, (3,), or a function `field(t) -> (3,)`, such as `midlie_jax.orbits.DipoleField`.

    Raises:
        ValueError: another shape, numbers that are not finite, a tensor that is not symmetric or has a negative
            eigenvalue. When called: a state without an attitude.

    Examples:
        >>> brake = ml.spacecraft.EddyCurrents(tensor=2.0, field=[0.0, 0.0, 1.0])
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> brake.on(body)(0.0, state)[:2]  # across the field; the spin about the field is not damped
        Array([-2., -2.], dtype=float64)
    """

    tensor: Float[Array, "*batch"]
    field: Float[Array, "*batch 3"] | Callable[[Any], Array]

    def __init__(self, tensor: Any, field: Any):
        self.tensor = as_tensor("tensor", tensor)
        self.field = as_function_of_time("field", field)
        shape = self.tensor.shape
        if shape not in ((), (3,), (3, 3)) and shape[-1:] != (3,):
            raise ValueError(f"tensor must be (), (3,) or (3, 3), got {shape}.")

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        field = to_body_components("field", self.field, t, state)
        induced = cp.cross(cp.vector(body.velocity(state.momentum)), field)
        return cp.pack(cp.cross(self._times(induced), field))

    def _times(self, v: cp.Vector) -> cp.Vector:
        m = self.tensor
        if m.ndim == 0:
            return cp.scale(m, v)
        if m.ndim == 1:
            return cp.times(cp.vector(m), v)
        if m.shape != (3, 3):
            raise ValueError(f"tensor must be (), (3,) or (3, 3) for one body, got {m.shape}.")
        return cp.dot(cp.vector(m[0]), v), cp.dot(cp.vector(m[1]), v), cp.dot(cp.vector(m[2]), v)


_ROOT_OF_PI = float(np.sqrt(np.pi))


class FreeMolecularDrag(InAir):
    """Drag and lift of a thin gas on a surface, such as a satellite; molecules are re-emitted diffusely.

    With v the velocity of the body relative to the gas, n the normal of a facet of area A, w = n . v, c the thermal
    speed of the gas and x = w / c, the force on the facet at its centroid is

        -1/2 rho A (m v + (c^2 Z / 2 + sqrt(pi) / 2 v_r m) n)
        m = c exp(-x^2) / sqrt(pi) + w Z,   Z = 1 + erf(x),   v_r^2 = (1 - a) v^2 / 2 + a v_w^2

    (L. H. Sentman, LMSC-448514 (1961); so in E. Doornbos, Thermospheric Density and Wind Determination (2012), section
    3.3; accommodation: K. Moe, M. M. Moe, Planet. Space Sci. 53 (2005) 793). Some programs, such as ADBSat, take 2/3 in
    place of the factor 1/2 of v^2 in v_r^2. For a cold gas (c = 0) m is 2 w on the facets that move forward and zero on
    the others. The rotation of the body adds no velocity. Facets shield each other after `surface.with_shadows()`;
    without, a surface that is not convex gives a warning. A facet of which the fraction k is open towards v has the
    factor k in m of a cold gas, and Z = erfc|x| + k (erf|x| + erf(x)) in a warm one.

    Attributes:
        surface: the facets, in the frame of the body.
        density: rho of the gas, (), mass/length^3, or a function `density(t) -> ()`.
        velocity: v, space frame, (3,), or a function `velocity(t) -> (3,)`, length/time; None for the velocity of a
            `FreeState`.
        wind: with `velocity` None, the velocity of the gas, in the same forms; None for a gas at rest.
        accommodation: a, () or one for each facet, (n,): the fraction of the energy above the energy at wall
            temperature that molecules leave at the wall. 1 is usual below 300 km, 0.8 to 0.9 at 500 km.
        wall_speed: v_w = sqrt(2 k T / m) of the gas at the temperature of the wall, (), length/time. 0 omits
            re-emission at this temperature; 558 m/s for atomic oxygen at 300 K adds a few per cent to the drag.
        thermal_speed: c = sqrt(2 k T / m) of the gas, (), length/time; None for a cold gas, whose speed is negligible.

    Raises:
        ValueError: not a `Surface`; wrong shapes, numbers that are not finite, a negative density or wall speed, an
            accommodation not between 0 and 1, a thermal speed that is not positive, or velocity and wind together. When
            called: as for `Sunlight`; without `velocity`, body and state do not translate.

    Examples:
        >>> plate = ml.Surface.of_facets([0.5], [[1.0, 0.0, 0.0]], [[0.0, 0.5, 0.0]])  # 0.5 m^2, faces x, at y = 0.5 m
        >>> drag = ml.spacecraft.FreeMolecularDrag(plate, density=1e-11, velocity=[7600.0, 0.0, 0.0])
        >>> state = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> round(1e6 * float(drag(0.0, state)[2]), 3)  # micro-N m: the lever, 0.5 m, times rho A v^2
        144.4
    """

    surface: Surface
    density: Float[Array, "*batch"] | Callable[[Any], Array]
    accommodation: Float[Array, "*batch"]
    wall_speed: Float[Array, "*batch"]
    thermal_speed: Float[Array, "*batch"] | None

    def __init__(
        self,
        surface: Any,
        density: Any,
        velocity: Any = None,
        *,
        wind: Any = None,
        accommodation: Any = 1.0,
        wall_speed: Any = 0.0,
        thermal_speed: Any = None,
    ):
        self.surface, self.density = as_lit_surface(surface), as_amount("density", density)
        self._set_flow(velocity, wind)
        self.accommodation = as_fractions("accommodation", accommodation)
        self.wall_speed, self.thermal_speed = as_not_negative("wall_speed", wall_speed), None
        if thermal_speed is not None:
            self.thermal_speed = as_positive("thermal_speed", thermal_speed, cure="leave it out for a cold gas.")

    def torque_in(self, t: Time, velocity: cp.Vector) -> cp.Vector:
        return self._load(t, velocity)[0]

    def at(self, t: Time, state: AnyState, body: Any) -> Any:
        state, body = travelling(self, state, body)
        velocity = state.seen_from_body(through_air(t, state, body, self.wind))
        torque, force = self._load(t, velocity)
        return Wrench(cp.pack(torque), cp.pack(state.to_space(force)))

    def _load(self, t: Time, velocity: cp.Vector) -> tuple[cp.Vector, cp.Vector]:
        surface = self.surface
        accommodation = of_facets("accommodation", self.accommodation, surface)
        normals, centroids = cp.vector(surface.normals), cp.vector(surface.centroids)
        columns, tables = with_horizon((*normals, *centroids, surface.areas, accommodation), surface)
        square = cp.dot(velocity, velocity)
        wall = jnp.asarray(self.wall_speed, square.dtype)
        # Inside the sum, because products of areas, levers and squared speeds may exceed the range of the dtype.
        density = self.density(t) if callable(self.density) else self.density
        factor = -0.5 * jnp.asarray(density, square.dtype)
        flow = factor, velocity, square, (wall * wall, wall)
        if self.thermal_speed is None:
            return sum_over_rows(_cold, columns, flow, tables)
        return sum_over_rows(_warm, columns, (*flow, jnp.asarray(self.thermal_speed, square.dtype)), tables)


def _cold(row: Any, argument: Any) -> tuple[cp.Vector, cp.Vector]:
    factor, velocity, square, wall = argument
    met = 2 * factor * lit(cp.dot(row[0:3], velocity)) * unshadowed(row, 8, velocity)
    return _on_facet(row, velocity, met, None, square, wall)


def _warm(row: Any, argument: Any) -> tuple[cp.Vector, cp.Vector]:
    factor, velocity, square, wall, thermal = argument
    ahead = cp.dot(row[0:3], velocity)
    x = ahead / thermal
    z = 1 + jax.lax.erf(x)
    if len(row) > 8:  # of the molecules, erfc|x| are so fast that they come from all sides
        z = z - (1 - unshadowed(row, 8, velocity)) * 2 * lit(z - 1)
    met = factor * (thermal / _ROOT_OF_PI * jnp.exp(-x * x) + ahead * z)
    return _on_facet(row, velocity, met, factor * (thermal * thermal) / 2 * z, square, wall)


def _on_facet(
    row: Any, velocity: cp.Vector, met: Array, pressure: Array | None, square: Array, wall: tuple[Array, Array]
) -> tuple[cp.Vector, cp.Vector]:
    """Torque and force of the incoming gas, -rho/2 m, and of the pressure of a gas at rest, -rho/2 c^2 Z / 2."""
    normal, centroid, area, accommodation = row[0:3], row[3:6], row[6], row[7]
    push = _ROOT_OF_PI / 2 * _speed_away(square, accommodation, *wall) * met
    push = push if pressure is None else push + pressure
    force = cp.scale(area, cp.add(cp.scale(met, velocity), cp.scale(push, normal)))
    return cp.cross(centroid, force), force


@jax.custom_jvp
def _speed_away(square: Array, accommodation: Array, wall_square: Array, wall: Array) -> Array:
    """v_r, from v^2, a, v_w^2 and v_w, of which the value needs only the squares."""
    return cp.root(0.5 * (1 - accommodation) * square + accommodation * wall_square)


@_speed_away.defjvp
def _speed_away_tangent(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    """At zero, where the derivative of the square vanishes, v_r is sqrt(a) v_w."""
    value, change = jax.jvp(_speed_away.fun, primals, tangents)
    at_zero = cp.root(primals[1]) * tangents[3]
    return value, change + jnp.where(value > 0, jnp.zeros_like(at_zero), at_zero)
