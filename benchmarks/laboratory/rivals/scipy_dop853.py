"""SciPy's DOP853: Dormand and Prince's order 8 with an adaptive step, one body at a time in Python.

The right-hand side works on Python floats, which for a dozen numbers is faster than on NumPy arrays.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..kinds.rigid import kepler, orbit_of
from .problem import Point, Problem, program

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
_BODIES = 2  # bodies timed and compared: one body takes as long as hundreds of bodies of a compiled program
_LONGEST = 1.0  # seconds for one body after which no smaller tolerance is tried


def measure(problem: Problem, tolerances: tuple[float, ...] = TOLERANCES) -> Iterator[Point]:
    """A point for each tolerance."""
    solve_ivp = program("scipy.integrate").solve_ivp

    scene, orbit, equations = problem.scene, orbit_of(problem.scene), problem.kind.rates(problem.scene)
    position = None if orbit is None else kepler(orbit)

    def field(t: float, y: np.ndarray) -> tuple[float, ...]:
        return equations(y.tolist(), None if position is None else position(t))

    starts = problem.states[:_BODIES]
    for tolerance in tolerances:

        def run(tolerance: float = tolerance) -> list[Any]:
            options = {"rtol": max(tolerance, 3e-14), "atol": tolerance * problem.sizes, "t_eval": [scene.duration]}
            return [solve_ivp(field, (0.0, scene.duration), start, "DOP853", **options) for start in starts]

        solutions, timing = problem.timed(run)
        seconds = timing.seconds / _BODIES
        error = problem.error(np.stack([solution.y[:, -1] for solution in solutions]))
        evaluations = float(np.mean([solution.nfev for solution in solutions]))
        setting = f"tol {tolerance:.0e}"
        yield Point("SciPy DOP853", setting, error, seconds, evaluations, evaluations / 12, timing.spread)
        if seconds > _LONGEST:
            return
