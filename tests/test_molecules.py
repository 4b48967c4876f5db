"""Pair forces of molecules and their list of neighbours against sums over all pairs; runs that keep the list."""

from math import erfc, exp, pi, sqrt

import equinox as eqx
import jax
import jax.numpy as jnp
import molecules as water
import numpy as np
import pytest
from path_scenes import cast

import midlie_jax as ml

CUTOFF, DAMPING = 0.9, 2.0
START, EDGE = water.box()
SITES = 2  # oxygen and one hydrogen, with all kinds of pairs, compile in half the time
POINTS = water.POINTS[:SITES]
DATA = {"charges": water.CHARGES[:SITES], "sigmas": water.SIGMAS[:SITES], "epsilons": water.EPSILONS[:SITES]}
PLACES = np.asarray(ml.molecules.sites(START, POINTS))
BOXES = {"cube": (EDGE, EDGE, EDGE), "brick": (EDGE, 1.1 * EDGE, 1.3 * EDGE)}


def forces_in(box=EDGE, **more):
    return ml.molecules.PairForces(POINTS, box=box, cutoff=CUTOFF, **{**DATA, **more})


def listed(state=START, box=EDGE, **more):
    return forces_in(box, **more).listed(state, skin=0.1, slots=190)


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


def of_all_pairs(box):
    """Energy, and forces on all sites."""
    energy, forces = 0.0, np.zeros_like(PLACES)
    for p in range(SITES):
        for q in range(SITES):
            d = PLACES[:, None, p] - PLACES[None, :, q]
            d -= box * np.round(d / np.array(box))
            r = np.linalg.norm(d, axis=-1)
            inside = (r < CUTOFF) & ~np.eye(len(r), dtype=bool)
            r = np.where(inside, r, CUTOFF)
            charge = water.COULOMB * water.CHARGES[p] * water.CHARGES[q]
            v, f = pair(r, charge, water.SIGMAS[0], water.EPSILONS[0] if p == q == 0 else 0.0)
            energy += np.sum(np.where(inside, v, 0)) / 2
            forces[:, p] += np.sum(np.where(inside, f / r, 0)[..., None] * d, axis=1)
    return energy, ml.molecules.wrench_on_sites(START, POINTS, forces)


@pytest.mark.parametrize(("box", "single"), [("cube", True), ("brick", False)])
def test_forces_and_energy_are_those_of_all_pairs(single, box):
    found, energy = evaluated(listed(box=BOXES[box], single=single), START)
    expected_energy, expected = of_all_pairs(BOXES[box])
    largest = np.max(np.abs(expected.force))
    np.testing.assert_allclose(energy, expected_energy, rtol=1e-10)
    np.testing.assert_allclose(found.force, expected.force, atol=largest * (1e-5 if single else 1e-11))
    np.testing.assert_allclose(found.torque, expected.torque, atol=largest * (1e-6 if single else 1e-12))
    np.testing.assert_allclose(np.sum(found.force, axis=0), 0, atol=largest * (1e-4 if single else 1e-12))


def test_derivatives_of_the_force_are_symmetric_and_those_of_differences():
    random, torque = np.random.default_rng(1), listed()
    one, other = (jnp.asarray(random.normal(size=START.position.shape)) for _ in range(2))

    def forces(shift):
        return torque(0.0, moved(shift)).force

    def along(d):
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


def scaled(scale, box="brick"):
    """The molecules and the box stretched, the molecules rigid."""
    state = ml.CoupledState(START.momentum, START.attitude, START.linear, scale * START.position)
    return state, listed(state, tuple(scale * x for x in BOXES[box]))


def test_the_virial_is_the_derivative_of_the_energy_with_the_size_of_the_box():
    state, torque = scaled(1.0)
    step = 1e-5
    up, down = (evaluated(*reversed(scaled(1 + x)))[1] for x in (step, -step))
    virial = eqx.filter_jit(lambda torque, state: torque.virial(0.0, state))(torque, state)
    np.testing.assert_allclose(virial, -(up - down) / (2 * step), rtol=1e-5)
    body = water.molecules(START.count)
    pressure = ml.molecules.Pressure().of(jnp.array(0.0), state, body, torque)
    kinetic = np.sum(np.sum(np.asarray(state.linear) ** 2, axis=-1) / np.asarray(body.mass)) / 2
    np.testing.assert_allclose(pressure, (2 * kinetic + virial) / (3 * np.prod(torque.box)), rtol=1e-12)


def test_a_custom_energy_gives_the_forces_of_the_same_energy_built_in():
    def lennard_jones(p, q, r):
        del q
        sixth = (water.SIGMAS[0] / r) ** 6
        return 4 * (water.EPSILONS[0] if p == 0 else 0.3) * (sixth**2 - sixth)

    both = {"sigmas": [water.SIGMAS[0]] * 2, "epsilons": [water.EPSILONS[0], 0.3]}
    first = {"charges": None, "sigmas": None, "epsilons": None}
    alone = ml.molecules.PairForces(POINTS[:1], box=EDGE, cutoff=CUTOFF, **{k: v[:1] for k, v in both.items()})
    own = ml.molecules.PairForces(POINTS[:1], box=EDGE, cutoff=CUTOFF, energy=lennard_jones, **first)
    (found, energy), (expected, expected_energy) = (evaluated(f.listed(START), START) for f in (own, alone))
    np.testing.assert_allclose(found.force, expected.force, atol=1e-11 * float(jnp.max(jnp.abs(expected.force))))
    np.testing.assert_allclose(energy, expected_energy, rtol=1e-12)


def at_distance(r, dtype=jnp.float64):
    still = jnp.zeros((2, 3), dtype)
    upright = jnp.tile(jnp.array([1.0, 0, 0, 0], dtype), (2, 1))
    return ml.CoupledState(still, upright, still, still.at[1, 0].set(r))


@pytest.mark.parametrize(
    ("damping", "single"), [(0.0, False), (1.0, True), (2.4, False), (3.5, False), (6.0, True), (10.0, False)]
)
def test_the_damped_force_is_exact_for_every_damping(damping, single):
    torque = ml.molecules.PairForces(
        [[0.0, 0.0, 0.0]], box=2.0, cutoff=1.0, charges=[1.0], coulomb=1.0, damping=damping, single=single
    )
    forces = torque.listed(at_distance(0.2), skin=2.0)
    found = jax.jit(jax.vmap(lambda r: forces(0.0, at_distance(r)).force[1, 0]))(r := jnp.linspace(0.2, 0.99, 80))

    def pull(r):
        return erfc(damping * r) / r**2 + 2 * damping / sqrt(pi) * exp(-((damping * r) ** 2)) / r

    expected = np.array([pull(float(x)) for x in r]) - pull(1.0)
    np.testing.assert_allclose(found, expected, atol=3e-4 if single else 1e-7)


def nitrogen(count=64, edge=2.2, seed=0):
    """Linear molecules of two sites on a lattice in a box, hot enough to move far in a short run."""
    rng, number = np.random.default_rng(seed), round(count ** (1 / 3))
    body, points = ml.molecules.from_points([14.0067, 14.0067], [[0, 0, -0.055], [0, 0, 0.055]])
    axis = rng.normal(size=(count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    lattice = edge / number * np.stack(np.meshgrid(*[np.arange(number)] * 3), axis=-1).reshape(-1, 3)
    momentum = np.cross(axis, 0.3 * rng.normal(size=(count, 3)))
    start = ml.CoupledFreeAxisState(momentum, axis, linear=10 * rng.normal(size=(count, 3)), position=lattice)
    return body, ml.molecules.PairForces(points, box=edge, cutoff=0.9, sigmas=[0.331] * 2, epsilons=[0.299] * 2), start


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_run_renews_its_list_and_is_the_run_with_all_neighbours(dtype):
    """In float32 to its rounding."""
    body, forces, start = cast(nitrogen(), dtype)
    close = 1e-8 if dtype == "float64" else 2e-3
    options = {"dt": 0.002, "steps": 160}
    whole = ml.integrate("SYMMETRIC[EA]", body, forces.listed(start, skin=1.6), start, save_every=40, **options)
    path = ml.molecules.integrate("SYMMETRIC[EA]", body, forces, start, skin=0.05, save_every=40, **options)
    assert bool(path.ok)
    assert bool(whole.ok)
    assert path.states.axis.dtype == dtype
    first = forces.listed(start, skin=0.05).neighbours
    assert float(first.moved(ml.molecules.sites(jax.tree.map(lambda x: x[-1], path.states), forces.points))) > 0.1
    for found, expected in zip(jax.tree.leaves(path.states), jax.tree.leaves(whole.states), strict=True):
        np.testing.assert_allclose(found, expected, atol=close * float(jnp.max(jnp.abs(expected))))
    np.testing.assert_allclose(path.times, whole.times, rtol=1e-14)


def test_a_run_of_molecules_goes_on_from_its_carry_and_has_observables_and_noise():
    body, forces, start = nitrogen()
    bath = ml.baths.Langevin(2.5, 1.0, jax.random.key(0), linear_friction=1.0)
    observe = {"energy": ml.observe.energy, "pressure": ml.molecules.Pressure()}
    options = {"dt": 0.002, "bath": bath}
    half = ml.molecules.integrate("SYMMETRIC[BAOAB]", body, forces, start, steps=20, save_every=10, **options)
    rest = ml.molecules.integrate(
        "SYMMETRIC[BAOAB]", body, forces, half.carry, steps=20, save_every=10, observe=observe, **options
    )
    whole = ml.molecules.integrate("SYMMETRIC[BAOAB]", body, forces, start, steps=40, save_every=None, **options)
    assert int(rest.carry.index) == 40
    np.testing.assert_allclose(rest.times, [0.04, 0.06, 0.08], rtol=1e-12)
    np.testing.assert_allclose(whole.times, 0.08, rtol=1e-12)
    last = forces.listed(whole.states)
    energy = ml.observe.energy(body, last, whole.states)
    np.testing.assert_allclose(rest.states["energy"][-1], energy, rtol=1e-9)
    pressure = ml.molecules.Pressure().of(jnp.array(0.0), whole.states, body, last)
    np.testing.assert_allclose(rest.states["pressure"][-1], pressure, rtol=1e-7)


def test_a_run_that_fails_says_why_and_repeats_its_last_values():
    path = go(BEGIN, dt=1.0, steps=6, save_every=2)
    assert not path.ok
    assert path.result != ml.RESULTS.successful
    assert int(path.first_bad) == 1
    assert path.times.shape == (4,)


def go(start, forces=None, **options):
    body, own, _ = NITROGEN
    return ml.molecules.integrate("SYMMETRIC[EA]", body, forces or own, start, **{"dt": 0.1, "steps": 2, **options})


NITROGEN = nitrogen()
BEGIN = NITROGEN[2]
REFUSED = [
    (lambda: go(BEGIN, ml.torques.Magnus(0.1)), r"torque must contain PairForces.*midlie_jax\.integrate"),
    (lambda: jax.jit(go)(BEGIN), r"must not be traced.*forces\.listed"),
    (lambda: go(jax.tree.map(lambda x: jnp.stack([x, x]), BEGIN)), r"one box, .* with \(2, 64, 3\)"),
    (lambda: go(BEGIN, ml.torques.OnEach(NITROGEN[1])), "Leave out OnEach"),
    (lambda: ml.molecules.Neighbours.of(np.full((3, 1, 3), np.nan), EDGE, CUTOFF), "places must be finite"),
    (lambda: forces_in([EDGE, 1.7, EDGE]), "box must be at least twice the cut-off.*more molecules"),
    (lambda: forces_in(charges=water.CHARGES), "charges must be 2 numbers, one for each point, got 3"),
    (lambda: forces_in(epsilons=[0.5, -0.1]), "epsilons must be finite and"),
    (lambda: forces_in()(0.0, START), r"list of neighbours.*forces\.listed\(start\)"),
    (lambda: ml.molecules.Pressure().of(jnp.array(0.0), START, water.molecules(216), None), "alone for the pressure"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_what_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


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
