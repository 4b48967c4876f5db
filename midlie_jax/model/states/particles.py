"""`ParticleState`: momenta and positions, as arrays of any shape."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite
from ..bodies import Particles
from ..kind import Kind, Leaves
from ..leaf import Described, Flat
from ..state import State


class Positions(Flat):
    about: ClassVar[tuple[Described, ...]] = (
        ((), {"long_name": "linear momentum", "units": "mass length time-1", "frame": "space"}),
        ((), {"long_name": "position", "units": "length", "frame": "space"}),
    )

    @staticmethod
    def components(arrays: Any) -> Any:
        return arrays

    @staticmethod
    def packed(momentum: Array, pose: Array) -> tuple[Array, ...]:
        return momentum, pose


class OnArrays(Kind):
    def evaluate(self, function: Any, t: Array, momentum: Array, pose: Array) -> tuple[Any, Any]:
        value = function(t, self.join(momentum, pose))
        return value, jax.ShapeDtypeStruct(jnp.shape(value), jnp.result_type(value))


class ParticleState(State):
    """Positions and momenta of particles.

    Attributes:
        momentum: p, of any shape that fits the mass, such as (n,) or (n, 3).
        position: u, of the same shape.

    Examples:
        >>> def spring(t, state):
        ...     return -8.0 * state.position
        >>> ball, start = ml.Particles(2.0), ml.ParticleState(momentum=[0.0], position=[1.0])
        >>> ml.integrate("Verlet", ball, spring, start, dt=0.001, steps=1000).states.position[-1].round(4)  # cos(2)
        Array([-0.4161], dtype=float64)
    """

    momentum: Float[Array, "..."]
    position: Float[Array, "..."]
    body: ClassVar[type] = Particles
    leaves: ClassVar[Leaves] = (Positions,)
    own_axes: ClassVar[int] = 0  # the arrays can have any shape, so no axes are known to be a batch

    def __init__(self, momentum: Any, position: Any):
        self.momentum, self.position = as_finite("momentum", momentum), as_finite("position", position)
        if self.momentum.shape != self.position.shape:
            raise ValueError(f"momentum {self.momentum.shape} and position {self.position.shape} must have one shape.")

    @property
    def kind(self) -> Kind:
        return OnArrays(type(self), self.leaves)
