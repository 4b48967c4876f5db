"""The flights: which are symplectic and which not, and that a solve converges or says that it did not."""

from functools import partial
from itertools import pairwise
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, at, epsilon, quick, whole
from claims import canonical
from laboratory.free_body import free_body

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax.cli import convergence, scenes
from midlie_jax.integrators import flights
from midlie_jax.model import so3

FLIGHT = flights.LieMidpoint()


def fly(moments, h, momentum, flight=FLIGHT):
    """Increment, new momentum and flag, on arrays."""
    inertia = flights.Inertia.of(ml.RigidBody(moments, physical=False))
    increment, change, ok = flight(inertia, h, cp.vector(momentum))
    return cp.pack(increment), momentum + cp.pack(change), ok


def defects(flight, times=(0.4, 0.2, 0.1)):
    """The largest entry of |M^T W1 M - W0|, M the derivative of one free step, both ends seen from the left."""
    moments = jnp.array([2.0, 2.0, 3.0] if flight.name == "SYMMETRIC" else [1.0, 2.0, 3.0])
    start = jnp.array([1.0, 0.8, -1.3])

    def step(change, h):
        turn, momentum = change[:3], start + change[3:]
        increment, new, _ = fly(moments, h, momentum, flight)
        return so3.multiply(so3.exp(turn), increment), new

    def derivative(h):
        (increment, new), (turning, moving) = step(jnp.zeros(6), h), jax.jacfwd(step)(jnp.zeros(6), h)
        left = jax.vmap(lambda column: 2 * so3.multiply(so3.conjugate(increment), column)[1:], 1, 1)(turning)
        return jnp.concatenate([left, moving]), new

    return [
        np.abs(m.T @ canonical(new) @ m - canonical(np.asarray(start))).max()
        for m, new in zip(*map(np.asarray, quick(jax.vmap(derivative))(jnp.array(times))), strict=True)
    ]


@pytest.mark.sample(0)
def test_is_not_symplectic_at_third_order():
    found = defects(FLIGHT)
    np.testing.assert_allclose(found, [3.0e-3, 3.8e-4, 4.8e-5], rtol=0.02)
    assert abs(np.log2(found[1] / found[2]) - 3) < 0.05
    assert not FLIGHT.symplectic


# ---- the solve ----


def problems(count, largest, spread, dtype):
    """Moments (b+c, a+c, a+b) with a, b, c over `spread` decades, and h = 1 momenta whose turn Psi is known."""
    rng = np.random.default_rng(5)
    masses = 10.0 ** rng.uniform(-spread, 0, size=(count, 3))
    moments = masses.sum(axis=1, keepdims=True) - masses
    psi = rng.normal(size=(count, 3))
    psi *= (largest * rng.uniform(0, 1, size=(count, 1)) ** (1 / 3)) / np.linalg.norm(psi, axis=1, keepdims=True)
    momentum = np.asarray(so3.rotate(so3.exp(jnp.asarray(psi / 2)), jnp.asarray(moments * psi)))
    return moments.astype(dtype), momentum.astype(dtype), psi


@jax.jit
@jax.vmap
def solve_all(moments, momentum):
    """One step without torque from attitude one, which ends at the increment."""
    start = ml.RigidState(momentum, jnp.array([1.0, 0.0, 0.0, 0.0], momentum.dtype))
    path = ml.integrate("LIEMID[E2]", ml.RigidBody(moments), None, start, dt=1.0, steps=1)
    return path.states.attitude[-1], path.states.momentum[-1], path.ok


@pytest.mark.sample(0)
@pytest.mark.parametrize(("dtype", "scale"), [("float64", 1e12), ("float32", 1e-12)])
def test_solves_every_step_of_up_to_a_radian_and_a_half(dtype, scale):
    """Residual below 8 eps |Pi|, measured in float64 from the increment itself; and the root is the right one."""
    moments, momentum, psi = problems(10_000, 1.5, 6, dtype)
    # A slender body that begins with turns about its thin axis is refused, though it has such a root.
    slow = np.linalg.norm(momentum / moments, axis=1) < 11.9
    moments, momentum, psi = moments[slow], momentum[slow], psi[slow]
    increment, new, ok = solve_all(moments * np.asarray(scale, dtype), momentum * np.asarray(scale, dtype))
    assert len(ok) > 4000
    assert np.all(ok)
    turn = np.asarray(so3.log(jnp.asarray(increment, np.float64)))
    inward = so3.rotate(so3.exp(jnp.asarray(-turn / 2)), jnp.asarray(momentum, np.float64))
    residual = np.linalg.norm(moments * turn - np.asarray(inward), axis=1) / np.linalg.norm(momentum, axis=1)
    # The increment is rounded to eps, hence Psi to a few eps, which the body multiplies by its moments.
    assert residual.max() <= (8 + 4 * 1.5) * epsilon(dtype)
    # A slender body: the smallest moment decides how well a turn is determined.
    near = moments.max(axis=1) < 100 * moments.min(axis=1)
    np.testing.assert_allclose(turn[near], psi[near], atol=1000 * epsilon(dtype))
    outward = so3.rotate(jnp.asarray(increment, np.float64), jnp.asarray(new, np.float64) / scale)
    error = np.linalg.norm(np.asarray(outward) - momentum, axis=1) / np.linalg.norm(momentum, axis=1)
    assert error.max() <= 8 * epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_never_a_silent_wrong_answer(dtype):
    """Whatever the size of the turn, True means that the residual is small: checked in float64."""
    for largest, spread in ((2.4, 1), (3.0, 1), (10.0, 2), (1e3, 2)):
        moments, momentum, _ = problems(10_000, largest, spread, dtype)
        increment, _, ok = solve_all(moments, momentum)
        turn = np.asarray(so3.log(jnp.asarray(increment, np.float64)))[ok]
        inward = so3.rotate(so3.exp(jnp.asarray(-turn / 2)), jnp.asarray(momentum[ok], np.float64))
        residual = np.linalg.norm(moments[ok] * turn - np.asarray(inward), axis=1)
        assert np.all(residual <= 16 * epsilon(dtype) * np.linalg.norm(momentum[ok], axis=1))


@pytest.mark.parametrize("dtype", DTYPES)
def test_says_false_beyond_its_range(dtype):
    moments = np.array([1.0, 2.0, 2.5])
    ok = quick(
        lambda h, momentum: fly(jnp.asarray(moments, dtype), jnp.asarray(h, dtype), jnp.asarray(momentum, dtype))[2]
    )
    for axis in np.eye(3):
        assert not ok(1.0, moments * 3.0 * axis)  # Psi = 3 about a principal axis
    for bad in (np.nan, np.inf):
        assert not ok(1.0, np.full(3, bad))
    assert not ok(np.nan, np.ones(3))
    assert ok(1.0, np.zeros(3))


def along(start, s):
    """Increment and momentum of a flight whose moments, length and momentum all change with s."""
    moments, move = jnp.array([1.0, 2.0, 2.6]), jnp.array([0.2, -0.7, 0.5])
    increment, new, _ = fly(moments * (1 + 0.1 * s * move), 1 + 0.3 * s, moments * start + s * move)
    return jnp.concatenate([increment, new])


SLOPE = jax.jacfwd(along, 1)
DERIVATIVES = [quick(function) for function in (along, SLOPE, jax.jacfwd(SLOPE, 1))]


@pytest.mark.sample(0)
@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_derivative_is_that_of_the_implicit_function(turn):
    """Of first and second order, for |Psi| up to 2, against differences of high order: their error is 1e-9 and 1e-6."""
    direction = jnp.array([0.3, -0.8, 0.5])
    start = turn * direction / jnp.linalg.norm(direction)
    places, factors, step = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12, 1e-3
    for (function, derivative), slack in zip(pairwise(DERIVATIVES), (1e-9, 1e-6), strict=True):
        values = [function(start, jnp.asarray(step * p)) for p in places]
        np.testing.assert_allclose(derivative(start, jnp.asarray(0.0)), factors @ values / step, atol=slack)


SYMPLECTIC = [
    flights.SymplecticMidpoint(),
    flights.SymplecticMidpoint4(),
    flights.Symmetric(),
    flights.Jacobi(),
    flights.NearSymmetric(),
    flights.ThreeAxis(),
    flights.MoserVeselov(),
]


@pytest.mark.sample(0)
@pytest.mark.parametrize("flight", SYMPLECTIC, ids=lambda f: f.name)
def test_symplectic_to_rounding(flight):
    assert flight.symplectic
    assert max(defects(flight)) < 1e-14


@pytest.mark.sample(1)
@pytest.mark.parametrize("flight", [flights.MoserVeselov4(), flights.MoserVeselov6()], ids=lambda f: f.name)
def test_preprocessed_moments_are_not_symplectic(flight):
    """They depend on the momentum: the defect is of the order of a step's error."""
    found = defects(flight)
    assert not flight.symplectic
    assert abs(np.log2(found[1] / found[2]) - flight.order - 1) < 0.1, found


def test_symmetric_flight_says_false_for_an_asymmetric_body():
    """Where the moments are traced; where they are known a run refuses them (test_inputs.py)."""
    assert not fly(jnp.array([1.0, 2.0, 3.0]), jnp.asarray(0.1), jnp.array([1.0, 0.8, -1.3]), flights.Symmetric())[2]


UNEQUAL = {2: [1.4, 1.4, 0.8], 0: [0.8, 1.4, 1.4], 1: [1.4, 0.8, 1.4]}


@pytest.mark.sample(0)
@pytest.mark.parametrize("axis", UNEQUAL)
def test_symmetric_flight_is_about_whichever_axis_it_is(axis):
    """Found from moments that are known, by `integrate`, `ensemble` and diffrax alike; the motion is JACOBI's."""
    moments = jnp.array(UNEQUAL[axis])
    body, start = ml.RigidBody(moments), ml.RigidState(jnp.array([0.4, -0.7, 0.9]), jnp.array([0.5, 0.5, -0.5, 0.5]))
    top = ml.torques.HeavyTop(0.7, (0.48, 0.6, 0.64))
    assert ml.method("SYMMETRIC", "EA").fitted(body).flight == flights.Symmetric(axis)
    ours, theirs = (ml.integrate(f"{f}[EA]", body, top, start, dt=0.2, steps=10) for f in ("SYMMETRIC", "JACOBI"))
    assert ours.ok
    for x, y in zip(at(ours.states), at(theirs.states), strict=True):
        np.testing.assert_allclose(x, y, atol=2e-15 * 10)
    many = ml.ensemble("SYMMETRIC[EA]", body, top, jax.tree.map(lambda x: x[None], start), dt=0.2, steps=10)
    assert many.ok.all()
    term, solver = ml.diffrax.RigidBodyTerm(body, top), ml.diffrax.LieSolver("SYMMETRIC[EA]")
    solution = diffrax.diffeqsolve(term, solver, 0.0, 2.0, 0.2, start)
    np.testing.assert_allclose(solution.ys.momentum[-1], ours.states.momentum[-1], atol=1e-14)


def test_symmetric_flight_of_a_batch():
    """About one axis where all bodies have it, else about each one's own."""
    method = ml.method("SYMMETRIC", "EA")
    balls = ml.RigidBody(jnp.array([UNEQUAL[0], [1.0, 1.0, 1.0]]))
    assert method.fitted(balls).flight == flights.Symmetric(0)
    mixed = ml.RigidBody(jnp.array([UNEQUAL[2], UNEQUAL[0], UNEQUAL[1]]))
    assert method.fitted(mixed).flight == flights.Symmetric()
    starts = ml.RigidState(jnp.tile(jnp.array([0.4, -0.7, 0.9]), (3, 1)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (3, 1)))
    ours, theirs = (ml.ensemble(f"{f}[EA]", mixed, None, starts, dt=0.2, steps=10) for f in ("SYMMETRIC", "JACOBI"))
    assert ours.ok.all()
    np.testing.assert_allclose(ours.states.attitude, theirs.states.attitude, atol=2e-15 * 10)
    with pytest.raises(ValueError, match="two equal moments"):
        method.fitted(ml.RigidBody(jnp.array([UNEQUAL[2], [1.0, 1.1, 1.2]])))


def in_parts(flight, moments, h, momentum):
    increment, new, _ = fly(moments, h, momentum, flight)
    return jnp.concatenate([increment, new])


@quick
def derivatives_of_jacobi(*point):
    """The first, forward, in moments, time and momentum, and the second in the momentum."""
    exact = partial(in_parts, flights.Jacobi())
    return jax.jacfwd(exact, (0, 1, 2))(*point), jax.jacfwd(jax.jacrev(exact, 2), 2)(*point)


@pytest.mark.sample(0)
@pytest.mark.parametrize("axis", [1, *whole(2, 0)])
def test_symmetric_flight_has_the_derivative_of_the_motion(axis):
    """In each moment by itself, which parts the two equal ones; in time and momentum."""
    point = jnp.array(UNEQUAL[axis]), jnp.asarray(0.6), jnp.array([0.4, -0.7, 0.9])
    ours = partial(in_parts, flights.Symmetric(axis))
    first, second = derivatives_of_jacobi(*point)
    for found, exact in zip(quick(jax.jacfwd(ours, (0, 1, 2)))(*point), first, strict=True):
        np.testing.assert_allclose(found, exact, atol=2e-15)
    np.testing.assert_allclose(quick(jax.jacfwd(jax.jacrev(ours, 2), 2))(*point), second, atol=2e-15)
    for twice in (jax.jacfwd(jax.jacrev(ours, 0), 0), jax.jacfwd(jax.jacrev(ours, 2), 0)):
        with pytest.raises(ValueError, match="only first derivatives with respect to the moments; use JACOBI"):
            twice(*point)


PROPORTIONS = 10.0 ** np.arange(-6.0, 0.5)


@pytest.mark.sample(0)
@pytest.mark.parametrize("flight", [FLIGHT, *SYMPLECTIC[2:6]], ids=lambda f: f.name)
def test_increments_and_their_derivatives_are_right_in_proportion(flight):
    """In float32, for turns from a millionth to one: errors are a few units in the last place of the turn itself."""
    rng = np.random.default_rng(3)
    masses = rng.uniform(0.3, 1, (len(PROPORTIONS), 3))
    masses[:, 1] = masses[:, 0]
    moments = (masses.sum(1, keepdims=True) - masses).astype(np.float32)
    momentum = rng.normal(size=moments.shape)
    momentum = (0.9 * momentum / np.linalg.norm(momentum / moments, axis=1, keepdims=True)).astype(np.float32)

    def both(moments, h, momentum):
        def vector(momentum):
            return fly(moments, h, momentum, flight)[0][1:]

        return vector(momentum), jax.jacfwd(vector)(momentum)

    made = quick(jax.vmap(both))
    found, exact = (
        [np.asarray(x, float) for x in made(*(x.astype(d) for x in (moments, np.float32(PROPORTIONS), momentum)))]
        for d in ("float32", "float64")
    )
    for value, right in zip(found, exact, strict=True):
        axes = tuple(range(1, value.ndim))
        error = np.abs(value - right).max(axes) / np.abs(right).max(axes)
        assert error.max() <= 8 * epsilon("float32"), error / epsilon("float32")


# ---- the exact flight of any body ----


def taylor(moments, momentum, parts=4, degree=24):
    """Attitude (n, 4) and momentum (n, 3) at time 1 from attitude one: Taylor series in extended precision."""
    moments, momentum = (np.asarray(x, np.longdouble).T for x in (moments, momentum))
    onward, back = [1, 2, 0], [2, 0, 1]
    gaps = (moments[onward] - moments[back]) / (moments[onward] * moments[back])
    attitude = np.zeros((4, momentum.shape[1]), np.longdouble)
    attitude[0] = 1
    for _ in range(parts):
        p, q = np.zeros((2, degree + 1, 4, momentum.shape[1]), np.longdouble)
        p[0, 1:], q[0] = momentum, attitude
        for n in range(degree):
            past, now = p[n::-1] if n else p[:1], slice(0, n + 1)
            omega, w, v = past[:, 1:] / moments, q[now, :1], q[now, 1:]
            p[n + 1, 1:] = gaps * (p[now, 1:][:, onward] * past[:, 1:][:, back]).sum(0) / (n + 1)
            q[n + 1, 0] = -(v * omega).sum((0, 1)) / (2 * n + 2)
            across = v[:, onward] * omega[:, back] - v[:, back] * omega[:, onward]
            q[n + 1, 1:] = (w * omega + across).sum(0) / (2 * n + 2)
        powers = (np.longdouble(1) / parts) ** np.arange(degree + 1)[:, None, None]
        momentum, attitude = (p * powers).sum(0)[1:], (q * powers).sum(0)
    return attitude.T, momentum.T


def tumbling(dtype):
    """Bodies, moments of ratios up to 1e6, all axes shuffled, and momenta for turns of up to 1.2 radians.

    Next to the separatrix and on it, with two or three moments equal or nearly, about a principal axis, and generic.
    """
    rng = np.random.default_rng(11)
    masses = 10.0 ** rng.uniform(-6, 0, size=(10_000, 3))
    masses[:2000] = 10.0 ** rng.uniform(-1, 0, size=(2000, 3))
    masses[1000:1400, 1] = masses[1000:1400, 0]
    masses[1200:1400, 1] *= 1 + epsilon(dtype) * rng.integers(0, 5, 200)
    masses[1400:1500] = 1.0
    moments = rng.permuted(masses.sum(axis=1, keepdims=True) - masses, axis=1).astype(dtype).astype(float)
    momentum = rng.normal(size=moments.shape) * np.where(rng.random((10_000, 1)) < 0.5, moments, 1.0)
    low, middle, high = np.argsort(moments, axis=1).T
    row = np.arange(1000)
    momentum[row] *= 10.0 ** rng.uniform(-17, 0, size=(1000, 1))
    momentum[row, middle[row]] = 1.0
    # On the separatrix: the smallest and the largest in the proportion that keeps 2 H times the middle moment at Pi^2.
    i, j, k = (moments[row[:500], axis[:500]] for axis in (low, middle, high))
    momentum[row[:500], high[:500]] = momentum[row[:500], low[:500]] * np.sqrt(k * (j - i) / (i * (k - j)))
    momentum[1500:1600] = np.eye(3)[rng.integers(0, 3, 100)]
    rate = np.linalg.norm(momentum / moments, axis=1, keepdims=True)
    momentum *= 1.199 * rng.random((10_000, 1)) / rate
    momentum[1600:1700] *= 10.0 ** rng.uniform(-20, 0, size=(100, 1))
    return moments.astype(dtype), momentum.astype(dtype)


APPROXIMATE = [f for f in (FLIGHT, *SYMPLECTIC, flights.MoserVeselov4(), flights.MoserVeselov6()) if f.order]


@pytest.mark.sample(len(APPROXIMATE))
@pytest.mark.parametrize("flight", APPROXIMATE, ids=lambda f: f.name)
def test_order_of_a_flight(flight):
    """The error of one flight is of the order's next power of its length, in momentum and attitude."""
    moments, times = np.array([1.0, 2.0, 2.5]), np.array([0.4, 0.2, 0.1])
    momentum = np.outer(times, [1.0, 0.8, -1.3])
    fly_all = jax.jit(jax.vmap(lambda p: fly(jnp.array(moments), jnp.ones(()), p, flight)))
    increment, new, ok = fly_all(jnp.array(momentum))
    attitude, end = taylor(np.tile(moments, (3, 1)), momentum)
    turns = np.linalg.norm(np.asarray(increment) - attitude, axis=1)
    changes = np.linalg.norm(np.asarray(new) - end, axis=1) / times
    assert np.all(ok)
    for errors in (turns, changes):
        slope = np.log2(np.array(errors[1] / errors[2], float))
        assert abs(slope - flight.order - 1) < 0.1, errors


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_jacobi_is_exact(dtype):
    """To a few units in the last place, the energy with it; and the series that says so is that of the oracle."""
    moments, momentum = tumbling(dtype)
    flight = jax.jit(jax.vmap(lambda i, p: fly(i, jnp.ones((), p.dtype), p, flights.Jacobi())))
    increment, new, ok = map(np.asarray, flight(moments, momentum))
    assert np.all(ok)
    assert increment.dtype == new.dtype == dtype
    # In pieces that fit the cache; a tenth of the bodies for float32, whose rounding hides more.
    every = slice(None, None, 1 if dtype == "float64" else 10)
    moments, momentum, increment, new = moments[every], momentum[every], increment[every], new[every]
    pieces = [taylor(moments[k : k + 250], momentum[k : k + 250]) for k in range(0, len(moments), 250)]
    attitude, end = (np.concatenate(column) for column in zip(*pieces, strict=True))
    assert np.abs(increment - attitude).max() <= 4 * epsilon(dtype)
    size = np.linalg.norm(momentum.astype(float), axis=1)
    assert (np.linalg.norm(new - end, axis=1) / size).max() <= 6 * epsilon(dtype)
    for row in range(0, len(moments), 250):
        exact = free_body(moments[row], momentum[row], np.eye(4)[0], [1.0])
        np.testing.assert_allclose(end[row].astype(float), exact[0][0], rtol=0, atol=1e-15 * size[row])
        np.testing.assert_allclose(attitude[row].astype(float), exact[1][0], rtol=0, atol=1e-15)


def test_jacobi_refuses_what_turns_over_faster_than_it_spins():
    """No mass is spread like this: at h |Omega| = 0.5 about the middle axis disturbances grow a thousandfold."""
    moments, momentum = jnp.array([1e-4, 1.0, 2.0]), jnp.array([0.0, 0.5, 0.0])
    ok = quick(jax.vmap(lambda h: fly(moments, h, momentum, flights.Jacobi())[2]))(jnp.array([1.0, 0.01]))
    assert ok.tolist() == [False, True]


# ---- a flight written outside the package ----

half_turn = ml.flights.short_series.half_turn


class Explicit(ml.flights.Flight):
    """Turns by h times the angular velocity that one step of Euler's equations gives half way: order 2."""

    name: ClassVar[str] = "EXPLICIT"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False
    body: ClassVar[type] = ml.RigidBody
    per_loop: ClassVar[int] = 2

    def __call__(self, inertia, h, momentum):
        change = cp.cross(momentum, inertia.velocity(momentum))
        half_way = inertia.velocity(cp.add(momentum, cp.scale(h / 2, change)))
        w = cp.scale(h / 2, half_way)
        increment = cp.square(half_turn(w))
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), cp.dot(w, w) <= 1


def test_a_flight_from_outside_keeps_the_laws_that_it_claims():
    scene, method = scenes.scene("free-asymmetric"), ml.method(Explicit(), "E1")
    assert (method.name, method.order, method.symmetric, method.symplectic) == ("EXPLICIT[E1]", 1, False, False)
    path = ml.integrate(method, scene.body, None, scene.start, dt=0.05, steps=200, save_every=20)
    assert path.ok
    momenta = np.asarray(ml.observe.spatial_momentum(path.states))
    np.testing.assert_allclose(momenta, np.tile(momenta[0], (len(momenta), 1)), atol=1e-13)
    reference = convergence.find_reference(scene, 512)
    rows, _ = convergence.survey(scene, [ml.method(Explicit(), "EA")], [256, 512], reference)
    assert all(row.ok and not row.failure for row in rows)
    assert rows[-1].attitude_slope == pytest.approx(2, abs=0.1)

    class Other(Explicit):
        name: ClassVar[str] = "JACOBI"

    with pytest.raises(ValueError, match="flight 'JACOBI': midlie_jax has a flight of this name; choose another name"):
        ml.method(Other(), "EA")
