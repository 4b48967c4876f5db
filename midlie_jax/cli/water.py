"""Rigid SPC/E waters in free space, as a torque on coupled bodies; units amu, nm, ps, so energies are in kJ/mol."""

from itertools import combinations
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..model.sites import sites
from ..model.state import Time
from ..model.torques import FromPotential, Torque

_COULOMB = 138.935457644  # of two elementary charges at a distance of 1 nm
_CHARGES = np.array([-0.8476, 0.4238, 0.4238])
_SIGMA, _DEPTH = 0.3166, 0.650  # of the Lennard-Jones potential of the oxygens


class Molecule(NamedTuple):
    """A rigid molecule.

    Attributes:
        mass: ().
        moments: principal, (3,).
        points: O, H and H in the principal frame, (3, 3).
    """

    mass: float
    moments: np.ndarray
    points: np.ndarray


def _water() -> Molecule:
    """Two hydrogens at 0.1 nm from the oxygen, at the angle of a tetrahedron; flat, with e2 across the plane."""
    oxygen, hydrogen, half = 15.9994, 1.008, np.arccos(-1 / 3) / 2
    mass = oxygen + 2 * hydrogen
    x, z = 0.1 * np.sin(half), 0.1 * np.cos(half)
    low = -2 * hydrogen * z / mass  # the oxygen, from the centre of mass
    points = np.array([[0.0, 0.0, low], [x, 0.0, low + z], [-x, 0.0, low + z]])
    across, along = oxygen * low**2 + 2 * hydrogen * (low + z) ** 2, 2 * hydrogen * x**2
    return Molecule(mass, np.array([across, across + along, along]), points)


WATER = _water()


class Waters(Torque):
    """The electrostatic and Lennard-Jones forces between a few waters, by automatic differentiation."""

    def __call__(self, t: Time, state: Any) -> Any:
        return FromPotential(self.potential)(t, state)

    def potential(self, t: Time, state: Any) -> Array:
        del t
        places = sites(state, jnp.asarray(WATER.points, state.position.dtype))
        charges = jnp.asarray(_COULOMB * np.outer(_CHARGES, _CHARGES), places.dtype)
        energies = [_of_pair(places[i], places[j], charges) for i, j in combinations(range(len(places)), 2)]
        return sum(energies[1:], start=energies[0])


def _of_pair(first: Array, second: Array, charges: Array) -> Array:
    distances = jnp.sqrt(jnp.sum((first[:, None] - second[None]) ** 2, axis=-1))
    sixth = (_SIGMA / distances[0, 0]) ** 6
    return jnp.sum(charges / distances) + 4 * _DEPTH * (sixth * sixth - sixth)
