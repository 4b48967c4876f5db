"""A circular orbit, and the magnetic field of a dipole along an orbit."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_positive, require_rows, shown, vector_at
from ..._math import components as cp
from ..._math.powers import unit
from .base import Orbit, Units


class CircularOrbit(Orbit):
    """A circular orbit about the origin.

    Attributes:
        across: the position a quarter of a period later, (3,), length.
        rate: angular velocity sqrt(mu/r^3), (), radians per unit of time.

    Args:
        position: the position at t = 0, (3,), length.
        direction: the direction of motion at t = 0, (3,); only its part perpendicular to `position` counts.
        mu: gravitational parameter, (), length^3/time^2.

    Raises:
        ValueError: wrong shapes, numbers that are not finite, a position at the origin, a direction along the position,
            or mu not positive.

    Examples:
        >>> orbit = ml.orbits.CircularOrbit(position=[7000.0, 0.0, 0.0], direction=[0.0, 1.0, 0.0], mu=3.986e5)  # km, s
        >>> round(2 * np.pi / float(orbit.rate) / 60, 2)  # period in minutes
        97.14
    """

    position: Float[Array, "*batch 3"]
    across: Float[Array, "*batch 3"]
    rate: Float[Array, "*batch"]

    def __init__(self, position: Any, direction: Any, mu: Any):
        self.position = as_finite("position", position, (3,))
        direction = as_finite("direction", direction, (3,))
        mu = as_positive("mu", mu)
        require_rows("position", self.position, lambda x: np.any(x != 0, axis=-1), "must not be the centre", "move it.")
        dtype = jnp.result_type(self.position, mu)
        units = Units.of(cp.vector(self.position.astype(dtype)), mu.astype(dtype))
        place = self.position * units.per_length[..., None]
        direction = direction * unit(jnp.max(jnp.abs(direction), axis=-1, keepdims=True))[1]
        square = jnp.sum(place**2, axis=-1, keepdims=True)
        along = direction - place * (jnp.sum(direction * place, axis=-1, keepdims=True) / square)
        if not cp.is_traced(along):
            least = 16 * jnp.finfo(along.dtype).eps * jnp.linalg.norm(direction, axis=-1)
            if not bool(jnp.all(jnp.linalg.norm(along, axis=-1) > least)):
                raise ValueError(
                    f"direction must have a part perpendicular to position, got {shown(direction)}; change it."
                )
        across = along * jnp.sqrt(square / jnp.sum(along**2, axis=-1, keepdims=True))
        self.across = across * units.length[..., None]
        self.rate = jnp.sqrt(units.of_mu * mu / square[..., 0] ** 1.5) * units.per_time

    def known(self) -> tuple[Array, Array]:
        return self.position, self.across * self.rate[..., None]

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        angle = self.rate * t
        c, s = jnp.cos(angle), jnp.sin(angle)
        return cp.pack(cp.add(cp.scale(c, cp.vector(self.position)), cp.scale(s, cp.vector(self.across))))


class DipoleField(eqx.Module):
    """The field of a magnetic dipole at the origin, along an orbit: B = (mu_0 / 4 pi r^3) (3 (m . e) e - m), e = r/|r|.

    `field(t) -> (3,)`, space frame; in T with the default `constant`, lengths in m and the moment in A m^2. For the
    Earth, the moment is (-3.75e21, 1.203e22, -7.605e22) A m^2 in an Earth-fixed frame, 7.7e22 A m^2 to the south with a
    tilt of 9.4 degrees (P. Alken and others, Earth Planets Space 73 (2021) 49), and rotates at 7.292115e-5 rad/s.

    Attributes:
        orbit: the position in the space frame, `orbit(t) -> (3,)`, length.
        moment: dipole moment m in the space frame, at t = 0 if it rotates, (3,).
        constant: mu_0 / 4 pi in the units of the problem, (); 1e-7 T m/A in SI units.
        turning: rate of rotation of the moment about the space z axis, (), radians per unit of time, positive to the
            east; None for a moment fixed in space.

    Examples:
        >>> orbit = ml.orbits.CircularOrbit(position=[7e6, 0.0, 0.0], direction=[0.0, 0.0, 1.0], mu=3.986e14)  # m, s
        >>> field = ml.orbits.DipoleField(orbit, moment=[0.0, 0.0, -7.7e22])  # of the Earth, without the tilt
        >>> round(1e6 * float(field(0.0)[2]), 3)  # microtesla to the north, above the equator
        22.449
    """

    orbit: Callable[[Any], Array]
    moment: Float[Array, "*batch 3"]
    constant: Float[Array, "*batch"]
    turning: Float[Array, "*batch"] | None

    def __init__(self, orbit: Callable[[Any], Array], moment: Any, constant: Any = 1e-7, turning: Any = None):
        self.orbit = orbit
        self.moment = as_finite("moment", moment, (3,))
        self.constant = as_finite("constant", constant)
        self.turning = None if turning is None else as_finite("turning", turning)

    def __call__(self, t: Any) -> Float[Array, "*batch 3"]:
        position, moment = cp.vector(vector_at("orbit", self.orbit, t)), cp.vector(self.moment)
        if self.turning is not None:
            x, y, z = moment
            c, s = jnp.cos(self.turning * t), jnp.sin(self.turning * t)
            moment = c * x - s * y, s * x + c * y, z
        inverse = 1 / jnp.sqrt(cp.dot(position, position))
        e, moment = cp.scale(inverse, position), cp.scale(self.constant * inverse, moment)
        field = cp.subtract(cp.scale(3 * cp.dot(moment, e), e), moment)
        return cp.pack(cp.scale(inverse, cp.scale(inverse, field)))
