"""`MutualGravity`: mutual gravity of rigid bodies, such as binary asteroids, to the fourth degree.

The potential energy of two bodies is expanded in their sizes over their distance r. With u the unit vector from the
first to the second, d = a - b for a point a of the first and b of the second body, and P_n Legendre's polynomials,

    V = -G sum_n 1/r^(n+1) <<|d|^n P_n(u . d/|d|)>>,

where <<>> is the sum over all pairs of points, each with the product of its masses. Terms of one body alone hold its
moments of degree n; the only other term up to degree 4 is the product of both bodies' moments of degree 2.

The moments of a homogeneous ellipsoid: MacMillan, The Theory of the Potential (1930); the expansion: Tricarico, Celest.
Mech. Dyn. Astron. 100 (2008) 319.
"""

from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_positive, described
from .._math import components as cp
from ..model.bodies import RigidBody, TensorBody
from ..model.free_body import FreeBody, Wrench
from ..model.state import AnyState, Time
from ..model.states import CoupledState
from ..model.torques.reads_body import ReadsBody

_DEGREES = (0, 2, 3, 4)
_MOST = 8  # bodies, each pair of which is written out
Matrix = tuple[cp.Vector, cp.Vector, cp.Vector]  # rows


def require_coupled(torque: ReadsBody, state: Any, body: Any) -> tuple[CoupledState, FreeBody]:
    name = type(torque).__name__
    if not isinstance(state, CoupledState) or not isinstance(body, FreeBody):
        raise ValueError(
            f"{name} acts on a CoupledState of a FreeBody, but the state is a {type(state).__name__} and the body "
            f"{described(body)}."
        )
    if not isinstance(body.body, RigidBody | TensorBody):
        raise ValueError(f"{name} needs all three moments; use a FreeBody of a RigidBody or TensorBody.")
    return state, body


class MutualGravity(ReadsBody):
    """Mutual gravity of coupled rigid bodies, for a `CoupledState` and a `FreeBody` of 2 to 8 bodies.

    Energy, linear momentum and the total angular momentum are conserved. The expansion holds while the spheres around
    the bodies do not overlap; moments do not give their radii, so nothing warns. For a spheroid (3, 1, 1) in contact
    with a ball of radius 1, the force is 12 % too small at degree 2 and 5 % at degree 4.

    Attributes:
        G: the gravitational constant, (), length^3 / (mass time^2).
        third: the moments of degree 3 of each body, the integrals of x_i x_j x_k over its mass, in the body frame,
            (N, 3, 3, 3); or None, for bodies that are symmetric under x -> -x.
        fourth: the moments of degree 4, (N, 3, 3, 3, 3), likewise; or None, for homogeneous ellipsoids.
        degree: the last degree of the expansion: 0 (points), 2, 3 or 4. Degree 2 holds for bodies of any shape and
            needs only their principal moments of inertia.

    Raises:
        ValueError: G is not positive; the degree is none of these, or does not use the given moments; moments of a
            wrong shape or not symmetric. When called: body and state are not coupled bodies that translate, or the
            number of bodies exceeds 8 or differs from the number of moments.

    Examples:
        >>> pair = ml.FreeBody(ml.RigidBody([[0.8, 0.9, 1.0], [0.1, 0.1, 0.1]]), mass=[2.0, 0.5])
        >>> still, upright = jnp.zeros((2, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1))
        >>> state = ml.CoupledState(still, upright, linear=still, position=[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
        >>> wrench = ml.asteroids.MutualGravity(G=1.0).on(pair)(0.0, state)
        >>> wrench.torque.shape, round(float(wrench.force[0, 0]), 6)  # for points G m1 m2 / r^2 = 0.01
        ((2, 3), 0.010022)
    """

    G: Float[Array, "*batch"]
    third: Float[Array, "*batch 3 3 3"] | None
    fourth: Float[Array, "*batch 3 3 3 3"] | None
    degree: int = eqx.field(static=True)

    @property
    def keeps_total_momentum(self) -> bool:
        return True

    def __init__(self, G: Any, *, degree: int = 2, third: Any = None, fourth: Any = None):
        if degree not in _DEGREES:
            raise ValueError(f"degree must be one of {_DEGREES}, got {degree!r}.")
        if (degree < 3 and third is not None) or (degree < 4 and fourth is not None):
            raise ValueError(f"moments of degree 3 or 4 need degree=4; degree={degree} does not use them.")
        if degree == 3 and third is None:
            raise ValueError("degree=3 needs the moments of degree 3 as third=; otherwise use degree=2.")
        self.G = as_positive("G", G)  # pyright: ignore[reportConstantRedefinition]
        self.degree = degree
        self.third = None if third is None else _moments("third", third, 3)
        self.fourth = None if fourth is None else _moments("fourth", fourth, 4)

    @property
    def gravitational(self) -> bool:
        return True

    def at(self, t: Time, state: AnyState, body: Any) -> Wrench:
        bodies = self._bodies(state, body)
        zero = jnp.zeros_like(bodies[0].position[0])
        torques = [(zero, zero, zero)] * len(bodies)
        forces = list(torques)
        for i, j in combinations(range(len(bodies)), 2):
            pair = _Pair(self, bodies[i], bodies[j])
            force, first, second = pair.load()
            torques[i], torques[j] = cp.add(torques[i], first), cp.add(torques[j], second)
            forces[i], forces[j] = cp.subtract(forces[i], force), cp.add(forces[j], force)
        torques = [one.in_frame_of_user(torque) for one, torque in zip(bodies, torques, strict=True)]
        return Wrench(jnp.stack([*map(cp.pack, torques)]), jnp.stack([*map(cp.pack, forces)]))

    def potential_at(self, t: Time, state: AnyState, body: Any) -> Array:
        pairs = [_Pair(self, *two).potential() for two in combinations(self._bodies(state, body), 2)]
        return sum(pairs[1:], start=pairs[0])

    def _bodies(self, state: Any, body: Any) -> "list[_Body]":
        state, body = require_coupled(self, state, body)
        count = state.count
        if not 2 <= count <= _MOST:
            raise ValueError(f"MutualGravity acts on 2 to {_MOST} bodies, got {count}; for more write a torque.")
        for name in ("third", "fourth"):
            moments = getattr(self, name)
            if moments is not None and moments.shape[0] != count:
                raise ValueError(f"{name} must hold the moments of {count} bodies, got {moments.shape}.")
        return [_Body.of(self, state, body, i) for i in range(count)]


def _moments(name: str, value: Any, degree: int) -> Array:
    moments = as_finite(name, value, (3,) * degree)
    if moments.ndim != degree + 1:
        raise ValueError(f"{name} must be (N,{' 3,' * degree}), got {moments.shape}.")
    if not cp.is_traced(moments):
        numbers = np.asarray(moments)
        close = partial(np.allclose, numbers, rtol=1e-5, atol=1e-5 * np.abs(numbers).max())
        if not all(close(np.swapaxes(numbers, axis, axis + 1)) for axis in range(1, degree)):
            raise ValueError(f"{name} must be symmetric in its last {degree} axes; integrate x_i x_j ... .")
    return moments


class _Body(NamedTuple):
    """One body, in its principal axes."""

    mass: Array
    position: cp.Vector
    attitude: cp.Quaternion  # takes components in the principal axes to space
    second: cp.Vector  # the moments of degree 2, the integrals of x_i^2
    trace: Array  # their sum
    third: Array | None  # in the frame of the user
    fourth: Array | None
    frame: cp.Quaternion | None  # takes components in the principal axes to the frame of the user; None if both agree

    @classmethod
    def of(cls, torque: MutualGravity, state: Any, body: FreeBody, i: int) -> "_Body":
        principal = body.in_principal_axes()
        row = i if body.batch else ...
        moments = cp.vector(principal.body.moments[row])  # pyright: ignore[reportAttributeAccessIssue]
        trace = 0.5 * (moments[0] + moments[1] + moments[2])
        second = (trace - moments[0], trace - moments[1], trace - moments[2])
        attitude, frame = cp.quaternion(state.attitude[i]), body.frame_of_user()
        if frame is not None:
            frame = (frame[0][row], frame[1][row], frame[2][row], frame[3][row])
            attitude = cp.multiply(attitude, frame)
        third, fourth = (None if m is None else m[i] for m in (torque.third, torque.fourth))
        return cls(principal.mass[row], cp.vector(state.position[i]), attitude, second, trace, third, fourth, frame)

    def in_frame_of_user(self, vector: cp.Vector) -> cp.Vector:
        return vector if self.frame is None else cp.rotate(self.frame, vector)

    def field(
        self, u: cp.Vector, inverse: Array, degree: int, sign: float
    ) -> "list[tuple[int, float, Array, cp.Vector]]":
        """The terms of this body alone: degree, factor, <|x/r|^n P_n> without the factor, and its gradient with u.

        u is the unit vector between the bodies, in the principal axes of this one. 1/r multiplies the moments, because
        their powers alone may exceed the range of the dtype. The sign is 1 for the first body and -1 for the second.
        """
        square = inverse * inverse
        terms = list[tuple[int, float, Array, cp.Vector]]()
        if degree >= 2:
            along = cp.scale(square, cp.times(self.second, u))
            terms.append((2, 0.5, 3 * cp.dot(u, along) - square * self.trace, cp.scale(6, along)))
        if self.third is not None:
            value, gradient = self._in_axes_of_user(u, self._third)
            terms.append((3, 0.5 * sign, inverse * (square * value), cp.scale(inverse, cp.scale(square, gradient))))
        if degree >= 4 and self.fourth is not None:
            value, gradient = self._in_axes_of_user(u, self._fourth)
            terms.append((4, 0.125, square * (square * value), cp.scale(square, cp.scale(square, gradient))))
        elif degree >= 4:
            terms.append((4, 0.125, *self._ellipsoid(u, square)))
        return terms

    def _in_axes_of_user(self, u: cp.Vector, term: Any) -> tuple[Array, cp.Vector]:
        if self.frame is None:
            return term(u)
        value, gradient = term(cp.rotate(self.frame, u))
        return value, cp.rotate_back(self.frame, gradient)

    def _third(self, u: cp.Vector) -> tuple[Array, cp.Vector]:
        moments: Any = self.third
        twice = _contracted(_contracted(moments, u), u)
        trace = cp.vector(jnp.trace(moments, axis1=-2, axis2=-1))
        value = 5 * cp.dot(u, cp.vector(twice)) - 3 * cp.dot(u, trace)
        return value, cp.subtract(cp.scale(15, cp.vector(twice)), cp.scale(3, trace))

    def _fourth(self, u: cp.Vector) -> tuple[Array, cp.Vector]:
        moments: Any = self.fourth
        thrice = cp.vector(_contracted(_contracted(_contracted(moments, u), u), u))
        pairs = jnp.trace(moments, axis1=-2, axis2=-1)
        once = cp.vector(_contracted(pairs, u))
        value = 35 * cp.dot(u, thrice) - 30 * cp.dot(u, once) + 3 * jnp.trace(pairs)
        return value, cp.subtract(cp.scale(140, thrice), cp.scale(60, once))

    def _ellipsoid(self, u: cp.Vector, square: Array) -> tuple[Array, cp.Vector]:
        """The term of degree 4 of a homogeneous ellipsoid, whose second moments are m/5 times its squared semi-axes."""
        per_mass = 5 * cp.reciprocal(self.mass) * square
        a, t = cp.scale(per_mass, self.second), per_mass * self.trace
        once = cp.times(a, u)
        twice = cp.times(a, once)
        q = cp.dot(u, once)
        squares = cp.dot(a, a)
        value = 105 * q * q - 30 * (t * q + 2 * cp.dot(once, once)) + 3 * (t * t + 2 * squares)
        gradient = cp.subtract(cp.scale(420 * q - 60 * t, once), cp.scale(120, twice))
        return 1 / 35 * self.mass * value, cp.scale(1 / 35 * self.mass, gradient)


def _contracted(moments: Array, u: cp.Vector) -> Array:
    return moments[..., 0] * u[0] + moments[..., 1] * u[1] + moments[..., 2] * u[2]


class _Pair:
    """Two bodies in the principal axes of the first one, with the distance 1 / inverse along the unit vector u, which
    is v in the axes of the second; `between` takes components in the axes of the second to those of the first.
    """

    def __init__(self, torque: MutualGravity, first: _Body, second: _Body):
        self.G, self.degree, self.first, self.second = torque.G, torque.degree, first, second
        way = cp.subtract(second.position, first.position)
        self.inverse = cp.inverse_root(cp.dot(way, way))
        self.u = cp.rotate_back(first.attitude, cp.scale(self.inverse, way))
        self.between = cp.multiply(cp.conjugate(first.attitude), second.attitude)
        self.v = cp.rotate_back(self.between, self.u)

    def potential(self) -> Array:
        weight = -self.G * self.inverse
        total = weight * self.first.mass * self.second.mass
        for body, other, u, sign in self._each():
            for _, factor, value, _ in body.field(u, self.inverse, self.degree, sign):
                total = total + factor * weight * other.mass * value
        if self.degree >= 4:
            total = total + 0.125 * weight * self.first.mass * self.second.mass * self._both()[0]
        return total

    def load(self) -> tuple[cp.Vector, cp.Vector, cp.Vector]:
        """The force on the second body in space, and the torques on both, each in its principal axes."""
        (of_first, torque), (of_second, other_torque) = (self._own(*each) for each in self._each())
        weight = self.G * self.inverse
        pull = cp.scale(-weight * self.inverse * self.first.mass * self.second.mass, self.u)
        force = cp.add(pull, cp.add(of_first, cp.rotate(self.between, of_second)))
        if self.degree >= 4:
            value, gradient, turn = self._both()
            strength = 0.125 * weight * self.first.mass * self.second.mass
            force = cp.add(force, cp.scale(strength * self.inverse, _slope(4, value, self.u, gradient)))
            # This term does not change the total angular momentum: both torques and r x force add up to zero.
            opposite = cp.scale(-strength, cp.add(turn, cp.cross(self.u, gradient)))
            torque = cp.add(torque, cp.scale(strength, turn))
            other_torque = cp.add(other_torque, cp.rotate_back(self.between, opposite))
        return cp.rotate(self.first.attitude, force), torque, other_torque

    def _own(self, body: _Body, other: _Body, u: cp.Vector, sign: float) -> tuple[cp.Vector, cp.Vector]:
        """The force on the second body by the terms of one body alone, and the torque on that body, in its axes."""
        weight = self.G * self.inverse * other.mass
        force = torque = cp.scale(0, u)
        for degree, factor, value, gradient in body.field(u, self.inverse, self.degree, sign):
            strength = factor * weight
            force = cp.add(force, cp.scale(strength * self.inverse, _slope(degree, value, u, gradient)))
            torque = cp.add(torque, cp.scale(-strength, cp.cross(u, gradient)))
        return force, torque

    def _each(self) -> Any:
        return (self.first, self.second, self.u, 1.0), (self.second, self.first, self.v, -1.0)

    def _both(self) -> tuple[Array, cp.Vector, cp.Vector]:
        """The term of degree 4 with the second moments A, B of both bodies, without the factor 1/8.

        It is 210 a b - 30 (b tr A + a tr B + 4 u.A B u) + 6 tr A tr B + 12 tr A B, with a = u.A u and b = u.B u, and
        moments per mass and r^2. Also its gradient with u, and its derivative with a rotation of the first body.
        """
        square = self.inverse * self.inverse
        factors = [square * cp.reciprocal(body.mass) for body in (self.first, self.second)]
        first, second = (cp.scale(c, body.second) for c, body in zip(factors, (self.first, self.second), strict=True))
        turned = _turned(self.between, second)
        of_first, of_second = cp.times(first, self.u), _times(turned, self.u)
        a, b = cp.dot(self.u, of_first), cp.dot(self.u, of_second)
        s, t = factors[0] * self.first.trace, factors[1] * self.second.trace
        again = cp.times(first, of_second)
        both = cp.add(again, _times(turned, of_first))
        product = first[0] * turned[0][0] + first[1] * turned[1][1] + first[2] * turned[2][2]
        value = 210 * a * b - 30 * (b * s + a * t + 4 * cp.dot(of_first, of_second)) + 6 * s * t + 12 * product
        gradient = cp.subtract(
            cp.add(cp.scale(420 * b - 60 * t, of_first), cp.scale(420 * a - 60 * s, of_second)), cp.scale(120, both)
        )
        commutator = (
            (first[1] - first[2]) * turned[1][2],
            (first[2] - first[0]) * turned[2][0],
            (first[0] - first[1]) * turned[0][1],
        )
        turn = cp.add(
            cp.cross(cp.subtract(cp.scale(420 * b - 60 * t, of_first), cp.scale(120, again)), self.u),
            cp.add(cp.scale(-120, cp.cross(of_first, of_second)), cp.scale(24, commutator)),
        )
        return value, gradient, turn


def _slope(degree: int, value: Array, u: cp.Vector, gradient: cp.Vector) -> cp.Vector:
    """r^(degree + 2) times the gradient with r = r u of value(u) / r^(degree + 1)."""
    return cp.subtract(gradient, cp.scale((degree + 1) * value + cp.dot(u, gradient), u))


def _turned(q: cp.Quaternion, diagonal: cp.Vector) -> Matrix:
    rows = cp.columns(cp.conjugate(q))
    scaled = [cp.times(row, diagonal) for row in rows]
    xx, yy, zz = (cp.dot(rows[i], scaled[i]) for i in range(3))
    xy, yz, zx = cp.dot(rows[0], scaled[1]), cp.dot(rows[1], scaled[2]), cp.dot(rows[2], scaled[0])
    return (xx, xy, zx), (xy, yy, yz), (zx, yz, zz)


def _times(matrix: Matrix, v: cp.Vector) -> cp.Vector:
    return cp.dot(matrix[0], v), cp.dot(matrix[1], v), cp.dot(matrix[2], v)
