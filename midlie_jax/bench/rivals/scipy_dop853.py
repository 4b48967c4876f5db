"""SciPy's DOP853: Dormand and Prince's order 8 with an adaptive step, one body at a time in Python.

The right-hand side is written on Python's floats, which for seven numbers is quicker than NumPy's arrays.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from .problem import Point, Problem, kepler, orbit_of, program, rates

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
_BODIES = 2  # timed and judged: one takes as long as hundreds of a compiled program
_LONGEST = 1.0  # seconds a body


def measure(problem: Problem, tolerances: tuple[float, ...] = TOLERANCES) -> Iterator[Point]:
    """A point for each tolerance."""
    solve_ivp = program("scipy.integrate").solve_ivp

    scene, orbit, equations = problem.scene, orbit_of(problem.scene), rates(problem.scene)
    place = None if orbit is None else kepler(orbit)

    def field(t: float, y: np.ndarray) -> tuple[float, ...]:
        return equations(y.tolist(), None if place is None else place(t))

    starts = problem.states[:_BODIES]
    # The momentum has a size of its own; the quaternion's is one.
    scale = np.concatenate([np.full(3, float(np.linalg.norm(starts[0, :3]))), np.ones(4)])
    for tolerance in tolerances:

        def run(tolerance: float = tolerance) -> list[Any]:
            options = {"rtol": max(tolerance, 3e-14), "atol": tolerance * scale, "t_eval": [scene.duration]}
            return [solve_ivp(field, (0.0, scene.duration), start, "DOP853", **options) for start in starts]

        found, timing = problem.timed(run)
        seconds = timing.seconds / _BODIES
        error = problem.error(np.stack([one.y[3:, -1] for one in found]))
        evaluations = float(np.mean([one.nfev for one in found]))
        setting = f"tol {tolerance:.0e}"
        yield Point("SciPy DOP853", setting, error, seconds, evaluations, evaluations / 12, timing.spread)
        if seconds > _LONGEST:
            return
