"""The exact flight of a body with two equal moments: two rotations and no solve. With I1 = I2,

b = h (1/I3 - 1/I1) Pi3,    R1 = R0 exp(h Pi0/I1) exp(b e3),    Pi1 = exp(-b e3) Pi0

That holds for equal moments alone, and so tells nothing of the derivative in their difference. With inverse moments
a + e, a - e, c the energy is that of the symmetric body and e H1, H1 = (Pi1^2 - Pi2^2)/2, and to first order in e the
motion is the symmetric body's after the flow of e K, K the integral of H1 along it (variation of constants):

K(Pi0) = h/2 sinc(b) Re(z^2 exp(-i b)),    z = Pi1 + i Pi2,    sinc(b) = sin(b)/b

a turn by e grad K, which takes the momentum along.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero

from ..._kernel import components as cp
from ..._kernel.short_series import LARGEST_SQUARE, half_turn, spin, stumpff
from ...model.bodies import RigidBody
from ..inertia import Inertia
from .base import Flight

_SLACK = 8  # units of eps by which inverse moments may differ and still count as equal

Flown = tuple[cp.Quaternion, cp.Vector]


class Symmetric(Flight):
    """Exact where two moments are equal; symplectic, keeps energy and spatial momentum to rounding.

    Says False where no two moments are equal to 8 eps, or a flight turned by more than 2.4 radians in one of its parts.
    The derivatives are those of the motion, in the moments of first order only (a ValueError beyond: take JACOBI).

    Attributes:
        axis: the axis of symmetry, 0, 1 or 2; None to find it in every flight, which costs a little.
    """

    axis: int | None = eqx.field(static=True, default=None)

    name: ClassVar[str] = "SYMMETRIC"
    use: ClassVar[str] = "bodies with two equal moments: exact, and three times as fast as JACOBI"
    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
    equal_moments: ClassVar[bool] = True
    per_loop: ClassVar[int] = 4

    def fitted(self, moments: Array) -> "Symmetric":
        """This flight about the axis of symmetry of bodies with these moments, (..., 3), if they have the same one.

        Raises:
            ValueError: no two moments of a body are equal.
        """
        a, b, c = (1 / np.asarray(moments)[..., k] for k in range(3))
        equal = {2: _equal(a, b), 0: _equal(b, c), 1: _equal(c, a)}  # the third first: a ball has every axis
        if not np.all(equal[0] | equal[1] | equal[2]):
            raise ValueError(
                "method SYMMETRIC needs bodies with two equal moments, got moments "
                f"{np.array2string(np.asarray(moments), threshold=12)}; take JACOBI, which moves any body."
            )
        return Symmetric(next((axis for axis, holds in equal.items() if np.all(holds)), None))

    def __call__(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        numbering = _Numbering.of(inertia.inverses, self.axis)
        inverses = numbering.third(inertia.inverses)
        seen = numbering.third(momentum)
        (w, *u), change = _fly(h, inverses, seen)
        ok = within_reach(h, inverses[0], inverses[2], seen) & _equal(inverses[0], inverses[1])
        return (w, *numbering.back((u[0], u[1], u[2]))), numbering.back(change), ok


def _equal(a: Any, b: Any) -> Any:
    return abs(a - b) <= _SLACK * float(np.finfo(a.dtype).eps) * a


class _Numbering(NamedTuple):
    """The axes renamed in their cyclic order so that the axis of symmetry is the third: it was the first, the second.

    Each of the two is a Python bool, or an array where the axis is not known before tracing.
    """

    first: Any
    second: Any

    @classmethod
    def of(cls, inverses: cp.Vector, axis: int | None) -> "_Numbering":
        if axis is not None:
            return cls(axis == 0, axis == 1)
        a, b, c = inverses
        third, first = _equal(a, b), _equal(b, c)
        return cls(~third & first, ~third & ~first & _equal(c, a))

    def third(self, v: cp.Vector) -> cp.Vector:
        """The components in the new order."""
        return self._chosen((v[1], v[2], v[0]), (v[2], v[0], v[1]), v)

    def back(self, v: cp.Vector) -> cp.Vector:
        """The inverse of `third`."""
        return self._chosen((v[2], v[0], v[1]), (v[1], v[2], v[0]), v)

    def _chosen(self, first: cp.Vector, second: cp.Vector, third: cp.Vector) -> cp.Vector:
        if isinstance(self.first, bool):
            return first if self.first else second if self.second else third
        x, y, z = (
            jnp.where(self.first, a, jnp.where(self.second, b, c)) for a, b, c in zip(first, second, third, strict=True)
        )
        return x, y, z


def _rotations(h: Array, a: Array, c: Array, momentum: cp.Vector) -> tuple[cp.Vector, Array]:
    """Half of the rotation about the momentum, and of the angle about axis 3."""
    return cp.scale(h / 2, cp.scale(a, momentum)), h / 2 * ((c - a) * momentum[2])


def symmetric_turn(h: Array, a: Array, c: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, tuple[Array, Array]]:
    """The turn of a body with 1/I1 = 1/I2 = a and 1/I3 = c.

    Returns:
        The increment; the cosine and sine of half the angle about axis 3 by which the momentum turns back, seen from
        the body.
    """
    turn, angle = _rotations(h, a, c, momentum)
    cosine, sine = spin(angle)
    return cp.multiply_about(cp.square(half_turn(turn)), 2, cosine, sine), (cosine, sine)


def within_reach(h: Array, a: Array, c: Array, momentum: cp.Vector) -> Array:
    """Whether both rotations of `symmetric_turn` are."""
    turn, angle = _rotations(h, a, c, momentum)
    return (cp.dot(turn, turn) <= LARGEST_SQUARE) & (angle * angle <= LARGEST_SQUARE)


@jax.custom_jvp
def _fly(h: Array, inverses: cp.Vector, momentum: cp.Vector) -> Flown:
    """The flight about the third axis, with the derivative of a body whose moments need not stay equal."""
    increment, about_third = symmetric_turn(h, inverses[0], inverses[2], momentum)
    return increment, cp.rotation_change_about(2, *about_third, momentum)


def _fly_jvp(primals: Any, tangents: Any) -> tuple[Flown, Flown]:
    h, inverses, momentum = primals
    a, _, c = _for_first_derivatives(inverses)
    dh, (da, db, dc), dp = _numbers(tangents, primals)

    def flown(h: Array, a: Array, c: Array, momentum: cp.Vector) -> Flown:
        return _fly.fun(h, (a, a, c), momentum)

    (increment, _), (turning, moving) = jax.jvp(flown, (h, a, c, momentum), (dh, (da + db) / 2, dc, dp))
    if not all(map(_is_zero, tangents[1])):
        # A turn by grad K first, which takes the momentum along, and then the flight.
        turn = cp.scale((da - db) / 2, _gradient(h, c - a, momentum))
        taken = cp.cross(momentum, turn)
        _, (onward, moved) = jax.jvp(lambda p: flown(h, a, c, p), (momentum,), (taken,))
        before = cp.multiply((h * 0, *cp.scale(0.5, turn)), increment)
        turning = tuple(x + y + z for x, y, z in zip(turning, before, onward, strict=True))
        moving = cp.add(moving, cp.add(taken, moved))
    return _fly(*primals), (turning, moving)


_fly.defjvp(_fly_jvp, symbolic_zeros=True)


@jax.custom_jvp
def _for_first_derivatives(inverses: cp.Vector) -> cp.Vector:
    """The same numbers, in a derivative that is not right to second order in them and so must not be differentiated."""
    return inverses


def _refuse(primals: Any, tangents: Any) -> Any:
    if all(map(_is_zero, tangents[0])):
        return primals[0], _numbers(tangents[0], primals[0])
    raise ValueError(
        "the flight SYMMETRIC has derivatives of first order only in the moments; take JACOBI, which has all."
    )


_for_first_derivatives.defjvp(_refuse, symbolic_zeros=True)


def _gradient(h: Array, gap: Array, momentum: cp.Vector) -> cp.Vector:
    """grad K, with gap = 1/I3 - 1/I1."""
    p, q, r = momentum
    angle = h * gap * r
    x = angle * angle
    two, three, _, _ = stumpff(x)
    sinc, slope = 1 - x * three, angle * (three - two)
    cosine, sine = 1 - x * two, angle * sinc
    u, v = p * cosine + q * sine, q * cosine - p * sine  # z exp(-i b)
    along = slope * (p * u - q * v) + sinc * (p * v + q * u)
    return h * sinc * u, -h * sinc * v, h * h / 2 * gap * along


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def _numbers(tangents: Any, primals: Any) -> Any:
    return jax.tree.map(lambda t, p: jnp.zeros_like(p) if _is_zero(t) else t, tangents, primals, is_leaf=_is_zero)
