"""`Wrench`: a torque and a force together, for a body that also translates."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats


class Wrench(eqx.Module):
    """A torque in the body frame and a force in the space frame: the value of a torque function for a `FreeState`.

    Wrenches add; an array added to a wrench is a torque. For a `FreeAxisState` the torque is in the space frame.

    Attributes:
        torque: about the centre of mass, body frame, (..., 3).
        force: space frame, (..., 3).

    Raises:
        ValueError: wrong shapes or dtypes.

    Examples:
        >>> def engine(t, state):
        ...     force = ml.so3.rotate(state.attitude, jnp.array([0.0, 0.0, 2.0]))
        ...     return ml.torques.Wrench(torque=jnp.zeros(3), force=force)
        >>> upside_down = ml.FreeState([0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
        >>> engine(0.0, upside_down).force[2]
        Array(-2., dtype=float64)
    """

    torque: Float[Array, "*batch 3"]
    force: Float[Array, "*batch 3"]
    __array_ufunc__: ClassVar[None] = None  # so that NumPy arrays leave the sum to `__radd__`

    def __init__(self, torque: Any, force: Any):
        self.torque, self.force = as_floats("torque", torque, (3,)), as_floats("force", force, (3,))

    @classmethod
    def of(cls, value: Any) -> "Wrench":
        """A wrench unchanged; an array as a torque without a force."""
        return value if isinstance(value, Wrench) else cls(jnp.asarray(value), jnp.zeros_like(value))

    def __add__(self, other: Any) -> "Wrench":
        other = Wrench.of(other)
        return Wrench(self.torque + other.torque, self.force + other.force)

    __radd__ = __add__
