"""The order of a scheme, measured on two pendulums: no JAX, no rigid body, extended precision."""

from itertools import pairwise
from typing import Any

import numpy as np

from .scheme import FLIGHT, Scheme, run

# Two pendulums on one spring: far from quadratic, and of two masses.
_MASSES = np.array([1.0, 1.7], np.longdouble)
_START = np.array([0.3, 0.8], np.longdouble), np.array([0.7, -0.4], np.longdouble)
_TIME, _FEWEST, _MOST = 3, 12, 1536


def pendulums(
    scheme: Scheme, count: int, before: tuple[tuple[str, float], ...] = (), after: tuple[tuple[str, float], ...] = ()
) -> np.ndarray:
    """Momenta and angles of two pendulums after `count` steps, in extended precision, (4,).

    Args:
        before, after: stages to apply once before and after the steps: a processor.
    """
    h = np.longdouble(_TIME) / count

    def fly(a: float, motion: Any) -> Any:
        return motion[0], motion[1] + a * h * motion[0] / _MASSES

    def kick(b: float, c: float, motion: Any, force: Any) -> Any:
        del c
        return motion[0] + b * h * force, motion[1]

    def evaluate(c: float, g: float, motion: Any) -> Any:
        del c
        u = motion[1]
        pull = np.cos(u[0] - u[1]) / 2
        force = -np.sin(u) - np.array([pull, -pull])
        if not g:
            return force
        w = force / _MASSES
        bend = np.sin(u[0] - u[1]) / 2 * (w[0] - w[1])
        return force + 2 * g * h * h * (-np.cos(u) * w + np.array([bend, -bend]))

    def apply(stages: tuple[tuple[str, float], ...], motion: Any) -> Any:
        for kind, x in stages:
            motion = fly(x, motion) if kind == FLIGHT else kick(x, 0.0, motion, evaluate(0.0, 0.0, motion))
        return motion

    motion, force = apply(before, _START), None
    for _ in range(count):
        motion, force = run(scheme, fly, kick, evaluate, motion, force if scheme.reuses_force else None)
    return np.concatenate(apply(after, motion))


def measured_order(
    scheme: Scheme, before: tuple[tuple[str, float], ...] = (), after: tuple[tuple[str, float], ...] = ()
) -> float:
    """The order of a table as two pendulums show it: the slope of the error at the smallest steps above rounding.

    Without JAX and in NumPy's longdouble, by differences of runs with steps h, h/2 and h/4. For a table of your own, to
    be sure of its digits. A whole number to about .1; where rounding hides the error (order 8 and more in plain
    doubles) the slope is that of the largest steps.

    Args:
        scheme: the table.
        before, after: stages to apply once before and after a run: a processor.
    """
    slope, count = np.nan, _FEWEST
    ends = [pendulums(scheme, count * factor, before, after) for factor in (1, 2)]
    while 4 * count <= _MOST:
        ends.append(pendulums(scheme, 4 * count, before, after))
        coarse, fine = (np.linalg.norm(a - b) for a, b in pairwise(ends[-3:]))
        if np.isfinite(slope) and fine < 1e4 * np.finfo(np.longdouble).eps:
            break
        slope = float(np.log2(coarse / fine))
        count *= 2
    return slope
