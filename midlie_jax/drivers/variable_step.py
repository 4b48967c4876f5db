"""`integrate_variable_step`: a driver with variable steps, whose step control is reversible in time.

A step chosen from an error estimate depends only on the past, which destroys the good long-time behaviour of a
symmetric method. Here the inverse of the step is a separate variable that is integrated along with the motion (Hairer &
Soderlind, "Explicit, time reversible, adaptive step size control", SIAM J. Sci. Comput. 26 (2005) 1838). The density
Q(t, y) prescribes the steps: they should be about dt / Q. With G = d(log Q)/dt along the motion, a step is

    half = rho + dt/2 G(y),   y' = step of dt/half from y,   rho' = half + dt/2 G(y').

This is Verlet's method for rho' = G with h = dt / rho, so rho stays near Q. It is explicit, and a run with -dt takes
the same steps backwards. `python benchmarks/rounding.py variable` measures when it pays.

The loop carries the length of the next step in addition to rho, so that a step itself compiles to one loop (see
`_xla.fusion`). A body that has reached t1 or has failed takes steps of length zero, which leave it unchanged, bit for
bit, while the rest of the batch continues.
"""

from typing import Any, NamedTuple, Required, Unpack, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import LEAST_ULPS, as_count, require_finite, require_function, same_dtype
from .._math import components as cp
from .._xla import budgets
from .._xla.compiler import tuned_jit
from .._xla.fusion import fuse
from .._xla.mesh import all_promoted, axes_of_run
from ..integrators.base import Method, Progress
from ..integrators.system import Motion, System
from ..integrators.verdict import FINE, UNFOLLOWED, UNSTABLE, at_start, earlier
from ..model.bodies import Body
from ..model.densities import DensityLike
from ..model.state import AnyState, StateT
from ..model.torques import TorqueLike, on_body
from .arguments import as_method, as_saving, as_scalar, check_clock, check_span, check_step, check_system
from .bad_start import finite_start, nan_unless
from .derivatives import Adjoint, Checkpointed, Forward, Reversible, as_adjoint
from .gain import with_gain_judged
from .observe import Observe, as_observe_of_one, observe_state
from .observe.series import Series
from .path import Path, end_alone, first_bad
from .results import result_of
from .stepper import Carry, Options, check_carried

_SLACK = 1e-3  # the share by which the last step may exceed dt / half: rounding could leave one more, tiny step
_LARGEST_FACTOR = 2.0  # between rho and the density: beyond it the steps no longer follow the density


class _Clock(NamedTuple):
    t: Array
    residue: Array  # rounding error of t, to be added to t; without it, float32 would lose the time
    rho: Array
    half: Array  # rho in the middle of the next step
    h: Array  # the next step
    last: Array  # whether the next step ends at t1
    taken: Array  # steps taken


class _Options(Options, total=False):
    density: Required[DensityLike]
    t1: float | Array | None
    rho: float | Array | None


@overload  # the return type follows `start` and `observe`
def integrate_variable_step(
    method: Method | str, body: Body, torque: TorqueLike | None, start: StateT, **options: Unpack[_Options]
) -> Path[StateT]: ...
@overload
def integrate_variable_step(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState | Carry,
    *,
    observe: Any = ...,
    **options: Unpack[_Options],
) -> Path[Any]: ...
def integrate_variable_step(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: StateT | Carry,
    *,
    density: DensityLike,
    dt: float | Array,
    steps: int,
    save_every: int | None = 1,
    t0: float | Array = 0.0,
    t1: float | Array | None = None,
    rho: float | Array | None = None,
    adjoint: Adjoint | None = None,
    observe: Any = None,
) -> Path[StateT]:
    """Integrates one body reversibly with steps of about dt / density; supports `jax.vmap` over any argument.

    Without `t1` the run takes `steps` steps, and the bodies of a batch end at different times. With `t1` it takes at
    most `steps`. A batch then runs until its slowest body has reached `t1`, which is checked at least every 32 steps,
    so put bodies with similar numbers of steps in one batch. Each body has its own times. Functions of time alone, such
    as a common orbit, are therefore computed per body.

    A run continues bit for bit from `path.carry`, also to another `t1`. From the last state and the last `rho` of the
    path, with -dt, it returns to the initial state up to rounding; but not after a last step that was cut short at t1.

    Compiled for each method, torque, density function, shape and number of steps. Differentiable with respect to every
    array, in forward and reverse mode; with `t1`, reverse mode needs `adjoint=Checkpointed()`.

    Args:
        method: a symmetric method from `midlie_jax.method`, or its name. The run has the order of the method.
        body, torque, t0, observe: as for `midlie_jax.integrate`.
        start: the initial state. Or the `carry` of a path with variable steps, without `t0` and `rho`; method, body,
            torque, density and dt must then be the same as for that path.
        density: `density(t, state) -> ()`, positive and smooth, or one of `midlie_jax.densities`. Pass the same
            function object to reuse the compiled program.
        dt: step length where the density is 1, (), may be negative.
        steps: number of steps; with `t1` the maximum.
        save_every: save the state every `save_every` steps; must divide `steps`. After `t1` the last time and state are
            repeated. None: only the final state.
        t1: the exact end time, (); dt must point from t0 to t1.
        rho: the initial rho, (); by default the density at the initial state. From a saved state pass its entry of
            `path.rho`.
        adjoint: `Checkpointed()`, the default without `t1`, which always runs all of `steps`, because reverse mode
            needs a fixed number; or `Forward()`, the default with `t1`.

    Returns:
        The path. If the run fails, `path.ok` is False, no exception is raised, and the body does not move any more.

    Raises:
        ValueError: as for `midlie_jax.integrate`, or the method is not symmetric.

    Examples:
        >>> density = ml.densities.Spin([5.0, 5.0, 1.0], reference=50.0, floor=1.0)
        >>> path = ml.integrate_variable_step("JACOBI[EA]", body, torque, start, density=density, dt=0.01, steps=100)
        >>> path.times.shape, path.rho.shape, int(path.taken), bool(path.ok)  # steps of about 0.01 / rho
        ((101,), (101,), 100, True)
    """
    steps = as_count("steps", steps)
    save_every = as_saving(save_every, steps)
    adjoint = (Checkpointed() if t1 is None else Forward()) if adjoint is None else as_adjoint(adjoint)
    if isinstance(adjoint, Reversible):
        raise ValueError("adjoint must be Checkpointed() or Forward(): variable steps are not taken back one by one.")
    observe = as_observe_of_one(observe)
    if isinstance(observe, Series):
        raise ValueError(
            f"{type(observe).__name__} needs values at equal intervals, and these steps differ; give it to "
            "midlie_jax.integrate or midlie_jax.ensemble."
        )
    carried = start if isinstance(start, Carry) else None
    if carried is not None and carried.clock is None:
        raise ValueError("start must be the carry of a run with variable steps, got the carry of steps of one length.")
    if carried is not None and (rho is not None or isinstance(t0, Array | np.ndarray) or t0 != 0):
        raise ValueError("t0 and rho must be left out where start is a Carry, which has the time and rho.")
    state: Any = start if carried is None else carried.like
    refused = "integrate_variable_step chooses its steps by the state, and in a heat bath that would bias averages"
    method = check_system(as_method(method), body, torque, state, bath=refused)
    if state.kind.constant_steps:
        raise ValueError(
            f"{state.kind.constant_steps} run with a constant step; use midlie_jax.integrate, ensemble or simulate."
        )
    if not method.symmetric:
        raise ValueError(
            f"method {method.name!r} is not symmetric, but a reversible step control needs a symmetric method; "
            "take for example LIEMID[EA] or JACOBI[SRKN6b]."
        )
    require_function("density", density, "t, state")
    same_dtype("start.momentum", state.momentum, density=density)
    for leaf in jax.tree.leaves(eqx.filter(density, eqx.is_inexact_array)):
        require_finite("density", leaf)
    dtype = state.momentum.dtype
    dt, begin = as_scalar("dt", dt, dtype), as_scalar("t0", t0, dtype) if carried is None else carried.clock.t
    check_step(method, dt)
    if rho is not None:
        rho = as_scalar("rho", rho, dtype)
        if not cp.is_traced(rho) and rho <= 0:
            raise ValueError(f"rho must be positive, got {rho}; pass an entry of `rho` of a path, or None.")
    if t1 is not None:
        t1 = as_scalar("t1", t1, dtype)
        if not any(cp.is_traced(x) for x in (begin, t1, dt)) and (t1 - begin) * dt < 0:
            raise ValueError(f"dt must point from t0 = {begin} to t1 = {t1}, got {dt}; change its sign.")
        if not cp.is_traced(begin, t1):
            check_span("torque", torque, begin, t1)
            check_span("density", density, begin, t1)
    known = carried is None and not cp.is_traced(density, dt, begin, rho, state)
    if known and abs(dt) < LEAST_ULPS * cp.epsilon(dt) * abs(begin):
        value: Any = density(begin, state) if rho is None else rho
        check_clock(begin, jnp.where(jnp.asarray(value) > 0, dt / value, dt))
    all_steps = t1 is None or isinstance(adjoint, Checkpointed)
    begun = None if carried is None else (carried.progress, carried.clock)
    arguments = body, torque, state, density, dt, begin, t1, rho
    return _run(method, arguments, steps, save_every, all_steps, observe, begun)


@tuned_jit
def _run(
    method: Method,
    arguments: Any,
    steps: int,
    save_every: int | None,
    all_steps: bool,
    observe: Observe | None,
    begun: tuple[Progress, Any] | None,
) -> Path[Any]:
    body, torque, start, density, dt, t0, t1, rho = arguments
    axes = axes_of_run(arguments, (on_body(torque, body), t0, start), (density, t0, start))
    body, torque, start, density, dt, t0, t1, rho = all_promoted(arguments, axes)
    system = System.of(body, torque, start, t0)
    if begun is not None:
        check_carried(begun[0], system, method)
        start = all_promoted(system.state(begun[0].motion), axes)
    given, good = start, cp.all_finite(start)
    start = finite_start(start, good, on_body(torque, body), t0, (body, density, dt, t1, rho))

    def advance(carry: tuple[Progress, _Clock], _: None) -> tuple[tuple[Progress, _Clock], None]:
        progress, clock = carry
        # In the compiled program the step is one loop, and the step control with its divisions is another.
        progress, (t_end, residue) = method.advance(system, (clock, t1), _ends_of_step, clock.h, progress, axes)
        value, slope = _density_and_slope(system, density, t_end, progress)
        ok, moved = progress.ok, clock.h != 0
        rho = jnp.where(moved, clock.half + dt / 2 * slope, clock.rho)
        ok = ok & _follows(rho, value)
        clock = clock._replace(t=t_end, residue=residue, rho=rho, taken=clock.taken + moved.astype(jnp.int32))
        clock = _with_next_step(clock, dt, t1, slope, ok)
        judged = earlier(progress.verdict, jnp.where(ok & (clock.half > 0), FINE, UNFOLLOWED))
        return fuse(all_promoted((progress._replace(verdict=judged), clock), axes)), None

    if begun is None:
        progress = method.begin(system, start, t0)
        value, slope = _density_and_slope(system, density, t0, progress)
        rho_0 = value if rho is None else rho
        zero = jnp.zeros_like(rho_0)  # from rho, so that all fields have the type of the motion on a mesh as well
        clock = _Clock(
            t0 + zero, zero, rho_0, rho_0, zero, jnp.zeros_like(rho_0, bool), jnp.zeros_like(rho_0, jnp.int32)
        )
        clock = _with_next_step(clock, dt, t1, slope, jnp.ones_like(rho_0, bool))
        follows = _follows(clock.rho, value) & (clock.half > 0)
        verdict = jnp.where(follows, FINE, UNFOLLOWED)
    else:
        progress, clock = begun
        clock, verdict = _with_length(clock, dt, t1, progress.ok), progress.verdict
    # Each reverse derivative of a derivative removes one checkpoint; see `_xla.keep.recomputed`.
    step = jax.checkpoint(jax.checkpoint(advance, prevent_cse=False), prevent_cse=False)

    def take_steps(carry: Any, count: int) -> Any:
        return jax.lax.scan(step, carry, length=count, unroll=method.unroll)[0]

    def save_interval(carry: Any, _: None) -> tuple[Any, Any]:
        if all_steps:
            carry = take_steps(carry, every)
        else:
            # Blocks of steps, until the next step of every body is zero.
            size = max(n for n in range(1, budgets.CHECKED_STEPS + 1) if every % n == 0)
            first = jnp.array(0, jnp.int32), carry
            carry = jax.lax.while_loop(
                lambda state: (state[0] < every // size) & (state[1][1].h != 0),
                lambda state: (state[0] + 1, take_steps(state[1], size)),
                first,
            )[1]
        progress, clock = carry
        state = system.state(progress.motion)
        seen = observe_state(observe, clock.t, state, body, torque)
        return carry, (seen, clock.t, clock.rho, progress.ok & cp.all_finite((state, clock.rho)))

    progress = progress._replace(verdict=earlier(at_start(body, good), verdict))
    begin = all_promoted((progress, clock), axes)
    every = save_every or steps
    (progress, clock), saved = jax.lax.scan(save_interval, begin, length=steps // every)
    before = given if observe is None else nan_unless(good, observe_state(observe, t0, start, body, torque))
    saved = (nan_unless(good, saved[0]), *saved[1:])
    first = (before, t0, begin[1].rho)
    states, times, rhos = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, saved[:3])
    progress = with_gain_judged(system, start, t0, dt, steps, progress)
    finite = cp.all_finite((progress.motion, clock.rho))
    reached = True if t1 is None else clock.t == t1
    ok, result = progress.ok & finite & reached, result_of(progress.verdict, finite, reached)
    bad = first_bad(given, saved[3] & (progress.verdict != UNSTABLE))
    bad = jnp.where(begin[0].ok, bad, jnp.zeros_like(bad))
    carry = Carry(clock.taken, progress, system.kind, clock)
    path = Path(times, states, ok, bad, result, carry, rhos, clock.taken - begin[1].taken)
    return path if save_every else end_alone(path)._replace(rho=rhos[-1])


def _ends_of_step(clock_and_t1: tuple[_Clock, Array | None]) -> tuple[Array, Array, tuple[Array, Array]]:
    """The times at both ends of the next step, and the end time with its rounding error (Kahan's summation)."""
    clock, t1 = clock_and_t1
    increment = clock.h + clock.residue
    t_end = clock.t + increment
    residue = increment - (t_end - clock.t)
    if t1 is not None:
        t_end = jnp.where(clock.last, t1, t_end)
        residue = jnp.where(clock.last, jnp.zeros_like(residue), residue)
    return clock.t, t_end, (t_end, residue)


def _follows(rho: Array, value: Array) -> Array:
    """Whether the density is positive and close to rho; after a jump of the density it is not."""
    return (value > 0) & (rho <= _LARGEST_FACTOR * value) & (value <= _LARGEST_FACTOR * rho)


def _with_next_step(clock: _Clock, dt: Array, t1: Array | None, slope: Array, ok: Array) -> _Clock:
    """The clock with its next step; zero if the run has failed, rho would become negative, or t1 is reached."""
    return _with_length(clock._replace(half=clock.rho + dt / 2 * slope), dt, t1, ok)


def _with_length(clock: _Clock, dt: Array, t1: Array | None, ok: Array) -> _Clock:
    half = clock.half
    ok = ok & (half > 0)
    h = jnp.where(ok, dt / jnp.where(ok, half, jnp.ones_like(half)), jnp.zeros_like(half))
    if t1 is None:
        return clock._replace(h=h, last=jnp.zeros_like(clock.last))
    remaining = (t1 - clock.t) - clock.residue
    last = ok & (remaining * jnp.sign(dt) <= jnp.abs(h) * (1 + _SLACK))
    # The step is zero if dt points away from t1.
    remaining = jnp.where(remaining * jnp.sign(dt) > 0, remaining, jnp.zeros_like(remaining))
    away = (t1 - clock.t) * jnp.sign(dt) < 0
    return clock._replace(h=jnp.where(last, remaining, h), last=last & ~away)


def _density_and_slope(system: System, density: Any, t: Array, progress: Progress) -> tuple[Array, Array]:
    motion = progress.motion
    force = system.force(t, motion) if progress.force is None else progress.force
    velocity = system.velocity(motion.momentum)
    rate = system.kind.momentum_rate(motion.momentum, velocity, force)
    tangents = (jnp.ones_like(t), rate, system.kind.rate(motion.pose, velocity))

    def evaluate(t: Array, momentum: Any, pose: Any) -> Array:
        value, like = system.evaluate(lambda t, s: jnp.asarray(density(t, s), t.dtype), t, Motion(momentum, pose))
        if like.shape:
            raise ValueError(
                f"density must return one number, got an array of shape {like.shape}; reduce it, e.g. jnp.sum."
            )
        return jnp.asarray(jax.tree.leaves(value)[0], t.dtype)

    value, change = jax.jvp(evaluate, (t, motion.momentum, motion.pose), tangents)
    return value, change / value
