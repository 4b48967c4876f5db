"""`Flight`, the base class of all flights: maps for the torque-free motion of a body; and the flight of particles."""

import math
from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..._math import components as cp
from ...model.bodies import Body, Particles, RigidBody
from ..verdict import as_verdict, is_fine


class Flight(eqx.Module):
    """The torque-free motion of a body, as a callable.

    Attributes:
        name: the part before the bracket of a method's name.
        use: when to use the flight, for `midlie_jax.flights.names()`.
        order: order of accuracy; `None` if the flight is exact.
        symplectic: whether the map preserves the Lie-Poisson and symplectic structure to rounding.
        symmetric: whether a flight of time -h undoes a flight of time h.
        body: the class of body that the flight moves.
        also: further classes of body, for which `fitted` returns another flight.
        equal_moments: whether the flight moves only bodies with two equal moments.
        solves: the number of equations that a flight solves by iteration.
        per_loop: the number of flights that fit one compiled loop; in a step with more flights, a loop ends after each
            flight, because XLA's CPU emitter would repeat the work of a larger loop many times.
        per_kernel: the number of flights, each with a kick, in one GPU kernel (counted by `benchmarks/kernels.py`).
        long_derivative: whether the reverse derivative of a flight is so long that it needs its own loop.
        reach: the largest angle of a flight, time times `turn_rate`, in radians; `ok` is False beyond it.

    Examples:
        >>> cp, half_turn = ml.flights.components, ml.flights.short_series.half_turn
        >>> class Frozen(ml.flights.Flight):  # custom, of order 1: it rotates with the initial angular velocity
        ...     name, order, symplectic, symmetric, body = "FROZEN", 1, False, False, ml.RigidBody
        ...     def __call__(self, inertia, h, momentum):
        ...         turn = cp.square(half_turn(cp.scale(h / 2, inertia.velocity(momentum))))
        ...         return turn, cp.rotation_change(cp.conjugate(turn), momentum), True
        >>> ml.method(Frozen(), "EA").name  # a method for ml.integrate
        'FROZEN[EA]'
    """

    name: ClassVar[str]
    use: ClassVar[str] = "see its docstring"
    order: ClassVar[int | None]
    symplectic: ClassVar[bool]
    symmetric: ClassVar[bool] = True
    body: ClassVar[type[Body]]
    also: ClassVar[tuple[type[Body], ...]] = ()
    equal_moments: ClassVar[bool] = False
    solves: ClassVar[int] = 0
    per_loop: ClassVar[int]
    per_kernel: ClassVar[int] = 1
    long_derivative: ClassVar[bool] = True
    reach: ClassVar[float] = math.inf

    def fitted(self, body: Body) -> "Flight":
        """This flight specialised to a body in its principal axes, or to a batch of bodies.

        Raises:
            ValueError: the numbers of the body are concrete, and the flight does not support this body.
        """
        return self

    @property
    def bodies(self) -> tuple[type[Body], ...]:
        """All classes of body that the flight supports; any of these may also translate (`FreeBody`)."""
        return (self.body, *self.also)

    def moves(self, moments: Array) -> bool:
        """Whether the flight supports a body with these moments, (3,)."""
        x, y, z = map(float, moments)
        return not self.equal_moments or x == y or y == z or z == x

    @abstractmethod
    def __call__(self, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
        """The flight for the time h.

        Returns:
            The increment (for a rigid body a unit quaternion in the body frame), the change of the momentum, and `ok`,
            a boolean that is False where the result is invalid.
        """

    def judged(self, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array]:
        """The flight with a verdict, which also gives the reason of a failure, in place of `ok`: see `verdict.py`."""
        increment, change, ok = self(inertia, h, momentum)
        return increment, change, as_verdict(ok)

    def turn_rate(self, inertia: Any, momentum: Any) -> Array:
        """The angle per unit of time to which `reach` refers: by default the angular speed |Omega| of a rigid body."""
        return cp.root(inertia.square_of_turn(1.0, momentum))

    def momentum_change(self, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Array | bool]:
        """The change of the momentum and `ok` of a state without a pose (`MomentumState`), which needs no increment.

        A flight that can compute the change faster without the increment overrides this method. The change, its
        derivatives and `ok` must agree with the whole flight to rounding.
        """
        _, change, ok = self(inertia, h, momentum)
        return change, ok


class JudgedFlight(Flight):
    """A flight that defines `judged`, which gives the reason of a failure; by default symplectic, of a rigid body."""

    symplectic: ClassVar[bool] = True
    body: ClassVar[type[Body]] = RigidBody

    @abstractmethod
    def judged(self, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array]: ...

    def __call__(self, inertia: Any, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
        increment, change, verdict = self.judged(inertia, h, momentum)
        return increment, change, is_fine(verdict)


class Linear(Flight):
    """u += h M^-1 p, the exact force-free motion of particles. The momentum is constant.

    Examples:
        >>> masses = ml.Particles([1.0, 2.0])
        >>> displacement, change, ok = ml.flights.Linear()(masses.inertia(), jnp.array(0.5), jnp.array([3.0, 4.0]))
        >>> displacement
        Array([1.5, 1. ], dtype=float64)
    """

    name: ClassVar[str] = "linear"
    use: ClassVar[str] = "particles: exact"
    order: ClassVar[int | None] = None
    symplectic: ClassVar[bool] = True
    body: ClassVar[type] = Particles
    per_loop: ClassVar[int] = 64
    per_kernel: ClassVar[int] = 8

    def __call__(self, inertia: Particles, h: Array, momentum: Any) -> tuple[Any, Any, Array | bool]:
        return h * inertia.velocity(momentum), jnp.zeros_like(momentum), True
