"""`Observable`: a quantity of one body at one time, from a function of (t, state) or several by name."""

from abc import abstractmethod
from collections.abc import Callable
from inspect import isfunction
from typing import Any

import equinox as eqx
from jax import Array

from ..._checks.arguments import described, require_function
from ...model import observables
from ...model.bodies import Body
from ...model.state import AnyState
from ...model.torques import TorqueLike
from ..energy import energy


class Observable(eqx.Module):
    """A quantity of one body at one time: the argument `observe` of a run, or the input of a statistic.

    Examples:
        >>> class Tilt(ml.observe.Observable):  # of your own: the angle between axis 3 and the vertical, ()
        ...     def of(self, t, state, body, torque):
        ...         return jnp.arccos(ml.so3.to_matrix(state.attitude)[2, 2])
        >>> round(float(Tilt().of(jnp.array(0.0), start, body, torque)), 6)  # in a run: as observe
        0.3
    """

    @abstractmethod
    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        """The value of the observable, an array or a pytree of arrays, for the state of one body at the time t."""


class Function(Observable):
    """A function of the time and the state of one body, pure and made of JAX operations; returns a pytree of arrays.

    Examples:
        >>> speed = ml.observe.Function(lambda t, state: jnp.linalg.norm(state.momentum))
        >>> speed.of(jnp.array(0.0), start, body, torque).item()  # a run also takes the plain function as observe
        50.0
    """

    function: Callable[[Any, Any], Any]

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return self.function(t, state)


class Together(Observable):
    """Several observables by name, each in any form that `observe` of a run accepts; the value is a dict of values.

    Examples:
        >>> both = ml.observe.Together({"energy": ml.observe.energy, "axis": ml.observe.Axis()})
        >>> found = both.of(jnp.array(0.0), start, body, None)  # as observe of a run, or the dict alone
        >>> round(float(found["energy"]), 6), found["axis"].shape
        (1250.0, (3,))
    """

    parts: dict[str, Observable] = eqx.field(
        converter=lambda parts: {name: as_observable(f"observe[{name!r}]", part) for name, part in parts.items()}
    )

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return {name: part.of(t, state, body, torque) for name, part in self.parts.items()}


def _of_state(function: Any) -> Any:
    return lambda t, state, body, torque: function(state)


def _of_body(function: Any) -> Any:
    return lambda t, state, body, torque: function(body, state)


QUANTITIES: dict[Any, Callable[[Any, Any, Any, Any], Any]] = {
    energy: lambda t, state, body, torque: observables.energy(body, torque, state, t),
    observables.kinetic_energy: _of_body(observables.kinetic_energy),
    observables.angular_velocity: _of_body(observables.angular_velocity),
    observables.spatial_angular_velocity: _of_body(observables.spatial_angular_velocity),
    observables.linear_velocity: _of_body(observables.linear_velocity),
    observables.spatial_momentum: _of_state(observables.spatial_momentum),
    observables.linear_momentum: _of_state(observables.linear_momentum),
    observables.position: _of_state(observables.position),
}
"""The functions of a state that a run accepts as `observe`, each as a function of (t, state, body, torque)."""


class Quantity(Observable):
    """A function in `QUANTITIES`, such as `midlie_jax.observe.energy`, for the body and the torque of the run."""

    function: Callable[..., Any] = eqx.field(static=True)

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return QUANTITIES[self.function](t, state, body, torque)

    def __repr__(self) -> str:
        return self.function.__name__


def as_observable(name: str, value: Any) -> Observable:
    """The argument `name` as an observable: an observable, a function of (t, state), or a dict of both.

    Raises:
        ValueError: it is none of these.

    Examples:
        >>> isinstance(ml.observe.as_observable("observe", lambda t, state: state.momentum[2]), ml.observe.Function)
        True
    """
    if isinstance(value, Observable):
        return value
    if isfunction(value) and value in QUANTITIES:
        return Quantity(value)
    if isinstance(value, dict) and value and all(isinstance(key, str) for key in value):
        return Together({key: as_observable(f"{name}[{key!r}]", part) for key, part in value.items()})
    if callable(value) and not isinstance(value, type):
        require_function(name, value, "t, state")
        return Function(value)
    raise ValueError(
        f"{name} must be a function of (t, state), an observable such as midlie_jax.observe.energy, or a dict of "
        f"these by name, got {described(value)}."
    )
