"""`Observable`, a quantity of one body at one time; any function of (t, state), and several by name."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
from jax import Array

from ..._checks.arguments import described
from ...model.bodies import Body
from ...model.state import AnyState
from ...model.torques import TorqueLike


class Observable(eqx.Module):
    """A quantity of one body at one time."""

    @abstractmethod
    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        """The value of the observable, an array or a pytree of arrays, for the state of one body at the time t."""


class Function(Observable):
    """A function of the time and the state of one body, `function(t, state)`; returns an array or a pytree of them."""

    function: Callable[[Any, Any], Any]

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return self.function(t, state)


class Together(Observable):
    """Several observables by name."""

    parts: dict[str, Observable]

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return {name: part.of(t, state, body, torque) for name, part in self.parts.items()}


def as_observable(name: str, value: Any) -> Observable:
    """The argument as an observable: an observable, a function of (t, state), or a dict of both."""
    if isinstance(value, Observable):
        return value
    if isinstance(value, dict) and value and all(isinstance(key, str) for key in value):
        return Together({key: as_observable(f"{name}[{key!r}]", part) for key, part in value.items()})
    if callable(value) and not isinstance(value, type):
        return Function(value)
    raise ValueError(
        f"{name} must be a function of (t, state), an observable such as midlie_jax.observe.Energy(), or a dict of "
        f"these by name, got {described(value)}."
    )
