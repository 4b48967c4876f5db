"""`free_motion`: a body under no torque at any times, each in one evaluation and without steps.

The momentum of a free body circles one of its axes. With the axes labelled such that it circles the third, and the
second is that of the middle moment,

    Pi = (A1 cn u, A2 sn u, A3 dn u),    u = u0 + rate t,
    angle' = |Pi| / I1 + |Pi| (1/I3 - 1/I1) / (1 + n sn^2 u),    n = (A1 / A3)^2

where `angle` is that of the first axis about the spatial momentum. From u = 0 on, JACOBI's flight gives both exactly
for a short time. `_kernel.elliptic` doubles this time as often as needed, and two addition theorems carry the result
from u = 0 to the start u0. Each time costs some sixty operations for every doubling, and the loop makes the most that
can be needed, 52 in float64.

R. van Zon, J. Schofield, J. Comput. Phys. 225 (2007) 145; E. T. Whittaker, Analytical Dynamics, section 69. The
doubling is this package's; the tests compare it with `oracles.free_body`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.checks import as_floats, require_finite
from .._kernel.elliptic import Complex, Modulus, Point, half_addition_angle, product
from .._kernel.weierstrass import sigma_functions
from .._kernel.width import wide_jit
from ..methods.flights.jacobi import LARGEST_TURN, Jacobi
from ..methods.flights.jacobi_momentum import Invariants
from ..methods.inertia import Inertia
from ..methods.system import Motion, System
from ..model.bodies import Body, RigidBody, principal_of
from ..model.state import AnyState
from .arguments import as_method, check_system
from .integrate import Path

_TURN = 1.1  # the largest turn of the first flight, in radians; less than JACOBI's `LARGEST_TURN`
_DOUBLINGS = {"float64": 52, "float32": 23}  # after more, no digit of the phase is left
_LARGEST_LEVER = 64.0  # of rounding errors in the attitude, see `_Orbit.lever`


def free_motion(body: Body, start: AnyState, times: Any) -> Path:
    """The states of one free body at any times after the start; map over bodies and states with `jax.vmap`.

    Nothing is integrated: the cost of a state hardly depends on its time. The error of momentum and attitude is a few
    eps (1 + Omega |t|), relative to |Pi| and in radians, with Omega = sqrt(2 energy / smallest moment), a bound of the
    angular velocity. Close to the separatrix, where the body tumbles between two steady rotations about the middle
    axis, the motion itself is that sensitive to the last digits of body and momentum: there the result is the motion of
    a body and momentum that differ by a few eps from those given.

    Differentiable where the three moments differ and the momentum is neither along a principal axis nor on the
    separatrix; there the derivatives can be NaN (those of `integrate` with JACOBI are not). A reverse derivative
    takes minutes to compile.

    Args:
        body: a `RigidBody`, or a `TensorBody` in a frame of your own.
        start: the state at time 0: a `MomentumState`, `DirectionState` or `RigidState`.
        times: (n,), of any sign, size and order, relative to the start.

    Returns:
        The path, with `times` and `states` as given by `times`. `ok` is False where a time is so long that no digit of
        the phase is left; where rounding errors of the attitude would be magnified by more than 64, as for a body ten
        times thinner than long that spins about its long side; or where a number is not finite.

    Raises:
        ValueError: an argument is invalid; the message names the argument and the cure. Raised before anything is
            traced.
    """
    check_system(as_method("JACOBI[EA]"), body, None, start)
    times = as_floats("times", times)
    if times.ndim != 1:
        raise ValueError(f"times must have shape (n,), got {times.shape}; map over a batch with jax.vmap.")
    times = times.astype(start.momentum.dtype)
    require_finite("times", times)
    return _run(body, start, times)


@wide_jit
def _run(body: Any, start: AnyState, times: Array) -> Path:
    system = System.of(body, None, start, jnp.zeros((), times.dtype))
    motion = system.motion(start)
    orbit = _Orbit.of(principal_of(body).moments, cp.pack(motion.momentum))

    def at(t: Array) -> tuple[AnyState, Array]:
        momentum, turn, ok = orbit.at(t)
        ok = ok & (orbit.lever <= _LARGEST_LEVER) if system.kind.has_pose else ok
        state = system.state(Motion(momentum, system.kind.rotate(motion.pose, turn)))
        state = jax.tree.map(lambda x, y: jnp.where(t == 0, x, y), start, state)
        return state, ok & jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(state)]))

    states, ok = jax.vmap(at)(times)
    first_bad = jnp.argmin(jnp.append(ok, False)).astype(jnp.int32)
    return Path(times, states, jnp.all(ok), first_bad)


class _Orbit(NamedTuple):
    """The motion of one free body in units in which moments and momentum are near 1, on labelled axes.

    Attributes:
        axes, signs: component l of the labelled axes is signs[l] times component axes[l] of the body.
        size: the unit of momentum; zero for a body at rest.
        per_time: turns a time into the units of the motion.
        inertia: of the body on the labelled axes.
        momentum: at the start, on the labelled axes.
        amplitudes: A1, A2 and A3.
        start: sn, cn, dn of u0.
        modulus: of the elliptic functions.
        rate: of u.
        n, root: as in `_kernel.elliptic`; the angle grows with the sign of `root`.
        omega: a bound of the angular velocity.
    """

    axes: Array
    signs: Array
    size: Array
    per_time: Array
    inertia: Inertia
    momentum: cp.Vector
    amplitudes: cp.Vector
    start: Point
    modulus: Modulus
    rate: Array
    n: Array
    root: Array
    omega: Array

    @property
    def lever(self) -> Array:
        """How much the angle about the momentum magnifies errors where the momentum passes the first axis."""
        return jnp.sqrt(1 + self.n)

    @classmethod
    def of(cls, moments: Array, momentum: Array) -> "_Orbit":
        one = jnp.ones((), momentum.dtype)
        # The units are powers of two and round nothing.
        size, unit = _power_of_two(jnp.max(jnp.abs(momentum))), _power_of_two(jnp.max(moments))
        at_rest = size == 0
        relative, direction = moments / unit, jnp.where(at_rest, jnp.eye(3)[2].astype(one.dtype), momentum)
        direction = direction / jnp.where(at_rest, one, size)

        axes, signs = _labels(relative, direction)
        i1, i2, i3 = relative[axes]
        p1, p2, p3 = p = cp.vector(signs * direction[axes])
        to_second, to_third, between = i2 - i1, i3 - i1, i3 - i2  # all of one sign; exact where they are small
        above = p1 * p1 * to_third / i1 + p2 * p2 * between / i2
        below = p2 * p2 * to_second / i2 + p3 * p3 * to_third / i3
        nearness = (p3 * p3 * between * i1 - p1 * p1 * to_second * i3) / (i1 * i3)
        speed = below * between
        steady, ball = speed <= 0, to_third == 0
        speed = jnp.where(steady, one, speed)
        m = jnp.where(steady, 0 * one, jnp.clip(above * to_second / speed, 0, 1))
        m1 = jnp.where(steady, one, jnp.clip(nearness * to_third / speed, 0, 1))
        rate = jnp.where(steady, 0 * one, jnp.sqrt(speed / (i1 * i2 * i3)))

        a1, a2 = _root_of_quotient(i1 * above, to_third), _root_of_quotient(i2 * above, between)
        a3 = jnp.where(ball, cp.norm(p), _root_of_quotient(i3 * below, to_third))
        sign = jnp.where(to_third < 0, -one, one)
        cn, sn = p1 * jnp.sqrt(jnp.abs(to_third) / i1), sign * p2 * jnp.sqrt(jnp.abs(between) / i2)
        along = (cn == 0) & (sn == 0)  # u0 is arbitrary
        length = jnp.hypot(jnp.where(along, one, cn), sn)
        a3_or_one = jnp.where(ball, one, a3)
        begin = Point(sn / length, jnp.where(along, one, cn / length), jnp.where(ball, one, p3 / a3_or_one))
        n = jnp.where(ball, 0 * one, (a1 / a3_or_one) ** 2)
        product_of_three = (1 + n) * n * (n + m)
        positive = ~steady & (product_of_three > 0)
        root = jnp.where(positive, sign * jnp.sqrt(jnp.where(positive, product_of_three, one)), 0 * one)
        omega = jnp.sqrt((p1 * p1 / i1 + p2 * p2 / i2 + p3 * p3 / i3) / jnp.min(relative))
        inertia = Inertia.of(RigidBody(relative[axes], physical=False))
        amplitudes = a1, sign * a2, a3
        modulus = Modulus(m, m1)
        return cls(axes, signs, size, size / unit, inertia, p, amplitudes, begin, modulus, rate, n, root, omega)

    def at(self, t: Array) -> tuple[cp.Vector, cp.Quaternion, Array]:
        """The momentum after the time t, the rotation since the start, and whether the phase has digits left."""
        t, most = t * self.per_time, _DOUBLINGS[str(t.dtype)]
        doublings = jnp.ceil(jnp.log2(jnp.maximum(self.omega * jnp.abs(t) / _TURN, 1)))
        ok, doublings = doublings <= most, jnp.minimum(doublings, most)
        point, half_angle, flight_ok = self._short(t * jnp.exp2(-doublings))

        def double(carry: Any, number: Array) -> tuple[Any, None]:
            point, half_angle = carry
            twice = self.modulus.doubled(point)
            angle = product(half_angle, half_angle)
            angle = product(angle, half_addition_angle(self.n, self.root, point, point, twice))
            return jax.tree.map(lambda new, old: jnp.where(number < doublings, new, old), (twice, angle), carry), None

        (point, half_angle), _ = jax.lax.scan(double, (point, half_angle), jnp.arange(most, dtype=t.dtype))
        end = self.modulus.sum(self.start, point)
        # On the middle axis u0 is infinite, and adding to it changes nothing.
        middle = (self.momentum[0] == 0) & (self.momentum[2] == 0)
        end = jax.tree.map(lambda x, y: jnp.where(middle, x, y), self.start, end)
        half_angle = product(half_angle, half_addition_angle(self.n, self.root, self.start, point, end))

        a1, a2, a3 = self.amplitudes
        moved = a1 * end.cn, a2 * end.sn, a3 * end.dn
        steady = self.rate == 0
        moved = tuple(jnp.where(steady, p, q) for p, q in zip(self.momentum, moved, strict=True))
        zero = jnp.zeros_like(t)
        about = half_angle[0], zero, zero, half_angle[1]
        moved = moved[0], moved[1], moved[2]
        w, *u = cp.multiply(cp.multiply(cp.conjugate(_to_third(self.momentum)), about), _to_third(moved))
        back, turn = self._in_body_axes(moved), self._in_body_axes((u[0], u[1], u[2]))
        return cp.scale(self.size, back), (w, *turn), ok & flight_ok

    def _short(self, h: Array) -> tuple[Point, Complex, Array]:
        """The functions and half the angle after a short time h from u = 0, and `ok`."""
        a1, _, a3 = self.amplitudes
        first = a1, jnp.zeros_like(a1), a3
        increment, change, ok = Jacobi()(self.inertia, h, first)
        about = cp.multiply(cp.multiply(_to_third(first), increment), cp.conjugate(_to_third(cp.add(first, change))))
        length = jnp.hypot(about[0], about[3])
        invariants = Invariants.of(self.inertia, self.inertia.travel(h, first))
        s, w, _ = sigma_functions(invariants.g2, invariants.g3, LARGEST_TURN)
        v = w - invariants.wp * s * s
        e1, e2, e3 = (jnp.sqrt(v + difference * s * s) for difference in invariants.differences)
        return (
            self.modulus.point(self.rate * h * s / e2, e3 / e2),
            (about[0] / length, about[3] / length),
            ok & (e1 > 0),
        )

    def _in_body_axes(self, vector: cp.Vector) -> cp.Vector:
        values = self.signs * cp.pack(vector)
        return cp.vector(jnp.zeros_like(values).at[self.axes].set(values))


def _labels(moments: Array, momentum: Array) -> tuple[Array, Array]:
    """Right-handed axes, as indices and signs, such that the momentum circles the third, on its positive side."""
    order = jnp.argsort(moments)
    low, middle, high = order[0], order[1], order[2]
    squares = momentum * momentum
    about_high = squares[high] * (moments[high] - moments[middle]) * moments[low]
    about_low = squares[low] * (moments[middle] - moments[low]) * moments[high]
    circles_high = (about_high > about_low) | ((about_high == about_low) & (moments[middle] > moments[low]))
    first, third = jnp.where(circles_high, low, high), jnp.where(circles_high, high, low)
    side = jnp.where(momentum[third] < 0, -1, 1).astype(momentum.dtype)
    second = jnp.where((middle - first) % 3 == 1, side, -side)
    return jnp.stack([first, middle, third]), jnp.stack([jnp.ones_like(side), second, side])


def _power_of_two(x: Array) -> Array:
    """The power of two next above x > 0; zero for zero."""
    _, exponent = jnp.frexp(jax.lax.stop_gradient(x))
    return jnp.where(x == 0, jnp.zeros_like(x), jnp.ldexp(jnp.ones_like(x), exponent))


def _root_of_quotient(a: Array, b: Array) -> Array:
    """sqrt(a / b) of numbers of one sign; zero where either is zero."""
    zero = (a == 0) | (b == 0)
    return jnp.where(zero, jnp.zeros_like(a), jnp.sqrt(jnp.where(zero, jnp.ones_like(a), a / jnp.where(zero, 1, b))))


def _to_third(p: cp.Vector) -> cp.Quaternion:
    """The rotation that takes p to the third axis and keeps the first axis in the plane of the first and third."""
    side, lift = jnp.arctan2(p[1], p[2]) / 2, jnp.arctan2(-p[0], jnp.hypot(p[1], p[2])) / 2
    zero = jnp.zeros_like(side)
    return cp.multiply((jnp.cos(lift), zero, jnp.sin(lift), zero), (jnp.cos(side), jnp.sin(side), zero, zero))
