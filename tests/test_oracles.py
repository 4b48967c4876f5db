"""The closed forms against a 30-digit Taylor series, published figures and the laws of motion."""

from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest

from midlie_jax.cli import oracles

BITS = 150  # of the fixed-point numbers below
ORDER = 32
ONE = (1.0, 0.0, 0.0, 0.0)
PIVOT = (5.0, 5.0, 1.0)


def fixed(value: Fraction | float) -> int:
    value = Fraction(value)
    return (value.numerator << BITS) // value.denominator


def convolve(*pairs: tuple[list[int], list[int], int]) -> int:
    """The last Taylor coefficient of a sum of products, each with a sign."""
    total = 0
    for a, b, sign in pairs:
        total += sign * sum(map(int.__mul__, a, reversed(b)))
    return total >> BITS


def taylor(moments, momentum, attitude, time, mgl=0.0):
    """Momentum and quaternion by a Taylor series of order 32 in fixed-point integers: slow, and unlike any oracle."""
    w, x, y, z = map(Fraction, map(float, attitude))
    norm = w * w + x * x + y * y + z * z
    up = [2 * (x * z - w * y) / norm, 2 * (y * z + w * x) / norm, (w * w - x * x - y * y + z * z) / norm]
    length = Fraction(np.sqrt(float(norm)))
    for _ in range(3):  # Newton: a square root to all digits
        length = Fraction(fixed((length + norm / length) / 2), 1 << BITS)
    values = [fixed(float(p)) for p in momentum] + [fixed(u) for u in up] + [fixed(q / length) for q in (w, x, y, z)]
    slow = [fixed(1 / Fraction(float(i))) for i in moments]
    weight, left, sign = fixed(float(mgl)), fixed(abs(float(time))), 1 if time >= 0 else -1
    while left > 0:
        series = [[v] for v in values]
        spin: list[list[int]] = [[], [], []]
        p1, p2, p3, g1, g2, g3, qw, qx, qy, qz = series
        for n in range(ORDER):
            for s, p, i in zip(spin, series, slow, strict=False):
                s.append(p[n] * i >> BITS)
            o1, o2, o3 = spin
            rates = [
                convolve((p2, o3, 1), (p3, o2, -1)) + (weight * g2[n] >> BITS),
                convolve((p3, o1, 1), (p1, o3, -1)) - (weight * g1[n] >> BITS),
                convolve((p1, o2, 1), (p2, o1, -1)),
                convolve((g2, o3, 1), (g3, o2, -1)),
                convolve((g3, o1, 1), (g1, o3, -1)),
                convolve((g1, o2, 1), (g2, o1, -1)),
                convolve((qx, o1, -1), (qy, o2, -1), (qz, o3, -1)) >> 1,
                convolve((qw, o1, 1), (qy, o3, 1), (qz, o2, -1)) >> 1,
                convolve((qw, o2, 1), (qz, o1, 1), (qx, o3, -1)) >> 1,
                convolve((qw, o3, 1), (qx, o2, 1), (qy, o1, -1)) >> 1,
            ]
            for s, r in zip(series, rates, strict=True):
                s.append(sign * r // (n + 1))
        sizes = [max(1e-40, max(abs(s[n]) for s in series) / 2.0**BITS) for n in (ORDER - 1, ORDER)]
        step = min(fixed(min((1e-31 / sizes[0]) ** (1 / (ORDER - 1)), (1e-31 / sizes[1]) ** (1 / ORDER), 1.0)), left)
        for k, s in enumerate(series):
            value = 0
            for coefficient in reversed(s):
                value = coefficient + (value * step >> BITS)
            values[k] = value
        left -= step
    numbers = [float(Fraction(v, 1 << BITS)) for v in values]
    return np.array(numbers[:3]), np.array(numbers[6:])


def matrix(q):
    w, x, y, z = q
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows)


def tilted(angle):
    return (np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0)


def gap(motion, reference, scale):
    """Largest relative difference of the one state in `motion`; the quaternion's sign counts."""
    momenta, attitudes = motion
    return max(np.max(np.abs(momenta[0] - reference[0])) / scale, np.max(np.abs(attitudes[0] - reference[1])))


def check_free(moments, momentum, time, attitude=ONE, within=3e-15):
    scale = max(float(np.linalg.norm(momentum)), 1e-300)
    reference = taylor(moments, momentum, attitude, time)
    assert gap(oracles.free_body(moments, momentum, attitude, [time]), reference, scale) < within


def check_top(moments, mgl, momentum, attitude, time, within=3e-15):
    reference = taylor(moments, momentum, attitude, time, mgl)
    scale = max(float(np.linalg.norm(momentum)), float(np.linalg.norm(reference[0])), 1e-300)
    assert gap(oracles.lagrange_top(moments, mgl, momentum, attitude, [time]), reference, scale) < within


# ---- free body ----


@pytest.mark.parametrize("seed", range(12))
def test_free_body_agrees_with_taylor_series(seed):
    rng = np.random.default_rng(seed)
    moments = np.exp(rng.normal(size=3))  # any order, also beyond the triangle inequality
    check_free(moments, rng.normal(size=3), rng.uniform(-6, 6), rng.normal(size=4))


def test_free_body_published():
    start = (-0.709894965287627, -0.685144717153487, 0.163174308075589)
    momenta, _ = oracles.free_body((1, 1.648785782711929, 1.9720127096641928), start, ONE, [0.1])
    np.testing.assert_allclose(momenta[0], (-0.7088447919224319, -0.6905148054187735, 0.1439734852739128), atol=2e-15)
    start = (-0.609860759302936, 0.761660947972381, 0.218957654801698)
    momenta, attitudes = oracles.free_body((1, 1.012686988782515, 3.306237422473038), start, ONE, [10.0])
    np.testing.assert_allclose(momenta[0], (-0.7243786338874610, -0.6515663606923394, 0.2252484681001733), atol=2e-15)
    third = (-0.6484702022780026, -0.0046633029105, -0.7612257551892809)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], third, atol=1e-13)
    momenta, _ = oracles.free_body((0.6, 0.8, 1), (1.8, 0.4, -0.9), ONE, [10.0])
    np.testing.assert_allclose(momenta[0], (1.76596250851821, -0.695464197033089, 0.779554981481871), atol=1e-14)


NEARLY = 1 + 4 * np.finfo(float).eps
EQUAL_MOMENTS = [*sorted(set(permutations((2.0, 2.0, 3.0)))), *sorted(set(permutations((2.0, 3.0, 3.0))))]
EQUAL_MOMENTS += [*permutations((2.0, 2.0 * NEARLY, 3.0)), *permutations((2.0, 3.0, 3.0 / NEARLY))]


@pytest.mark.parametrize("moments", EQUAL_MOMENTS)
def test_free_body_two_moments_equal(moments):
    check_free(moments, (0.7, -1.1, 0.4), 5.0, (0.5, -0.5, 0.1, 0.7))


@pytest.mark.parametrize("moments", [(2.0, 2.0, 2.0), (2.0, 2.0 * NEARLY, 2.0), (2.0 / NEARLY, 2.0, 2.0 * NEARLY)])
def test_free_body_spherical(moments):
    check_free(moments, (0.7, -1.1, 0.4), 5.0)


@pytest.mark.parametrize("moments", [(2.0, 2.0, 3.0), (2.0, 2.0 * NEARLY, 3.0), (2.0, 2.0 + 1e-9, 3.0)])
def test_free_body_spin_across_the_symmetry_axis(moments):
    check_free(moments, (0.7, -1.1, 0.0), 5.0)
    check_free(moments, (0.7, -1.1, 1e-12), 5.0)


@pytest.mark.parametrize("moments", list(permutations((1.0, 2.0, 3.5))))
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("off", [0.0, 1e-13, 1e-5])
def test_free_body_principal_axis(moments, axis, off):
    momentum = [off, -off, off]
    momentum[axis] = -1.5
    check_free(moments, momentum, 4.0)


@pytest.mark.parametrize("moments", [(1.0, 2.0, 3.0), (3.0, 1.0, 2.0)])
@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1)])
@pytest.mark.parametrize("off", [0.0, 1e-6, -1e-6, 1e-10, -1e-10, 1e-14, -1e-14])
def test_free_body_separatrix(moments, signs, off):
    # On 2 H I2 = |Pi|^2 to the last bit: with moments .75, 1, 1.5 that is Pi1 = Pi3. The marks 1, 2, 3 fix the order.
    table = {1.0: 0.75, 2.0: 1.0, 3.0: 1.5}
    values = {1.0: signs[0] * 0.5 * (1 + off), 2.0: 0.25, 3.0: signs[1] * 0.5}
    check_free([table[m] for m in moments], [values[m] for m in moments], 20.0)


def test_free_body_separatrix_ends_on_the_middle_axis():
    momenta, attitudes = oracles.free_body((0.75, 1.0, 1.5), (0.5, 0.25, 0.5), ONE, [-300.0, 300.0])
    length = np.sqrt(0.5625)
    np.testing.assert_allclose(momenta, [[0, -length, 0], [0, length, 0]], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(attitudes, axis=1), 1, atol=1e-15)


@pytest.mark.sample(1)
@pytest.mark.parametrize("moments", list(permutations((1.0, 1e3, 1e6))))
def test_free_body_ratio_of_a_million(moments):
    check_free(moments, np.sqrt(moments) * (0.3, 1.0, -0.8), 3.0)


def test_free_body_at_rest_and_no_times():
    momenta, attitudes = oracles.free_body((1, 2, 3), (0, 0, 0), (0, 3, 0, 4), [0.0, 7.0])
    assert np.all(momenta == 0)
    np.testing.assert_allclose(attitudes, [[0, 0.6, 0, 0.8]] * 2, atol=1e-16)
    assert oracles.free_body((1, 2, 3), (1, 2, 3), ONE, [])[0].shape == (0, 3)


@pytest.mark.parametrize("time", [1e5, -1e9])
def test_free_body_long_times_conserve_and_compose(time):
    moments, start, attitude = np.array([0.8, 1.7, 1.1]), np.array([0.6, -0.2, 1.1]), np.array(ONE)
    momenta, attitudes = oracles.free_body(moments, start, attitude, [time])
    assert abs(np.sum(momenta[0] ** 2 / moments) / np.sum(start**2 / moments) - 1) < 1e-15
    np.testing.assert_allclose(matrix(attitudes[0]) @ momenta[0], start, atol=2e-15)
    # The second leap is short, so that rounding the state between the two cannot grow.
    middle = oracles.free_body(moments, start, attitude, [time - 3.0])
    again = oracles.free_body(moments, middle[0][0], middle[1][0], [3.0])
    assert gap(again, (momenta[0], attitudes[0]), 1.0) < 1e-14


def test_free_body_quaternion_is_continuous():
    for moments in ((1.0, 1.5, 2.0), (2.0, 1.0, 1.5), (1.5, 1.0, 2.0)):
        for start in ((1.0, 0.1, 0.2), (0.2, 0.1, -1.0), (-0.3, 1.0, 0.2)):
            _, attitudes = oracles.free_body(moments, start, ONE, np.linspace(0, 8, 33))
            assert np.min(np.sum(attitudes[1:] * attitudes[:-1], axis=1)) > 0.9


# ---- Lagrange's top ----


@pytest.mark.parametrize("seed", range(12))
def test_top_agrees_with_taylor_series(seed):
    rng = np.random.default_rng(100 + seed)
    across, along = np.exp(rng.normal(size=2))
    momentum, attitude = rng.normal(size=3), rng.normal(size=4)
    check_top((across, across, along), rng.normal(), momentum, attitude, rng.uniform(-5, 5))


def test_top_published():
    momenta, attitudes = oracles.lagrange_top(PIVOT, 20.0, (0, 0, 50), tilted(0.05), [1.0, 10.0])
    np.testing.assert_allclose(momenta[0], (-0.113617175760399, 0.184034282516356, 50), atol=1e-15)
    axis = (0.021541104974264, -0.050010335483372, 0.998516372996121)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], axis, atol=1e-15)
    np.testing.assert_allclose(momenta[1], (-0.153091997209136, 0.143264870866601, 50), atol=1e-14)
    rows = [
        [-0.880353208246793, 0.471971165950715, -0.0471322314419819],
        [-0.473439184662768, -0.880420266806675, 0.0267486863587099],
        [-0.0288715630929733, 0.0458625370775063, 0.998530450480797],
    ]
    np.testing.assert_allclose(matrix(attitudes[1]), rows, atol=2e-15)
    momenta, attitudes = oracles.lagrange_top(PIVOT, 20.0, (0, 0, 50), tilted(0.3), [10.0])
    np.testing.assert_allclose(momenta[0], (-0.825255618261498, 0.772281645922085, 50), atol=1e-14)
    axis = (-0.274864608390022, 0.154741521010720, 0.948949160245105)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], axis, atol=1e-14)
    block, spin = (0.0454896, 0.0454896, 0.00139968), (0, 0, 313 * np.pi * 0.00139968)
    momenta, attitudes = oracles.lagrange_top(block, 2.74617216, spin, tilted(0.05), [0.8])
    np.testing.assert_allclose(momenta[0], (0.001294760157796, 0.008576777914099, 1.376331238882863), atol=1e-14)
    axis = (0.055504854936289, 0.004308103862570, 0.998449123050047)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], axis, atol=1e-14)


@pytest.mark.parametrize("attitude", [(0.6, 0.0, 0.0, 0.8), (0.0, 0.6, -0.8, 0.0)])
@pytest.mark.parametrize("spin", [0.0, 2.0, -30.0])
@pytest.mark.parametrize("push", [0.0, 1e-14, 1e-7, 1e-3, 2.0])
def test_top_from_the_vertical(attitude, spin, push):
    # Up with spin 2 the sleeping top is unstable (L3^2 < 4 I1 mgl = 400), with spin 30 stable; down it is a pendulum.
    check_top(PIVOT, 20.0, (push, -0.3 * push, spin), attitude, 3.0)


@pytest.mark.sample(9)
@pytest.mark.parametrize("spin", [2.0, 19.999999999, 20.0, 20.000000001, 60.0])
@pytest.mark.parametrize("tilt", [1e-12, 1e-6, 0.2])
def test_top_near_the_sleeping_one(spin, tilt):
    check_top(PIVOT, 20.0, (0.0, 0.0, spin), tilted(tilt), 4.0)


def test_sleeping_top_sleeps():
    momenta, attitudes = oracles.lagrange_top(PIVOT, 20.0, (0, 0, 2.0), ONE, [1e4])
    assert np.all(momenta == (0, 0, 2))
    np.testing.assert_allclose(attitudes[0], (np.cos(1e4), 0, 0, np.sin(1e4)), atol=1e-15)


def test_top_running_into_the_sleeping_one():
    # Pendulum on its separatrix, exactly: level axis, Pi^2 / (2 I1) = mgl. It reaches the top at infinite time.
    level = (1.0, 1.0, 0.0, 0.0)
    for push in (20.0, -20.0):
        check_top((5.0, 5.0, 1.0), 40.0, (push, 0.0, 0.0), level, 3.0)
        check_top((5.0, 5.0, 1.0), 40.0, (push * (1 + 1e-14), 0.0, 0.0), level, 9.0)
        check_top((5.0, 5.0, 1.0), 40.0, (push * (1 - 1e-10), 0.0, 0.0), level, 9.0)
    _, attitudes = oracles.lagrange_top((5.0, 5.0, 1.0), 40.0, (-20.0, 0.0, 0.0), level, [500.0])
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], (0, 0, 1), atol=1e-15)
    # The same with spin: at level axis lz = Pi2 = L3 = 12, and Pi1^2 + Pi2^2 = 2 I1 mgl = 400 leaves Pi1 = 16.
    check_top((5.0, 5.0, 1.0), 40.0, (16.0, 12.0, 12.0), level, 3.0)
    check_top((5.0, 5.0, 1.0), 40.0, (-16.0, 12.0, 12.0), level, 3.0)


@pytest.mark.sample(3)
@pytest.mark.parametrize("factor", [1.0, 1 + 1e-15, 1 - 1e-12, 1 + 1e-7])
def test_top_regular_precession(factor):
    # The quaternion (2, 1, 0, 0) has cos = .6 and sin = .8; I1 w^2 cos - L3 w + mgl = 0 with w = 1 gives L3 = 23.
    momentum = (0.0, 5.0 * 0.8 * factor, 23.0)
    check_top(PIVOT, 20.0, momentum, (2.0, 1.0, 0.0, 0.0), 4.0)


def test_top_exact_regular_precession():
    # Level axis: w = mgl / L3 = 2, I1 w = 10, doubles all of them, so the double root is exact.
    momenta, attitudes = oracles.lagrange_top(PIVOT, 20.0, (0.0, 10.0, 10.0), (1.0, 1.0, 0.0, 0.0), [3.0])
    check_top(PIVOT, 20.0, (0.0, 10.0, 10.0), (1.0, 1.0, 0.0, 0.0), 3.0)
    np.testing.assert_allclose(np.hypot(*momenta[0, :2]), 10, atol=1e-14)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], (np.sin(6), -np.cos(6), 0), atol=1e-15)


@pytest.mark.sample(9)
@pytest.mark.parametrize("mgl", [20.0, -20.0])
@pytest.mark.parametrize(
    "momentum", [(0, 0, 0), (3.0, 0, 0), (40.0, 0, 0), (0, 3.0, 0), (1.0, 2.0, 0), (-17.0, 1e-9, 0)]
)
def test_top_without_spin(mgl, momentum):
    check_top(PIVOT, mgl, momentum, tilted(2.0), 4.0)


@pytest.mark.parametrize("mgl", [0.0, 1e-9, -1e-9, 1e6])
def test_top_weak_and_strong_weight(mgl):
    check_top((1.0, 1.0, 0.5), mgl, (0.5, -0.3, 1.0), (0.5, -0.5, 0.1, 0.7), 4.0 if abs(mgl) < 1 else 0.02)


def test_top_moments_far_apart():
    check_top((1.0, 1.0, 1e-6), 3.0, (0.5, -0.3, 1e-3), tilted(1.0), 0.2)
    check_top((1.0, 1.0, 1e6), 3.0, (0.5, -0.3, 1e3), tilted(1.0), 0.1)


@pytest.mark.parametrize("time", [1e4, -1e8])
def test_top_long_times_conserve_and_compose(time):
    moments, start, attitude = np.array([2.0, 2.0, 0.7]), np.array([0.6, -0.2, 3.1]), np.array(tilted(0.7))

    def energy(pi, q):
        return np.sum(pi**2 / moments) / 2 + 4.0 * matrix(q)[2, 2]

    momenta, attitudes = oracles.lagrange_top(moments, 4.0, start, attitude, [time])
    assert abs(energy(momenta[0], attitudes[0]) / energy(start, attitude) - 1) < 2e-15
    vertical = (matrix(attitudes[0]) @ momenta[0])[2]
    assert abs(vertical - (matrix(attitude) @ start)[2]) < 5e-15
    assert momenta[0, 2] == start[2]
    middle = oracles.lagrange_top(moments, 4.0, start, attitude, [time - 2.0])
    again = oracles.lagrange_top(moments, 4.0, middle[0][0], middle[1][0], [2.0])
    assert gap(again, (momenta[0], attitudes[0]), 3.0) < 1e-14


def test_top_quaternion_is_continuous():
    for start in ((0.0, 0.0, 2.0), (9.0, 1.0, 2.0), (20.0, 0.0, 0.0), (-20.0, 5.0, 5.0)):
        _, attitudes = oracles.lagrange_top(PIVOT, 20.0, start, tilted(1.0), np.linspace(0, 4, 41))
        assert np.min(np.sum(attitudes[1:] * attitudes[:-1], axis=1)) > 0.9


# ---- errors ----


def test_wrong_input_is_named():
    with pytest.raises(ValueError, match="moments must be positive"):
        oracles.free_body((1, 0, 1), (1, 1, 1), ONE, [1.0])
    with pytest.raises(ValueError, match="momentum must be 3 finite"):
        oracles.free_body((1, 2, 3), (1, np.nan, 1), ONE, [1.0])
    with pytest.raises(ValueError, match="zero quaternion"):
        oracles.free_body((1, 2, 3), (1, 1, 1), (0, 0, 0, 0), [1.0])
    with pytest.raises(ValueError, match="times"):
        oracles.free_body((1, 2, 3), (1, 1, 1), ONE, [np.inf])
    with pytest.raises(ValueError, match="first two moments equal"):
        oracles.lagrange_top((1, 2, 3), 1.0, (1, 1, 1), ONE, [1.0])
