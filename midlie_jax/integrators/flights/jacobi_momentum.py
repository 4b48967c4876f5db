"""The momentum of JACOBI's flight, for states without a pose, and the invariants of the whole flight.

The angle of the body about its momentum takes most of the run time, and the momentum does not need it: in the notation
of `jacobi.py`, Pi_l(1) = N_l / D is rational. Subtracting Pi_l(0) from this quotient would leave the rounding errors of
Pi, which have a bias, and the length of the momentum would drift. The change is therefore computed from the momentum X
at the middle of the flight. With S, E_l and D for half the flight,

    N_l = Pi_l E_m E_n + a_l S Pi_m Pi_n E_l,    X_l = N_l / D(Pi)
    Pi_l(1) - Pi_l(0) = 2 a_l S X_m X_n E_l / D(X),    Pi_l(1) + Pi_l(0) = 2 X_l E_m E_n / D(X)

The change is a product, so its rounding errors are proportional to it. It is orthogonal to the sum because a_1 + a_2 +
a_3 = 0, which conserves |Pi|; the energy is conserved in the same way. Half a flight also needs fewer terms of the
series.

No root is needed: T = E_1 E_2 E_3 has its own series, and E_l N_l = Pi_l T + a_l S E_l^2 Pi_m Pi_n as well as T^2 D(X)
contain only T and the squares of E_l.
"""

from typing import NamedTuple

import jax
from jax import Array

from ..._math import components as cp
from ..._math.weierstrass import moment_functions, sigma_functions
from ..._xla.fusion import fuse_second_derivative
from ...model.inertia import Inertia

# The square of the relative change of the momentum below which a change counts as short: even if each of 1e5 steps
# repeats the error of its length, other rounding errors are larger.
_SHORT = 2.0**-10
_NO_TURN = 1e-30  # keeps a denominator from vanishing; the square, in radians, of a negligible rotation


class Invariants(NamedTuple):
    """Constants of the motion of a body with momentum y, in the notation of the module `jacobi`.

    Choosing i as the axis of the middle moment keeps the invariants of any real body below |Omega|^2.

    Attributes:
        k: component j is a_k, component k is -a_j, component i is 0.
        a_jk: a_j a_k.
        squares, total: the squares of the components of y, and their sum.
        K: a_k y_j^2 - a_j y_k^2, zero on the separatrix.
        differences: wp(v) - e_l.
        wp, g2, g3: wp(v) and the invariants of Weierstrass's function.
    """

    k: cp.Vector
    a_jk: Array
    squares: cp.Vector
    total: Array
    K: Array
    differences: cp.Vector
    wp: Array
    g2: Array
    g3: Array

    @classmethod
    def of(cls, inertia: Inertia, y: cp.Vector) -> "Invariants":
        middle = inertia.middle
        k = cp.cross(inertia.gaps, middle)
        a_jk = -(k[0] * k[1] + k[1] * k[2] + k[2] * k[0])
        squares = cp.times(y, y)
        total = squares[0] + squares[1] + squares[2]
        K = cp.dot(k, squares)
        differences = cp.subtract(cp.scale(a_jk * total, middle), cp.scale(K, k))
        wp = (differences[0] + differences[1] + differences[2]) * (1 / 3)
        roots = cp.subtract((wp, wp, wp), differences)
        g2, g3 = 2 * cp.dot(roots, roots), 4 * roots[0] * roots[1] * roots[2]
        return cls(k, a_jk, squares, total, K, differences, wp, g2, g3)


class HalfWay(NamedTuple):
    """The momentum at the middle of a flight, and the functions of half the flight.

    Attributes:
        y: the momentum at the start, in units in which half the flight takes a unit of time.
        invariants: the invariants of the motion, in these units.
        s, t: S and T = E_1 E_2 E_3.
        v: V.
        d: D at the start.
        momentum: E_l N_l, in units of the momentum.
        moved: `momentum` in units of y.
        squares, pairs: E_l^2, and T^2 / E_l^2.
        others: (T D X_l)^2.
        weight: a_j a_k S^2.
        below: T^2 D^2 D(X).
    """

    y: cp.Vector
    invariants: Invariants
    s: Array
    t: Array
    v: Array
    d: Array
    momentum: cp.Vector
    moved: cp.Vector
    squares: cp.Vector
    pairs: cp.Vector
    others: cp.Vector
    weight: Array
    below: Array

    @classmethod
    def of(cls, inertia: Inertia, h: Array, momentum: cp.Vector, radius: float) -> "HalfWay":
        y = inertia.travel(h / 2, momentum)
        found = Invariants.of(inertia, y)
        found, y = fuse_second_derivative((found, y))
        s, w, t = fuse_second_derivative(sigma_functions(found.g2, found.g3, radius / 2))
        s_squared = s * s
        v = w - found.wp * s_squared
        weight = found.a_jk * s_squared
        d = v + weight * (found.total - cp.dot(inertia.middle, found.squares))
        squares = cp.add((v, v, v), cp.scale(s_squared, found.differences))
        pairs = (squares[1] * squares[2], squares[2] * squares[0], squares[0] * squares[1])
        crossed = (y[1] * momentum[2], y[2] * momentum[0], y[0] * momentum[1])
        pulls = cp.times(inertia.gaps, squares)
        half_way = cp.add(cp.scale(t, momentum), cp.scale(s, cp.times(pulls, crossed)))
        moved = inertia.travel(h / 2, half_way)
        others = cp.times(pairs, cp.times(moved, moved))
        below = v * (t * d) * (t * d) + weight * (others[0] + others[1] + others[2] - cp.dot(inertia.middle, others))
        return cls(y, found, s, t, v, d, half_way, moved, squares, pairs, others, weight, below)


def momentum_change(inertia: Inertia, h: Array, momentum: cp.Vector, radius: float) -> tuple[cp.Vector, Invariants]:
    """The change of the momentum in a flight of time h, and the invariants of half the flight.

    It is exact to rounding if h |Omega| and the roots of the invariants of the whole flight are at most `radius`.
    """
    half = fuse_second_derivative(HalfWay.of(inertia, h, momentum, radius))
    pulls = cp.times(inertia.gaps, half.squares)
    sides = (pulls[0] * half.moved[1], pulls[1] * half.moved[2], pulls[2] * half.moved[0])
    direction = cp.times(sides, (half.momentum[2], half.momentum[0], half.momentum[1]))
    factor = 2 * half.s * half.t * cp.reciprocal(half.below)
    moving = cp.times(sides, (half.moved[2], half.moved[0], half.moved[1]))  # the direction in units of y
    total = half.invariants.total
    error = _error_of_length(*jax.lax.stop_gradient((half.y, total, cp.scale(factor, moving))))
    return cp.scale(factor - factor * error, direction), half.invariants


def lag(inertia: Inertia, h: Array, momentum: cp.Vector, radius: float) -> Array:
    """The integral of (h - t) Pi_1 Pi_2 Pi_3 over a flight, with momenta in units of the largest moment.

    With t counted from the middle of the flight, it is h/2 times the integral of Pi_1 Pi_2 Pi_3 minus the integral of t
    Pi_1 Pi_2 Pi_3. The first integral times 2 a_l is the change of Pi_l^2. Because a_1 a_2 a_3 Pi_1 Pi_2 Pi_3 = wp'/2,
    `moment_functions` gives the second, in which p^2 - g2/12, 2 g2 p + 3 g3 and 18 g3 p + g2^2 are a_1 a_2 a_3 times
    `change`/3, `first` and `second` below.
    """
    half = HalfWay.of(inertia, h, momentum, radius)
    a, found = inertia.gaps, half.invariants
    x, y, z = half.moved
    rate = cp.scale(inertia.per_unit, half.momentum)  # `moved` per h/2; one such factor replaces the division by h/2
    per = cp.reciprocal(half.t * half.d)
    squares = cp.scale(per * per, half.others)  # X_l^2
    rates = cp.times(cp.scale(per * per, cp.times(half.pairs, half.moved)), rate)
    per_product = per * per * per * half.t * half.t
    product, product_rate = x * y * z * per_product, x * y * rate[2] * per_product
    change = a[0] * squares[1] * rates[2] + a[1] * squares[2] * rates[0] + a[2] * squares[0] * rates[1]
    across = squares[0] + squares[1] + squares[2] - cp.dot(inertia.middle, squares)
    p = found.wp - found.a_jk * across
    first = 4 * p * change - 12 * a[0] * a[1] * a[2] * product * product_rate
    second = 6 * p * first - 4 * found.g2 * change
    A, B, C = moment_functions(found.g2, found.g3, radius / 2)
    per_d = cp.reciprocal(half.v + half.weight * across)
    return (2 * half.s * half.t * product_rate - 0.5 * (A / 3 * change + B * first + C * second)) * per_d * per_d


def _error_of_length(y: cp.Vector, total: Array, change: cp.Vector) -> Array:
    """The relative error in the length of a change, which would make |y| drift; total is |y|^2.

    In all steps of a free body the functions of the step are the same, and so are their rounding errors: if these make
    the change too long, |Pi| and the energy grow steadily. A change d conserves |y| if y . d + |d|^2 / 2 = 0. This
    equation determines the length of d well only if d is long, and only then does an error of the length matter. The
    weights therefore leave a short change unchanged. The error is some units in the last place, so five digits of it
    suffice.
    """
    square = 0.5 * cp.dot(change, change)
    return (cp.dot(y, change) + square) * cp.rough_reciprocal(square + (_SHORT * total + _NO_TURN))
