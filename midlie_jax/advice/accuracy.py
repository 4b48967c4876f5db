"""Difference of a run from one with half the step: the accuracy estimate of `check`."""

from typing import Any

import numpy as np


def difference(states: Any, with_half_step: Any) -> tuple[float, str]:
    """The largest difference between states and the states of a run with half the step, and the name of the quantity.

    It is the angle between attitudes, axes or directions, in radians. Between momenta without these it is relative.
    """
    for name in ("attitude", "axis", "direction"):
        if hasattr(states, name):
            a, b = (np.asarray(getattr(s, name), np.float64) for s in (states, with_half_step))
            apart = np.linalg.norm(a - b, axis=-1)
            if name != "attitude":
                return float(np.max(2 * np.arcsin(np.minimum(apart / 2, 1)))), name
            apart = np.minimum(apart, np.linalg.norm(a + b, axis=-1))  # q and -q are one attitude
            return float(np.max(4 * np.arcsin(np.minimum(apart / 2, 1)))), name
    a, b = (np.asarray(s.momentum, np.float64) for s in (states, with_half_step))
    size = np.linalg.norm(b, axis=-1)
    return float(np.max(np.linalg.norm(a - b, axis=-1) / np.where(size > 0, size, 1))), "momentum"
