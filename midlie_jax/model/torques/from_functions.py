"""Torques from a function: of time alone, of a potential energy, or of a function that reads the momentum."""

from collections.abc import Callable
from typing import Any

from jax import Array

from ..._checks.arguments import require_function
from ..._math import components as cp
from ..state import Time
from .base import Torque, TorqueLike, on_body


class Prescribed(Torque):
    """A body-frame torque that is a function of time alone.

    The function must be continuous. A method evaluates it at instants, so a jump within a step silently makes the
    impulse wrong by about half the jump times the step. A pulse shorter than a step is counted several times, or not at
    all. `midlie_jax.check` finds such jumps. For pulses use `Pulses`, and for controls that are constant in intervals
    `Held`; both are exact. Otherwise let a step end at each jump, and return the mean of both sides at that time:
    methods of second order then keep their order.

    Attributes:
        function: `function(t) -> (3,)`; make it a pytree if you differentiate with respect to its parameters.

    Raises:
        ValueError: the function cannot be called.

    Examples:
        >>> thruster = ml.torques.Prescribed(lambda t: jnp.array([0.0, 0.0, 0.25 * t]))
        >>> state = ml.RigidState([1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> thruster(2.0, state)
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
        function: `function(t, state) -> ()`, the potential energy; differentiable with respect to the pose of the
            state. It may use arrays, for example with `midlie_jax.so3.to_matrix`.

    Raises:
        ValueError: the function cannot be called.

    Examples:
        >>> torque = ml.torques.FromPotential(lambda t, state: -5.0 * ml.so3.to_matrix(state.attitude)[2, 2])
        >>> tilted = ml.RigidState([0.0, 0.0, 0.0], ml.so3.exp(jnp.array([0.1, 0.0, 0.0])))
        >>> round(float(torque(0.0, tilted)[0]), 6)  # back to the vertical: -5 sin(0.1)
        -0.499167
        >>> round(float(torque.potential(0.0, tilted)), 6)
        -4.975021
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

    The kicks of the explicit methods then evaluate the torque twice (the explicit midpoint rule in the momentum), so
    LIEMID[EA] keeps order 2. With such torques methods are neither symplectic nor exactly reversible. A run detects
    automatically whether a torque reads the momentum. `LieSolver.order` does not trace the torque and relies on this
    declaration.

    Attributes:
        function: `function(t, state) -> (3,)`, body frame.

    Raises:
        ValueError: the function cannot be called.

    Examples:
        >>> drag = ml.torques.VelocityDependent(lambda t, state: -0.5 * jnp.abs(state.momentum) * state.momentum)
        >>> state = ml.RigidState([1.0, 2.0, 4.0], [1.0, 0.0, 0.0, 0.0])
        >>> drag(0.0, state)
        Array([-0.5, -2. , -8. ], dtype=float64)
        >>> drag.velocity_dependent
        True
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
