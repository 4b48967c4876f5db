"""What every integrator is: a step from one motion to the next, on components.

A `System` is everything that stays the same during a run, a `Motion` everything that changes. A `Method` steps
a motion; most are a flight and a scheme (`Splitting`), the rest are in `implicit/`.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.fusion import seam, together
from .._kernel.replay import Packed, by_components, traits
from ..model.bodies import Body, RigidBody, TensorBody, principal_of
from ..model.states import State
from ..model.torques import TorqueLike, on_body, velocity_dependent
from . import schemes
from .flights import Flight, Inertia

_NEEDS_NUMBERS = (jax.errors.TracerArrayConversionError, jax.errors.TracerIntegerConversionError)


class Motion(NamedTuple):
    """Momentum and pose, as `State.parts` gives them."""

    momentum: Any
    pose: Any


class System(NamedTuple):
    """A body made ready, the torque on it, and the kind of state that is followed."""

    inertia: Any  # `Inertia` for a rigid body, `Particles` themselves
    torque: TorqueLike | None
    kind: type[State]
    reads_momentum: bool  # whether the torque does: damping, control
    joint: Callable[[Any], Any]  # what a motion goes through between two parts of a step
    axes: cp.Quaternion | None = None  # principal components to those of states and torques, where these differ

    @classmethod
    def of(cls, body: Body, torque: TorqueLike | None, start: State, t: Array) -> "System":
        """Ready to step from the state `start`.

        A torque with a division, root or exponential in it is kept in loops of its own: XLA counts these as too dear
        to repeat, and would cut the loop around them at every value used twice.
        """
        axes = cp.unpack(body.axes) if isinstance(body, TensorBody) else None
        principal = principal_of(body)
        inertia = Inertia.of(principal) if isinstance(principal, RigidBody) else principal
        if torque is None:
            return cls(inertia, None, type(start), False, seam, axes)
        torque = on_body(torque, body)
        try:
            found = traits(torque, t, start)
        except (jax.errors.ConcretizationTypeError, *_NEEDS_NUMBERS) as error:
            raise ValueError(
                "the torque needs numbers where JAX has none yet: write jnp.where(condition, a, b) for an `if`, and "
                f"jax.numpy for numpy (jnp.cross for np.cross). JAX says: {str(error).splitlines()[0]}"
            ) from error
        reads = velocity_dependent(torque) or found.reads[1].momentum
        return cls(inertia, torque, type(start), reads, together if found.dear else seam, axes)

    def motion(self, state: State) -> Motion:
        """The motion of a state, in principal components."""
        motion = Motion(*state.parts())
        if self.axes is None:
            return motion
        return Motion(cp.rotate_back(self.axes, motion.momentum), self.kind.rotate(motion.pose, self.axes))

    def state(self, motion: Motion) -> State:
        """The inverse of `motion`."""
        return self.kind.join(*self.shown_motion(motion))

    def shown_motion(self, motion: Motion) -> Motion:
        """The motion in the components of states and torques."""
        if self.axes is None:
            return motion
        pose = self.kind.rotate(motion.pose, cp.conjugate(self.axes))
        return Motion(self.shown(motion.momentum), pose)

    def shown(self, vector: Any) -> Any:
        """A vector of principal components in those of states and torques."""
        return vector if self.axes is None else cp.rotate(self.axes, vector)

    def force(self, t: Array, motion: Motion) -> Any:
        """The torque's components, or the force on particles; zero where there is none."""
        if self.torque is None:
            return _like(motion.momentum, 0.0)
        motion = motion if self.joint is seam else together(motion)
        force = self._evaluate(self.torque, t, motion)
        return force if self.joint is seam else together(force)

    def gradient_force(self, t: Array, weight: Array, motion: Motion) -> Any:
        """The torque of the potential V - weight T . I^-1 T.

        That is T + 2 weight (dT + w x T) with w = I^-1 T and dT the change of T as the body turns with w: the
        derivatives of a potential along the body's axes do not commute. For particles the cross product is absent.
        """
        if self.torque is None:
            return _like(motion.momentum, 0.0)
        if self.reads_momentum:
            raise ValueError("a scheme with force gradients needs a torque from a potential, not one of the momentum.")
        torque = self.torque
        motion = motion if self.joint is seam else together(motion)

        def at(pose: Any) -> Any:
            return self._evaluate(torque, t, Motion(motion.momentum, pose))

        force = at(motion.pose)
        velocity = self.velocity(force)
        _, change = jax.jvp(at, (motion.pose,), (self.kind.rate(motion.pose, velocity),))
        if isinstance(self.inertia, Inertia):
            change = cp.add(change, cp.cross(velocity, force))
        force = _add(force, 2 * weight, change)
        return force if self.joint is seam else together(force)

    def _evaluate(self, torque: TorqueLike, t: Array, motion: Motion) -> Any:
        if not isinstance(motion.momentum, tuple):
            value = torque(t, self.kind.join(*motion))
            _check(value, motion.momentum)
            return value
        entries, out = on_arrays(torque, self.kind, t, self.shown_motion(motion))
        _check(out, jax.ShapeDtypeStruct((len(motion.momentum),), motion.momentum[0].dtype))
        force = tuple(entries)
        return force if self.axes is None else cp.rotate_back(self.axes, (force[0], force[1], force[2]))

    def velocity(self, momentum: Any) -> Any:
        """Angular velocity as components, I^-1 times a vector; of particles their velocity."""
        if isinstance(self.inertia, Inertia):
            return cp.times(self.inertia.inverses, momentum)
        return self.inertia.velocity(momentum)

    def turned(self, pose: Any, increment: Any, t: Array, h: Array) -> Any:
        """The pose after a flight in a step of h from time t."""
        return self.kind.turn(pose, increment, h == 0, t)


def on_arrays(
    function: Callable[[Any, Any], Any], kind: type[State], t: Array, motion: Motion
) -> tuple[list[Any], jax.ShapeDtypeStruct]:
    """Evaluates `function(t, state)`, written on arrays, on components: see `by_components`."""
    boxed = tuple(Packed(tuple(part)) if part else () for part in motion)
    return by_components(lambda t, momentum, pose: function(t, kind.of(momentum, pose)), t, *boxed)


class Method(eqx.Module):
    """An integrator with a fixed step. Get one from `midlie_jax.method`.

    Attributes:
        name: as in `midlie_jax.methods()`.
        order: order of accuracy in the step.
        symmetric: whether a step of -h undoes a step of h.
        bodies: the class of body it moves.
        evaluations: torque evaluations a step.
    """

    name: eqx.AbstractVar[str]
    order: eqx.AbstractVar[int]
    symmetric: eqx.AbstractVar[bool]
    bodies: eqx.AbstractVar[type]
    evaluations: eqx.AbstractVar[int]

    @property
    def unroll(self) -> int:
        """Steps a turn of the loop over steps. With two XLA need not copy the arrays, but compiles twice as long."""
        return 1

    def fitted(self, body: Body) -> "Method":
        """This method made for a body, or a batch of them; a ValueError if the body is known and it cannot move it."""
        del body
        return self

    @abstractmethod
    def keeps_force(self, system: System) -> bool:
        """Whether the force at the end of a step is kept for the next one."""

    @abstractmethod
    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion, force: Any
    ) -> tuple[Motion, Any, Array | bool]:
        """One step from t0 to t1 = t0 + h.

        Args:
            system, motion: see there.
            h: the signed step. Zero must leave the motion as it is, bit for bit, and return the force there.
            force: the force at t0 if `keeps_force`, else None.

        Returns:
            The motion at t1, the force there if kept, else None, and whether all solves succeeded.
        """


class Splitting(Method):
    """Flights with kicks between them, in the order and with the coefficients of a scheme.

    Attributes:
        flight, scheme: the two parts.
    """

    flight: Flight
    scheme: schemes.Scheme = eqx.field(static=True)
    name: str = eqx.field(static=True)
    order: int = eqx.field(static=True)
    symmetric: bool = eqx.field(static=True)
    bodies: type = eqx.field(static=True)
    evaluations: int = eqx.field(static=True)

    def __init__(self, flight: Flight, scheme: schemes.Scheme, name: str):
        self.flight = flight
        self.scheme = scheme.merged() if flight.order is None else scheme
        self.name = name
        self.order = scheme.order
        if flight.order is not None and not scheme.composed:
            self.order = min(scheme.order, flight.order)
        self.symmetric = scheme.symmetric
        self.bodies = flight.body
        self.evaluations = scheme.evaluations

    @property
    def unroll(self) -> int:
        return 2 if 2 * self.scheme.flights <= self.flight.per_loop else 1

    def fitted(self, body: Body) -> "Method":
        principal = principal_of(body)
        if not isinstance(principal, RigidBody) or cp.is_traced(principal.moments):
            return self
        flight = self.flight.fitted(principal.moments)
        return self if flight == self.flight else Splitting(flight, self.scheme, self.name)

    def keeps_force(self, system: System) -> bool:
        return system.torque is not None and self.scheme.reuses_force and not system.reads_momentum

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion, force: Any
    ) -> tuple[Motion, Any, Array | bool]:
        advance = self._in_a_loop if self._looped else self._written_out
        motion, force, ok = advance(_Stages(self.flight, system, t0, t1, h), motion, force)
        return motion, force if self.keeps_force(system) else None, ok

    @property
    def _looped(self) -> bool:
        """Whether the step is a loop over its stages: as many flights written out would take the compiler too long."""
        many = self.scheme.flights > max(2, self.flight.per_loop)
        return many and self.scheme.alternates and not self.scheme.gradients

    def _written_out(self, stages: "_Stages", motion: Motion, force: Any) -> tuple[Motion, Any, Array | bool]:
        ok: Array | bool = True

        def fly(a: float, motion: Motion) -> Motion:
            nonlocal ok
            motion, fine = stages.fly(a, motion)
            ok = ok & fine
            return together(motion) if self.scheme.flights > self.flight.per_loop else stages.system.joint(motion)

        motion, force = schemes.run(self.scheme, fly, stages.kick, stages.evaluate, motion, force)
        return motion, force, ok

    def _in_a_loop(self, stages: "_Stages", motion: Motion, force: Any) -> tuple[Motion, Any, Array | bool]:
        """A flight and a kick a turn, beginning with whichever the scheme begins with."""
        kicks, flights, times = self.scheme.columns()
        kicks_first = self.scheme.stages[0][0] == schemes.KICK
        if kicks_first and force is None:
            force = stages.evaluate(0.0, 0.0, motion)

        light = self.flight.per_loop > 2
        cut = stages.system.joint if light else together

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
            return together((motion, force, ok & fine)), None

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
            return self.t0 if c == 0 else self.t1 if c == 1 else self.t0 + c * self.h
        return jnp.where(c == 1, self.t1, self.t0 + c * self.h)

    def fly(self, a: Any, motion: Motion) -> tuple[Motion, Array | bool]:
        increment, change, ok = _fly(self.flight, self.system.inertia, a * self.h, motion.momentum)
        momentum = cp.accumulate(motion.momentum, change, self.t0)
        return Motion(momentum, self.system.turned(motion.pose, increment, self.t0, self.h)), ok

    def evaluate(self, c: Any, g: float, motion: Motion) -> Any:
        if self.system.torque is None:
            return None
        if g:
            return self.system.gradient_force(self._time(c), g * self.h * self.h, motion)
        return self.system.force(self._time(c), motion)

    def kick(self, b: Any, c: Any, motion: Motion, force: Any) -> Motion:
        if force is None:
            return motion
        if self.system.reads_momentum:
            half_way = Motion(_add(motion.momentum, b * self.h / 2, force), motion.pose)
            force = self.system.force(self._time(c), half_way)
        change = jax.tree.map(lambda f: b * self.h * f, force)
        return Motion(cp.accumulate(motion.momentum, change, self.t0), motion.pose)


@eqx.filter_jit
def _fly(flight: Flight, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
    """Traced once for all the flights of a step, and of every later method with this flight."""
    inertia, h, momentum = seam((inertia, h, momentum))
    return flight(inertia, h, momentum)


def _add(momentum: Any, h: Any, force: Any) -> Any:
    if isinstance(momentum, tuple):
        return tuple(p + h * f for p, f in zip(momentum, force, strict=True))
    return momentum + h * force


def _like(momentum: Any, value: float) -> Any:
    if isinstance(momentum, tuple):
        return tuple(jnp.full_like(p, value) for p in momentum)
    return jnp.full_like(momentum, value)


def _check(value: Any, like: Any) -> None:
    shape, dtype = tuple(jnp.shape(value)), jnp.result_type(value)
    if shape == tuple(like.shape) and dtype == like.dtype:
        return
    cure = "use jnp.stack([...]) and cast its parameters."
    if len(shape) > len(like.shape) and shape[len(shape) - len(like.shape) :] == tuple(like.shape):
        cure = "a parameter with one row a body needs midlie_jax.ensemble (and there torque_axes=0), or jax.vmap."
    raise ValueError(
        f"the torque must return {like.dtype}{list(like.shape)} like the momentum, got {dtype}{list(shape)}; {cure}"
    )
