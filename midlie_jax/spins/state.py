"""`SpinState`: unit vectors on a lattice."""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, is_unit, require
from .._math import components as cp
from .._xla.fusion import split
from ..model.kind import Kind, Leaves
from ..model.leaf import Described, Flat, NoPose
from ..model.state import State
from .body import Spins


class Spin(Flat, NoPose):
    about: ClassVar[tuple[Described, ...]] = (
        ((), {"long_name": "spin, a unit vector", "units": "1", "frame": "space"}),
    )

    @staticmethod
    def momentum_rate(momentum: cp.Vector, velocity: cp.Vector, force: cp.Vector) -> cp.Vector:
        return cp.cross(force, momentum)

    @classmethod
    def rates(
        cls, inertia: Spins, h: Array, momentum: cp.Vector, pose: tuple[()], force: cp.Vector | None
    ) -> tuple[cp.Vector, tuple[()]]:
        return (cp.scale(0, momentum) if force is None else inertia.change(h, momentum, force)), pose

    @staticmethod
    def to_body(owner: Any, pose: tuple[()], vector: cp.Vector) -> cp.Vector:
        raise ValueError("a SpinState has no body frame for a torque; give a field, as in midlie_jax.spins.")

    @staticmethod
    def normalised(*arrays: Array) -> tuple[Array, ...]:
        (spin,) = arrays
        return (spin / jnp.linalg.norm(spin, axis=-1, keepdims=True),)


class OnLattice(Kind):
    constant_steps: ClassVar[str | None] = "spins"

    def check_shapes(self, shapes: dict[str, tuple[int, ...]]) -> None:
        if 0 in shapes["spin"]:
            raise ValueError(f"spin must hold at least one spin, got shape {shapes['spin']}; give no empty axis.")

    def batch_of(self, body: Any) -> tuple[int, ...]:
        return ()

    @property
    def momenta(self) -> tuple[str, ...]:
        """None: a field that reads the spins is not friction."""
        return ()

    def join(self, momentum: Any, pose: Any) -> "SpinState":
        (spin,) = self.packed(momentum, pose)
        return SpinState.unchecked(spin=spin)

    def evaluate(
        self, function: Callable[[Any, Any], Any], t: Array, momentum: cp.Vector, pose: tuple[()]
    ) -> tuple[Any, Any]:
        # If fused with its reader, the field of a lattice would be computed again for each number that reads it.
        lattice = momentum[0].ndim > 0
        momentum = split(momentum) if lattice else momentum
        value = jax.tree.map(jnp.asarray, function(t, self.join(momentum, pose)))
        entries = jax.tree.map(lambda x: cp.unpacked(x) if x.ndim else (x,), value)
        return split(entries) if lattice else entries, jax.tree.map(
            lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), value
        )

    def force_from(self, potential: Callable[[Any], Array], state: Any) -> Array:
        return -jax.grad(lambda spin: potential(SpinState.unchecked(spin=spin)))(state.spin)


class SpinState(State):
    """Classical spins: three numbers each, no attitude.

    The axes before the last one are the lattice: (3,) is one spin, (n, 3) a chain or n spins without a lattice, (n, m,
    3) and (n, m, l, 3) are lattices of two and three dimensions.

    Attributes:
        spin: unit vectors S, space frame, (*lattice, 3).

    Raises:
        ValueError: not of shape (..., 3), or not unit vectors.

    Examples:
        >>> lattice = ml.spins.SpinState(jnp.tile(jnp.array([0.0, 0.0, 1.0]), (4, 4, 1)))
        >>> ml.observe.energy(ml.spins.Spins(), ml.spins.Exchange(1.0), lattice)  # -1 for each of 32 bonds
        Array(-32., dtype=float64)
    """

    spin: Float[Array, "*lattice 3"]
    body: ClassVar[type] = Spins
    leaves: ClassVar[Leaves] = (Spin,)
    own_axes: ClassVar[int] = 0  # the lattice can have any number of axes, so none is known to be a batch

    def __init__(self, spin: Any):
        self.spin = as_finite("spin", spin, (3,))
        require("spin", self.spin, is_unit, "must be unit vectors", "put their magnitude into the energy.")

    @property
    def momentum(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The spin, which a run integrates like the momentum of a body."""
        return self.spin

    @property
    def kind(self) -> Kind:
        return OnLattice(type(self), self.leaves)
