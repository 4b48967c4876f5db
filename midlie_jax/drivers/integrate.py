"""Many steps: a `lax.scan` over steps of one size, with states kept every so often."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from .._kernel.checks import as_count
from .._kernel.internals import all_promoted, axes_of_run, promoted
from ..methods.base import Method, Progress
from ..methods.system import System
from ..model.bodies import Body
from ..model.states import AnyState
from ..model.torques import TorqueLike, on_body
from .arguments import as_first_step, as_method, as_scalar, check_saving, check_step, check_system, counts

_EXACT_BITS = 24  # a float32 holds every integer of so many bits


class Path(NamedTuple):
    """A motion at the times that were kept.

    Attributes:
        times: (n,), the start first; n = 1 + steps / save_every.
        states: the states at those times, of the class of the start, with a leading axis (n,).
        ok: (), False when a solve failed or a number stopped being finite.
    """

    times: Float[Array, "*n"]
    states: Any
    ok: Bool[Array, "*batch"]


def integrate(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState,
    *,
    dt: float | Array,
    steps: int,
    save_every: int = 1,
    t0: float | Array = 0.0,
    first_step: int | Array = 0,
) -> Path:
    """Integrates one body with a constant step; map over bodies, torques, states and steps with `jax.vmap`.

    Compiled on the first call for each method, torque function, shape and step count, and differentiable,
    forward and reverse, in every array. Reverse mode keeps one state a step and recomputes the rest. Everything
    is computed in the dtype of the start.

    Args:
        method: from `midlie_jax.method`, or its name.
        body: what moves: a `RigidBody`, a `TensorBody` in a frame of your own, or `Particles`.
        torque: any callable `torque(t, state) -> (3,)` in the body frame (for particles a force of the momentum's
            shape), or None. Pass the same function object again to reuse what was compiled.
        start: the state at the first time; its class decides how much is followed.
        dt: step, (), may be negative.
        steps: number of steps.
        save_every: keep every so many steps; must divide `steps`.
        t0: time of step 0, ().
        first_step: the index of the first step: time is t0 + (first_step + n) dt, from the integer. Continuing
            from a kept state with the index it was kept at is, bit for bit, the run that was never stopped.

    Returns:
        The path. A failed solve, NaN or infinity shows in `path.ok`, never as an exception.

    Raises:
        ValueError: an argument does not fit; the message names it and the cure. Raised before anything is traced.
    """
    steps, save_every = as_count("steps", steps), as_count("save_every", save_every)
    check_saving(steps, save_every)
    first = as_first_step(first_step, steps)
    method = check_system(as_method(method), body, torque, start)
    dtype = start.momentum.dtype
    dt, t0 = as_scalar("dt", dt, dtype), as_scalar("t0", t0, dtype)
    check_step(dt)
    return _run(method, body, torque, start, dt, t0, first, steps, save_every)


@eqx.filter_jit
def _run(
    method: Method,
    body: Any,
    torque: Any,
    start: AnyState,
    dt: Array,
    t0: Array,
    first: Array,
    steps: int,
    save_every: int,
) -> Path:
    axes = axes_of_run((body, torque, start, dt, t0, first), (on_body(torque, body), t0, start))
    uniform = t0, dt
    body, torque, start, dt, t0 = all_promoted((body, torque, start, dt, t0), axes)
    system = System.of(body, torque, start, t0)
    counted, first = counts(first, steps), first.astype(jnp.int32)

    def advance(h: Array, progress: Progress, n: Array) -> tuple[Progress, None]:
        return method.advance(system, (t0, dt), partial(ends_of_step, n), h, progress, axes)

    progress = Progress(system.motion(start), None, promoted(jnp.asarray(counted), axes))
    if method.keeps_force(system):
        progress = _with_force(system, progress, advance, time_of(t0, dt, first), first)
    # Two checkpoints, because each order of reverse mode removes one: a gradient of a gradient, too, then keeps one
    # state a step.
    step = jax.checkpoint(jax.checkpoint(partial(advance, dt), prevent_cse=False), prevent_cse=False)

    def save_interval(progress: Progress, n: Array) -> tuple[Progress, AnyState]:
        indices = n + jnp.arange(save_every, dtype=jnp.int32)
        progress, _ = jax.lax.scan(step, progress, indices, unroll=method.unroll)
        return progress, system.state(progress.motion)

    kept = first + save_every * jnp.arange(steps // save_every, dtype=jnp.int32)
    progress, states = jax.lax.scan(save_interval, progress, kept)
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), start, states)
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(progress.motion)]
    times = time_of(*uniform, jnp.concatenate([first[None], kept + save_every]))
    return Path(times, states, progress.ok & jnp.all(jnp.stack(finite)))


def ends_of_step(n: Array, clock: tuple[Array, Array]) -> tuple[Array, Array, None]:
    """The times of step n, from (t0, dt)."""
    return time_of(*clock, n), time_of(*clock, n + 1), None


def _with_force(system: System, progress: Progress, advance: Callable[..., Any], t: Array, first: Array) -> Progress:
    """The progress with the force at the start, from two steps of no length.

    Evaluating the torque here directly would be shorter. But compiled in another place the torque may round differently
    from inside the loop, and a run continued from its middle would then differ in the last bit. A step of zero length
    leaves the motion alone and runs the code of the loop; two of them, because a loop of one turn would be unrolled.
    The derivative is that of the torque itself, which compiles faster than that of the loop.
    """
    motion = progress.motion
    zeros = jax.tree.map(jnp.zeros_like, motion.momentum)
    indices = jnp.stack([first - 1, first - 1])
    still = jnp.zeros_like(jax.tree.leaves(motion)[0].ravel()[0])
    loop = jax.lax.stop_gradient(progress._replace(force=zeros))
    found, _ = jax.lax.scan(partial(advance, still), loop, indices)
    direct = system.force(t, motion)
    stop = jax.lax.stop_gradient
    return progress._replace(force=jax.tree.map(lambda f, d: stop(f) + (d - stop(d)), found.force, direct))


def time_of(t0: Array, dt: Array, n: Array) -> Array:
    """t0 + n dt, rounded to the dtype, for every index n of 32 bits.

    From the index: adding dt up would lose a step of float32 time. In two parts, both of which a float32 holds exactly.
    """
    high = n >> _EXACT_BITS
    low = n - (high << _EXACT_BITS)
    return t0 + (high.astype(dt.dtype) * (2**_EXACT_BITS * dt) + low.astype(dt.dtype) * dt)
