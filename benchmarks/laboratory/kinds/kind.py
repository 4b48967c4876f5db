"""`Kind`: what the programs and the measure of errors must know of a kind of state."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from midlie_jax.cli.scenes import Scene


class Kind(NamedTuple):
    """A kind of state.

    Attributes:
        rates: for a scene the function `field(state, place=None)`: d/dt of the numbers of a state, on scalars of any
            type, such as Python floats, JAX arrays or expressions of another program.
        errors: of ends (n, k) from exact ends (n, k), for each body, (n,).
        measured: what the errors are of, in words.
        exact: for a scene and starts (n, k) the numbers at the end and the name of the closed form, or None.
    """

    rates: Callable[[Scene], Callable[..., tuple[Any, ...]]]
    errors: Callable[[np.ndarray, np.ndarray], np.ndarray]
    measured: str
    exact: Callable[[Scene, np.ndarray], tuple[np.ndarray, str] | None]


def no_closed_form(scene: Scene, states: np.ndarray) -> None:
    """For a kind whose scenes have no closed form."""
