"""The exact flight of any body in closed form: Jacobi's solution by addition theorems.

The components of the momentum are elliptic functions of time. By their addition theorems, the components after a step
are rational in the components before the step and in functions of the step alone. No inverse elliptic function is
needed. The angle about the spatial momentum is an elliptic integral of the third kind. Its addition theorem leaves a
function of the step and the argument of a complex number that is rational as well. The formulas need no sorting of the
moments and have no special case at the separatrix or for equal moments. They use only three short sums in the
invariants of the step (`_math.weierstrass`), a few roots and a reciprocal, but no period and no arithmetic-geometric
mean.

For a unit of time, with (l, m, n) cyclic, a_l = 1/I_n - 1/I_m so that Pi_l' = a_l Pi_m Pi_n, i the axis of the middle
moment, (i, j, k) cyclic, K = a_k Pi_j^2 - a_j Pi_k^2, and Weierstrass's function wp whose
roots e_l satisfy a_m a_n Pi_l(t)^2 = wp(t - t0) - e_l:

    wp(v) = e_i + a_j a_k |Pi|^2,    wp(v) - e_j = -a_k K,    wp(v) - e_k = a_j K
    S = sigma(1),    E_l^2 = S^2 (wp(1) - e_l),    V = S^2 (wp(1) - wp(v))
    D Pi_l(1) = N_l = Pi_l E_m E_n + a_l S Pi_m Pi_n E_l,    D = E_l^2 - a_m a_n S^2 Pi_l^2, the same for every l
    angle = |Pi|/I_i + arg F + arg Z,    F = sigma(v - 1) exp(zeta(v)) / sigma(v),    |F|^2 = V
    Z = D |Pi|^2 (E_1 + E_2 + E_3) + sum Pi_l N_l E_l - M E_i  +  i |Pi| S (K D + a_k Pi_j N_j - a_j Pi_k N_k)
    M = D |Pi|^2 + Pi . N,    |Z|^2 = V M^2

The rotation of the body is the shortest rotation between the two momenta, combined with a rotation about Pi by the
angle above. Because |F Z| = V M contains no square root, the sine and cosine of half the angle contain one only in a
common factor. The normalisation of the quaternion removes it.

C. G. J. Jacobi, J. reine angew. Math. 39 (1850) 293; R. van Zon, J. Schofield, J. Comput. Phys. 225 (2007) 145;
E. Celledoni, F. Fasso, N. Safstrom, A. Zanna, SIAM J. Sci. Comput. 30 (2008) 2084. These papers evaluate the
elliptic functions anew at each time. The rational step was derived for this package; the tests compare it with
a closed form in many digits.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._math.short_series import half_angle, half_turn
from ..._math.weierstrass import step_functions
from ...model.inertia import Inertia
from ..verdict import verdict
from .exact import ExactFlight, Flown
from .jacobi_momentum import Invariants, lag, momentum_change
from .turn_tangent import Changes, turn_of

# The largest h |Omega|, in radians, for which the sums are exact to rounding.
LARGEST_TURN = 1.2

Complex = tuple[Array, Array]  # (real, imaginary / |y|), so that only |y|^2 is needed, never |y|


class Jacobi(ExactFlight):
    """The exact flight for any moments; symplectic; conserves energy and spatial momentum to rounding.

    The flight reports False in `ok` if h |Omega| exceeds 1.2 radians. For a real body this limit also bounds the
    invariants of the motion. A body whose moments violate the triangle inequality can flip faster than it spins; for
    such a body, `ok` is also False if an invariant exceeds this bound.

    Examples:
        >>> momentum = ml.flights.components.vector(jnp.array([1.0, 0.8, -1.3]))  # a tuple of scalars
        >>> inertia = ml.RigidBody([1.0, 2.0, 2.5]).inertia()
        >>> turn, change, ok = ml.flights.Jacobi()(inertia, jnp.array(0.1), momentum)
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
        series = half_turn(_select(at_rest, cp.add(cp.scale(0.5, turn), cp.scale(0.25, change)), cp.scale(0, turn)))
        closed_form = _turn(inertia, spins, _select(at_rest, cp.times(inertia.middle, inertia.relative), y))
        series = cp.square(series)
        increment = (jnp.where(at_rest, series[0], closed_form[0]), *_select(at_rest, series[1:], closed_form[1:]))
        return Flown(increment, cp.rotation_change(cp.conjugate(increment), momentum))

    def tangent(
        self, inertia: Inertia, h: Array, momentum: cp.Vector, flown: Flown, changes: Changes
    ) -> tuple[cp.Vector, cp.Vector, Any]:
        """The tangent of the rational function, by differentiation; chi follows from it (`turn_tangent`)."""
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
        """The change of the momentum as a rational function, without the angle of the body about the momentum."""
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
    e = (
        _square_root(v + differences[0] * s * s),
        _square_root(v + differences[1] * s * s),
        _square_root(v + differences[2] * s * s),
    )
    d = v + a_jk * s * s * (total - cp.dot(middle, squares))
    products = (y[1] * y[2] * e[0], y[2] * y[0] * e[1], y[0] * y[1] * e[2])
    n = cp.add(cp.times(y, (e[1] * e[2], e[2] * e[0], e[0] * e[1])), cp.scale(s, cp.times(a, products)))

    # F as in the module docstring; Z and M divided by |y|^2.
    per_total = cp.reciprocal(total)
    along = cp.scale(per_total, cp.times(y, n))
    M = d + along[0] + along[1] + along[2]
    imaginary = -2 * a_jk * K * odd
    F = _square_root(v - total * imaginary * imaginary), imaginary
    Z = (
        d * (e[0] + e[1] + e[2]) + cp.dot(along, e) - M * cp.dot(middle, e),
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
    others = (sums[1] * sums[2], sums[2] * sums[0], sums[0] * sums[1])
    share = s * s * cp.reciprocal(sums[0] * others[0])
    change = cp.times(
        cp.scale(share, others),
        cp.subtract((differences[2], differences[0], differences[1]), (differences[1], differences[2], differences[0])),
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


def _half_phase(rate: Array, total: Array) -> Complex:
    """exp(i rate |y| / 2), computed from the angle rate |y| / 4, for which the series are short."""
    square = rate * rate * total / 4
    cosine, sine = half_angle(square)
    return 1 - 2 * square * sine * sine, rate * cosine * sine


def _complex_product(a: Complex, b: Complex, total: Array) -> Complex:
    return a[0] * b[0] - total * a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _select(choice: Array, a: cp.Vector, b: cp.Vector) -> cp.Vector:
    return jnp.where(choice, a[0], b[0]), jnp.where(choice, a[1], b[1]), jnp.where(choice, a[2], b[2])


def _square_root(x: Array) -> Array:
    return x * cp.inverse_root(x)
