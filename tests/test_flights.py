"""The flights: which are symplectic and which not, that a solve converges or says that it did not; their short series,
and the momentum alone, which is that of the whole flight.
"""

from functools import partial
from itertools import pairwise
from math import factorial
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, MOMENTUM_FLIGHTS, at, epsilon, quick, real, whole
from claims import canonical
from laboratory.free_body import free_body

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax._math import short_series
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
    for largest, spread in ((2.4, 1), (10.0, 2), (1e3, 2)):
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


def in_parts(flight, moments, h, momentum):
    increment, new, _ = fly(moments, h, momentum, flight)
    return jnp.concatenate([increment, new])


def along(start, s):
    """Increment and momentum of a flight whose moments, length and momentum all change with s."""
    moments, move = jnp.array([1.0, 2.0, 2.6]), jnp.array([0.2, -0.7, 0.5])
    return in_parts(FLIGHT, moments * (1 + 0.1 * s * move), 1 + 0.3 * s, moments * start + s * move)


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
    *(flights.SymplecticMidpoint(), flights.SymplecticMidpoint4(), flights.Symmetric(), flights.Jacobi()),
    *(flights.NearSymmetric(), flights.ThreeAxis(), flights.MoserVeselov()),
]
PREPROCESSED = [flights.MoserVeselov4(), flights.MoserVeselov6()]


@pytest.mark.sample(0)
@pytest.mark.parametrize("flight", SYMPLECTIC, ids=lambda f: f.name)
def test_symplectic_to_rounding(flight):
    assert flight.symplectic
    assert max(defects(flight)) < 1e-14


@pytest.mark.sample(1)
@pytest.mark.parametrize("flight", [*PREPROCESSED, FLIGHT], ids=lambda f: f.name)
def test_the_defect_of_a_flight_that_is_not_symplectic_is_of_the_order_of_its_error(flight):
    """Moments prepared for a step depend on the momentum."""
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
    """Found from moments that are known, by `integrate` and diffrax; the motion is JACOBI's."""
    moments = jnp.array(UNEQUAL[axis])
    body, start = ml.RigidBody(moments), ml.RigidState(jnp.array([0.4, -0.7, 0.9]), jnp.array([0.5, 0.5, -0.5, 0.5]))
    top = ml.torques.HeavyTop(0.7, (0.48, 0.6, 0.64))
    assert ml.method("SYMMETRIC", "EA").fitted(body).flight == flights.Symmetric(axis)
    ours, theirs = (ml.integrate(f"{f}[EA]", body, top, start, dt=0.2, steps=10) for f in ("SYMMETRIC", "JACOBI"))
    assert ours.ok
    for x, y in zip(at(ours.states), at(theirs.states), strict=True):
        np.testing.assert_allclose(x, y, atol=2e-15 * 10)
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


@pytest.mark.sample(0)
@pytest.mark.parametrize("axis", [1, *whole(2, 0)])
def test_symmetric_flight_has_the_second_derivative_of_the_motion(axis):
    """In the momentum; that in the moments, which would part the two equal ones, is refused."""
    point = jnp.array(UNEQUAL[axis]), jnp.asarray(0.6), jnp.array([0.4, -0.7, 0.9])
    ours, exact = partial(in_parts, flights.Symmetric(axis)), partial(in_parts, flights.Jacobi())
    found, right = (quick(jax.jacfwd(jax.jacrev(f, 2), 2))(*point) for f in (ours, exact))
    np.testing.assert_allclose(found, right, atol=2e-15)
    for twice in (jax.jacfwd(jax.jacrev(ours, 0), 0), jax.jacfwd(jax.jacrev(ours, 2), 0)):
        with pytest.raises(ValueError, match="only first derivatives with respect to the moments; use JACOBI"):
            twice(*point)


# ---- the exact flight of any body ----


def tumbling(dtype):
    """Bodies, moments of ratios up to 1e6, all axes shuffled, and momenta for turns of up to 1.2 radians."""
    rng = np.random.default_rng(11)
    masses = 10.0 ** rng.uniform(-6, 0, size=(200, 3))
    masses[:60] = 10.0 ** rng.uniform(-1, 0, size=(60, 3))
    masses[30:40, 1] = masses[30:40, 0]
    masses[35:40, 1] *= 1 + epsilon(dtype) * np.arange(5)
    masses[40:45] = 1.0
    moments = rng.permuted(masses.sum(axis=1, keepdims=True) - masses, axis=1).astype(dtype).astype(float)
    momentum = rng.normal(size=moments.shape) * np.where(rng.random((200, 1)) < 0.5, moments, 1.0)
    low, middle, high = np.argsort(moments, axis=1).T
    row = np.arange(30)
    momentum[row] *= 10.0 ** rng.uniform(-17, 0, size=(30, 1))
    momentum[row, middle[row]] = 1.0
    # On the separatrix: the smallest and the largest in the proportion that keeps 2 H times the middle moment at Pi^2.
    row = row[:15]
    i, j, k = (moments[row, axis[row]] for axis in (low, middle, high))
    momentum[row, high[row]] = momentum[row, low[row]] * np.sqrt(k * (j - i) / (i * (k - j)))
    momentum[45:50] = np.eye(3)[rng.integers(0, 3, 5)]
    momentum *= 1.199 * rng.random((200, 1)) / np.linalg.norm(momentum / moments, axis=1, keepdims=True)
    momentum[50:60] *= 10.0 ** rng.uniform(-20, 0, size=(10, 1))
    return moments.astype(dtype), momentum.astype(dtype)


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
        increment = cp.square(short_series.half_turn(w))
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), cp.dot(w, w) <= 1


APPROXIMATE = [f for f in (FLIGHT, *SYMPLECTIC, *PREPROCESSED, Explicit()) if f.order]


@pytest.mark.sample(len(APPROXIMATE))
@pytest.mark.parametrize("flight", APPROXIMATE, ids=lambda f: f.name)
def test_order_of_a_flight(flight):
    """The error of one flight is of the order's next power of its length, in momentum and attitude."""
    moments, momentum, times = np.array([1.0, 2.0, 2.5]), np.array([1.0, 0.8, -1.3]), np.array([0.4, 0.2, 0.1])
    fly_all = jax.jit(jax.vmap(lambda h: fly(jnp.array(moments), h, jnp.array(momentum), flight)))
    increment, new, ok = map(np.asarray, fly_all(times))
    assert np.all(ok)
    end, attitude = free_body(moments, momentum, np.eye(4)[0], times)
    for errors in (np.linalg.norm(increment - attitude, axis=1), np.linalg.norm(new - end, axis=1)):
        slope = np.log2(errors[1] / errors[2])
        assert abs(slope - flight.order - 1) < 0.1, errors


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_jacobi_is_exact(dtype):
    """To a few units in the last place."""
    moments, momentum = tumbling(dtype)
    flight = jax.jit(jax.vmap(lambda i, p: fly(i, jnp.ones((), p.dtype), p, flights.Jacobi())))
    increment, new, ok = map(np.asarray, flight(moments, momentum))
    assert np.all(ok)
    assert increment.dtype == new.dtype == dtype
    exact = [free_body(*row, np.eye(4)[0], [1.0]) for row in zip(moments, momentum, strict=True)]
    end, attitude = (np.concatenate(column) for column in zip(*exact, strict=True))
    assert np.abs(increment - attitude).max() <= 4 * epsilon(dtype)
    size = np.linalg.norm(momentum.astype(float), axis=1)
    assert (np.linalg.norm(new - end, axis=1) / size).max() <= 6 * epsilon(dtype)


def test_jacobi_refuses_what_turns_over_faster_than_it_spins():
    """No mass is spread like this: at h |Omega| = 0.5 about the middle axis disturbances grow a thousandfold."""
    moments, momentum = jnp.array([1e-4, 1.0, 2.0]), jnp.array([0.0, 0.5, 0.0])
    ok = quick(jax.vmap(lambda h: fly(moments, h, momentum, flights.Jacobi())[2]))(jnp.array([1.0, 0.01]))
    assert ok.tolist() == [False, True]


def test_a_flight_from_outside_keeps_the_laws_that_it_claims():
    method, start = ml.method(Explicit(), "E1"), ml.RigidState([1.0, 0.8, -1.3], [1.0, 0.0, 0.0, 0.0])
    assert (method.name, method.order, method.symmetric, method.symplectic) == ("EXPLICIT[E1]", 1, False, False)
    path = ml.integrate(method, ml.RigidBody([1.0, 2.0, 2.5]), None, start, dt=0.05, steps=200, save_every=20)
    assert path.ok
    momenta = np.asarray(ml.observe.spatial_momentum(path.states))
    np.testing.assert_allclose(momenta, np.tile(momenta[0], (len(momenta), 1)), atol=1e-13)

    class Other(Explicit):
        name: ClassVar[str] = "JACOBI"

    with pytest.raises(ValueError, match="flight 'JACOBI': midlie_jax has a flight of this name; choose another name"):
        ml.method(Other(), "EA")


# Bodies and momenta where formulas of free bodies have their special cases.
SPECIAL = (
    ([1.0, 2.0, 2.6], [0.1, 1.9, 0.12]),
    ([1.0, 2.0, 3.0], [0.0, 1.0, 0.0]),  # on the separatrix, about the middle axis
    ([3.0, 4.0, 6.0], [1.0, 0.3, 1.0]),  # on it, elsewhere
    ([2.0, 2.0, 2.0], [0.3, -0.4, 0.9]),
    ([2.0, 3.0, 2.0], [0.3, -0.4, 0.9]),
    ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0]),
    ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]),
)
EVERY = pytest.mark.parametrize("flight", MOMENTUM_FLIGHTS, ids=lambda flight: flight.name)


def flown(flight, moments, h, momentum):
    """The change of the momentum and `ok`: of the whole flight, and of the momentum alone."""
    inertia, momentum = flights.Inertia.of(ml.RigidBody(moments)), cp.vector(momentum)
    _, whole, ok = flight(inertia, h, momentum)
    alone, fine = flight.momentum_change(inertia, h, momentum)
    return cp.pack(whole), ok, cp.pack(alone), fine


def special_problems(count=4000):
    """Moments and momenta with turns of up to 1.4 radians in a unit of time, and the special cases."""
    rng = np.random.default_rng(3)
    masses = 10 ** rng.uniform(-1, 0, (count, 3))
    moments, momentum = masses.sum(1, keepdims=True) - masses, rng.normal(size=(count, 3))
    momentum *= 1.4 * rng.random((count, 1)) / np.linalg.norm(momentum / moments, axis=1, keepdims=True)
    special = [np.array(x) for x in zip(*SPECIAL, strict=True)]
    return np.concatenate([moments, special[0]]), np.concatenate([momentum, special[1]])


@pytest.mark.sample(0)
@EVERY
def test_it_is_the_change_of_the_whole_flight(flight):
    """To some units in the last place of the change itself; and `ok` means the same."""
    fly = real(jax.vmap(lambda i, p: flown(flight, i, jnp.ones((), p.dtype), p)))
    for dtype in DTYPES:
        moments, momentum = (x.astype(dtype) for x in special_problems())
        exact, _, _, _ = map(np.asarray, fly(moments.astype(float), momentum.astype(float)))
        _, ok, alone, fine = map(np.asarray, fly(moments, momentum))
        np.testing.assert_array_equal(fine, ok)
        assert 0.7 < ok.mean() < 0.95
        error = np.linalg.norm(alone - exact, axis=1)[ok]
        turn, size = np.linalg.norm(momentum / moments, axis=1)[ok], np.linalg.norm(momentum, axis=1)[ok]
        assert np.all(error <= 12 * epsilon(dtype) * turn * size)


@pytest.mark.sample(0)
@EVERY
def test_its_derivatives_are_those_of_the_whole_flight(flight):
    """In moments, time and momentum together, in every special case."""
    moments, momentum = map(jnp.array, zip(*SPECIAL, strict=True))
    moves = np.random.default_rng(0).normal(size=(3, 7))

    def derivatives(alone, moments, momentum, move):
        def along(s):
            moved = moments * (1 + 0.1 * s * move[:3]), 0.4 + 0.3 * s * move[3], momentum + s * move[4:]
            return flown(flight, *moved)[2 if alone else 0]

        return jax.jacfwd(along)(0.0)

    over_moves = jax.vmap(derivatives, (None, None, None, 0))
    whole, alone = (
        quick(jax.vmap(partial(over_moves, alone), (0, 0, None)))(moments, momentum, moves) for alone in (False, True)
    )
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=0, atol=2e-13), whole, alone)


WIDEST = short_series.WIDEST_SQUARE


def exactly(shift, x):
    """The sum of (-x)^n / (2n + shift)!, in extended precision."""
    return np.sum([(-x) ** n / np.longdouble(factorial(2 * n + shift)) for n in range(30)], axis=0)


def value(coefficients, x, dtype):
    """The polynomial with coefficients rounded to `dtype`, in extended precision."""
    return np.sum([np.longdouble(np.dtype(dtype).type(c)) * x**n for n, c in enumerate(coefficients)], axis=0)


@pytest.mark.parametrize("dtype", DTYPES)
def test_polynomials_are_exact_to_rounding(dtype):
    x = np.linspace(0, 1, 200, dtype=np.longdouble)
    name, half = np.dtype(dtype).name, np.finfo(dtype).eps / 2
    for shift in (0, 1):
        spin = short_series.economised(shift, short_series.SPIN_TERMS[name])
        assert abs(value(spin, WIDEST * x, dtype) - exactly(shift, WIDEST * x)).max() < 1.1 * half
        turn = short_series.half_angle_polynomials(name)[shift]
        assert abs(value(turn, WIDEST * x, dtype) - exactly(shift, WIDEST * x / 4) / (1 + shift)).max() < half
    for shift in (4, 5):
        terms = short_series.economised(shift, short_series.STUMPFF_TERMS[name], 4 * WIDEST)
        assert abs(value(terms, 4 * WIDEST * x, dtype) - exactly(shift, 4 * WIDEST * x)).max() < half / 16


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "dtype"), [("SYMMETRIC[E1]", "float32"), ("NEARSYM[E1]", "float64")])
def test_a_symmetric_body_turns_by_up_to_4_4_radians_in_a_flight(name, dtype):
    """A flight of h, the whole step of E1, is two of h/2, for a fast spin and for a turn about the momentum."""
    momenta, rates = np.array([[0.3, -0.2, 5.0], [20.0, 3.0, 0.5]]), np.array([4.0, 4.046])
    body, one = ml.RigidBody(jnp.asarray([5.0, 5.0, 1.0], dtype)), jnp.asarray([1.0, 0, 0, 0], dtype)

    def both(momentum, h):
        start = ml.RigidState(momentum, one)
        return [ml.integrate(name, body, None, start, dt=h / n, steps=n, save_every=None) for n in (1, 2)]

    fly_all = quick(jax.vmap(jax.vmap(both, (None, 0))))
    once, twice = fly_all(
        *(jnp.asarray(x, dtype) for x in (momenta, np.array([2.5, 3.5, 4.35, 4.45]) / rates[:, None]))
    )
    np.testing.assert_array_equal(once.ok, [[True, True, True, False]] * 2)
    for a, b in zip(*(map(np.asarray, jax.tree.leaves(path.states)) for path in (once, twice)), strict=True):
        scale = np.abs(a[:, :3]).max(axis=(1, 2), keepdims=True)
        assert np.all(np.abs(a - b)[:, :3] <= 40 * epsilon(dtype) * scale)
