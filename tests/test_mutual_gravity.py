"""Gravity and tides of binaries: published end states, direct sums, by hand, and what they conserve."""

from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark, refused, still

import midlie_jax as ml

didymos = benchmark("binaries")
DAY = didymos.DAY
STEP = {"JACOBI[SRKN14a]": 200.0, "GBS12": 300.0}


@pytest.mark.sample(0)
@pytest.mark.parametrize(("case", "method"), [*zip(didymos.ENDS, [*STEP] * 9, strict=False)])
def test_the_known_end_states(case, method):
    """To 1e-10; after 30 days, when a change of the start has grown a million times, to 1e-8."""
    kind, degree, duration = case
    torque, steps = ml.asteroids.MutualGravity(didymos.G, degree=degree), round(duration / STEP[method])
    run = {"dt": duration / steps, "steps": steps, "save_every": None}
    path = ml.integrate(method, didymos.BODY, torque, didymos.start(kind), **run)
    found = didymos.errors(path.states, didymos.ENDS[case])
    assert path.ok
    assert max(found.values()) < (1e-8 if duration > DAY else 1e-10), found


def test_what_is_conserved_of_the_known_case():
    torque, start = ml.asteroids.MutualGravity(didymos.G), didymos.start()
    np.testing.assert_allclose(ml.observe.energy(didymos.BODY, torque, start), didymos.ENERGY, rtol=1e-14)
    scale = np.linalg.norm(didymos.ANGULAR_MOMENTUM)
    np.testing.assert_allclose(ml.observe.spatial_momentum(start), didymos.ANGULAR_MOMENTUM, rtol=0, atol=1e-14 * scale)


def cloud(seed, frame, count=5):
    """A rigid cloud about its centre of mass, its principal axes turned: masses and places of points, and moments."""
    rng = np.random.default_rng(seed)
    mass, x = rng.uniform(0.5, 1.5, count), rng.normal(size=(count, 3))
    x -= mass @ x / mass.sum()
    x = x @ np.linalg.eigh(np.einsum("a,ai,aj->ij", mass, x, x))[1] @ frame.T
    second, third = np.einsum("a,ai,aj->ij", mass, x, x), np.einsum("a,ai,aj,ak->ijk", mass, x, x, x)
    return mass, x, np.trace(second) * np.eye(3) - second, third, np.einsum("a,ai,aj,ak,al->ijkl", mass, x, x, x, x)


def clouds(count, size, turned, degree, strength=1.0):
    """The gravity of several clouds on each other, bound to their body, and their points; or in another frame."""
    frame = ml.so3.to_matrix(ml.so3.exp(jnp.array([0.5, -0.7, 1.1]) if turned else jnp.zeros(3)))
    drawn = zip(*(cloud(seed, np.asarray(frame)) for seed in range(count)), strict=True)
    mass, places, inertia, third, fourth = map(np.stack, drawn)
    inertia = size**2 * inertia
    turning = ml.TensorBody(inertia) if turned else ml.RigidBody(np.diagonal(inertia, axis1=1, axis2=2))
    given = dict([("third", third * size**3), ("fourth", fourth * size**4)][: max(degree - 2, 0)])
    torque = ml.asteroids.MutualGravity(strength, degree=degree, **given)
    return torque.on(ml.FreeBody(turning, mass.sum(1))), mass, places * size


def placed(count):
    rng = np.random.default_rng(5)
    attitude = rng.normal(size=(count, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    position = 5 * np.array([[1.0, 0.2, -0.3], [-0.8, 0.9, 0.1], [0.1, -1.2, 0.9]])[:count]
    return ml.CoupledState(0.1 * rng.normal(size=(count, 3)), attitude, 0.1 * rng.normal(size=(count, 3)), position)


def sum_over_points(mass, places, state):
    """-G m m / distance, with G = 1, over all pairs of points of different bodies."""
    frames = np.asarray(ml.so3.to_matrix(state.attitude))
    points = np.asarray(state.position)[:, None] + np.einsum("nij,naj->nai", frames, places)
    total = 0.0
    for (m, x), (n, y) in combinations(zip(mass, points, strict=True), 2):
        total -= float(np.sum(np.outer(m, n) / np.linalg.norm(x[:, None] - y[None], axis=-1)))
    return total


@pytest.mark.sample(1)
@pytest.mark.parametrize(("count", "turned"), [(2, True), (3, False)])
def test_the_expansion_is_that_of_the_sum_over_all_points(count, turned):
    """A term of degree n leaves an error that goes as the size of the bodies to the power n + 1 or, by chance, more."""
    state = placed(count)
    for degree in (2, 3, 4):
        missed = []
        for size in (0.04, 0.02):
            torque, mass, places = clouds(count, size, turned, degree)
            missed.append(abs(float(torque.potential(0.0, state)) - sum_over_points(mass, places, state)))
        assert np.log2(missed[0] / missed[1]) > degree + 0.7, (degree, missed)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("turned", "degree"), [(False, 3), (True, 4), (False, 0)])
def test_the_wrench_is_that_of_the_potential(turned, degree):
    bound, state = clouds(3, 0.7, turned, degree, strength=0.7)[0], placed(3)
    found, expected = bound(0.0, state), ml.torques.FromPotential(bound.potential)(0.0, state)
    scale = float(jnp.abs(expected.force).max())
    np.testing.assert_allclose(found.force, expected.force, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(found.torque, expected.torque, rtol=0, atol=1e-14 * scale)
    assert (np.abs(found.torque).max() > 0) == (degree > 0)


STILL, UPRIGHT = jax.tree.leaves(still(2))
SUN, AU = 1.32712440018e20, 1.495978707e11
ORBIT = ml.orbits.KeplerOrbit.from_elements(
    mu=SUN, semi_major_axis=1.6446 * AU, eccentricity=0.3839, inclination=0.06, ascending_node=1.28,
    argument_of_periapsis=5.57, mean_anomaly=2.0,
)  # fmt: skip


@pytest.mark.sample(0)
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
        seen = np.asarray(ml.so3.to_matrix(start.attitude[i])).T @ unit
        pulls = 3 * k * mass / 6 * seen * (points @ seen)[:, None]
        np.testing.assert_allclose(wrench.torque[i], np.cross(points, pulls).sum(0), rtol=1e-9)


@pytest.mark.sample(0)
def test_hills_problem_has_the_known_secular_advance():
    """The node of a circular orbit of rate n, inclined by i to the Sun's of rate s, moves by -(3/4) (s^2/n) cos i.

    To leading order in s/n (E. W. Brown, An Introductory Treatise on the Lunar Theory (1896)).
    """
    inclination, ratio, mass = 0.3, 0.01, 1e-12
    pair = ml.FreeBody(ml.RigidBody(np.full((2, 3), 1e-20)), [1.0, mass])
    sun = ml.orbits.CircularOrbit([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], ratio**2)
    momentum = mass * jnp.array([0.0, np.cos(inclination), np.sin(inclination)])
    linear, position = jnp.stack([-momentum, momentum]), [[0.0, 0, 0], [1.0, 0, 0]]
    start = ml.CoupledState(STILL, UPRIGHT, linear, position)
    torque = ml.asteroids.MutualGravity(1.0) + ml.torques.OnEach(ml.asteroids.SolarTide(sun, ratio**2))
    path = ml.integrate("JACOBI[SRKN6b]", pair, torque, start, dt=0.1, steps=25_000, save_every=50)
    normal = jnp.cross(path.states.position[:, 1], path.states.linear[:, 1])
    node = np.unwrap(np.arctan2(normal[:, 0], -normal[:, 1]))
    rate = np.polyfit(path.times, node, 1)[0]
    assert rate == pytest.approx(-0.75 * ratio**2 * np.cos(inclination), rel=0.02)


FRICTION = ml.asteroids.TidalDissipation(didymos.G, lag=[30.0, 10.0], radius=[390.0, 80.0])


@pytest.mark.sample(0)
def test_friction_of_a_circular_orbit_is_that_of_the_book():
    """The torque 3 k tau G m^2 R^5/r^6 (w - n) of a circle (Hut 1981), and none for synchronous rotation."""
    r, n, spin = 1200.0, 1.5e-4, 7.7e-4
    mass, moments = didymos.BODY.mass, didymos.BODY.body.moments
    share = mass[::-1] / mass.sum()
    position = jnp.array([[-1.0, 0, 0], [1.0, 0, 0]]) * r * share[:, None]
    linear = mass[:, None] * n * jnp.stack([-position[:, 1], position[:, 0], position[:, 2]], axis=1)
    rates = jnp.array([[0.0, 0, spin], [0.0, 0, n]])
    state = ml.CoupledState(moments * rates, UPRIGHT, linear, position)
    wrench = FRICTION.on(didymos.BODY)(0.0, state)
    torque = -3 * 30.0 * didymos.G * mass[1] ** 2 * 390.0**5 / r**6 * (spin - n)
    np.testing.assert_allclose(wrench.torque, [[0, 0, torque], [0, 0, 0]], rtol=1e-12, atol=1e-12 * abs(torque))
    np.testing.assert_allclose(wrench.force, [[0, torque / r, 0], [0, -torque / r, 0]], rtol=1e-10, atol=1e-20)


@pytest.mark.sample(0)
def test_friction_takes_the_power_of_the_formula():
    """-3 k tau G m^2 R^5/r^8 (3 (u . v)^2 + |v_t + r x w|^2), summed over both bulges; the momenta stay."""
    rng = np.random.default_rng(5)
    for _ in range(3):
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
            r, spin = np.linalg.norm(way), np.asarray(ml.so3.to_matrix(start.attitude[i]) @ rates[i])
            slip = v + np.cross(way, spin)
            c = 3 * FRICTION.lag[i] * didymos.G * didymos.BODY.mass[j] ** 2 * FRICTION.radius[i] ** 5 / r**8
            expected -= float(c) * (2 * (way @ v / r) ** 2 + slip @ slip)
        assert power == pytest.approx(expected, rel=1e-9)
        turned = ml.so3.rotate(start.attitude, wrench.torque) + jnp.cross(start.position, wrench.force)
        np.testing.assert_allclose(jnp.sum(wrench.force, axis=0), 0, atol=1e-12 * jnp.abs(wrench.force).max())
        np.testing.assert_allclose(jnp.sum(turned, axis=0), 0, atol=1e-12 * jnp.abs(turned).max())


gravity, START = ml.asteroids.MutualGravity, didymos.start()
MANY = ml.CoupledState(*(jnp.tile(x, (5, 1)) for x in jax.tree.leaves(START)))
FREE, ROTOR = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.5]), 1.0), ml.FreeBody(ml.SymmetricRotor(1.0), 1.0)


def go(torque, body=didymos.BODY, start=START, method="JACOBI[EA]"):
    return ml.integrate(method, body, torque, start, dt=1.0, steps=1)


test_what_is_refused = refused(
    (lambda: ml.asteroids.SolarTide(ORBIT, -1.0), "mu must be positive"),
    (lambda: ml.asteroids.TidalDissipation(1.0, -1.0, 1.0), "lag must be finite and not negative"),
    (lambda: FRICTION.on(ml.RigidBody([1.0, 1, 1]))(0.0, START.of_body(0).turning), "CoupledState"),
    (lambda: ml.asteroids.SolarTide(ORBIT, SUN).on(didymos.BODY)(0.0, didymos.start()), "OnEach"),
    (lambda: gravity(1.0, degree=5), "degree must be one of"),
    (lambda: gravity(1.0, third=np.zeros((2, 3, 3, 3))), "degree=2 does not use them"),
    (lambda: gravity(1.0, degree=3), "needs the moments of degree 3"),
    (lambda: gravity(1.0, degree=3, third=np.arange(54.0).reshape(2, 3, 3, 3)), "sym"),
    (lambda: go(gravity(1.0), jax.tree.map(lambda x: x[0], didymos.BODY), START.of_body(0)), "on a CoupledState"),
    (lambda: go(gravity(1.0), FREE, MANY), "2 to 8 bodies"),
    (lambda: go(gravity(1.0), ROTOR, ml.CoupledFreeAxisState.of(START), "SYMMETRIC[EA]"), "CoupledFreeAxisState"),
)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("degree", "short"), [(0, 0.324), (2, 0.121), (4, 0.048)])
def test_near_contact_the_force_is_as_short_as_published(degree, short):
    """A homogeneous spheroid (3, 1, 1) and a ball at the distance 4 on its axis: 0.09241893 (arXiv 2301.10083)."""
    squares = np.array([9.0, 1.0, 1.0])
    moments = np.stack([(squares.sum() - squares) / 5, np.full(3, 1e-9)])
    pair = ml.FreeBody(ml.RigidBody(moments), np.ones(2))
    state = ml.CoupledState(STILL, UPRIGHT, STILL, jnp.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]))
    force = ml.asteroids.MutualGravity(1.0, degree=degree).on(pair)(0.0, state).force[0, 0]
    assert 1 - float(force) / 0.09241893 == pytest.approx(short, abs=5e-4)
