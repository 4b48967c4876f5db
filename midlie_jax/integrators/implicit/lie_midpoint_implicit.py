"""LIEMID[I]: the implicit midpoint rule on the group, with the torque at mid-step."""

import equinox as eqx

from ..._math import components as cp
from .torque_half_way import TorqueHalfWay


class LieMidpointImplicit(TorqueHalfWay):
    """I Psi = h (exp(-Psi/2) Pi0 + (h/2) Tm), Pi1 = exp(-Psi) Pi0 + h exp(-Psi/2) Tm, R1 = R0 exp(Psi).

    Tm is the torque at t + h/2 and R0 exp(Psi/2). Order 2, symmetric; Krysl 2004.
    """

    name: str = eqx.field(static=True, default="LIEMID[I]")

    def mean_momentum(self, start: cp.Vector, half: cp.Quaternion, impulse: cp.Vector) -> cp.Vector:
        return cp.add(cp.rotate_back(half, start), cp.scale(0.5, impulse))
