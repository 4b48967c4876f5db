"""`EddyCurrents`: magnetic braking of a conducting body that rotates in a magnetic field."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_function_of_time, require
from .._math import components as cp
from ..model.bodies import is_symmetric, read_as_tensor
from ..model.state import AnyState, Time
from ..model.torques.fields import to_body_components
from ..model.torques.reads_body import ReadsVelocity


class EddyCurrents(ReadsVelocity):
    """The torque of eddy currents, T = (M (Omega x B)) x B, which never increases the energy.

    M is the magnetic tensor of the body (N. Ortiz Gomez, S. J. I. Walker, Acta Astronaut. 114 (2015) 34), which is M =
    2 pi / 15 sigma R^5 for a solid sphere and 2 pi / 3 sigma R^4 e for a thin shell of thickness e, with the
    conductivity sigma. The field is uniform over the body and changes little during the decay time of the currents.

    Attributes:
        tensor: M, (), (3,) for the diagonal, or a symmetric tensor (3, 3); body frame, torque time / field^2: S m^4 in
            SI units, with the field in T. An array (3, 3) is always a tensor, and never the diagonals of three bodies.
        field: B, space frame, (3,), or a function `field(t) -> (3,)`, such as `midlie_jax.orbits.DipoleField`.

    Raises:
        ValueError: another shape, numbers that are not finite, a tensor that is not symmetric or has a negative
            eigenvalue. When called: a state without an attitude.

    Examples:
        >>> brake = ml.spacecraft.EddyCurrents(tensor=2.0, field=[0.0, 0.0, 1.0])
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> brake.on(body)(0.0, state)[:2]  # across the field; the spin about the field is not damped
        Array([-2., -2.], dtype=float64)
    """

    tensor: Float[Array, "*batch"]
    field: Float[Array, "*batch 3"] | Callable[[Any], Array]

    def __init__(self, tensor: Any, field: Any):
        self.tensor = as_finite("tensor", tensor)
        self.field = as_function_of_time("field", field)
        shape = self.tensor.shape
        if shape not in ((), (3,), (3, 3)) and shape[-1:] != (3,):
            raise ValueError(f"tensor must be (), (3,) or (3, 3), got {shape}.")
        not_negative = "must have no negative eigenvalue"
        cure = "eddy currents only dissipate energy."
        if shape[-2:] == (3, 3):
            other = read_as_tensor("tensor")
            require("tensor", self.tensor, is_symmetric, "must be symmetric", f"pass (M + M.T) / 2; or, {other}.")
            require("tensor", self.tensor, _not_negative, not_negative, f"{cure[:-1]}; or, {other}.")
        else:
            require("tensor", self.tensor, lambda m: m >= 0, not_negative, cure)

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        field = to_body_components("field", self.field, t, state)
        induced = cp.cross(cp.vector(body.velocity(state.momentum)), field)
        return cp.pack(cp.cross(self._times(induced), field))

    def _times(self, v: cp.Vector) -> cp.Vector:
        m = self.tensor
        if m.ndim == 0:
            return cp.scale(m, v)
        if m.ndim == 1:
            return cp.times(cp.vector(m), v)
        if m.shape != (3, 3):
            raise ValueError(f"tensor must be (), (3,) or (3, 3) for one body, got {m.shape}.")
        return cp.dot(cp.vector(m[0]), v), cp.dot(cp.vector(m[1]), v), cp.dot(cp.vector(m[2]), v)


def _not_negative(tensors: np.ndarray) -> Any:
    values = np.linalg.eigvalsh(tensors)
    return values[..., 0] >= -1e-6 * np.abs(values).max(-1)
