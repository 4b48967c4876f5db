"""Friction: viscous damping of the rotation, and air drag.

Reference: P. C. Hughes, Spacecraft Attitude Dynamics (1986), chapter 8 (environment).
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_not_negative
from ..._math import components as cp
from ..rotor import SymmetricRotor
from ..state import AnyState, Time
from ..states import TravellingState
from ..wrench import Wrench
from .reads_body import ReadsVelocity, angular_velocity_of, knows_axis_alone
from .travel import InAir, through_air, travelling


def as_gain(name: str, value: Any) -> Array:
    gain = as_not_negative(name, value, cure="pass its magnitude.")
    if gain.ndim and gain.shape[-1] != 3:
        raise ValueError(
            f"{name} must be a number or have shape (3,), got {gain.shape}. For one number per body write "
            f"jnp.tile({name}[:, None], (1, 3))."
        )
    return gain


class Damping(ReadsVelocity):
    """Viscous friction, -coefficient * Omega.

    Attributes:
        coefficient: torque per angular velocity, () or one for each body axis (3,), not negative. For an `AxisState`
            the first two must be equal, and the body is a `SymmetricRotor(moment, along)`.

    Raises:
        ValueError: a negative or not finite coefficient, or another shape. When a run begins: an `AxisState` with a
            coefficient that varies across the axis, or a `SymmetricRotor` without `along`.

    Examples:
        >>> body = ml.RigidBody([2.0, 3.0, 4.0])
        >>> state = ml.RigidState([2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0])  # Omega = (1, 1, 1)
        >>> ml.torques.Damping([0.5, 0.5, 0.25]).on(body)(0.0, state)
        Array([-0.5 , -0.5 , -0.25], dtype=float64)
    """

    coefficient: Float[Array, "*batch"]

    def __init__(self, coefficient: Any):
        self.coefficient = as_gain("coefficient", coefficient)

    def check(self, state: AnyState) -> None:
        super().check(state)
        if not knows_axis_alone(state) or cp.is_traced(self.coefficient):
            return
        gain = np.asarray(self.coefficient)
        if gain.ndim and np.any(gain[..., 0] != gain[..., 1]):
            raise ValueError(
                f"coefficient is {gain.tolist()}, but the first two must be equal for "
                f"{type(state).__name__}, which holds only the axis of symmetry; use a RigidState."
            )

    def at(self, t: Time, state: AnyState, body: Any) -> Array:
        if not isinstance(body.turning, SymmetricRotor):
            return -self.coefficient * body.velocity(state.momentum)
        velocity, gain = angular_velocity_of(state, body), jnp.broadcast_to(self.coefficient, state.momentum.shape)
        axis, _ = state.in_one_frame((0.0, 0.0, 1.0), velocity)
        across = jnp.where(gain[..., 0] == gain[..., 1], gain[..., 0], jnp.nan)
        along = (gain[..., 2] - across) * cp.dot(axis, velocity)
        return -cp.pack(cp.add(cp.scale(across, velocity), cp.scale(along, axis)))


class Drag(InAir):
    """Air drag on a body whose cross section does not depend on the attitude: F = -1/2 rho A |v| v, and lever x F.

    This holds in free molecular flow (Hughes, section 8.2), and for a ball in air. For a body made of plates, add one
    `Drag` for each plate, or write a custom torque. With `velocity`, a known path, it is a torque alone. Without, it
    uses the velocity of a body that translates, and the drag is a wrench.

    Attributes:
        lever: vector from the centre of mass to the centre of pressure, body frame, (3,), length.
        area: drag coefficient times cross section A, (), length^2, not negative.
        density: density rho of the air, (), mass/length^3, not negative.
        velocity: velocity v of the body relative to the air, space frame, (3,), or a function `velocity(t) -> (3,)`,
            length/time; None for the velocity of a `FreeState`.
        wind: with `velocity` None, the velocity of the air, in the same forms; None for air at rest.

    Raises:
        ValueError: wrong shapes, values that are not finite, a negative area or density, or velocity and wind together.
            When called: as for `DipoleInField`; without `velocity`, body and state do not translate.

    Examples:
        >>> drag = ml.torques.Drag(lever=[0.0, 0.0, 0.5], area=2.0, density=1e-11, velocity=[7600.0, 0.0, 0.0])
        >>> state = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> round(1e6 * float(drag(0.0, state)[1]), 3)  # micro-N m: -lever * rho A v^2 / 2
        -288.8
    """

    lever: Float[Array, "*batch 3"]
    area: Float[Array, "*batch"]
    density: Float[Array, "*batch"]

    def __init__(self, lever: Any, area: Any, density: Any, velocity: Any = None, *, wind: Any = None):
        self.lever = as_finite("lever", lever, (3,))
        self.area, self.density = as_not_negative("area", area), as_not_negative("density", density)
        self._set_flow(velocity, wind)

    def check(self, state: AnyState) -> None:
        if isinstance(state, TravellingState):
            state.in_one_frame(cp.vector(self.lever))

    def torque_in(self, t: Time, velocity: cp.Vector) -> cp.Vector:
        return cp.cross(cp.vector(self.lever), self._force(velocity))

    def at(self, t: Time, state: AnyState, body: Any) -> Any:
        state, body = travelling(self, state, body)
        force = self._force(through_air(t, state, body, self.wind))
        return Wrench(cp.pack(cp.cross(*state.in_one_frame(cp.vector(self.lever), force))), cp.pack(force))

    def _force(self, velocity: cp.Vector) -> cp.Vector:
        return cp.scale(-self.density * self.area / 2 * cp.norm(velocity), velocity)
