"""`SymmetricRotor`: a symmetric body whose rotation angle about its axis is not computed."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, require, require_rows
from .._math import components as cp
from .bodies import Body, all_positive, is_positive, require_within_range

_UNITS = "check its units."
_ROUNDING = 1e-6  # of `along`, relative to twice the moment


class RotorInertia(NamedTuple):
    """Constants of a run: 1 / moment. Momentum and torque are in the space frame."""

    inverse: Array

    def velocity(self, momentum: cp.Vector) -> cp.Vector:
        return cp.scale(self.inverse, momentum)

    def commutator(self, force: cp.Vector) -> cp.Vector:
        return cp.scale(0, force)

    def square_of_turn(self, h: Array | float, momentum: cp.Vector) -> Array:
        turn = cp.scale(h, self.velocity(momentum))
        return cp.dot(turn, turn)

    def nutation(self, momentum: cp.Vector) -> Array:
        return cp.norm(self.velocity(momentum))


class SymmetricRotor(Body):
    """A symmetric body, of which only the direction of the axis and the momentum are computed.

    Without torque the axis e rotates about the spatial momentum pi at the rate |pi| / I1, for any moment about the
    axis. Under a torque without a component along e, pi . e is constant. Examples are a spinning top, a linear molecule
    or a dumbbell (pi . e = 0), a dipole and a spherical pendulum (I1 = m l^2). The state is an `AxisState`.

    Attributes:
        moment: the moment of inertia I1 = I2 about an axis across the axis of symmetry, (...), mass x length^2.
        along: the moment I3 about the axis of symmetry, (...), zero for a linear molecule; None if unknown. The motion
            does not depend on it, but a torque may, such as `PointMass`.

    Raises:
        ValueError: the moment is not positive, or out of range; `along` is not between 0 and 2 I1, or of another shape.

    Examples:
        >>> rotor, top = ml.SymmetricRotor(5.0), ml.AxisState.of(start)
        >>> ml.integrate("SYMMETRIC[EA]", rotor, torque, top, dt=0.01, steps=100).states.axis.shape
        (101, 3)
    """

    moment: Float[Array, "*batch"]
    along: Float[Array, "*batch"] | None

    def __init__(self, moment: Any, along: Any = None):
        self.moment = as_floats("moment", moment)
        require_rows("moment", self.moment, is_positive, "must be positive and finite", "check its units.")
        require_within_range("moment", self.moment, "mass or length")
        self.along = None if along is None else as_floats("along", along)
        if self.along is not None:
            if self.along.shape != self.moment.shape:
                raise ValueError(f"along {self.along.shape} and moment {self.moment.shape} must have one shape.")
            require("along", self.along, lambda x: np.isfinite(x) & (x >= 0), "must be finite and not negative", _UNITS)
            if not cp.is_traced(self.along, self.moment) and np.any(
                np.asarray(self.along) > 2 * np.asarray(self.moment)
            ):
                raise ValueError("along must not exceed twice the moment, as in any real body; check their order.")

    def inertia(self) -> RotorInertia:
        return RotorInertia(1 / self.moment)

    def is_possible(self) -> Array:
        possible = all_positive(self.moment)
        if self.along is None:
            return possible
        along = jax.lax.stop_gradient(self.along)
        most = 2 * jax.lax.stop_gradient(self.moment) * (1 + _ROUNDING)
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
