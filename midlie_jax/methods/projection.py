"""Projection: the smallest change of a step's end that restores the energy, and the momentum about an axis in space.

A Runge-Kutta step of high order is accurate but conserves nothing. After it, the end is moved to where the invariants
have their values of the step's start. The change is of the size of the step's own error, so the order remains (Hairer,
Lubich & Wanner, Geometric Numerical Integration, IV.4).

The energy is K + V, for a torque from a potential V that does not depend on time. Where the torque has no component
about a direction d fixed in space (`Torque.fixed_axis`), as gravity has none about the vertical, Pi . d is the second
invariant; under no torque it is |Pi|^2 / 2. Under other torques the step is left as it is.

The change is taken along the gradients of the invariants, in a metric that weighs a change of the momentum by I^-1 and
a turn of the body by I/h^2. The pose takes part in it because a change of the momentum does not change the energy where
a swinging body stands still for a moment.

Gradients are taken in units in which the largest moment and h are 1: with respect to y = h Pi / largest moment, and to
the angles by which the body turns.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.replay import traits
from ..model.state import AnyState
from ..model.torques import TorqueLike, potential_of
from .inertia import Inertia
from .system import AnyMotion, Motion, System

OPERATIONS = 300  # about as many as the projection has for a simple torque
_ITERATIONS = 3  # Newton steps, of which the last is needed where the step itself has two or three digits


class _Gradient(NamedTuple):
    """The derivatives of an invariant with respect to y and to the angles, or a change of both."""

    momentum: cp.Vector
    turn: cp.Vector

    def raised(self, inertia: Inertia) -> "_Gradient":
        """The change along which the invariant grows fastest in the metric."""
        return _Gradient(cp.times(inertia.relative, self.momentum), cp.times(inertia.spins, self.turn))

    def along(self, change: "_Gradient") -> Array:
        return cp.dot(self.momentum, change.momentum) + cp.dot(self.turn, change.turn)


class _Invariant(NamedTuple):
    """An invariant of a step.

    Attributes:
        gradient: at the end.
        change: how much the invariant has changed since the start, in a unit of momentum, as a function of the motion.
    """

    gradient: _Gradient
    change: Callable[[AnyMotion], Array]


def projected(system: System, t0: Array, t1: Array, h: Array, start: AnyMotion, end: AnyMotion) -> AnyMotion:
    """The end of a step of h from t0 to t1, changed so that the invariants are those of its start."""
    energy = _energy(system, t0, t1, h, start, end)
    if energy is None:
        return end
    second = (_square if system.torque is None else _about_axis)(system, t0, h, start, end)
    inertia: Inertia = system.inertia
    up = energy.gradient.raised(inertia)
    a = energy.gradient.along(up)
    if second is None:
        side, b, c = None, jnp.zeros_like(a), jnp.ones_like(a)
    else:
        side = second.gradient.raised(inertia)
        b, c = second.gradient.along(up), second.gradient.along(side)
    determinant = a * c - b * b
    # The gradients are parallel in a steady motion. There the energy alone determines the change, along both.
    independent = determinant > float(jnp.finfo(h.dtype).eps) ** 0.4 * a * c
    b, c = jnp.where(independent, b, jnp.zeros_like(b)), jnp.where(independent, c, jnp.ones_like(c))
    determinant = a * c - b * b
    solvable = determinant > 0  # false for a body at rest
    inverse = jnp.where(solvable, cp.reciprocal(jnp.where(solvable, determinant, jnp.ones_like(a))), jnp.zeros_like(a))
    unit = h * inertia.per_unit
    for _ in range(_ITERATIONS):
        e = energy.change(end)
        m = None if second is None else jnp.where(independent, second.change(end), jnp.zeros_like(a))
        x = unit * inverse * (-c * e if m is None else b * m - c * e)
        momentum, turn = cp.scale(x, end.momentum), cp.scale(x, up.turn)
        if side is not None and m is not None:
            y = inverse * (b * e - a * m)  # zero where the gradients are parallel, as b and m are
            momentum = cp.add(momentum, cp.scale(y, side.momentum))
            turn = cp.add(turn, cp.scale(unit * y, side.turn))
        moved = system.pushed(end, momentum, t0)
        pose = system.kind.shift(moved.pose, system.kind.rate(moved.pose, turn), h == 0, t0)
        end = Motion(moved.momentum, pose)
    return end


def steady_potential(torque: TorqueLike, t: Array, state: AnyState) -> Callable[[Any, Any], Array] | None:
    """The potential V(t, state) of a torque on its body; None if it has none, or one that depends on time."""
    try:
        potential = potential_of(torque)
        depends_on_time = traits(lambda t, s: jnp.asarray(potential(t, s)), t, state).reads[0]
    except ValueError:  # the torque has no potential
        return None
    return None if depends_on_time else potential


def _energy(system: System, t0: Array, t1: Array, h: Array, start: AnyMotion, end: AnyMotion) -> _Invariant | None:
    """The energy; None where it changes with time or is not known, or where the torque is not that of a potential."""
    inertia: Inertia = system.inertia
    potential = None if system.torque is None else steady_potential(system.torque, t0, system.state(start))
    if system.reads_momentum or (system.torque is not None and potential is None):
        return None

    def potential_energy(motion: AnyMotion) -> Array:
        return jnp.zeros_like(h) if potential is None else system.number(potential, t0, motion)

    at_start = potential_energy(start)

    def change(motion: AnyMotion) -> Array:
        moved = inertia.travel(h, cp.subtract(motion.momentum, start.momentum))
        kinetic = 0.5 * cp.dot(cp.times(inertia.spins, moved), cp.add(motion.momentum, start.momentum))
        return kinetic + h * (potential_energy(motion) - at_start)

    turning = cp.times(inertia.spins, inertia.travel(h, end.momentum))
    return _Invariant(_Gradient(turning, inertia.travel(-h, cp.scale(h, system.force(t1, end)))), change)


def _about_axis(system: System, t0: Array, h: Array, start: AnyMotion, end: AnyMotion) -> _Invariant | None:
    """The momentum about the axis in space about which the torque has no component; None if there is none."""
    before, now = system.fixed_axis(t0, start), system.fixed_axis(t0, end)
    if before is None or now is None:
        return None

    def change(motion: AnyMotion) -> Array:
        axis = system.fixed_axis(t0, motion)
        moved, turned = cp.subtract(motion.momentum, start.momentum), cp.subtract(axis, before)
        return cp.dot(moved, axis) + cp.dot(start.momentum, turned)

    return _Invariant(_Gradient(now, cp.cross(system.inertia.travel(h, end.momentum), now)), change)


def _square(system: System, t0: Array, h: Array, start: AnyMotion, end: AnyMotion) -> _Invariant:
    """Half the square of the momentum."""
    del t0
    inertia: Inertia = system.inertia

    def change(motion: AnyMotion) -> Array:
        moved = inertia.travel(h, cp.subtract(motion.momentum, start.momentum))
        return 0.5 * cp.dot(moved, cp.add(motion.momentum, start.momentum))

    zero = jnp.zeros_like(h)
    return _Invariant(_Gradient(inertia.travel(h, end.momentum), (zero, zero, zero)), change)
