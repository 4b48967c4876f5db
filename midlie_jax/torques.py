"""Torques: any callable of (t, state) that returns the body-frame torque (3,), and the fields that scenes use.

The classes here are pytrees whose leaves are their parameters, so they can be mapped over and differentiated;
most know their potential, which is what `midlie_jax.energy` adds to the kinetic energy. `a + b` acts together.
Forces on particles are callables of the same kind, returning an array of the shape of the momentum.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from . import _components as cp
from .bodies import Particles, RigidBody, State, kinetic_energy
from .checks import as_floats, require, require_finite
from .orbits import Orbit

TorqueLike = Callable[[Any, Any], Array]


class Torque(eqx.Module):
    """A torque field; subclasses say whether it has a potential and whether it reads the momentum."""

    def __call__(self, t: Any, state: Any) -> Array:
        raise NotImplementedError(f"{type(self).__name__} must define __call__(t, state).")

    def potential(self, t: Any, state: Any) -> Array:
        """The potential energy, torque x angle; a ValueError where there is none."""
        del t, state
        raise ValueError(f"{type(self).__name__} has no potential energy; use midlie_jax.kinetic_energy instead.")

    @property
    def velocity_dependent(self) -> bool:
        return False

    def __add__(self, other: TorqueLike) -> "Sum":
        return Sum(self, other)


def velocity_dependent(torque: TorqueLike | None) -> bool:
    """Whether the torque was declared to read the momentum (`VelocityDependent`, or a sum holding one)."""
    return isinstance(torque, Torque) and torque.velocity_dependent


class Sum(Torque):
    """Several torques acting together.

    Attributes:
        terms: the torques, each a callable of (t, state).
    """

    terms: tuple[TorqueLike, ...]

    def __init__(self, *terms: TorqueLike):
        self.terms = terms

    def __call__(self, t: Any, state: Any) -> Array:
        return sum((term(t, state) for term in self.terms[1:]), start=self.terms[0](t, state))

    def potential(self, t: Any, state: Any) -> Array:
        parts = [_potential(term, t, state) for term in self.terms]
        return sum(parts[1:], start=parts[0])

    @property
    def velocity_dependent(self) -> bool:
        return any(velocity_dependent(term) for term in self.terms)


class HeavyTop(Torque):
    """A top in uniform gravity, V = weight * z of the tip: for axis e3, weight * (R e3)_z.

    Attributes:
        weight: m g l, the moment of the weight about the pivot at full lever, (): torque.
        axis: unit vector from the pivot to the centre of mass, in the body, a tuple of three numbers.
    """

    weight: Float[Array, "*batch"]
    axis: tuple[float, float, float] = eqx.field(static=True)

    def __init__(self, weight: Any, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)):
        self.weight = as_floats("weight", weight)
        require_finite("weight", self.weight)
        self.axis = (float(axis[0]), float(axis[1]), float(axis[2]))

    def __call__(self, t: Any, state: Any) -> Array:
        del t
        return cp.pack(cp.scale(self.weight, _cross_constant(state.vertical(), self.axis)))

    def potential(self, t: Any, state: Any) -> Array:
        del t
        up = state.vertical()
        return self.weight * (self.axis[0] * up[0] + self.axis[1] * up[1] + self.axis[2] * up[2])


class DipoleInField(Torque):
    """A dipole fixed in the body in a uniform field fixed in space, V = -moment . R^T field.

    Attributes:
        moment: dipole moment in the body, (3,).
        field: the field in space, (3,); moment x field is a torque.
    """

    moment: Float[Array, "*batch 3"]
    field: Float[Array, "*batch 3"]

    def __init__(self, moment: Any, field: Any):
        self.moment = as_floats("moment", moment, (3,))
        self.field = as_floats("field", field, (3,))
        require_finite("moment", self.moment)
        require_finite("field", self.field)

    def __call__(self, t: Any, state: Any) -> Array:
        del t
        return cp.pack(cp.cross(cp.unpack(self.moment), state.seen_from_body(cp.unpack(self.field))))

    def potential(self, t: Any, state: Any) -> Array:
        del t
        return -cp.dot(cp.unpack(self.moment), state.seen_from_body(cp.unpack(self.field)))


class GravityGradient(Torque):
    """The torque of a point mass's gravity on an orbiting body, 3 mu/r^3 u x I u with u = R^T r/|r|.

    Attributes:
        moments: principal moments of the body, (3,).
        orbit: the body's place seen from the attracting mass, `orbit(t) -> (3,)` in space; a
            `midlie_jax.orbits.CircularOrbit`, `KeplerOrbit`, or any callable.
        mu: gravitational parameter, length^3/time^2, ().

    To first order in body size over r (Hughes, Spacecraft Attitude Dynamics, section 8.1).
    """

    moments: Float[Array, "*batch 3"]
    orbit: Orbit | Callable[[Any], Array]
    mu: Float[Array, "*batch"]

    def __init__(self, moments: Any, orbit: Orbit | Callable[[Any], Array], mu: Any):
        self.moments = as_floats("moments", moments, (3,))
        self.orbit = orbit
        self.mu = as_floats("mu", mu)
        require("mu", self.mu, lambda m: m > 0, "must be positive", "it attracts.")

    def _local(self, t: Any, state: Any) -> tuple[Array, cp.Vector]:
        """3 mu/r^3 and u."""
        place = cp.unpack(self.orbit(t))
        square = cp.dot(place, place)
        inverse = 1 / jnp.sqrt(square)
        return 3 * self.mu * inverse / square, state.seen_from_body(cp.scale(inverse, place))

    def __call__(self, t: Any, state: Any) -> Array:
        strength, u = self._local(t, state)
        return cp.pack(cp.scale(strength, cp.cross(u, cp.times(cp.unpack(self.moments), u))))

    def potential(self, t: Any, state: Any) -> Array:
        """The part that depends on the attitude, (3 mu/2r^3) (u . I u - tr I / 3)."""
        strength, u = self._local(t, state)
        moments = cp.unpack(self.moments)
        return strength / 2 * (cp.dot(u, cp.times(moments, u)) - (moments[0] + moments[1] + moments[2]) / 3)


class Prescribed(Torque):
    """A body-frame torque given as a function of time alone.

    At a jump return the mean of both sides and let steps end there: second order is then kept.

    Attributes:
        function: `function(t) -> (3,)`; a pytree if it has parameters to differentiate.
    """

    function: Callable[[Any], Array]

    def __call__(self, t: Any, state: Any) -> Array:
        del state
        return self.function(t)


class FromPotential(Torque):
    """The torque, or the force on particles, of a potential energy, by automatic differentiation.

    Attributes:
        function: `function(t, state) -> ()`, the potential energy; differentiable in the state's pose.
            It may be written on arrays (`midlie_jax.so3.to_matrix` and so on).
    """

    function: Callable[[Any, Any], Array]

    def __call__(self, t: Any, state: Any) -> Array:
        kind = type(state)
        momentum, pose = state.parts()
        slope = jax.grad(lambda p: self.function(t, kind.join(momentum, p)))(pose)
        # dV/dt = slope . rate(pose, velocity) = -torque . velocity, and the rate is linear in velocity.
        (along,) = jax.linear_transpose(lambda velocity: kind.rate(pose, velocity), momentum)(slope)
        return jax.tree.map(jnp.negative, along) if isinstance(along, jax.Array) else -cp.pack(along)

    def potential(self, t: Any, state: Any) -> Array:
        return self.function(t, state)


class VelocityDependent(Torque):
    """A torque that reads the momentum: damping, control, a magnetic field on a moving charge.

    The kicks of the explicit methods then take two evaluations (the explicit midpoint rule in the momentum),
    which keeps order 2 for LIEMID[EA]; symplecticity and exact reversal do not apply to such torques. A run sees for
    itself whether a torque reads the momentum; this says so where there is no run to see it, as in
    `LieSolver.order` and `recommend`.

    Attributes:
        function: `function(t, state) -> (3,)`, body frame.
    """

    function: TorqueLike

    def __call__(self, t: Any, state: Any) -> Array:
        return self.function(t, state)

    @property
    def velocity_dependent(self) -> bool:
        return True


def energy(
    body: RigidBody | Particles, torque: TorqueLike | None, state: State, t: float | Array = 0.0
) -> Float[Array, "*batch"]:
    """Kinetic plus potential energy.

    Args:
        body, state: as for `integrate`; the state may carry leading batch axes.
        torque: None, or a torque with a potential.
        t: time, for fields that change.

    Returns:
        (...), the batch shape of the state.

    Raises:
        ValueError: the torque has no potential.
    """
    kinetic = kinetic_energy(body, state)
    return kinetic if torque is None else kinetic + _potential(torque, t, state)


def _potential(torque: TorqueLike, t: Any, state: Any) -> Array:
    if isinstance(torque, Torque):
        return torque.potential(t, state)
    raise ValueError(
        "a plain callable has no potential energy; give the potential to midlie_jax.torques.FromPotential, "
        "or use midlie_jax.kinetic_energy."
    )


def _cross_constant(a: cp.Vector, b: tuple[float, float, float]) -> cp.Vector:
    """a x b without the products by zero, which XLA must keep (they could be NaN)."""

    def minor(i: int, j: int) -> Array:
        total = jnp.zeros_like(a[0])
        if b[j]:
            total = a[i] * b[j]
        if b[i]:
            total = total - a[j] * b[i]
        return total

    return minor(1, 2), minor(2, 0), minor(0, 1)
