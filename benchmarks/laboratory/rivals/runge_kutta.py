"""diffrax and SciPy: explicit Runge-Kutta methods on the numbers of a state, with constant and with adaptive steps.

The tolerance or step is an argument of the compiled program, so each of the two is compiled once. The programs are
compiled for the full vectors of the machine, as those of this package are, but with XLA's own way to compile short
loops: the other one, which our steps need, was measured to make these solvers half as fast."""

from collections.abc import Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from midlie_jax._xla.compiler import vector_width_options

from ..kinds import kepler, orbit_of, radius
from .problem import Point, Problem, program

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
_PATIENCE = 6  # runs may take so many times as long as those of others, to reach the small errors that are compared


def measure(problem: Problem, solver: Any, name: str, stages: int) -> Iterator[Point]:
    """Points of a solver of diffrax with so many stages."""
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
            count = float(np.mean(steps))
            yield from problem.point(name, f"{label} {value:.1e}", ends, timing, count, stages * count)
            if timing.seconds > _PATIENCE * problem.longest:
                break


# ---- SciPy's DOP853: one body at a time in Python ----
#
# The right-hand side works on Python floats, which for a dozen numbers is faster than on NumPy arrays.

_BODIES = 2  # bodies timed and compared: one body takes as long as hundreds of bodies of a compiled program
_LONGEST = 1.0  # seconds for one body after which no smaller tolerance is tried


def dop853(problem: Problem, tolerances: tuple[float, ...] = TOLERANCES) -> Iterator[Point]:
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
        ends = np.stack([solution.y[:, -1] for solution in solutions])
        count = float(np.mean([solution.nfev for solution in solutions]))
        yield from problem.point("SciPy DOP853", f"tol {tolerance:.0e}", ends, timing, count / 12, count, _BODIES)
        if timing.seconds / _BODIES > _LONGEST:
            return
