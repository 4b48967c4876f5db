"""Fields of lattice neighbours on spins: exchange and the Dzyaloshinskii-Moriya interaction."""

from abc import abstractmethod
from collections.abc import Callable
from functools import reduce
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, described
from .._math import components as cp
from ..model.state import Time
from .fields import SpinField, lattice_of

# For each lattice site the spin of its neighbour, from an axis of the lattice and a step of 1 or -1 along it.
Near = Callable[[int, int], cp.Vector]


class NeighbourField(SpinField):
    """Base class of fields of the neighbours along the axes of the lattice.

    Attributes:
        periodic: for each axis of the lattice, or for all, whether the first and the last spin are neighbours.
    """

    periodic: eqx.AbstractVar[bool | tuple[bool, ...]]

    def check(self, state: Any) -> None:
        axes = len(lattice_of(self, state))
        if not axes:
            raise ValueError(f"{type(self).__name__} needs a lattice of spins (..., 3), got one spin (3,).")
        if isinstance(self.periodic, tuple) and len(self.periodic) != axes:
            raise ValueError(f"periodic has {len(self.periodic)} entries, but the lattice has {axes} axes.")

    def closes(self, axis: int) -> bool:
        return self.periodic[axis] if isinstance(self.periodic, tuple) else self.periodic

    @abstractmethod
    def field_of(self, near: Near, axes: int) -> cp.Vector:
        """The field, from the function that returns neighbours and the number of axes of the lattice."""

    @abstractmethod
    def of_bonds(self, axis: int, spin: cp.Vector, following: cp.Vector) -> Array:
        """The energy of the bonds along an axis, from each spin and the next."""

    def energy(self, t: Time, spin: cp.Vector) -> Array:
        near = self.near(spin)
        return sum((self.of_bonds(axis, spin, near(axis, 1)) for axis in range(spin[0].ndim)), jnp.zeros_like(spin[0]))

    def field(self, t: Time, spin: cp.Vector) -> cp.Vector:
        return self.field_of(self.near(spin), spin[0].ndim)

    def near(self, spin: cp.Vector) -> Near:
        """For each lattice site the next spin (step 1) or the previous one (-1) along an axis; zero if none."""
        return lambda axis, step: shifted(spin, axis, step, self.closes(axis))


def as_periodic(periodic: Any) -> bool | tuple[bool, ...]:
    if isinstance(periodic, bool | np.bool_):
        return bool(periodic)
    if isinstance(periodic, tuple | list) and periodic and all(isinstance(x, bool | np.bool_) for x in periodic):
        return tuple(map(bool, periodic))
    raise ValueError(f"periodic must be True or False, or one of them for each axis, got {described(periodic)}.")


def shifted(spin: cp.Vector, axis: int, step: int, periodic: bool) -> cp.Vector:
    def one(x: Array) -> Array:
        size = x.shape[axis]
        if step > 0:
            inner, edge = _part(x, axis, 1, size), _part(x, axis, 0, 1)
        else:
            inner, edge = _part(x, axis, 0, size - 1), _part(x, axis, size - 1, size)
        edge = edge if periodic else jnp.zeros_like(edge)
        return jnp.concatenate((inner, edge) if step > 0 else (edge, inner), axis)

    return one(spin[0]), one(spin[1]), one(spin[2])


def _part(x: Array, axis: int, begin: int, end: int) -> Array:
    return x[(slice(None),) * axis + (slice(begin, end),)]


class Exchange(NeighbourField):
    """Exchange between neighbours, H = -J sum over bonds of S_i . S_j, each bond once: ferromagnetic with J > 0.

    Attributes:
        coupling: J, energy, one for all axes (), or one for each axis of the lattice (d,).
        periodic: whether the lattice closes, True or False, or one of them for each axis.

    Raises:
        ValueError: a coupling that is not finite; coupling or periodic without one entry for each axis.

    Examples:
        >>> chain = ml.spins.SpinState([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        >>> torque = ml.spins.Exchange(1.0, periodic=False)
        >>> torque.potential(0.0, chain).item()  # -1 - 1 + 1 from three bonds
        -1.0
        >>> torque(0.0, chain)[:, 2]  # the z component of the field on each spin
        Array([1., 2., 0., 1.], dtype=float64)
    """

    coupling: Float[Array, "*axes"]
    periodic: bool | tuple[bool, ...]

    def __init__(self, coupling: Any, periodic: Any = True):
        self.coupling = as_finite("coupling", coupling)
        self.periodic = as_periodic(periodic)

    def check(self, state: Any) -> None:
        super().check(state)
        axes = state.spin.ndim - 1
        if self.coupling.shape not in ((), (axes,)):
            raise ValueError(f"coupling must be () or ({axes},), one for each axis, got {self.coupling.shape}.")

    def of_axis(self, axis: int) -> Array:
        return self.coupling[axis] if self.coupling.ndim else self.coupling

    def field_of(self, near: Near, axes: int) -> cp.Vector:
        pairs = [cp.add(near(axis, 1), near(axis, -1)) for axis in range(axes)]
        if self.coupling.ndim:
            return reduce(cp.add, [cp.scale(self.of_axis(a), pair) for a, pair in enumerate(pairs)])
        return cp.scale(self.coupling, reduce(cp.add, pairs))

    def of_bonds(self, axis: int, spin: cp.Vector, following: cp.Vector) -> Array:
        return -self.of_axis(axis) * cp.dot(spin, following)


class DzyaloshinskiiMoriya(NeighbourField):
    """Dzyaloshinskii-Moriya interaction, H = sum over bonds of D . (S_i x S_j), with j the next site along an axis.

    Attributes:
        vectors: D for the bonds along each axis of the lattice, space frame, energy, (d, 3). In bulk D is parallel to
            the bond; at an interface with the normal z it is z x bond, the same up to a sign for all bonds of an axis.
        periodic: whether the lattice closes, True or False, or one of them for each axis.

    Raises:
        ValueError: vectors that are not finite; vectors or periodic that are not one for each axis.

    Examples:
        >>> chain = ml.spins.SpinState([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        >>> torque = ml.spins.DzyaloshinskiiMoriya([[0.0, 0.0, 0.5]], periodic=False)  # one axis of the lattice
        >>> torque.potential(0.0, chain).item()  # D . (S_0 x S_1)
        0.5
    """

    vectors: Float[Array, "axes 3"]
    periodic: bool | tuple[bool, ...]

    def __init__(self, vectors: Any, periodic: Any = True):
        self.vectors = as_finite("vectors", vectors, (3,))
        if self.vectors.ndim != 2:
            raise ValueError(f"vectors must be (d, 3), one for each axis of the lattice, got {self.vectors.shape}.")
        self.periodic = as_periodic(periodic)

    def check(self, state: Any) -> None:
        super().check(state)
        if len(self.vectors) != state.spin.ndim - 1:
            axes = state.spin.ndim - 1
            raise ValueError(f"vectors must be ({axes}, 3), one for each axis, got {self.vectors.shape}.")

    def field_of(self, near: Near, axes: int) -> cp.Vector:
        """B_i = sum over neighbours of D_ij x S_j, where D_ji = -D_ij."""
        pairs = [cp.subtract(near(axis, 1), near(axis, -1)) for axis in range(axes)]
        return reduce(cp.add, [cp.cross(cp.vector(self.vectors[a]), pair) for a, pair in enumerate(pairs)])

    def of_bonds(self, axis: int, spin: cp.Vector, following: cp.Vector) -> Array:
        return cp.dot(cp.vector(self.vectors[axis]), cp.cross(spin, following))
