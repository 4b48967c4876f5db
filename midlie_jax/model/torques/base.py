"""The interface of a torque, and sums of torques, as pytrees of their parameters."""

import operator
from collections.abc import Callable
from functools import reduce
from typing import Any, overload

import equinox as eqx
import jax
from jax import Array

from ..._checks.arguments import shown
from ..._checks.brief_help import BriefHelp
from ..._math import components as cp
from ..free_body import Wrench
from ..state import Time

TorqueLike = Callable[[Any, Any], Any]  # of (t, state) -> (3,), or of the form of the momentum


class Torque(eqx.Module, metaclass=BriefHelp):
    """Base class of torques; subclasses define the torque, and whether it has a potential or reads momentum or body.

    Raises:
        ValueError: for every torque: arguments that are not of the described shape and range, or functions that cannot
            be called. When called: the state lacks what the torque reads.

    Examples:
        >>> class Spring(ml.torques.Torque):  # custom: back to the attitude (1, 0, 0, 0)
        ...     stiffness: float
        ...     def __call__(self, t, state):
        ...         return -self.stiffness * ml.so3.log(state.attitude)
        ...     def potential(self, t, state):  # for ml.observe.energy
        ...         return self.stiffness * jnp.sum(ml.so3.log(state.attitude) ** 2) / 2
        >>> turned = ml.RigidState([0.0, 0.0, 0.0], ml.so3.exp(jnp.array([0.1, 0.2, 0.3])))
        >>> Spring(10.0)(0.0, turned).round(6)
        Array([-1., -2., -3.], dtype=float64)
    """

    def __call__(self, t: Time, state: Any) -> Any:
        """The torque (3,), body frame, on one body at a time (); or a `Wrench` for a body that translates."""
        raise NotImplementedError(f"{type(self).__name__} must define __call__(t, state).")

    def potential(self, t: Time, state: Any) -> Array:
        """The potential energy (), torque x angle; a ValueError if the torque has no potential."""
        raise no_potential(self)

    def fixed_axis(self, state: Any) -> cp.Vector | None:
        """A space-fixed direction about which the torque has no component, in body components; None if unknown."""
        return None

    @property
    def velocity_dependent(self) -> bool:
        """Whether the torque is declared to read the momentum."""
        return False

    @property
    def gravitational(self) -> bool:
        """Whether the force is gravity, which an accelerometer does not measure."""
        return False

    @property
    def keeps_total_momentum(self) -> bool:
        """Whether the torque is known to conserve the total angular momentum about the origin."""
        return False

    def tide(self, t: Time, state: Any, place: cp.Vector) -> cp.Vector | None:
        """The gravity at a position in the body minus the gravity at the centre of mass, body frame; None if zero."""
        return None

    def without_gravity(self) -> TorqueLike | None:
        """The torque without its gravity terms, or None if none is left."""
        return None if self.gravitational else self

    def check(self, state: Any) -> None:
        """Raises a ValueError if the torque, by its numbers, cannot act on this kind of state."""

    def on(self, body: Any) -> "Torque":
        """The torque bound to a body: an `OnBody` if the torque reads the body, otherwise the torque itself."""
        return self

    def __add__(self, other: TorqueLike | None) -> "Sum":
        return Sum(self, other)

    def __radd__(self, other: TorqueLike | int) -> "Torque":
        """The sum of a function and this torque; 0, the start value of Python's `sum`, counts as no torque."""
        if isinstance(other, int):
            if isinstance(other, bool) or other:
                raise _no_torque(other)
            return self
        return Sum(other, self)


def no_potential(torque: Torque) -> ValueError:
    return ValueError(f"{type(torque).__name__} has no potential energy; use midlie_jax.observe.kinetic_energy.")


def velocity_dependent(torque: TorqueLike | None) -> bool:
    """Whether the torque is declared to read the momentum, such as `VelocityDependent` and sums that contain it.

    Examples:
        >>> ml.torques.velocity_dependent(ml.torques.HeavyTop(2.0) + ml.torques.Damping(0.25))
        True
    """
    return isinstance(torque, Torque) and torque.velocity_dependent


@overload
def on_body(torque: TorqueLike, body: Any) -> TorqueLike: ...
@overload
def on_body(torque: None, body: Any) -> None: ...
def on_body(torque: TorqueLike | None, body: Any) -> TorqueLike | None:
    """The torque bound to a body: `torque.on(body)`, or the argument itself if it is None or a plain callable.

    Examples:
        >>> ml.torques.on_body(ml.torques.Damping(0.5), body)(0.0, start)  # -0.5 * Omega
        Array([ -0.,  -0., -25.], dtype=float64)
    """
    return torque.on(body) if isinstance(torque, Torque) else torque


def potential_of(torque: TorqueLike) -> Callable[[Any, Any], Array]:
    """The potential `V(t, state) -> ()` of a torque; a ValueError for a plain callable, which has none.

    Examples:
        >>> ml.torques.potential_of(torque)(0.0, start).round(4)
        Array(19.1067, dtype=float64)
    """
    if isinstance(torque, Torque):
        return torque.potential
    raise ValueError("a plain callable has no potential energy; write midlie_jax.torques.FromPotential(potential).")


class Sum(Torque):
    """The sum of several torques, also written `first + second`.

    Attributes:
        terms: the torques, each a callable of (t, state); None among the arguments is ignored.

    Examples:
        >>> torque = ml.torques.HeavyTop(2.0) + ml.torques.Damping(0.25)
        >>> [type(term).__name__ for term in torque.terms]
        ['HeavyTop', 'Damping']
    """

    terms: tuple[TorqueLike, ...]

    def __init__(self, *terms: TorqueLike | None):
        self.terms = tuple(term for term in terms if term is not None)
        if not self.terms:
            raise ValueError("a sum of torques needs at least one; pass a torque that is not None.")
        for term in self.terms:
            if not callable(term):
                raise _no_torque(term)

    def __call__(self, t: Time, state: Any) -> Any:
        return reduce(_sum, [term(t, state) for term in self.terms])

    def potential(self, t: Time, state: Any) -> Array:
        return reduce(operator.add, [potential_of(term)(t, state) for term in self.terms])

    @property
    def velocity_dependent(self) -> bool:
        return any(velocity_dependent(term) for term in self.terms)

    @property
    def gravitational(self) -> bool:
        return all(isinstance(term, Torque) and term.gravitational for term in self.terms)

    def without_gravity(self) -> TorqueLike | None:
        return _with_terms(self, [without_gravity(term) for term in self.terms])

    def check(self, state: Any) -> None:
        for term in self.terms:
            if isinstance(term, Torque):
                term.check(state)

    def on(self, body: Any) -> Torque:
        return Sum(*(on_body(term, body) for term in self.terms))


def _no_torque(term: Any) -> ValueError:
    from ..baths.base import HeatBath  # which needs this module

    if isinstance(term, HeatBath):
        name = type(term).__name__
        return ValueError(f"a torque must be a function of (t, state), got a {name}; pass bath={name}(...) to the run.")
    return ValueError(
        f"a torque must be a function of (t, state), got {shown(term)} in a sum; for a constant "
        "torque use midlie_jax.torques.Prescribed(lambda t: jnp.array([x, y, z]))."
    )


def _sum(a: Any, b: Any) -> Any:
    wrenches = isinstance(a, Wrench) or isinstance(b, Wrench)
    return Wrench.of(a) + Wrench.of(b) if wrenches else jax.tree.map(operator.add, a, b)


def kept_terms(torque: TorqueLike | None, kept: Callable[[TorqueLike], bool]) -> TorqueLike | None:
    """The torque with only the terms for which `kept` is true; None if none is left.

    Examples:
        >>> torque = ml.torques.HeavyTop(2.0) + ml.torques.Damping(0.25)
        >>> type(ml.torques.kept_terms(torque, ml.torques.velocity_dependent).terms[0]).__name__
        'Damping'
    """
    if isinstance(torque, Sum):
        return _with_terms(torque, [kept_terms(term, kept) for term in torque.terms])
    return None if torque is None or not kept(torque) else torque


def _with_terms(torque: Sum, terms: list[TorqueLike | None]) -> TorqueLike | None:
    if all(new is old for new, old in zip(terms, torque.terms, strict=True)):
        return torque
    return Sum(*terms) if any(term is not None for term in terms) else None


def terms_of(torque: TorqueLike | None) -> list[TorqueLike]:
    """The terms of a sum, at any depth; empty for None.

    Examples:
        >>> torque = ml.torques.HeavyTop(2.0) + (ml.torques.HeavyTop(1.0) + ml.torques.Damping(0.25))
        >>> len(ml.torques.terms_of(torque))
        3
    """
    if torque is None:
        return []
    return [x for term in torque.terms for x in terms_of(term)] if isinstance(torque, Sum) else [torque]


def without_gravity(torque: TorqueLike | None) -> TorqueLike | None:
    """The torque without its gravity terms, also within `OnEach`; None if no other term is left.

    Examples:
        >>> torque = ml.torques.UniformGravity([0.0, 0.0, -9.81]) + ml.torques.Magnus(1e-3)
        >>> type(ml.torques.without_gravity(torque).terms[0]).__name__
        'Magnus'
    """
    return torque.without_gravity() if isinstance(torque, Torque) else torque
