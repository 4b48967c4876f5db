"""Scattered inputs: a body's draw is its own to the bit, draws follow their laws, and bad input is named."""

import os
import subprocess
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, epsilon, refused, whole
from scipy import stats

import midlie_jax as ml

d = ml.distributions
KEY = jax.random.key(17)
RNG = np.random.default_rng(5)
ROOT = RNG.normal(size=(4, 3))
SEMIDEFINITE = ROOT @ ROOT.T  # of rank 3
TABLE = RNG.normal(size=(7, 2))
MEAN_ATTITUDE = np.array([0.5, -0.5, 0.5, 0.5])
EVERY = {
    "number": d.Normal(1.0, 0.3),
    "matrix": d.Normal(np.arange(6.0).reshape(2, 3), 0.1),
    "vector": d.Normal([1.0, 2.0, 3.0, 4.0], covariance=SEMIDEFINITE),
    "moments": d.LogNormal([5.0, 5.0, 2.0], [0.1, 0.2, 0.0]),
    "box": d.Uniform(-1.0, [1.0, 2.0]),
    "axis": d.Sphere(2.0),
    "anyhow": d.Rotation(),
    "pointed": d.RotationNear(MEAN_ATTITUDE, [0.1, 0.2, 0.3]),
    "lost": d.RotationNear(MEAN_ATTITUDE, 2.0),
    "row": d.Rows(TABLE),
    "own": d.Each(RNG.normal(size=(2500, 2))),
    "both": d.Joint({"z": 1.0, "a": [[0.0, 1.0, 2.0]]}, SEMIDEFINITE),
}
MANY = 20_000
SIGMAS = 5.0  # of a mean of MANY draws; more are seen once in two million
SMIRNOV = 1.95 / np.sqrt(MANY)  # the distance of Kolmogorov and Smirnov that one sample in a thousand exceeds


def draws(distribution, dtype):
    return jax.tree.map(np.asarray, ml.scatter(KEY, MANY, dtype=dtype, x=distribution)["x"])


same_bits = partial(jax.tree.map, partial(np.testing.assert_array_equal, strict=True))  # and dtypes


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_a_body_is_the_same_in_any_company(dtype):
    """Alone, in groups of sizes around those of the blocks, in any order, and at every place of a block."""
    drawn = ml.scatter(KEY, 2500, dtype=dtype, **EVERY)
    assert list(drawn) == list(EVERY)
    whole = jax.tree.map(np.asarray, drawn)
    assert all(leaf.dtype == dtype and len(leaf) == 2500 for leaf in jax.tree.leaves(whole))
    groups = [range(n) for n in (1, 17, 1023, 1024, 1025)]
    groups += [[1023], [2499], range(1000, 1100), RNG.permutation(2500), np.full(1024, 777), range(0)]
    for group in groups:
        rows = np.asarray(group, int)
        some = ml.scatter(KEY, group, dtype=dtype, **EVERY)
        same_bits(jax.tree.map(np.asarray, some), jax.tree.map(lambda x, rows=rows: x[rows], whole))
    alone = ml.scatter(KEY, 300, dtype=dtype, pointed=EVERY["pointed"])  # without other quantities
    same_bits(jax.tree.map(np.asarray, alone), {"pointed": whole["pointed"][:300]})


PROGRAM = """
import hashlib, sys; sys.path.insert(0, "tests")
import jax; jax.config.update("jax_enable_x64", True)
import test_scatter as t
names = sys.argv[2:] or t.EVERY
drawn = t.ml.scatter(t.KEY, 2500, dtype=sys.argv[1], **{n: t.EVERY[n] for n in names})
bits = b"".join(t.np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(drawn))
print(jax.device_count(), hashlib.sha256(bits).hexdigest())
"""


@pytest.mark.sample(0)
@pytest.mark.parametrize("arguments", [("float64", "pointed"), *whole((("float64",),), (("float32",),))], ids=" ".join)
def test_processes_with_other_devices_draw_the_same(arguments):
    """With the compiler as users have it; Python's hash of a name, which differs as well, must not matter."""
    said = []
    for n in ("1", "3"):
        flags = {"XLA_FLAGS": f"--xla_force_host_platform_device_count={n}", "PYTHONHASHSEED": n}
        command = [sys.executable, "-c", PROGRAM, *arguments]
        done = subprocess.run(command, env=os.environ | flags, stdout=subprocess.PIPE, text=True, check=True)
        said.append(done.stdout.split())
        assert said[-1] == [n, said[0][1]]


def test_dtype_follows_x64():
    assert ml.scatter(KEY, 3, x=d.Uniform(0.0, 1.0))["x"].dtype == jnp.float64
    with jax.enable_x64(False):
        assert ml.scatter(KEY, 3, x=d.Uniform(0.0, 1.0))["x"].dtype == jnp.float32
        with pytest.raises(ValueError, match=r"dtype float64 needs .*jax_enable_x64"):
            ml.scatter(KEY, 3, dtype="float64", x=d.Uniform(0.0, 1.0))


def assert_moments(found, mean, covariance):
    spread = np.diag(covariance)
    rounding = 1e-5 * spread.max()  # of float32, where nothing is scattered
    assert np.all(np.abs(found.mean(0) - mean) <= SIGMAS * np.sqrt(spread / MANY) + rounding)
    error = np.sqrt((np.outer(spread, spread) + covariance**2) / MANY)
    assert np.all(np.abs(np.cov(found.T) - covariance) <= SIGMAS * error + rounding)


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_normal_has_its_mean_and_covariance(dtype):
    """Also of quantities in one covariance whose variances differ by 22 orders of magnitude, or are zero."""
    found = draws(EVERY["vector"], dtype)
    assert_moments(found, [1.0, 2.0, 3.0, 4.0], SEMIDEFINITE)
    plane = np.linalg.svd(ROOT.T)[2][3]  # the direction in which nothing is scattered
    assert np.max(np.abs((found - [1.0, 2.0, 3.0, 4.0]) @ plane)) < 1e-7 * (1 if dtype == "float64" else 500)
    found = draws(d.Normal([0.0, 3.0], [2.0, 0.0]), dtype)
    assert np.all(found[:, 1] == 3.0)
    assert stats.kstest(found[:, 0] / 2, "norm").statistic < SMIRNOV
    sizes = np.array([1.0, 1e-5, 1e6, 0.0])
    correlations = np.where(np.eye(4) > 0, 1.0, 0.5)
    mean = {"a": 0.0, "b": [0.0, 0.0], "fixed": 7.0}
    drawn = draws(d.Joint(mean, correlations * np.outer(sizes, sizes)), dtype)
    assert np.all(drawn["fixed"] == 7.0)
    scaled = np.column_stack([drawn["a"], drawn["b"]]).astype(np.float64) / sizes[:3]
    assert_moments(scaled, np.zeros(3), correlations[:3, :3])


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_numbers_follow_their_laws(dtype):
    moments = draws(EVERY["moments"], dtype)
    assert np.all(moments[:, 2] == 2.0)
    for column, deviation in ((0, 0.1), (1, 0.2)):
        sigma = np.sqrt(np.log1p(deviation**2))
        assert stats.kstest(moments[:, column], "lognorm", (sigma, 0, 5.0)).statistic < SMIRNOV
        mean = 5.0 * np.sqrt(1 + deviation**2)
        assert abs(moments[:, column].mean() - mean) < SIGMAS * deviation * mean / np.sqrt(MANY)
        # Of draws near normal the relative error of the deviation is about 1 / sqrt(2 n).
        assert moments[:, column].std() / mean == pytest.approx(deviation, rel=1.5 * SIGMAS / np.sqrt(2 * MANY))
    box = draws(EVERY["box"], dtype)
    for column, width in ((0, 2.0), (1, 3.0)):
        assert stats.kstest(box[:, column], "uniform", (-1.0, width)).statistic < SMIRNOV
    both = draws(EVERY["both"], dtype)
    assert {name: x.shape for name, x in both.items()} == {"z": (MANY,), "a": (MANY, 1, 3)}
    together = np.column_stack([both["z"], both["a"].reshape(MANY, 3)])
    assert_moments(together, [1.0, 0.0, 1.0, 2.0], SEMIDEFINITE)


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_directions_and_rotations_are_uniform(dtype):
    """Each component of a point of S^2 is uniform; the square of one of S^3 has the law Beta(1/2, 3/2)."""
    axis = draws(EVERY["axis"], dtype)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 2.0, rtol=4 * epsilon(dtype))
    oblique = axis @ np.array([0.48, 0.6, 0.64])
    for component in (*axis.T, oblique):
        assert stats.kstest(component, "uniform", (-2.0, 4.0)).statistic < SMIRNOV
    anyhow = draws(EVERY["anyhow"], dtype)
    np.testing.assert_allclose(np.linalg.norm(anyhow, axis=1), 1.0, rtol=4 * epsilon(dtype))
    for component in anyhow.T:
        assert stats.kstest(component**2, "beta", (0.5, 1.5)).statistic < SMIRNOV
        assert abs(np.mean(component)) < SIGMAS * 0.5 / np.sqrt(MANY)
    # A vector of the body then points anywhere, and the angle of the rotation has the law (a - sin a) / pi.
    turned = np.asarray(ml.so3.rotate(jnp.asarray(anyhow), jnp.tile(jnp.asarray([0.6, 0.0, 0.8], dtype), (MANY, 1))))
    for component in turned.T:
        assert stats.kstest(component, "uniform", (-1.0, 2.0)).statistic < SMIRNOV
    angle = 2 * np.arccos(np.minimum(np.abs(anyhow[:, 0]), 1))
    assert stats.kstest(angle, lambda a: (a - np.sin(a)) / np.pi).statistic < SMIRNOV


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_rotations_near_a_mean_have_its_errors(dtype):
    for deviation, covariance in (([0.1, 0.2, 0.3], None), (None, 0.01 * SEMIDEFINITE[:3, :3])):
        found = draws(d.RotationNear(MEAN_ATTITUDE, deviation, covariance=covariance), dtype)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=8 * epsilon(dtype))
        mean = jnp.tile(jnp.asarray(MEAN_ATTITUDE, dtype), (MANY, 1))
        error = np.asarray(ml.so3.log(ml.so3.multiply(ml.so3.conjugate(mean), jnp.asarray(found))))
        assert_moments(error, np.zeros(3), np.diag([0.01, 0.04, 0.09]) if covariance is None else covariance)


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_data_come_as_they_are(dtype):
    rows = draws(EVERY["row"], dtype)
    matches = np.all(rows[:, None] == TABLE.astype(dtype), axis=2)
    assert np.all(matches.sum(axis=1) == 1)
    shares = matches.mean(axis=0)
    assert np.all(np.abs(shares - 1 / 7) < SIGMAS * np.sqrt(6 / 49 / MANY))
    values = np.asarray(jax.tree.leaves(EVERY["own"])[0]).astype(dtype)
    own = ml.scatter(KEY, [5, 2, 2499], dtype=dtype, own=EVERY["own"])["own"]
    np.testing.assert_array_equal(own, values[[5, 2, 2499]])


def scatter(key=KEY, bodies=3, dtype=None, x=EVERY["number"]):
    return ml.scatter(key, bodies, dtype=dtype, x=x)


def normal(covariance):
    return d.Normal(np.zeros(len(covariance)), covariance=covariance)


UNIT, BALL = [1.0, 0.0, 0.0, 0.0], [5.0, 5.0, 5.0]
STRONG = [[1.0, 3.2e-5, 0.0], [3.2e-5, 1e-10, 0.0], [0.0, 0.0, 1e12]]
INDEFINITE = np.array([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]) * 1e-6
test_bad_input_is_named = refused(
    (lambda: d.Normal(0.0), "deviation or covariance must be given, got neither; pass one"),
    (lambda: d.Normal([0.0], 1.0, covariance=[[1.0]]), "deviation or covariance .* got both"),
    (lambda: d.Normal(0.0, -1.0), "deviation must not be negative, got .*-1"),
    (lambda: d.Normal("a", 1.0), "mean must be an array of real numbers, got str"),
    (lambda: d.Normal([0.0, 0.0], [1.0] * 3), r"mean \(2,\) and deviation \(3,\) do not fit"),
    (lambda: d.Normal([[0.0]], covariance=[[1.0]]), r"mean must be a vector \(d,\).*Joint"),
    (lambda: d.Normal([0.0, 0.0], covariance=[1.0, 2.0]), r"covariance must have shape \(2, 2\)"),
    (lambda: normal([[1.0, 0.5], [0.0, 1.0]]), r"pass \(C \+ C.T\) / 2"),
    (lambda: normal([[1.0, 2.0], [2.0, 1.0]]), r"(?s)positive semi-definite, .*correlations \[\[1. 2.\]"),
    (lambda: normal(STRONG), r"(?s)positive semi-definite, .* 3.2"),
    (lambda: normal([[-1e-10, 0.0], [0.0, 1e6]]), r"(?s)positive semi-definite, .*variances \[-1.e-10"),
    (lambda: normal([[0.0, 1e-9], [1e-9, 1e6]]), r"(?s)positive semi-definite, .*variances \[ *0"),
    (lambda: normal(INDEFINITE), "(?s)semi-definite.*correlations .* eigenvalue -0.8;"),
    (lambda: d.LogNormal([1.0, 0.0], 0.1), "median must be positive.*use Normal"),
    (lambda: d.Uniform(1.0, 0.0), "low must not exceed high, got low 1.0 and high 0.0; exchange"),
    (lambda: d.Sphere(0.0), "radius must be positive"),
    (lambda: d.RotationNear([1.0, 1.0, 0.0, 0.0], 0.1), "attitude must be a unit quaternion.*divide"),
    (lambda: d.RotationNear(UNIT, np.ones((2, 3))), r"deviation must be one number or \(3,\)"),
    (lambda: d.Rows(1.0), "values must have at least one row"),
    (lambda: d.Joint([0.0], [[1.0]]), "mean must be a dictionary"),
    (lambda: jax.jit(lambda x: d.Normal(x, 1.0))(0.0), "mean is traced; make distributions outside jit"),
    (lambda: scatter(jax.random.PRNGKey(0)), r"key must be one typed key.*jax.random.key\(0\)"),
    (lambda: scatter(jax.random.split(KEY)), "key must be one typed key"),
    (lambda: scatter(jax.random.key(0, impl="rbg")), "must be of the generator threefry"),
    (lambda: jax.jit(scatter)(KEY), "key is traced; call scatter outside jit"),
    (lambda: jax.jit(lambda n: scatter(bodies=n))(3), "bodies is traced"),
    (lambda: scatter(bodies=0), "bodies must be a positive number of bodies.*got 0"),
    (lambda: scatter(bodies=[-1, 2]), "got indices from -1 to 2; they count from 0"),
    (lambda: ml.scatter(KEY, 3), "scatter needs a quantity"),
    (lambda: scatter(x=2.0), "x must be a distribution .* got float; use Each"),
    (lambda: scatter(dtype="int32"), "dtype must be float32 or float64"),
    (lambda: scatter(dtype="float32", x=d.Normal(1e300, 1.0)), "parameter of x in float32 must"),
    (lambda: scatter(bodies=8, x=d.Each(TABLE)), "x must have one row per body, got 7 rows and body 7"),
    (lambda: ml.RigidBody([[BALL] * 3, [BALL] * 2 + [[1.0, 2.0, 4.0]]]), r"in 1 of 6 rows: \(1, 2\);.*\[1. 2. 4.\];"),
)
