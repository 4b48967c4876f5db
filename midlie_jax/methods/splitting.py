"""Methods made of flights with kicks between them, in the order and with the coefficients of a scheme."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.fusion import fuse, fuse_derivative
from ..model.bodies import Body, RigidBody, principal_of
from .base import Method
from .flights import Flight
from .scheme import KICK, Scheme, run
from .system import AnyMotion, Motion, System, added


class Splitting(Method):
    """A flight and a scheme.

    Attributes:
        flight, scheme: the two parts.
    """

    flight: Flight
    scheme: Scheme = eqx.field(static=True)
    name: str = eqx.field(static=True)
    order: int = eqx.field(static=True)
    symmetric: bool = eqx.field(static=True)
    symplectic: bool = eqx.field(static=True)
    keeps_momentum: bool = eqx.field(static=True)
    bodies: type = eqx.field(static=True)
    evaluations: int = eqx.field(static=True)

    def __init__(self, flight: Flight, scheme: Scheme, name: str):
        self.flight = flight
        self.scheme = scheme.merged() if flight.order is None else scheme
        self.name = name
        self.order = scheme.order
        if flight.order is not None and not scheme.composed:
            self.order = min(scheme.order, flight.order)
        self.symmetric = scheme.symmetric and flight.symmetric
        self.symplectic = flight.symplectic
        self.keeps_momentum = True
        self.bodies = flight.body
        self.evaluations = scheme.evaluations

    @property
    def unroll(self) -> int:
        return 2 if 2 * self.scheme.flights <= self.flight.per_loop else 1

    def fitted(self, body: Body) -> "Splitting":
        principal = principal_of(body)
        if not isinstance(principal, RigidBody) or cp.is_traced(principal.moments):
            return self
        flight = self.flight.fitted(principal.moments)
        return self if flight == self.flight else Splitting(flight, self.scheme, self.name)

    def keeps_force(self, system: System) -> bool:
        return system.torque is not None and self.scheme.reuses_force and not system.reads_momentum

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        advance = self._in_a_loop if self.loops else self._written_out
        motion, force, ok = advance(_Stages(self.flight, system, t0, t1, h), motion, force)
        return motion, force if self.keeps_force(system) else None, ok

    @property
    def loops(self) -> bool:
        """Whether the step is a loop over its stages: as many flights written out would take the compiler too long."""
        many = self.scheme.flights > max(2, self.flight.per_loop)
        return many and self.scheme.alternates and not self.scheme.gradients

    def _written_out(self, stages: "_Stages", motion: AnyMotion, force: Any) -> tuple[AnyMotion, Any, Array | bool]:
        ok: Array | bool = True

        def fly(a: float, motion: AnyMotion) -> AnyMotion:
            nonlocal ok
            motion, fine = stages.fly(a, motion)
            ok = ok & fine
            return fuse(motion) if self.scheme.flights > self.flight.per_loop else stages.system.cut(motion)

        motion, force = run(self.scheme, fly, stages.kick, stages.evaluate, motion, force)
        return motion, force, ok

    def _in_a_loop(self, stages: "_Stages", motion: AnyMotion, force: Any) -> tuple[AnyMotion, Any, Array | bool]:
        """A flight and a kick a turn, beginning with whichever the scheme begins with."""
        kicks, flights, times = self.scheme.columns()
        kicks_first = self.scheme.stages[0][0] == KICK
        if kicks_first and force is None:
            force = stages.evaluate(0.0, 0.0, motion)

        light = self.flight.per_loop > 2
        cut = stages.system.cut if light else fuse

        def turn(carry: Any, row: Any) -> tuple[Any, None]:
            motion, force, ok = carry
            kick, flight, here, there = row
            if kicks_first:
                motion = stages.kick(kick, here, motion, force)
            motion, fine = stages.fly(flight, motion)
            motion = cut(motion)
            force = stages.evaluate(there, 0.0, motion)
            if not kicks_first:
                motion, force = stages.kick(kick, there, motion, force), None
            return fuse((motion, force, ok & fine)), None

        rows = [kicks, flights, times[:-1], times[1:]]
        count = min(len(kicks), len(flights))
        rows = tuple(jnp.asarray(column[:count], stages.h.dtype) for column in rows)
        begin = motion, force, jnp.ones_like(stages.h, bool)
        (motion, force, ok), _ = jax.lax.scan(turn, begin, rows, unroll=2 if light else 1)
        if kicks_first:
            return stages.kick(kicks[-1], 1.0, motion, force), force, ok
        motion, fine = stages.fly(flights[-1], motion)
        return motion, None, ok & fine


class _Stages(NamedTuple):
    """The parts of one step; their coefficients are numbers, or scalars in a loop over stages."""

    flight: Flight
    system: System
    t0: Array
    t1: Array
    h: Array

    def _time(self, c: Any) -> Array:
        """c steps after the start of the step, and at its two ends exactly there."""
        if isinstance(c, float):
            return self.t0 if c == 0.0 else self.t1 if c == 1.0 else self.t0 + c * self.h
        return jnp.where(c == 1, self.t1, self.t0 + c * self.h)

    def fly(self, a: Any, motion: AnyMotion) -> tuple[AnyMotion, Array | bool]:
        increment, change, ok = _fly(self.flight, self.system.inertia, a * self.h, motion.momentum)
        momentum = cp.accumulate(motion.momentum, change, self.t0)
        return Motion(momentum, self.system.turned(motion.pose, increment, self.t0, self.h)), ok

    def evaluate(self, c: Any, g: float, motion: AnyMotion) -> Any:
        if self.system.torque is None:
            return None
        if g:
            return self.system.gradient_force(self._time(c), g * self.h * self.h, motion)
        return self.system.force(self._time(c), motion)

    def kick(self, b: Any, c: Any, motion: AnyMotion, force: Any) -> AnyMotion:
        if force is None:
            return motion
        if self.system.reads_momentum:
            half_way = Motion(added(motion.momentum, b * self.h / 2, force), motion.pose)
            force = self.system.force(self._time(c), half_way)
        change = jax.tree.map(lambda f: b * self.h * f, force)
        return Motion(cp.accumulate(motion.momentum, change, self.t0), motion.pose)


@eqx.filter_jit
def _fly(flight: Flight, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
    """Traced once for all the flights of a step, and of every later method with this flight."""
    inertia, h, momentum = fuse_derivative((inertia, h, momentum))
    return flight(inertia, h, momentum)
