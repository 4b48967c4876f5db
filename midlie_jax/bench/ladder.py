"""The points of one of our methods on a problem: error against cost, from coarse steps to fine."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from ..drivers.program import Program
from ..methods.base import Method
from ..model.states import RigidState
from .rivals.problem import Point, Problem

_FLOOR = 3e-14  # an attitude error at which rounding rules, and a finer step tells nothing
_ROUGH = 0.1  # an attitude error above which a method has not begun to converge
_GROWTH = 1.6  # from one rung of a ladder to the next
CHUNK = 256  # bodies moved at once, or fewer where the method asks for fewer


def ladder(method: Method, given: Problem) -> Iterator[Point]:
    """Points of a method from a coarse step to where rounding rules or a run takes too long."""
    scene = given.scene
    starts = RigidState.of(jnp.asarray(given.momentum), jnp.asarray(given.attitude))
    program = Program(method, scene.body, scene.torque, starts, chunk=min(CHUNK, method.chunk))
    count = max(1, given.scene.steps // 100)
    best, worse = np.inf, 0
    while worse < 3:
        steps = program.whole(count)
        (found, fine), timing = given.timed(lambda steps=steps: program.run(scene.duration / steps, steps))
        ends, ok = np.asarray(found.attitude), bool(np.all(fine))
        error = given.error(ends) if np.all(np.isfinite(ends)) else np.inf
        if ok and np.isfinite(error):
            evaluations = float("nan") if given.scene.torque is None else method.evaluations * steps
            yield Point(
                method.name,
                f"step {given.scene.duration / steps:.2e}",
                error,
                timing.seconds / given.bodies,
                evaluations,
                steps,
                timing.spread,
            )
            # Past the floor, and past three rungs that gain nothing on a good one, there is rounding alone.
            worse = worse + 1 if error < _FLOOR or (best < _ROUGH and error > 0.7 * best) else 0
            best = min(best, error)
        if timing.seconds > given.longest:
            return
        count = max(count + 1, round(count * _GROWTH))
