"""Two waters for 1 ps: how far each program ends from the known end, and what that takes."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from harness import Table, in_turn

import midlie_jax as ml

from . import water
from .lammps_runs import Waters, centre_and_attitude
from .openmm_runs import Dimer

OWN = {"EA": (1, 0.5, 0.25, 0.1), "CHIN4A": (2, 1), "SRKN6b": (5, 2, 1), "SRKN14a": (10, 5)}
OTHERS = (1, 0.5, 0.25, 0.1)
LEAST = 1e-8  # to which the known end is known
ROUNDS = 7


def rows() -> Iterator[list[str]]:
    cases = [*_own(), *_lammps(), *_openmm()]
    times = in_turn([run for *_, run in cases], ROUNDS)
    for (name, step, forces, end, _), seconds in zip(cases, times, strict=True):
        yield [name, f"{step:g}", str(forces), *errors(*end), f"{1e3 * seconds:.2g}"]


def errors(position: Any, attitude: Any) -> tuple[str, str]:
    """How far position and attitude of the second molecule are from the known end."""
    there = ml.so3.multiply(jnp.asarray(water.DIMER_ATTITUDE), water.FRAME)
    turn = ml.so3.log(ml.so3.multiply(ml.so3.conjugate(there), jnp.asarray(attitude)))
    found = float(np.linalg.norm(np.asarray(position) - water.DIMER_POSITION)), float(jnp.linalg.norm(turn))
    place, angle = (f"{error:.1e}" if error > 2 * LEAST else "below 2e-8" for error in found)
    return place, angle


def _own() -> Iterator[tuple[str, float, int, Any, Callable[[], Any]]]:
    body, start, torque = water.molecules(2), water.dimer(), ml.torques.FromPotential(water.dimer_energy)
    for scheme, all_steps in OWN.items():
        for step in all_steps:
            name, steps = f"JACOBI[{scheme}]", round(1000 / step)
            options = {"dt": 1e-3 * step, "steps": steps, "save_every": steps}

            def run(name: str = name, options: dict[str, Any] = options) -> Any:
                return ml.integrate(name, body, torque, start, **options)

            states = run().states
            end = states.position[-1, 1], states.attitude[-1, 1]
            yield f"`{name}`", step, steps * water.forces_per_step(name), end, run


def _lammps() -> Iterator[tuple[str, float, int, Any, Callable[[], Any]]]:
    for step in OTHERS:
        steps = round(1000 / step)
        run = Waters(water.dimer(), step, None)
        run.run(steps, prepare=True)
        end = centre_and_attitude(run.places(), 1)
        yield "LAMMPS `rigid/nve/small`", step, steps, end, partial(run.run, steps)


def _openmm() -> Iterator[tuple[str, float, int, Any, Callable[[], Any]]]:
    for step in OTHERS:
        steps = round(1000 / step)
        run = Dimer(water.dimer(), 1e-3 * step)
        run.run(steps)
        yield "OpenMM SETTLE", step, steps, centre_and_attitude(run.places(), 1), partial(run.run, steps)


SHOWN = (  # the rows on the page
    *(("`JACOBI[EA]`", "1"), ("`JACOBI[CHIN4A]`", "1"), ("`JACOBI[SRKN6b]`", "1"), ("`JACOBI[SRKN14a]`", "5")),
    *(("LAMMPS `rigid/nve/small`", "1"), ("OpenMM SETTLE", "1"), ("OpenMM SETTLE", "0.1")),
)
TABLE = Table(
    *("reports/heat.md", "dimer"),
    ("program", "step, fs", "forces", "error of x2, nm", "error of q2, rad", "time, ms"),
    *(rows, "waters-two", lambda row: tuple(row[:2]) in SHOWN),
)
