"""`ExactFlight`, the base class of the exact flights of rigid bodies, with derivatives in closed form.

In a time h a free body rotates by Q, and its momentum in the body frame changes from Pi to Q^T Pi. A small change of h,
Pi and c = 1/I changes Q to (1 + [chi]) Q, with [chi] x = chi x x. With (l, m, n) cyclic, a_l = c_n - c_m, so that
Pi_l' = a_l Pi_m Pi_n, the constant spatial momentum and the constant energy give (`docs/reports/exact-flight.md`)

    chi x Pi = -z,    z = (Q - 1) dPi + Q d(Q^T Pi - Pi)
    Pi . chi = h Omega . dPi + Omega . Pi dh + sum (h Pi_l^2 + a_l L) dc_l,    L = int_0^h (h - t) Pi_1 Pi_2 Pi_3 dt

The `lag` L is of second order in h. The derivative of the angle about the momentum, the most expensive part of a
flight, is never needed.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ..._xla.fusion import fuse_derivative, split
from ..._xla.internals import are_zero, with_zeros
from ...model.inertia import Inertia
from ...model.kind import Kind
from .base import JudgedFlight

# The square of the rotation, in radians, up to which only the derivative with respect to the momentum matters.
_NO_TURN = {"float64": 1e-280, "float32": 1e-28}


class Changes(NamedTuple):
    """Tangents of the arguments of a flight, each None if it does not change."""

    spins: cp.Vector | None  # of the inverse moments, in units of the largest moment
    h: Array | None
    momentum: cp.Vector

    @classmethod
    def of(cls, inertia: Inertia, inertia_tangent: Any, h: Any, momentum: Any) -> "Changes":
        """The changes; tangents may be symbolic zeros. Only the inverse moments of `Inertia` count."""
        inverses, spins = inertia_tangent.inverses, None
        if not are_zero(inverses):
            spins = cp.scale(cp.largest(inertia.moments), with_zeros(inverses, inertia.inverses))
        return cls(spins, None if are_zero(h) else h, with_zeros(momentum, inertia.inverses))

    def gaps(self) -> cp.Vector:
        assert self.spins is not None
        x, y, z = self.spins
        return z - y, x - z, y - x


def turn_of(
    inertia: Inertia,
    h: Array,
    momentum: cp.Vector,
    increment: cp.Quaternion,
    changes: Changes,
    momentum_change: cp.Vector,
    lag: Array | None,
) -> cp.Vector:
    """The chi of a change of the arguments of a flight.

    `momentum_change` is the tangent of the change of the momentum. `lag` is L for momenta in units of the largest
    moment; needed if the inverse moments change.
    """
    # With the momentum in units of an angle, nothing overflows or underflows in any user units.
    y = inertia.travel(h, momentum)
    total = cp.dot(y, y)
    # If the rotation vanishes, the formula would divide by zero; the term of first order in h is then exact.
    at_rest = total <= _NO_TURN[str(total.dtype)]
    axis = cp.scale(h * cp.reciprocal(jnp.where(at_rest, jnp.ones_like(total), total)), y)
    per = cp.scale(inertia.per_unit, axis)

    turn = cp.times(inertia.spins, y)
    along = cp.dot(cp.scale(inertia.per_unit, turn), changes.momentum)
    slow = cp.times(cp.scale(h * inertia.per_unit, inertia.spins), changes.momentum)
    if changes.h is not None or changes.spins is not None:
        scaled = cp.scale(inertia.per_unit, momentum)
        if changes.h is not None:
            along = along + changes.h * cp.dot(cp.times(inertia.spins, scaled), scaled)
        if changes.spins is not None:
            assert lag is not None
            weights = cp.add(cp.times(scaled, y), cp.scale(lag, inertia.gaps))
            along = along + cp.dot(weights, changes.spins)
    z = cp.add(momentum_change, cp.unit_rotation_change(increment, cp.add(changes.momentum, momentum_change)))
    fast = cp.add(cp.scale(along, axis), cp.cross(z, per))
    a, b, c = (jnp.where(at_rest, one, other) for one, other in zip(slow, fast, strict=True))
    return a, b, c


T = TypeVar("T")


class Flown(NamedTuple):
    """The rotation of the body and the change of its momentum."""

    increment: cp.Quaternion
    change: cp.Vector
    parts: Any = ()  # further numbers for the tangent, which are the same for a flight and for its reverse


class Known(NamedTuple):
    """The known parts of a flight whose derivative alone is needed."""

    increment: cp.Quaternion
    parts: Any
    pose: Any  # after the flight


class ExactFlight(JudgedFlight):
    """An exact flight, whose formulas are not differentiated."""

    order: ClassVar[int | None] = None
    long_derivative: ClassVar[bool] = False

    @abstractmethod
    def formula(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Flown:
        """The flight, by formulas that are never differentiated."""

    @abstractmethod
    def tangent(
        self, inertia: Inertia, h: Array, momentum: cp.Vector, flown: Flown, changes: Changes
    ) -> tuple[cp.Vector, cp.Vector, Any]:
        """The tangents of the change of the momentum, chi, and the tangents of the parts."""

    @abstractmethod
    def verdict(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Array:
        """Fine if the flight is short enough for the formulas, and they hold for the body."""

    def judged(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> tuple[cp.Quaternion, cp.Vector, Array]:
        increment, change, _ = self.fly(inertia, h, momentum)
        return increment, change, self.verdict(inertia, h, momentum)

    def fly(self, inertia: Inertia, h: Array, momentum: cp.Vector) -> Flown:
        return _fly(self, inertia, h, momentum, None)


def _boundary(flight: ExactFlight) -> Callable[[T], T]:
    """What ends the loop of a flight in its derivative: a long flight has its own loop already in the first one."""
    return split if flight.per_loop <= 2 else fuse_derivative


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _fly(flight: ExactFlight, inertia: Inertia, h: Array, momentum: cp.Vector, known: Known | None) -> Flown:
    if known is None:
        return flight.formula(inertia, h, momentum)
    return Flown(known.increment, cp.rotation_change(cp.conjugate(known.increment), momentum), known.parts)


def _tangent(flight: ExactFlight, primals: Any, tangents: Any) -> tuple[Flown, Flown]:
    flown = _boundary(flight)(_fly(flight, *primals))
    return flown, _flown_tangent(flight, primals, tangents, flown)[0]


def _flown_tangent(flight: ExactFlight, primals: Any, tangents: Any, flown: Flown) -> tuple[Flown, cp.Vector]:
    """The tangent of a flight, and chi; primals and tangents begin with inertia, h and momentum."""
    inertia, h, momentum = primals[:3]
    change, chi, parts = flight.tangent(inertia, h, momentum, flown, Changes.of(inertia, *tangents[:3]))
    change, chi = fuse_derivative((change, chi))
    (a, b, c), (w, x, y, z) = cp.scale(0.5, chi), flown.increment  # the tangent is (0, chi/2) times the increment
    increment = -a * x - b * y - c * z, a * w + b * z - c * y, b * w + c * x - a * z, c * w + a * y - b * x
    return Flown(increment, change, parts), chi


_fly.defjvp(_tangent, symbolic_zeros=True)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def carry(
    flight: ExactFlight,
    kind: Kind,
    inertia: Inertia,
    h: Array,
    momentum: cp.Vector,
    known: Known | None,
    pose: Any,
    no_step: Array,
) -> tuple[Flown, Any]:
    """`fly`, and the pose after it by `kind.act`, which have a shorter derivative together than separately."""
    flown = _fly(flight, inertia, h, momentum, known)
    return flown, kind.act(pose, flown.increment, no_step) if known is None else known.pose


def _carry_tangent(flight: ExactFlight, kind: Kind, primals: Any, tangents: Any) -> tuple[Any, Any]:
    """The tangent of `carry`: the initial pose rotates by chi and by its own change, and the flight carries both."""
    *_, pose, no_step = primals
    flown, end = _boundary(flight)(carry(flight, kind, *primals))
    flown_dot, chi = _flown_tangent(flight, primals, tangents, flown)
    both = jax.tree.map(jnp.add, with_zeros(tangents[4], pose), kind.rate(pose, chi))
    _, end_dot = jax.jvp(lambda pose: kind.act(pose, flown.increment, no_step), (pose,), (both,))
    return (flown, end), (flown_dot, end_dot)


carry.defjvp(_carry_tangent, symbolic_zeros=True)
