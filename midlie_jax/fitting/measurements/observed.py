"""`Observed`: any measurement, by a function that says what the model lets expect."""

from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ..._checks.arguments import as_floats, require_function
from ...model.state import AnyState
from .base import Expected
from .source import Part

_ARGUMENTS = "t, state, body, values"


class Observed(Expected):
    """Any measurement of any quantity: the residual is (function - value) / sigma.

    `function(t, state, body, values)` is called for one time, and mapped over all:

    - `t` is the time, (), on the clock of the model.
    - `state` is the model's state at this time, such as a `RigidState` with `momentum` (3,), body frame, and `attitude`
      (4,), body to space. Of a model of several bodies it is the state of all, such as a `CoupledState` with arrays
      (N, 3); in `OfBody` it is that of one.
    - `body` is the body that the model returned; `body.velocity(state.momentum)` is the angular velocity, body frame.
    - `values` are the values of the parameters, of the structure of the guess.

    It is written with `jax.numpy` and must be pure. It does not get the torque: what depends on it, such as the angular
    acceleration, is `body.velocity(jnp.cross(state.momentum, rates) + moment)` by Euler's equations, with the moment
    (3,) of the model's torque, zero for a free body. Pass the same function again to reuse what was compiled. A
    function that holds arrays, to be mapped over or differentiated, is an `equinox.Module` with `__call__`, or a
    `jax.tree_util.Partial`.

    Args:
        times: (n,), ascending.
        values: (n,) or (n, k), or with further axes, in any unit; NaN where missing.
        sigma: standard deviation in the unit of the values, broadcast to their shape.
        function: see above; its value has the shape of one of `values`: () or (k,).
        clock: as for `Rates`.

    Raises:
        ValueError: as for `Rates`, or `function` cannot be called. In `fit` and `prepare`, before anything is compiled:
            its value has another shape or another dtype than the values, or it asks for a parameter that there is not.

    Examples:
        >>> def range_rate(t, state, body, values):  # of a mark at (1, 0, 0) in the body, seen from far away on x
        ...     velocity = jnp.cross(body.velocity(state.momentum), jnp.array([1.0, 0.0, 0.0]))
        ...     return ml.so3.rotate(state.attitude, velocity)[0]
        >>> seen = np.array([0.02, 0.05, 0.01])
        >>> radar = ml.fitting.Observed(np.arange(3.0), seen, sigma=0.01, function=range_rate)  # for ml.fit
        >>> radar.values.shape
        (3,)
    """

    function: Callable[..., Any]

    def __init__(
        self,
        times: Any,
        values: Any,
        sigma: Any,
        function: Callable[[Array, Any, Any, Any], Any] | Any,
        *,
        clock: Part | float | None = None,
    ):
        require_function("function", function, _ARGUMENTS)
        self._record(times, values, sigma, as_floats("values", values).shape[1:], clock)
        # What holds arrays has them as arrays of the measurement; a plain function is static.
        holds = isinstance(function, eqx.Module | jax.tree_util.Partial)
        self.function = cast(Callable[..., Any], function if holds else jax.tree_util.Partial(function))

    def subject(self, body: Any, states: Any) -> tuple[Any, Any, Any]:
        return self, body, states

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        return jnp.asarray(self.function(t, state, body, parameters))

    def check(self, parameters: Any, body: Any, start: AnyState) -> None:
        """Raises a ValueError unless the function suits the values, by its value for the first state."""
        try:
            found = jax.eval_shape(self.expected, self.times[0], start, body, parameters)
        except KeyError as error:
            raise ValueError(f"function of Observed asks for {error}, which is not among the values.") from error
        except TypeError as error:
            raise ValueError(f"function of Observed must take ({_ARGUMENTS}) and return an array: {error}") from error
        wanted = self.values.shape[1:]
        if found.shape != wanted:
            rest = "" if wanted else " (give values (n, 1) for a function that returns (1,))"
            raise ValueError(
                f"function of Observed returns shape {found.shape} for each time, and values have {wanted}{rest}; "
                "return one number for each measured one."
            )
        if found.dtype != self.values.dtype:
            raise ValueError(
                f"function of Observed returns {found.dtype}, and values are {self.values.dtype}; cast one of them, "
                "such as the arrays that the function holds."
            )
