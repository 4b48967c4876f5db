"""Common observables: the direction of an axis, and Euler angles."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import shown
from ..._math import components as cp
from ...model import so3
from ...model.bodies import Body
from ...model.state import AnyState, attitude_of
from ...model.states import AxisState, FreeAxisState
from ...model.torques import TorqueLike
from .observables import Observable


class Axis(Observable):
    """The direction in space of a body-fixed axis, a unit vector (3,); by default the third axis.

    Attributes:
        axis: three numbers in the body frame, of any length but zero.

    Raises:
        ValueError: the axis is zero or not finite. In a run: the state has no attitude; or it is an `AxisState`, which
            supports only the third axis.

    Examples:
        >>> lying = ml.RigidState([0.0, 0.0, 5.0], [0.5, 0.5, 0.5, 0.5])  # axis 3 points along x
        >>> ml.observe.Axis().of(jnp.array(0.0), lying, body, None)[0].item()  # in a run: as observe
        1.0
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __check_init__(self) -> None:
        if not np.all(np.isfinite(self.axis)) or not np.any(self.axis):
            raise ValueError(f"axis must be three finite numbers, not all zero, got {shown(self.axis)}.")

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        if isinstance(state, AxisState | FreeAxisState):
            return cp.pack(state.in_one_frame(tuple(map(float, axis)))[0])
        return so3.rotate(attitude_of(state), jnp.asarray(axis, state.momentum.dtype))


class EulerAngles(Observable):
    """The Euler angles of the body, (3,), radians, in the order of the sequence; see `midlie_jax.so3.to_euler`.

    Attributes:
        sequence: three axes; by default "ZYX", for yaw, pitch and roll.
        frame: a function of time that returns the quaternion of a frame, (4,), to which the angles refer, such as
            `orbit.lvlh`; None for the space frame.

    Raises:
        ValueError: another sequence. In a run: the state has no attitude.

    Examples:
        >>> orbit = ml.orbits.CircularOrbit([7e6, 0.0, 0.0], [0.0, 1.0, 0.0], 3.986e14)
        >>> level = ml.RigidState([0.0, 0.0, 0.0], orbit.lvlh(0.0))
        >>> jnp.abs(ml.observe.EulerAngles(frame=orbit.lvlh).of(jnp.array(0.0), level, body, None)).round(6)
        Array([0., 0., 0.], dtype=float64)
    """

    sequence: str = eqx.field(static=True, default="ZYX")
    frame: Any = None

    def __check_init__(self) -> None:
        so3.to_euler(jnp.array([1.0, 0.0, 0.0, 0.0]), self.sequence)  # which raises for another sequence

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        attitude = attitude_of(state)
        if self.frame is not None:
            frame = jnp.asarray(self.frame(t), attitude.dtype)
            attitude = so3.multiply(so3.conjugate(frame), attitude)
        return so3.to_euler(attitude, self.sequence)
