"""`LieSolver`, a method of the package as a solver of diffrax."""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, NamedTuple, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._checks.arguments import described
from .._math import components as cp
from .._xla.fusion import fuse, is_stored, split
from ..drivers.arguments import as_method
from ..integrators.base import Method, Progress
from ..integrators.registry import DEFAULT
from ..integrators.splitting import Splitting
from ..integrators.system import AnyMotion, System
from ..integrators.verdict import FINE, is_fine
from ..model.torques import velocity_dependent
from .dense import LieInterpolation, ShorterStep, Start
from .estimate import REFERENCE_ORDER, History, companion
from .term import RigidBodyTerm, as_time, check, unchecked


class Memory(NamedTuple):
    """Data of a step for the next step: two arrays, because diffrax compiles a dozen operations for each array."""

    force: Array  # the torque at the end of the step; for particles the force
    history: Array  # the entries of a `History`

    @classmethod
    def of(cls, force: Any, history: History) -> "Memory":
        return cls(cp.flat(force), jnp.append(cp.flat(history.slope), history.span))

    def unpacked(self, like: Any) -> tuple[Any, History]:
        """The torque as components, in the form of the momentum `like`, and the history."""
        return cp.of_flat(self.force, like), History(cp.of_flat(self.history[:-1], like), self.history[-1])


class LieSolver(diffrax.AbstractAdaptiveSolver[Any]):
    """A method of this package as a solver for diffrax. It needs a `RigidBodyTerm` and a midlie_jax state.

    Order and torque evaluations are the same as for the method. An adaptive controller and the dense output `"cubic"`
    (`SaveAt(ts=...)`, an event) also need the torques at both ends of a step. Methods that begin with a kick (under a
    torque that does not read the momentum), AKW, NMB, symplectic Euler and Verlet already evaluate these torques. For
    the other methods, an adaptive controller needs one more evaluation per step, and dense output two.

    Dense output, the states between the ends of a step, by `dense`:

    - `"cubic"`: `LieInterpolation`, of third order for every method. Fast: one evaluation is a few polynomials.
    - `"step"`: a shorter step of the method from the start of the step, of the order of the method, for accurate events
      with methods of order 4 and more. Each state, and each iteration of the root finder of an event, takes a step, and
      the program holds a second copy of it. `SaveAt(dense=True)` stores the arrays of body and torque for every step,
      so they must be numbers, not random keys. The rate of change has small jumps at the ends of steps.

    Error estimate: the step minus its companion (module `estimate`). For a method of order p = 1 or 2 it is
    asymptotically the true local error, of order h^(p + 1). For p >= 4 it is the larger error of the companion, of
    order h^4 in the momentum and h^5 in the attitude. Derivatives do not pass through the estimate. Prefer constant
    steps for long runs: a varying step destroys the long-time energy behaviour of these methods.

    A step has an infinite error if its solve failed, if it is not finite, or if it rotates by more than 2.4 radians. An
    adaptive controller then tries a shorter one. Without an adaptive controller, a failed solve or a step that is not
    finite sets the result of the solution to `diffrax.RESULTS.nonlinear_divergence`. A body with impossible moments or
    an impossible mass does the same with any controller. A reverse-mode derivative is NaN if any attempted step, even a
    rejected one, is not finite.

    Adjoints: RecursiveCheckpointAdjoint, DirectAdjoint and ForwardMode differentiate the steps taken, and
    `BacksolveAdjoint(solver=diffrax.Tsit5())` the exact motion.

    Attributes:
        method: a method from `midlie_jax.method`, or its name; by default JACOBI[EA], for rigid bodies.
        dense: the interpolation between the ends of a step, "cubic" or "step".

    Raises:
        ValueError: the method or `dense` is unknown; or, from `diffeqsolve`, the term, state, batch or dtype does not
            fit.

    Examples:
        >>> import diffrax
        >>> term, solver = ml.diffrax.RigidBodyTerm(body, torque), ml.diffrax.LieSolver("JACOBI[EA]")
        >>> steps = diffrax.StepTo(ts=0.01 * jnp.arange(101.0))  # with dt0=None: steps of one size
        >>> run = {"stepsize_controller": steps, "saveat": diffrax.SaveAt(steps=True), "max_steps": 100}
        >>> solution = diffrax.diffeqsolve(term, solver, 0.0, 1.0, None, start, **run)
        >>> solution.ys.attitude.shape
        (100, 4)
    """

    method: Method
    dense: str = eqx.field(static=True)
    term_structure: ClassVar = diffrax.AbstractTerm

    def __init__(self, method: Any = DEFAULT, *, dense: str = "cubic"):
        if dense not in ("cubic", "step"):
            raise ValueError(f'dense must be "cubic" or "step", got {described(dense)}.')
        self.method, self.dense = as_method(method), dense

    @property
    def interpolation_cls(self) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        return ShorterStep if self.dense == "step" else LieInterpolation

    def order(self, terms: Any) -> int:
        """The order of the method; at most 2 for a FLIGHT[SCHEME] under a torque declared `VelocityDependent`."""
        limited = isinstance(self.method, Splitting) and velocity_dependent(_single_term(terms).torque)
        return min(self.method.order, 2) if limited else self.method.order

    def error_order(self, terms: Any) -> int:
        """The exponent of h in the error estimate."""
        return min(self.order(terms), REFERENCE_ORDER) + 1

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Memory:
        """The memory before the first step: the torque at t0, and no history."""
        system, clock, method = self._system(terms, t0, y0, args)
        return _new_memory(system, clock(t0), system.motion(y0), _begins_with_force(method, system))

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Memory, made_jump: Any
    ) -> tuple[Any, Any, dict[str, Any], Memory, diffrax.RESULTS]:
        system, clock, method = self._system(terms, t0, y0, args)
        start_time, end_time, h = clock(t0), clock(t1), as_time(terms.contr(t0, t1), y0)
        y0, memory = _varying_together((y0, solver_state))
        y1, error, dense, force, memory, ok = _step(method, system, start_time, end_time, h, y0, memory, made_jump)
        term = _single_term(terms)
        if self.dense == "step":
            stored = force if _begins_with_force(method, system) else None
            times = jnp.stack([start_time, end_time, h])
            dense = {"start": Start.of(method, term.body, term.torque_at(args), y0, stored, times)}
        ok = ok & term.body.is_possible()
        success, failure = cast(Any, (diffrax.RESULTS.successful, diffrax.RESULTS.nonlinear_divergence))
        return y1, error, dense, memory, diffrax.RESULTS.where(ok, success, failure)

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """The derivative of the arrays of the state, as a state of the same class."""
        self._system(terms, t0, y0, args)
        return terms.vf(t0, y0, args).ambient

    def _system(self, terms: Any, t: Any, y: Any, args: Any) -> tuple[System, Callable[[Any], Array], Method]:
        """The system, the map from the increasing time of diffrax to the term's, and the fitted method."""
        term = _single_term(terms)
        torque = term.torque_at(args)
        check(term.body, torque, y, self.method)

        def clock(t: Any) -> Array:
            return as_time(terms.contr(jnp.zeros_like(t), jnp.asarray(t)), y)

        return System.of(term.body, torque, y, clock(t), whole=True), clock, self.method.fitted(term.body)


def _begins_with_force(method: Method, system: System) -> bool:
    """Whether a step begins by using the torque at its start, which the previous step has stored."""
    if method.keeps_force(system):
        return True
    return isinstance(method, Splitting) and system.keeps_torque and method.scheme.begins_with_force


@eqx.filter_jit
@eqx.filter_checkpoint(policy=is_stored)
def _step(
    method: Method,
    system: System,
    start_time: Array,
    end_time: Array,
    h: Array,
    y0: Any,
    memory: Memory,
    made_jump: Any,
) -> Any:
    """The step of `LieSolver.step`, in the time of the term.

    Jitted, because diffrax differentiates its loop several times, and JAX then finds the derivative already traced.
    Reverse mode recomputes the step, because each array passed to it would be compiled entry by entry.
    """
    system, motion = system.in_step(start_time, end_time, h), system.motion(y0)
    keeps_force, begins_with_force = method.keeps_force(system), _begins_with_force(method, system)
    if made_jump is not False:
        fresh = partial(_new_memory, system, start_time, motion, begins_with_force)
        memory = jax.lax.cond(made_jump, fresh, lambda kept=memory: kept)
    force = memory.force
    stored_force, stored_history = memory.unpacked(motion.momentum)
    progress = Progress(motion, stored_force if begins_with_force else None, jnp.asarray(FINE))
    (end, method_force, judged), _ = method.advance(
        system, (start_time, end_time), lambda clock: (*clock, None), h, progress
    )
    # Controllers of diffrax support NaN in y1, but not infinity.
    y1 = jax.tree.map(lambda x: jnp.where(jnp.isinf(x), jnp.nan, x), system.state(end))

    # The compiler removes everything after the split if nothing uses the results. That part gets separate loops, so a
    # torque for the next step must not pass through the split.
    next_force = method_force if keeps_force else system.force(end_time, end) if begins_with_force else None
    motion, end, stored_force, end_torque = split((motion, end, stored_force, next_force))
    end_torque = end_torque if begins_with_force else system.force(end_time, end)
    start_torque = stored_force if begins_with_force else system.force(start_time, motion)
    dense = {"y0": y0, "y1": y1, "h": h}
    for i, (momentum, torque) in enumerate(((motion.momentum, start_torque), (end.momentum, end_torque))):
        dense[f"velocity{i}"] = cp.packed(system.vector_in_user_axes(system.velocity(momentum)))
        dense[f"torque{i}"] = cp.packed(system.vector_in_user_axes(torque))
    ok = is_fine(judged) & cp.all_finite(y1)
    stop = jax.lax.stop_gradient
    step_data = stop(motion), stop(end), (stop(stored_force), stop(end_torque)), stop(stored_history)
    target, history, valid = companion(system._replace(inertia=stop(system.inertia)), stop(h), *step_data)
    target, history, valid = fuse((target, history, valid))
    user_target = system.in_user_axes(target)
    error = jax.tree.map(jnp.subtract, y1, unchecked(y1.kind, user_target.momentum, user_target.pose))
    error = jax.tree.map(lambda e: jnp.where(ok & valid, e, jnp.full_like(e, jnp.inf)), jax.lax.stop_gradient(error))
    # Derivatives do not pass through a torque that only the error estimate reads.
    next_force = next_force if begins_with_force else jax.lax.stop_gradient(end_torque)
    return y1, error, dense, force, Memory.of(next_force, history), ok


@jax.custom_jvp
def _varying_together(tree: Any) -> Any:
    """The tree unchanged; all of its arrays have tangents if one has, so that diffrax traces one derivative alone."""
    return tree


@_varying_together.defjvp
def _varying_together_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    # Without the barrier JAX drops symbolic zero tangents. Each tangent has its own barrier: a barrier for several,
    # some of which do not depend on the input, has no transpose in jax 0.12.
    return primals[0], jax.tree.map(jax.lax.optimization_barrier, tangents[0])


def _new_memory(system: System, t: Array, motion: AnyMotion, begins_with_force: bool) -> Memory:
    force = system.force(t, motion)
    next_force = force if begins_with_force else jax.lax.stop_gradient(force)
    none = History(jax.tree.map(lambda p: p * 0, motion.momentum), t * 0)
    return Memory.of(next_force, jax.lax.stop_gradient(none))


def _single_term(terms: Any) -> RigidBodyTerm:
    """The `RigidBodyTerm` in `terms`, without the wrapper of diffrax for backward time."""
    kinds = (RigidBodyTerm, diffrax.MultiTerm, diffrax.ODETerm, diffrax.ControlTerm)
    terms_found = [x for x in jax.tree.leaves(terms, is_leaf=lambda x: isinstance(x, kinds)) if isinstance(x, kinds)]
    term = terms_found[0] if len(terms_found) == 1 else None
    if not isinstance(term, RigidBodyTerm):
        raise ValueError(
            "LieSolver needs one midlie_jax.diffrax.RigidBodyTerm(body, torque) as its terms, got "
            f"{' and '.join(type(x).__name__ for x in terms_found) or described(terms)}; add torques "
            "with midlie_jax.torques.Sum."
        )
    return term
