"""The two oracles: the closed form of a free body and the Taylor series, against each other and published figures."""

from itertools import permutations

import numpy as np
import pytest
from laboratory.free_body import free_body
from laboratory.rivals import matrix

from midlie_jax.cli.oracle import exact_motion

ONE = (1.0, 0.0, 0.0, 0.0)
PIVOT = (5.0, 5.0, 1.0)


def tilted(angle):
    return (np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0)


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
        given = moments, momentum, *(attitude or [ONE]), [time]
        assert gap(free_body(*given), exact_motion(*given), float(np.linalg.norm(momentum))) < 3e-15, given


def test_free_bodies_published():
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
    momenta, attitudes = free_body((0.75, 1.0, 1.5), (0.5, 0.25, 0.5), ONE, [-300.0, 300.0])  # on the separatrix
    np.testing.assert_allclose(momenta, [[0, -0.75, 0], [0, 0.75, 0]], atol=1e-15)


# ---- the Taylor series of tops: momentum and third axis of the body at the end ----

BLOCK, SPIN = (0.0454896, 0.0454896, 0.00139968), (0, 0, 313 * np.pi * 0.00139968)
PUBLISHED = [
    (PIVOT, (0, 0, 50), 0.05, 10.0, 20.0, (-0.153091997209136, 0.143264870866601, 50),
     (-0.0471322314419819, 0.0267486863587099, 0.998530450480797)),
    (PIVOT, (0, 0, 50), 0.3, 10.0, 20.0, (-0.825255618261498, 0.772281645922085, 50),
     (-0.274864608390022, 0.154741521010720, 0.948949160245105)),
    (BLOCK, SPIN, 0.05, 0.8, 2.74617216, (0.001294760157796, 0.008576777914099, 1.376331238882863),
     (0.055504854936289, 0.004308103862570, 0.998449123050047)),
]  # fmt: skip


@pytest.mark.parametrize(("moments", "start", "tilt", "time", "weight", "momentum", "axis"), PUBLISHED)
def test_tops_published(moments, start, tilt, time, weight, momentum, axis):
    momenta, attitudes = exact_motion(moments, start, tilted(tilt), [time], weight=weight)
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
