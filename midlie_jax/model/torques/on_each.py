"""`OnEach`: a one-body torque applied to each of several coupled bodies."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from ..._checks.arguments import require_function
from ..state import Time
from .base import TorqueLike, on_body, potential_of, velocity_dependent, without_gravity
from .reads_body import ReadsBody


class OnEach(ReadsBody):
    """A one-body torque applied to each of several coupled bodies: their weight, a field, drag.

    Attributes:
        torque: a callable of (t, state) with the state of one body, such as `UniformGravity`. All bodies share its
            parameters.

    Raises:
        ValueError: the torque cannot be called. When called: the state does not hold coupled bodies.

    Examples:
        >>> weight = ml.torques.OnEach(ml.torques.UniformGravity([0.0, 0.0, -10.0]))
        >>> pair = ml.FreeBody(ml.RigidBody([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]), mass=[3.0, 5.0])
        >>> still, upright = jnp.zeros((2, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1))
        >>> state = ml.CoupledState(still, upright, linear=still, position=[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
        >>> weight.on(pair)(0.0, state).force[:, 2]
        Array([-30., -50.], dtype=float64)
    """

    torque: TorqueLike

    def __check_init__(self) -> None:
        require_function("torque", self.torque, "t, state")

    def at(self, t: Time, state: Any, body: Any) -> Any:
        return self._each(lambda torque, state: torque(t, state), state, body)

    def potential_at(self, t: Time, state: Any, body: Any) -> Array:
        return jnp.sum(self._each(lambda torque, state: potential_of(torque)(t, state), state, body))

    def _each(self, function: Any, state: Any, body: Any) -> Any:
        if not state.several:
            raise ValueError(
                f"OnEach is for coupled bodies, such as a CoupledState, got a {type(state).__name__}; leave OnEach out."
            )

        def of_one(state: Any, body: Any) -> Any:
            return function(on_body(self.torque, body), state)

        own = 0 if body.batch else None
        return jax.vmap(of_one, in_axes=(0, own))(state.of_body(slice(None)), body)

    @property
    def velocity_dependent(self) -> bool:
        return velocity_dependent(self.torque)

    @property
    def gravitational(self) -> bool:
        return getattr(self.torque, "gravitational", False)

    def without_gravity(self) -> TorqueLike | None:
        rest = without_gravity(self.torque)
        return self if rest is self.torque else None if rest is None else OnEach(rest)
