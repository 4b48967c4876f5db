"""Cases of spacecraft and free bodies that others publish, each with its source."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import midlie_jax as ml

DEGREE = np.pi / 180
LEVEL = [1.0, 0.0, 0.0, 0.0]


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
    longitude, latitude, phase = np.array([254.0, -12.0, 33.0]) * DEGREE
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
