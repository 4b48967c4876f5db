"""`Light`: the base class of `Brightness` and `EllipsoidBrightness`."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import require_function
from .._math import components as cp
from ..drivers.observe.observables import Observable
from ..model.bodies import Body
from ..model.facets import as_direction, seen_from_body
from ..model.state import AnyState, Time
from ..model.torques import TorqueLike


class Light(Observable):
    """Sunlight that a body sends to an observer; also callable as `light(t, state)`."""

    sun: Float[Array, "*batch 3"] | Callable[[Any], Array]
    observer: Float[Array, "*batch 3"] | Callable[[Any], Array]
    phase: Callable[[Array], Array] | None
    magnitude: bool = eqx.field(static=True)

    def _view(self, sun: Any, observer: Any, phase: Any, magnitude: bool) -> None:
        self.sun, self.observer = as_direction("sun", sun), as_direction("observer", observer)
        if phase is not None:
            require_function("phase", phase, "angle")
        self.phase, self.magnitude = phase, magnitude

    @abstractmethod
    def intensity(self, sun: cp.Vector, observer: cp.Vector) -> Array:
        """The intensity () for directions in the frame of the body, without the factor `phase`."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return self(t, state)

    def __call__(self, t: Time, state: AnyState) -> Float[Array, ""]:
        """The intensity or magnitude (), of one state."""
        if state.several:
            raise ValueError(
                f"{type(self).__name__} must have the state of one body, got a {type(state).__name__}; for body i "
                "write lambda t, state: brightness(t, state.of_body(i))."
            )
        directions = ("sun", self.sun), ("observer", self.observer)
        sun, observer = (seen_from_body(name, direction, t, state) for name, direction in directions)
        total = self.intensity(sun, observer)
        if self.phase is not None:
            total = total * self.phase(jnp.arctan2(cp.norm(cp.cross(sun, observer)), cp.dot(sun, observer)))
        return -2.5 * jnp.log10(total) if self.magnitude else total
