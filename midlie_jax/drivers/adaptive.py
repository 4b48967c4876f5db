"""Many steps, each as long as the motion allows: a step control that keeps what symmetric methods are for.

A step chosen from an error estimate looks back only, and the long-time behaviour of the method is lost. Here the
inverse of the step is a variable of its own, integrated along with the motion (Hairer & Soderlind, "Explicit, time
reversible, adaptive step size control", SIAM J. Sci. Comput. 26 (2005) 1838). With a density Q(t, y), how close the
steps should lie, and G = d(log Q)/dt along the motion,

    half = rho + dt/2 G(y),   y' = step of dt/half from y,   rho' = half + dt/2 G(y'),

which is Verlet for rho' = G, h = dt / rho: rho stays near Q. It is explicit, and -dt undoes it exactly, the steps
being the same. A step costs one derivative of the density along the motion more than it does in `integrate`.

What that is worth (`python benchmarks/adaptive.py`): where the scale of time changes, much. On an orbit of eccentricity
.6, 801 steps of JACOBI[EA] in 5.3 orbits leave an attitude error of 8.3e-4 instead of 1.8e-2, and of JACOBI[SRKN6b]
5.4e-10 instead of 5.5e-8. Where it does not change, less than nothing: for the top of Bruls and Cardona the error
doubles (.48 of a gain, JACOBI[EA], by the size of the torque). The energy of a swinging Lagrange top does not drift in
2.6e5 steps (largest error 1.3e-3 in the first eighth and the last; with the density taken at the start of each step
3.7e-2 and 1.5e-1). That is for motions that are integrable or nearly so: of an asymmetric top's energy the mean wanders
between 3.1e-3 and -2.9e-3, and a constant step is better.

The loop carries the next step rather than rho, so that the divisions stand between two steps and the step itself stays
one loop (see `_kernel.fusion`). A step of zero length leaves a motion as it is, bit for bit: that is how a body which
has arrived, or failed, waits for the rest of the batch, without a select over its state.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from .._kernel import components as cp
from .._kernel.checks import as_count, described, require_finite, same_dtype
from .._kernel.fusion import fuse
from .._kernel.internals import all_promoted, axes_of_run
from ..methods.base import Method, Progress
from ..methods.system import Motion, System
from ..model.bodies import Body
from ..model.densities import DensityLike
from ..model.states import AnyState
from ..model.torques import TorqueLike, on_body
from .arguments import as_method, as_scalar, check_saving, check_step, check_system

# A last step may be longer than the density asks for by this share, lest rounding leave a step of no length.
_SLACK = 1e-3
# A factor between rho and the density beyond which the steps no longer follow the density.
_STRAYED = 2.0
# Steps between two looks at whether every body has arrived.
_BLOCK = 32


class AdaptivePath(NamedTuple):
    """A motion at the times that were kept.

    Attributes:
        times: (n,), the start first; n = 1 + steps / save_every.
        states: the states at those times, of the class of the start, with a leading axis (n,).
        densities: rho at those times, (n,): the next step is about dt / rho. Near the density, and what `rho` takes
            in a run that goes on, or back, from there.
        taken: steps taken, (); fewer than asked for where t1 or a failure came before.
        ok: (), False when a solve failed, a number stopped being finite, rho or the density stopped being positive,
            the two came to differ by more than a factor of 2 (the density jumped, or its steps are too large to follow
            it), or t1 was not reached.
    """

    times: Float[Array, "*batch n"]
    states: Any
    densities: Float[Array, "*batch n"]
    taken: Int[Array, "*batch"]
    ok: Bool[Array, "*batch"]


class _Clock(NamedTuple):
    """What the control carries from step to step, at time t."""

    t: Array
    lost: Array  # what rounding took from t: float32 would lose the time otherwise
    rho: Array
    half: Array  # rho in the middle of the next step
    h: Array  # the next step
    last: Array  # whether that ends at t1
    taken: Array


def integrate_adaptive(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState,
    *,
    density: DensityLike,
    dt: float | Array,
    steps: int,
    save_every: int = 1,
    t0: float | Array = 0.0,
    t1: float | Array | None = None,
    rho: float | Array | None = None,
    reverse: bool = False,
) -> AdaptivePath:
    """Integrates one body with steps dt / density, reversibly; map over anything with `jax.vmap`.

    Without `t1` a fixed number of steps: bodies of a batch end at different times, and no work is lost. With `t1` at
    most so many: a batch runs until its slowest body has arrived, looking every 32 steps at most, and the others
    wait at the price of a step; keep bodies of like step counts in one batch. Each body has a time of its own, so
    what depends on time alone, such as an orbit that all share, is computed for each.

    Reversible: the run back, from the last state with its `densities` as `rho` and -dt, takes the same steps and comes
    home to rounding, unless it ends at `t1`, whose last step is cut to end there and is not the control's.

    Compiled on the first call for each method, torque, density function, shape and step count. Differentiable in
    every array, forward and reverse; with `t1` in reverse only if asked for.

    Args:
        method: symmetric, from `midlie_jax.method`, or its name. Its order is kept.
        body, torque, start, t0: as for `midlie_jax.integrate`.
        density: `density(t, state) -> ()`, positive and smooth, or one of `midlie_jax.densities`. Pass the same
            function object again to reuse what was compiled.
        dt: the step where the density is 1, (), may be negative.
        steps: number of steps; with `t1` the most that are taken.
        save_every: keep every so many steps; must divide `steps`. Once at `t1` the kept times and states repeat.
        t1: where to end, exactly, on the side of t0 to which dt points.
        rho: the density to start with, by default that of the start; for a run that goes on or back, from a path's
            `densities`.
        reverse: with `t1`, run all of `steps` whatever happens, so that there is a reverse derivative.

    Returns:
        The path. Failures show in `path.ok`, never as an exception; a body that failed waits where it failed.

    Raises:
        ValueError: an argument does not fit, or the method is not symmetric; the message names it and the cure. Raised
            before anything is traced.
    """
    steps, save_every = as_count("steps", steps), as_count("save_every", save_every)
    check_saving(steps, save_every)
    method = check_system(as_method(method), body, torque, start)
    if not method.symmetric:
        raise ValueError(
            f"method {method.name!r} is not symmetric, and a reversible step control needs one that is, such as "
            "LIEMID[EA] or JACOBI[SRKN6b]."
        )
    if not callable(density):
        raise ValueError(f"density must be a callable of (t, state), got {described(density)}.")
    same_dtype("start.momentum", start.momentum, density=density)
    for leaf in jax.tree.leaves(eqx.filter(density, eqx.is_inexact_array)):
        require_finite("density", leaf)
    dtype = start.momentum.dtype
    dt, t0 = as_scalar("dt", dt, dtype), as_scalar("t0", t0, dtype)
    check_step(dt)
    if rho is not None:
        rho = as_scalar("rho", rho, dtype)
        if not cp.is_traced(rho) and rho <= 0:
            raise ValueError(f"rho must be positive, got {rho}; give a path's `densities`, or None.")
    if t1 is not None:
        t1 = as_scalar("t1", t1, dtype)
        if not any(cp.is_traced(x) for x in (t0, t1, dt)) and (t1 - t0) * dt < 0:
            raise ValueError(f"dt must point from t0 = {t0} to t1 = {t1}, got {dt}; change its sign.")
    return _run(method, body, torque, start, density, dt, t0, t1, rho, steps, save_every, reverse)


@eqx.filter_jit
def _run(
    method: Method,
    body: Any,
    torque: Any,
    start: AnyState,
    density: Any,
    dt: Array,
    t0: Array,
    t1: Array | None,
    rho: Array | None,
    steps: int,
    save_every: int,
    reverse: bool,
) -> AdaptivePath:
    arguments = (body, torque, start, density, dt, t0, t1, rho)
    axes = axes_of_run(arguments, (on_body(torque, body), t0, start), (density, t0, start))
    body, torque, start, density, dt, t0, t1, rho = all_promoted(arguments, axes)
    system = System.of(body, torque, start, t0)

    def advance(carry: tuple[Progress, _Clock], _: None) -> tuple[tuple[Progress, _Clock], None]:
        progress, clock = carry
        # The step is one loop, the control, with its divisions, another.
        progress, (there, lost) = method.advance(system, (clock, t1), _ends_of_step, clock.h, progress, axes)
        value, slope = _along(system, density, there, progress)
        clock, ok = _next(clock, there, lost, dt, t1, value, slope, progress.ok)
        return fuse(all_promoted((progress._replace(ok=ok), clock), axes)), None

    motion = system.motion(start)
    force = system.force(t0, motion) if method.keeps_force(system) else None
    progress = Progress(motion, force, jnp.ones((), bool))
    value, slope = _along(system, density, t0, progress)
    clock = _first(t0, dt, t1, value if rho is None else rho, slope)
    # Twice, because each order of reverse mode takes one off: see `integrate`.
    step = jax.checkpoint(jax.checkpoint(advance, prevent_cse=False), prevent_cse=False)

    def go(carry: Any, count: int) -> Any:
        return jax.lax.scan(step, carry, length=count, unroll=method.unroll)[0]

    def save_interval(carry: Any, _: None) -> tuple[Any, Any]:
        if t1 is None or reverse:
            carry = go(carry, save_every)
        else:
            carry = _while_any_moves(partial(go, count=_block(save_every)), carry, save_every // _block(save_every))
        progress, clock = carry
        return carry, (system.state(progress.motion), clock.t, clock.rho)

    progress = progress._replace(ok=_near(clock.rho, value) & (clock.half > 0))
    begin = all_promoted((progress, clock), axes)
    (progress, clock), kept = jax.lax.scan(save_interval, begin, length=steps // save_every)
    first = (start, t0, begin[1].rho)
    states, times, densities = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, kept)
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves((progress.motion, clock.rho))]
    ok = progress.ok & jnp.all(jnp.stack(finite))
    return AdaptivePath(times, states, densities, clock.taken, ok if t1 is None else ok & (clock.t == t1))


def _first(t0: Array, dt: Array, t1: Array | None, rho: Array, slope: Array) -> _Clock:
    # Made from one number of the motion, so that they have its type on a mesh of devices, too.
    zero = jnp.zeros_like(rho)
    clock = _Clock(t0 + zero, zero, rho, rho, zero, jnp.zeros_like(rho, bool), jnp.zeros_like(rho, jnp.int32))
    return _planned(clock, dt, t1, slope, jnp.ones_like(rho, bool))


def _ends_of_step(given: tuple[_Clock, Array | None]) -> tuple[Array, Array, tuple[Array, Array]]:
    """The times of the next step; the later one again, and what rounding takes from it (Kahan)."""
    clock, t1 = given
    part = clock.h + clock.lost
    there = clock.t + part
    lost = part - (there - clock.t)
    if t1 is not None:
        there, lost = jnp.where(clock.last, t1, there), jnp.where(clock.last, jnp.zeros_like(lost), lost)
    return clock.t, there, (there, lost)


def _next(
    clock: _Clock, there: Array, lost: Array, dt: Array, t1: Array | None, value: Array, slope: Array, ok: Array
) -> tuple[_Clock, Array]:
    """The clock after a step, with Q and d(log Q)/dt there."""
    moved = clock.h != 0
    rho = jnp.where(moved, clock.half + dt / 2 * slope, clock.rho)
    ok = ok & _near(rho, value)
    taken = clock.taken + moved.astype(jnp.int32)
    clock = _planned(clock._replace(t=there, lost=lost, rho=rho, taken=taken), dt, t1, slope, ok)
    return clock, ok & (clock.half > 0)


def _near(rho: Array, value: Array) -> Array:
    """Whether the density is positive and rho has kept to it; it has not where the density jumped."""
    return (value > 0) & (rho <= _STRAYED * value) & (value <= _STRAYED * rho)


def _planned(clock: _Clock, dt: Array, t1: Array | None, slope: Array, ok: Array) -> _Clock:
    """The clock with its next step; none where rho would be lost, or all is done."""
    half = clock.rho + dt / 2 * slope
    ok = ok & (half > 0)
    h = jnp.where(ok, dt / jnp.where(ok, half, jnp.ones_like(half)), jnp.zeros_like(half))
    if t1 is None:
        return clock._replace(half=half, h=h)
    left = (t1 - clock.t) - clock.lost
    last = ok & (left * jnp.sign(dt) <= jnp.abs(h) * (1 + _SLACK))
    # Where dt points away from t1 there is nothing to take.
    left = jnp.where(left * jnp.sign(dt) > 0, left, jnp.zeros_like(left))
    away = (t1 - clock.t) * jnp.sign(dt) < 0
    return clock._replace(half=half, h=jnp.where(last, left, h), last=last & ~away)


def _along(system: System, density: Any, t: Array, progress: Progress) -> tuple[Array, Array]:
    """The density and the rate of its logarithm along the motion."""
    motion = progress.motion
    force = system.force(t, motion) if progress.force is None else progress.force
    velocity = system.velocity(motion.momentum)
    rate = system.kind.momentum_rate(motion.momentum, velocity, force)
    moving = (jnp.ones_like(t), rate, system.kind.rate(motion.pose, velocity))
    value, change = jax.jvp(partial(_evaluate, density, system), (t, motion.momentum, motion.pose), moving)
    return value, change / value


def _evaluate(density: Any, system: System, t: Array, momentum: Any, pose: Any) -> Array:
    """The density, on components as a torque is."""
    (value, *_), found = system.evaluate(lambda t, s: jnp.asarray(density(t, s), t.dtype), t, Motion(momentum, pose))
    if found.shape:
        raise ValueError(f"density must return one number, got an array of shape {found.shape}.")
    return jnp.asarray(value, t.dtype)


def _while_any_moves(go: Any, carry: Any, turns: int) -> Any:
    """So many turns, or as many as it takes until every body of the batch has no next step."""

    def moves(state: Any) -> Array:
        turn, (_, clock) = state
        return (turn < turns) & (clock.h != 0)

    return jax.lax.while_loop(moves, lambda state: (state[0] + 1, go(state[1])), (jnp.array(0, jnp.int32), carry))[1]


def _block(count: int) -> int:
    """The largest divisor of the count that is no larger than _BLOCK."""
    return max(n for n in range(1, _BLOCK + 1) if count % n == 0)
