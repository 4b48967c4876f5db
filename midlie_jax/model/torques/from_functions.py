"""Torques from a function of time, of a potential energy or of the momentum; and `OnEach`, for coupled bodies."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from ..._checks.arguments import require_function
from ..._math import components as cp
from ..state import Time
from .base import Torque, TorqueLike, on_body, potential_of, velocity_dependent, without_gravity
from .reads_body import ReadsBody


class Prescribed(Torque):
    """A body-frame torque that is a function of time alone.

    The function must be continuous: a method evaluates it at instants, so a jump within a step makes the impulse wrong.
    `midlie_jax.check` finds such jumps. Use `Pulses` and `Held` for torques that jump; both are exact.

    Attributes:
        function: `function(t) -> (3,)`; make it a pytree if you differentiate with respect to its parameters.

    Examples:
        >>> ml.torques.Prescribed(lambda t: jnp.array([0.0, 0.0, 0.25 * t]))(2.0, start)
        Array([0. , 0. , 0.5], dtype=float64)
    """

    function: Callable[[Any], Array]

    def __check_init__(self) -> None:
        require_function("function", self.function, "t")

    def __call__(self, t: Time, state: Any) -> Array:
        return self.function(t)


class FromPotential(Torque):
    """The torque, or the force on particles, of a potential energy, by automatic differentiation.

    Attributes:
        function: `function(t, state) -> ()`, the potential energy, differentiable with respect to the pose.

    Examples:
        >>> torque = ml.torques.FromPotential(lambda t, state: -5.0 * ml.so3.to_matrix(state.attitude)[2, 2])
        >>> tilted = ml.RigidState([0.0, 0.0, 0.0], ml.so3.exp(jnp.array([0.1, 0.0, 0.0])))
        >>> round(float(torque(0.0, tilted)[0]), 6)  # back to the vertical: -5 sin(0.1)
        -0.499167
    """

    function: Callable[[Any, Any], Array]

    def __check_init__(self) -> None:
        require_function("function", self.function, "t, state")

    def __call__(self, t: Time, state: Any) -> Any:
        return state.kind.force_from(lambda state: self.function(t, state), state)

    def potential(self, t: Time, state: Any) -> Array:
        return self.function(t, state)

    def fixed_axis(self, state: Any) -> cp.Vector | None:
        """The direction of a `DirectionState`, because the potential depends on nothing else."""
        return cp.vector(state.direction) if hasattr(state, "direction") else None


class VelocityDependent(Torque):
    """A torque that is declared to read the momentum: damping, control, a magnetic field on a moving charge.

    The kicks of the explicit methods then evaluate the torque twice, so LIEMID[EA] keeps order 2. A run detects
    automatically whether a torque reads the momentum. `LieSolver.order` does not, and relies on this declaration.

    Attributes:
        function: `function(t, state) -> (3,)`, body frame.

    Examples:
        >>> ml.torques.VelocityDependent(lambda t, state: -0.5 * state.momentum)(0.0, start)
        Array([ -0.,  -0., -25.], dtype=float64)
    """

    function: TorqueLike

    def __check_init__(self) -> None:
        require_function("function", self.function, "t, state")

    def __call__(self, t: Time, state: Any) -> Any:
        return self.function(t, state)

    @property
    def velocity_dependent(self) -> bool:
        return True

    def on(self, body: Any) -> Torque:
        return VelocityDependent(on_body(self.function, body))


class OnEach(ReadsBody):
    """A one-body torque applied to each of several coupled bodies: their weight, a field, drag.

    Attributes:
        torque: a callable of (t, state) with the state of one body. All bodies share its parameters.

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
            raise ValueError(f"OnEach is for coupled bodies, got a {type(state).__name__}; leave OnEach out.")

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
