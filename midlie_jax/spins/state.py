"""`Spins`, classical spins that precess in the field on each of them, and `SpinState`."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_not_negative, described, is_unit, require
from .._math import components as cp
from .._xla.fusion import split
from ..model.bodies import Unturned
from ..model.kind import Kind, Leaves
from ..model.leaf import Described, Flat, NoPose
from ..model.state import State


class Spins(Unturned):
    """Classical spins on a lattice: unit vectors S under the Landau-Lifshitz-Gilbert equation.

        S' = g B x S + g alpha S x (B x S),    B = -dH/dS,    g = gyromagnetic / (1 + alpha^2)

    Each spin precesses about its field B in the right-handed sense. For the magnetisation M of an electron,
    micromagnetics writes M' = -gamma M x B, which is the same with gamma as `gyromagnetic`.

    Attributes:
        damping: Gilbert's alpha, one for all spins () or one for each, in the shape of the lattice. Not negative.
            Stored as None if given as the number 0; steps without damping are 2 times faster.
        gyromagnetic: the gyromagnetic ratio over the magnetic moment of a spin, 1/action: 1 where time is measured in
            units of hbar over an energy. () or in the shape of the lattice.
        sublattices: for the methods SUBLATTICES[...], the sublattice of each spin, counted from 0, in the shape of the
            lattice; None for the two sublattices of a checkerboard. Spins of one sublattice must not act on each other.

    Raises:
        ValueError: a damping that is negative or not finite, or sublattices that are not integers from 0. When a run
            begins: damping or gyromagnetic not in the shape of the lattice.

    Examples:
        >>> spins, field = ml.spins.Spins(damping=0.1), ml.spins.AppliedField([0.0, 0.0, 1.0])
        >>> chain = ml.spins.SpinState(jnp.tile(jnp.array([1.0, 0.0, 0.0]), (8, 1)))
        >>> path = ml.integrate("SUBLATTICES[EA]", spins, field, chain, dt=0.1, steps=100)
        >>> path.states.spin[-1, 0, 2].round(4)  # tanh(10 alpha / (1 + alpha^2))
        Array(0.7574, dtype=float64)
    """

    namespace: ClassVar[str] = "midlie_jax.spins"
    bath: ClassVar[str] = "midlie_jax.spins.ThermalField(kT, key)"
    damping: Float[Array, "*#lattice"] | None
    gyromagnetic: Float[Array, "*#lattice"]
    sublattices: Array | None
    count: int | None = eqx.field(static=True)

    def __init__(self, damping: Any = 0.0, gyromagnetic: Any = 1.0, sublattices: Any = None):
        none = isinstance(damping, int | float) and damping == 0
        self.damping = None if none else as_not_negative("damping", damping, cure="check its sign.")
        self.gyromagnetic = as_finite("gyromagnetic", gyromagnetic)
        self.sublattices, self.count = None, None
        if sublattices is not None:
            self.sublattices, self.count = _labels(sublattices)

    @property
    def rate(self) -> Array:
        """g = gyromagnetic / (1 + alpha^2): a spin rotates by g |B| h in the time h."""
        return self.gyromagnetic if self.damping is None else self.gyromagnetic / (1 + self.damping**2)

    def check_shape(self, name: str, shape: tuple[int, ...], batch: int) -> None:
        if len(shape) <= batch:
            raise ValueError(f"{name}.spin must be (n, ..., 3), got {shape}; stack the lattices, or use integrate.")
        lattice = shape[batch:-1]
        require_lattice("damping", self.damping, lattice)
        require_lattice("gyromagnetic", self.gyromagnetic, lattice)

    def velocity(self, momentum: Any) -> Any:
        """Zero: spins have no kinetic energy and rotate only in a field."""
        return self.commutator(momentum)

    def change(self, h: Any, spin: cp.Vector, field: cp.Vector) -> cp.Vector:
        """h S' of spins in this field."""
        turn = cp.cross(field, spin)
        if self.damping is not None:
            turn = cp.add(turn, cp.scale(self.damping, cp.cross(spin, turn)))
        return cp.scale(h * self.rate, turn)


def require_lattice(name: str, value: Array | None, lattice: tuple[int, ...], own: tuple[int, ...] = ()) -> None:
    """Raises unless a value is one for all spins of a lattice or one for each; `own` are its axes for one spin."""
    if value is None:
        return
    axes = value.shape[: value.ndim - len(own)]
    fits = len(axes) <= len(lattice) and all(a in (1, n) for a, n in zip(axes[::-1], lattice[::-1], strict=False))
    if not fits or value.shape[len(axes) :] != own:
        raise ValueError(
            f"{name} must be {own}, one for all spins, or {(*lattice, *own)}, one for each on the lattice {lattice}, "
            f"got {value.shape}."
        )


def _labels(sublattices: Any) -> tuple[Array, int]:
    labels = np.asarray(sublattices)
    if not (np.issubdtype(labels.dtype, np.integer) and labels.size and labels.min() >= 0):
        raise ValueError(f"sublattices must be integers from 0, one for each spin, got {described(sublattices)}.")
    used = np.unique(labels)
    if len(used) != used[-1] + 1 or len(used) > 127:
        raise ValueError(f"sublattices must use every number from 0 to at most 126, got {used.tolist()[:8]}.")
    return jnp.asarray(labels, jnp.int8), len(used)


def checkerboard(shape: tuple[int, ...]) -> np.ndarray:
    """The number 0 or 1 of each lattice site: the parity of the sum of its indices.

    Examples:
        >>> ml.spins.checkerboard((2, 4)).tolist()  # the default of SUBLATTICES[...]
        [[0, 1, 0, 1], [1, 0, 1, 0]]
    """
    return np.indices(shape).sum(axis=0) % 2 if shape else np.zeros((), int)


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
        raise ValueError("a SpinState has no body frame for a torque; give a field, such as spins.AppliedField.")

    @staticmethod
    def normalised(*arrays: Array) -> tuple[Array, ...]:
        return (arrays[0] / jnp.linalg.norm(arrays[0], axis=-1, keepdims=True),)


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
        return SpinState.unchecked(spin=self.packed(momentum, pose)[0])

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

    Attributes:
        spin: unit vectors S, space frame, (*lattice, 3): (3,) is one spin, (n, 3) a chain or n spins without a lattice,
            (n, m, 3) a lattice of two dimensions.

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
        require("spin", self.spin, is_unit, "must be unit vectors", "divide it by its norm.")

    @property
    def momentum(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The spin, which a run integrates like the momentum of a body."""
        return self.spin

    @property
    def kind(self) -> Kind:
        return OnLattice(type(self), self.leaves)
