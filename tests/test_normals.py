"""The random numbers of `_math/normals.py`: their bits, and what a statistician would test."""

import re
from math import erfc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, loop_bodies, real
from scipy import stats

from midlie_jax._math import normals
from midlie_jax._xla.fusion import fuse

MANY = 10_000_000
SIGMAS = 5


@jax.jit
def drawn(key, step, stage, member):
    return jnp.stack(normals.normals(key, (step, stage, member), 6, jnp.float32))


drawn_of_each = jax.jit(jax.vmap(drawn))


def mixed(x, y, z, w):
    """`normals._mix` on Python's integers."""
    for _ in range(2):
        x = (x + y * w) % 2**32
        y = (y + z * x) % 2**32
        z = (z + x * y) % 2**32
        w = (w + y * z) % 2**32
        x, y, z, w = (a ^ a >> 16 for a in (x, y, z, w))
    return x, y, z, w


@pytest.mark.parametrize("size", [2, 4])
def test_the_words_are_those_of_the_same_formula_on_integers(size):
    key = tuple(int(k) for k in np.random.default_rng(3).integers(2**32, size=size))
    step, stage, member, count = 123_456_789, 3, 5, 10
    roots = [int(np.sqrt(p) % 1 * 2**32) for p in (2, 3, 5, 7, 11, 13, 17, 19)]
    own = mixed(*(k ^ k >> 16 for k in (*roots[size:4], *key)))
    place = mixed(*mixed(*(k ^ k >> 16 for k in (*roots[6:], step, stage))))
    expected = []
    for block in range(3):
        row = 3 * member + block
        rows = (row * (r | 1) % 2**32 for r in roots[:4])
        expected += mixed(*(k ^ (p + (r ^ r >> 16)) % 2**32 for k, p, r in zip(own, place, rows, strict=True)))
    words = jax.jit(normals.words, static_argnums=4)(tuple(map(jnp.uint32, key)), jnp.int32(step), stage, member, count)
    assert [int(w) for w in words] == expected[:count]


def test_every_word_gives_a_finite_number():
    extreme = [0, 1, 2, 2**31 - 1, 2**31, 2**31 + 1, 2**31 - 2**7, 2**32 - 2, 2**32 - 1, 0x5A82799A, 0x5A827999]
    a, b = (jnp.asarray(x.ravel(), jnp.uint32) for x in np.meshgrid(extreme, extreme))
    z = np.array(jax.jit(normals.of_words, static_argnums=1)((a, b, a, b), 3))
    assert np.isfinite(z).all()
    assert abs(z).max() < 6.56


def test_the_transform_is_that_of_box_and_muller_to_float32():
    rng = np.random.default_rng(1)
    a, b = rng.integers(2**32, size=(2, 100_000)).astype(np.uint32)
    a[:50_000] >>= rng.integers(32, size=50_000).astype(np.uint32)  # the tails
    signed = (a | np.uint32(1)).view(np.int32).astype(np.float32).astype(np.float64)
    radius = np.sqrt(-2 * np.log(abs(signed) / 2**31))
    angle = np.pi / 4 + b.view(np.int32).astype(np.float64) * (np.pi / 2**33)
    x, y, z = (np.asarray(n).astype(np.float64) for n in jax.jit(normals.of_words, static_argnums=1)((a, b, a, b), 3))
    np.testing.assert_allclose(x, radius * np.cos(angle) * np.sign(a.view(np.int32) + 0.5), rtol=1e-6, atol=3e-6)
    np.testing.assert_allclose(y, radius * np.sin(angle) * np.where(b & 1, -1, 1), rtol=1e-6, atol=3e-6)
    np.testing.assert_allclose(z, radius * np.sin(2 * angle - np.pi / 2), rtol=1e-6, atol=3e-6)


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_a_step_computes_each_word_once(dtype):
    """In the loop of a float32 step, or in one of their own before a float64 step; the key is mixed before the run."""
    batch, steps = 517, 7

    def run(key, momentum):
        def step(n, momentum):
            numbers = normals.normals((key[0], key[1]), (n, 0, 0), 3, dtype)
            return fuse(tuple(m + z * m * z for m, z in zip(momentum, numbers, strict=True)))

        return jax.lax.fori_loop(jnp.int32(0), jnp.int32(steps), step, tuple(momentum))

    keys = jax.random.key_data(jax.random.split(jax.random.key(5, impl="threefry2x32"), batch))
    text = real(jax.vmap(run)).lower(keys, jnp.ones((batch, 3), dtype)).compile().as_text()
    (body,) = (body for body in loop_bodies(text) if f"[{batch}]" in body)
    fused = re.findall(r" fusion\(.*calls=%?([\w.\-]+)", body)
    loops = [text.split(f"\n%{name} (")[1].split("\n}")[0] for name in fused]
    assert sum(" reduce(" in loop for loop in loops) == (1 if dtype == "float32" else 2)
    assert sum(len(re.findall(rf"u32\[{batch}\]\S* multiply\(", loop)) for loop in loops) == 8


@pytest.mark.sample(0)
def test_distribution():
    members = jnp.arange(MANY // 6, dtype=jnp.int32)
    z = np.asarray(drawn((jnp.uint32(0), jnp.uint32(7)), jnp.int32(11), jnp.int32(1), members)).astype(np.float64)
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-4
    for bound in (2, 3, 4, 5):
        for tail in (z > bound, z < -bound):
            expected = z.size * erfc(bound / 2**0.5) / 2
            assert abs(tail.sum() - expected) < SIGMAS * np.sqrt(expected)
    shares = stats.norm.cdf(z[:, :1_000_000])
    for i in range(6):  # pairs in 64 x 64 squares of equal probability
        for j in range(i):
            squares, *_ = np.histogram2d(shares[i], shares[j], 64, [(0, 1), (0, 1)])
            assert stats.chisquare(squares.ravel()).pvalue > 1e-5


@pytest.mark.sample(0)
@pytest.mark.parametrize("what", ["step", "stage", "member", "key"])
def test_neighbours_are_independent(what):
    """Correlations of numbers, squares and signs of all six components, for arguments that differ in one bit."""
    n, rng = 100_000, np.random.default_rng(2)
    given = dict(zip(("key", "word"), jnp.asarray(rng.integers(2**32, size=(2, n)), jnp.uint32), strict=True))
    given |= dict(zip(("step", "member"), jnp.asarray(rng.integers(2**31, size=(2, n)), jnp.int32), strict=True))
    given["stage"] = jnp.full(n, 3, jnp.int32)

    def numbers(given):
        z = drawn_of_each((given["key"], given["word"]), given["step"], given["stage"], given["member"])
        z = np.asarray(z).T.astype(np.float64)
        return np.concatenate([z, (z**2 - 1) / 2**0.5, np.sign(z)])

    first = numbers(given)
    assert abs(first[:6] @ first[:6].T / n - np.eye(6)).max() < SIGMAS * 2 / n**0.5
    for bit in (0, 15, 30):
        other = numbers({**given, what: given[what] ^ jnp.asarray(1 << bit, given[what].dtype)})
        assert abs(first @ other.T / n).max() < (SIGMAS + 1) / n**0.5
