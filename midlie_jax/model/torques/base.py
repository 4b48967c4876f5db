"""What a torque is, and the torques that are made of functions or of other torques.

The classes are pytrees whose leaves are their parameters, so they can be mapped over and differentiated; most know
their potential, which is what `midlie_jax.energy` adds to the kinetic energy. `a + b` acts together. Forces on
particles are callables of the same kind, returning an array of the shape of the momentum.
"""

from collections.abc import Callable
from typing import Any, overload

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ..._kernel import components as cp
from ..._kernel.checks import require_function
from ..bodies import RigidBody, TensorBody

TorqueLike = Callable[[Any, Any], Array]


class Torque(eqx.Module):
    """A torque field; subclasses say whether it has a potential, reads the momentum, or reads the body."""

    def __call__(self, t: Any, state: Any) -> Array:
        raise NotImplementedError(f"{type(self).__name__} must define __call__(t, state).")

    def potential(self, t: Any, state: Any) -> Array:
        """The potential energy, torque x angle; a ValueError where there is none."""
        del t, state
        raise _no_potential(self)

    @property
    def velocity_dependent(self) -> bool:
        return False

    def on(self, body: Any) -> "Torque":
        """This torque as it acts on a body; itself, unless it reads the body."""
        del body
        return self

    def __add__(self, other: TorqueLike | None) -> "Sum":
        return Sum(self, other)

    def __radd__(self, other: TorqueLike | int) -> "Torque":
        """A function plus this; or 0, with which Python's `sum` begins."""
        return self if isinstance(other, int) else Sum(other, self)


def _no_potential(torque: Torque) -> ValueError:
    return ValueError(f"{type(torque).__name__} has no potential energy; use midlie_jax.kinetic_energy instead.")


def velocity_dependent(torque: TorqueLike | None) -> bool:
    """Whether the torque was declared to read the momentum (`VelocityDependent`, or a sum holding one)."""
    return isinstance(torque, Torque) and torque.velocity_dependent


@overload
def on_body(torque: TorqueLike, body: Any) -> TorqueLike: ...
@overload
def on_body(torque: None, body: Any) -> None: ...
def on_body(torque: TorqueLike | None, body: Any) -> TorqueLike | None:
    """A torque, or None, as it acts on a body."""
    return torque.on(body) if isinstance(torque, Torque) else torque


def potential_of(torque: TorqueLike) -> Callable[[Any, Any], Array]:
    """The potential `V(t, state) -> ()` of a torque; a ValueError for a plain callable, which has none."""
    if isinstance(torque, Torque):
        return torque.potential
    raise ValueError(
        "a plain callable has no potential energy; give the potential to midlie_jax.torques.FromPotential, "
        "or use midlie_jax.kinetic_energy."
    )


class Sum(Torque):
    """Several torques acting together.

    Attributes:
        terms: the torques, each a callable of (t, state); None counts as no torque.
    """

    terms: tuple[TorqueLike, ...]

    def __init__(self, *terms: TorqueLike | None):
        self.terms = tuple(term for term in terms if term is not None)
        if not self.terms:
            raise ValueError("a sum of torques needs one at least; None is no torque.")
        for term in self.terms:
            require_function("a torque", term, "t, state")

    def __call__(self, t: Any, state: Any) -> Array:
        return sum((term(t, state) for term in self.terms[1:]), start=self.terms[0](t, state))

    def potential(self, t: Any, state: Any) -> Array:
        parts = [potential_of(term)(t, state) for term in self.terms]
        return sum(parts[1:], start=parts[0])

    @property
    def velocity_dependent(self) -> bool:
        return any(velocity_dependent(term) for term in self.terms)

    def on(self, body: Any) -> Torque:
        return Sum(*(on_body(term, body) for term in self.terms))


class Prescribed(Torque):
    """A body-frame torque given as a function of time alone.

    At a jump return the mean of both sides and let steps end there: second order is then kept.

    Attributes:
        function: `function(t) -> (3,)`; a pytree if it has parameters to differentiate.
    """

    function: Callable[[Any], Array]

    def __check_init__(self) -> None:
        require_function("function", self.function, "t")

    def __call__(self, t: Any, state: Any) -> Array:
        del state
        return self.function(t)


class FromPotential(Torque):
    """The torque, or the force on particles, of a potential energy, by automatic differentiation.

    Attributes:
        function: `function(t, state) -> ()`, the potential energy; differentiable in the state's pose.
            It may be written on arrays (`midlie_jax.so3.to_matrix` and so on).
    """

    function: Callable[[Any, Any], Array]

    def __check_init__(self) -> None:
        require_function("function", self.function, "t, state")

    def __call__(self, t: Any, state: Any) -> Array:
        kind = type(state)
        momentum, pose = state.parts()
        slope = jax.grad(lambda p: self.function(t, kind.join(momentum, p)))(pose)
        # dV/dt = slope . rate(pose, velocity) = -torque . velocity, and the rate is linear in velocity.
        (along,) = jax.linear_transpose(lambda velocity: kind.rate(pose, velocity), momentum)(slope)
        return jax.tree.map(jnp.negative, along) if isinstance(along, jax.Array) else -cp.pack(along)

    def potential(self, t: Any, state: Any) -> Array:
        return self.function(t, state)


class VelocityDependent(Torque):
    """A torque that reads the momentum: damping, control, a magnetic field on a moving charge.

    The kicks of the explicit methods then take two evaluations (the explicit midpoint rule in the momentum),
    which keeps order 2 for LIEMID[EA]; symplecticity and exact reversal do not apply to such torques. A run sees for
    itself whether a torque reads the momentum; this says so where there is no run to see it, as in
    `LieSolver.order` and `recommend`.

    Attributes:
        function: `function(t, state) -> (3,)`, body frame.
    """

    function: TorqueLike

    def __check_init__(self) -> None:
        require_function("function", self.function, "t, state")

    def __call__(self, t: Any, state: Any) -> Array:
        return self.function(t, state)

    @property
    def velocity_dependent(self) -> bool:
        return True

    def on(self, body: Any) -> Torque:
        return VelocityDependent(on_body(self.function, body))


class ReadsBody(Torque):
    """A torque that reads the body on which it acts; a run tells it which (`on`)."""

    def at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        """The torque (3,), body frame, on a body."""
        raise NotImplementedError(f"{type(self).__name__} must define at(t, state, body).")

    def potential_at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        """The potential energy; a ValueError where there is none."""
        del t, state, body
        raise _no_potential(self)

    def on(self, body: Any) -> Torque:
        return OnBody(self, body)

    def __call__(self, t: Any, state: Any) -> Array:
        raise ValueError(f"{type(self).__name__} reads the body: call torque.on(body)(t, state).")

    def potential(self, t: Any, state: Any) -> Array:
        raise ValueError(f"{type(self).__name__} reads the body: call torque.on(body).potential(t, state).")


class OnBody(Torque):
    """A torque that reads the body, and the body.

    Attributes:
        torque: a `ReadsBody`.
        body: as given to `integrate`.
    """

    torque: ReadsBody
    body: RigidBody | TensorBody

    def __call__(self, t: Any, state: Any) -> Array:
        return self.torque.at(t, state, self.body)

    def potential(self, t: Any, state: Any) -> Array:
        return self.torque.potential_at(t, state, self.body)

    @property
    def velocity_dependent(self) -> bool:
        return self.torque.velocity_dependent


class BodyTorque(ReadsBody):
    """A torque as a function of the body as well: of its inertia, or its angular velocity.

    Attributes:
        function: `function(t, state, body) -> (3,)`, body frame; the body is the one given to `integrate`, and
            `body.velocity(state.momentum)` its angular velocity.
    """

    function: Callable[[Any, Any, Any], Array]

    def __check_init__(self) -> None:
        require_function("function", self.function, "t, state, body")

    def at(self, t: Any, state: Any, body: RigidBody | TensorBody) -> Array:
        return self.function(t, state, body)
