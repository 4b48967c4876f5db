"""Deformable solids: the energy of a block and its gradient, and d'Alembert's bar."""

from itertools import permutations, product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import solids
from solids import NeoHookean

import midlie_jax as ml

CELLS = (2, 1, 1)
MU, LAME = 3.0, 8.0


def tiled(cells):
    """Nodes (n, 3) of unit cells, and tetrahedra (e, 4): six in each cell, one for each order of the axes."""
    shape = np.array(cells) + 1
    nodes = np.array(list(product(*map(range, shape))), float)
    ways = np.eye(3, dtype=int)[np.array(list(permutations(range(3))))].cumsum(axis=1)  # from one corner to the other
    ways = np.concatenate([np.zeros((6, 1, 3), int), ways], axis=1)
    places = np.array(list(product(*map(range, cells))))[:, None, None] + ways
    return nodes, np.ravel_multi_index(tuple(np.moveaxis(places, -1, 0)), tuple(shape)).reshape(-1, 4)


def test_the_energy_is_that_of_a_homogeneous_deformation():
    """And does not feel a rotation; its gradient is what `FromPotential` returns."""
    nodes, corners = tiled(CELLS)
    energy = NeoHookean(jnp.asarray(nodes), corners, MU, LAME)
    F = np.array([[1.2, 0.1, 0.0], [-0.2, 0.9, 0.3], [0.1, 0.0, 1.1]])
    log_J = np.log(np.linalg.det(F))
    exact = 2 * (MU / 2 * (np.sum(F**2) - 3) - MU * log_J + LAME / 2 * log_J**2)
    turn = np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.array([0.4, 1.0, -2.0]))))
    for map_ in (F, turn @ F):
        bent = ml.ParticleState(jnp.zeros_like(nodes), jnp.asarray(nodes @ map_.T + 3.0))
        assert energy(0.0, bent) == pytest.approx(exact, rel=1e-13)
    gradient = jax.grad(lambda x: energy(0.0, ml.ParticleState(bent.momentum, x)))(bent.position)
    np.testing.assert_array_equal(ml.torques.FromPotential(energy)(0.0, bent), -gradient)


@pytest.mark.parametrize(("courant", "bound"), [(1.0, 1e-13), (0.4, 1e-13)])
def test_the_nodes_of_a_bar_move_as_known(courant, bound):
    """At c h = dx as d'Alembert's waves, otherwise at the frequency of elements and steps; over 10,000 steps."""
    found = solids.case(courant, 10_000)
    assert np.abs(found.found - found.exact).max() < bound
    if courant == 1.0:
        assert found.frequency == pytest.approx(solids.MODE * np.pi, rel=1e-15)
