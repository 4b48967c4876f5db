"""The exact flight of any body in closed form: Jacobi's solution by addition theorems.

`docs/reports/exact-flight.md` derives the formulas and names their sources. For a unit of time, with (l, m, n) cyclic,
a_l = 1/I_n - 1/I_m so that Pi_l' = a_l Pi_m Pi_n, i the axis of the middle moment, (i, j, k) cyclic, K = a_k Pi_j^2 -
a_j Pi_k^2, and Weierstrass's function wp whose roots e_l satisfy a_m a_n Pi_l(t)^2 = wp(t - t0) - e_l:

    wp(v) = e_i + a_j a_k |Pi|^2,    wp(v) - e_j = -a_k K,    wp(v) - e_k = a_j K
    S = sigma(1),    E_l^2 = S^2 (wp(1) - e_l),    V = S^2 (wp(1) - wp(v))
    D Pi_l(1) = N_l = Pi_l E_m E_n + a_l S Pi_m Pi_n E_l,    D = E_l^2 - a_m a_n S^2 Pi_l^2, the same for every l
    angle = |Pi|/I_i + arg F + arg Z,    F = sigma(v - 1) exp(zeta(v)) / sigma(v),    |F|^2 = V
    Z = D |Pi|^2 (E_1 + E_2 + E_3) + sum Pi_l N_l E_l - M E_i  +  i |Pi| S (K D + a_k Pi_j N_j - a_j Pi_k N_k)
    M = D |Pi|^2 + Pi . N,    |Z|^2 = V M^2

The rotation of the body is the shortest rotation between the two momenta, combined with a rotation about Pi by the
angle above.

The momentum alone does not need this angle, which takes most of the run time. Subtracting Pi_l(0) from N_l / D would
leave the rounding errors of Pi, which have a bias, and the length of the momentum would drift. The change is therefore
computed from the momentum X at the middle of the flight. With S, E_l and D for half the flight,

    N_l = Pi_l E_m E_n + a_l S Pi_m Pi_n E_l,    X_l = N_l / D(Pi)
    Pi_l(1) - Pi_l(0) = 2 a_l S X_m X_n E_l / D(X),    Pi_l(1) + Pi_l(0) = 2 X_l E_m E_n / D(X)

The change is a product, so its rounding errors are proportional to it. It is orthogonal to the sum because a_1 + a_2 +
a_3 = 0, which conserves |Pi|; the energy is conserved in the same way. No root is needed: T = E_1 E_2 E_3 has its own
series, and E_l N_l = Pi_l T + a_l S E_l^2 Pi_m Pi_n as well as T^2 D(X) contain only T and the squares of E_l.
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.short_series import half_angle, half_turn
from ..._math.weierstrass import moment_functions, sigma_functions, step_functions
from ..._xla.fusion import fuse_second_derivative
from ...model.inertia import Inertia
from ..verdict import verdict
from .exact import Changes, ExactFlight, Flown, turn_of

# The square of the relative change of the momentum below which a change counts as short: even if each of 1e5 steps
# repeats the error of its length, other rounding errors are larger.
_SHORT = 2.0**-10
_NO_TURN = 1e-30  # keeps a denominator from vanishing; the square, in radians, of a negligible rotation


class Invariants(NamedTuple):
    """Constants of the motion of a body with momentum y, in the notation of the module docstring.

    Choosing i as the axis of the middle moment keeps the invariants of any real body below |Omega|^2.
    """

    k: cp.Vector  # component j is a_k, component k is -a_j, component i is 0
    a_jk: Array  # a_j a_k
    # the squares of the components of y, and their sum
    squares: cp.Vector
    total: Array
    K: Array  # a_k y_j^2 - a_j y_k^2, zero on the separatrix
    differences: cp.Vector  # wp(v) - e_l
    # wp(v) and the invariants of Weierstrass's function
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
    """The momentum at the middle of a flight, and the functions of half the flight."""

    y: cp.Vector  # the momentum at the start, in units in which half the flight takes a unit of time
    invariants: Invariants  # of the motion, in these units
    # s, t: S and T = E_1 E_2 E_3
    s: Array
    t: Array
    v: Array  # V
    d: Array  # D at the start
    momentum: cp.Vector  # E_l N_l, in units of the momentum
    moved: cp.Vector  # `momentum` in units of y
    # squares, pairs: E_l^2, and T^2 / E_l^2
    squares: cp.Vector
    pairs: cp.Vector
    others: cp.Vector  # (T D X_l)^2
    weight: Array  # a_j a_k S^2
    below: Array  # T^2 D^2 D(X)

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
        pairs = cp.others(squares)
        crossed = (y[1] * momentum[2], y[2] * momentum[0], y[0] * momentum[1])
        pulls = cp.times(inertia.gaps, squares)
        half_way = cp.add(cp.scale(t, momentum), cp.scale(s, cp.times(pulls, crossed)))
        moved = inertia.travel(h / 2, half_way)
        others = cp.times(pairs, cp.times(moved, moved))
        below = v * (t * d) * (t * d) + weight * (others[0] + others[1] + others[2] - cp.dot(inertia.middle, others))
        return cls(y, found, s, t, v, d, half_way, moved, squares, pairs, others, weight, below)


def momentum_change(inertia: Inertia, h: Array, momentum: cp.Vector, radius: float) -> tuple[cp.Vector, Invariants]:
    """The change of the momentum in a flight of time h, and the invariants of half the flight.

    Exact to rounding if h |Omega| and the roots of the invariants of the whole flight are at most `radius`.
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

    In all steps of a free body the rounding errors of the functions of the step are the same, so |Pi| and the energy
    would grow steadily. A change d conserves |y| if y . d + |d|^2 / 2 = 0. This determines the length of d well only if
    d is long, and only then does its error matter; the weights leave a short change unchanged. Five digits suffice.
    """
    square = 0.5 * cp.dot(change, change)
    return (cp.dot(y, change) + square) * cp.rough_reciprocal(square + (_SHORT * total + _NO_TURN))


# The largest h |Omega|, in radians, for which the sums are exact to rounding.
LARGEST_TURN = 1.2

Complex = tuple[Array, Array]  # (real, imaginary / |y|), so that only |y|^2 is needed, never |y|


class Jacobi(ExactFlight):
    """The exact flight for any moments; symplectic; conserves energy and spatial momentum to rounding.

    The flight reports False in `ok` if h |Omega| exceeds 1.2 radians. For a real body this limit also bounds the
    invariants of the motion. A body whose moments violate the triangle inequality can flip faster than it spins; for
    such a body, `ok` is also False if an invariant exceeds this bound.

    Examples:
        >>> inertia = ml.RigidBody([1.0, 2.0, 2.5]).inertia()
        >>> turn, change, ok = ml.flights.Jacobi()(inertia, jnp.array(0.1), momentum)  # vectors are tuples of scalars
        >>> jnp.stack(turn).round(4), bool(ok)
        (Array([ 0.9982,  0.0502,  0.019 , -0.0264], dtype=float64), True)
        >>> ml.method(ml.flights.Jacobi(), "SRKN6b").name  # the name for ml.integrate
        'JACOBI[SRKN6b]'
    """

    name: ClassVar[str] = "JACOBI"
    use: ClassVar[str] = "any body: exact, without a solve"
    per_loop: ClassVar[int] = 2
    per_kernel: ClassVar[int] = 2
    reach: ClassVar[float] = LARGEST_TURN

    def verdict(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Array:
        y = inertia.travel(h, momentum)
        turn = cp.times(inertia.spins, y)
        largest = cp.largest(Invariants.of(inertia, y).differences)
        return verdict(True, (cp.dot(turn, turn), LARGEST_TURN**2), (largest, LARGEST_TURN**2))

    def formula(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Flown:
        spins, y = inertia.spins, inertia.travel(h, momentum)
        turn = cp.times(spins, y)
        # A vanishing momentum leaves the axis of the angle undefined; two terms of the series in h are then exact to
        # rounding.
        at_rest = cp.dot(turn, turn) <= cp.epsilon(h)
        change = cp.times(spins, cp.cross(y, turn))
        series = half_turn(cp.where(at_rest, cp.add(cp.scale(0.5, turn), cp.scale(0.25, change)), cp.scale(0, turn)))
        closed_form = _turn(inertia, spins, cp.where(at_rest, cp.times(inertia.middle, inertia.relative), y))
        series = cp.square(series)
        increment = (jnp.where(at_rest, series[0], closed_form[0]), *cp.where(at_rest, series[1:], closed_form[1:]))
        return Flown(increment, cp.rotation_change(cp.conjugate(increment), momentum))

    def tangent(
        self, inertia: Inertia, h: Array, momentum: cp.Vector, flown: Flown, changes: Changes
    ) -> tuple[cp.Vector, cp.Vector, Any]:
        varying: dict[str, Any] = {"momentum": (momentum, changes.momentum)}
        if changes.h is not None:
            varying["h"] = h, changes.h
        if changes.spins is not None:
            varying["gaps"] = inertia.gaps, changes.gaps()

        def change_with(arguments: dict[str, Any]) -> cp.Vector:
            varied = inertia._replace(gaps=arguments.get("gaps", inertia.gaps))
            return momentum_change(varied, arguments.get("h", h), arguments["momentum"], LARGEST_TURN)[0]

        at, along = ({name: pair[place] for name, pair in varying.items()} for place in (0, 1))
        _, tangent = jax.jvp(change_with, (at,), (along,))
        integral = None if changes.spins is None else lag(inertia, h, momentum, LARGEST_TURN)
        return tangent, turn_of(inertia, h, momentum, flown.increment, changes, tangent, integral), ()

    def momentum_change(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Vector, Array]:
        change, half = momentum_change(inertia, h, momentum, LARGEST_TURN)
        turn = cp.times(inertia.spins, inertia.travel(h, momentum))
        # The invariants of half a flight are a quarter of the invariants of the flight.
        largest = 4 * cp.largest(half.differences)
        return change, (largest <= LARGEST_TURN**2) & (cp.dot(turn, turn) <= LARGEST_TURN**2)


def _turn(inertia: Inertia, spins: cp.Vector, y: cp.Vector) -> cp.Quaternion:
    """The rotation in a unit of time of a body with momentum y, in units of the largest moment; letters as above."""
    a, middle = inertia.gaps, inertia.middle
    k, a_jk, squares, total, K, differences, wp, g2, g3 = Invariants.of(inertia, y)
    s, w, odd = step_functions(wp, g2, g3, LARGEST_TURN)

    v = w - wp * s * s
    e1, e2, e3 = (cp.fast_root(v + difference * s * s) for difference in differences)
    e = e1, e2, e3
    d = v + a_jk * s * s * (total - cp.dot(middle, squares))
    products = (y[1] * y[2] * e[0], y[2] * y[0] * e[1], y[0] * y[1] * e[2])
    n = cp.add(cp.times(y, cp.others(e)), cp.scale(s, cp.times(a, products)))

    # F as in the module docstring; Z and M divided by |y|^2.
    per_total = cp.reciprocal(total)
    along = cp.scale(per_total, cp.times(y, n))
    M = d + along[0] + along[1] + along[2]
    imaginary = -2 * a_jk * K * odd
    F = cp.fast_root(v - total * imaginary * imaginary), imaginary
    Z = (
        d * (e1 + e2 + e3) + cp.dot(along, e) - M * cp.dot(middle, e),
        s * (per_total * K * d + cp.dot(k, along)),
    )
    real, imaginary = _complex_product(F, Z, total)
    cosine, sine = _complex_product((v * M + real, imaginary), _half_phase(cp.dot(middle, spins), total), total)

    across = _across(a, y, differences, e, s)
    x = cp.add(cp.scale(cosine * per_total, across), cp.scale(sine, cp.add(cp.scale(d, y), n)))
    return cp.normalised((cosine * M, *x))


def _across(a: cp.Vector, y: cp.Vector, differences: cp.Vector, e: cp.Vector, s: Array) -> cp.Vector:
    """n x y for two nearly parallel vectors, with an error proportional to |n x y| and not to |n| |y|.

    (n x y)_l = y_m y_n E_l (E_n - E_m) + S y_l (a_m y_n^2 E_m - a_n y_m^2 E_n). To avoid subtracting nearly equal
    roots, E_n - E_m is computed from E_n^2 - E_m^2: S^2 times the difference of two entries of `differences`.
    """
    sums = (e[1] + e[2], e[2] + e[0], e[0] + e[1])
    others = cp.others(sums)
    share = s * s * cp.reciprocal(sums[0] * others[0])
    d1, d2, d3 = differences
    change = cp.times(cp.scale(share, others), cp.subtract((d3, d1, d2), (d2, d3, d1)))
    first = cp.times(cp.others(y), cp.times(e, change))
    turn = cp.cross(cp.times(a, e), cp.times(y, y))
    return cp.add(first, cp.scale(s, cp.times(y, turn)))


def _half_phase(rate: Array, total: Array) -> Complex:
    """exp(i rate |y| / 2), computed from the angle rate |y| / 4, for which the series are short."""
    square = rate * rate * total / 4
    cosine, sine = half_angle(square)
    return 1 - 2 * square * sine * sine, rate * cosine * sine


def _complex_product(a: Complex, b: Complex, total: Array) -> Complex:
    return a[0] * b[0] - total * a[1] * b[1], a[0] * b[1] + a[1] * b[0]
