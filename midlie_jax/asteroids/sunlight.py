"""`Sunlight`: the pressure of sunlight on the facets of a body, and of their thermal radiation."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, require
from .._math import components as cp
from .._xla.rows import sum_over_rows
from ..model.facets import (
    as_amount,
    as_direction,
    as_fractions,
    as_lit_surface,
    lit,
    of_facets,
    seen_from_body,
    unshadowed,
    with_horizon,
)
from ..model.state import AnyState, Time
from ..model.states import TravellingState
from ..model.surface import Surface
from ..model.torques.base import Torque
from ..model.wrench import Wrench

SPEED_OF_LIGHT = 299792458.0  # m/s
_TOLERANCE = 1e-6  # largest excess of specular + diffuse over 1


class Sunlight(Torque):
    """The pressure of sunlight on a surface, and of the thermal radiation of its lit facets (YORP).

    Let u be the unit vector to the Sun, n the normal of a facet of area A, and mu = n . u where this is positive. The
    fraction s of the light is reflected specularly and the fraction d is scattered by Lambert's law. The same facet
    immediately radiates the fraction h of the absorbed rest by Lambert's law. The force on the facet is

        -(flux / c) A mu ((1 - s) u + (2 s mu + 2/3 (d + h (1 - s - d))) n)

    at its centroid (O. Montenbruck, E. Gill, Satellite Orbits (2000), section 3.4, for s and d; D. P. Rubincam, Icarus
    148 (2000) 2, for h = 1, a body without thermal inertia). Facets do not heat each other, and shadow each other after
    `surface.with_shadows()`; without, a surface that is not convex gives a warning. For a `RigidState` the result is
    the torque about the origin of the frame, the centre of mass; for a `FreeState` a wrench.

    Attributes:
        surface: the facets, in the frame of the body.
        direction: to the Sun, space frame, a unit vector (3,); or a function `direction(t) -> (3,)`, whose value is
            normalised, such as minus the orbit about the Sun.
        flux: power per area across the light, (), or a function `flux(t) -> ()`, also for eclipses: W/m^2 where c is in
            m/s; 1361 at one astronomical unit.
        specular, diffuse, thermal: s, d and h, () or one for each facet, (n,).
        speed_of_light: c, (), by default in m/s; then lengths are in m, forces in N. For other units give c in these,
            or 1 and the flux as a pressure.

    Raises:
        ValueError: not a `Surface`, a direction that is not a unit vector, a negative flux, fractions not between 0 and
            1 or s + d above 1, a speed that is not positive. When called: fractions for another number of facets, or a
            state without an attitude.

    Examples:
        >>> panel = ml.Surface.of_facets([2.0], [[1.0, 0.0, 0.0]], [[0.0, 0.5, 0.0]])  # 2 m^2, faces x, at y = 0.5 m
        >>> light = ml.asteroids.Sunlight(panel, direction=[1.0, 0.0, 0.0], flux=1361.0)  # W/m^2; all is absorbed
        >>> state = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> round(1e6 * float(light(0.0, state)[2]), 4)  # micro-N m: the lever, 0.5 m, times flux A / c
        4.5398
    """

    surface: Surface
    direction: Float[Array, "*batch 3"] | Callable[[Any], Array]
    flux: Float[Array, "*batch"] | Callable[[Any], Array]
    specular: Float[Array, "*batch"]
    diffuse: Float[Array, "*batch"]
    thermal: Float[Array, "*batch"]
    speed_of_light: Float[Array, "*batch"]

    def __init__(
        self,
        surface: Any,
        direction: Any,
        flux: Any,
        specular: Any = 0.0,
        diffuse: Any = 0.0,
        thermal: Any = 0.0,
        *,
        speed_of_light: Any = SPEED_OF_LIGHT,
    ):
        self.surface, self.direction = as_lit_surface(surface), as_direction("direction", direction)
        self.flux, self.speed_of_light = as_amount("flux", flux), as_floats("speed_of_light", speed_of_light)
        require("speed_of_light", self.speed_of_light, lambda c: c > 0, "must be positive", "give it in your units.")
        self.specular, self.diffuse = as_fractions("specular", specular), as_fractions("diffuse", diffuse)
        self.thermal = as_fractions("thermal", thermal)
        if not cp.is_traced(self.specular, self.diffuse):
            reflected = np.asarray(self.specular) + np.asarray(self.diffuse)
            if np.any(reflected > 1 + _TOLERANCE):
                raise ValueError(f"specular + diffuse must be at most 1, got {reflected.max():g}; reduce them.")

    def __call__(self, t: Time, state: AnyState) -> Any:
        sun = seen_from_body("direction", self.direction, t, state)
        flux = self.flux(t) if callable(self.flux) else self.flux
        pressure = -jnp.asarray(flux, sun[0].dtype) / self.speed_of_light
        columns, tables = with_horizon(self._columns(), self.surface)
        (pushed, turned), along, across = sum_over_rows(_loads, columns, sun, tables)
        torque = cp.scale(pressure, cp.add(cp.cross(pushed, sun), turned))
        if not isinstance(state, TravellingState):
            return cp.pack(torque)
        force = cp.scale(pressure, cp.add(cp.scale(along, sun), across))
        return Wrench(cp.pack(torque), cp.pack(state.to_space(force)))

    def _columns(self) -> tuple[Array, ...]:
        """For each facet n, A (1 - s) times the centroid, the lever of n, 2/3 A (...), 2 A s, and A (1 - s)."""
        surface = self.surface
        specular = of_facets("specular", self.specular, surface)
        diffuse = of_facets("diffuse", self.diffuse, surface)
        thermal = of_facets("thermal", self.thermal, surface)
        normals, centroids = cp.vector(surface.normals), cp.vector(surface.centroids)
        taken = surface.areas * (1 - specular)
        spread = 2 / 3 * surface.areas * (diffuse + thermal * (1 - specular - diffuse))
        levers = cp.cross(centroids, normals)
        return *normals, *cp.scale(taken, centroids), *levers, spread, 2 * surface.areas * specular, taken


def _loads(row: Any, sun: cp.Vector) -> tuple[tuple[cp.Vector, cp.Vector], Array, cp.Vector]:
    # The force along u acts at the centroid, so one sum r x u gives its torque; the part across the facet acts along n.
    cosine = lit(cp.dot(row[0:3], sun))
    light = cosine * unshadowed(row, 12, sun)
    across = light * (row[9] + row[10] * cosine)
    torques = cp.scale(light, row[3:6]), cp.scale(across, row[6:9])
    return torques, light * row[11], cp.scale(across, row[0:3])
