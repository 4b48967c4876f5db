"""Fields on spins: an applied field, anisotropies, exchange and the Dzyaloshinskii-Moriya interaction.

The field is B = -dH/dS, with the energy H given in each docstring; sums run over the lattice. A lattice has the axes of
the array of spins before its last one.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_floats, as_weak, described, is_unit, require, vector_at
from .._math import components as cp
from ..model.state import Time
from ..model.torques.base import Torque
from .state import require_lattice


class SpinField(Torque):
    """A field B = -dH/dS on spins, space frame, energy; `torque(t, state)` has the shape of the spins, (*lattice, 3).

    A custom field is a subclass with `field` and `energy`, which work on components.

    Raises:
        ValueError: when called, the state has no spins, or its lattice does not fit the parameters.

    Examples:
        >>> class Gradient(ml.spins.SpinField):  # custom: along z, growing along a chain
        ...     def field(self, t, spin):
        ...         return (0 * spin[0], 0 * spin[1], jnp.arange(0.0, len(spin[2])))
        ...     def energy(self, t, spin):
        ...         return -self.field(t, spin)[2] * spin[2]
        ...     def is_uniform(self, t):
        ...         return False
        >>> Gradient()(0.0, ml.spins.SpinState([[0.0, 0.0, 1.0]] * 3))[:, 2]
        Array([0., 1., 2.], dtype=float64)
    """

    @abstractmethod
    def field(self, t: Time, spin: cp.Vector) -> cp.Vector:
        """The field on components of shape (*lattice), or with fewer axes if it is the same for all."""

    def is_uniform(self, t: Time) -> bool:
        """Whether its parameters are the same for all spins."""
        return True

    @abstractmethod
    def energy(self, t: Time, spin: cp.Vector) -> Array:
        """The energy of each spin or bond, whose sum over all axes is H."""

    def __call__(self, t: Time, state: Any) -> Array:
        self.check(state)
        spin = cp.vector(state.spin)
        return cp.pack(tuple(jnp.broadcast_to(b, x.shape) for b, x in zip(self.field(t, spin), spin, strict=True)))

    def potential(self, t: Time, state: Any) -> Array:
        self.check(state)
        return jnp.sum(self.energy(t, cp.vector(state.spin)))

    def check(self, state: Any) -> None:
        lattice_of(self, state)


def lattice_of(torque: Torque, state: Any) -> tuple[int, ...]:
    if not hasattr(state, "spin"):
        raise ValueError(f"{type(torque).__name__} acts on spins, but the state is a {type(state).__name__}.")
    return state.spin.shape[:-1]


def in_dtype_of(spin: cp.Vector, axis: Any) -> cp.Vector:
    x, y, z = (jnp.asarray(a, spin[0].dtype) for a in axis)
    return x, y, z


class AppliedField(SpinField):
    """An applied field, H = -sum B . S.

    Attributes:
        value: B, space frame, energy: (3,), or (*lattice, 3); or a function of time t -> one of these.

    Raises:
        ValueError: a value that is not finite, or whose last axis is not (3,). When called: as `SpinField`.

    Examples:
        >>> spins = ml.spins.SpinState([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
        >>> ml.spins.AppliedField([0.0, 0.0, 0.5]).potential(0.0, spins).item()
        -0.5
    """

    value: Any

    def __init__(self, value: Any):
        self.value = value if callable(value) else as_finite("value", value, (3,))

    def is_uniform(self, t: Time) -> bool:
        return len(jax.eval_shape(self.value, t).shape if callable(self.value) else self.value.shape) == 1

    def check(self, state: Any) -> None:
        super().check(state)
        if not callable(self.value):
            require_lattice("value", self.value, lattice_of(self, state), (3,))

    def field(self, t: Time, spin: cp.Vector) -> cp.Vector:
        return cp.vector(jnp.asarray(vector_at("value", self.value, t), spin[0].dtype))

    def energy(self, t: Time, spin: cp.Vector) -> Array:
        return -cp.dot(self.field(t, spin), spin)


class OwnField(SpinField):
    """A field of each spin on itself, through its components along some axes: H = sum over axes of V(S . e).

    The motion under one axis alone is a rotation about it: the component S . e does not change.

    Examples:
        >>> class Quartic(ml.spins.OwnField):  # custom: H = -K sum (S . z)^4
        ...     strength: jax.Array
        ...     def axes(self):
        ...         return (ml.flights.components.vector(jnp.array([0.0, 0.0, 1.0])),)
        ...     def along(self, component):
        ...         return 4 * self.strength * component**3
        ...     def energy(self, t, spin):
        ...         return -self.strength * spin[2] ** 4
        >>> Quartic(jnp.array(0.5))(0.0, ml.spins.SpinState([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]]))[:, 2].round(6)
        Array([1.024, 0.   ], dtype=float64)
    """

    strength: eqx.AbstractVar[Array]

    def check(self, state: Any) -> None:
        require_lattice("strength", self.strength, lattice_of(self, state))

    def is_uniform(self, t: Time) -> bool:
        return not self.strength.ndim

    @abstractmethod
    def axes(self) -> tuple[Any, ...]:
        """Unit vectors, each (3,)."""

    @abstractmethod
    def along(self, component: Array) -> Array:
        """The field along an axis, -V'(S . e)."""

    @property
    def linear(self) -> Array | None:
        """The ratio of the field along an axis to the component of the spin, if constant; otherwise None."""
        return None

    def field(self, t: Time, spin: cp.Vector) -> cp.Vector:
        total = cp.scale(0, spin)
        for axis in self.axes():
            axis = in_dtype_of(spin, axis)
            total = cp.add(total, cp.scale(self.along(cp.dot(axis, spin)), axis))
        return total


class Anisotropy(OwnField):
    """Uniaxial anisotropy, H = -K sum (S . e)^2: an easy axis with K > 0, an easy plane with K < 0.

    Attributes:
        strength: K, energy, () or in the shape of the lattice.
        axis: the unit vector e, space frame, (3,).

    Raises:
        ValueError: a strength that is not finite, or an axis that is not a unit vector (3,). When called: as
            `SpinField`.

    Examples:
        >>> spins = ml.spins.SpinState([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # one along z, one across
        >>> ml.spins.Anisotropy(0.25)(0.0, spins)  # z is easy; the field on each spin
        Array([[0. , 0. , 0.5],
               [0. , 0. , 0. ]], dtype=float64)
    """

    strength: Float[Array, "*#lattice"]
    axis: Float[Array, " 3"]

    def __init__(self, strength: Any, axis: Any = (0.0, 0.0, 1.0)):
        self.strength = as_finite("strength", strength)
        axis = as_floats("axis", np.asarray(axis, float) if isinstance(axis, tuple | list) else axis, (3,))
        if axis.ndim != 1:
            raise ValueError(f"axis must have shape (3,), got {axis.shape}.")
        require("axis", axis, is_unit, "must be a unit vector", "divide it by its norm.")
        weak = self.strength.weak_type and not cp.is_traced(axis)
        self.axis = as_weak(axis) if weak else axis.astype(self.strength.dtype)

    def axes(self) -> tuple[Any, ...]:
        return (cp.vector(self.axis),)

    def along(self, component: Array) -> Array:
        return 2 * self.strength * component

    @property
    def linear(self) -> Array:
        return 2 * self.strength

    def energy(self, t: Time, spin: cp.Vector) -> Array:
        component = cp.dot(cp.vector(self.axis), spin)
        return -self.strength * component * component


class CubicAnisotropy(OwnField):
    """Cubic anisotropy, H = K sum (x^2 y^2 + y^2 z^2 + z^2 x^2): easy along the axes with K > 0.

    Attributes:
        strength: K, energy, () or in the shape of the lattice.

    Raises:
        ValueError: a strength that is not finite. When called: as `SpinField`.

    Examples:
        >>> spins = ml.spins.SpinState([[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]])
        >>> round(float(ml.spins.CubicAnisotropy(1.0).potential(0.0, spins)), 6)  # x^2 y^2 of the second spin
        0.2304
    """

    strength: Float[Array, "*#lattice"]

    def __init__(self, strength: Any):
        self.strength = as_finite("strength", strength)

    def axes(self) -> tuple[Any, ...]:
        return tuple(cp.vector(row) for row in jnp.eye(3, dtype=self.strength.dtype))

    def along(self, component: Array) -> Array:
        """For unit vectors H is K/2 sum (1 - x^4 - y^4 - z^4)."""
        return 2 * self.strength * component * component * component

    def energy(self, t: Time, spin: cp.Vector) -> Array:
        x, y, z = (component * component for component in spin)
        return self.strength * (x * y + y * z + z * x)


# For each lattice site the spin of its neighbour, from an axis of the lattice and a step of 1 or -1 along it.
Near = Callable[[int, int], cp.Vector]


class NeighbourField(SpinField):
    """Base class of fields of the neighbours along the axes of the lattice, each periodic or not."""

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
        before = (slice(None),) * axis
        inner, edge = (x[*before, 1:], x[*before, :1]) if step > 0 else (x[*before, :-1], x[*before, -1:])
        edge = edge if periodic else jnp.zeros_like(edge)
        return jnp.concatenate((inner, edge) if step > 0 else (edge, inner), axis)

    return one(spin[0]), one(spin[1]), one(spin[2])


class Exchange(NeighbourField):
    """Exchange between neighbours, H = -J sum over bonds of S_i . S_j, each bond once: ferromagnetic with J > 0.

    Attributes:
        coupling: J, energy, one for all axes (), or one for each axis of the lattice (d,).
        periodic: whether the lattice closes, True or False, or one of them for each axis.

    Raises:
        ValueError: a coupling that is not finite; coupling or periodic without one entry for each axis.

    Examples:
        >>> chain = ml.spins.SpinState([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        >>> ml.spins.Exchange(1.0, periodic=False).potential(0.0, chain).item()  # -1 - 1 + 1 from three bonds
        -1.0
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
        axes = state.spin.ndim - 1
        if len(self.vectors) != axes:
            raise ValueError(f"vectors must be ({axes}, 3), one for each axis, got {self.vectors.shape}.")

    def field_of(self, near: Near, axes: int) -> cp.Vector:
        """B_i = sum over neighbours of D_ij x S_j, where D_ji = -D_ij."""
        pairs = [cp.subtract(near(axis, 1), near(axis, -1)) for axis in range(axes)]
        return reduce(cp.add, [cp.cross(cp.vector(self.vectors[a]), pair) for a, pair in enumerate(pairs)])

    def of_bonds(self, axis: int, spin: cp.Vector, following: cp.Vector) -> Array:
        return cp.dot(cp.vector(self.vectors[axis]), cp.cross(spin, following))
