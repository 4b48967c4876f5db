"""SW: Simo and Wong's conserving algorithm, ALGO_C1."""

import equinox as eqx

from ..._math import components as cp
from .torque_half_way import TorqueHalfWay


class SW(TorqueHalfWay):
    """I Psi = (h/2)(Pi0 + Pi1), R1 = R0 exp(Psi), Pi1 = exp(-Psi) Pi0 + h exp(-Psi/2) Tm.

    Tm is the torque at t + h/2 and R0 exp(Psi/2). Order 2, symmetric; Simo & Wong, IJNME 31 (1991) 19.
    """

    name: str = eqx.field(static=True, default="SW")

    def mean_momentum(self, start: cp.Vector, half: cp.Quaternion, impulse: cp.Vector) -> cp.Vector:
        end = cp.rotate_back(half, cp.add(cp.rotate_back(half, start), impulse))
        return cp.scale(0.5, cp.add(start, end))
