"""Two waters in OpenMM, whose SETTLE keeps them rigid under the leapfrog, on its Reference platform in float64."""

from typing import Any

import jax
import numpy as np

import midlie_jax as ml

from . import water
from .lammps_runs import site_velocities


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
