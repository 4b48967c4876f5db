"""How often a run is kept: at a kill no more than half a minute is to be lost, whatever the price of a step.

A part of a run that takes longer is computed in legs (`drivers/legs.py`) of a few seconds each, and kept after some of
them. Only the time decides when, and the numbers do not depend on it.
"""

import time

# A kill costs what was computed since the last write that has ended: 15 s, and as long as the next write takes. So it
# is half a minute at most where a leg takes no longer than foreseen, and a write no longer than the computing.
LEG = 5.0  # seconds that a leg is to take
KEPT = 10.0  # seconds after which a run is kept, at the end of the leg


class Pace:
    """The speed of a run, from its last leg, and when it was kept."""

    def __init__(self) -> None:
        self._began = self._kept = time.perf_counter()
        self._seconds = 0.0  # of a step of a group; 0 while it is not known

    def begin(self) -> int:
        """A leg begins; returns how many steps it should have, one at first."""
        self._began = time.perf_counter()
        return max(1, int(LEG / self._seconds)) if self._seconds else 1

    def end(self, steps: int) -> None:
        """The leg ends after so many steps. The time of the first contains compiling, so the second is short, too."""
        self._seconds = (time.perf_counter() - self._began) / steps

    def due(self) -> bool:
        """Whether the run must be kept now."""
        return time.perf_counter() - self._kept >= KEPT

    def kept(self) -> None:
        """The run is being kept."""
        self._kept = time.perf_counter()
