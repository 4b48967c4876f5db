"""The exact flight of any body in closed form: Jacobi's solution by its addition theorems.

The momentum's components are elliptic functions of time. So after a step they are rational in what they were before
and in the functions of the step alone, and the current values need no inverse function: they are read off the
momentum itself. The angle about the spatial momentum is an elliptic integral of the third kind; its addition theorem
leaves a function of the step and the argument of a complex number that is rational again. Nothing is sorted, and
nothing happens at the separatrix or where moments are equal: there is no period and no arithmetic-geometric mean,
only three short sums of the step's invariants (`_kernel.weierstrass`), a few roots and a reciprocal.

In a unit of time, with (l, m, n) cyclic, a_l = 1/I_n - 1/I_m so that Pi_l' = a_l Pi_m Pi_n, i the axis of the middle
moment, (i, j, k) cyclic, K = a_k Pi_j^2 - a_j Pi_k^2, and Weierstrass's function of roots e_l with
a_m a_n Pi_l(t)^2 = wp(t - t0) - e_l:

    wp(v) = e_i + a_j a_k |Pi|^2,    wp(v) - e_j = -a_k K,    wp(v) - e_k = a_j K
    S = sigma(1),    E_l^2 = S^2 (wp(1) - e_l),    V = S^2 (wp(1) - wp(v))
    D Pi_l(1) = N_l = Pi_l E_m E_n + a_l S Pi_m Pi_n E_l,    D = E_l^2 - a_m a_n S^2 Pi_l^2, the same for every l
    angle = |Pi|/I_i + arg F + arg Z,    F = sigma(v - 1) exp(zeta(v)) / sigma(v),    |F|^2 = V
    Z = D |Pi|^2 (E_1 + E_2 + E_3) + sum Pi_l N_l E_l - M E_i  +  i |Pi| S (K D + a_k Pi_j N_j - a_j Pi_k N_k)
    M = D |Pi|^2 + Pi . N,    |Z|^2 = V M^2

The angle is that about Pi after the shortest way from one momentum to the other. Because |F Z| = V M has no root in
it, neither has half the angle, but for a factor that drops out of the normalised quaternion.

C. G. J. Jacobi, J. reine angew. Math. 39 (1850) 293; R. van Zon, J. Schofield, J. Comput. Phys. 225 (2007) 145;
E. Celledoni, F. Fasso, N. Safstrom, A. Zanna, SIAM J. Sci. Comput. 30 (2008) 2084. These evaluate the functions anew
at each time. The rational step was derived for this package; the tests hold it against `oracles.free_body`.
"""

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from ..._kernel import components as cp
from ..._kernel.short_series import half_angle, half_turn
from ..._kernel.weierstrass import step_functions
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight

# Radians of h |Omega| up to which the sums are exact to rounding.
_REACH = 1.2

Complex = tuple[Array, Array]  # (real, imaginary / |y|): only |y|^2 is ever needed


class Jacobi(Flight):
    """Exact for any moments; symplectic, keeps energy and spatial momentum to rounding.

    Says False where h |Omega| exceeds 1.2 radians; for a body that breaks the triangle inequality, and so can turn
    over faster than it spins, also where an invariant of its motion exceeds the bound that this sets for others.
    """

    name: ClassVar[str] = "JACOBI"
    use: ClassVar[str] = "any body: exact, without a solve"
    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
    per_loop: ClassVar[int] = 2

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        spins, y = inertia.spins, inertia.travel(h, momentum)
        turn = cp.times(spins, y)
        size = cp.dot(turn, turn)
        # Where the momentum vanishes so does the axis of the angle; there two terms in h are the motion to rounding.
        still = size <= cp.epsilon(h)
        change = cp.times(spins, cp.cross(y, turn))
        little = half_turn(_where(still, cp.add(cp.scale(0.5, turn), cp.scale(0.25, change)), cp.scale(0, turn)))
        large, fine = _turn(inertia, spins, _where(still, cp.times(inertia.middle, inertia.relative), y))
        little = cp.square(little)
        increment = (jnp.where(still, little[0], large[0]), *_where(still, little[1:], large[1:]))
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), fine & (size <= _REACH**2)


def _turn(inertia: Inertia, spins: cp.Vector, y: cp.Vector) -> tuple[cp.Quaternion, Array]:
    """The rotation in a unit of time of a body with momentum y, in units of the largest moment.

    The axis of the middle moment as pole of the angle keeps the invariants of any real body below |Omega|^2.
    """
    a, middle = inertia.gaps, inertia.middle
    k = cp.cross(a, middle)  # a_k on the axis j, -a_j on the axis k
    depth = -(k[0] * k[1] + k[1] * k[2] + k[2] * k[0])  # a_j a_k
    squares = cp.times(y, y)
    total = squares[0] + squares[1] + squares[2]
    excess = cp.dot(k, squares)

    below = cp.subtract(cp.scale(depth * total, middle), cp.scale(excess, k))
    pole = (below[0] + below[1] + below[2]) * (1 / 3)
    roots = cp.subtract((pole, pole, pole), below)
    g2, g3 = 2 * cp.dot(roots, roots), 4 * roots[0] * roots[1] * roots[2]
    s, w, odd = step_functions(pole, g2, g3, _REACH)

    v = w - pole * s * s
    e = (_root(v + below[0] * s * s), _root(v + below[1] * s * s), _root(v + below[2] * s * s))
    d = v + depth * s * s * (total - cp.dot(middle, squares))
    products = (y[1] * y[2] * e[0], y[2] * y[0] * e[1], y[0] * y[1] * e[2])
    n = cp.add(cp.times(y, (e[1] * e[2], e[2] * e[0], e[0] * e[1])), cp.scale(s, cp.times(a, products)))

    # The two complex numbers, and M, over |y|^2.
    per_total = cp.reciprocal(total)
    along = cp.scale(per_total, cp.times(y, n))
    both = d + along[0] + along[1] + along[2]
    imaginary = -2 * depth * excess * odd
    shift = _root(v - total * imaginary * imaginary), imaginary
    rest = (
        d * (e[0] + e[1] + e[2]) + cp.dot(along, e) - both * cp.dot(middle, e),
        s * (per_total * excess * d + cp.dot(k, along)),
    )
    real, imaginary = _times(shift, rest, total)
    cosine, sine = _times((v * both + real, imaginary), _half(cp.dot(middle, spins), total), total)

    across = _across(a, y, below, e, s)
    x = cp.add(cp.scale(cosine * per_total, across), cp.scale(sine, cp.add(cp.scale(d, y), n)))
    scalar = cosine * both
    factor = cp.inverse_root(scalar * scalar + cp.dot(x, x))
    fine = cp.largest(below) <= _REACH**2
    return (factor * scalar, factor * x[0], factor * x[1], factor * x[2]), fine


def _across(a: cp.Vector, y: cp.Vector, below: cp.Vector, e: cp.Vector, s: Array) -> cp.Vector:
    """n x y, of two vectors that are nearly parallel, with an error in proportion to it and not to both.

    (n x y)_l = y_m y_n E_l (E_n - E_m) + S y_l (a_m y_n^2 E_m - a_n y_m^2 E_n), and E_n^2 - E_m^2 is known without a
    difference of roots: S^2 times that of `below`.
    """
    sums = (e[1] + e[2], e[2] + e[0], e[0] + e[1])
    others = (sums[1] * sums[2], sums[2] * sums[0], sums[0] * sums[1])
    share = s * s * cp.reciprocal(sums[0] * others[0])
    change = cp.times(
        cp.scale(share, others), cp.subtract((below[2], below[0], below[1]), (below[1], below[2], below[0]))
    )
    first = cp.times((y[1] * y[2], y[2] * y[0], y[0] * y[1]), cp.times(e, change))
    pull = cp.times(a, e)
    square = cp.times(y, y)
    turn = (
        pull[1] * square[2] - pull[2] * square[1],
        pull[2] * square[0] - pull[0] * square[2],
        pull[0] * square[1] - pull[1] * square[0],
    )
    return cp.add(first, cp.scale(s, cp.times(y, turn)))


def _half(rate: Array, total: Array) -> Complex:
    """exp of half the angle rate |y|, from a quarter of it, for which the series are short."""
    square = rate * rate * total / 4
    cosine, sine = half_angle(square)
    return 1 - 2 * square * sine * sine, rate * cosine * sine


def _times(a: Complex, b: Complex, total: Array) -> Complex:
    return a[0] * b[0] - total * a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _where(choice: Array, a: cp.Vector, b: cp.Vector) -> cp.Vector:
    return jnp.where(choice, a[0], b[0]), jnp.where(choice, a[1], b[1]), jnp.where(choice, a[2], b[2])


def _root(x: Array) -> Array:
    return x * cp.inverse_root(x)
