"""Tides of binaries: by hand, by their potential, by differences of the Sun's gravity, and what they conserve."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark

import midlie_jax as ml
from midlie_jax.model import so3

didymos = benchmark("binaries")
STILL = ml.RigidState(jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0]))
SUN, AU = 1.32712440018e20, 1.495978707e11
ORBIT = ml.orbits.KeplerOrbit.from_elements(
    mu=SUN, semi_major_axis=1.6446 * AU, eccentricity=0.3839, inclination=0.06, ascending_node=1.28,
    argument_of_periapsis=5.57, mean_anomaly=2.0,
)  # fmt: skip


def test_the_force_is_the_difference_of_the_gravity_of_the_sun_and_the_torque_that_of_points():
    """Of six points with the body's moments, to the relative size of what the first order leaves out."""
    tide = ml.torques.OnEach(ml.asteroids.SolarTide(ORBIT, SUN))
    start = didymos.start("tilted")
    wrench = tide.on(didymos.BODY)(4e5, start)
    sun = np.asarray(ORBIT(4e5))
    unit = sun / np.linalg.norm(sun)
    for i in range(2):
        mass, moments = float(didymos.BODY.mass[i]), np.asarray(didymos.BODY.body.moments[i])
        x, k = np.asarray(start.position[i]), SUN / np.linalg.norm(sun) ** 3
        np.testing.assert_allclose(wrench.force[i], mass * k * (3 * unit * (unit @ x) - x), rtol=1e-12)
        arms = np.sqrt(3 * (moments.sum() / 2 - moments) / mass)  # six points of mass m/6 at these distances
        points = np.concatenate([np.diag(arms), -np.diag(arms)])
        seen = np.asarray(so3.to_matrix(start.attitude[i])).T @ unit
        pulls = 3 * k * mass / 6 * seen * (points @ seen)[:, None]
        np.testing.assert_allclose(wrench.torque[i], np.cross(points, pulls).sum(0), rtol=1e-9)


def test_hills_problem_has_the_known_secular_advance():
    """A wide circular pair that the Sun makes precess: rates of orbit and node follow perturbation theory.

    A circular orbit has the rate n and the inclination i to the orbit of the Sun, whose rate is s. Its node moves by
    -(3/4) (s^2/n) cos i to leading order in s/n (E. W. Brown, An Introductory Treatise on the Lunar Theory (1896)).
    """
    distance, inclination, ratio = 1.0, 0.3, 0.01
    masses = np.array([1.0, 1e-12])
    pair = ml.FreeBody(ml.RigidBody(np.full((2, 3), 1e-20)), masses)
    sun = ml.orbits.CircularOrbit([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], ratio**2)
    still = jnp.zeros((2, 3))
    position = jnp.array([[0.0, 0, 0], [distance, 0, 0]])
    momentum = masses[1] * jnp.array([0.0, np.cos(inclination), np.sin(inclination)])
    start = ml.CoupledState(
        still, jnp.tile(jnp.array([1.0, 0, 0, 0]), (2, 1)), jnp.stack([-momentum, momentum]), position
    )
    torque = ml.asteroids.MutualGravity(1.0) + ml.torques.OnEach(ml.asteroids.SolarTide(sun, ratio**2))
    path = ml.integrate("JACOBI[SRKN6b]", pair, torque, start, dt=0.1, steps=25_000, save_every=50)
    normal = jnp.cross(path.states.position[:, 1], path.states.linear[:, 1])
    node = np.unwrap(np.arctan2(normal[:, 0], -normal[:, 1]))
    rate = np.polyfit(path.times, node, 1)[0]
    assert rate == pytest.approx(-0.75 * ratio**2 * np.cos(inclination), rel=0.02)


FRICTION = ml.asteroids.TidalDissipation(didymos.G, lag=[30.0, 10.0], radius=[390.0, 80.0])


def test_friction_of_a_circular_orbit_is_that_of_the_book():
    """The torque 3 k tau G m^2 R^5/r^6 (w - n) of a circle (Hut 1981), and none for synchronous rotation."""
    r, n, spin = 1200.0, 1.5e-4, 7.7e-4
    mass, moments = didymos.BODY.mass, didymos.BODY.body.moments
    share = mass[::-1] / mass.sum()
    position = jnp.array([[-1.0, 0, 0], [1.0, 0, 0]]) * r * share[:, None]
    linear = mass[:, None] * n * jnp.stack([-position[:, 1], position[:, 0], position[:, 2]], axis=1)
    rates = jnp.array([[0.0, 0, spin], [0.0, 0, n]])
    upright = jnp.tile(jnp.array([1.0, 0, 0, 0]), (2, 1))
    state = ml.CoupledState(moments * rates, upright, linear, position)
    wrench = FRICTION.on(didymos.BODY)(0.0, state)
    torque = -3 * 30.0 * didymos.G * mass[1] ** 2 * 390.0**5 / r**6 * (spin - n)
    np.testing.assert_allclose(wrench.torque, [[0, 0, torque], [0, 0, 0]], rtol=1e-12, atol=1e-12 * abs(torque))
    np.testing.assert_allclose(wrench.force, [[0, torque / r, 0], [0, -torque / r, 0]], rtol=1e-10, atol=1e-20)


def test_friction_keeps_the_total_momenta():
    torque, run = ml.asteroids.MutualGravity(didymos.G) + FRICTION, {"dt": 100.0, "steps": 2000, "save_every": 200}
    path = ml.integrate("JACOBI[EA]", didymos.BODY, torque, didymos.start("tilted"), **run)
    total = np.asarray(ml.observe.spatial_momentum(path.states))
    assert np.abs(total - total[0]).max() < 1e-13 * np.linalg.norm(total[0])
    np.testing.assert_allclose(
        jnp.sum(path.states.linear, axis=1), 0, atol=1e-12 * float(jnp.abs(path.states.linear).max())
    )


def test_friction_takes_the_power_of_the_formula():
    """-3 k tau G m^2 R^5/r^8 (3 (u . v)^2 + |v_t + r x w|^2), summed over both bulges; always a loss."""
    rng = np.random.default_rng(5)
    for _ in range(10):
        start = didymos.start("tilted")
        start = ml.CoupledState(
            start.momentum * rng.uniform(-2, 2, (2, 3)), start.attitude, start.linear * rng.uniform(-2, 2, (2, 3)),
            start.position * rng.uniform(0.8, 2),
        )  # fmt: skip
        wrench = FRICTION.on(didymos.BODY)(0.0, start)
        rates = start.momentum / didymos.BODY.body.moments
        speeds = start.linear / didymos.BODY.mass[:, None]
        power = float(jnp.sum(wrench.torque * rates) + jnp.sum(wrench.force * speeds))
        expected = 0.0
        for i, j in ((0, 1), (1, 0)):
            way, v = np.asarray(start.position[j] - start.position[i]), np.asarray(speeds[j] - speeds[i])
            r, spin = np.linalg.norm(way), np.asarray(so3.to_matrix(start.attitude[i]) @ rates[i])
            slip = v + np.cross(way, spin)
            c = 3 * FRICTION.lag[i] * didymos.G * didymos.BODY.mass[j] ** 2 * FRICTION.radius[i] ** 5 / r**8
            expected -= float(c) * (2 * (way @ v / r) ** 2 + slip @ slip)
        assert power == pytest.approx(expected, rel=1e-9)
        assert power < 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: ml.asteroids.SolarTide(ORBIT, -1.0), "mu must be positive"),
        (lambda: ml.asteroids.TidalDissipation(1.0, -1.0, 1.0), "lag must be finite and not negative"),
        (lambda: FRICTION.on(ml.RigidBody([1.0, 1, 1]))(0.0, STILL), "CoupledState"),
        (lambda: ml.asteroids.SolarTide(ORBIT, SUN).on(didymos.BODY)(0.0, didymos.start()), "OnEach"),
    ],
)
def test_what_is_wrong_is_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()
