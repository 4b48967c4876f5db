"""Bodies: the inertia of rigid bodies, rotors and particles; `states/` holds their configuration and momentum."""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, as_not_negative, cure_of, in_wider, require, require_finite, require_rows
from .._checks.brief_help import BriefHelp
from .._math import components as cp
from .._math.powers import unit as power_of_two
from . import so3
from .inertia import Inertia, RotorInertia

# A flat body has I1 + I2 = I3 exactly; moments from a file satisfy this only up to rounding.
_TRIANGLE_TOLERANCE = 1e-6
_SYMMETRY_TOLERANCE = 1e-5  # relative to the largest entry of the tensor
# Moments must lie between s and 1/s, where s is the smallest normal number of their dtype to this power. This leaves
# room for the intermediate results of the methods.
_RANGE_EXPONENT = 0.8


def require_possible(name: str, value: Any, units: str, cure: str = "check its units.") -> None:
    """Raises unless moments or masses are positive and leave room for the intermediate results."""
    require_rows(name, value, is_positive, "must be positive and finite", cure)
    smallest = float(np.finfo(value.dtype).tiny) ** _RANGE_EXPONENT
    cure = in_wider(value.dtype, f"use other units of {units}")
    problem = f"must be between {smallest:.0e} and {1 / smallest:.0e} in {value.dtype}"
    require_rows(name, value, lambda x: (x >= smallest) & (x <= 1 / smallest), problem, cure)


def _triangle(moments: Any) -> Any:
    return 2 * moments.max(-1) <= moments.sum(-1) * (1 + _TRIANGLE_TOLERANCE)


def is_symmetric(matrix: np.ndarray) -> bool:
    tolerance = _SYMMETRY_TOLERANCE * np.abs(matrix).max()
    return bool(np.allclose(matrix, np.swapaxes(matrix, -1, -2), rtol=0, atol=tolerance))


class Body(eqx.Module, metaclass=BriefHelp):
    """Base class of bodies.

    A custom body defines `inertia` and overrides other methods where it differs; docs/extending.md shows an example.
    `namespace` is where users find the class, and `bath` is its heat bath, both for messages.

    Examples:
        >>> [isinstance(body, ml.base.Body) for body in (ml.SymmetricRotor(5.0), ml.Particles(1.0))]
        [True, True]
    """

    namespace: ClassVar[str] = "midlie_jax"
    bath: ClassVar[str] = "midlie_jax.baths.Langevin(kT, friction, key)"

    @abstractmethod
    def inertia(self) -> Any:
        """The constants of a run, computed once, as a pytree with four methods on components.

        `velocity(momentum)` is I^-1 Pi. `commutator(force)` is the rate of change of the components of a force T while
        the body rotates with the velocity I^-1 T; it is zero if nothing rotates. `square_of_turn(h, momentum)` is |h
        Omega|^2, which bounds the steps of the Runge-Kutta methods. `nutation(momentum)` is the frequency of a fast
        spin, for `midlie_jax.check`; it is zero without spin.
        """

    def velocity(self, momentum: Any) -> Any:
        """The velocity for a momentum, as arrays."""
        return cp.packed(self.inertia().velocity(cp.unpacked(momentum)))

    def is_possible(self) -> Array | bool:
        """Whether the numbers of the body, or of all coupled bodies, are valid, (); a run checks traced numbers so."""
        return True

    @property
    def batch(self) -> tuple[int, ...]:
        """The sizes of the leading axes of a batch of bodies."""
        return ()

    def check_shape(self, name: str, shape: tuple[int, ...], batch: int) -> None:
        """Raises unless the body fits the shape of a state without a fixed number of axes, after `batch` axes."""

    @property
    def turning(self) -> "Body":
        """The body whose rotation the flights compute: the body itself, or its rotating part if it also translates."""
        return self

    def in_principal_axes(self) -> "Body":
        """The body in its principal axes, in which the steps move it."""
        return self

    def frame_of_user(self) -> cp.Quaternion | None:
        """The quaternion from components in the principal frame to components in the user's; None if both agree."""
        return None


class RigidBody(Body):
    """A rigid body that rotates about a fixed point or its centre of mass.

    Attributes:
        moments: principal moments of inertia about this point, along the axes of the body frame, (..., 3), mass x
            length^2. If the largest exceeds the sum of the other two only by rounding of the last digit, as in
            (0.0833, 0.0833, 0.1667), it is lowered to that sum, the moment of a flat body.
        physical: False allows moments that violate the triangle inequality I1 <= I2 + I3. No mass distribution has such
            moments, but the equations of motion remain valid.

    Raises:
        ValueError: the moments are not of shape (..., 3), not positive, unphysical, or not between 1e-30 and 1e30
            (float64: 1e-246 and 1e246). Also if a full tensor was passed; use `TensorBody` or `from_tensor`.

    Examples:
        >>> top = ml.RigidBody([5.0, 5.0, 1.0])
        >>> top.velocity(jnp.array([10.0, 0.0, 50.0]))  # of a momentum
        Array([ 2.,  0., 50.], dtype=float64)
    """

    moments: Float[Array, "*batch 3"]
    physical: bool = eqx.field(static=True, repr=False)

    def __init__(self, moments: Any, *, physical: bool = True):
        self.moments, self.physical = as_floats("moments", moments, (3,)), bool(physical)
        # A (3, 3) array can be three bodies or, by mistake, a tensor. The rows of a physical tensor fail one of the
        # checks below, whose message names the classes for tensors.
        tensor_shaped = self.moments.shape[-2:] == (3, 3)
        cure = "for a full inertia tensor use midlie_jax.TensorBody or RigidBody.from_tensor." if tensor_shaped else ""
        other = "check units and order; for a thin rod, with a moment of zero, use midlie_jax.SymmetricRotor(moment)"
        cure_of_sign = cure or cure_of(self.moments, other)
        require_possible("moments", self.moments, "mass or length", cure_of_sign)
        if physical:
            self.moments = made_flat(self.moments, _TRIANGLE_TOLERANCE)
            problem = "are unphysical: the largest must not exceed the sum of the other two"
            cure = cure or "check the moments, or pass physical=False to allow moments that no real body has."
            require_rows("moments", self.moments, _triangle, problem, cure)

    @classmethod
    def from_tensor(cls, tensor: Any, *, physical: bool = True) -> tuple["RigidBody", Float[Array, "*batch 3 3"]]:
        """The body with a full inertia tensor, and its principal axes. `TensorBody` converts automatically.

        Args:
            tensor, physical: as for `TensorBody`, in some frame G fixed in the body.

        Returns:
            The body, with ascending moments, and rotation matrices `axes` (..., 3, 3) whose columns are the principal
            axes in G: tensor = axes @ diag(moments) @ axes.T. A vector v in G is axes.T @ v in the body frame, and an
            attitude R of G becomes R @ axes. Derivatives are NaN where moments are equal.
        """
        tensor = as_floats("tensor", tensor, (3, 3))
        require_finite("tensor", tensor)
        require("tensor", tensor, is_symmetric, "must be symmetric", "pass (J + J.T) / 2 if it differs by rounding.")
        unit, per_unit = power_of_two(jnp.max(jnp.abs(tensor), axis=(-1, -2)))
        moments, axes = jnp.linalg.eigh(per_unit[..., None, None] * tensor)
        moments = unit[..., None] * moments
        sign = jnp.where(jnp.linalg.det(axes) < 0, -1, 1).astype(axes.dtype)
        return cls(moments, physical=physical), axes * sign[..., None, None]

    def inertia(self) -> Inertia:
        return Inertia.of(self)

    def is_possible(self) -> Array:
        moments = jax.lax.stop_gradient(self.moments)
        possible = all_positive(moments)
        return possible & jnp.all(_triangle(moments)) if self.physical else possible

    @property
    def batch(self) -> tuple[int, ...]:
        return self.moments.shape[:-1]

    def velocity(self, momentum: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular velocity I^-1 Pi, body frame."""
        return cp.pack(tuple(p / i for p, i in zip(cp.vector(momentum), cp.vector(self.moments), strict=True)))

    def momentum(self, velocity: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular momentum I Omega, body frame."""
        return cp.pack(cp.times(cp.vector(self.moments), cp.vector(velocity)))

    @property
    def trace(self) -> Float[Array, "*batch"]:
        """I1 + I2 + I3."""
        return jnp.sum(self.moments, axis=-1)


class TensorBody(Body):
    """A rigid body with a full inertia tensor, in any frame fixed in the body ("your frame").

    Momentum, attitude, torque and angular velocity are all in your frame; the drivers convert to the principal frame
    and back. A run resumed from a saved state therefore differs from an uninterrupted run by rounding. Where two
    moments are equal, gradients with respect to the tensor are NaN; use a `RigidBody` there.

    Attributes:
        principal: the same body in its principal frame.
        frame: unit quaternion that takes components in the principal frame to components in your frame, (..., 4).

    Args:
        tensor: (..., 3, 3) symmetric positive definite inertia tensor, mass x length^2; otherwise a ValueError.
        physical: as for `RigidBody`.

    Examples:
        >>> body = ml.TensorBody([[3.0, 0.5, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 4.0]])
        >>> body.momentum(jnp.array([1.0, 0.0, 1.0])).round(6)  # of an angular velocity, both in your frame
        Array([3. , 0.5, 4. ], dtype=float64)
    """

    principal: RigidBody
    frame: Float[Array, "*batch 4"]

    def __init__(self, tensor: Any, *, physical: bool = True):
        self.principal, axes = RigidBody.from_tensor(tensor, physical=physical)
        self.frame = so3.from_matrix(axes)

    def inertia(self) -> Inertia:
        return self.principal.inertia()

    def is_possible(self) -> Array:
        return self.principal.is_possible()

    @property
    def batch(self) -> tuple[int, ...]:
        return self.principal.batch

    def in_principal_axes(self) -> RigidBody:
        return self.principal

    def frame_of_user(self) -> cp.Quaternion:
        return cp.quaternion(self.frame)

    @property
    def tensor(self) -> Float[Array, "*batch 3 3"]:
        """The inertia tensor in your frame."""
        axes = so3.to_matrix(self.frame)
        return (axes * self.principal.moments[..., None, :]) @ jnp.swapaxes(axes, -1, -2)

    def velocity(self, momentum: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular velocity I^-1 Pi, your frame."""
        return so3.rotate(self.frame, self.principal.velocity(self.to_principal(momentum)))

    def momentum(self, velocity: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular momentum I Omega, your frame."""
        return so3.rotate(self.frame, self.principal.momentum(self.to_principal(velocity)))

    @property
    def trace(self) -> Float[Array, "*batch"]:
        return self.principal.trace

    def to_principal(self, vector: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The components in the principal frame of a vector in your frame."""
        return so3.rotate(so3.conjugate(self.frame), vector)


class SymmetricRotor(Body):
    """A symmetric body, of which only the direction of the axis and the momentum are computed.

    Without torque the axis e rotates about the spatial momentum pi at the rate |pi| / I1, for any moment about the
    axis. Under a torque without a component along e, pi . e is constant. Examples are a spinning top, a linear molecule
    or a dumbbell (pi . e = 0), a dipole and a spherical pendulum (I1 = m l^2). The state is an `AxisState`.

    Attributes:
        moment: the moment of inertia I1 = I2 about an axis across the axis of symmetry, (...), mass x length^2.
        along: the moment I3 about the axis of symmetry, (...), from zero, for a linear molecule, to 2 I1; None if
            unknown. The motion does not depend on it, but a torque may, such as `PointMass`.

    Examples:
        >>> rotor, top = ml.SymmetricRotor(5.0), ml.AxisState.of(start)
        >>> ml.integrate("SYMMETRIC[EA]", rotor, torque, top, dt=0.01, steps=100).states.axis.shape
        (101, 3)
    """

    moment: Float[Array, "*batch"]
    along: Float[Array, "*batch"] | None

    def __init__(self, moment: Any, along: Any = None):
        self.moment = as_floats("moment", moment)
        require_possible("moment", self.moment, "mass or length")
        self.along = None if along is None else as_not_negative("along", along)
        if self.along is not None:
            if self.along.shape != self.moment.shape:
                raise ValueError(f"along {self.along.shape} and moment {self.moment.shape} must have one shape.")
            known = not cp.is_traced(self.along, self.moment)
            if known and np.any(np.asarray(self.along) > 2 * np.asarray(self.moment)):
                raise ValueError("along must not exceed twice the moment, as in any real body; check their order.")

    def inertia(self) -> RotorInertia:
        return RotorInertia(1 / self.moment)

    def is_possible(self) -> Array:
        possible = all_positive(self.moment)
        if self.along is None:
            return possible
        along = jax.lax.stop_gradient(self.along)
        most = 2 * jax.lax.stop_gradient(self.moment) * (1 + _TRIANGLE_TOLERANCE)
        return possible & jnp.all((along >= 0) & (along <= most))

    @property
    def known_along(self) -> Float[Array, "*batch"]:
        if self.along is None:
            raise ValueError("this torque needs the moment about the axis; write SymmetricRotor(moment, along).")
        return self.along

    @property
    def trace(self) -> Float[Array, "*batch"]:
        """2 I1 + I3; a ValueError if `along` is None."""
        return 2 * self.moment + self.known_along

    @property
    def batch(self) -> tuple[int, ...]:
        return self.moment.shape

    def velocity(self, momentum: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular velocity pi / I1 of the axis, space frame; it omits part of the spin."""
        return cp.pack(cp.scale(1 / self.moment, cp.vector(momentum)))

    def momentum(self, velocity: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular momentum I1 w of a body without spin whose axis rotates at w, space frame."""
        return cp.pack(cp.scale(self.moment, cp.vector(velocity)))


class Unturned(Body):
    """A body without rotation, which is the constants of its own runs."""

    def inertia(self) -> Any:
        return self

    def commutator(self, force: Any) -> Any:
        return jax.tree.map(jnp.zeros_like, force)

    def square_of_turn(self, h: Array | float, momentum: Any) -> Array:
        return h * self.nutation(momentum)

    def nutation(self, momentum: Any) -> Array:
        return jnp.zeros((), jax.tree.leaves(momentum)[0].dtype)


class Particles(Unturned):
    """Point masses, or any mechanical system with a constant mass matrix: u' = M^-1 p, p' = f(t, u).

    The nodes of a deformable solid are also particles; docs/solids.md shows an example.

    Attributes:
        mass: positive masses, whose shape must fit the positions in one way only, in one of the forms

            - (): one for all coordinates;
            - (n,): one for each coordinate of positions (n,); or for each column of positions (k, n), if k is not n;
            - a column (n, 1): one for each row of positions (n, d), that is, one for each particle;
            - a row (1, d): one for each column of positions (n, d);
            - (n, n): a symmetric positive definite matrix for positions (n,), stored as its lower Cholesky factor.

    Raises:
        ValueError: a mass of another form, or, in `velocity`, `momentum` and runs, one that does not fit the positions.

    Examples:
        >>> three = ml.Particles([[1.0], [2.0], [3.0]])  # a mass for each
        >>> three.velocity(jnp.ones((3, 3)))[:, 0].round(4)
        Array([1.    , 0.5   , 0.3333], dtype=float64)
    """

    mass: Float[Array, ""] | Float[Array, " n"] | Float[Array, "n 1"] | Float[Array, "1 n"] | Float[Array, "n n"]

    def __init__(self, mass: Any):
        mass = as_floats("mass", mass)
        if mass.ndim > 2 or (mass.ndim == 2 and not is_matrix(mass) and 1 not in mass.shape):
            raise ValueError(
                f"mass must be a scalar, (n,), (n, 1), (1, n) or (n, n), got {mass.shape}; flatten the positions, or "
                "map over a batch with jax.vmap."
            )
        if is_matrix(mass):
            require_finite("mass", mass)
            require("mass", mass, lambda m: np.allclose(m, m.T, rtol=1e-6), "must be symmetric", "pass (M + M.T) / 2.")
            mass = jnp.linalg.cholesky(mass)
            if not cp.is_traced(mass) and not np.all(np.isfinite(mass)):
                raise ValueError("mass must be positive definite: its Cholesky factorisation failed.")
        else:
            require("mass", mass, is_positive, "must be positive and finite", "give every coordinate a positive mass.")
        self.mass = mass

    def is_possible(self) -> Array:
        """A matrix that is not positive definite has no Cholesky factor."""
        return all_positive(jnp.diag(self.mass) if is_matrix(self.mass) else self.mass)

    def check_shape(self, name: str, shape: tuple[int, ...], batch: int) -> None:
        _check_fits(self.mass, f"{name}.position", shape[batch:])

    def velocity(self, momentum: Array) -> Array:
        """The velocity u' = M^-1 p."""
        _check_fits(self.mass, "momentum", jnp.shape(momentum))
        if self.mass.shape == (1, 1):
            return momentum / self.mass[0, 0] / self.mass[0, 0]  # the factor is the root of the mass
        if is_matrix(self.mass):
            return jax.scipy.linalg.cho_solve((self.mass, True), momentum)
        return momentum / self.mass

    def momentum(self, velocity: Array) -> Array:
        """The momentum p = M u'."""
        _check_fits(self.mass, "velocity", jnp.shape(velocity))
        if self.mass.shape == (1, 1):
            return self.mass[0, 0] * (self.mass[0, 0] * velocity)
        if is_matrix(self.mass):
            return self.mass @ (self.mass.T @ velocity)
        return self.mass * velocity


def principal_of(body: Any) -> Any:
    return body.in_principal_axes() if isinstance(body, Body) else body


def is_positive(numbers: np.ndarray) -> Any:
    return np.isfinite(numbers) & (numbers > 0)


def all_positive(numbers: Array) -> Array:
    numbers = jax.lax.stop_gradient(numbers)
    return jnp.all(jnp.isfinite(numbers) & (numbers > 0))


def is_matrix(mass: Array) -> bool:
    return mass.ndim == 2 and mass.shape[0] == mass.shape[1]


def _check_fits(mass: Array, name: str, shape: tuple[int, ...]) -> None:
    form, values = mass.shape, f"{name} of shape {shape}"
    if is_matrix(mass):
        if shape != form[:1] and (form != (1, 1) or shape[:1] != (1,)):
            raise ValueError(
                f"body.mass must have one row per coordinate if it is a matrix, got {form} for {values}. Flatten the "
                "state to one axis."
            )
        return
    if len(form) > len(shape) or any(m not in (1, n) for m, n in zip(form[::-1], shape[::-1], strict=False)):
        cure = f"give one mass (), or one for each coordinate {shape}"
        if len(shape) > 1:
            column, row = (shape[-2], 1), (1, shape[-1])
            cure = f"give one mass (), one for each particle, which is a row, {column}, or one for each column {row}"
        raise ValueError(f"body.mass {form} does not fit {values}; {cure}.")
    if len(form) == 1 and form[0] > 1 and form[0] in shape[:-1]:
        raise ValueError(
            f"body.mass must be a column or a row for {values}, got {form}. Write mass[:, None] for one mass per "
            "particle, or mass[None, :]."
        )


_MOST_ROUNDED = 1e-3  # the largest violation relative to the sum of the moments, for any number of digits


def made_flat(moments: Array, tolerance: float) -> Array:
    if cp.is_traced(moments):
        return moments
    rows = np.array(moments).reshape(-1, 3)
    total = rows.sum(axis=1)
    excess = 2 * rows.max(axis=1) - total
    changed = False
    for i in np.flatnonzero((excess > tolerance * total) & (excess <= _MOST_ROUNDED * total)):
        row = rows[i]
        if excess[i] <= 1.5 * 1.001 * min(map(_last_digit, row)):
            largest = int(np.argmax(row))
            row[largest] = 0
            row[largest] = row.sum()
            changed = True
    return jnp.asarray(rows.reshape(moments.shape)) if changed else moments


def _last_digit(number: np.floating) -> float:
    mantissa, _, exponent = np.format_float_scientific(number, trim="-").partition("e")
    return 10.0 ** (int(exponent) - len(mantissa.partition(".")[2]))
