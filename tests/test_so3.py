"""Rotations: values, first and second derivatives against 120 digits, at and near zero and pi, in both dtypes."""

from itertools import combinations_with_replacement, product

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from cases import DTYPES, epsilon, quick
from scipy.spatial.transform import Rotation

from midlie_jax.model import so3

AXES = np.array([[0.0, 0.0, -1.0], [0.36, -0.48, 0.8], [-0.6, 0.64, 0.48]])
ANGLES = (0.0, 1e-300, 1e-160, 1e-30, 1e-8, 1e-4, 0.1, 0.39, 0.4, 0.99, 1.01, 1.99, 2.01, 3.0)
NEAR_PI = (np.pi - 1e-2, np.pi - 1e-4, np.pi - 1e-8, np.pi)
DIGITS, STEP = 120, "1e-20"
RATE = (0.7, -1.1, 0.4)


def vectors(angles, dtype):
    return np.concatenate([a * AXES for a in angles]).astype(dtype)


# ---- the same functions with many digits ----


def angle_of(v):
    return mpmath.sqrt(sum(x * x for x in v))


def ratio(a, closed, *series):
    """A function even in the angle: its Taylor series below 1e-10, where the closed form would lose digits."""
    return sum(c * a ** (2 * n) for n, c in enumerate(series)) if a < mpmath.mpf("1e-10") else closed(a)


def inverses(first):
    """(-1)^n / (2 n + first)!"""
    return [(-1) ** n / mpmath.factorial(2 * n + first) for n in range(6)]


def exact_exp(v):
    half = angle_of(v) / 2
    s = ratio(half, lambda a: mpmath.sin(a) / a, *inverses(1)) / 2
    return [mpmath.cos(half), *(s * x for x in v)]


def exact_log(q):
    sign = -1 if q[0] < 0 else 1
    w, norm = sign * q[0], angle_of(q[1:])
    factor = 2 * sign * (mpmath.atan2(norm, w) / norm if norm else 1 / w)
    return [factor * x for x in q[1:]]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def turned(v, b, c):
    """r + b v x r + c v x (v x r)"""
    r = [mpmath.mpf(x) for x in RATE]
    first = cross(v, r)
    return [x + b * y + c * z for x, y, z in zip(r, first, cross(v, first), strict=True)]


def exact_dexp(v):
    a = angle_of(v)
    b = ratio(a, lambda a: (1 - mpmath.cos(a)) / a**2, *inverses(2))
    return turned(v, b, ratio(a, lambda a: (a - mpmath.sin(a)) / a**3, *inverses(3)))


def exact_dexp_inverse(v):
    series = [1 / mpmath.mpf(n) for n in (12, 720, 30240, 1209600, 47900160)]
    c = ratio(angle_of(v), lambda a: (1 - a / 2 * mpmath.cot(a / 2)) / a**2, *series)
    return turned(v, -mpmath.mpf(1) / 2, c)


def exact_jet(function, point):
    """Value, Jacobian and Hessian of a function from many digits, by central differences."""
    with mpmath.workdps(DIGITS):
        h, x = mpmath.mpf(STEP), [mpmath.mpf(float(p)) for p in point]

        def shifted(*moves):
            y = list(x)
            for i, sign in moves:
                y[i] += sign * h
            return function(y)

        n, middle = len(x), function(x)
        ends = {(i, s): shifted((i, s)) for i in range(n) for s in (1, -1)}
        first = [[(u - d) / (2 * h) for u, d in zip(ends[i, 1], ends[i, -1], strict=True)] for i in range(n)]
        second = np.empty((n, n, len(middle)))
        for i, j in combinations_with_replacement(range(n), 2):
            corners = [ends[i, 1], middle, middle, ends[i, -1]]
            if i != j:
                corners = [shifted((i, a), (j, b)) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            over = h * h * (1 if i == j else 4)
            second[i, j] = second[j, i] = [float((a - b - c + d) / over) for a, b, c, d in zip(*corners, strict=True)]
        tensors = [float(x) for x in middle], [[float(f) for f in row] for row in first]
        return np.array(tensors[0]), np.array(tensors[1]).T, np.moveaxis(second, -1, 0)


def jet(function, points):
    def all_of_it(x):
        return function(x), jax.jacfwd(function)(x), jax.jacrev(function)(x), jax.jacfwd(jax.jacfwd(function))(x)

    return [np.asarray(part) for part in quick(jax.vmap(all_of_it))(jnp.asarray(points))]


def check_jets(function, exact, points, dtype, bounds):
    """Entries to `bounds` units of rounding of the largest entry of the tensor they belong to."""
    value, forward, reverse, second = jet(function, points)
    worst = [0.0, 0.0, 0.0]
    for k, point in enumerate(points):
        truth = exact_jet(exact, point)
        for order, found in enumerate(((value[k],), (forward[k], reverse[k]), (second[k],))):
            size = max(1.0, np.abs(truth[order]).max())
            for array in found:
                assert array.dtype == dtype
                worst[order] = max(worst[order], np.abs(array - truth[order]).max() / size / epsilon(dtype))
    assert all(w <= b for w, b in zip(worst, bounds, strict=True)), worst


# The closed forms beyond a = 1 divide differences of order a^2 or a^3 by them, once more for each derivative.
@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(
    ("function", "exact", "bounds"),
    [
        (so3.exp, exact_exp, (2, 4, 16)),
        (lambda v: so3.dexp(v, jnp.array(RATE, v.dtype)), exact_dexp, (8, 32, 128)),
        (lambda v: so3.dexp_inverse(v, jnp.array(RATE, v.dtype)), exact_dexp_inverse, (8, 32, 128)),
    ],
    ids=["exp", "dexp", "dexp_inverse"],
)
def test_functions_of_a_vector(function, exact, bounds, dtype):
    check_jets(function, exact, vectors(ANGLES + NEAR_PI, dtype), dtype, bounds)


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_log(dtype):
    with mpmath.workdps(DIGITS):
        turns = [[mpmath.mpf(float(a)) * mpmath.mpf(float(x)) for x in axis] for a in ANGLES + NEAR_PI for axis in AXES]
        points = np.array([[float(x) for x in exact_exp(turn)] for turn in turns]).astype(dtype)
    check_jets(so3.log, exact_log, np.concatenate([points, -points[points[:, 0] > 1e-9]]), dtype, (4, 16, 64))


# ---- against SciPy ----


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_operations_agree_with_scipy(dtype):
    rng = np.random.default_rng(1)
    a = Rotation.random(200, rng=rng).as_quat(scalar_first=True).astype(dtype)
    b = Rotation.random(200, rng=rng).as_quat(scalar_first=True).astype(dtype)
    ra, rb = (Rotation.from_quat(q, scalar_first=True) for q in (a, b))
    v = rng.normal(size=(200, 3)).astype(dtype)
    p, q, x = map(jnp.asarray, (a, b, v))
    slack = 8 * epsilon(dtype)
    np.testing.assert_allclose(so3.rotate(p, x), ra.apply(v), atol=4 * slack)
    np.testing.assert_allclose(so3.to_matrix(p), ra.as_matrix(), atol=slack)
    np.testing.assert_allclose(so3.to_matrix(so3.multiply(p, q)), (ra * rb).as_matrix(), atol=slack)
    np.testing.assert_allclose(so3.to_matrix(so3.conjugate(p)), ra.inv().as_matrix(), atol=slack)
    back = np.asarray(so3.from_matrix(so3.to_matrix(p)))
    assert back.min(axis=0)[0] >= 0
    np.testing.assert_allclose(back, np.where(a[:, :1] < 0, -a, a), atol=slack)
    assert so3.rotate(p[None], x[None]).shape == (1, 200, 3)


# ---- round trips, with derivatives: each is the identity, so its Jacobian is 1 and its Hessian 0 ----


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_log_undoes_exp_through_the_matrix(dtype):
    # Up to just short of pi; each of the four formulas of from_matrix is met.
    points = vectors((*ANGLES, np.pi - 1e-2, np.pi - 1e-3), dtype)
    value, forward, reverse, second = jet(lambda v: so3.log(so3.from_matrix(so3.to_matrix(so3.exp(v)))), points)
    pairs = (value, points), (forward, np.eye(3)), (reverse, np.eye(3)), (second, 0)
    errors = np.array([np.abs(x - y).max() for x, y in pairs]) / epsilon(dtype)
    assert np.all(errors <= [8, 32, 32, 256]), errors


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_dexp_is_the_derivative_of_exp(dtype):
    """exp(v + r s) exp(-v) turns by dexp(v, r) s, and in the body by dexp(-v, r) s."""

    def both(v, r):
        q, change = jax.jvp(so3.exp, (v,), (r,))
        space = 2 * so3.multiply(change, so3.conjugate(q))[1:] - so3.dexp(v, r)
        body = 2 * so3.multiply(so3.conjugate(q), change)[1:] - so3.dexp(-v, r)
        return space, body, so3.dexp_inverse(v, so3.dexp(v, r)) - r

    v = vectors(ANGLES + NEAR_PI, dtype)
    r = np.random.default_rng(2).normal(size=v.shape).astype(dtype)
    for difference in jax.vmap(both)(v, r):
        assert np.abs(difference).max() <= 16 * epsilon(dtype) * np.abs(r).max()


SEQUENCES = ["".join(axes) for axes in product("XYZ", repeat=3) if axes[0] != axes[1] != axes[2]]


@pytest.mark.sample(4)
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_angles_agree_with_scipy_and_give_the_rotation_back(sequence):
    quaternions = np.random.default_rng(5).normal(size=(200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    angles = so3.to_euler(jnp.asarray(quaternions), sequence)
    expected = Rotation.from_quat(quaternions, scalar_first=True).as_euler(sequence)
    np.testing.assert_allclose(angles, expected, atol=1e-11)
    back = so3.from_euler(angles, sequence)
    np.testing.assert_allclose(np.abs(np.sum(back * quaternions, axis=1)), 1, atol=1e-14)
    digits = sequence.translate(str.maketrans("XYZ", "123"))
    np.testing.assert_array_equal(so3.to_euler(jnp.asarray(quaternions), digits), angles)
    # At the singularity the three angles still give the rotation.
    middle = 0.0 if sequence[0] == sequence[2] else np.pi / 2
    locked = so3.from_euler(jnp.array([0.3, middle, -0.8]), sequence)
    again = so3.from_euler(so3.to_euler(locked, sequence), sequence)
    np.testing.assert_allclose(abs(jnp.sum(again * locked)), 1, atol=1e-14)


def test_euler_angles_have_derivatives_and_refuse_other_sequences():
    angles = jnp.array([0.3, 0.4, -0.8])
    found = jax.jacfwd(lambda a: so3.to_euler(so3.from_euler(a, "ZYX"), "ZYX"))(angles)
    np.testing.assert_allclose(found, jnp.eye(3), atol=1e-13)
    for sequence in ("ZZX", "AB", "1234", "xyy"):
        with pytest.raises(ValueError, match="sequence must be three axes"):
            so3.to_euler(jnp.array([1.0, 0, 0, 0]), sequence)
