"""`integrate`: the driver with a constant step, a `lax.scan` over steps that saves the state at regular intervals."""

from typing import Any, Unpack, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import as_count
from .._math import components as cp
from .._xla import budgets
from .._xla.compiler import tuned_jit
from .._xla.internals import bodies_at_once
from .._xla.mesh import all_promoted, axes_of_run
from .._xla.platform import on_cpu
from ..integrators.base import Method, Progress
from ..integrators.verdict import UNSTABLE, at_start, earlier
from ..model.baths.base import HeatBath
from ..model.bodies import Body
from ..model.state import AnyState, StateT
from ..model.torques import TorqueLike, on_body
from ..model.torques.reads_body import with_bath
from .arguments import as_argument, as_first_step, as_method, as_saving, check_step, check_system, check_times, counts
from .bad_start import finite_start, nan_unless
from .clock import time_of
from .derivatives import Adjoint, Checkpointed, as_adjoint
from .gain import with_gain_judged
from .observe import Observe, as_observe_of_one, observe_state
from .observe.series import Series
from .path import Path, end_alone, first_bad
from .results import result_of
from .shared_inputs import Rows, SharedInputs
from .stepper import Carry, ConstantStep, carried_on, check_carried
from .steps import Leg, OneStep, in_leg


@overload  # the return type follows `start` and `observe`
def integrate(
    method: Method | str, body: Body, torque: TorqueLike | None, start: StateT, **options: Unpack[ConstantStep]
) -> Path[StateT]: ...
@overload
def integrate(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState | Carry,
    *,
    observe: Any = ...,
    **options: Unpack[ConstantStep],
) -> Path[Any]: ...
def integrate(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: StateT | Carry,
    *,
    dt: float | Array,
    steps: int,
    save_every: int | None = 1,
    t0: float | Array = 0.0,
    first_step: int | Array = 0,
    adjoint: Adjoint | None = None,
    observe: Any = None,
    bath: HeatBath | None = None,
) -> Path[StateT]:
    """Integrates one body with a constant step; supports `jax.vmap` over bodies, torques, states and steps.

    Compiled on the first call for each method, torque function, shape and number of saved states. On a CPU, outside of
    `jax.jit` and derivatives, one program serves every number of steps between saved states from 32 on, and every
    number of steps with `save_every=None`. Differentiable in forward and reverse mode with respect to every array;
    `adjoint` chooses how. All arithmetic is in the dtype of `start`.

    Args:
        method: from `midlie_jax.method`, or its name.
        body: a `RigidBody`, a `TensorBody` in a custom frame, or `Particles`.
        torque: any callable `torque(t, state) -> (3,)` in the body frame (for particles a force of the momentum's
            shape), or None. Pass the same function object to reuse the compiled program.
        start: the initial state; its class decides what is integrated besides the momentum. Or the `carry` of a path,
            from which the run continues with the same bits and noise; method, body, torque, dt and t0 must then be the
            same as for that path.
        dt, steps: the step, (), which may be negative, and the number of steps.
        save_every: save the state every `save_every` steps, beginning with the initial state; must divide `steps`.
            None: only the final state, without a leading axis.
        t0: time of step 0, (). dt must be at least 4 units in the last place of t0; otherwise times would not change.
            In float32 count the time from the beginning of the run, or use float64.
        first_step: the index of the first step. The time after n steps is t0 + (first_step + n) dt. A run continued
            from a saved state needs the index of this state: it then has the random numbers of the uninterrupted run
            and agrees with it up to rounding; from a `Carry`, bit for bit.
        adjoint: how a derivative of the run is computed: `Checkpointed()`, the default, or another of
            `midlie_jax.adjoints`.
        observe: what the path holds instead of the states: a function of (t, state), an observable of
            `midlie_jax.observe`, or a dict of these; or a statistic of time, such as
            `midlie_jax.observe.Autocorrelation(f, 100)`, which has no axis of times.
        bath: a heat bath, such as `midlie_jax.baths.Langevin(kT, friction, key)`, for methods with a bath stage.

    Returns:
        The path. A failed solve, NaN or infinity sets `path.ok` to False and never raises an exception.
        `path.first_bad` says where the first failure occurred.

    Raises:
        ValueError: an argument is invalid; the message names the argument and the remedy. Raised before anything is
            traced.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> path.states.attitude.shape, bool(path.ok), bool(jnp.ptp(ml.observe.energy(body, torque, path)) < 1e-3)
        ((101, 4), True, True)
    """
    steps, observe = as_count("steps", steps), as_observe_of_one(observe)
    save_every = as_saving(save_every, steps)
    if isinstance(observe, Series):
        observe.check(save_every and 1 + steps // save_every)
    torque = with_bath(torque, bath)
    state, first, carried = carried_on(start, first_step)
    first = as_first_step(first, steps)
    method = check_system(as_method(method), body, torque, state)
    dtype = state.momentum.dtype
    h, begin = as_argument("dt", dt, dtype), as_argument("t0", t0, dtype)
    check_step(method, h)
    check_times(method, torque, begin, h, first, steps)
    adjoint, every = as_adjoint(adjoint), save_every or steps
    run = (body, torque, state, h, begin), first, steps // every, count_as_argument(every, steps, adjoint)
    guarded = carried is None and not bodies_at_once()
    return _run(method, adjoint, *run, at_end=save_every is None, observe=observe, guarded=guarded, carried=carried)


def run_of_body(
    method: Method,
    adjoint: Adjoint,
    arguments: tuple[Any, Any, AnyState, Array, Array],
    first: Array,
    intervals: int,
    save_every: int | Array,
    shared: SharedInputs | None = None,
    rows: Rows | None = None,
    observe: Observe | None = None,
    leg: Leg | None = None,
    guarded: bool = False,
    carried: Progress | None = None,
) -> Path[Any]:
    """`integrate` without the checks; the arguments are body, torque, start, dt and t0.

    With an array `save_every` or a `leg` (the part of the steps that is taken, see `Leg`), `adjoint` is ignored.
    After a leg only its own saved states, failures and final carry are valid. `guarded`: an initial state that is not
    finite must not reach the steps, which may be differentiated. `carried` is the progress from a `Carry`; of `start`
    then only class, shape and dtype are read.
    """
    body, torque, start, dt, t0 = arguments
    axes = axes_of_run((arguments, first), (on_body(torque, body), t0, start))
    uniform = t0, dt
    body, torque, start, dt, t0 = all_promoted(arguments, axes)
    system = method.system(body, torque, start, t0, dt)
    if isinstance(save_every, int):
        adjoint.check(method, system, save_every)
    counted, first = leg is not None or counts(first, intervals * save_every), first.astype(jnp.int32)

    if shared is not None:
        system = shared.placed(system)
    begun = start  # of the whole run, if this is a leg
    if carried is not None:
        check_carried(carried, system, method)
        start = all_promoted(system.state(carried.motion), axes)
    if leg is not None and leg.given is not None:
        begun = all_promoted(system.state(leg.given.motion), axes)
    given, good = start, cp.all_finite(start) if guarded else jnp.asarray(True)
    if guarded:
        start = finite_start(start, good, on_body(torque, body), t0, (body, dt))
    one = OneStep(method, system, t0, dt, shared, axes)
    progress = method.begin(system, start, time_of(t0, dt, first)) if carried is None else carried
    progress = progress if leg is None else leg.carried
    verdict = earlier(progress.verdict, at_start(body, good, counted))
    progress = all_promoted(progress._replace(verdict=verdict), axes)

    def move(progress: Progress, n: Array, rows_of_interval: Any) -> Progress:
        if not isinstance(save_every, int):
            return one.counted(progress, first, save_every, rows, n - first)
        if leg is not None:
            return in_leg(leg, one, first, n - first, save_every, rows, progress)
        indices = n + jnp.arange(save_every, dtype=jnp.int32)
        return adjoint.run(one, (indices, rows_of_interval), intervals * save_every, progress)

    def save_interval(progress: Progress, interval: tuple[Array, Any]) -> tuple[Progress, tuple[Any, Array]]:
        n, rows_of_interval = interval
        progress = move(progress, n, rows_of_interval)
        state = system.state(progress.motion)
        if observe is None:
            return progress, (state, progress.ok)
        seen = observe_state(observe, time_of(*uniform, n + save_every), state, body, torque)
        return progress, (seen, progress.ok & cp.all_finite(state))

    interval_starts = first + save_every * jnp.arange(intervals, dtype=jnp.int32)
    rows_of_intervals = None
    if isinstance(save_every, int) and leg is None:
        rows_of_intervals = jax.tree.map(lambda x: x.reshape(intervals, save_every, *x.shape[1:]), rows)
    progress, (seen, solved) = jax.lax.scan(save_interval, progress, (interval_starts, rows_of_intervals))
    # Outside the loop over steps, which does not need this result.
    steps = intervals * save_every
    begun, judged = (start, steps) if leg is None else (begun, leg.judged)
    progress = with_gain_judged(system, begun, t0, dt, judged, progress)
    trusted = solved & cp.all_finite(seen, axes=1) if observe is None else solved
    if leg is not None:  # a failure in the leg does not affect states saved before it
        trusted = trusted | (interval_starts - first + save_every <= leg.begin)
    trusted = trusted & (progress.verdict != UNSTABLE)
    before = given
    if observe is not None:
        before = observe_state(observe, time_of(*uniform, first), start, body, torque)
        before = nan_unless(good, before) if guarded else before
    seen = nan_unless(good, seen) if guarded else seen
    seen = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), before, seen)
    times = time_of(*uniform, jnp.concatenate([first[None], interval_starts + save_every]))
    finite = cp.all_finite(progress.motion)
    result = result_of(progress.verdict, finite)
    bad = first_bad(given, trusted)
    bad = bad if carried is None else jnp.where(carried.ok, bad, 0)
    carry = Carry(first + (steps if leg is None else leg.end), progress, system.kind)
    return Path(times, seen, progress.ok & finite, bad, result, carry)


def path_of_body(*run: Any, at_end: bool = False, observe: Observe | None = None, **options: Any) -> Path[Any]:
    """Like `run_of_body`; a statistic of time replaces the values."""
    path = run_of_body(*run, observe=observe, **options)
    if isinstance(observe, Series):
        *_, (_, _, _, dt, _), _, _, save_every = run
        good = jnp.arange(len(path.times), dtype=jnp.int32) < path.first_bad
        values = jax.tree.map(lambda x: x[None], path.states)
        path = path._replace(states=observe.of_bodies(values, good[None], dt * jnp.asarray(save_every, dt.dtype)))
    return end_alone(path) if at_end else path


def _side_by_side(method: Method, adjoint: Adjoint, arguments: Any, *others: Any, **more: Any) -> int:
    """The number of bodies that a step moves side by side; few bodies are moved number by number, like one."""
    start = arguments[2]
    return start.count if start.several and start.count > budgets.UNROLLED_BODIES else 1


_run = tuned_jit(path_of_body, _side_by_side)


def count_as_argument(every: int, steps: int, adjoint: Adjoint) -> Any:
    """The steps between two saved states: an array, so that one program serves every number, or an int.

    A reverse derivative needs an int, and so does an accelerator, to launch kernels without a check after each. The
    number is therefore an argument only on a CPU, outside of every other program (`jax.jit`, `jax.grad` and the like).
    """
    default = isinstance(adjoint, Checkpointed) and adjoint.every is None
    free = default and (every == steps or every >= budgets.COUNTED_STEPS)
    return np.asarray(every, np.int32) if free and on_cpu() and bodies_at_once() else every
