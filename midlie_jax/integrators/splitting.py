"""`Splitting`, a method whose step alternates flights and kicks in the order and with the coefficients of a scheme."""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._xla.apart import Placement
from .._xla.fusion import begin, begin_step, cut, fuse, fuse_derivative, split
from .._xla.keep import kept, recomputed
from .._xla.platform import on_cpu
from ..model.baths.base import BathOfBodies
from ..model.bodies import Body
from ..model.kind import Kind
from ..model.state import AnyState
from ..model.torques.reads_body import without_bath
from .base import Method
from .flights import Flight
from .flights.exact import ExactFlight, Flown, Known, carry
from .limits import decay_limit, oscillator_limit
from .scheme import BATH, FLIGHT, KICK, Scheme, run
from .system import AnyMotion, Motion, Stepped, System, added
from .verdict import BEYOND, FINE, NOT_FINITE, as_verdict, earlier, of_all


class Splitting(Method):
    """The method of a flight and a scheme; if the flight is exact, adjacent flights are merged."""

    flight: Flight
    scheme: Scheme = eqx.field(static=True)

    def __init__(self, flight: Flight, scheme: Scheme, name: str):
        self.flight = flight
        self.scheme = scheme.merged() if flight.order is None else scheme
        self.name = name
        self.order = scheme.order
        if flight.order is not None and not scheme.composed:
            self.order = min(scheme.order, flight.order)
        self.symmetric = scheme.symmetric and flight.symmetric
        self.symplectic = flight.symplectic and not scheme.random and not scheme.displaced
        self.keeps_momentum = not scheme.random
        self.bodies = flight.body
        self.evaluations = scheme.evaluations

    @property
    def random(self) -> bool:
        return self.scheme.random

    @property
    def solves(self) -> int:
        return self.scheme.flights * self.flight.solves

    @property
    def unroll(self) -> int:
        if on_cpu():
            return 2 if 2 * self.scheme.flights <= self.flight.per_loop else 1
        return max(1, self.flight.per_kernel // self.scheme.flights)

    @property
    def reach(self) -> float:
        return self.flight.reach / max(abs(c) for kind, c in self.scheme.stages if kind == FLIGHT)

    @property
    def asks(self) -> tuple[float, float]:
        times = self.scheme.times_of_kicks
        return min((0.0, *times)), max((1.0, *times))

    def turn_rate(self, inertia: Any, momentum: Any) -> Array:
        return self.flight.turn_rate(inertia, momentum)

    @property
    def several(self) -> bool:
        return True

    def moves(self, body: Body) -> bool:
        return isinstance(body.turning, self.flight.bodies)

    def stability_limit(self, direction: complex) -> float:
        decays = -direction.real > abs(direction.imag)
        return decay_limit(self.scheme) if decays else oscillator_limit(self.scheme)

    def fitted(self, body: Body) -> "Splitting":
        flight = self.flight.fitted(body.in_principal_axes().turning)
        return self if flight == self.flight else Splitting(flight, self.scheme, self.name)

    def system(self, body: Body, torque: Any, start: AnyState, t: Array, h: Array) -> System:
        if not self.random:
            return super().system(body, torque, start, t, h)
        rest, bath = without_bath(torque)
        assert isinstance(bath, BathOfBodies)
        bath.check_on(start, body)
        coefficients = {b for kind, b in self.scheme.stages if kind == BATH}
        prepared = bath.prepared(body, coefficients, t, h, start)
        return System.of(body, rest, start, t)._replace(bath=prepared)

    def keeps_force(self, system: System) -> bool:
        return self.scheme.reuses_force and system.keeps_torque

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
        return self._step(system, t0, t1, h, motion, force)

    def step_back(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool, Any]:
        used = isinstance(self.flight, ExactFlight) and system.kind.has_pose and not self.loops_for(system)
        flown: list[Known] | None = [] if used else None
        return *self._step(system, t0, t1, h, motion, force, flown=flown), flown

    def step_again(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any, known: Any
    ) -> Stepped:
        known = None if known is None else [flown._replace(increment=cp.conjugate(flown.increment)) for flown in known]
        return self._step(system, t0, t1, h, motion, force, known=known)

    def _step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any, **known: Any
    ) -> Stepped:
        stages = _Stages(self.flight, system, t0, t1, h, self.scheme.displaced, **known)
        advance = self._step_in_loop if self.loops_for(system) else self._step_unrolled
        motion, force, ok = advance(stages, motion, force)
        return motion, force if self.keeps_force(system) else None, ok

    @property
    def _can_loop(self) -> bool:
        return self.scheme.alternates and not self.scheme.gradients

    @property
    def loops(self) -> bool:
        """Whether the step is a loop over its stages, because the unrolled step would take too long to compile."""
        return self.scheme.flights > max(2, self.flight.per_loop) and self._can_loop

    def loops_for(self, system: System) -> bool:
        """True also for a separately compiled torque, so that a step holds one copy of it."""
        return self.loops or (system.placement is Placement.APART and self._can_loop and self.scheme.flights > 1)

    def _step_unrolled(self, stages: "_Stages", motion: AnyMotion, force: Any) -> Stepped:
        ok: Array | bool = True

        def fly(a: float, motion: AnyMotion) -> AnyMotion:
            nonlocal ok, stages
            motion, flight_ok = stages.fly(a, motion)
            ok = earlier(ok, flight_ok)
            ended = self._after_unrolled_flight(stages.system, motion)
            if ended is motion:  # the flight and the kick after it are one loop
                return motion
            system, motion = stages.system.begun(begin, ended)
            stages = stages._replace(system=system)
            return motion

        # Each call takes the `stages` at its time.
        parts = fly, lambda *given: stages.kick(*given), lambda *given: stages.evaluate(*given)
        motion, force = run(self.scheme, *parts, motion, force, lambda *given: stages.bathe(*given))
        return motion, force, ok

    def _after_unrolled_flight(self, system: System, motion: AnyMotion) -> AnyMotion:
        if self.scheme.flights > self.flight.per_loop:
            return cut(motion)
        # A compensated sum needs both parts, and XLA would repeat the flight for each of them.
        if system.kind.compensated and (self.scheme.flights > 1 or system.torque is not None):
            return split(motion)
        # For a long wrench, which reads thirteen numbers, XLA would repeat a long flight.
        travels = system.kind.rotation is not None or system.kind.several
        if system.placement.is_long and travels and self.flight.per_loop <= 2:
            return split(motion)
        return system.placement.after_flight(motion)

    def _step_in_loop(self, stages: "_Stages", motion: AnyMotion, force: Any) -> Stepped:
        """The step as a loop, whose iterations are a flight and the kick after it; the last flight follows the loop.

        If the step begins with a kick, this kick precedes the loop, so that no iteration passes a force through memory
        to the next one. Only a separately compiled torque is in the loop once for all flights, each after its kick.
        """
        kicks, flights, times = self.scheme.columns()
        if kicks_first := self.scheme.stages[0][0] == KICK:
            force = stages.evaluate(0.0, 0.0, motion) if force is None else force
            if stages.system.placement is Placement.APART:

                def kick_and_fly(stages: _Stages, row: Any, motion: AnyMotion, force: Any, ok: Any) -> Any:
                    kick, flight, start_time, end_time = row
                    motion = stages.kick(kick, start_time, motion, force)
                    motion, force, flight_ok = self._flown(stages, flight, end_time, motion)
                    return motion, force, earlier(ok, flight_ok)

                columns = kicks[:-1], flights, times[:-1], times[1:]
                motion, force, ok = self._over_stages(kick_and_fly, stages, columns, motion, force)
                return stages.kick(kicks[-1], 1.0, motion, force), force, ok
            motion = fuse(stages.kick(kicks[0], 0.0, motion, force))
            kicks = kicks[1:]

        def fly_and_kick(stages: _Stages, row: Any, motion: AnyMotion, ok: Any) -> Any:
            flight, end_time, kick = row
            motion, force, flight_ok = self._flown(stages, flight, end_time, motion)
            return stages.kick(kick, end_time, motion, force), earlier(ok, flight_ok)

        columns = flights[:-1], times[1:-1], kicks[: len(flights) - 1]
        motion, ok = self._over_stages(fly_and_kick, stages, columns, motion)
        system, motion = stages.system.begun(begin, motion, shared=True)
        stages = stages._replace(system=system)
        if kicks_first:
            motion, force, flight_ok = self._flown(stages, flights[-1], 1.0, motion)
            return stages.kick(kicks[-1], 1.0, motion, force), force, earlier(ok, flight_ok)
        motion, flight_ok = stages.fly(flights[-1], motion)
        return motion, None, earlier(ok, flight_ok)

    def _over_stages(self, part: Callable[..., Any], stages: "_Stages", columns: Any, *start: Any) -> Any:
        """The end of a scan. A reverse derivative recomputes each iteration, or it would store all of its numbers."""

        def iteration(carry: Any, row: Any) -> tuple[Any, None]:
            system, carry = stages.system.begun(begin_step, carry, shared=True)
            return fuse(part(stages._replace(system=system), row, *carry)), None

        rows = tuple(jnp.asarray(column, stages.h.dtype) for column in columns)
        carry = *start, jnp.full_like(stages.h, FINE, FINE.dtype)
        unroll = self.flight.per_kernel if not on_cpu() else 2 if self.flight.per_loop > 2 else 1
        return jax.lax.scan(recomputed(iteration, middle=False), carry, rows, unroll=unroll)[0]

    def _flown(self, stages: "_Stages", flight: Any, end_time: Any, motion: AnyMotion) -> tuple[AnyMotion, Any, Any]:
        """The motion after a flight in a loop, the force there and the verdict; a long flight fills its own loop."""
        motion, ok = stages.fly(flight, motion)
        motion = stages.system.placement.after_flight(motion) if self.flight.per_loop > 2 else split(motion)
        return motion, stages.evaluate(end_time, 0.0, motion), ok


class _Stages(NamedTuple):
    """The parts of one step. Coefficients are Python floats, or traced scalars in a loop over the stages."""

    flight: Flight
    system: System
    t0: Array
    t1: Array
    h: Array
    displaced: bool
    flown: list[Known] | None = None  # a list to which each flight adds the known parts of its reverse; or None
    # the known parts of the flights, from the last to the first, or None; each flight removes its entry
    known: list[Known] | None = None

    def _time(self, c: Any) -> Array:
        """The time c h after the start of the step: exactly t0 for c = 0 and exactly t1 for c = 1."""
        if isinstance(c, float):
            return self.t0 if c == 0.0 else self.t1 if c == 1.0 else self.t0 + c * self.h
        return jnp.where(c == 1, self.t1, self.t0 + c * self.h)

    def fly(self, a: Any, motion: AnyMotion) -> tuple[AnyMotion, Array | bool]:
        order = -1 if self.known else 1  # the known parts of the last body are last in the list
        flown = [self._fly_one(a, *member) for member in self.system.members(motion)[::order]][::order]
        ok = reduce(earlier, (one for _, one in flown), True)
        return self.system.of_members([motion for motion, _ in flown]), ok

    def _fly_one(self, a: Any, system: System, motion: AnyMotion) -> tuple[AnyMotion, Array | bool]:
        rotated, ok = self._turn(a, *system.rotating(motion))
        moved = system.travelled(a * self.h, motion, rotated)
        # Otherwise the flight would be repeated in the loop that checks the success of all.
        if system.placement is Placement.APART:
            moved, ok = split((moved, ok))
        return moved, of_all(ok)

    def _turn(self, a: Any, system: System, motion: AnyMotion) -> tuple[AnyMotion, Array | bool]:
        known = self.known.pop() if self.known else None
        if isinstance(self.flight, ExactFlight) and system.kind.has_pose:
            arguments = system.inertia, a * self.h, motion, self.h == 0, known
            flown, pose, ok = _carry(self.flight, system.kind, *arguments)
            if self.flown is not None:
                self.flown.append(Known(flown.increment, flown.parts, motion.pose))
            return system.pushed(Motion(motion.momentum, pose), flown.change), ok
        increment, change, ok = _fly(self.flight, system.kind.has_pose, system.inertia, a * self.h, motion.momentum)
        motion = system.pushed(motion, change)
        return Motion(motion.momentum, system.turned(motion.pose, increment, self.h)), ok

    def evaluate(self, c: Any, g: float, motion: AnyMotion) -> Any:
        if self.system.torque is None:
            return None
        if g:
            if self.system.reads_momentum:
                raise ValueError(
                    "torque must not depend on the momentum under a scheme with force gradients. Use a scheme without "
                    "gradients."
                )
            gradient = self.system.displaced_force if self.displaced else self.system.gradient_force
            return gradient(self._time(c), g * self.h * self.h, motion)
        return self.system.force(self._time(c), motion)

    def bathe(self, b: float, c: float, stage: int, motion: AnyMotion) -> AnyMotion:
        t = self._time(c)
        bathed = self.system.of_members([own.bathed(b, t, stage, one) for own, one in self.system.members(motion)])
        # The exposures belong to a whole step. A step of length zero leaves the motion unchanged.
        return jax.tree.map(lambda old, new: jnp.where(self.h == 0, old, new), motion, bathed)

    def kick(self, b: Any, c: Any, motion: AnyMotion, force: Any) -> AnyMotion:
        if force is None:
            return motion
        if self.system.reads_momentum:
            midpoint = Motion(added(motion.momentum, b * self.h / 2, force), motion.pose)
            force = self.system.force(self._time(c), midpoint)
        change = jax.tree.map(lambda f: b * self.h * f, force)
        pushed = self.system.pushed(motion, change)
        # Everything after the first kick reads the motion after that kick, not the force left by the previous step.
        first = isinstance(c, float) and c == 0.0 and not self.system.reads_momentum
        return kept(pushed) if first else pushed


@eqx.filter_jit
def _fly(flight: Flight, has_pose: bool, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
    """A flight, traced once for all methods that have it; its increment is None for a state without a pose."""
    if flight.long_derivative:
        inertia, h, momentum = fuse_derivative((inertia, h, momentum))
    if has_pose:
        return flight.judged(inertia, h, momentum)
    change, ok = flight.momentum_change(inertia, h, momentum)
    if isinstance(flight, ExactFlight):  # it solves nothing and fails only beyond its reach or without finite numbers
        return None, change, jnp.where(ok, FINE, jnp.where(momentum[0] == momentum[0], BEYOND, NOT_FINITE))
    return None, change, as_verdict(ok)


@eqx.filter_jit
def _carry(
    flight: ExactFlight,
    kind: Kind,
    inertia: Any,
    h: Array,
    motion: AnyMotion,
    no_step: Array,
    known: Known | None,
) -> tuple[Flown, Any, Array | bool]:
    flown, pose = carry(flight, kind, inertia, h, motion.momentum, known, motion.pose, no_step)
    ok = True if known is not None else flight.verdict(inertia, h, motion.momentum)
    return flown, pose, ok
