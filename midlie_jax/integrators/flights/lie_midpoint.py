"""The paper's flight: the midpoint rule on the group, with the momentum in the body frame at mid-step.

    I Psi = h exp(-Psi/2) Pi0,    R1 = R0 exp(Psi),    Pi1 = exp(-Psi) Pi0

The flight is of order 2, reversible, and conserves the spatial momentum exactly. It is not symplectic: the symplectic
defect of a step is of third order in h (`docs/reports/exact-flight.md`).

The unknown of the solve is u = tan(|Psi|/4) n, the Rodrigues vector of half the rotation, Psi/2, about the axis n. With
exp(-Psi/2) = (1 + [u])^-1 (1 - [u]), the equation is rational in u except for one arctangent:

    g (v + u x v) = y - u x y,    v = 4 I u,    g = atan|u| / |u|,    y = h Pi0
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.short_series import LARGEST_TANGENT_SQUARE, LARGEST_TURN, arctangent, arctangent_slope, share_of_one
from ..._xla.fusion import split
from ...model.inertia import Inertia
from ..verdict import verdict
from .base import JudgedFlight

# For each dtype: the number of Newton steps with the plain Jacobian, then with each full Jacobian. They suffice for
# |Psi| <= 1.5 and the moments of any real body, up to ratios of 1e6 (for the most slender bodies, one flight in 1e5 is
# rejected).
STEPS = {"float64": (1, (2, 2)), "float32": (2, (3,))}
_RESIDUAL_LIMIT = 8  # units of eps |Pi|
_SMALL_RESIDUAL = 1e-4  # in units of |Pi|; a residual below this is assumed to keep decreasing at the same rate


class LieMidpoint(JudgedFlight):
    """I Psi = h exp(-Psi/2) Pi0, order 2 (Krysl 2004; Krysl & Endres 2005).

    The flight reports False in `ok` if the solve did not converge, the rotation exceeds 2.4 radians, or h |Omega| at
    the start exceeds 12 radians.

    Examples:
        >>> ml.method(ml.flights.LieMidpoint(), "EA").name
        'LIEMID[EA]'
    """

    name: ClassVar[str] = "LIEMID"
    use: ClassVar[str] = "the paper's flight, for comparison with the paper; not symplectic"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = False
    solves: ClassVar[int] = 1
    per_loop: ClassVar[int] = 2
    long_derivative: ClassVar[bool] = False
    reach: ClassVar[float] = LARGEST_TURN

    def judged(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        quadruple = cp.scale(4, inertia.relative)
        y = inertia.travel(h, momentum)
        u, converged = _root(quadruple, y, *_solve(*jax.lax.stop_gradient((quadruple, y))))
        x = cp.dot(u, u)
        factor = share_of_one(x)
        increment = ((1 - x) * factor, *cp.scale(2 * factor, u))
        ok = verdict(converged, (x, LARGEST_TANGENT_SQUARE), inertia.bound_of_first_root(y))
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok


@jax.custom_jvp
def _root(quadruple: cp.Vector, y: cp.Vector, u: cp.Vector, converged: Array) -> tuple[cp.Vector, Array]:
    """The root u, with derivatives of any order by the implicit function theorem, and `converged` unchanged."""
    return u, converged


@_root.defjvp
def _root_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """J du = dy - u x dy - g (dv + u x dv), dv = 4 dI u."""
    quadruple, y, *_ = primals
    u, converged = split(_root(*primals))  # both, or the loop of the step would solve again for `converged`
    x = cp.dot(u, u)
    g = arctangent(x, exact=True)
    inverse = cp.Inverse3.of(_columns(quadruple, y, u, g, arctangent_slope(x, exact=True)))
    dv = cp.scale(g, cp.times(tangents[0], u))
    right = cp.subtract(cp.subtract(tangents[1], dv), cp.cross(u, cp.add(tangents[1], dv)))
    return (u, converged), (inverse.times(right), tangents[3])


def _solve(quadruple: cp.Vector, y: cp.Vector) -> tuple[cp.Vector, Array]:
    u = cp.scale(0.5, free_start(cp.scale(0.5, quadruple), y))
    first, more = STEPS[str(y[0].dtype)]
    u, converged = _improve(quadruple, y, u, _plain_columns(quadruple, y, u), first, exact=False)
    for n, steps in enumerate(more, start=1):
        exact, x = n == len(more), cp.dot(u, u)
        columns = _columns(quadruple, y, u, arctangent(x, exact), arctangent_slope(x, exact=False))
        u, converged = _improve(quadruple, y, u, columns, steps, exact)
    return u, converged


def _improve(
    quadruple: cp.Vector, y: cp.Vector, u: cp.Vector, columns: cp.Columns, steps: int, exact: bool
) -> tuple[cp.Vector, Array]:
    """The result of Newton steps with one Jacobian, and whether they converged; each reduces the residual by at least
    the factor of the one before, which bounds the last residual.
    """
    inverse = cp.Inverse3.of(columns, exact=False)
    previous = current = jnp.zeros_like(y[0])
    for _ in range(steps):
        residual = _residual(quadruple, y, u, exact)
        u = cp.subtract(u, inverse.times(residual))
        previous, current = current, cp.dot(residual, residual)
    size = cp.dot(y, y)
    limit = (_RESIDUAL_LIMIT * cp.epsilon(size)) ** 2 * size
    return u, (current <= limit) | (current * current <= limit * jnp.minimum(previous, _SMALL_RESIDUAL**2 * size))


def _residual(quadruple: cp.Vector, y: cp.Vector, u: cp.Vector, exact: bool) -> cp.Vector:
    v = cp.scale(arctangent(cp.dot(u, u), exact), cp.times(quadruple, u))
    return cp.add(cp.subtract(v, y), cp.cross(u, cp.add(v, y)))


def _columns(quadruple: cp.Vector, y: cp.Vector, u: cp.Vector, g: Array, slope: Array) -> cp.Columns:
    """Columns of g (4 I + [u] 4 I - [v]) + 2 g' (v + u x v) u^T - [y], v = 4 I u."""
    v = cp.times(quadruple, u)
    along = cp.scale(2 * slope, cp.add(v, cp.cross(u, v)))
    plain = _plain_columns(cp.scale(g, quadruple), y, u)
    a, b, c = (cp.add(column, cp.scale(part, along)) for column, part in zip(plain, u, strict=True))
    return a, b, c


def _plain_columns(k: cp.Vector, y: cp.Vector, u: cp.Vector) -> cp.Columns:
    """Columns of K + [u] K - [K u] - [y], K = 4 g I: the Jacobian for constant g, correct to first order in u."""
    a, b, c = cp.add(cp.times(k, u), y)
    return (
        (k[0], k[0] * u[2] - c, b - k[0] * u[1]),
        (c - k[1] * u[2], k[1], k[1] * u[0] - a),
        (k[2] * u[1] - b, a - k[2] * u[0], k[2]),
    )


def free_start(double: cp.Vector, y: cp.Vector) -> cp.Vector:
    """A root of 2 I w = exp(-w) y to second order in |w|, by one Newton step from zero: (2 I - [y]) w = y."""
    (k, m, n), (a, b, c) = double, y
    return cp.Inverse3.of(((k, -c, b), (c, m, -a), (-b, a, n)), exact=False).times(y)
