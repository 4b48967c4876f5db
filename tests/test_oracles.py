"""The two oracles against each other and published figures: closed form and Taylor series; published cases."""

from itertools import permutations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import LEVEL
from laboratory.free_body import free_body
from laboratory.rivals import matrix
from scipy.spatial.transform import Rotation
from test_scenes import ENDS

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.cli.oracle import exact_motion


def gap(motion, reference, scale):
    """Largest relative difference of the one state in each; the quaternion's sign counts."""
    momenta, attitudes = (np.abs(one[0] - other[0]) for one, other in zip(motion, reference, strict=True))
    return max(np.max(momenta) / scale, np.max(attitudes))


NEARLY = 1 + 4 * np.finfo(float).eps
EQUAL = [(2.0, 2.0, 3.0), (3.0, 2.0, 2.0), (2.0, 3.0, 2.0), (2.0, 3.0, 3.0), (2.0, 3.0, 3.0 / NEARLY)]
EQUAL += [*permutations((2.0, 2.0 * NEARLY, 3.0)), (2.0, 2.0, 2.0), (2.0 / NEARLY, 2.0, 2.0 * NEARLY)]
ACROSS = [(2.0, 2.0, 3.0), (2.0, 2.0 * NEARLY, 3.0), (2.0, 2.0 + 1e-9, 3.0)]


def random_body(seed):
    """Moments in any order, also beyond the triangle inequality."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(size=3)), rng.normal(size=3), rng.uniform(-6, 6), rng.normal(size=4)


def on_the_separatrix(order, signs, off):
    """2 H I2 = |Pi|^2 to the last bit: with moments 0.75, 1, 1.5 that is Pi1 = Pi3. The marks 1, 2, 3 fix the order."""
    table = {1: 0.75, 2: 1.0, 3: 1.5}
    values = {1: signs[0] * 0.5 * (1 + off), 2: 0.25, 3: signs[1] * 0.5}
    return [table[m] for m in order], [values[m] for m in order], 20.0


def near_an_axis(moments, axis, off):
    momentum = np.array([off, -off, off])
    momentum[axis] = -1.5
    return moments, momentum, 4.0


FREE = {
    "any body": [random_body(seed) for seed in range(5)],
    "equal moments": [(moments, (0.7, -1.1, 0.4), 5.0, (0.5, -0.5, 0.1, 0.7)) for moments in EQUAL],
    "spin across the axis of symmetry": [(moments, (0.7, -1.1, z), 5.0) for moments in ACROSS for z in (0.0, 1e-12)],
    "principal axes": [near_an_axis((1.0, 2.0, 3.5), k, off) for k in range(3) for off in (0.0, 1e-13, 1e-5)],
    "the separatrix": [
        on_the_separatrix(order, signs, off)
        for order, signs in (((1, 2, 3), (1, 1)), ((3, 1, 2), (-1, 1)), ((3, 1, 2), (1, -1)))
        for off in (0.0, 1e-6, -1e-10, 1e-14)
    ],
    "a ratio of a million": [(m, np.sqrt(m) * (0.3, 1.0, -0.8), 3.0) for m in ((1.0, 1e3, 1e6), (1e6, 1.0, 1e3))],
}


@pytest.mark.parametrize("kind", FREE)
def test_the_closed_form_of_a_free_body_agrees_with_the_taylor_series(kind):
    for moments, momentum, time, *attitude in FREE[kind]:
        given = moments, momentum, *(attitude or [LEVEL]), [time]
        assert gap(free_body(*given), exact_motion(*given), float(np.linalg.norm(momentum))) < 3e-15, given


def test_free_bodies_published():
    start = (-0.709894965287627, -0.685144717153487, 0.163174308075589)
    moments, end = (
        (1, 1.648785782711929, 1.9720127096641928),
        (-0.7088447919224319, -0.6905148054187735, 0.1439734852739128),
    )
    momenta, _ = free_body(moments, start, LEVEL, [0.1])
    np.testing.assert_allclose(momenta[0], end, atol=2e-15)
    run = ml.integrate("JACOBI[EA]", ml.RigidBody(moments), None, ml.RigidState(start, LEVEL), dt=1e-3, steps=100)
    np.testing.assert_allclose(run.states.momentum[-1], end, rtol=0, atol=1e-14)
    start = (-0.609860759302936, 0.761660947972381, 0.218957654801698)
    momenta, attitudes = free_body((1, 1.012686988782515, 3.306237422473038), start, LEVEL, [10.0])
    np.testing.assert_allclose(momenta[0], (-0.7243786338874610, -0.6515663606923394, 0.2252484681001733), atol=2e-15)
    third = (-0.6484702022780026, -0.0046633029105, -0.7612257551892809)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], third, atol=1e-13)
    momenta, _ = free_body((0.6, 0.8, 1), (1.8, 0.4, -0.9), LEVEL, [10.0])
    np.testing.assert_allclose(momenta[0], (1.76596250851821, -0.695464197033089, 0.779554981481871), atol=1e-14)
    momenta, attitudes = free_body((0.75, 1.0, 1.5), (0.5, 0.25, 0.5), LEVEL, [-300.0, 300.0])  # on the separatrix
    np.testing.assert_allclose(momenta, [[0, -0.75, 0], [0, 0.75, 0]], atol=1e-15)


# ---- the Taylor series of tops ----


@pytest.mark.parametrize(
    ("name", "time", "momentum", "axis"), [(n, t, *end) for n, _, t, *end, k in ENDS if n[0] == "P"]
)
def test_tops_published(name, time, momentum, axis):
    scene = scenes.scene(name)
    given = scene.body.moments, scene.start.momentum, scene.start.attitude, [time]
    momenta, attitudes = exact_motion(*given, weight=float(scene.torque.mgl))
    np.testing.assert_allclose(momenta[0], momentum, atol=1e-14)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], axis, atol=1e-14)


def test_a_heavy_body_keeps_its_laws_and_motions_compose():
    """Any moments and any axis; the second motion goes back in time."""
    rng = np.random.default_rng(200)
    moments, start, axis, weight = np.exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3), rng.normal() * 3
    attitude = rng.normal(size=4)
    attitude /= np.linalg.norm(attitude)
    force = {"weight": weight, "axis": axis}

    def laws(pi, q):
        return np.sum(pi**2 / moments) / 2 + weight * (matrix(q) @ axis)[2], (matrix(q) @ pi)[2]

    momenta, attitudes = exact_motion(moments, start, attitude, [4.0, -2.5], **force)
    for pi, q in zip(momenta, attitudes, strict=True):
        np.testing.assert_allclose(laws(pi, q), laws(start, attitude), rtol=0, atol=1e-13)
    back = exact_motion(moments, momenta[0], attitudes[0], [-6.5], **force)
    assert gap(back, (momenta[1:], attitudes[1:]), np.linalg.norm(start)) < 1e-12
    # Numbers as of molecules in SI units move as numbers of size 1, by powers of 2 that change no digit.
    small, short = 2.0**-150, 2.0**-40
    units = small / short
    force = {"weight": weight * units / short, "axis": axis}
    found = exact_motion(small * moments, units * start, attitude, [4.0 * short], **force)
    assert gap((found[0] / units, found[1]), (momenta[:1], attitudes[:1]), 1.0) < 1e-14


# ---- cases of spacecraft and free bodies that others publish, each with its source ----


def test_the_moments_of_echostar_ii_from_its_parts():
    """A box and two panels (B. Wie): 9512.47, 1771.27 and 9608.57 kg m^2."""

    def box(mass, x, y, z):
        return ml.RigidBody([mass * (y**2 + z**2) / 12, mass * (z**2 + x**2) / 12, mass * (x**2 + y**2) / 12])

    panels = [(box(60.0, 3.1, 8.5, 0.0), 60.0, [0.0, y, 0.0]) for y in (-7.7, 7.7)]
    craft: Any
    craft, centre = ml.FreeBody.joined([(box(1900.0, 2.3, 2.3, 2.3), 1900.0, [0.0, 0.0, 0.0]), *panels])
    np.testing.assert_allclose(np.diag(craft.body.tensor), [9512.47, 1771.27, 9608.57], atol=0.005)
    np.testing.assert_allclose(centre, 0, atol=1e-15)


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1], [1, 0, 2]])
def test_a_free_body_of_orekit(order):
    """`TorqueFreeTest`: the spatial momentum stays, and the body momentum has a period of 686.15256 s."""
    body = ml.RigidBody(np.array([3 / 8, 1 / 2, 5 / 8])[order])
    start = ml.RigidState.from_velocity(body, np.array([0.05, 0.0, 0.04])[order], LEVEL)
    states = ml.free_motion(body, start, jnp.linspace(-40.0, 40.0, 81)).states
    spatial = np.asarray(ml.observe.spatial_momentum(states))
    size = np.linalg.norm(start.momentum)
    assert np.abs(spatial - np.asarray(start.momentum)).max() < 2e-15 * size * 10
    after = ml.free_motion(body, start, jnp.array([686.15256])).states.momentum[0]
    np.testing.assert_allclose(after, start.momentum, atol=2.6e-9)  # half of the last digit


def test_nearly_degenerate_free_bodies_of_principia():
    """`euler_solver_test`: a period near the separatrix, a rate of two equal moments, and finite at the ends."""
    body, start = ml.RigidBody([3.0, 5.0, 9.0], physical=False), ml.MomentumState([0.0, 2.0, 0.01])
    times = 118.11089 * jnp.array([0.5, 1.0])
    half, whole = ml.free_motion(body, start, times).states.momentum
    np.testing.assert_allclose(whole, start.momentum, atol=2e-7)
    np.testing.assert_allclose(half, start.momentum * jnp.array([1.0, -1.0, -1.0]), atol=0.03)
    symmetric = ml.RigidBody([3.0, 3.0, 9.0], physical=False)
    quarter = np.pi / 2 / 1.5555556
    turned = ml.free_motion(symmetric, ml.MomentumState([0.0, 5.0, 7.0]), jnp.array([quarter])).states.momentum[0]
    np.testing.assert_allclose(np.abs(turned), [5.0, 0.0, 7.0], atol=1e-6)
    for momentum in ([1e-300, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]):
        path = ml.free_motion(ml.RigidBody([2.0, 3.0, 5.0]), ml.RigidState(momentum, LEVEL), jnp.array([3.0]))
        assert bool(jnp.all(path.ok))


def test_the_box_of_the_boxes_benchmark():
    """S. Peters' boxes: 10 s of free flight under gravity; energy 368.5464167 J, position (-20, 20, -410) m."""
    body = ml.FreeBody(ml.RigidBody([0.80833333, 0.68333333, 0.14166667]), 10.0)
    start = ml.FreeState.from_velocity(body, [0.1, 5.0, 0.1], LEVEL, [-2.0, 2.0, 8.0], [0.0, 0.0, 0.0])
    weight = ml.torques.UniformGravity([0.0, 0.0, -9.8])
    path = ml.integrate("JACOBI[EA]", body, weight, start, dt=0.01, steps=1000, save_every=100)
    assert float(ml.observe.kinetic_energy(body, start)) == pytest.approx(368.5464167, abs=2e-7)
    energy = np.asarray(ml.observe.energy(body, weight, path))
    np.testing.assert_allclose(energy, energy[0], rtol=1e-11)  # of terms a hundred times larger
    np.testing.assert_allclose(path.states.position[-1], [-20.0, 20.0, -410.0], atol=1e-10)


def test_a_spin_state_of_damit():
    """Rz(lambda) Ry(90 deg - beta) Rz(phi) of its documentation, by SciPy; the pole is at (lambda, beta)."""
    longitude, latitude, phase = np.array([254.0, -12.0, 33.0]) * np.pi / 180
    found = ml.so3.to_matrix(ml.so3.from_euler(jnp.array([longitude, np.pi / 2 - latitude, phase]), "ZYZ"))
    z, y = (lambda angle: Rotation.from_euler("z", angle)), Rotation.from_euler("y", np.pi / 2 - latitude)
    np.testing.assert_allclose(found, (z(longitude) * y * z(phase)).as_matrix(), atol=1e-15)
    pole = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)
    np.testing.assert_allclose(found[:, 2], pole, atol=1e-15)


def test_sunlight_on_a_plate_of_orts():
    """orts issue 377: specular 0.2, diffuse 0.1, the Sun at 45 degrees; the force over flux A / c."""
    plate = ml.Surface.of_facets([1.0], [[0.0, 0.0, 1.0]], [[0.0, 0.0, 0.0]])
    sun = jnp.sqrt(0.5) * jnp.array([1.0, 0.0, 1.0])
    still = ml.FreeState(jnp.zeros(3), jnp.array(LEVEL), jnp.zeros(3), jnp.zeros(3))
    force = ml.asteroids.Sunlight(plate, sun, 1.0, 0.2, 0.1, speed_of_light=1.0)(0.0, still).force
    np.testing.assert_allclose(force, [-0.4, 0.0, -0.6471405], atol=1e-7)


@pytest.mark.parametrize(
    ("rate", "angles", "rates"),
    [
        (0.0, [2.0554015, 10.5918203, 21.0314689], [0.4210376, 0.4646720, 0.3483206]),
        (2.0, [9.6839372, 34.0124943, 65.9607367], [1.8460614, 0.9433829, 1.1709812]),
    ],
)
def test_hyperion_in_the_plane_of_its_orbit(rate, angles, rates):
    """C. Hill, scipython.com, problem 8.2.7; its unit of rates is the momentum of the orbit over a^2."""
    unit = np.sqrt(1 - 0.1**2)
    orbit = ml.orbits.KeplerOrbit([0.9, 0.0, 0.0], [0.0, np.sqrt(1.1 / 0.9), 0.0], 1.0)
    body = ml.RigidBody([0.6, 0.865, 1.0])
    pull = ml.spacecraft.GravityGradient(None, orbit, 1.0)
    start = ml.RigidState([0.0, 0.0, rate * unit], LEVEL)
    path = ml.integrate("JACOBI[SRKN14a]", body, pull, start, dt=2 * np.pi / 100, steps=1000, save_every=100)
    ends = jax.tree.map(lambda x: x[jnp.array([1, 5, 10])], path.states)
    np.testing.assert_allclose(ends.momentum[:, 2] / unit, rates, atol=2e-7)
    turned = 2 * np.arctan2(ends.attitude[:, 3], ends.attitude[:, 0])
    np.testing.assert_allclose((turned - angles + np.pi) % (2 * np.pi), np.pi, atol=2e-7)
