"""Pair forces of molecules and their list of neighbours against sums over all pairs, runs that keep it; rods."""

from functools import partial
from math import pi, sqrt
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import molecules as water
import numpy as np
import pytest
from cases import refused, still
from path_scenes import cast
from scipy.special import erfc

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
    return torque(0.0, state), torque.potential(0.0, state)


def moved(shift):
    return ml.CoupledState(START.momentum, START.attitude, START.linear, START.position + shift)


def pair(distance, charge, sigma, epsilon, a=DAMPING, c=CUTOFF):
    """V and -V' of LAMMPS' coul/dsf and lj/smooth/linear, as its documentation has them."""
    s, pull = (erfc(a * r) / r**2 + 2 * a / sqrt(pi) * np.exp(-((a * r) ** 2)) / r for r in (c, distance))
    energy = charge * (erfc(a * distance) / distance - erfc(a * c) / c + s * (distance - c))

    def lennard_jones(r):
        sixth = (sigma / r) ** 6
        return 4 * epsilon * (sixth**2 - sixth), 24 * epsilon * (2 * sixth**2 - sixth) / r

    (there, force), (at_c, force_at_c) = lennard_jones(distance), lennard_jones(c)
    return energy + there - at_c + (distance - c) * force_at_c, charge * (pull - s) + force - force_at_c


def of_all_pairs(box):
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


def test_a_list_serves_until_a_site_has_moved_by_half_the_skin():
    near, far = (moved(jnp.zeros_like(START.position).at[0, 0].set(x)) for x in (0.049, 0.051))
    (found, energy), (anew, energy_anew) = evaluated(listed(), near), evaluated(listed(near), near)
    np.testing.assert_allclose(found.force, anew.force, atol=1e-9)
    np.testing.assert_allclose(energy, energy_anew, rtol=1e-13)
    failed, lost = evaluated(listed(), far)
    assert jnp.all(jnp.isnan(failed.force))
    assert jnp.isnan(lost)


def test_the_virial_is_the_derivative_of_the_energy_with_the_size_of_the_box():
    def energy(scale):
        """Of rigid molecules, stretched with the box."""
        state = moved((scale - 1) * START.position)
        return evaluated(listed(state, tuple(scale * x for x in BOXES["brick"])), state)[1]

    torque, step = listed(box=BOXES["brick"]), 1e-5
    virial = eqx.filter_jit(lambda torque, state: torque.virial(0.0, state))(torque, START)
    np.testing.assert_allclose(virial, -(energy(1 + step) - energy(1 - step)) / (2 * step), rtol=1e-5)
    body = water.molecules(START.count)
    pressure = ml.molecules.Pressure().of(jnp.array(0.0), START, body, torque)
    kinetic = np.sum(np.sum(np.asarray(START.linear) ** 2, axis=-1) / np.asarray(body.mass)) / 2
    np.testing.assert_allclose(pressure, (2 * kinetic + virial) / (3 * np.prod(torque.box)), rtol=1e-12)


def test_a_custom_energy_gives_the_forces_of_the_same_energy_built_in():
    def lennard_jones(p, q, r):
        sixth = (water.SIGMAS[0] / r) ** 6
        return 4 * water.EPSILONS[0] * (sixth**2 - sixth)

    given = {"energy": lennard_jones}, {"sigmas": water.SIGMAS[:1], "epsilons": water.EPSILONS[:1]}
    both = (ml.molecules.PairForces(POINTS[:1], box=EDGE, cutoff=CUTOFF, **one).listed(START) for one in given)
    (found, energy), (expected, expected_energy) = (evaluated(forces, START) for forces in both)
    np.testing.assert_allclose(found.force, expected.force, atol=1e-11 * float(jnp.max(jnp.abs(expected.force))))
    np.testing.assert_allclose(energy, expected_energy, rtol=1e-12)


def at_distance(r):
    zero, upright = jax.tree.leaves(still(2))
    return ml.CoupledState(zero, upright, zero, zero.at[1, 0].set(r))


@pytest.mark.parametrize(("damping", "single"), [(0.0, False), (2.4, False), (6.0, True), (10.0, False)])
def test_the_damped_force_is_exact_for_every_damping(damping, single):
    given = {"box": 2.0, "cutoff": 1.0, "charges": [1.0], "coulomb": 1.0, "damping": damping, "single": single}
    forces = ml.molecules.PairForces([[0.0, 0.0, 0.0]], **given).listed(at_distance(0.2), skin=2.0)
    found = jax.jit(jax.vmap(lambda r: forces(0.0, at_distance(r)).force[1, 0]))(r := jnp.linspace(0.2, 0.99, 80))
    expected = pair(np.asarray(r), 1.0, 1.0, 0.0, damping, 1.0)[1]
    np.testing.assert_allclose(found, expected, atol=3e-4 if single else 1e-7)


def nitrogen(count=64, edge=2.2):
    """Linear molecules of two sites on a lattice in a box, hot enough to move far in a short run."""
    rng, number = np.random.default_rng(0), round(count ** (1 / 3))
    body, points = ml.molecules.from_points([14.0067, 14.0067], [[0, 0, -0.055], [0, 0, 0.055]])
    axis = rng.normal(size=(count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    lattice = edge / number * np.stack(np.meshgrid(*[np.arange(number)] * 3), axis=-1).reshape(-1, 3)
    momentum = np.cross(axis, 0.3 * rng.normal(size=(count, 3)))
    start = ml.CoupledFreeAxisState(momentum, axis, linear=10 * rng.normal(size=(count, 3)), position=lattice)
    return body, ml.molecules.PairForces(points, box=edge, cutoff=0.9, sigmas=[0.331] * 2, epsilons=[0.299] * 2), start


NITROGEN = nitrogen()


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_run_renews_its_list_and_is_the_run_with_all_neighbours(dtype):
    body, forces, start = cast(NITROGEN, dtype)
    close, options = 1e-8 if dtype == "float64" else 2e-3, {"dt": 0.002, "steps": 160, "save_every": 40}
    whole = ml.integrate("SYMMETRIC[EA]", body, forces.listed(start, skin=1.6), start, **options)
    path = ml.molecules.integrate("SYMMETRIC[EA]", body, forces, start, skin=0.05, **options)
    assert bool(path.ok & whole.ok)
    assert path.states.axis.dtype == dtype
    assert float(np.linalg.norm(path.states.position[-1] - start.position, axis=-1).max()) > 0.1
    for found, expected in zip(jax.tree.leaves(path.states), jax.tree.leaves(whole.states), strict=True):
        np.testing.assert_allclose(found, expected, atol=close * float(jnp.max(jnp.abs(expected))))
    np.testing.assert_allclose(path.times, whole.times, rtol=1e-14)


def test_a_run_of_molecules_goes_on_from_its_carry_and_has_observables_and_noise():
    body, forces, start = NITROGEN
    bath = ml.baths.Langevin(2.5, 1.0, jax.random.key(0), linear_friction=1.0)
    run = partial(ml.molecules.integrate, "SYMMETRIC[BAOAB]", body, forces, dt=0.002, bath=bath)
    observe = {"energy": ml.observe.energy, "pressure": ml.molecules.Pressure()}
    half = run(start, steps=20, save_every=10)
    rest = run(half.carry, steps=20, save_every=10, observe=observe)
    whole = run(start, steps=40, save_every=None)
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


BEGIN = NITROGEN[2]
test_what_is_refused = refused(
    (lambda: Rod(-1.0, ONES, ONES), "length must be positive and finite"),
    (lambda: Rod(1.0, jnp.ones(2), ONES), r"stretch must have shape \(3,\)"),
    (lambda: Rod(1.0, ONES, ONES, clamp=(ONES, jnp.ones(4))), r"clamp\[1\] must be a unit quaternion"),
    (lambda: Rod(jnp.ones(9), ONES, ONES)(0.0, straight(2)[2]), "one for each of 2, got"),
    (lambda: straight(3)[1](0.0, ml.RigidState(jnp.zeros(3), jnp.eye(4)[0])), "the state is a RigidState; use a"),
    (lambda: straight(0), "elements must be a positive Python int"),
    (lambda: ml.molecules.straight_rod(2, [0.0, 0, 0], [0, 0, 1.0], [0, 0, 1.0], **SOFT), "must be at right angles"),
    (lambda: go(BEGIN, ml.torques.Magnus(0.1)), r"torque must contain PairForces.*midlie_jax\.integrate"),
    (lambda: jax.jit(go)(BEGIN), r"must not be traced.*forces\.listed"),
    (lambda: go(jax.tree.map(lambda x: jnp.stack([x, x]), BEGIN)), r"one box, .* with \(2, 64, 3\)"),
    (lambda: go(BEGIN, ml.torques.OnEach(NITROGEN[1])), "Leave out OnEach"),
    (lambda: ml.molecules.Neighbours.of(np.full((3, 1, 3), np.nan), EDGE, CUTOFF), "places must be finite"),
    (lambda: forces_in([EDGE, 1.7, EDGE]), "box must be at least twice the cut-off.*more molecules"),
    (lambda: forces_in(charges=water.CHARGES), "charges must be 2 numbers, one for each point, got 3"),
    (lambda: forces_in(epsilons=[0.5, -0.1]), "epsilons must be finite and"),
    (lambda: forces_in()(0.0, START), r"list of neighbours.*forces\.listed\(start\)"),
    (lambda: ml.molecules.Pressure().of(jnp.array(0.0), START, water.molecules(216), None), "alone for the"),
)


def test_the_dimer_has_the_known_energies_and_forces():
    body, torque = water.molecules(2), ml.torques.FromPotential(water.dimer_energy)
    found, potential = evaluated(torque, water.dimer())
    np.testing.assert_allclose(potential, -14.1713118855, atol=1e-10)
    np.testing.assert_allclose(jnp.sum(ml.observe.kinetic_energy(body, water.dimer())), 2.8302913250, atol=1e-10)
    np.testing.assert_allclose(found.force[0], [-133.05661886, 72.38990025, 21.93440128], atol=1e-8)
    turned = ml.so3.rotate(water.FRAME, found.torque[0])
    np.testing.assert_allclose(turned, [-11.01499786, -12.78168010, 5.69002955], atol=1e-8)


# The cantilever of PyElastica's example: length, radius, density, Young's and shear modulus; the force at its tip.
CANTILEVER = {"length": 3.0, "radius": 0.25, "density": 5000.0, "youngs_modulus": 1e6, "shear_modulus": 1e4}
TIP_FORCE, TIP = 15.0, 0.0677703
Rod, ONES = ml.molecules.Rod, jnp.ones(3)
SOFT = {"length": 2.0, "radius": 0.1, "density": 5.0, "youngs_modulus": 10.0, "shear_modulus": 4.0}


def straight(elements, clamped=False, **sizes):
    ways = [0.0, 0.0, 0.0], [0.0, 0.6, 0.8], [1.0, 0.0, 0.0]
    return ml.molecules.straight_rod(elements, *ways, **(sizes or SOFT), clamped=clamped)


def shaken(start, size):
    increment = np.random.default_rng(0).standard_normal(12 * start.count)
    return start.plus(jnp.asarray(size * increment, start.momentum.dtype))


def varied(rod):
    """The rod with other numbers for each link, and bent and twisted at rest."""
    links, numbers = 5, np.random.default_rng(1)
    stiff = [numbers.uniform(1, 2, (links, 3)) for _ in range(2)]
    at_rest = {name: 0.2 * numbers.standard_normal((links, 3)) for name in ("strain", "curvature")}
    lengths = float(rod.length) * numbers.uniform(0.5, 2, links)
    return Rod(lengths, *stiff, **at_rest, clamp=rod.clamp)


@pytest.mark.parametrize(("size", "clamped"), [(0.0, True), (1e-9, False), (0.7, True), (0.7, False)])
def test_the_wrench_is_minus_the_gradient_of_the_potential(clamped, size):
    _, rod, start = straight(5, clamped)
    state, rod = shaken(start, size), varied(rod)
    found, wanted = jax.jit(lambda s: (rod(0.0, s), ml.torques.FromPotential(rod.potential)(0.0, s)))(state)
    scale = float(jnp.abs(wanted.torque).max())
    np.testing.assert_allclose(found.torque, wanted.torque, rtol=0, atol=1e-13 * scale)
    np.testing.assert_allclose(found.force, wanted.force, rtol=0, atol=1e-13 * scale)
    if not clamped:  # a free rod conserves its momenta
        torques = ml.so3.rotate(state.attitude, found.torque) + jnp.cross(state.position, found.force)
        np.testing.assert_allclose(jnp.sum(found.force, axis=0), 0, atol=1e-13 * scale)
        np.testing.assert_allclose(jnp.sum(torques, axis=0), 0, atol=1e-12 * scale)


def test_the_potential_is_that_of_the_page():
    body, rod, start = straight(5)
    state, rod = shaken(start, 0.5), varied(rod)
    before, length = state.attitude[:-1], rod.length[:, None]
    turn = ml.so3.log(ml.so3.multiply(ml.so3.conjugate(before), state.attitude[1:]))
    middle = ml.so3.multiply(before, ml.so3.exp(turn / 2))
    way = ml.so3.rotate(ml.so3.conjugate(middle), jnp.diff(state.position, axis=0) / length)
    assert rod.strain is not None
    assert rod.curvature is not None
    strain, curvature = way - jnp.array([[0.0, 0.0, 1.0]]) - rod.strain, turn / length - rod.curvature
    total = jnp.sum(length / 2 * (rod.stretch * strain**2 + rod.bend * curvature**2))
    found = ml.observe.energy(body, rod, state) - ml.observe.kinetic_energy(body, state)
    np.testing.assert_allclose(found, total, rtol=1e-13)


def test_the_bodies_make_up_the_rod():
    body, rod, start = straight(8, **CANTILEVER)
    r, length = CANTILEVER["radius"], CANTILEVER["length"]
    mass = CANTILEVER["density"] * np.pi * r**2 * length
    np.testing.assert_allclose(start.position[-1], length * np.array([0.0, 0.6, 0.8]), rtol=1e-14)
    place = np.asarray(start.position)
    distances = np.sum((place - place[4]) ** 2, axis=1)
    turning: Any = body.body
    across = float(np.sum(turning.moments[:, 0] + np.asarray(body.mass) * distances))
    assert across == pytest.approx(mass * (3 * r**2 + length**2) / 12, rel=3.1 / 8**2)
    assert float(turning.moments[:, 2].sum()) == pytest.approx(mass * r**2 / 2)
    turn = np.asarray(ml.so3.to_matrix(start.attitude[3]))
    np.testing.assert_allclose(turn[:, [0, 2]].T, [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]], atol=1e-15)
    held = straight(8, clamped=True, **CANTILEVER)
    assert (rod.clamp, held.start.count) == (None, 8)
    for many, fewer in zip(jax.tree.leaves((body, start)), jax.tree.leaves((held.body, held.start)), strict=True):
        np.testing.assert_array_equal(many[1:], fewer)


def stiffness(rod, start):
    """The second derivative of the potential with turns and places of the bodies, (6 N, 6 N)."""

    @jax.jit
    @jax.jacfwd
    def slope(u):
        turns, places = jnp.split(u.reshape(start.count, 6), 2, axis=1)
        zeros = jnp.zeros((start.count, 3))
        wrench = rod(0.0, start.plus(jnp.concatenate([zeros, turns, zeros, places], axis=1).ravel()))
        return -jnp.concatenate([wrench.torque, wrench.force], axis=1).ravel()

    return np.asarray(slope(jnp.zeros(6 * start.count)))


def test_the_cantilever_of_timoshenko():
    errors = []
    for count in (10, 20):
        _, rod, start = straight(count, clamped=True, **CANTILEVER)
        load = np.zeros((count, 6))
        load[-1, 3] = TIP_FORCE  # along x, which is e1
        moved = np.linalg.solve(stiffness(rod, start), load.ravel()).reshape(count, 6)
        errors.append(moved[-1, 3] - TIP)
    assert abs(errors[-1]) < 1e-3 * TIP
    assert abs(errors[1] - (errors[0] - errors[1]) / 3) < 1e-6 * TIP  # of second order, and the limit is TIP
