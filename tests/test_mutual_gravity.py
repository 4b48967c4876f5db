"""The gravity of rigid bodies on each other: published end states, direct sums, conservation, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark, quick

import midlie_jax as ml

didymos = benchmark("binaries")
DAY = didymos.DAY


STEP = {"JACOBI[SRKN14a]": 200.0, "GBS12": 300.0}
KNOWN = [*zip(didymos.ENDS, [*STEP] * 9, strict=False)]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("case", "method"), KNOWN)
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


def cloud(seed, count=5):
    """A rigid cloud of points about its centre of mass, in its principal axes: masses, places and moments."""
    rng = np.random.default_rng(seed)
    mass, x = rng.uniform(0.5, 1.5, count), rng.normal(size=(count, 3))
    x -= mass @ x / mass.sum()
    second = np.einsum("a,ai,aj->ij", mass, x, x)
    x = x @ np.linalg.eigh(second)[1]
    second = np.einsum("a,ai,ai->i", mass, x, x)
    third = np.einsum("a,ai,aj,ak->ijk", mass, x, x, x)
    return mass, x, second.sum() - second, third, np.einsum("a,ai,aj,ak,al->ijkl", mass, x, x, x, x)


def clouds(count, size, frame=None):
    """The body of several clouds with its moments, and their points; in another frame of each body, if given."""
    parts = [cloud(seed) for seed in range(count)]
    third = np.stack([p[3] for p in parts]) * size**3
    fourth = np.stack([p[4] for p in parts]) * size**4
    moments, places = np.stack([p[2] for p in parts]) * size**2, np.stack([p[1] for p in parts]) * size
    turning = ml.RigidBody(moments)
    if frame is not None:
        places = places @ frame.T
        third = np.einsum("ia,jb,kc,nabc->nijk", frame, frame, frame, third)
        fourth = np.einsum("ia,jb,kc,ld,nabcd->nijkl", frame, frame, frame, frame, fourth)
        turning = ml.TensorBody(np.einsum("ia,na,ja->nij", frame, moments, frame))
    mass = np.stack([p[0] for p in parts])
    return ml.FreeBody(turning, mass.sum(1)), third, fourth, mass, places


def placed(count, seed=5):
    rng = np.random.default_rng(seed)
    attitude = rng.normal(size=(count, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    position = 5 * np.array([[1.0, 0.2, -0.3], [-0.8, 0.9, 0.1], [0.1, -1.2, 0.9]])[:count]
    return ml.CoupledState(0.1 * rng.normal(size=(count, 3)), attitude, 0.1 * rng.normal(size=(count, 3)), position)


def sum_over_points(mass, places, state):
    """-G m m / distance, with G = 1, over all pairs of points of different bodies."""
    frames = np.asarray(ml.so3.to_matrix(state.attitude))
    points = np.asarray(state.position)[:, None] + np.einsum("nij,naj->nai", frames, places)
    total = 0.0
    for i in range(len(mass)):
        for j in range(i):
            distance = np.linalg.norm(points[i][:, None] - points[j][None], axis=-1)
            total -= float(np.sum(mass[i][:, None] * mass[j][None] / distance))
    return total


@pytest.mark.parametrize(("count", "turned"), [(2, True), (3, False)])
def test_the_expansion_is_that_of_the_sum_over_all_points(count, turned):
    """A term of degree n leaves an error that goes as the size of the bodies to the power n + 1 or, by chance, more."""
    frame = np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.array([0.5, -0.7, 1.1])))) if turned else None
    state = placed(count)
    for degree in (2, 3, 4):
        missed = []
        for size in (0.04, 0.02):
            body, third, fourth, mass, places = clouds(count, size, frame)
            given = {"third": third} if degree > 2 else {}
            given |= {"fourth": fourth} if degree > 3 else {}
            torque = ml.asteroids.MutualGravity(1.0, degree=degree, **given)
            missed.append(abs(float(torque.on(body).potential(0.0, state)) - sum_over_points(mass, places, state)))
        assert np.log2(missed[0] / missed[1]) > degree + 0.7, (degree, missed)


@pytest.mark.sample(2)
@pytest.mark.parametrize(("kind", "degree"), [("ellipsoids", 0), ("frames", 2), ("clouds", 3), ("frames", 4)])
def test_the_wrench_is_that_of_the_potential(kind, degree):
    frame = np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.array([0.5, -0.7, 1.1])))) if kind == "frames" else None
    body, third, fourth, *_ = clouds(3, 0.7, frame)
    given = {"third": third} if degree > 2 else {}
    given |= {"fourth": fourth} if degree > 3 else {}
    bound, state = ml.asteroids.MutualGravity(0.7, degree=degree, **given).on(body), placed(3)
    found, expected = bound(0.0, state), ml.torques.FromPotential(bound.potential)(0.0, state)
    scale = float(jnp.abs(expected.force).max())
    np.testing.assert_allclose(found.force, expected.force, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(found.torque, expected.torque, rtol=0, atol=1e-14 * scale)
    assert (np.abs(found.torque).max() > 0) == (degree > 0)


@pytest.mark.sample(0)
def test_derivatives_in_moments_and_masses_are_those_of_differences():
    torque, start = ml.asteroids.MutualGravity(didymos.G), didymos.start()

    def end(factors):
        moments, mass = jnp.asarray(didymos.MOMENTS) * factors[:, :3], jnp.asarray(didymos.MASSES) * factors[:, 3]
        body = ml.FreeBody(ml.RigidBody(moments, physical=False), mass)
        options = {"dt": 300.0, "steps": 24, "save_every": 24, "adjoint": ml.adjoints.Reversible()}
        states = ml.integrate("JACOBI[EA]", body, torque, start, **options).states
        return jnp.concatenate([states.attitude[-1].ravel(), states.position[-1].ravel() / 1000])[jnp.array([2, 5, 13])]

    factors, run = jnp.ones((2, 4)), quick(end)
    found = np.asarray(quick(jax.jacrev(end))(factors))
    assert np.all(np.isfinite(found))
    for i, j in ((0, 1), (1, 0), (1, 2), (0, 3), (1, 3)):
        push = jnp.zeros_like(factors).at[i, j].set(1e-4)
        slope = np.asarray(run(factors + push) - run(factors - push)) / 2e-4
        np.testing.assert_allclose(found[:, i, j], slope, rtol=1e-5, atol=1e-8)


gravity, START = ml.asteroids.MutualGravity, didymos.start()
MANY = ml.CoupledState(*(jnp.tile(x, (5, 1)) for x in jax.tree.leaves(START)))
FREE, ROTOR = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.5]), 1.0), ml.FreeBody(ml.SymmetricRotor(1.0), 1.0)


def go(torque, body=didymos.BODY, start=START, method="JACOBI[EA]"):
    return ml.integrate(method, body, torque, start, dt=1.0, steps=1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: gravity(1.0, degree=5), "degree must be one of"),
        (lambda: gravity(1.0, third=np.zeros((2, 3, 3, 3))), "degree=2 does not use them"),
        (lambda: gravity(1.0, degree=3), "needs the moments of degree 3"),
        (lambda: gravity(1.0, degree=3, third=np.arange(54.0).reshape(2, 3, 3, 3)), "sym"),
        (lambda: go(gravity(1.0), jax.tree.map(lambda x: x[0], didymos.BODY), START.of_body(0)), "on a CoupledState"),
        (lambda: go(gravity(1.0), FREE, MANY), "2 to 8 bodies"),
        (lambda: go(gravity(1.0), ROTOR, ml.CoupledFreeAxisState.of(START), "SYMMETRIC[EA]"), "CoupledFreeAxisState"),
    ],
)
def test_what_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.sample(0)
@pytest.mark.parametrize(("degree", "short"), [(0, 0.324), (2, 0.121), (4, 0.048)])
def test_near_contact_the_force_is_as_short_as_published(degree, short):
    """A homogeneous spheroid (3, 1, 1) and a ball at the distance 4 on its axis: 0.09241893 (arXiv 2301.10083)."""
    squares = np.array([9.0, 1.0, 1.0])
    moments = np.stack([(squares.sum() - squares) / 5, np.full(3, 1e-9)])
    pair = ml.FreeBody(ml.RigidBody(moments), np.ones(2))
    still, upright = jnp.zeros((2, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1))
    state = ml.CoupledState(still, upright, still, jnp.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]))
    force = ml.asteroids.MutualGravity(1.0, degree=degree).on(pair)(0.0, state).force[0, 0]
    assert 1 - float(force) / 0.09241893 == pytest.approx(short, abs=5e-4)
