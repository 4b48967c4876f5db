"""`OfBody`: a measurement of one of several coupled bodies."""

# What are fields of other measurements are read from the one within.
# pyright: reportIncompatibleVariableOverride=false

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from .._checks.arguments import described
from .measurements import Accelerations, Measurement, Source


class OfBody(Measurement):
    """A measurement of one of the bodies of a `CoupledState`: of the attitude of a moon, for example.

    Args:
        body: the index of the body, from 0.
        measurement: such as `Attitudes` or `Rates`.

    Raises:
        ValueError: the index is not a whole number from 0 on; the measurement is none of one body, or `Accelerations`,
            which need the force on the body alone.

    Examples:
        >>> times, seen = np.arange(3.0), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
        >>> moon = ml.fitting.OfBody(1, ml.fitting.Attitudes(times, seen, sigma=0.01))  # the second body
        >>> moon.body, moon.values.shape
        (1, (3, 4))
    """

    body: int = eqx.field(static=True)
    measurement: Measurement

    def __init__(self, body: Any, measurement: Any):
        if isinstance(body, bool) or not isinstance(body, int | np.integer) or body < 0:
            raise ValueError(f"body must be the index of a body, from 0, got {body!r}.")
        if not isinstance(measurement, Measurement) or isinstance(measurement, OfBody | Accelerations):
            raise ValueError(
                "measurement must be one of Rates, Attitudes, Directions, Positions and Observed, got "
                f"{described(measurement)}."
            )
        self.body, self.measurement = int(body), measurement

    @property
    def times(self) -> Float[Array, " n"]:
        return self.measurement.times

    @property
    def values(self) -> Array:
        return self.measurement.values

    @property
    def sigma(self) -> Array:
        return self.measurement.sigma

    @property
    def present(self) -> Bool[Array, "..."]:
        return self.measurement.present

    @property
    def clock(self) -> Source | None:
        return self.measurement.clock

    def subject(self, body: Any, states: Any) -> tuple[Any, Any, Any]:
        if not states.several:
            raise ValueError(f"OfBody is for coupled bodies, but the model starts from a {type(states).__name__}.")
        if self.body >= states.count:
            raise ValueError(f"OfBody({self.body}, ...): the model has {states.count} bodies, counted from 0.")
        one = jax.tree.map(lambda x: x[self.body], body) if body.batch else body
        return self.measurement, one, states.of_body(self.body)

    def differences(self, parameters: Any, body: Any, states: Any) -> Array:
        measurement, body, states = self.subject(body, states)
        return measurement.differences(parameters, body, states)
