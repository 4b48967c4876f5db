"""The paper's flight: the midpoint rule on the group, with the body seen from half way.

    I Psi = h exp(-Psi/2) Pi0,    R1 = R0 exp(Psi),    Pi1 = exp(-Psi) Pi0

Order 2, reversible, keeps the spatial momentum exactly. It is not symplectic, against what is often said: the
defect of its step is of third order in h (see `tests/test_flights.py`).
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from .. import _components as cp
from .._fuse import together
from .._half_turn import LARGEST_SQUARE, dexp_weights, half_turn
from ..bodies import RigidBody
from .base import Flight, Inertia

# Pairs of steps from the start below; enough for |Psi| <= 1.5 and the moments of any real body, ratios of 1e6 included.
_PAIRS = 3
_RESIDUAL_LIMIT = 8  # units of eps |Pi|


class LieMidpoint(Flight):
    """I Psi = h exp(-Psi/2) Pi0, order 2 (Krysl 2004; Krysl & Endres 2005).

    Says False where the residual exceeds 8 eps |Pi|, or the step turned by more than 2.4 radians.
    """

    name: ClassVar[str] = "LIEMID"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = False
    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 2

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        # w = Psi/2 and y = h Pi0 solve 2 I w = exp(-w) y.
        double = cp.scale(2, inertia.relative)
        y = cp.scale(h * inertia.per_unit, momentum)

        w = _half_angle(double, y)
        half = half_turn(w)
        middle = cp.rotate_back(half, momentum)
        error = cp.subtract(cp.times(double, w), cp.scale(h * inertia.per_unit, middle))
        limit = _RESIDUAL_LIMIT * cp.epsilon(w[0])
        ok = (cp.dot(error, error) <= limit * limit * cp.dot(y, y)) & (cp.dot(w, w) <= LARGEST_SQUARE)
        return cp.multiply(half, half), cp.rotate_back(half, middle), ok


@jax.custom_jvp
def _half_angle(double: cp.Vector, y: cp.Vector) -> cp.Vector:
    """The root w of 2 I w = exp(-w) y, with the derivative of the implicit function, of any order."""
    return _iterate(double, y, free_start(double, y))


@_half_angle.defjvp
def _half_angle_jvp(
    primals: tuple[cp.Vector, cp.Vector], tangents: tuple[cp.Vector, cp.Vector]
) -> tuple[cp.Vector, cp.Vector]:
    """J dw = exp(-w) dy - 2 dI w, where exp(-w) y is 2 I w by now."""
    double, y = primals
    w = together(_half_angle(double, y))
    inverse = cp.Inverse3.of(_columns(double, cp.times(double, w), _dexp_columns(w, exact=True)))
    change = cp.subtract(cp.rotate_back(half_turn(w), tangents[1]), cp.times(tangents[0], w))
    return w, inverse.times(change)


def free_start(double: cp.Vector, y: cp.Vector) -> cp.Vector:
    """A root of 2 I w = exp(-w) y to second order in |w|: Newton's step from zero."""
    zero, one = jnp.zeros_like(y[0]), jnp.ones_like(y[0])
    identity = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    return cp.Inverse3.of(_columns(double, y, identity)).times(y)


def _iterate(double: cp.Vector, y: cp.Vector, w: cp.Vector) -> cp.Vector:
    """Newton steps, each followed by a second with the same Jacobian: third order for half as much again.

    The derivative of exp(-w) y along d is z x dexp(-w, d) with z = exp(-w) y.
    """
    for _ in range(_PAIRS):
        z = cp.rotate_back(half_turn(w), y)
        inverse = cp.Inverse3.of(_columns(double, z, _dexp_columns(w, exact=False)))
        w = cp.subtract(w, inverse.times(cp.subtract(cp.times(double, w), z)))
        z = cp.rotate_back(half_turn(w), y)
        w = cp.subtract(w, inverse.times(cp.subtract(cp.times(double, w), z)))
    return w


def _columns(
    double: cp.Vector, z: cp.Vector, dexp: tuple[cp.Vector, cp.Vector, cp.Vector]
) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
    """Columns of 2 I - skew(z) dexp."""
    a, b, c = (cp.cross(z, column) for column in dexp)
    return (double[0] - a[0], -a[1], -a[2]), (-b[0], double[1] - b[1], -b[2]), (-c[0], -c[1], double[2] - c[2])


def _dexp_columns(w: cp.Vector, exact: bool) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
    """Columns of dexp(-w, .) = 1 - b skew(w) + c skew(w)^2."""
    x = cp.dot(w, w)
    b, c = dexp_weights(x, exact)
    bw, cw = cp.scale(b, w), cp.scale(c, w)
    diagonal = 1 - c * x
    xy, xz, yz = cw[0] * w[1], cw[0] * w[2], cw[1] * w[2]
    return (
        (diagonal + cw[0] * w[0], xy - bw[2], xz + bw[1]),
        (xy + bw[2], diagonal + cw[1] * w[1], yz - bw[0]),
        (xz - bw[1], yz + bw[0], diagonal + cw[2] * w[2]),
    )
