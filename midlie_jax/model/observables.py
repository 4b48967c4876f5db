"""Observables: energies, momenta and angular velocities of one state, a batch of states, or the states of a path.

All except the energy also accept many bodies with many states each. For the energy, the drivers handle shared torques.
"""

from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats, described
from .._math import components as cp
from .._xla.replay import traits
from . import so3
from .bodies import Body, SymmetricRotor, principal_of
from .compatibility import check_body, check_state, check_torque
from .free_body import Momenta
from .state import AnyState, State, attitude_of
from .torques import TorqueLike, on_body, potential_of


def kinetic_energy(body: Body, state: AnyState) -> Float[Array, "*batch"]:
    """The kinetic energy Pi . I^-1 Pi / 2, or p . M^-1 p / 2; the total for coupled bodies and bodies that translate.

    For a `SymmetricRotor` it is |pi|^2 / (2 I1), which omits the constant energy of the spin.

    Args:
        body: one body for all states; or n bodies, whose states have the leading axes (n, times).
        state: any state of this body, which may have leading batch axes; for a path its `states`.

    Returns:
        (...) for momenta of shape (..., 3); () for particles.

    Raises:
        ValueError: the state does not belong to the body, or the first axis of the states of n bodies is not n.

    Examples:
        >>> ml.observe.kinetic_energy(ml.RigidBody([5.0, 5.0, 1.0]), ml.MomentumState([10.0, 0.0, 50.0]))
        Array(1260., dtype=float64)
    """
    products = jax.tree.map(jnp.multiply, _momentum(state), _velocity(body, state))
    axes = tuple(range(-state.own_axes, 0)) if state.own_axes else None
    sums = [jnp.sum(leaf, axis=axes) for leaf in jax.tree.leaves(products)]
    return sum(sums[1:], start=sums[0]) / 2


def energy(
    body: Body, torque: TorqueLike | None, motion: Any, t: float | Array | None = None
) -> Float[Array, "*batch"]:
    """Kinetic plus potential energy of one body, whose states may have leading axes; `midlie_jax.observe.energy` maps
    it over several.
    """
    if isinstance(motion, State):
        state, path_shape = motion, ()
    elif isinstance(getattr(motion, "states", None), State):
        if t is not None:
            raise ValueError("a path has its own times; do not pass t.")
        state, t, path_shape = motion.states, motion.times, motion.times.shape
        if not state.own_axes and len(path_shape) != motion.ok.ndim + 1:
            raise ValueError(f"for an ensemble of {type(state).__name__} map energy over states and t by jax.vmap.")
    else:
        raise ValueError(f"motion must be a state or a path, got {described(motion)}.")
    check_body(body, state)
    check_torque(torque)
    if state.kind.batch_of(body):
        raise ValueError("body must be one body; map energy over several with jax.vmap.")
    t = None if t is None else as_floats("t", t).astype(state.momentum.dtype)
    # A particle state can have any shape, so the times of its path determine the number of leading axes.
    batch = state.batch if state.own_axes else state.momentum.shape[: len(path_shape)]
    if torque is None:
        potential = None
    else:
        potential = potential_of(on_body(torque, body))
        if t is None:
            first = jax.tree.map(lambda x: x[(0,) * len(batch)], state)
            if traits(lambda t, s: jnp.asarray(potential(t, s)), jnp.zeros((), first.momentum.dtype), first).reads[0]:
                raise ValueError("the potential depends on time: give t, or pass the path instead of its states.")
    times = jnp.broadcast_to(jnp.zeros((), state.momentum.dtype) if t is None else t, batch)

    def energy_of_state(state: AnyState, t: Array) -> Array:
        kinetic = kinetic_energy(body, state)
        return kinetic if potential is None else kinetic + potential(t, state)

    for _ in batch:
        energy_of_state = jax.vmap(energy_of_state)
    return energy_of_state(state, times)


def angular_velocity(body: Body, state: AnyState) -> Float[Array, "*batch 3"]:
    """The angular velocity I^-1 Pi in the body frame, radians per unit of time, (..., 3) like the momentum.

    Arguments and errors are as for `kinetic_energy`; a `SymmetricRotor`, whose spin is unknown, is also an error.

    Examples:
        >>> ml.observe.angular_velocity(ml.RigidBody([5.0, 5.0, 1.0]), ml.MomentumState([10.0, 0.0, 50.0]))
        Array([ 2.,  0., 50.], dtype=float64)
    """
    if isinstance(principal_of(body).turning, SymmetricRotor):
        raise ValueError("the angular velocity of a SymmetricRotor is undefined, as is its spin; use body.velocity.")
    velocity = _velocity(body, state)
    return velocity.angular if isinstance(velocity, Momenta) else velocity


def spatial_angular_velocity(body: Body, state: AnyState) -> Float[Array, "*batch 3"]:
    """The angular velocity R I^-1 Pi in the space frame, radians per unit of time, (..., 3).

    Arguments and errors are as for `kinetic_energy`; the state must have an attitude.

    Examples:
        >>> ml.observe.spatial_angular_velocity(body, start).round(4)
        Array([ 0.    , -14.776 ,  47.7668], dtype=float64)
    """
    velocity = _velocity(body, state)
    if isinstance(velocity, Momenta):
        velocity = velocity.angular
    if not isinstance(velocity, Array):
        raise ValueError(f"a {type(state).__name__} has more than an angular velocity; use body.velocity.")
    return so3.rotate(attitude_of(state), velocity)


def spatial_momentum(state: AnyState) -> Float[Array, "*batch 3"]:
    """The angular momentum in the space frame about its origin, (..., 3); constant for a free body.

    It is R Pi for a body that rotates about a fixed point, and x cross p + R Pi for a body that translates. For coupled
    bodies it is the total.

    Args:
        state: a state with an attitude or an axis, otherwise a ValueError is raised; for a path its `states`.

    Examples:
        >>> ml.observe.spatial_momentum(start).round(4)
        Array([  0.    , -14.776 ,  47.7668], dtype=float64)
    """
    return state.spatial_momentum()


def linear_momentum(state: AnyState) -> Float[Array, "*batch 3"]:
    """The linear momentum p of a body that translates, or the total of coupled bodies, space frame, (..., 3).

    Args:
        state: a `FreeState` or `FreeAxisState`, for a path its `states`; a ValueError if the state does not translate.

    Examples:
        >>> thrown = ml.FreeState([0.1, 3.0, 0.2], [1.0, 0.0, 0.0, 0.0], [12.0, 0.0, 9.0], position=[0.0, 0.0, 1.5])
        >>> ml.observe.linear_momentum(thrown)
        Array([12.,  0.,  9.], dtype=float64)
    """
    linear = _translation(state)[0]
    return jnp.sum(linear, axis=-2) if state.several else linear


def linear_velocity(body: Body, state: AnyState) -> Float[Array, "*batch 3"]:
    """The velocity p/m of the centre of mass of a body that translates, space frame, length/time, (..., 3).

    Arguments and errors are as for `kinetic_energy`; a state that does not translate is also an error.

    Examples:
        >>> brick = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.6]), mass=3.0)
        >>> thrown = ml.FreeState([0.1, 3.0, 0.2], [1.0, 0.0, 0.0, 0.0], [12.0, 0.0, 9.0], position=[0.0, 0.0, 1.5])
        >>> ml.observe.linear_velocity(brick, thrown)
        Array([4., 0., 3.], dtype=float64)
    """
    _translation(state)
    return _velocity(body, state).linear


def position(state: AnyState) -> Float[Array, "*batch 3"]:
    """The position of the centre of mass of a body that translates, space frame, length, (..., 3).

    Args:
        state: as for `linear_momentum`. For coupled bodies the positions are (..., N, 3).

    Examples:
        >>> thrown = ml.FreeState([0.1, 3.0, 0.2], [1.0, 0.0, 0.0, 0.0], [12.0, 0.0, 9.0], position=[0.0, 0.0, 1.5])
        >>> ml.observe.position(thrown)
        Array([0. , 0. , 1.5], dtype=float64)
    """
    return _translation(state)[1]


def _translation(state: Any) -> tuple[Array, Array]:
    if not isinstance(state, State) or len(state.leaves) < 2:
        raise ValueError(f"a {type(state).__name__} does not translate; use a FreeState or a FreeAxisState.")
    linear, place = (getattr(state, field.name) for field in fields(state)[state.leaves[0].arrays :])
    return linear, place


def _velocity(body: Body, state: AnyState) -> Any:
    check_state("state", state)
    check_body(body, state)
    velocity: Any = type(body).velocity
    for _ in range(axes_of_bodies(body, state)):
        velocity = jax.vmap(velocity)
    return velocity(body, _momentum(state))


def _momentum(state: AnyState) -> Any:
    return cp.packed(state.parts()[0])


def axes_of_bodies(body: Body, state: AnyState) -> int:
    bodies = state.kind.batch_of(body)
    if not bodies:
        return 0
    states = state.batch
    if states and bodies != states[: len(bodies)]:
        raise ValueError(
            f"momentum must be (n, 3) or (n, ..., 3) for moments (n, 3), got {state.momentum.shape} for "
            f"{(*bodies, 3)}. Map other axes with jax.vmap."
        )
    return len(bodies) if states else 0
