"""What acts along a path: `forces_on`, and of coupled bodies `balanced`, whether the total angular momentum stays."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._math import components as cp
from ..model.states import TravellingState
from ..model.torques import on_body


def forces_on(body: Any, torque: Any, times: np.ndarray, states: Any) -> Any:
    """The torque on a body at each saved time, (n, 3), or torque and force of one that travels, as `Momenta`."""
    bound: Any = on_body(torque, body)

    def at(t: Any, state: Any) -> Any:
        return type(state).force_of(bound(t, state))

    return jax.jit(jax.vmap(at))(jnp.asarray(times, jnp.result_type(float)), states)


def add_up_to_zero(*vectors: Any) -> bool:
    """Whether vectors (n, N, 3) of N bodies add up to zero at all times, but for rounding."""
    total = np.linalg.norm(sum(np.sum(each, axis=-2) for each in vectors), axis=-1)
    sizes = sum(np.sum(np.linalg.norm(each, axis=-1), axis=-1) for each in vectors)
    return bool(np.all(total <= np.sqrt(jnp.finfo(jnp.result_type(float)).eps) * sizes))


def balanced(body: Any, torque: Any, times: np.ndarray, states: Any) -> bool:
    """Whether the torques on coupled bodies, about the origin, add up to zero at the saved times, (n,)."""
    if torque is None or not states.several:
        return False
    states = jax.tree.map(jnp.asarray, states)
    found, each = forces_on(body, torque, times, states), states.of_body(slice(None))
    travels = isinstance(states, TravellingState)
    turn = np.stack(each.to_space(cp.vector(found.angular if travels else found)), axis=-1)
    return add_up_to_zero(turn, np.cross(states.position, found.linear)) if travels else add_up_to_zero(turn)
