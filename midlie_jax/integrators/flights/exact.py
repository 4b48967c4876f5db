"""`ExactFlight`, the base class of the exact flights of rigid bodies, with derivatives in closed form.

A change of the arguments of a flight changes its increment Q to (1 + [chi]) Q, with [chi] x = chi x x.
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
from ...model.bodies import RigidBody
from ...model.inertia import Inertia
from ...model.kind import Kind
from .base import JudgedFlight
from .turn_tangent import Changes, with_zeros

T = TypeVar("T")


class Flown(NamedTuple):
    """The results of a formula: the rotation of the body, the change of the momentum, and further numbers for the
    tangent, which are the same for a flight and for its reverse, or ().
    """

    increment: cp.Quaternion
    change: cp.Vector
    parts: Any = ()


class Known(NamedTuple):
    """The known parts of a flight whose derivative alone is needed: its increment and parts, and the pose after it."""

    increment: cp.Quaternion
    parts: Any
    pose: Any


class ExactFlight(JudgedFlight):
    """An exact flight, whose formulas are not differentiated."""

    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = RigidBody
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

    def carry(
        self,
        kind: Kind,
        inertia: Inertia,
        h: Array,
        momentum: cp.Vector,
        pose: Any,
        no_step: Array,
        known: Known | None = None,
    ) -> tuple[Flown, Any]:
        """`fly`, and the pose after it by `kind.act`, which have a shorter derivative together than separately."""
        return _carry(self, kind, inertia, h, momentum, known, pose, no_step)


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
    return Flown(_turned(chi, flown.increment), change, parts), chi


_fly.defjvp(_tangent, symbolic_zeros=True)


def _turned(chi: cp.Vector, increment: cp.Quaternion) -> cp.Quaternion:
    """The tangent of the increment, (0, chi/2) times the increment."""
    (a, b, c), (w, x, y, z) = cp.scale(0.5, chi), increment
    return -a * x - b * y - c * z, a * w + b * z - c * y, b * w + c * x - a * z, c * w + a * y - b * x


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _carry(
    flight: ExactFlight,
    kind: Kind,
    inertia: Inertia,
    h: Array,
    momentum: cp.Vector,
    known: Known | None,
    pose: Any,
    no_step: Array,
) -> tuple[Flown, Any]:
    flown = _fly(flight, inertia, h, momentum, known)
    return flown, kind.act(pose, flown.increment, no_step) if known is None else known.pose


def _carry_tangent(flight: ExactFlight, kind: Kind, primals: Any, tangents: Any) -> tuple[Any, Any]:
    """The tangent of `carry`: the initial pose rotates by chi and by its own change, and the flight carries both."""
    *_, pose, no_step = primals
    flown, end = _boundary(flight)(_carry(flight, kind, *primals))
    flown_dot, chi = _flown_tangent(flight, primals, tangents, flown)
    both = jax.tree.map(jnp.add, with_zeros(tangents[4], pose), kind.rate(pose, chi))
    _, end_dot = jax.jvp(lambda pose: kind.act(pose, flown.increment, no_step), (pose,), (both,))
    return (flown, end), (flown_dot, end_dot)


_carry.defjvp(_carry_tangent, symbolic_zeros=True)
