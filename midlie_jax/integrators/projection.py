"""Projection: the smallest change of the end of a step that restores the energy and the momentum about a space axis.

The invariants get their values at the start of the step. The change has the size of the error of the step, so the order
remains (`docs/reports/exact-flight.md`). The energy is K + V, for a torque from a potential V that does not depend on
time. If the torque has no component about a space-fixed direction d (`Torque.fixed_axis`), such as gravity about the
vertical, Pi . d is the second invariant; without torque it is |Pi|^2 / 2. For other torques the step is unchanged.

The change is along the gradients of the invariants, in a metric that weighs a change of the momentum by I^-1 and a
rotation of the body by I/h^2. They are taken in units in which the largest moment and h are 1: with respect to
y = h Pi / largest moment, and to the rotation angles of the body.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._xla.replay import traits
from ..model.inertia import Inertia
from ..model.state import AnyState
from ..model.torques import TorqueLike, potential_of
from .system import AnyMotion, Motion, System

OPERATIONS = 800  # approximate number of operations of the projection for a simple torque
# The number of corrections with the gradients at the end of the step, and with those after the first correction. The
# error relative to the energy decreases to its second, fourth and sixth power.
_CORRECTIONS = (1, 2)
_ROUNDING = 64  # the largest change of the energy by rounding, in eps times the size of its terms


Height = Callable[[AnyMotion], Array]  # the potential energy of a motion


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
    """An invariant of a step: its change since the start, in a unit of momentum, and its derivative."""

    change: Callable[[AnyMotion], Array]
    gradient: Callable[[AnyMotion], _Gradient]


def projected(
    system: System, t0: Array, t1: Array, h: Array, start: AnyMotion, end: AnyMotion
) -> tuple[AnyMotion, Array | bool]:
    """The end of a step of h, with the invariants of its start; False if the energy differs beyond rounding."""
    potential = None
    if system.torque is not None:
        potential = None if system.reads_momentum else steady_potential(system.torque, t0, system.state(start))
        if potential is None:
            return end, True

    def height(motion: AnyMotion) -> Array:
        return jnp.zeros_like(t0) if potential is None else system.number(potential, t0, motion)

    energy = _energy(system, t1, h, start, height)
    second = _square(system, h, start) if system.torque is None else _about_axis(system, t0, h, start)
    error = jnp.abs(energy.change(end))
    # Kinetic and potential energy plus the work of the torque over one radian, in the unit of `change`.
    turning = cp.times(system.inertia.spins, system.inertia.travel(h, end.momentum))
    torque = sum(map(jnp.abs, system.force(t1, end)), jnp.zeros_like(h))
    potential_energy = jnp.abs(height(end))
    size = jnp.abs(cp.dot(turning, end.momentum)) + jnp.abs(h) * (potential_energy + torque)
    for corrections in _CORRECTIONS:
        end = _corrected(system, h, end, energy, second, corrections)
    eps = float(jnp.finfo(h.dtype).eps)
    # A potential whose terms are larger than their sum has a rounding error above the last place of `size`. A remaining
    # change of energy counts as such rounding if the error before the corrections was too small for them to fail.
    small = eps ** (1 / 3) * size
    return end, jnp.abs(energy.change(end)) <= jnp.where(error <= small, small, _ROUNDING * eps * size)


def _corrected(
    system: System, h: Array, end: AnyMotion, energy: _Invariant, second: _Invariant | None, corrections: int
) -> AnyMotion:
    """The end after some corrections, all along the gradients at the point before them."""
    inertia: Inertia = system.inertia
    slope = energy.gradient(end)
    up = slope.raised(inertia)
    a = slope.along(up)
    if second is None:
        side, b, c = None, jnp.zeros_like(a), jnp.ones_like(a)
    else:
        slope = second.gradient(end)
        side = slope.raised(inertia)
        b, c = slope.along(up), slope.along(side)
    determinant = a * c - b * b
    # In a steady motion the gradients are parallel. The energy alone then determines the change along both.
    independent = determinant > float(jnp.finfo(h.dtype).eps) ** 0.4 * a * c
    b, c = jnp.where(independent, b, jnp.zeros_like(b)), jnp.where(independent, c, jnp.ones_like(c))
    determinant = a * c - b * b
    solvable = determinant > 0  # false for a body at rest
    inverse = jnp.where(solvable, cp.reciprocal(jnp.where(solvable, determinant, jnp.ones_like(a))), jnp.zeros_like(a))
    unit = h * inertia.per_unit
    for _ in range(corrections):
        e = energy.change(end)
        m = None if second is None else jnp.where(independent, second.change(end), jnp.zeros_like(a))
        x = unit * inverse * (-c * e if m is None else b * m - c * e)
        momentum, turn = cp.scale(x, end.momentum), cp.scale(x, up.turn)
        if side is not None and m is not None:
            y = inverse * (b * e - a * m)  # zero where the gradients are parallel, as b and m are
            momentum = cp.add(momentum, cp.scale(y, side.momentum))
            turn = cp.add(turn, cp.scale(unit * y, side.turn))
        moved = system.pushed(end, momentum)
        pose = system.kind.shift(moved.pose, system.kind.rate(moved.pose, turn), h == 0)
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


def _energy(system: System, t1: Array, h: Array, start: AnyMotion, height: Height) -> _Invariant:
    inertia: Inertia = system.inertia
    at_start = height(start)

    def change(motion: AnyMotion) -> Array:
        moved = inertia.travel(h, cp.subtract(motion.momentum, start.momentum))
        kinetic = 0.5 * cp.dot(cp.times(inertia.spins, moved), cp.add(motion.momentum, start.momentum))
        return kinetic + h * (height(motion) - at_start)

    def gradient(motion: AnyMotion) -> _Gradient:
        turning = cp.times(inertia.spins, inertia.travel(h, motion.momentum))
        return _Gradient(turning, inertia.travel(-h, cp.scale(h, system.force(t1, motion))))

    return _Invariant(change, gradient)


def _about_axis(system: System, t0: Array, h: Array, start: AnyMotion) -> _Invariant | None:
    """The momentum about a space-fixed axis about which the torque has no component; None if there is none."""
    before = system.fixed_axis(t0, start)
    if before is None:
        return None

    def change(motion: AnyMotion) -> Array:
        axis = system.fixed_axis(t0, motion)
        moved, turned = cp.subtract(motion.momentum, start.momentum), cp.subtract(axis, before)
        return cp.dot(moved, axis) + cp.dot(start.momentum, turned)

    def gradient(motion: AnyMotion) -> _Gradient:
        axis = system.fixed_axis(t0, motion)
        return _Gradient(axis, cp.cross(system.inertia.travel(h, motion.momentum), axis))

    return _Invariant(change, gradient)


def _square(system: System, h: Array, start: AnyMotion) -> _Invariant:
    inertia: Inertia = system.inertia

    def change(motion: AnyMotion) -> Array:
        moved = inertia.travel(h, cp.subtract(motion.momentum, start.momentum))
        return 0.5 * cp.dot(moved, cp.add(motion.momentum, start.momentum))

    def gradient(motion: AnyMotion) -> _Gradient:
        zero = jnp.zeros_like(h)
        return _Gradient(inertia.travel(h, motion.momentum), (zero, zero, zero))

    return _Invariant(change, gradient)
