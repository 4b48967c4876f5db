"""The derivative of the rotation of a free body, in closed form from the derivative of its momentum.

In a time h a free body rotates by Q, and its momentum in the body frame changes from Pi to Q^T Pi. Let c = 1/I, (l, m,
n) cyclic, a_l = c_n - c_m, so that Pi_l' = a_l Pi_m Pi_n, and let a small change of c, h and Pi change Q to (1 + [chi])
Q, as in `exact`. The momentum in space does not change during the motion, so

    chi x Pi = -z,    z = (Q - 1) dPi + Q d(Q^T Pi - Pi)

Only the component of chi along Pi is missing. In the body frame, eta = Q^T chi grows by eta' = dOmega + eta x Omega,
so (Pi . eta)' = Pi . dOmega = Omega . dPi + sum Pi_l^2 dc_l. The energy is constant, therefore Omega . dPi differs from
its initial value by sum (Pi_l(0)^2 - Pi_l^2) dc_l / 2; and the derivative of Pi_l^2 is 2 a_l Pi_1 Pi_2 Pi_3:

    Pi . chi = h Omega . dPi + Omega . Pi dh + sum (h Pi_l^2 + a_l L) dc_l,    L = int_0^h (h - t) Pi_1 Pi_2 Pi_3 dt

The `lag` L is of second order in h. The derivative of the angle about the momentum, the most expensive part of a
flight, is never needed. This derivation was made for this package; the tests compare it with derivatives of the
formulas of the flight and with 50-digit references.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero

from ..._math import components as cp
from ...model.inertia import Inertia

# The square of the rotation, in radians, up to which only the derivative with respect to the momentum matters.
_NO_TURN = {"float64": 1e-280, "float32": 1e-28}


class Changes(NamedTuple):
    """Tangents of the arguments of a flight, each None if it does not change; `spins` of the inverse moments in units
    of the largest moment.
    """

    spins: cp.Vector | None
    h: Array | None
    momentum: cp.Vector

    @classmethod
    def of(cls, inertia: Inertia, inertia_tangent: Any, h: Any, momentum: Any) -> "Changes":
        """The changes; tangents may be symbolic zeros. Those of the inverse moments determine those of `Inertia`."""
        inverses, spins = inertia_tangent.inverses, None
        if not all(map(is_zero, inverses)):
            spins = cp.scale(cp.largest(inertia.moments), with_zeros(inverses, inertia.inverses))
        return cls(spins, None if is_zero(h) else h, with_zeros(momentum, inertia.inverses))

    def gaps(self) -> cp.Vector:
        assert self.spins is not None
        x, y, z = self.spins
        return z - y, x - z, y - x


def is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def with_zeros(tangents: Any, primals: Any) -> Any:
    return jax.tree.map(lambda t, p: jnp.zeros_like(p) if is_zero(t) else t, tangents, primals, is_leaf=is_zero)


def turn_of(
    inertia: Inertia,
    h: Array,
    momentum: cp.Vector,
    increment: cp.Quaternion,
    changes: Changes,
    momentum_change: cp.Vector,
    lag: Array | None,
) -> cp.Vector:
    """The chi of a change of the arguments of a flight, from its rotation and the tangent of the change of the
    momentum.

    `lag` is the L of the module docstring, for momenta in units of the largest moment; needed if the inverse moments
    change.
    """
    # With the momentum in units of an angle, nothing overflows or underflows in any user units.
    y = inertia.travel(h, momentum)
    total = cp.dot(y, y)
    # If the rotation vanishes, the formula would divide by zero; the term of first order in h is then exact.
    at_rest = total <= _NO_TURN[str(total.dtype)]
    axis = cp.scale(h * cp.reciprocal(jnp.where(at_rest, jnp.ones_like(total), total)), y)
    per = cp.scale(inertia.per_unit, axis)

    turn = cp.times(inertia.spins, y)
    along = cp.dot(cp.scale(inertia.per_unit, turn), changes.momentum)
    slow = cp.times(cp.scale(h * inertia.per_unit, inertia.spins), changes.momentum)
    if changes.h is not None or changes.spins is not None:
        scaled = cp.scale(inertia.per_unit, momentum)
        if changes.h is not None:
            along = along + changes.h * cp.dot(cp.times(inertia.spins, scaled), scaled)
        if changes.spins is not None:
            assert lag is not None
            weights = cp.add(cp.times(scaled, y), cp.scale(lag, inertia.gaps))
            along = along + cp.dot(weights, changes.spins)
    z = cp.add(momentum_change, cp.unit_rotation_change(increment, cp.add(changes.momentum, momentum_change)))
    fast = cp.add(cp.scale(along, axis), cp.cross(z, per))
    a, b, c = (jnp.where(at_rest, one, other) for one, other in zip(slow, fast, strict=True))
    return a, b, c
