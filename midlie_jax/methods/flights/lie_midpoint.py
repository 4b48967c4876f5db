"""The paper's flight: the midpoint rule on the group, with the body seen from half way.

    I Psi = h exp(-Psi/2) Pi0,    R1 = R0 exp(Psi),    Pi1 = exp(-Psi) Pi0

Order 2, reversible, keeps the spatial momentum exactly. It is not symplectic, against what is often said: the
defect of its step is of third order in h (see `tests/test_flights.py`).

Solved for u = tan(|Psi|/4) n, the Rodrigues vector of the half turn Psi/2, in which it is rational but for one
arctangent, from exp(-Psi/2) = (1 + [u])^-1 (1 - [u]):

    g (v + u x v) = y - u x y,    v = 4 I u,    g = atan|u| / |u|,    y = h Pi0
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from ..._kernel import components as cp
from ..._kernel.fusion import fuse
from ..._kernel.short_series import LARGEST_TANGENT_SQUARE, arctangent, arctangent_slope, share_of_one
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight

# Steps with the plain Jacobian at the start, and with each full one after it: enough for |Psi| <= 1.5 and the moments
# of any real body, ratios of 1e6 included (of the slenderest, one in 1e5 is refused).
_STEPS = {"float64": (1, (2, 2)), "float32": (2, (3,))}
_RESIDUAL_LIMIT = 8  # units of eps |Pi|
_NEAR = 1e-4  # the share of |Pi| below which residuals are trusted to shrink as they did


class LieMidpoint(Flight):
    """I Psi = h exp(-Psi/2) Pi0, order 2 (Krysl 2004; Krysl & Endres 2005).

    Says False where the solve did not settle, or the flight turned by more than 2.4 radians or began with more than 12.
    """

    name: ClassVar[str] = "LIEMID"
    use: ClassVar[str] = "the paper's flight, for comparison with the paper; not symplectic"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = False
    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 2

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        quadruple = cp.scale(4, inertia.relative)
        y = inertia.travel(h, momentum)
        u, settled = _solve(*jax.lax.stop_gradient((quadruple, y)))
        u = _root(quadruple, y, u)
        x = cp.dot(u, u)
        share = share_of_one(x)
        increment = ((1 - x) * share, *cp.scale(2 * share, u))
        ok = settled & (x <= LARGEST_TANGENT_SQUARE) & inertia.on_first_root(y)
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), ok


@jax.custom_jvp
def _root(quadruple: cp.Vector, y: cp.Vector, u: cp.Vector) -> cp.Vector:
    """The root u, with the derivative of the implicit function, of any order."""
    del quadruple, y
    return u


@_root.defjvp
def _root_jvp(primals: Any, tangents: Any) -> tuple[cp.Vector, cp.Vector]:
    """J du = dy - u x dy - g (dv + u x dv), dv = 4 dI u."""
    quadruple, y, _ = primals
    u = fuse(_root(*primals))
    x = cp.dot(u, u)
    share = arctangent(x, exact=True)
    inverse = cp.Inverse3.of(_columns(quadruple, y, u, share, arctangent_slope(x, exact=True)))
    dv = cp.scale(share, cp.times(tangents[0], u))
    right = cp.subtract(cp.subtract(tangents[1], dv), cp.cross(u, cp.add(tangents[1], dv)))
    return u, inverse.times(right)


def _solve(quadruple: cp.Vector, y: cp.Vector) -> tuple[cp.Vector, Array]:
    """The root u, and whether the solve settled."""
    u = cp.scale(0.5, free_start(cp.scale(0.5, quadruple), y))
    first, more = _STEPS[str(y[0].dtype)]
    u, settled = _improve(quadruple, y, u, _plain_columns(quadruple, y, u), first, exact=False)
    for n, steps in enumerate(more, start=1):
        exact, x = n == len(more), cp.dot(u, u)
        columns = _columns(quadruple, y, u, arctangent(x, exact), arctangent_slope(x, exact=False))
        u, settled = _improve(quadruple, y, u, columns, steps, exact)
    return u, settled


def _improve(
    quadruple: cp.Vector, y: cp.Vector, u: cp.Vector, columns: cp.Columns, steps: int, exact: bool
) -> tuple[cp.Vector, Array]:
    """Newton's steps with one Jacobian, and if settled.

    Each leaves a residual less by a factor no worse than the one before it: the last is judged without being computed.
    """
    inverse = cp.Inverse3.of(columns, exact=False)
    before = now = jnp.zeros_like(y[0])
    for _ in range(steps):
        residual = _residual(quadruple, y, u, exact)
        u = cp.subtract(u, inverse.times(residual))
        before, now = now, cp.dot(residual, residual)
    size = cp.dot(y, y)
    limit = (_RESIDUAL_LIMIT * cp.epsilon(size)) ** 2 * size
    return u, (now <= limit) | (now * now <= limit * jnp.minimum(before, _NEAR**2 * size))


def _residual(quadruple: cp.Vector, y: cp.Vector, u: cp.Vector, exact: bool) -> cp.Vector:
    v = cp.scale(arctangent(cp.dot(u, u), exact), cp.times(quadruple, u))
    return cp.add(cp.subtract(v, y), cp.cross(u, cp.add(v, y)))


def _columns(quadruple: cp.Vector, y: cp.Vector, u: cp.Vector, g: Array, slope: Array) -> cp.Columns:
    """Columns of g (4 I + [u] 4 I - [v]) + 2 g' (v + u x v) u^T - [y], v = 4 I u."""
    v = cp.times(quadruple, u)
    along = cp.scale(2 * slope, cp.add(v, cp.cross(u, v)))
    a, b, c = _plain_columns(cp.scale(g, quadruple), y, u)
    return (
        cp.add(a, cp.scale(u[0], along)),
        cp.add(b, cp.scale(u[1], along)),
        cp.add(c, cp.scale(u[2], along)),
    )


def _plain_columns(k: cp.Vector, y: cp.Vector, u: cp.Vector) -> cp.Columns:
    """Columns of K + [u] K - [K u] - [y]: the same for g constant, whose slope is of second order in u."""
    a, b, c = cp.add(cp.times(k, u), y)
    return (
        (k[0], k[0] * u[2] - c, b - k[0] * u[1]),
        (c - k[1] * u[2], k[1], k[1] * u[0] - a),
        (k[2] * u[1] - b, a - k[2] * u[0], k[2]),
    )


def free_start(double: cp.Vector, y: cp.Vector) -> cp.Vector:
    """A root of 2 I w = exp(-w) y to second order in |w|: Newton's step from zero, (2 I - [y]) w = y."""
    (k, m, n), (a, b, c) = double, y
    return cp.Inverse3.of(((k, -c, b), (c, m, -a), (-b, a, n)), exact=False).times(y)
