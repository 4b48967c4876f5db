"""What every flight is: a rule for motion under no torque."""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
from jax import Array

from ...model.bodies import Particles, RigidBody


class Flight(eqx.Module):
    """A free flight; calling one flies.

    Attributes:
        name: its name in method names.
        use: when to take it, for `midlie_jax.flights()`.
        order: its order of accuracy as a map; `None` when exact.
        symplectic: whether the map preserves the Lie-Poisson and symplectic structure to rounding.
        symmetric: whether a flight of time -h undoes one of h.
        body: the kind of body it moves.
        equal_moments: whether it moves only bodies with two equal moments.
        per_loop: how many of it the compiler takes in one loop; a step of more is cut after each. A larger loop XLA's
            CPU emitter cuts into functions that call each other, and so repeats the work many times over.
        one_loop: whether one flight compiles to a single loop over the batch; False where a solve is cut in parts.
    """

    name: ClassVar[str]
    use: ClassVar[str] = "see its docstring"
    order: ClassVar[int | None]
    symplectic: ClassVar[bool]
    symmetric: ClassVar[bool] = True
    body: ClassVar[type[RigidBody] | type[Particles]]
    equal_moments: ClassVar[bool] = False
    per_loop: ClassVar[int]
    one_loop: ClassVar[bool] = True

    def fitted(self, moments: Array) -> "Flight":
        """This flight made for bodies of these moments, (..., 3), all known; a ValueError if it cannot move them."""
        del moments
        return self

    def moves(self, moments: Array) -> bool:
        """Whether it moves a body of these moments, (3,)."""
        x, y, z = map(float, moments)
        return not self.equal_moments or x == y or y == z or z == x

    @abstractmethod
    def __call__(self, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
        """Flies for time h.

        Returns:
            The increment (for a rigid body a unit quaternion in the body frame), the change of the momentum, and a
            boolean: False where the result is not to be trusted.
        """
