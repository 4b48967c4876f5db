"""A function replayed on scalars gives what the function itself gives: many ways to write one on arrays."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from midlie_jax._xla.replay import Packed, by_components
from midlie_jax.model import so3

THREE = np.array([0.3, -1.2, 0.7])
TABLE = np.sin(np.arange(1000.0))
MATRIX = np.array([[2.0, 0.3, -0.1], [0.2, 1.5, 0.4], [-0.3, 0.1, 3.0]])


@jax.jit
def inner(t, p):
    return jnp.cross(p, jnp.stack([t, t * t, jnp.sin(t)]))


def tabulated(t, p, q):
    place = jnp.clip((100 * jnp.abs(t)).astype(jnp.int32), 0, 998)
    part = 100 * jnp.abs(t) - place.astype(t.dtype)
    return p * ((1 - part) * jnp.asarray(TABLE)[place] + part * jnp.asarray(TABLE)[place + 1])


def potential(t, p, q):
    return jnp.sum((so3.to_matrix(q / jnp.linalg.norm(q)) @ p) ** 2 * THREE) + jnp.cos(t * q[1])


FUNCTIONS = {
    "matmul": lambda t, p, q: so3.to_matrix(q) @ p,
    "matrix_product": lambda t, p, q: (so3.to_matrix(q) @ MATRIX @ so3.to_matrix(q).T) @ p,
    "einsum": lambda t, p, q: jnp.einsum("ij,jk,k->i", so3.to_matrix(q), MATRIX, p),
    "einsum_trace": lambda t, p, q: p * jnp.einsum("ii,jj", so3.to_matrix(q), MATRIX),
    "cross": lambda t, p, q: jnp.cross(jnp.cross(p, THREE), jnp.array([0.0, 0.0, 1.0])),
    "norm": lambda t, p, q: p / jnp.linalg.norm(p) + jnp.linalg.norm(q, ord=1),
    "indexing": lambda t, p, q: jnp.array([p[2], q[-1] * p[0], q[1:][::-1][0]]),
    "fancy_indexing": lambda t, p, q: p[jnp.array([2, 0, 1])] + q[np.array([3, 3, 0])] + p[..., None][:, 0],
    "mask_indexing": lambda t, p, q: jnp.concatenate([q[np.array([True, False, True, False])], p[:1]]),
    "traced_index": lambda t, p, q: p * q[jnp.argmax(jnp.abs(q))] + q[(t > 0).astype(jnp.int32)],
    "dynamic_slice": lambda t, p, q: jax.lax.dynamic_slice(q, (1,), (3,)) + jax.lax.dynamic_slice(q, (3,), (3,)),
    "at_set": lambda t, p, q: p.at[1].set(t).at[0].add(q[0]).at[jnp.array([2])].multiply(3.0),
    "at_repeated": lambda t, p, q: p.at[jnp.array([0, 0, 2])].add(q[:3]),
    "at_min_max": lambda t, p, q: p.at[0].min(q[0]).at[1].max(q[1]),
    "clip": lambda t, p, q: jnp.clip(p, -0.5, 0.5) + jnp.sign(q[1:]) + jnp.maximum(p, q[:3]),
    "extremes": lambda t, p, q: p * jnp.max(q) + jnp.min(p) + jnp.argmin(p).astype(p.dtype),
    "where": lambda t, p, q: jnp.where(p > 0, p, -2 * p) + jnp.where(t > 0, q[1:], p),
    "eye": lambda t, p, q: jnp.eye(3) @ p + jnp.diag(jnp.array([1.0, 2.0, 3.0])) @ p + jnp.trace(MATRIX),
    "sum": lambda t, p, q: p + jnp.sum(q) + jnp.mean(p) + jnp.var(q) + jnp.prod(q),
    "cumulative": lambda t, p, q: jnp.cumsum(p) + jnp.cumprod(q)[:3],
    "sort": lambda t, p, q: jnp.sort(p) + p[jnp.argsort(q[:3])],
    "reshape": lambda t, p, q: (q.reshape(2, 2) @ q.reshape(2, 2).T).ravel()[:3] + jnp.squeeze(p[None, :], 0),
    "powers": lambda t, p, q: jnp.abs(p) ** 1.5 + p**3 + 2.0**p + jnp.sqrt(jnp.abs(q[:3])) + 1 / (2 + p),
    "functions": lambda t, p, q: jnp.exp(-p) + jnp.tanh(p) + jnp.arctan2(p, q[1:]) + jnp.log1p(p**2) + jnp.cbrt(p),
    "integers": lambda t, p, q: p * (jnp.array([1, 2, 3]) % 2).astype(p.dtype) + jnp.floor(3 * p) + (p // 0.25),
    "jit_inside": lambda t, p, q: inner(t, p) + inner(2 * t, inner(t, q[1:])),
    "vmap_inside": lambda t, p, q: jax.vmap(lambda row: row @ p)(so3.to_matrix(q)),
    "custom_jvp": lambda t, p, q: jax.nn.relu(p) + jax.nn.softplus(p) + jax.nn.softmax(q)[:3],
    "cond": lambda t, p, q: jax.lax.cond(t > 0, lambda x: jnp.cross(x, THREE), lambda x: -x, p),
    "fori_loop": lambda t, p, q: jax.lax.fori_loop(0, 3, lambda i, x: jnp.cross(x, THREE) + x / (i + 1.0), p),
    "while_loop": lambda t, p, q: jax.lax.while_loop(lambda x: jnp.sum(x**2) < 50, lambda x: 2 * x, p),
    "scan": lambda t, p, q: jax.lax.scan(lambda x, y: (x + y * x, y), p, q)[0],
    "solve": lambda t, p, q: jnp.linalg.solve(MATRIX + jnp.outer(p, p), q[:3]),
    "inverse": lambda t, p, q: jnp.linalg.inv(MATRIX + jnp.outer(p, p)) @ p + jnp.linalg.det(MATRIX * t),
    "large_table": tabulated,
    "large_sum": lambda t, p, q: p * jnp.sum(jnp.cos(t * jnp.asarray(TABLE))),
    "interp": lambda t, p, q: p * jnp.interp(t, jnp.linspace(-9.0, 9.0, 1000), jnp.asarray(TABLE)),
    "polyval": lambda t, p, q: jnp.polyval(jnp.array([1.0, -2.0, 0.5]), p),
    "gradient": lambda t, p, q: jax.grad(potential, 1)(t, p, q),
    "gradient_of_pose": lambda t, p, q: jax.grad(potential, 2)(t, p, q)[1:],
    "gradient_in_time": lambda t, p, q: p * jax.grad(potential)(t, p, q),
    "hessian": lambda t, p, q: jax.hessian(potential, 1)(t, p, q) @ p,
    "jacobian": lambda t, p, q: jax.jacrev(lambda x: jnp.cross(x, jnp.sin(x)))(p) @ THREE,
    "gradient_of_loop": lambda t, p, q: jax.grad(
        lambda x: jnp.sum(jax.lax.fori_loop(0, 3, lambda i, y: jnp.sin(y) * x, x))
    )(p),
    "exp_log": lambda t, p, q: so3.log(so3.multiply(so3.exp(p), so3.exp(t * THREE))),
}

CASES = [(t, *np.split(np.random.default_rng(n).normal(size=7), [3])) for n, t in enumerate((0.7, -1.3, 2.9))]
# Sums may be taken in another order; the longest has 1000 terms of size 1.
SLACK = 1e-13


def replayed(function, t, p, q):
    entries, out = by_components(function, t, Packed(tuple(p)), Packed(tuple(q)))
    assert len(entries) == np.prod(out.shape, dtype=int)
    assert all(jnp.shape(entry) == () for entry in entries)
    return jnp.stack([jnp.asarray(entry) for entry in entries]).reshape(out.shape)


@pytest.mark.sample(14)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_gives_what_the_function_gives(name):
    """Compiled, mapped over a batch; the plain function runs operation by operation."""
    function = FUNCTIONS[name]
    columns = [jnp.stack([jnp.asarray(x) for x in column]) for column in zip(*CASES, strict=True)]
    found = jax.jit(jax.vmap(lambda t, p, q: replayed(function, t, p, q)))(*columns)
    for row, case in zip(found, CASES, strict=True):
        truth = function(*map(jnp.asarray, case))
        assert row.shape == truth.shape == (3,)
        assert row.dtype == truth.dtype
        np.testing.assert_allclose(row, truth, rtol=SLACK, atol=SLACK * np.abs(truth).max())


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", ["matmul", "at_set", "cond", "solve", "large_table", "gradient", "jit_inside"])
def test_has_the_derivative_of_the_function(name):
    function = FUNCTIONS[name]
    case = tuple(map(jnp.asarray, CASES[0]))
    found = jax.jit(jax.jacrev(lambda *args: replayed(function, *args), (0, 1, 2)))(*case)
    for x, y in zip(found, jax.jacrev(function, (0, 1, 2))(*case), strict=True):
        np.testing.assert_allclose(x, y, rtol=SLACK, atol=SLACK * max(1.0, np.abs(y).max()))


def test_entries_are_moved_not_computed():
    """Stacking, slicing and products by zero and one of a pose leave no array in the step."""

    def step(t, p, q):
        entries, _ = by_components(FUNCTIONS["matrix_product"], t, Packed(p), Packed(q))
        return tuple(entries)

    scalars = [jnp.asarray(0.5)] * 7
    jaxpr = jax.make_jaxpr(step)(jnp.asarray(1.0), tuple(scalars[:3]), tuple(scalars[3:]))
    types: list[Any] = [v.aval for equation in jaxpr.eqns for v in equation.outvars]
    assert {type_.shape for type_ in types} == {()}


def test_reports_shape_and_dtype_without_judging():
    entries, out = by_components(lambda t, p: jnp.outer(p, p).astype(jnp.float32), 1.0, Packed(tuple(jnp.ones(3))))
    assert (len(entries), out.shape, out.dtype) == (9, (3, 3), jnp.float32)
    entries, out = by_components(lambda t: t * 2, jnp.asarray(1.0))
    assert (len(entries), out.shape) == (1, ())
