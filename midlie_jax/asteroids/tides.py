"""`SolarTide`, the tide of the Sun on the bodies of a binary, and `TidalDissipation`, friction by mutual tides."""

from collections.abc import Callable
from itertools import permutations
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_not_negative, as_positive, vector_at
from .._math import components as cp
from ..model.free_body import Wrench
from ..model.orbits import Orbit
from ..model.orbits.base import check_units
from ..model.state import AnyState, Time, require_all_directions
from ..model.torques.reads_body import ReadsBody
from ..model.torques.travel import G_TIMES_MASS, travelling
from .mutual_gravity import require_coupled


class SolarTide(ReadsBody):
    """The tide of a distant mass, such as the Sun, on a body near the origin: force and torque.

    The origin is in free fall on the orbit, such as the barycentre of a binary. With u the direction of the distant
    mass, d its distance and x the position of the body, the force is m mu/d^3 (3 u (u . x) - x) and the torque 3
    mu/d^3 u x I u (G. W. Hill, Am. J. Math. 1 (1878) 5; Hughes, Spacecraft Attitude Dynamics, section 8.1). Terms of
    relative order x/d are left out. For several bodies write `OnEach(SolarTide(orbit, mu))`.

    Attributes:
        orbit: the position of the origin relative to the distant mass, or the other way round, `orbit(t) -> (3,)`,
            space frame, length.
        mu: gravitational parameter of the distant mass, (), length^3/time^2; of the Sun 1.32712440018e20 m^3/s^2.

    Raises:
        ValueError: mu not positive and finite, or an orbit of this package whose speeds do not fit mu. When called:
            body and state do not translate.

    Examples:
        >>> orbit = ml.orbits.CircularOrbit([1.5e11, 0.0, 0.0], [0.0, 1.0, 0.0], 1.327e20)
        >>> tide = ml.asteroids.SolarTide(orbit, 1.327e20)
        >>> body = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), mass=2.0)
        >>> state = ml.FreeState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1e3, 0.0, 0.0])
        >>> round(1e12 * float(tide.on(body)(0.0, state).force[0]), 4)  # 2 m mu/d^3 x
        157.2741
    """

    orbit: Orbit | Callable[[Any], Array]
    mu: Float[Array, "*batch"]

    def __init__(self, orbit: Orbit | Callable[[Any], Array], mu: Any):
        self.orbit, self.mu = orbit, as_positive("mu", mu, cure=G_TIMES_MASS)
        check_units(orbit, self.mu)

    @property
    def gravitational(self) -> bool:
        return True

    def _local(self, t: Time) -> tuple[Array, cp.Vector]:
        """mu/d^3 and u."""
        way = cp.vector(vector_at("orbit", self.orbit, t))
        inverse = cp.inverse_root(cp.dot(way, way))
        return self.mu * inverse * inverse * inverse, cp.scale(inverse, way)

    def at(self, t: Time, state: AnyState, body: Any) -> Wrench:
        moving, body = travelling(self, state, body)
        strength, u = self._local(t)
        x = cp.vector(moving.position)
        force = cp.scale(body.mass * strength, cp.subtract(cp.scale(3 * cp.dot(u, x), u), x))
        seen = require_all_directions(moving).seen_from_body(u)
        torque = cp.cross(seen, cp.vector(body.body.momentum(cp.pack(seen))))
        return Wrench(cp.pack(cp.scale(3 * strength, torque)), cp.pack(force))

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        moving, body = travelling(self, state, body)
        strength, u = self._local(t)
        x, seen = cp.vector(moving.position), require_all_directions(moving).seen_from_body(u)
        along = cp.dot(u, x)
        turn = 3 * cp.dot(seen, cp.vector(body.body.momentum(cp.pack(seen)))) - body.trace
        return strength / 2 * (turn - body.mass * (3 * along * along - cp.dot(x, x)))


class TidalDissipation(ReadsBody):
    """The friction of the tides that coupled bodies raise on each other, with a constant time lag.

    A body of radius R and Love number k, whose bulge lags by the time tau, exerts on another of mass m at r = r u,
    which moves with v relative to it, the force

        -3 k tau G m^2 R^5/r^8 (2 u (u . v) + v + r x Omega)

    (F. Mignard, Moon and Planets 20 (1979) 301; P. Hut, Astron. Astrophys. 99 (1981) 126). The reaction acts on the
    body itself, with the torque -r x force. Both momenta are conserved to rounding and energy decreases. Add it to
    `MutualGravity`. The bulge without lag, a small central force, is left out.

    Attributes:
        G: the gravitational constant, (), length^3 / (mass time^2).
        lag: k tau of each body, (N,), or () for all, time. A quality factor Q at the spin rate w and the orbital rate n
            means k/(2 Q |w - n|).
        radius: of each body, (N,), or () for all, length.

    Raises:
        ValueError: G or radius not positive, or lag negative. When called: body and state are not coupled bodies that
            translate, or their number differs.

    Examples:
        >>> pair = ml.FreeBody(ml.RigidBody([[0.4, 0.4, 0.4], [0.004, 0.004, 0.004]]), mass=[1.0, 0.01])
        >>> friction = ml.asteroids.TidalDissipation(1.0, lag=[0.01, 0.0], radius=[1.0, 0.2])
        >>> spin, upright, still = [[0.0, 0.0, 0.4], [0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0, 0.0]] * 2, jnp.zeros((2, 3))
        >>> state = ml.CoupledState(spin, upright, linear=still, position=[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
        >>> round(2**6 * float(friction.on(pair)(0.0, state).torque[0, 2]), 12)  # slows the spin
        -3e-06
    """

    G: Float[Array, "*batch"]
    lag: Float[Array, "*batch"]
    radius: Float[Array, "*batch"]

    def __init__(self, G: Any, lag: Any, radius: Any):
        self.G = as_positive("G", G)  # pyright: ignore[reportConstantRedefinition]
        self.lag, self.radius = as_not_negative("lag", lag, cure="0 is elastic."), as_positive("radius", radius)

    @property
    def velocity_dependent(self) -> bool:
        return True

    @property
    def keeps_total_momentum(self) -> bool:
        return True

    def at(self, t: Time, state: AnyState, body: Any) -> Wrench:
        state, body = require_coupled(self, state, body)
        n = state.count
        lags, radii = (self._each(name, n) for name in ("lag", "radius"))
        bodies = [jax.tree.map(lambda x, i=i: x[i], body) if body.batch else body for i in range(n)]
        attitudes = [cp.quaternion(state.attitude[i]) for i in range(n)]
        places = [cp.vector(state.position[i]) for i in range(n)]
        speeds = [cp.scale(1 / one.mass, cp.vector(state.linear[i])) for i, one in enumerate(bodies)]
        spins = [cp.rotate(attitudes[i], cp.vector(bodies[i].body.velocity(state.momentum[i]))) for i in range(n)]
        zero = jnp.zeros_like(state.position[0, 0])
        torques: list[cp.Vector] = [(zero, zero, zero)] * n
        forces = list(torques)
        for i, j in permutations(range(n), 2):  # the bulge of i, raised by j
            way = cp.subtract(places[j], places[i])
            inverse = cp.inverse_root(cp.dot(way, way))
            u, v = cp.scale(inverse, way), cp.subtract(speeds[j], speeds[i])
            size, mass = radii[i] * inverse, bodies[j].mass
            # The mass comes last: its square, or a force where a torque is representable, may be out of range.
            strength = -3 * lags[i] * (self.G * mass * inverse) * inverse * inverse * size**5
            along = cp.scale(2 * cp.dot(u, v), u)
            push = cp.scale(strength, cp.add(along, cp.add(v, cp.cross(way, spins[i]))))
            force = cp.scale(mass, push)
            forces[j], forces[i] = cp.add(forces[j], force), cp.subtract(forces[i], force)
            torques[i] = cp.subtract(torques[i], cp.scale(mass, cp.cross(way, push)))
        own = [cp.pack(cp.rotate_back(q, torque)) for q, torque in zip(attitudes, torques, strict=True)]
        return Wrench(jnp.stack(own), jnp.stack([*map(cp.pack, forces)]))

    def _each(self, name: str, count: int) -> Array:
        value = getattr(self, name)
        if value.shape not in ((), (count,)):
            raise ValueError(f"{name} must be () or ({count},), one for each body, got {value.shape}.")
        return jnp.broadcast_to(value, (count,))
