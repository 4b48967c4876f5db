"""Measures one of our methods on a problem over a ladder of steps, or the closed form: points of error against cost."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from midlie_jax._xla.compiler import compiler_options
from midlie_jax.advice.program import Program
from midlie_jax.drivers.chunks import chunk_size
from midlie_jax.drivers.free_motion import free_motion
from midlie_jax.integrators.base import Method
from midlie_jax.model.states import RigidState

from ..kinds import numbers
from .problem import Point, Problem

_EVALUATIONS = 20  # of the closed form in a timed run; one alone is a tenth of a millisecond, too short for the clock
FREE_MOTION = "free_motion"  # as points and charts name the closed form of a free body
_FLOOR = 3e-14  # below this error rounding dominates, and smaller steps give no more information
_ROUGH = 0.1  # above this error a method has not begun to converge
_GROWTH = 1.6  # factor between the numbers of steps of two rungs


def ladder(method: Method, case: Problem) -> Iterator[Point]:
    """Points of a method on the problem `case`, from coarse steps until rounding dominates or runs take too long.

    There are none if the method does not move such bodies.
    """
    scene, starts = case.scene, case.starts
    if not method.moves(scene.body):
        return
    program = Program(method, scene.body, scene.torque, starts, chunk=chunk_size(len(starts.momentum), starts))
    count = max(1, case.scene.steps // 100)
    best, rungs_without_gain = np.inf, 0
    while rungs_without_gain < 3:
        steps = program.whole(count)
        (states, bodies_ok), timing = case.timed(lambda steps=steps: program.run(scene.duration / steps, steps))
        setting, ends = f"step {scene.duration / steps:.2e}", numbers(states) if np.all(bodies_ok) else np.nan
        for point in case.point(method.name, setting, ends, timing, steps, method.evaluations * steps):
            yield point
            error = point.error
            # Three rungs below the floor, or without gain on a run that has begun to converge, show only rounding.
            no_gain = error < _FLOOR or (best < _ROUGH and error > 0.7 * best)
            rungs_without_gain = rungs_without_gain + 1 if no_gain else 0
            best = min(best, error)
        if timing.seconds > case.longest:
            return
        count = max(count + 1, round(count * _GROWTH))


def exact_point(case: Problem) -> Iterator[Point]:
    """The one point of `free_motion` on a problem without torque, compiled like `Program`."""
    times = jnp.asarray([case.scene.duration])

    def end(start: RigidState) -> tuple[RigidState, Array]:
        path = free_motion(case.scene.body, start, times)
        return jax.tree.map(lambda leaf: leaf[0], path.states), path.ok

    program = jax.jit(jax.vmap(end)).lower(case.starts).compile(compiler_options=compiler_options(case.bodies))

    def run() -> tuple[RigidState, Array]:
        return [jax.block_until_ready(program(case.starts)) for _ in range(_EVALUATIONS)][-1]

    run()  # the first call takes longer than the others and must not be timed
    (ends, ok), timing = case.timed(run)
    if bool(np.all(ok)):
        seconds, nan = timing.seconds / (_EVALUATIONS * case.bodies), float("nan")
        yield Point(FREE_MOTION, "one evaluation", case.error(numbers(ends)), seconds, nan, nan, timing.spread)
