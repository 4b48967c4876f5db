"""`FreeMolecularDrag`: the force of a gas so thin that its molecules do not collide with each other."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_not_negative, as_positive
from .._math import components as cp
from .._xla.rows import sum_over_rows
from ..model.facets import as_amount, as_fractions, as_lit_surface, lit, of_facets, unshadowed, with_horizon
from ..model.state import AnyState, Time
from ..model.surface import Surface
from ..model.torques.travel import InAir, through_air, travelling
from ..model.wrench import Wrench

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
    factor k in m of a cold gas, and Z = erfc|x| + k (erf|x| + erf(x)) in a warm one. Molecules that leave one facet do
    not meet another.

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
        if self.thermal_speed is None:
            return sum_over_rows(_cold, columns, (factor, velocity, square, (wall * wall, wall)), tables)
        thermal = jnp.asarray(self.thermal_speed, square.dtype)
        return sum_over_rows(_warm, columns, (factor, velocity, square, (wall * wall, wall), thermal), tables)


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
    away = _speed_away(square, accommodation, *wall)
    push = _ROOT_OF_PI / 2 * away * met
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
