"""Step densities: they shorten the steps of `integrate_variable_step` where the motion is fast.

A density is any callable `density(t, state) -> ()` that is positive and smooth; the step is `dt / density`. The
densities in this module are 1, or about 1, at a reference value that you choose, so `dt` is the step at that value. A
density should change little within a step and follow the time scale of the motion; it need not estimate the error.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, as_positive, vector_at
from .._math import components as cp
from .state import AnyState, Time
from .torques import TorqueLike

DensityLike = Callable[[Any, Any], Array]


class OrbitalDistance(eqx.Module):
    """((reference / r)^(4 power) + 1 / longest^4)^(1/4), where r is the distance of an orbit from its centre.

    With the default power 3/2 the step is proportional to r^(3/2), as are the time scales of free fall and of rotation
    by the gravity gradient. Far out the rotation of the body sets the time scale.

    Attributes:
        orbit: `orbit(t) -> (3,)`, length, such as `midlie_jax.orbits.KeplerOrbit`.
        reference: the distance at which the density is 1, (), length, positive.
        power: exponent, a static Python float.
        longest: the longest step, far out, in steps at the reference, (), positive.

    Examples:
        >>> orbit = ml.orbits.KeplerOrbit(position=[1.0, 0.0, 0.0], velocity=[0.0, 1.3, 0.0], mu=1.0)
        >>> density = ml.densities.OrbitalDistance(orbit, reference=1.0)  # for ml.integrate_variable_step
        >>> round(float(density(10.0, start)), 4)  # steps are longer far out
        0.1037
    """

    orbit: Callable[[Any], Array]
    reference: Float[Array, "*batch"]
    power: float = eqx.field(static=True)
    longest: Float[Array, "*batch"]

    def __init__(self, orbit: Callable[[Any], Array], reference: Any, power: float = 1.5, longest: Any = 16.0):
        self.orbit = orbit
        self.reference = as_positive("reference", reference)
        self.power = float(power)
        self.longest = as_positive("longest", longest)

    def __call__(self, t: Time, state: AnyState) -> Array:
        position = cp.vector(vector_at("orbit", self.orbit, t))
        x, y, z = (p / self.reference for p in position)
        nearness = 1 / (x * x + y * y + z * z)
        slowest = 1 / (self.longest * self.longest)
        return _power(_power(nearness, 2 * self.power) + slowest * slowest, 0.25)


class TorqueSize(eqx.Module):
    """((|T|^2 + floor^2) / reference^2)^(power / 2), where T is a torque.

    With the default power 1/2 the density is proportional to sqrt(|T|), as is sqrt(|T| / I), the rate at which a torque
    rotates a body with moment of inertia I from rest.

    Attributes:
        torque: `torque(t, state) -> (3,)`, the torque of the run or any other.
        reference: the torque at which the density is about 1, (), positive.
        floor: a positive torque, (); it keeps the step bounded and the density smooth where the torque vanishes.
        power: exponent, a static Python float.

    Examples:
        >>> density = ml.densities.TorqueSize(torque, reference=2.0, floor=0.1)
        >>> round(float(density(0.0, start)), 4)
        1.7192
    """

    torque: TorqueLike
    reference: Float[Array, "*batch"]
    floor: Float[Array, "*batch"]
    power: float = eqx.field(static=True)

    def __init__(self, torque: TorqueLike, reference: Any, floor: Any, power: float = 0.5):
        self.torque = torque
        self.reference = as_positive("reference", reference)
        self.floor = as_positive("floor", floor)
        self.power = float(power)

    def __call__(self, t: Time, state: AnyState) -> Array:
        # Divided first, because squared torques on small particles are below the range of float32.
        x, y, z = (torque / self.reference for torque in cp.vector(self.torque(t, state)))
        floor = self.floor / self.reference
        return _power(x * x + y * y + z * z + floor * floor, self.power / 2)


class Spin(eqx.Module):
    """sqrt((|Omega|^2 + floor^2) / reference^2), Omega the angular velocity: all steps rotate by similar angles.

    Attributes:
        moments: principal moments of a `RigidBody`, (3,). Not for a `TensorBody`, whose states use other axes.
        reference: the angular velocity at which the density is about 1, (), positive.
        floor: as for `TorqueSize`, an angular velocity, ().

    Examples:
        >>> density = ml.densities.Spin(moments=[5.0, 5.0, 1.0], reference=10.0, floor=0.1)
        >>> round(float(density(0.0, start)), 3)  # steps 5 times shorter than at the reference
        5.0
    """

    moments: Float[Array, "*batch 3"]
    reference: Float[Array, "*batch"]
    floor: Float[Array, "*batch"]

    def __init__(self, moments: Any, reference: Any, floor: Any):
        self.moments = as_floats("moments", moments, (3,))
        self.reference = as_positive("reference", reference)
        self.floor = as_positive("floor", floor)

    def __call__(self, t: Time, state: AnyState) -> Array:
        momentum, moments = cp.vector(state.momentum), cp.vector(self.moments)
        x, y, z = (p / i / self.reference for p, i in zip(momentum, moments, strict=True))
        floor = self.floor / self.reference
        return jnp.sqrt(x * x + y * y + z * z + floor * floor)


def _power(x: Array, exponent: float) -> Array:
    """x^exponent for x > 0, by products or square roots if possible, which are several times faster."""
    if exponent in (1, 2, 3, 4):
        return jax.lax.integer_pow(x, int(exponent))
    quarters = 4 * exponent
    if quarters not in (1, 2, 3):
        return x**exponent
    root = jnp.sqrt(x)
    return root if quarters == 2 else jnp.sqrt(root) if quarters == 1 else root * jnp.sqrt(root)
