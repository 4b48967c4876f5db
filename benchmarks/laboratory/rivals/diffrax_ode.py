"""diffrax: explicit Runge-Kutta methods on the numbers of a state, vmapped, with constant and with adaptive steps.

The tolerance or step is an argument of the compiled program, so each of the two is compiled once. The programs are
compiled for the full vectors of the machine, as those of this package are, but with XLA's own way to compile short
loops: the other one, which our steps need, was measured to make these solvers half as fast.
"""

from collections.abc import Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from midlie_jax._xla.compiler import vector_width_options

from ..kinds.rigid import orbit_of, radius
from .problem import Point, Problem

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
_PATIENCE = 6  # runs may take so many times as long as those of others, to reach the small errors that are compared


def _measure(problem: Problem, solver: Any, name: str, stages: int) -> Iterator[Point]:
    scene, orbit, equations = problem.scene, orbit_of(problem.scene), problem.kind.rates(problem.scene)
    states, size = jnp.asarray(problem.states), jnp.asarray(problem.sizes)

    def field(t: Any, y: Any, args: Any) -> Any:
        del args
        position = None if orbit is None else tuple(orbit(t) / radius(orbit))
        return jnp.stack(equations(tuple(y), position))

    def solve(start: Any, step: Any, controller: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            solver,
            0.0,
            scene.duration,
            step,
            start,
            stepsize_controller=controller,
            adjoint=diffrax.ForwardMode(),
            max_steps=None,
            throw=False,
        )
        ends: Any = solution.ys
        return ends[-1], solution.stats["num_steps"]

    def constant(starts: Any, step: Any) -> Any:
        return jax.vmap(lambda start: solve(start, step, diffrax.ConstantStepSize()))(starts)

    def adaptive(starts: Any, tolerance: Any) -> Any:
        controller = diffrax.PIDController(rtol=0.0, atol=tolerance * size)
        first = scene.dt / 4
        return jax.vmap(lambda start: solve(start, first, controller))(starts)

    constant_steps = [scene.duration / max(4, scene.steps // 64) / 2**n for n in range(16)]
    options = vector_width_options()
    for function, values, label in ((adaptive, TOLERANCES, "tol"), (constant, constant_steps, "step")):
        compiled = jax.jit(function).lower(states, jnp.asarray(1.0)).compile(compiler_options=options)
        for value in values:

            def run(value: float = value, compiled: Any = compiled) -> Any:
                return jax.block_until_ready(compiled(states, jnp.asarray(value)))

            (ends, steps), timing = problem.timed(run)
            if np.all(np.isfinite(ends)):
                mean_steps = float(np.mean(steps))
                yield Point(
                    name,
                    f"{label} {value:.1e}",
                    problem.error(ends),
                    timing.seconds / problem.bodies,
                    stages * mean_steps,
                    mean_steps,
                    timing.spread,
                )
            if timing.seconds > _PATIENCE * problem.longest:
                break


def tsit5(problem: Problem) -> Iterator[Point]:
    """Points of Tsitouras' method of order 5."""
    return _measure(problem, diffrax.Tsit5(), "diffrax Tsit5", 6)


def dopri8(problem: Problem) -> Iterator[Point]:
    """Points of Dormand and Prince's method of order 8."""
    return _measure(problem, diffrax.Dopri8(), "diffrax Dopri8", 13)
