"""heyoka: Taylor's method with adaptive step and order, compiled for the equations, for a SIMD register of bodies.

Biscani & Izzo, MNRAS 504 (2021) 2614. The integrator is built once for each tolerance. The time of the same Python loop
over batches without integration steps is subtracted, because it is not part of heyoka. Its option `fast_math` has no
measurable effect here.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..scenes import Scene
from .problem import Point, Problem, matrix, orbit_of, orbit_rates, orbit_start, program, rates

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14, 1e-15)


def equations(scene: Scene) -> list[Any]:
    """The equations of motion as heyoka's expressions; an orbit is integrated along with the body."""
    heyoka = program("heyoka")

    state = heyoka.make_vars("p0", "p1", "p2", "q0", "q1", "q2", "q3")
    orbit, field = orbit_of(scene), rates(scene)
    if orbit is None:
        return list(zip(state, field(state), strict=True))
    orbit_state = heyoka.make_vars("x", "y", "z", "u", "v", "w")
    derivatives = (*field(state, tuple(orbit_state[:3])), *orbit_rates(orbit, orbit_state))
    return list(zip((*state, *orbit_state), derivatives, strict=True))


def measure(problem: Problem, tolerances: tuple[float, ...] = TOLERANCES) -> Iterator[Point]:
    """A point for each tolerance."""
    heyoka = program("heyoka")

    scene, states = problem.scene, problem.states
    width = min(heyoka.recommended_simd_size(), len(states))  # a register may be wider than the number of bodies
    system, orbit = equations(scene), orbit_of(scene)
    if orbit is not None:
        states = np.concatenate([states, np.tile(orbit_start(orbit), (len(states), 1))], axis=1)
    batches = [np.ascontiguousarray(states[i : i + width].T) for i in range(0, len(states) - width + 1, width)]
    for tolerance in tolerances:
        integrator = heyoka.taylor_adaptive_batch(system, batches[0].copy(), tol=tolerance)
        state, set_time, propagate = integrator.state, integrator.set_time, integrator.propagate_until

        def loop(end: float, state: Any = state, set_time: Any = set_time, propagate: Any = propagate) -> None:
            for batch in batches:
                set_time(0.0)
                state[:] = batch
                propagate(end)

        ends, steps = [], []
        for batch in batches[: -(-len(problem.ends) // width)]:
            set_time(0.0)
            state[:] = batch
            propagate(scene.duration)
            ends.append(state[3:7].T.copy())
            steps.append(np.mean([outcome[3] for outcome in integrator.propagate_res]))
        _, timing = problem.timed(lambda loop=loop: loop(scene.duration))
        _, idle = problem.timed(lambda loop=loop: loop(0.0))
        error = problem.error(np.concatenate(ends))
        part = max(1 - idle.seconds / timing.seconds, 0.5)  # heyoka's fraction of the time of the loop
        cost, spread = part * timing.seconds / (width * len(batches)), timing.spread / part
        yield Point("heyoka", f"tol {tolerance:.0e}", error, cost, float("nan"), float(np.mean(steps)), spread)


def reference(scene: Scene, states: np.ndarray, digits: int = 38) -> np.ndarray:
    """Rotation matrices (k, 3, 3) at the end of a scene from states (k, 7), by Taylor's method in `digits` digits."""
    heyoka = program("heyoka")

    bits = int(digits * 3.33) + 2
    exact = np.vectorize(lambda x: heyoka.real(float(x), prec=bits), otypes=[object])
    orbit = orbit_of(scene)
    orbit_state = np.zeros(0) if orbit is None else orbit_start(orbit)
    system = equations(scene)
    first = np.array(list(exact(np.concatenate([states[0], orbit_state]))))
    integrator = heyoka.taylor_adaptive(system, first, fp_type=heyoka.real, prec=bits, compact_mode=True)
    ends = []
    for start in states:
        integrator.time = heyoka.real(0.0, prec=bits)
        for i, x in enumerate(np.concatenate([start, orbit_state])):
            integrator.state[i] = heyoka.real(float(x), prec=bits)
        integrator.propagate_until(heyoka.real(scene.duration, prec=bits))
        q = integrator.state[3:7]
        square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
        ends.append(np.array([[float(x / square) for x in row] for row in matrix(q)]))
    return np.stack(ends)
