"""The pair force that users copy, its list of neighbours, and the data of the waters: against sums over all pairs."""

from math import erfc, exp, pi, sqrt

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laboratory.molecules import water
from laboratory.molecules.damped_water import DampedPairs
from laboratory.molecules.neighbours import neighbour_list

import midlie_jax as ml

CUTOFF, DAMPING = 0.9, 2.0
START, EDGE = water.box()
SITES = 2  # oxygen and one hydrogen, with all kinds of pairs, compile in half the time
POINTS, DATA = water.POINTS[:SITES], [x[:SITES] for x in (water.CHARGES, water.SIGMAS, water.EPSILONS)]
PLACES = np.asarray(ml.molecules.sites(START, POINTS))


def listed(state=START, single=False):
    places = ml.molecules.sites(state, POINTS)
    return DampedPairs(neighbour_list(places, EDGE, CUTOFF, 0.1, slots=180), POINTS, *DATA, EDGE, single=single)


@eqx.filter_jit
def evaluated(torque, state):
    """The wrench and the energy."""
    return torque(0.0, state), torque.potential(0.0, state)


def moved(shift):
    return ml.CoupledState(START.momentum, START.attitude, START.linear, START.position + shift)


def pair(distance, charge, sigma, epsilon):
    """V and -V' of LAMMPS' coul/dsf and lj/smooth/linear, as its documentation has them."""
    erfc_of, c, a = np.vectorize(erfc), CUTOFF, DAMPING
    s = erfc(a * c) / c**2 + 2 * a / sqrt(pi) * exp(-((a * c) ** 2)) / c
    pull = erfc_of(a * distance) / distance**2 + 2 * a / sqrt(pi) * np.exp(-((a * distance) ** 2)) / distance
    energy = charge * (erfc_of(a * distance) / distance - erfc(a * c) / c + s * (distance - c))

    def lennard_jones(r):
        sixth = (sigma / r) ** 6
        return 4 * epsilon * (sixth**2 - sixth), 24 * epsilon * (2 * sixth**2 - sixth) / r

    (there, force), (at_c, force_at_c) = lennard_jones(distance), lennard_jones(c)
    return energy + there - at_c + (distance - c) * force_at_c, charge * (pull - s) + force - force_at_c


@pytest.fixture(scope="module")
def of_all_pairs():
    """Energy, and forces on all sites."""
    energy, forces = 0.0, np.zeros_like(PLACES)
    for p in range(SITES):
        for q in range(SITES):
            d = PLACES[:, None, p] - PLACES[None, :, q]
            d -= EDGE * np.round(d / EDGE)
            r = np.linalg.norm(d, axis=-1)
            inside = (r < CUTOFF) & ~np.eye(len(r), dtype=bool)
            r = np.where(inside, r, CUTOFF)
            charge = water.COULOMB * water.CHARGES[p] * water.CHARGES[q]
            v, f = pair(r, charge, water.SIGMAS[0], water.EPSILONS[0] if p == q == 0 else 0.0)
            energy += np.sum(np.where(inside, v, 0)) / 2
            forces[:, p] += np.sum(np.where(inside, f / r, 0)[..., None] * d, axis=1)
    return energy, ml.molecules.wrench_on_sites(START, POINTS, forces)


@pytest.mark.sample(1)
@pytest.mark.parametrize("single", [False, True])
def test_forces_and_energy_are_those_of_all_pairs(single, of_all_pairs):
    found, energy = evaluated(listed(single=single), START)
    expected_energy, expected = of_all_pairs
    largest = np.max(np.abs(expected.force))
    np.testing.assert_allclose(energy, expected_energy, rtol=1e-10)
    np.testing.assert_allclose(found.force, expected.force, atol=largest * (1e-5 if single else 1e-11))
    np.testing.assert_allclose(found.torque, expected.torque, atol=largest * (1e-6 if single else 1e-12))
    np.testing.assert_allclose(np.sum(found.force, axis=0), 0, atol=largest * (1e-4 if single else 1e-12))


@pytest.mark.sample(0)
def test_forces_are_the_derivative_of_the_energy():
    torque, shift = listed(), jnp.asarray(np.random.default_rng(0).normal(size=START.position.shape))
    derivative = jax.jit(lambda d: jax.jvp(lambda x: torque.potential(0.0, moved(x)), (0 * d,), (d,))[1])(shift)
    expected = -jnp.sum(evaluated(torque, START)[0].force * shift)
    np.testing.assert_allclose(derivative, expected, rtol=1e-10)


@pytest.mark.sample(0)
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_derivatives_of_the_force_are_symmetric_and_those_of_differences(mode):
    random, torque = np.random.default_rng(1), listed()
    one, other = (jnp.asarray(random.normal(size=START.position.shape)) for _ in range(2))

    def forces(shift):
        return torque(0.0, moved(shift)).force

    def along(d):
        if mode == "forward":
            return jax.jvp(forces, (0 * d,), (d,))[1]
        return jax.vjp(forces, 0 * d)[1](d)[0]

    found = jax.jit(along)(one)
    step = 1e-7  # the second derivative of the energy jumps at the cut-off
    difference = (forces(step * one) - forces(-step * one)) / (2 * step)
    np.testing.assert_allclose(found, difference, atol=1e-7 * float(jnp.max(jnp.abs(found))))
    np.testing.assert_allclose(jnp.sum(found * other), jnp.sum(jax.jit(along)(other) * one), rtol=1e-8)


def test_a_list_serves_until_a_site_has_moved_by_half_the_skin():
    near, far = (moved(jnp.zeros_like(START.position).at[0, 0].set(x)) for x in (0.049, 0.051))
    (found, energy), (anew, energy_anew) = evaluated(listed(), near), evaluated(listed(near), near)
    np.testing.assert_allclose(found.force, anew.force, atol=1e-9)
    np.testing.assert_allclose(energy, energy_anew, rtol=1e-13)
    failed, lost = evaluated(listed(), far)
    assert jnp.all(jnp.isnan(failed.force))
    assert jnp.isnan(lost)


def test_lists_that_cannot_be():
    with pytest.raises(ValueError, match=r"box must be at least twice the cut-off.*more molecules"):
        neighbour_list(PLACES, EDGE, 1.0, 0.1)
    with pytest.raises(ValueError, match=r"slots must be even and at least 1.*got 100; give some more"):
        neighbour_list(PLACES, EDGE, CUTOFF, 0.1, slots=100)


def test_the_dimer_has_the_known_energies_and_forces():
    body, torque = water.molecules(2), ml.torques.FromPotential(water.dimer_energy)

    def of_start(state):
        return torque(0.0, state), torque.potential(0.0, state), jnp.sum(ml.observe.kinetic_energy(body, state))

    found, potential, kinetic = jax.jit(of_start)(water.dimer())
    np.testing.assert_allclose(potential, -14.1713118855, atol=1e-10)
    np.testing.assert_allclose(kinetic, 2.8302913250, atol=1e-10)
    np.testing.assert_allclose(found.force[0], [-133.05661886, 72.38990025, 21.93440128], atol=1e-8)
    turned = ml.so3.rotate(water.FRAME, found.torque[0])
    np.testing.assert_allclose(turned, [-11.01499786, -12.78168010, 5.69002955], atol=1e-8)
