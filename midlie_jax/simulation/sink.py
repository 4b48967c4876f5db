"""Where the parts of a run are written: a store on disk, or memory."""

from typing import Protocol, runtime_checkable

import numpy as np

from .plan import Part

Arrays = dict[str, np.ndarray]


@runtime_checkable
class Sink(Protocol):
    """Takes the parts of a run."""

    def write(self, part: Part, seen: Arrays, state: Arrays, first_bad: np.ndarray) -> None:
        """Writes a part.

        Args:
            seen: the variables of the part: (bodies, saves, ...), or (1, saves, ...) of a statistic.
            state: the arrays of the states at the end of the part, (bodies, ...).
            first_bad: (bodies,).
        """
        ...

    def read(self, name: str) -> np.ndarray:
        """A whole variable."""
        ...
