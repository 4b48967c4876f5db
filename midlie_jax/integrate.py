"""Many steps: a `lax.scan` over steps of one size, with states kept every so often."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from ._fuse import seam, together
from ._types import all_promoted, axes_of_run
from .bodies import Particles, RigidBody, State
from .checks import require_finite, same_dtype
from .methods import method as find_method
from .stepper import Method, Motion, System
from .torques import TorqueLike


class Path(NamedTuple):
    """A motion at the times that were kept.

    Attributes:
        times: (n,), the start first; n = 1 + steps / save_every.
        states: the states at those times, of the class of the start, with a leading axis (n,).
        ok: (), False when a solve failed or a number stopped being finite.
    """

    times: Float[Array, "*batch n"]
    states: Any
    ok: Bool[Array, "*batch"]


def integrate(
    method: Method | str,
    body: RigidBody | Particles,
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
        body: what moves.
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
    method = find_method(method) if isinstance(method, str) else method
    check_arguments(method, body, torque, start, steps, save_every, first_step)
    dtype = start.momentum.dtype
    dt = as_scalar("dt", dt, dtype)
    t0 = as_scalar("t0", t0, dtype)
    return _run(method, body, torque, start, dt, t0, jnp.asarray(first_step, jnp.int32), steps, save_every)


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
    kind = type(start)
    axes = axes_of_run((body, torque, start, dt, t0, first), (torque, t0, start))
    uniform = t0, dt
    body, torque, start, dt, t0 = all_promoted((body, torque, start, dt, t0), axes)
    system = System.of(body, torque, start, t0)

    constants, functions = eqx.partition((system, t0, dt), eqx.is_array)

    def advance(h: Array, carry: Any, n: Array) -> tuple[Any, None]:
        (motion, force, ok), h, given = seam((carry, h, constants))
        system, t0, dt = eqx.combine(given, functions)
        here, there = _time(t0, dt, n), _time(t0, dt, n + 1)
        motion, force, fine = method.step(system, here, there, h, motion, force)
        return together(all_promoted((motion, force, ok & fine), axes)), None

    motion, ok = Motion(*start.parts()), jnp.ones_like(start.momentum.ravel()[0], bool)
    force = _first_force(method, system, motion, ok, advance, _time(t0, dt, first), first)
    # Twice, because each order of reverse mode takes one off: a gradient of a gradient keeps one state a step, too.
    step = jax.checkpoint(jax.checkpoint(partial(advance, dt), prevent_cse=False), prevent_cse=False)

    def leap(carry: Any, n: Array) -> tuple[Any, State]:
        carry, _ = jax.lax.scan(step, carry, n + jnp.arange(save_every, dtype=jnp.int32), unroll=method.unroll)
        return carry, kind.join(*carry[0])

    kept = first + save_every * jnp.arange(steps // save_every, dtype=jnp.int32)
    (motion, _, ok), states = jax.lax.scan(leap, (motion, force, ok), kept)
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), start, states)
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(motion)]
    times = _time(*uniform, jnp.concatenate([first[None], kept + save_every]))
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


def _time(t0: Array, dt: Array, n: Array) -> Array:
    """From the integer: adding dt up would lose a step of float32 time."""
    return t0 + n.astype(dt.dtype) * dt


def as_scalar(name: str, value: Any, dtype: Any) -> Array:
    array = jnp.asarray(value)
    if array.ndim:
        raise ValueError(f"{name} must be a scalar, got shape {array.shape}; map over a batch with jax.vmap.")
    require_finite(name, array)
    return array.astype(dtype)


def check_arguments(
    method: Any, body: Any, torque: Any, start: Any, steps: Any, save_every: Any, first_step: Any
) -> None:
    if not isinstance(method, Method):
        raise ValueError(f"method must come from midlie_jax.method(name), got {type(method).__name__}.")
    if not isinstance(start, State):
        raise ValueError(f"start must be a state such as midlie_jax.RigidState, got {type(start).__name__}.")
    if not isinstance(body, start.body):
        raise ValueError(
            f"a {type(start).__name__} belongs to {start.body.__name__}, but body is {type(body).__name__}."
        )
    if not isinstance(body, method.bodies):
        raise ValueError(
            f"method {method.name!r} moves {method.bodies.__name__}, but body is {type(body).__name__}; "
            "midlie_jax.methods() lists all."
        )
    if torque is not None and not callable(torque):
        raise ValueError(f"torque must be None or a callable of (t, state), got {type(torque).__name__}.")
    if isinstance(body, RigidBody):
        for name, array in (("body.moments", body.moments), ("start.momentum", start.momentum)):
            if array.ndim != 1:
                raise ValueError(f"{name} must be (3,), got {array.shape}; map over a batch with jax.vmap.")
    for name, value in (("steps", steps), ("save_every", save_every)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise ValueError(f"{name} must be a positive Python int, got {value!r}.")
    if steps % save_every:
        raise ValueError(f"steps ({steps}) must be divisible by save_every ({save_every}).")
    if not isinstance(first_step, (int, Array)):
        raise ValueError(f"first_step must be an integer, got {first_step!r}.")
    for leaf in jax.tree.leaves(start):
        if leaf.dtype != start.momentum.dtype:
            raise ValueError(f"all of start must have one dtype, got {leaf.dtype} beside {start.momentum.dtype}.")
    same_dtype("start.momentum", start.momentum, body=body, torque=torque)
    for name, value in (("body", body), ("start", start), ("torque", torque)):
        for leaf in jax.tree.leaves(eqx.filter(value, eqx.is_inexact_array)):
            require_finite(name, leaf)
