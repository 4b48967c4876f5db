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

from . import _components as cp
from . import schemes
from ._fuse import seam, together
from ._scalars import Packed, by_components, is_dear
from .bodies import Particles, RigidBody, State
from .flights import Flight, Inertia
from .torques import TorqueLike, velocity_dependent


class Motion(NamedTuple):
    """Momentum and pose, as `State.parts` gives them."""

    momentum: Any
    pose: Any


class System(NamedTuple):
    """A body made ready, the torque on it, and the kind of state that is followed."""

    inertia: Any  # `Inertia` for a rigid body, `Particles` themselves
    torque: TorqueLike | None
    kind: type[State]
    joint: Callable[[Any], Any]  # what a motion goes through between two parts of a step

    @classmethod
    def of(cls, body: RigidBody | Particles, torque: TorqueLike | None, start: State, t: Array) -> "System":
        """Ready to step from the state `start`.

        A torque with a division, root or exponential in it is kept in loops of its own: XLA counts these as too dear
        to repeat, and would cut the loop around them at every value used twice.
        """
        inertia = Inertia.of(body) if isinstance(body, RigidBody) else body
        dear = torque is not None and is_dear(torque, t, start)
        return cls(inertia, torque, type(start), together if dear else seam)

    def force(self, t: Array, motion: Motion) -> Any:
        """The torque's components, or the force on particles; zero where there is none."""
        if self.torque is None:
            return _like(motion.momentum, 0.0)
        torque, kind = self.torque, self.kind
        motion = motion if self.joint is seam else together(motion)
        force = self._evaluate(torque, kind, t, motion)
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
        torque, kind = self.torque, self.kind
        motion = motion if self.joint is seam else together(motion)

        def at(pose: Any) -> Any:
            return self._evaluate(torque, kind, t, Motion(motion.momentum, pose))

        force = at(motion.pose)
        rigid = isinstance(self.inertia, Inertia)
        velocity = cp.times(self.inertia.inverses, force) if rigid else self.inertia.velocity(force)
        _, change = jax.jvp(at, (motion.pose,), (kind.rate(motion.pose, velocity),))
        if rigid:
            change = cp.add(change, cp.cross(velocity, force))
        force = _add(force, 2 * weight, change)
        return force if self.joint is seam else together(force)

    @staticmethod
    def _evaluate(torque: TorqueLike, kind: type[State], t: Array, motion: Motion) -> Any:
        if not isinstance(motion.momentum, tuple):
            value = torque(t, kind.join(*motion))
            _check(value, motion.momentum)
            return value
        boxed = tuple(Packed(tuple(part)) if part else () for part in motion)
        entries, out = by_components(lambda t, momentum, pose: torque(t, kind.of(momentum, pose)), t, *boxed)
        _check(out, jax.ShapeDtypeStruct((len(motion.momentum),), motion.momentum[0].dtype))
        return tuple(entries)

    @property
    def reads_momentum(self) -> bool:
        return velocity_dependent(self.torque)

    def turned(self, pose: Any, increment: Any) -> Any:
        return self.kind.turn(pose, increment)

    def landed(self, pose: Any, increment: Any, h: Array) -> Any:
        """The pose after the last turn of a step, freed of the rounding that would change its length in time."""
        return self.kind.unit(self.kind.turn(pose, increment), h == 0)


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
        self.scheme = scheme
        self.name = name
        self.order = scheme.order
        if flight.order is not None and not scheme.composed:
            self.order = min(scheme.order, flight.order)
        self.symmetric = scheme.symmetric
        self.bodies = flight.body
        self.evaluations = scheme.evaluations

    def keeps_force(self, system: System) -> bool:
        return system.torque is not None and self.scheme.reuses_force and not system.reads_momentum

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion, force: Any
    ) -> tuple[Motion, Any, Array | bool]:
        oks = []

        def time(c: float) -> Array:
            return t0 if c == 0 else t1 if c == 1 else t0 + c * h

        def fly(a: float, motion: Motion) -> Motion:
            increment, momentum, ok = _fly(self.flight, system.inertia, a * h, motion.momentum)
            oks.append(ok)
            last = len(oks) == self.scheme.flights
            pose = system.landed(motion.pose, increment, h) if last else system.turned(motion.pose, increment)
            cut = together if self.scheme.flights > self.flight.per_loop else system.joint
            return cut(Motion(momentum, pose))

        def evaluate(c: float, g: float, motion: Motion) -> Any:
            if system.torque is None:
                return None
            return system.gradient_force(time(c), g * h * h, motion) if g else system.force(time(c), motion)

        def kick(b: float, c: float, motion: Motion, force: Any) -> Motion:
            if force is None:
                return motion
            if system.reads_momentum:
                half_way = Motion(_add(motion.momentum, b * h / 2, force), motion.pose)
                force = system.force(time(c), half_way)
            return Motion(_add(motion.momentum, b * h, force), motion.pose)

        motion, last = schemes.run(self.scheme, fly, kick, evaluate, motion, force)
        ok = oks[0]
        for other in oks[1:]:
            ok = ok & other
        return motion, last if self.keeps_force(system) else None, ok


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
    if jnp.shape(value) != jnp.shape(like) or jnp.result_type(value) != like.dtype:
        raise ValueError(
            f"the torque must return {like.dtype}{list(like.shape)} like the momentum, got "
            f"{jnp.result_type(value)}{list(jnp.shape(value))}; use jnp.stack([...]) and cast its parameters."
        )
