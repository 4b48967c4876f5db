"""Where a quantity of an instrument comes from: a parameter, a function of the parameters, or a known array."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jax import Array

from ..._checks.arguments import as_floats, require_finite

Part = str | Callable[[Any], Array] | Array  # a name in the values, a function of the values, or a known array


class Source(eqx.Module):
    """Where a quantity of an instrument comes from: see `Part`.

    Attributes:
        rule: the name of a parameter, a function of the values of the parameters, or None if the quantity is known.
        known: the known quantity, or None.
    """

    rule: str | Callable[..., Any] | None = eqx.field(static=True)
    known: Array | None

    @classmethod
    def of(cls, name: str, part: Any, shape: tuple[int, ...]) -> "Source":
        """The source, from an argument; the shape of a known array is checked."""
        if isinstance(part, str) or callable(part):
            return cls(part, None)
        array = as_floats(name, part)
        if array.size != int(np.prod(shape)):
            raise ValueError(f"{name} must have shape {shape}, got {array.shape}.")
        require_finite(name, array)
        return cls(None, array.reshape(shape))

    def __call__(self, parameters: Any) -> Any:
        """The quantity for these values of the parameters."""
        if isinstance(self.rule, str):
            return parameters[self.rule]
        return self.known if self.rule is None else self.rule(parameters)


def source(name: str, part: Any, shape: tuple[int, ...]) -> Source | None:
    return None if part is None else Source.of(name, part, shape)
