"""The destination of the parts of a run: a store on disk, or memory."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from .plan import Part

Arrays = dict[str, np.ndarray]


class Begun(NamedTuple):
    """An incomplete part; some of its steps are computed.

    Attributes:
        steps: number of these steps.
        seen: the values that the part will write, as far as they are computed.
        carried: the arrays of the progress of its bodies, (bodies, ...).
        first_bad: (bodies,), from the steps taken so far.
    """

    steps: int
    seen: Arrays
    carried: list[np.ndarray]
    first_bad: np.ndarray


@runtime_checkable
class Sink(Protocol):
    """Receives the parts of a run."""

    def write(self, part: Part, seen: Arrays, state: Arrays, first_bad: np.ndarray) -> None:
        """Writes a part.

        Args:
            seen: the variables of the part: (bodies, saves, ...), or (1, saves, ...) for a statistic.
            state: the arrays of the states at the end of the part, (bodies, ...).
            first_bad: (bodies,).
        """
        ...

    def keep(self, part: Part, begun: Begun) -> None:
        """Stores an incomplete part, until it is stored with more steps or written as a whole."""
        ...

    def read(self, name: str) -> np.ndarray:
        """A whole variable."""
        ...
