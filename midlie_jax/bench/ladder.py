"""Measures one of our methods on a problem over a ladder of steps: points of error against cost."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from ..drivers.chunks import chunk_size
from ..drivers.program import Program
from ..methods.base import Method
from ..model.states import RigidState
from .rivals.problem import Point, Problem

_FLOOR = 3e-14  # below this attitude error rounding dominates, and smaller steps give no more information
_ROUGH = 0.1  # above this attitude error a method has not begun to converge
_GROWTH = 1.6  # factor between the numbers of steps of two rungs


def ladder(method: Method, case: Problem) -> Iterator[Point]:
    """Points of a method on the problem `case`, from coarse steps until rounding dominates or runs take too long."""
    scene = case.scene
    starts = RigidState.of(jnp.asarray(case.momentum), jnp.asarray(case.attitude))
    program = Program(method, scene.body, scene.torque, starts, chunk=chunk_size(len(starts.momentum)))
    count = max(1, case.scene.steps // 100)
    best, rungs_without_gain = np.inf, 0
    while rungs_without_gain < 3:
        steps = program.whole(count)
        (states, bodies_ok), timing = case.timed(lambda steps=steps: program.run(scene.duration / steps, steps))
        ends, ok = np.asarray(states.attitude), bool(np.all(bodies_ok))
        error = case.error(ends) if np.all(np.isfinite(ends)) else np.inf
        if ok and np.isfinite(error):
            evaluations = float("nan") if case.scene.torque is None else method.evaluations * steps
            yield Point(
                method.name,
                f"step {case.scene.duration / steps:.2e}",
                error,
                timing.seconds / case.bodies,
                evaluations,
                steps,
                timing.spread,
            )
            # Three rungs below the floor, or without gain on a run that has begun to converge, show only rounding.
            no_gain = error < _FLOOR or (best < _ROUGH and error > 0.7 * best)
            rungs_without_gain = rungs_without_gain + 1 if no_gain else 0
            best = min(best, error)
        if timing.seconds > case.longest:
            return
        count = max(count + 1, round(count * _GROWTH))
