"""The two oracles: the closed form of a free body and the Taylor series, against each other and published figures."""

from itertools import permutations

import numpy as np
import pytest
from laboratory.free_body import free_body

from midlie_jax.cli.oracle import exact_motion

ONE = (1.0, 0.0, 0.0, 0.0)
PIVOT = (5.0, 5.0, 1.0)


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
    """Largest relative difference of the one state in each; the quaternion's sign counts."""
    momenta, attitudes = (np.abs(one[0] - other[0]) for one, other in zip(motion, reference, strict=True))
    return max(np.max(momenta) / scale, np.max(attitudes))


def check_free(moments, momentum, time, attitude=ONE, within=3e-15):
    scale = max(float(np.linalg.norm(momentum)), 1e-300)
    motions = (oracle(moments, momentum, attitude, [time]) for oracle in (free_body, exact_motion))
    assert gap(*motions, scale) < within


@pytest.mark.parametrize("seed", range(12))
def test_free_body_agrees_with_taylor_series(seed):
    rng = np.random.default_rng(seed)
    moments = np.exp(rng.normal(size=3))  # any order, also beyond the triangle inequality
    check_free(moments, rng.normal(size=3), rng.uniform(-6, 6), rng.normal(size=4))


def test_free_body_published():
    start = (-0.709894965287627, -0.685144717153487, 0.163174308075589)
    momenta, _ = free_body((1, 1.648785782711929, 1.9720127096641928), start, ONE, [0.1])
    np.testing.assert_allclose(momenta[0], (-0.7088447919224319, -0.6905148054187735, 0.1439734852739128), atol=2e-15)
    start = (-0.609860759302936, 0.761660947972381, 0.218957654801698)
    momenta, attitudes = free_body((1, 1.012686988782515, 3.306237422473038), start, ONE, [10.0])
    np.testing.assert_allclose(momenta[0], (-0.7243786338874610, -0.6515663606923394, 0.2252484681001733), atol=2e-15)
    third = (-0.6484702022780026, -0.0046633029105, -0.7612257551892809)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], third, atol=1e-13)
    momenta, _ = free_body((0.6, 0.8, 1), (1.8, 0.4, -0.9), ONE, [10.0])
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
    momenta, attitudes = free_body((0.75, 1.0, 1.5), (0.5, 0.25, 0.5), ONE, [-300.0, 300.0])
    length = np.sqrt(0.5625)
    np.testing.assert_allclose(momenta, [[0, -length, 0], [0, length, 0]], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(attitudes, axis=1), 1, atol=1e-15)


@pytest.mark.sample(1)
@pytest.mark.parametrize("moments", list(permutations((1.0, 1e3, 1e6))))
def test_free_body_ratio_of_a_million(moments):
    check_free(moments, np.sqrt(moments) * (0.3, 1.0, -0.8), 3.0)


def test_free_body_at_rest_and_no_times():
    momenta, attitudes = free_body((1, 2, 3), (0, 0, 0), (0, 3, 0, 4), [0.0, 7.0])
    assert np.all(momenta == 0)
    np.testing.assert_allclose(attitudes, [[0, 0.6, 0, 0.8]] * 2, atol=1e-16)
    assert free_body((1, 2, 3), (1, 2, 3), ONE, [])[0].shape == (0, 3)


@pytest.mark.parametrize("time", [1e5, -1e9])
def test_free_body_long_times_conserve_and_compose(time):
    moments, start, attitude = np.array([0.8, 1.7, 1.1]), np.array([0.6, -0.2, 1.1]), np.array(ONE)
    momenta, attitudes = free_body(moments, start, attitude, [time])
    assert abs(np.sum(momenta[0] ** 2 / moments) / np.sum(start**2 / moments) - 1) < 1e-15
    np.testing.assert_allclose(matrix(attitudes[0]) @ momenta[0], start, atol=2e-15)
    # The second leap is short, so that rounding the state between the two cannot grow.
    middle = free_body(moments, start, attitude, [time - 3.0])
    again = free_body(moments, middle[0][0], middle[1][0], [3.0])
    assert gap(again, (momenta, attitudes), 1.0) < 1e-14


def test_free_body_quaternion_is_continuous():
    for moments in ((1.0, 1.5, 2.0), (2.0, 1.0, 1.5), (1.5, 1.0, 2.0)):
        for start in ((1.0, 0.1, 0.2), (0.2, 0.1, -1.0), (-0.3, 1.0, 0.2)):
            _, attitudes = free_body(moments, start, ONE, np.linspace(0, 8, 33))
            assert np.min(np.sum(attitudes[1:] * attitudes[:-1], axis=1)) > 0.9


# ---- the Taylor series ----


def test_top_published():
    momenta, attitudes = exact_motion(PIVOT, (0, 0, 50), tilted(0.05), [1.0, 10.0], weight=20.0)
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
    momenta, attitudes = exact_motion(PIVOT, (0, 0, 50), tilted(0.3), [10.0], weight=20.0)
    np.testing.assert_allclose(momenta[0], (-0.825255618261498, 0.772281645922085, 50), atol=1e-14)
    axis = (-0.274864608390022, 0.154741521010720, 0.948949160245105)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], axis, atol=1e-14)
    block, spin = (0.0454896, 0.0454896, 0.00139968), (0, 0, 313 * np.pi * 0.00139968)
    momenta, attitudes = exact_motion(block, spin, tilted(0.05), [0.8], weight=2.74617216)
    np.testing.assert_allclose(momenta[0], (0.001294760157796, 0.008576777914099, 1.376331238882863), atol=1e-14)
    axis = (0.055504854936289, 0.004308103862570, 0.998449123050047)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], axis, atol=1e-14)


@pytest.mark.parametrize("seed", range(6))
def test_a_heavy_body_keeps_its_laws_and_motions_compose(seed):
    """Any moments and any axis; the second motion goes back in time."""
    rng = np.random.default_rng(200 + seed)
    moments, start, axis, weight = np.exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3), rng.normal() * 3
    attitude = rng.normal(size=4)
    attitude /= np.linalg.norm(attitude)
    force = {"weight": weight, "axis": axis}

    def laws(pi, q):
        return np.sum(pi**2 / moments) / 2 + weight * (matrix(q) @ axis)[2], (matrix(q) @ pi)[2]

    momenta, attitudes = exact_motion(moments, start, attitude, [4.0, -2.5], **force)
    for pi, q in zip(momenta, attitudes, strict=True):
        np.testing.assert_allclose(laws(pi, q), laws(start, attitude), rtol=0, atol=1e-13)
        np.testing.assert_allclose(np.linalg.norm(q), 1, atol=3e-16)
    back = exact_motion(moments, momenta[0], attitudes[0], [-6.5], **force)
    assert gap(back, (momenta[1:], attitudes[1:]), np.linalg.norm(start)) < 1e-12


def test_units_do_not_matter():
    """Numbers as of molecules in SI units move as numbers of size 1, by powers of 2 that change no digit."""
    moments, start, weight = np.array([2.0, 1.0, 3.0]), np.array([0.7, -1.1, 0.4]), 1.3
    momenta, attitudes = exact_motion(moments, start, tilted(0.7), [3.0], weight=weight)
    small, short = 2.0**-150, 2.0**-40
    units = small / short
    found = exact_motion(small * moments, units * start, tilted(0.7), [3.0 * short], weight=weight * units / short)
    np.testing.assert_allclose(found[0] / units, momenta, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found[1], attitudes, rtol=0, atol=1e-15)


def test_sleeping_top_sleeps():
    """Also an unstable one."""
    momenta, attitudes = exact_motion(PIVOT, (0, 0, 2.0), ONE, [20.0], weight=20.0)
    assert np.all(momenta == (0, 0, 2))
    np.testing.assert_allclose(attitudes[0], (np.cos(20.0), 0, 0, np.sin(20.0)), atol=1e-15)


def test_a_pendulum_runs_into_its_upright_rest():
    """On its separatrix, exactly: level at the start, Pi^2 / (2 I1) = weight. Then tan(theta/4) falls exponentially."""
    for push in (20.0, -20.0):
        times = [0.5, 1.0, 2.0]
        _, attitudes = exact_motion((5.0, 5.0, 1.0), (push, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), times, weight=40.0)
        fall = np.tan(np.pi / 8) * np.exp(np.sqrt(40 / 5) * np.array(times) * np.sign(push))
        np.testing.assert_allclose([matrix(q)[2, 2] for q in attitudes], np.cos(4 * np.arctan(fall)), atol=1e-13)


def test_top_exact_regular_precession():
    """Level axis: w = weight / L3 = 2."""
    momenta, attitudes = exact_motion(PIVOT, (0.0, 10.0, 10.0), (1.0, 1.0, 0.0, 0.0), [3.0], weight=20.0)
    np.testing.assert_allclose(np.hypot(*momenta[0, :2]), 10, atol=1e-14)
    np.testing.assert_allclose(matrix(attitudes[0])[:, 2], (np.sin(6), -np.cos(6), 0), atol=1e-15)


def test_quaternions_are_continuous():
    for start in ((0.0, 0.0, 2.0), (9.0, 1.0, 2.0), (20.0, 0.0, 0.0), (-20.0, 5.0, 5.0)):
        _, attitudes = exact_motion(PIVOT, start, tilted(1.0), np.linspace(0, 4, 41), weight=20.0)
        assert np.min(np.sum(attitudes[1:] * attitudes[:-1], axis=1)) > 0.9


@pytest.mark.parametrize("oracle", [free_body, exact_motion])
def test_wrong_input_is_named(oracle):
    with pytest.raises(ValueError, match="moments must be positive"):
        oracle((1, 0, 1), (1, 1, 1), ONE, [1.0])
    with pytest.raises(ValueError, match="momentum must be 3 finite"):
        oracle((1, 2, 3), (1, np.nan, 1), ONE, [1.0])
    with pytest.raises(ValueError, match="zero quaternion"):
        oracle((1, 2, 3), (1, 1, 1), (0, 0, 0, 0), [1.0])
    with pytest.raises(ValueError, match="times"):
        oracle((1, 2, 3), (1, 1, 1), ONE, [np.inf])
