"""How often the progress of a run is stored: a kill should lose at most half a minute of work.

A longer part of a run is computed in legs (`drivers/legs.py`) of a few seconds each, and its progress is stored after
some of the legs. Only the elapsed time decides when, and the numbers do not depend on it.
"""

import time

# A kill loses the work since the last complete write: 15 s plus the time of the next write. It loses at most half a
# minute if no leg takes longer than planned, and no write takes longer than 15 s.
LEG = 5.0  # seconds planned for a leg
KEPT = 10.0  # seconds after which the progress is stored, at the end of a leg


class Pace:
    """The speed of the last leg of a run, and the time when its progress was stored."""

    def __init__(self) -> None:
        self._began = self._kept = time.perf_counter()
        self._seconds = 0.0  # per step of a group; 0 while unknown

    def begin(self) -> int:
        """Called at the beginning of a leg; returns its number of steps, at first one."""
        self._began = time.perf_counter()
        return max(1, int(LEG / self._seconds)) if self._seconds else 1

    def end(self, steps: int) -> None:
        """Called at the end of a leg of `steps` steps; the first one also compiles, so the second is short as well."""
        self._seconds = (time.perf_counter() - self._began) / steps

    def due(self) -> bool:
        return time.perf_counter() - self._kept >= KEPT

    def kept(self) -> None:
        """Called when the progress is being stored."""
        self._kept = time.perf_counter()
