"""A method of the package as a solver of diffrax: the step, and everything that diffrax asks for beside it."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, cast

import diffrax
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel.checks import described
from ..drivers.arguments import as_method
from ..methods.base import Method, Progress
from ..methods.registry import DEFAULT
from ..methods.schemes import KICK
from ..methods.splitting import Splitting
from ..methods.system import AnyMotion, System
from ..model.torques import velocity_dependent
from .estimate import REFERENCE_ORDER, History, companion
from .interpolation import LieInterpolation
from .term import RigidBodyTerm, as_time, check, like, packed


class Memory(NamedTuple):
    """What one step keeps for the next.

    Attributes:
        force: the torque at the state, as components; for particles the force.
        history: for the error estimate.
    """

    force: Any
    history: History


class LieSolver(diffrax.AbstractAdaptiveSolver[Any]):
    """A method of this package as a solver for diffrax; terms must be a `RigidBodyTerm`, the state one of ours.

    Order: that of the method. Interpolation: `LieInterpolation`. Torque evaluations: those of the method; where an
    adaptive controller or dense output (`SaveAt(ts=...)`, an event) asks for the torques at both ends of a step,
    methods that begin with a kick (E2, EA, SRKN6b, SRKN11b and the compositions TJ4 to KL8, under a torque that does
    not read the momentum), AKW, NMB, symplectic Euler and Verlet have them already; for the others the controller
    costs one more, dense output two.

    Error estimate: the step less its companion in `estimate`. By the order p of the method:

    - p = 1: the true local error, asymptotically; of order h^2.
    - p = 2: the same; h^3.
    - p >= 4: that of the companion; h^4 in the momentum, h^5 in the attitude. Larger than the step's own error.

    `error_order` is that exponent (4 for p >= 4). A first step's estimate is of order h^2 in the momentum. No
    derivative passes through the estimate. Prefer constant steps for long runs: a varying step loses the long-time
    behaviour of energy for which these methods are chosen (`benchmarks/diffrax_pipeline.py energy`).

    A step whose solve failed, or that is not finite, or that turned by more than 2.4 radians, has an infinite error,
    so that a controller tries a shorter one; where none does, the first two make the solution's result
    `diffrax.RESULTS.nonlinear_divergence`. A reverse derivative is NaN if such a step on the way was not finite.

    Adjoints: RecursiveCheckpointAdjoint, DirectAdjoint and ForwardMode differentiate the steps taken;
    `BacksolveAdjoint(solver=diffrax.Tsit5())` the motion, and is off by the error of the method. `ImplicitAdjoint` is
    for steady states, which a conservative motion does not run into.

    Attributes:
        method: from `midlie_jax.method`, or its name; JACOBI[EA] unless given, which moves rigid bodies.

    Raises:
        ValueError: unknown method; from `diffeqsolve`, a term, state, batch or dtype that does not fit.
    """

    method: Method
    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = LieInterpolation

    def __init__(self, method: Any = DEFAULT):
        self.method = as_method(method)

    def order(self, terms: Any) -> int:
        """That of the method; at most 2 for flights and kicks under a torque declared `VelocityDependent`."""
        limited = isinstance(self.method, Splitting) and velocity_dependent(_only(terms).torque)
        return min(self.method.order, 2) if limited else self.method.order

    def error_order(self, terms: Any) -> int:
        """The exponent of h in the error estimate."""
        return min(self.order(terms), REFERENCE_ORDER) + 1

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Memory:
        """The torque at t0, and no history."""
        del t1
        system, clock = self._system(terms, t0, y0, args)
        return self._fresh(system, clock(t0), system.motion(y0))

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Memory, made_jump: Any
    ) -> tuple[Any, Any, dict[str, Any], Memory, diffrax.RESULTS]:
        system, clock = self._system(terms, t0, y0, args)
        here, there, h = clock(t0), clock(t1), as_time(terms.contr(t0, t1), y0)
        motion = system.motion(y0)
        keeps, begins = self.method.keeps_force(system), self._begins_with_force(system)
        memory = solver_state
        if made_jump is not False:
            memory = jax.lax.cond(made_jump, lambda: self._fresh(system, here, motion), lambda: solver_state)
        before = memory.force
        progress = Progress(motion, before if begins else None, jnp.asarray(True))
        (end, last, ok), _ = self.method.advance(system, (here, there), lambda clock: (*clock, None), h, progress)
        # A controller passes over NaN, but not over an infinity.
        y1 = jax.tree.map(lambda x: jnp.where(jnp.isinf(x), jnp.nan, x), system.state(end))

        # What follows is computed where something asks for it, and else removed by the compiler.
        after = last if keeps else system.force(there, end)
        start = before if begins else system.force(here, motion)
        dense = {"y0": y0, "y1": y1, "h": h}
        for i, (momentum, torque) in enumerate(((motion.momentum, start), (end.momentum, after))):
            dense[f"velocity{i}"] = packed(system.vector_in_user_axes(system.velocity(momentum)))
            dense[f"torque{i}"] = packed(system.vector_in_user_axes(torque))
        for leaf in jax.tree.leaves(y1):
            ok = ok & jnp.all(jnp.isfinite(leaf))
        stop = jax.lax.stop_gradient
        given = stop(motion), stop(end), (stop(before), stop(after)), stop(memory.history)
        target, history, known = companion(system._replace(inertia=stop(system.inertia)), stop(h), *given)
        seen = system.in_user_axes(target)
        error = jax.tree.map(jnp.subtract, y1, like(y1, packed(seen.momentum), packed(seen.pose)))
        error = jax.tree.map(
            lambda e: jnp.where(ok & known, e, jnp.full_like(e, jnp.inf)), jax.lax.stop_gradient(error)
        )
        good, bad = cast(Any, (diffrax.RESULTS.successful, diffrax.RESULTS.nonlinear_divergence))
        result = diffrax.RESULTS.where(ok, good, bad)
        # A torque that only the estimate reads is no path for a derivative.
        kept = after if begins else jax.lax.stop_gradient(after)
        return y1, error, dense, Memory(kept, history), result

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """The derivative of the state's arrays, a state of the same class."""
        self._system(terms, t0, y0, args)
        return terms.vf(t0, y0, args).ambient

    def _fresh(self, system: System, t: Array, motion: AnyMotion) -> Memory:
        force = system.force(t, motion)
        kept = force if self._begins_with_force(system) else jax.lax.stop_gradient(force)
        return Memory(kept, jax.lax.stop_gradient(History.none(motion.momentum, t)))

    def _begins_with_force(self, system: System) -> bool:
        """Whether a step needs the torque at its start first of all, so that the one before may hand it over."""
        if self.method.keeps_force(system):
            return True
        if not isinstance(self.method, Splitting) or system.torque is None or system.reads_momentum:
            return False
        return self.method.scheme.stages[0][0] == KICK

    def _system(self, terms: Any, t: Any, y: Any, args: Any) -> tuple[System, Callable[[Any], Array]]:
        """The system, and the clock that turns diffrax's time, which always grows, into the term's."""
        term = _only(terms)
        torque = term.torque_at(args)
        check(term.body, torque, y, self.method)

        def clock(t: Any) -> Array:
            return as_time(terms.contr(jnp.zeros_like(t), jnp.asarray(t)), y)

        return System.of(term.body, torque, y, clock(t)), clock


def _only(terms: Any) -> RigidBodyTerm:
    """The term, out of the wrapper in which diffrax hands it over when time runs backwards."""
    kinds = (RigidBodyTerm, diffrax.MultiTerm, diffrax.ODETerm, diffrax.ControlTerm)
    found = [x for x in jax.tree.leaves(terms, is_leaf=lambda x: isinstance(x, kinds)) if isinstance(x, kinds)]
    term = found[0] if len(found) == 1 else None
    if not isinstance(term, RigidBodyTerm):
        raise ValueError(
            "LieSolver needs one midlie_jax.RigidBodyTerm(body, torque) as its terms, got "
            f"{' and '.join(type(x).__name__ for x in found) or described(terms)}; add torques with "
            "midlie_jax.torques.Sum. diffrax's own solvers take the same term."
        )
    return term
