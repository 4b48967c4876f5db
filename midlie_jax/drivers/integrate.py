"""Many steps: a `lax.scan` over steps of one size, with states kept every so often."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from .._kernel.checks import as_count
from .._kernel.fusion import seam, together
from .._kernel.internals import all_promoted, axes_of_run, promoted
from ..methods.stepper import Method, Motion, System
from ..model.bodies import Body
from ..model.states import State
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
    start: State,
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
    start: State,
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

    constants, functions = eqx.partition((system, t0, dt), eqx.is_array)

    def advance(h: Array, carry: Any, n: Array) -> tuple[Any, None]:
        (motion, force, ok), h, given = seam((carry, h, constants))
        system, t0, dt = eqx.combine(given, functions)
        here, there = time_of(t0, dt, n), time_of(t0, dt, n + 1)
        motion, force, fine = method.step(system, here, there, h, motion, force)
        return together(all_promoted((motion, force, ok & fine), axes)), None

    motion, ok = system.motion(start), promoted(jnp.asarray(counted), axes)
    force = _first_force(method, system, motion, ok, advance, time_of(t0, dt, first), first)
    # Twice, because each order of reverse mode takes one off: a gradient of a gradient keeps one state a step, too.
    step = jax.checkpoint(jax.checkpoint(partial(advance, dt), prevent_cse=False), prevent_cse=False)

    def leap(carry: Any, n: Array) -> tuple[Any, State]:
        carry, _ = jax.lax.scan(step, carry, n + jnp.arange(save_every, dtype=jnp.int32), unroll=method.unroll)
        return carry, system.state(carry[0])

    kept = first + save_every * jnp.arange(steps // save_every, dtype=jnp.int32)
    (motion, _, ok), states = jax.lax.scan(leap, (motion, force, ok), kept)
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), start, states)
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(motion)]
    times = time_of(*uniform, jnp.concatenate([first[None], kept + save_every]))
    return Path(times, states, ok & jnp.all(jnp.stack(finite)))


def _first_force(
    method: Method, system: System, motion: Motion, ok: Array, advance: Any, t: Array, first: Array
) -> Any:
    """The force at the start, from two steps of no length.

    Evaluating the torque here directly would be shorter, but compiled in another place it may round otherwise
    than inside the loop, and a run continued from its middle would then differ in the last bit. A step of zero
    length leaves the motion alone and runs the loop's own code; a loop of one turn would be unrolled. The
    derivative is the torque's own: the loop's would only take longer to compile.
    """
    if not method.keeps_force(system):
        return None
    zeros = jax.tree.map(jnp.zeros_like, motion.momentum)
    here = jnp.stack([first - 1, first - 1])
    still = jnp.zeros_like(jax.tree.leaves(motion)[0].ravel()[0])
    loop = jax.lax.stop_gradient((motion, zeros, ok))
    (_, force, _), _ = jax.lax.scan(partial(advance, still), loop, here)
    direct = system.force(t, motion)
    return jax.tree.map(lambda f, d: jax.lax.stop_gradient(f) + (d - jax.lax.stop_gradient(d)), force, direct)


def time_of(t0: Array, dt: Array, n: Array) -> Array:
    """t0 + n dt, rounded to the dtype, for every index n of 32 bits.

    From the index: adding dt up would lose a step of float32 time. In two parts, both of which a float32 holds exactly.
    """
    high = n >> _EXACT_BITS
    low = n - (high << _EXACT_BITS)
    return t0 + (high.astype(dt.dtype) * (2**_EXACT_BITS * dt) + low.astype(dt.dtype) * dt)


def end_state(
    method: Method, body: Body, torque: TorqueLike | None, start: State, dt: Array, turns: Array
) -> tuple[State, Array]:
    """The state after so many turns of the loop of `integrate`, of `method.unroll` steps each; whether all went well.

    For programs that are compiled before the number of steps is known: it is an argument here, at the price of a
    reverse derivative. Nothing is checked. `tests/test_work_precision.py` holds it to the result of `integrate`.
    """
    zero = jnp.zeros((), start.momentum.dtype)
    system = System.of(body, torque, start, zero)
    constants, functions = eqx.partition(system, eqx.is_array)
    motion = system.motion(start)
    force = system.force(zero, motion) if method.keeps_force(system) else None

    def turn(i: Array, carry: Any) -> Any:
        for k in range(method.unroll):
            (motion, force, ok), h, given = seam((carry, dt, constants))
            n = i * method.unroll + k
            here, there = time_of(zero, h, n), time_of(zero, h, n + 1)
            motion, force, fine = method.step(eqx.combine(given, functions), here, there, h, motion, force)
            carry = together((motion, force, ok & fine))
        return carry

    motion, _, ok = jax.lax.fori_loop(0, turns, turn, (motion, force, jnp.array(True)))
    return system.state(motion), ok
