"""How often the progress of a run is stored: a kill should cost at most half a minute, whatever a step costs.

A part of a run that takes longer is computed in legs (`drivers/legs.py`) of a few seconds each, and its progress is
stored after some of the legs. Time alone decides when, and the numbers do not depend on that.
"""

import time

# A kill costs what was computed since the last complete write: 15 s, plus the time of the next write. So it costs at
# most half a minute if a leg takes no longer than planned, and a write takes no longer than 15 s.
LEG = 5.0  # seconds that a leg is to take
KEPT = 10.0  # seconds after which the progress is stored, at the end of a leg


class Pace:
    """The speed of a run, from its last leg, and when its progress was stored."""

    def __init__(self) -> None:
        self._began = self._kept = time.perf_counter()
        self._seconds = 0.0  # per step of a group; 0 while unknown

    def begin(self) -> int:
        """Called when a leg begins; returns how many steps it should have, at first one."""
        self._began = time.perf_counter()
        return max(1, int(LEG / self._seconds)) if self._seconds else 1

    def end(self, steps: int) -> None:
        """Called when a leg of `steps` steps ends. The first leg also compiles, so the second one is short, too."""
        self._seconds = (time.perf_counter() - self._began) / steps

    def due(self) -> bool:
        """Whether the progress must be stored now."""
        return time.perf_counter() - self._kept >= KEPT

    def kept(self) -> None:
        """Called when the progress is being stored."""
        self._kept = time.perf_counter()
