"""Sunlight on a surface or ellipsoid: its brightness by scattering laws, and the pressure of light."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, as_not_negative, as_positive, require, require_function
from .._math import components as cp
from .._math.powers import unit
from .._xla.rows import sum_over_rows
from ..drivers.observe.observables import Observable
from ..model.bodies import Body
from ..model.free_body import Wrench
from ..model.state import AnyState, Time
from ..model.states import TravellingState
from ..model.surface import (
    Surface,
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
from ..model.torques import TorqueLike
from ..model.torques.base import Torque


class Scattering(eqx.Module):
    """A scattering law: the brightness of a facet per area and albedo, `law(mu, mu0) -> ()`.

    A custom law is a subclass. It must tend to zero where mu or mu0 does, without a jump; it is called only where both
    are positive.

    Examples:
        >>> class Minnaert(ml.asteroids.Scattering):  # of your own, for ml.asteroids.Brightness
        ...     k: float
        ...     def __call__(self, mu, mu0):
        ...         return mu0**self.k * mu**self.k
        >>> Minnaert(2.0)(jnp.array(0.5), jnp.array(1.0)).item()
        0.25
    """

    @abstractmethod
    def __call__(self, mu: Array, mu0: Array) -> Array:
        """The law, of the cosines between the normal and the observer, mu, and the Sun, mu0, each ()."""


class Lambert(Scattering):
    """Lambert's law, mu mu0, for a white, rough surface; the intensity is pi times that for this albedo.

    Examples:
        >>> law = ml.asteroids.Lambert()  # for ml.asteroids.Brightness
        >>> law(jnp.array(0.5), jnp.array(0.25)).item()
        0.125
    """

    def __call__(self, mu: Array, mu0: Array) -> Array:
        return mu * mu0


class LommelSeeliger(Scattering):
    """The Lommel-Seeliger law plus a fraction of Lambert's law, mu mu0 (1 / (mu + mu0) + lambert).

    It describes a dark surface, such as most asteroids. With lambert = 0.1 it is the law of light curve inversion (M.
    Kaasalainen, J. Torppa, Icarus 153 (2001) 24; K. Muinonen et al., Astron. Astrophys. 642 (2020) A138).

    Attributes:
        lambert: the factor of Lambert's law, (), not negative; 0 for Lommel-Seeliger alone.

    Raises:
        ValueError: the factor is negative or not finite.

    Examples:
        >>> law = ml.asteroids.LommelSeeliger(lambert=0.1)  # for ml.asteroids.Brightness
        >>> round(float(law(jnp.array(0.5), jnp.array(0.25))), 6)  # 0.125 (1 / 0.75 + 0.1)
        0.179167
    """

    lambert: Float[Array, "*batch"]

    def __init__(self, lambert: Any = 0.0):
        self.lambert = as_not_negative("lambert", lambert, cure="as in 0.1.")

    def __call__(self, mu: Array, mu0: Array) -> Array:
        return mu * mu0 * (1 / (mu + mu0) + self.lambert.astype(mu.dtype))


class Light(Observable):
    """Sunlight that a body sends to an observer; also callable as `light(t, state)`."""

    sun: Float[Array, "*batch 3"] | Callable[[Any], Array]
    observer: Float[Array, "*batch 3"] | Callable[[Any], Array]
    phase: Callable[[Array], Array] | None
    magnitude: bool = eqx.field(static=True)

    def _view(self, sun: Any, observer: Any, phase: Any, magnitude: bool) -> None:
        self.sun, self.observer = as_direction("sun", sun), as_direction("observer", observer)
        if phase is not None:
            require_function("phase", phase, "angle")
        self.phase, self.magnitude = phase, magnitude

    @abstractmethod
    def intensity(self, sun: cp.Vector, observer: cp.Vector) -> Array:
        """The intensity () for directions in the frame of the body, without the factor `phase`."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return self(t, state)

    def __call__(self, t: Time, state: AnyState) -> Float[Array, ""]:
        if state.several:
            raise ValueError(
                f"{type(self).__name__} must have the state of one body, got a {type(state).__name__}; for body i "
                "write lambda t, state: brightness(t, state.of_body(i))."
            )
        directions = ("sun", self.sun), ("observer", self.observer)
        sun, observer = (seen_from_body(name, direction, t, state) for name, direction in directions)
        total = self.intensity(sun, observer)
        if self.phase is not None:
            total = total * self.phase(jnp.arctan2(cp.norm(cp.cross(sun, observer)), cp.dot(sun, observer)))
        return -2.5 * jnp.log10(total) if self.magnitude else total


class Brightness(Light):
    """The brightness of a surface: the sum of area albedo law over the facets that are lit and visible.

    It is an area times the albedo, up to the solar flux and the distances. Facets shadow and hide each other after
    `surface.with_shadows()`; otherwise the sum is exact for convex surfaces, and others give a warning. It is called as
    `brightness(t, state)`, and can be passed as `observe`. Derivatives are correct where facets rotate into the dark.

    Attributes:
        surface: the facets, in the frame of the body.
        sun: direction from the body to the Sun, space frame, a unit vector (3,); or a function `sun(t) -> (3,)`, whose
            vector is normalised, such as a position relative to the body.
        observer: direction to the observer, in the same forms. With a light travel time, t is the time at the body.
        law: a `Scattering`, such as `Lambert()` or `LommelSeeliger(lambert=0.1)`.
        albedo: () or one per facet, (n,), not negative.
        phase: None, or a factor as a function of the phase angle in radians, `phase(angle) -> ()`.
        magnitude: whether the result is -2.5 log10 of the brightness; it is infinite where nothing is visible.

    Raises:
        ValueError: the surface is no `Surface`, a direction is no unit vector, the law cannot be called, or an albedo
            is negative. When called: the numbers of albedos and facets differ, or the state has no attitude.

    Examples:
        >>> cube = ml.Surface.box([2.0, 2.0, 2.0])
        >>> law = ml.asteroids.Lambert()
        >>> light = ml.asteroids.Brightness(cube, sun=[1.0, 0.0, 0.0], observer=[0.6, 0.8, 0.0], law=law)
        >>> state = ml.RigidState([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0])
        >>> round(float(light(0.0, state)), 6)  # the Sun lights one face, area 4, seen with mu = 0.6; mu0 = 1
        2.4
    """

    surface: Surface
    law: Callable[[Array, Array], Array]
    albedo: Float[Array, "*batch"]

    def __init__(
        self,
        surface: Any,
        sun: Any,
        observer: Any,
        law: Any,
        *,
        albedo: Any = 1.0,
        phase: Any = None,
        magnitude: bool = False,
    ):
        self.surface = as_lit_surface(surface)
        self._view(sun, observer, phase, magnitude)
        if isinstance(law, type):
            raise ValueError(f"law must be a law and not its class: write {law.__name__}().")
        require_function("law", law, "mu, mu0")
        self.law, self.albedo = law, as_not_negative("albedo", albedo, cure="0 is black.")

    def intensity(self, sun: cp.Vector, observer: cp.Vector) -> Array:
        surface = self.surface
        weights = surface.areas * of_facets("albedo", self.albedo, surface).astype(surface.areas.dtype)
        columns, tables = with_horizon((*cp.vector(surface.normals), weights), surface)
        return sum_over_rows(lambda row, ways: _seen(self.law, row, *ways), columns, (sun, observer), tables)


def _seen(law: Callable[[Array, Array], Array], row: Any, sun: cp.Vector, observer: cp.Vector) -> Array:
    mu0, mu = cp.dot(row[0:3], sun), cp.dot(row[0:3], observer)
    seen = (mu > 0) & (mu0 > 0)
    # The law is not called in the dark, where it may be 0/0 and the derivative of `where` would be NaN.
    one = jnp.ones_like(mu)
    value = law(jnp.where(seen, mu, one), jnp.where(seen, mu0, one)) * unshadowed(row, 4, sun, observer)
    return jnp.where(seen, row[3] * value, jnp.zeros_like(value))


_NONE = 1e-30  # the square of a sine below this counts as zero


class EllipsoidBrightness(Light):
    """The brightness of a sunlit ellipsoid for the Lommel-Seeliger law, in closed form.

    It needs the run time of a few facets, and is smooth. For a sum over facets the derivative jumps where a facet
    rotates into the dark. A fit then takes more steps, and its intervals are too narrow if there are few facets.

    With s and o, the directions of Sun and observer divided by the semi-axes, component by component, and v = s + o,
    the brightness is pi/2 a b c |s| |o| / |v| (cos l + cos m + sin l sin m ln(tan(l/2) tan(m/2))), where l and m are
    the angles from v to s and to o (K. Muinonen, K. Lumme, Astron. Astrophys. 584 (2015) A23). Relative to the
    brightness seen from the Sun it is accurate to rounding; opposite to the Sun, to the power 2/3 of rounding.

    Attributes:
        semi_axes: along the axes of the body frame, (3,), length, positive.
        sun, observer, phase, magnitude: as for `Brightness`.

    Raises:
        ValueError: the semi-axes are not positive or have another shape, or a direction is no unit vector.

    Examples:
        >>> light = ml.asteroids.EllipsoidBrightness([3.0, 2.0, 1.0], sun=[1.0, 0.0, 0.0], observer=[0.0, 1.0, 0.0])
        >>> round(float(light(0.0, ml.RigidState([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]))), 4)
        1.4293
    """

    semi_axes: Float[Array, "*batch 3"]

    def __init__(self, semi_axes: Any, sun: Any, observer: Any, *, phase: Any = None, magnitude: bool = False):
        self.semi_axes = as_positive("semi_axes", semi_axes, (3,), cure="check their units.")
        self._view(sun, observer, phase, magnitude)

    def intensity(self, sun: cp.Vector, observer: cp.Vector) -> Array:
        # Without angles, because |s x v| = |o x v| = |s x o|; in powers of two, so that squares of inverse axes stay
        # within the dtype.
        axes = cp.vector(self.semi_axes)
        length, per_length = unit(cp.largest(axes))
        a, b, c = cp.scale(per_length, axes)
        s, o = ((x / a, y / b, z / c) for x, y, z in (sun, observer))
        v, across = cp.add(s, o), cp.cross(s, o)
        s2, o2, v2, square = (cp.dot(u, u) for u in (s, o, v, across))
        # Opposite to the Sun the bright edge is thinner than the rounding error of v; there it counts as dark.
        apart = v2 > s2 * float(jnp.finfo(v2.dtype).eps) ** (2 / 3)
        v2 = jnp.where(apart, v2, jnp.ones_like(v2))
        sizes, dots = (jnp.sqrt(s2 * v2), jnp.sqrt(o2 * v2)), (cp.dot(s, v), cp.dot(o, v))
        # On the line through both directions the logarithm is infinite, but not its product with |s x o|^2.
        bent = apart & (square > _NONE * s2 * o2)
        one = jnp.ones_like(square)
        product = jnp.where((dots[0] < 0) | (dots[1] < 0), one, square)
        for size, dot in zip(sizes, dots, strict=True):
            # tan(l/2) without cancellation, up to the factor |s x o| or its inverse. Only one angle can be obtuse.
            product = product * jnp.where(dot < 0, size - dot, 1 / jnp.where(bent, size + jnp.abs(dot), one))
        logarithm = jnp.log(jnp.where(bent, product, one))
        cosines = jnp.sqrt(o2) * dots[0] + jnp.sqrt(s2) * dots[1]
        return length * (np.pi / 2 * a * b * c / v2 * (cosines + square / jnp.sqrt(v2) * logarithm)) * length


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
        specular, diffuse, thermal = (
            of_facets(name, getattr(self, name), surface) for name in ("specular", "diffuse", "thermal")
        )
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
