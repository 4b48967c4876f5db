"""Step densities: where a motion wants its steps close, for `integrate_adaptive`.

A density is any callable `density(t, state) -> ()`, positive and smooth: the steps are `dt / density`. Those here are 1
at a reference that is given with them, so that `dt` is the step there. A density should change little in a step, and
follow the scale of time of the motion rather than its error: a step control needs no more.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._kernel import components as cp
from .._kernel.checks import as_floats, require
from .torques import TorqueLike

DensityLike = Callable[[Any, Any], Array]


def _positive(name: str, value: Any) -> Array:
    array = as_floats(name, value)
    require(name, array, lambda x: (x > 0) & np.isfinite(x), "must be positive and finite", "densities are relative.")
    return array


class OrbitalDistance(eqx.Module):
    """(reference / r)^power, r the distance of an orbit from its centre.

    The power 3/2 is that of every time in the problem, free fall and gravity gradient alike.

    Attributes:
        orbit: `orbit(t) -> (3,)`, such as `midlie_jax.orbits.KeplerOrbit`.
        reference: the distance at which the density is 1, ().
        power: static.
    """

    orbit: Callable[[Any], Array]
    reference: Float[Array, "*batch"]
    power: float = eqx.field(static=True)

    def __init__(self, orbit: Callable[[Any], Array], reference: Any, power: float = 1.5):
        self.orbit = orbit
        self.reference = _positive("reference", reference)
        self.power = float(power)

    def __call__(self, t: Any, state: Any) -> Array:
        del state
        place = cp.vector(self.orbit(t))
        return _power(self.reference * self.reference / cp.dot(place, place), self.power / 2)


class TorqueSize(eqx.Module):
    """((|T|^2 + floor^2) / reference^2)^(power / 2), T a torque.

    The power 1/2 is that of a rate: sqrt(|T| / I) is how fast a torque turns a body that it finds at rest.

    Attributes:
        torque: `torque(t, state) -> (3,)`, the one that acts or another.
        reference: the torque at which the density is about 1, ().
        floor: added so that the step stays bounded, and the density smooth, where the torque vanishes, ().
        power: static.
    """

    torque: TorqueLike
    reference: Float[Array, "*batch"]
    floor: Float[Array, "*batch"]
    power: float = eqx.field(static=True)

    def __init__(self, torque: TorqueLike, reference: Any, floor: Any, power: float = 0.5):
        self.torque = torque
        self.reference = _positive("reference", reference)
        self.floor = _positive("floor", floor)
        self.power = float(power)

    def __call__(self, t: Any, state: Any) -> Array:
        torque = cp.vector(self.torque(t, state))
        square = cp.dot(torque, torque) + self.floor * self.floor
        return _power(square / (self.reference * self.reference), self.power / 2)


class Spin(eqx.Module):
    """sqrt((|Omega|^2 + floor^2) / reference^2), Omega the angular velocity: steps of like angles.

    Attributes:
        moments: principal moments of a `RigidBody`, (3,); the states of a `TensorBody` are in other axes.
        reference: the angular velocity at which the density is about 1, ().
        floor: added so that the step stays bounded, and the density smooth, where the body rests, ().
    """

    moments: Float[Array, "*batch 3"]
    reference: Float[Array, "*batch"]
    floor: Float[Array, "*batch"]

    def __init__(self, moments: Any, reference: Any, floor: Any):
        self.moments = as_floats("moments", moments, (3,))
        self.reference = _positive("reference", reference)
        self.floor = _positive("floor", floor)

    def __call__(self, t: Any, state: Any) -> Array:
        del t
        momentum, moments = cp.vector(state.momentum), cp.vector(self.moments)
        x, y, z = (p / i for p, i in zip(momentum, moments, strict=True))
        return jnp.sqrt(x * x + y * y + z * z + self.floor * self.floor) / self.reference


def _power(x: Array, exponent: float) -> Array:
    """x^exponent for x > 0: by square roots where they do, several times cheaper than a power."""
    quarters = 4 * exponent
    if quarters not in (1, 2, 3):
        return x**exponent
    root = jnp.sqrt(x)
    return root if quarters == 2 else jnp.sqrt(root) if quarters == 1 else root * jnp.sqrt(root)
