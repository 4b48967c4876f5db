"""What is read off a motion: energies, momenta and angular velocities, of one state, a batch, or a whole path."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._kernel.checks import as_floats, described
from .._kernel.replay import traits
from . import so3
from .bodies import Body, Particles, RigidBody, TensorBody, principal_of
from .compatibility import check_body, check_state, check_torque
from .states import AnyState, ParticleState, State, attitude_of
from .torques import TorqueLike, on_body, potential_of


def kinetic_energy(body: Body, state: AnyState) -> Float[Array, "*batch"]:
    """Pi . I^-1 Pi / 2, or p . M^-1 p / 2. Shapes (..., 3) give (...), particles one number."""
    work = state.momentum * _velocity(body, state)
    return jnp.sum(work, axis=None if isinstance(body, Particles) else -1) / 2


def energy(
    body: Body, torque: TorqueLike | None, motion: Any, t: float | Array | None = None
) -> Float[Array, "*batch"]:
    """Kinetic plus potential energy.

    Args:
        body: one for all states; map over several with `jax.vmap`.
        torque: as for `integrate`; None, or one with a potential.
        motion: a state, which may carry leading batch axes (but not of particles), or a path, whose times are then
            those of its states.
        t: time, for a state in a field that changes, of a shape that broadcasts to the batch.

    Returns:
        (...), the batch shape of the state, or of the path's states.

    Raises:
        ValueError: the torque has no potential; the potential depends on time, and no time is given; a batch of bodies.
    """
    if isinstance(motion, State):
        state, of_path = motion, ()
    elif isinstance(getattr(motion, "states", None), State):
        if t is not None:
            raise ValueError("a path has its own times; leave out t.")
        state, t, of_path = motion.states, motion.times, motion.times.shape
        if isinstance(state, ParticleState) and len(of_path) != motion.ok.ndim + 1:
            raise ValueError("of an ensemble of particles map energy over the states with jax.vmap, and give t.")
    else:
        raise ValueError(f"motion must be a state or a path, got {described(motion)}.")
    check_body(body, state)
    check_torque(torque)
    if any(leaf.ndim > most for leaf, most in _axes(body)):
        raise ValueError("body must be one body; map energy over several with jax.vmap.")
    t = None if t is None else as_floats("t", t).astype(state.momentum.dtype)
    batch = _batch(state, of_path)
    if torque is None:
        potential = None
    else:
        potential = potential_of(on_body(torque, body))
        if t is None:
            one = jax.tree.map(lambda x: x[(0,) * len(batch)], state)
            if traits(lambda t, s: jnp.asarray(potential(t, s)), jnp.zeros((), one.momentum.dtype), one).reads[0]:
                raise ValueError("the potential depends on time: give t, or the path rather than its states.")
    times = jnp.broadcast_to(jnp.zeros((), state.momentum.dtype) if t is None else t, batch)

    def one_energy(state: AnyState, t: Array) -> Array:
        kinetic = kinetic_energy(body, state)
        return kinetic if potential is None else kinetic + potential(t, state)

    function = one_energy
    for _ in batch:
        function = jax.vmap(function)
    return function(state, times)


def _axes(body: Body) -> list[tuple[Array, int]]:
    """The arrays of a body, each with the most axes that it has for one body."""
    if isinstance(body, Particles):
        return [(body.mass, 2)]
    return [(leaf, 1) for leaf in jax.tree.leaves(body)]


def _batch(state: AnyState, times: tuple[int, ...]) -> tuple[int, ...]:
    """The leading axes of a state, or of the states of a path; those of particles are told by the path's times."""
    shape = state.momentum.shape
    return shape[: len(times)] if isinstance(state, ParticleState) else shape[:-1]


def angular_velocity(body: RigidBody | TensorBody, state: AnyState) -> Float[Array, "*batch 3"]:
    """The angular velocity I^-1 Pi in the body frame, radians per unit of time; shapes as the state's momentum."""
    return _velocity(body, state)


def spatial_angular_velocity(body: RigidBody | TensorBody, state: AnyState) -> Float[Array, "*batch 3"]:
    """The angular velocity R I^-1 Pi in space components.

    Raises:
        ValueError: for a state without attitude.
    """
    return so3.rotate(attitude_of(state), _velocity(body, state))


def spatial_momentum(state: AnyState) -> Float[Array, "*batch 3"]:
    """The angular momentum in space components, R Pi, (..., 3): constant for a free body.

    Raises:
        ValueError: for a state without attitude.
    """
    return so3.rotate(attitude_of(state), state.momentum)


def _velocity(body: Body, state: AnyState) -> Array:
    """The velocity of a state, or of one state for each body."""
    check_state("state", state)
    check_body(body, state)
    principal = principal_of(body)
    if isinstance(principal, RigidBody) and 1 < principal.moments.ndim < state.momentum.ndim:
        raise ValueError(
            f"moments {principal.moments.shape} are of several bodies, and momentum {state.momentum.shape} of several "
            "states of each; map over the bodies with jax.vmap."
        )
    return body.velocity(state.momentum)
