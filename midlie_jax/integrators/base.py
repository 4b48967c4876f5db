"""`Method`, the base class of every integrator: its properties, its step, and the call of that step by the drivers."""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._xla.apart import Placement
from .._xla.fusion import begin_step, fuse
from .._xla.mesh import NONE, Axes, all_promoted
from ..model.bodies import Body
from ..model.state import AnyState
from .system import AnyMotion, Stepped, System
from .verdict import FINE, earlier, is_fine


class Progress(NamedTuple):
    """The carry of a run from step to step: motion, force there if the method keeps it, and verdict so far."""

    motion: AnyMotion
    force: Any
    verdict: Any

    @property
    def ok(self) -> Any:
        return is_fine(self.verdict)


class Method(eqx.Module):
    """An integrator with a fixed step, made by `midlie_jax.method`.

    Attributes:
        name: as in `midlie_jax.methods()`.
        order: order of accuracy in the step.
        symmetric: whether a step of -h undoes a step of h, if the torque does not read the momentum.
        symplectic: whether a step preserves the Lie-Poisson structure to rounding, for torques from a potential.
        keeps_momentum: whether the spatial momentum of a free body stays constant to rounding.
        bodies: the class of body that the method moves.
        evaluations: torque evaluations per step.
    """

    name: str = eqx.field(static=True)
    order: int = eqx.field(static=True)
    bodies: type[Any] = eqx.field(static=True)
    evaluations: int = eqx.field(static=True)
    symmetric: bool = eqx.field(static=True)
    symplectic: bool = eqx.field(static=True)
    keeps_momentum: bool = eqx.field(static=True)

    @property
    def keeps_energy(self) -> bool:
        """Whether the energy stays constant to rounding, for torques from a potential that does not depend on time.

        This holds for steps of any length at which the result still has a few correct digits.
        """
        return False

    @property
    def random(self) -> bool:
        """Whether a step has a bath stage, and so needs a `midlie_jax.baths.Langevin`."""
        return False

    @property
    def solves(self) -> int:
        """Equations that a step solves by iteration."""
        return 0

    @property
    def unroll(self) -> int:
        """Steps per iteration of the loop over steps; on an accelerator, as many as fit one kernel.

        With two, XLA's CPU compiler need not copy the arrays, but compilation takes longer.
        """
        return 1

    @property
    def is_divided(self) -> bool:
        """Whether every part of a step is its own loop over the batch, so that the whole step is not one loop."""
        return False

    def loops_for(self, system: System) -> bool:
        """Whether a step of this system contains a loop over stages or a solver loop."""
        return self.solves > 0

    def is_one_loop(self, system: System) -> bool:
        """Whether a step of this system is one loop over the bodies of a batch, with a short torque and no bath."""
        return system.placement < Placement.OWN_LOOP and not self.loops_for(system) and system.bath is None

    @property
    def reach(self) -> float:
        """The largest angle of a step, h times `turn_rate`, in radians: `ok` is False above; infinity if unknown."""
        return math.inf

    @property
    def asks(self) -> tuple[float, float]:
        """The earliest and the latest time at which a step evaluates the torque, in steps after its start."""
        return 0.0, 1.0

    def turn_rate(self, inertia: Any, momentum: Any) -> Array:
        """The angle per unit of time to which `reach` refers: by default the angular speed |Omega| of a rigid body."""
        return cp.root(inertia.square_of_turn(1.0, momentum))

    def stability_limit(self, direction: complex) -> float:
        """The largest stable h |lambda| if disturbances grow as exp(lambda t); `direction` is lambda / |lambda|."""
        return math.inf

    def moves(self, body: Body) -> bool:
        """Whether the method supports a body of this class, in its principal axes."""
        return isinstance(body, self.bodies)

    @property
    def several(self) -> bool:
        """Whether the method supports coupled bodies."""
        return False

    def fitted(self, body: Body) -> "Method":
        """This method specialised to a body or a batch of bodies.

        Raises:
            ValueError: the moments are concrete, and the method does not support them.
        """
        return self

    def check(self, body: Any, torque: Any, start: Any, batch: int) -> None:
        """Raises unless the method supports this body under this torque, as far as their numbers show."""

    def system(self, body: Body, torque: Any, start: AnyState, t: Array, h: Array) -> System:
        """The system of a run: `System.of`, with the bath of the torque if there is one."""
        return System.of(body, torque, start, t)

    def keeps_force(self, system: System) -> bool:
        """Whether the force at the end of a step is kept for the next one."""
        return False

    def begin(self, system: System, start: AnyState, t: Array) -> Progress:
        """The progress before the first step of a run that starts at the time t."""
        motion = system.motion(start)
        return Progress(motion, system.force(t, motion) if self.keeps_force(system) else None, jnp.asarray(FINE))

    @abstractmethod
    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
        """One step of h from t0 to t1, from the force at t0 if `keeps_force`, else None.

        A step of zero must return the motion unchanged, bit for bit, and the force at t0. Returns the motion at t1, the
        force at t1 if `keeps_force`, else None, and a verdict, or whether the step succeeded.
        """

    def step_back(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool, Any]:
        """`step`, and the part of its result that `step_again` can reuse for the opposite direction, or None."""
        return *self.step(system, t0, t1, h, motion, force), None

    def step_again(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any, known: Any
    ) -> Stepped:
        """`step`, for its derivative only, after `step_back`, whose last result is `known`, took it back."""
        return self.step(system, t0, t1, h, motion, force)

    def advance(
        self,
        system: System,
        clock: Any,
        times: Callable[[Any], tuple[Array, Array, Any]],
        h: Array,
        progress: Progress,
        axes: Axes = NONE,
        step: Callable[..., Any] | None = None,
    ) -> tuple[Progress, Any]:
        """One step as used by every driver: one loop in the compiled program, and one loop in its derivative.

        `times` maps the clock to t0, t1 and further results to compute in the same loop. `axes` are the axes of a mesh
        along which the run varies. `step` is `step_back`, or `step_again` with its argument `known`, if not `step`.
        Returns the progress, and the further results; for `step_back` a pair of these and `known`.
        """
        carry, loops = (clock, h, progress), self.loops_for(system)  # loops make copies in each iteration
        shared = not (loops or self.is_one_loop(system))
        system, (clock, h, progress) = system.by_entries().begun(begin_step, carry, shared=shared)
        t0, t1, rest = times(clock)
        system = system.in_step(t0, t1, h)
        motion, force, ok, *known = (step or self.step)(system, t0, t1, h, progress.motion, progress.force)
        rest = (rest, *known) if known else rest
        result = all_promoted((Progress(motion, force, earlier(progress.verdict, ok)), rest), axes)
        return result if self.is_divided else fuse(result)
