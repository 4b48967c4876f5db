"""Checks that a body, a state and a torque are valid and fit each other, made before anything is traced.

Every function raises a ValueError that names the argument.
"""

from typing import Any

import equinox as eqx

from .._kernel.checks import described
from .bodies import RigidBody, principal_of
from .state import AnyState, State


def check_state(name: str, state: Any) -> None:
    """Raises unless the argument is a state whose arrays have the same leading axes."""
    if not isinstance(state, State):
        raise ValueError(f"{name} must be a state such as midlie_jax.RigidState, got {described(state)}.")
    state.check_batch()


def check_body(body: Any, state: AnyState) -> None:
    """Raises unless the body is of the kind that the state belongs to."""
    if not isinstance(principal_of(body), state.body):
        kind = state.body.__name__
        cure = "" if isinstance(body, eqx.Module) else f"; make one with midlie_jax.{kind}"
        raise ValueError(f"a {type(state).__name__} belongs to a {kind}, but body is {described(body)}{cure}.")


def check_torque(torque: Any) -> None:
    """Raises unless the torque is None or can be called."""
    if torque is not None and not callable(torque):
        raise ValueError(f"torque must be None or a callable of (t, state), got {described(torque)}.")


def check_batch(name: str, body: Any, state: AnyState, batch: int = 0) -> None:
    """Raises unless the state has `batch` leading axes, and the body at most as many; particles are not checked."""
    principal = principal_of(body)
    if not isinstance(principal, RigidBody):
        return
    moments = "body.moments" if principal is body else "body.principal.moments"
    for argument, array, min_axes in ((moments, principal.moments, 0), (f"{name}.momentum", state.momentum, batch)):
        if not min_axes <= array.ndim - 1 <= batch:
            wanted, cure = "(3,)", "map over a batch with jax.vmap, or use midlie_jax.ensemble"
            if batch:
                wanted, cure = "(n, 3)", "stack the states of the bodies, or use midlie_jax.integrate for one"
            raise ValueError(f"{argument} must be {wanted}, got {array.shape}; {cure}.")
