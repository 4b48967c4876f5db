"""`free_motion`: torque-free motion of a body at any times, each by one evaluation and without steps.

The closed form is in `free_orbit.py`. One loop over the bodies finds their orbits, one follows them for a short time,
one doubles this time as often as the largest rotation of the batch needs, and one makes the states.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .._checks.arguments import as_floats, require_finite, require_resolved
from .._math import components as cp
from .._xla.compiler import tuned_jit
from .._xla.fusion import begin, fuse
from ..integrators.flights.free_orbit import Circle, Orbit
from ..integrators.system import Motion, System
from ..integrators.verdict import FINE, LOST, at_start, earlier, is_fine
from ..model.bodies import Body, SymmetricRotor, principal_of
from ..model.state import StateT
from .arguments import as_method, as_scalar, check_system
from .bad_start import finite_start, nan_unless
from .path import Path
from .results import result_of


def free_motion(body: Body, start: StateT, times: Any, *, t0: float | Array = 0.0) -> Path[StateT]:
    """The states of one free body at any times; supports `jax.vmap` over bodies and states.

    Nothing is integrated: a state after a million rotations takes less than 2 times longer than after one. The error of
    momentum and attitude is a few eps (1 + Omega |t|), relative to |Pi| and in radians. Omega = sqrt(2 energy /
    smallest moment) bounds the angular velocity. Close to the separatrix the body tumbles between two steady rotations
    about the middle axis, and the result is the exact motion for moments and a momentum that differ by a few eps.

    A body that translates moves along a straight line, with the rounding error of the distance t p/m. The motion of a
    `SymmetricRotor` is differentiable everywhere except at rest; of other bodies if the three moments differ and the
    momentum is neither along a principal axis nor on the separatrix. Otherwise derivatives can be NaN, unlike the
    derivatives of `integrate` with JACOBI.

    Args:
        body: a `RigidBody`, a `TensorBody` in a custom frame, a `SymmetricRotor`, or a `FreeBody` of one of these.
        start: the state at the time t0, of any kind that fits the body.
        times: (n,), before and after t0, in any order, which the dtype of the state must be able to distinguish.
        t0: the time of the initial state, ().

    Returns:
        The path at these times. `ok` is False if a time is so long that no digit of the phase is left; if rounding
        errors of the attitude would be magnified by more than 64, as for a body 10 times thinner than long that spins
        about its long side; or if a number is not finite.

    Raises:
        ValueError: as for `midlie_jax.integrate`.

    Examples:
        >>> body = ml.RigidBody([1.0, 2.0, 2.5])
        >>> start = ml.RigidState([0.01, 2.0, 0.01], [1.0, 0.0, 0.0, 0.0])  # about the middle axis, which is unstable
        >>> path = ml.free_motion(body, start, [0.0, 1.0, 10.0, 1e6])
        >>> path.states.attitude.shape, bool(path.ok)
        ((4, 4), True)
    """
    mover = "SYMMETRIC[EA]" if isinstance(getattr(body, "turning", body), SymmetricRotor) else "JACOBI[EA]"
    check_system(as_method(mover), body, None, start)
    given, times = times, as_floats("times", times)
    if times.ndim != 1:
        raise ValueError(f"times must have shape (n,), got {times.shape}; map over a batch with jax.vmap.")
    times = times.astype(start.momentum.dtype)
    require_finite("times", times)
    require_resolved("times", given, times.dtype, t0)
    t0 = as_scalar("t0", t0, start.momentum.dtype)
    run = _run_of_several if start.several else _run
    return run(body, start, times - t0)._replace(times=times)


@tuned_jit
def _run_of_several(body: Any, start: Any, times: Array) -> Path[Any]:
    """For coupled bodies, which move independently without a torque."""
    own = 0 if body.batch else None
    paths = jax.vmap(path_of_one, in_axes=(own, 0, None))(body, start.of_body(slice(None)), times)
    states = type(start).of_bodies(jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), paths.states))
    worst = jnp.argmin(paths.first_bad)
    failed = jax.tree.map(lambda x: x[worst], (paths.first_bad, paths.result))
    return Path(times, states, jnp.all(paths.ok), *failed)


def path_of_one(body: Any, start: StateT, times: Array) -> Path[StateT]:
    good = cp.all_finite(start)
    start = finite_start(start, good, None, times, (body, times))
    system = System.of(body, None, start, jnp.zeros((), times.dtype))
    motion = system.motion(start)
    turning, turned = system.rotating(motion)
    turning_body = principal_of(body).turning
    if isinstance(turning_body, SymmetricRotor):
        orbit: Any = Circle.of(*begin((turning.inertia, turned.momentum)))
    else:
        orbit = fuse(Orbit.of(*begin((turning_body.moments, turned.momentum))))

    def at(t: Array) -> tuple[Any, Array]:
        momentum, turn, ok = orbit.at(t, turns=turning.kind.has_pose)
        rotated = Motion(momentum, turning.kind.act(turned.pose, turn))
        moved = system.in_user_axes(system.travelled(t, motion, rotated))
        same = Motion(*start.parts())
        moved = fuse(jax.tree.map(lambda x, y: jnp.where(t == 0, x, y), same, moved))
        return system.kind.join(moved.momentum, moved.pose), ok & cp.all_finite(moved)

    states, ok = jax.vmap(at)(times)
    states = nan_unless(good, states)
    possible = at_start(body, good)
    count, ok = times.shape[0], ok & is_fine(possible)
    first_bad = jnp.min(jnp.where(ok, count, jnp.arange(count)), initial=count).astype(jnp.int32)
    judged = earlier(possible, jnp.where(jnp.all(ok), FINE, LOST))
    return Path(times, states, jnp.all(ok), first_bad, result_of(judged, cp.all_finite(states)))


_run = tuned_jit(path_of_one)
