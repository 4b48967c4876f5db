"""`SpinState`: unit vectors on a lattice."""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, is_unit, require, require_finite
from ..._math import components as cp
from ..._xla.fusion import split
from ..bodies import Body
from ..spins import Spins
from ..state import Described, State
from .without_pose import WithoutPose


class SpinState(WithoutPose, State[cp.Vector, tuple[()]]):
    """Classical spins: three numbers each, no attitude.

    The axes before the last one are the lattice: (3,) is one spin, (n, 3) a chain or n spins without a lattice, (n, m,
    3) and (n, m, l, 3) are lattices of two and three dimensions.

    Attributes:
        spin: unit vectors S, space frame, (*lattice, 3).

    Raises:
        ValueError: not of shape (..., 3), or not unit vectors.

    Examples:
        >>> lattice = ml.SpinState(jnp.tile(jnp.array([0.0, 0.0, 1.0]), (4, 4, 1)))
        >>> ml.energy(ml.Spins(), ml.torques.Exchange(1.0), lattice)  # -1 for each of 32 bonds
        Array(-32., dtype=float64)
    """

    spin: Float[Array, "*lattice 3"]
    body: ClassVar[type] = Spins
    own_axes: ClassVar[int] = 0  # the lattice can have any number of axes, so none is known to be a batch
    momenta: ClassVar[tuple[str, ...]] = ()  # a field that reads the spins is not friction

    def __init__(self, spin: Any):
        self.spin = as_floats("spin", spin, (3,))
        require_finite("spin", self.spin)
        require(
            "spin",
            self.spin,
            is_unit,
            "must be unit vectors",
            "divide it by its norm, and put its magnitude into the coefficients of the energy.",
        )

    def check_batch(self) -> None:
        if 0 in self.spin.shape:
            raise ValueError(
                f"spin must hold at least one spin, got shape {self.spin.shape}; give no axis the length 0."
            )

    @property
    def momentum(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The spin, which a run integrates like the momentum of a body."""
        return self.spin

    def parts(self) -> tuple[cp.Vector, tuple[()]]:
        return cp.vector(self.spin), ()

    @classmethod
    def join(cls, momentum: cp.Vector, pose: tuple[()]) -> "SpinState":
        del pose
        return cls.unchecked(spin=cp.pack(momentum))

    @staticmethod
    def momentum_rate(momentum: cp.Vector, velocity: cp.Vector, force: cp.Vector) -> cp.Vector:
        del velocity
        return cp.cross(force, momentum)

    @classmethod
    def rates(
        cls, inertia: Spins, h: Array, momentum: cp.Vector, pose: tuple[()], force: cp.Vector | None
    ) -> tuple[cp.Vector, tuple[()]]:
        return (cp.scale(0, momentum) if force is None else inertia.change(h, momentum, force)), pose

    @classmethod
    def evaluate(
        cls, function: Callable[[Any, Any], Any], t: Array, momentum: cp.Vector, pose: tuple[()]
    ) -> tuple[Any, Any]:
        # If fused with its reader, the field of a lattice would be computed again for each number that reads it.
        lattice = momentum[0].ndim > 0
        momentum = split(momentum) if lattice else momentum
        value = jax.tree.map(jnp.asarray, function(t, cls.join(momentum, pose)))
        entries = jax.tree.map(lambda x: cp.unpacked(x) if x.ndim else (x,), value)
        return split(entries) if lattice else entries, jax.tree.map(
            lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), value
        )

    @classmethod
    def force_from(cls, potential: Callable[[Any], Array], state: Any) -> Array:
        return -jax.grad(lambda spin: potential(cls.unchecked(spin=spin)))(state.spin)

    def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
        raise ValueError(
            "a SpinState has no body frame for a torque; give a field, such as midlie_jax.torques.AppliedField."
        )

    def normalised(self) -> "SpinState":
        return self.unchecked(spin=self.spin / jnp.linalg.norm(self.spin, axis=-1, keepdims=True))

    def batch_of(self, body: Body) -> tuple[int, ...]:
        del body
        return ()

    @classmethod
    def described(cls) -> Described:
        return {"spin": ((), {"long_name": "spin, a unit vector", "units": "1", "frame": "space"})}
