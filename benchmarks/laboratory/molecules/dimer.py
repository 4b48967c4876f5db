"""Two waters for 1 ps: how far each program ends from the known end, and what that takes."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import Table, in_turn

import midlie_jax as ml

from . import water
from .lammps_runs import Waters, centre_and_attitude, site_velocities

# ---- OpenMM, whose SETTLE keeps them rigid under the leapfrog, on its Reference platform in float64 ----


class Dimer:
    """Two waters without a cut-off; velocities start half a step early, as the leapfrog keeps them.

    Args:
        start: the molecules.
        step: in ps.
    """

    def __init__(self, start: ml.CoupledState, step: float):
        openmm = _openmm()
        system, force = openmm.System(), openmm.NonbondedForce()
        force.setNonbondedMethod(openmm.NonbondedForce.NoCutoff)
        sites = np.asarray(water.PLACES)
        for molecule in range(start.count):
            first = molecule * len(sites)
            for a, mass in enumerate(water.MASSES):
                system.addParticle(mass)
                force.addParticle(water.CHARGES[a], water.SIGMAS[a] or 1.0, water.EPSILONS[a])
            for a, b in ((0, 1), (0, 2), (1, 2)):
                system.addConstraint(first + a, first + b, float(np.linalg.norm(sites[a] - sites[b])))
                force.addException(first + a, first + b, 0.0, 1.0, 0.0)
        system.addForce(force)
        self.integrator = openmm.VerletIntegrator(step)
        self.context = openmm.Context(system, self.integrator, openmm.Platform.getPlatformByName("Reference"))
        self.context.setPositions(np.asarray(ml.molecules.sites(start, water.POINTS)).reshape(-1, 3))
        self.context.setVelocities(site_velocities(_half_a_step_early(start, step)).reshape(-1, 3))

    def run(self, steps: int) -> None:
        self.integrator.step(steps)

    def places(self) -> np.ndarray:
        """The sites (2, 3, 3) in nm."""
        state = self.context.getState(getPositions=True)
        return np.asarray(state.getPositions(asNumpy=True)._value).reshape(-1, len(water.MASSES), 3)

    def energy(self) -> float:
        """The potential energy in kJ/mol."""
        return self.context.getState(getEnergy=True).getPotentialEnergy()._value


def _half_a_step_early(start: ml.CoupledState, step: float) -> Any:
    torque = ml.torques.FromPotential(water.dimer_energy)
    path = ml.integrate("JACOBI[SRKN14a]", water.molecules(2), torque, start, dt=-step / 2, steps=1)
    return jax.tree.map(lambda x: x[-1], path.states)


def _openmm() -> Any:
    try:
        import openmm
    except ImportError as error:
        raise ImportError("OpenMM is not installed: pip install 'midlie_jax[bench-molecules]'.") from error
    return openmm


# ---- all programs ----

OWN = {"EA": (1, 0.5, 0.25, 0.1), "CHIN4A": (2, 1), "SRKN6b": (5, 2, 1), "SRKN14a": (10, 5)}
OTHERS = (1, 0.5, 0.25, 0.1)
LEAST = 1e-8  # to which the known end is known
ROUNDS = 7


def rows() -> Iterator[list[str]]:
    cases = [*_own(), *_lammps(), *_by_openmm()]
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


def _by_openmm() -> Iterator[tuple[str, float, int, Any, Callable[[], Any]]]:
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
