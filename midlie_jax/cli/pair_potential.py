"""The potential of the drift test of Bou-Rabee, Ortolan and Saccon, arXiv 1005.3078.

    V = (d - 1)^2 - 0.3 / dm, d = |R - 1|, dm = |R - Rm|, Rm = exp(2.5 (1, 0, 1) / sqrt(2))

It has a ring of least energy about one attitude and a well at another; the norms are Frobenius norms. For a body that
moves between them, the energy drifts if a method is reversible but not symplectic. The norm of R - 1 is the norm of the
vector part of the attitude quaternion, times the root of 8; in this form nothing cancels near R = 1.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..model import so3
from ..model.state import Time
from ..model.torques import FromPotential
from ..model.torques.base import Torque

_WELL = (np.cos(1.25), np.sin(1.25) / np.sqrt(2.0), 0.0, np.sin(1.25) / np.sqrt(2.0))  # exp(2.5 (1, 0, 1) / sqrt(2))


class PairPotential(Torque):
    """The torque of the potential, by automatic differentiation; singular where R is 1 or Rm."""

    def __call__(self, t: Time, state: Any) -> Array:
        return FromPotential(self.potential)(t, state)

    def potential(self, t: Time, state: Any) -> Array:
        del t
        attitude = state.attitude
        from_well = so3.multiply(so3.conjugate(jnp.asarray(_WELL, attitude.dtype)), attitude)
        return (_distance(attitude) - 1) ** 2 - 0.3 / _distance(from_well)


def _distance(quaternion: Array) -> Array:
    """|R - 1| of the rotation of a unit quaternion."""
    return jnp.sqrt(8 * jnp.sum(quaternion[1:] ** 2))
