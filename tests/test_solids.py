"""Deformable solids: momenta, energy bands and the limit of the step of a block, d'Alembert's bar, gradients."""

from functools import cache
from itertools import permutations, product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import solids
from cases import DTYPES, epsilon
from solids import NeoHookean, angular_momentum

import midlie_jax as ml

ORDERS = {
    "symplectic Euler": 1,
    "Verlet": 2,
    "adjoint symplectic Euler": 1,
    "position Verlet": 2,
    "implicit midpoint": 2,
}
CELLS = (2, 1, 1)
MU, LAME, DENSITY = 3.0, 8.0, 1.5


def tiled(cells):
    """Nodes (n, 3) of unit cells, and tetrahedra (e, 4): six in each cell, one for each order of the axes."""
    shape = np.array(cells) + 1
    nodes = np.array(list(product(*map(range, shape))), float)
    ways = np.eye(3, dtype=int)[np.array(list(permutations(range(3))))].cumsum(axis=1)  # from one corner to the other
    ways = np.concatenate([np.zeros((6, 1, 3), int), ways], axis=1)
    places = np.array(list(product(*map(range, cells))))[:, None, None] + ways
    return nodes, np.ravel_multi_index(tuple(np.moveaxis(places, -1, 0)), tuple(shape)).reshape(-1, 4)


def block(dtype="float64", lame=LAME):
    """Body, energy and start of a block that is thrown and spins."""
    nodes, corners = tiled(CELLS)
    nodes = jnp.asarray(nodes, dtype)
    energy = NeoHookean(nodes, corners, MU, lame)
    mass = energy.masses(nodes, DENSITY)
    velocity = jnp.asarray([[0.3, -0.2, 0.5]], dtype) + jnp.cross(jnp.asarray([[0.2, 0.5, -0.3]], dtype), nodes)
    return ml.Particles(mass), energy, ml.ParticleState(mass * velocity, nodes)


@cache
def run(name, steps, dtype="float64"):
    """The states of a flight of 4.8, and the kinetic and elastic energies."""
    body, energy, start = block(dtype)
    path = ml.integrate(name, body, ml.torques.FromPotential(energy), start, dt=4.8 / steps, steps=steps)
    assert path.ok
    return path.states, ml.observe.energy(body, ml.torques.FromPotential(energy), path)


@pytest.mark.sample(0)
def test_the_mesh_fills_the_block_and_has_all_its_mass():
    body, energy, start = block()
    assert energy.volume.shape == (6 * 2,)
    np.testing.assert_allclose(energy.volume, 1 / 6, rtol=1e-15)
    assert jnp.sum(body.mass) == pytest.approx(2 * DENSITY)
    assert body.mass.shape == (len(start.position), 1)
    assert abs(energy(0.0, start)) < 1e-14


def test_the_energy_is_that_of_a_homogeneous_deformation():
    """And does not feel a rotation; its gradient is what `FromPotential` returns."""
    _, energy, start = block()
    F = np.array([[1.2, 0.1, 0.0], [-0.2, 0.9, 0.3], [0.1, 0.0, 1.1]])
    log_J = np.log(np.linalg.det(F))
    exact = 2 * (MU / 2 * (np.sum(F**2) - 3) - MU * log_J + LAME / 2 * log_J**2)
    turn = np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.array([0.4, 1.0, -2.0]))))
    for map_ in (F, turn @ F):
        bent = ml.ParticleState(start.momentum, start.position @ map_.T + 3.0)
        assert energy(0.0, bent) == pytest.approx(exact, rel=1e-13)
    gradient = jax.grad(lambda x: energy(0.0, ml.ParticleState(start.momentum, x)))(bent.position)
    np.testing.assert_array_equal(ml.torques.FromPotential(energy)(0.0, bent), -gradient)


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", ORDERS)
def test_momenta_are_kept_to_rounding(name, dtype):
    """Linear and angular, at every step: to rounding of the sums of their parts, growing as the root of the steps."""
    states, _ = run(name, 48, dtype)

    def moments(states):
        return jnp.sum(jnp.linalg.norm(jnp.cross(states.position, states.momentum), axis=2), axis=1)

    for of, parts in (
        (lambda s: jnp.sum(s.momentum, axis=1), lambda s: jnp.sum(jnp.abs(s.momentum), axis=1)),
        (angular_momentum, moments),
    ):
        found = of(states)
        assert jnp.max(jnp.abs(found - found[:1])) <= 48**0.5 * epsilon(dtype) * jnp.max(parts(states))


@pytest.mark.parametrize(("courant", "bound"), [(1.0, 1e-13), (0.4, 1e-13)])
def test_the_nodes_of_a_bar_move_as_known(courant, bound):
    """At c h = dx as d'Alembert's waves, otherwise at the frequency of elements and steps; over 10,000 steps."""
    found = solids.case(courant, 10_000)
    assert np.abs(found.found - found.exact).max() < bound
    if courant == 1.0:
        assert found.frequency == pytest.approx(solids.MODE * np.pi, rel=1e-15)
