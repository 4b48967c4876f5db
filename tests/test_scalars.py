"""A function replayed on scalars gives what the function itself gives: many ways to write one on arrays."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick
from jax import ad_checkpoint, lax

from midlie_jax._xla.replay import Packed, by_components
from midlie_jax._xla.rules import RULES, rule_for
from midlie_jax.model import so3

TIME = np.float64(0.7)
MOMENTUM = np.array([0.3, -1.2, 0.7])
POSE = np.array([0.1, -0.9, 0.4, 1.3])
WHOLE = np.array([100, -77, 53])  # of which small integers overflow
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


def table(p, q):
    return jnp.outer(p, q)


def whole(p, dtype=jnp.int32):
    """Integers that are not known while tracing."""
    return (p > 9).astype(dtype) + WHOLE.astype(dtype)


def small(p):
    return p.astype(jnp.float32)


@jax.custom_vjp
def with_derivative(x):
    return jnp.sin(x)


with_derivative.defvjp(lambda x: (jnp.sin(x), x), lambda x, slope: (2 * slope * x,))


def with_reference(t, p, q):
    kept = jax.new_ref(p)
    kept[0] = t
    kept[1] += q[1]
    return kept[...]


OF_ONE = (
    *(lax.acos, lax.asin, lax.asinh, lax.atan, lax.atanh, lax.cbrt, lax.ceil, lax.cosh, lax.erf, lax.erf_inv, lax.erfc),
    *(lax.exp2, lax.expm1, lax.floor, lax.is_finite, lax.lgamma, lax.log1p, lax.logistic, lax.rsqrt, lax.sinh),
    *(lax.square, lax.tan, lax.tanh),
)
OF_TWO = (lax.atan2, lax.eq, lax.ge, lax.gt, lax.le, lax.lt, lax.max, lax.min, lax.ne, lax.nextafter, lax.rem)
ROWS = lax.ScatterDimensionNumbers((1,), (0,), (0,))

FUNCTIONS = {
    "matmul": lambda t, p, q: so3.to_matrix(q) @ p,
    "matrix_product": lambda t, p, q: (so3.to_matrix(q) @ MATRIX @ so3.to_matrix(q).T) @ p,
    "einsum": lambda t, p, q: jnp.einsum("ij,jk,k->i", so3.to_matrix(q), MATRIX, p),
    "einsum_trace": lambda t, p, q: p * jnp.einsum("ii,jj", so3.to_matrix(q), MATRIX),
    "norm": lambda t, p, q: p / jnp.linalg.norm(p) + jnp.linalg.norm(q, ord=1),
    "indexing": lambda t, p, q: jnp.array([p[2], q[-1] * p[0], q[1:][::-1][0]]),
    "fancy_indexing": lambda t, p, q: p[jnp.array([2, 0, 1])] + q[np.array([3, 3, 0])] + p[..., None][:, 0],
    "mask_indexing": lambda t, p, q: jnp.concatenate([q[np.array([True, False, True, False])], p[:1]]),
    "traced_index": lambda t, p, q: p * q[jnp.argmax(jnp.abs(q))] + q[(t > 0).astype(jnp.int32)],
    "dynamic_slice": lambda t, p, q: jax.lax.dynamic_slice(q, (1,), (3,)) + jax.lax.dynamic_slice(q, (3,), (3,)),
    "at_set": lambda t, p, q: p.at[1].set(t).at[0].add(q[0]).at[jnp.array([2])].multiply(3.0),
    "at_repeated": lambda t, p, q: p.at[jnp.array([0, 0, 2])].add(q[:3]),
    "clip": lambda t, p, q: jnp.clip(p, -0.5, 0.5) + jnp.sign(q[1:]) + jnp.maximum(p, q[:3]),
    "extremes": lambda t, p, q: p * jnp.max(q) + jnp.min(p) + jnp.argmin(p).astype(p.dtype),
    "where": lambda t, p, q: jnp.where(p > 0, p, -2 * p) + jnp.where(t > 0, q[1:], p),
    "sum": lambda t, p, q: p + jnp.sum(q) + jnp.mean(p) + jnp.var(q) + jnp.prod(q),
    "cumulative": lambda t, p, q: jnp.cumsum(p) + jnp.cumprod(q)[:3],
    "sort": lambda t, p, q: jnp.sort(p) + p[jnp.argsort(q[:3])],
    "powers": lambda t, p, q: jnp.abs(p) ** 1.5 + p**3 + 2.0**p + jnp.sqrt(jnp.abs(q[:3])) + 1 / (2 + p),
    "functions": lambda t, p, q: jnp.exp(-p) + jnp.tanh(p) + jnp.arctan2(p, q[1:]) + jnp.log1p(p**2) + jnp.cbrt(p),
    "integers": lambda t, p, q: p * (jnp.array([1, 2, 3]) % 2).astype(p.dtype) + jnp.floor(3 * p) + (p // 0.25),
    "jit_inside": lambda t, p, q: inner(t, p) + inner(2 * t, inner(t, q[1:])),
    "vmap_inside": lambda t, p, q: jax.vmap(lambda row: row @ p)(so3.to_matrix(q)),
    "cond": lambda t, p, q: jax.lax.cond(t > 0, lambda x: jnp.cross(x, THREE), lambda x: -x, p),
    "fori_loop": lambda t, p, q: jax.lax.fori_loop(0, 3, lambda i, x: jnp.cross(x, THREE) + x / (i + 1.0), p),
    "while_loop": lambda t, p, q: jax.lax.while_loop(lambda x: jnp.sum(x**2) < 50, lambda x: 2 * x, p),
    "scan": lambda t, p, q: jax.lax.scan(lambda x, y: (x + y * x, y), p, q)[0],
    "solve": lambda t, p, q: jnp.linalg.solve(MATRIX + jnp.outer(p, p), q[:3]),
    "inverse": lambda t, p, q: jnp.linalg.inv(MATRIX + jnp.outer(p, p)) @ p + jnp.linalg.det(MATRIX * t),
    "large_table": tabulated,
    "large_sum": lambda t, p, q: p * jnp.sum(jnp.cos(t * jnp.asarray(TABLE))),
    "interp": lambda t, p, q: p * jnp.interp(t, jnp.linspace(-9.0, 9.0, 1000), jnp.asarray(TABLE)),
    "gradient": lambda t, p, q: jax.grad(potential, 1)(t, p, q),
    "gradient_of_pose": lambda t, p, q: jax.grad(potential, 2)(t, p, q)[1:],
    "gradient_in_time": lambda t, p, q: p * jax.grad(potential)(t, p, q),
    "hessian": lambda t, p, q: jax.hessian(potential, 1)(t, p, q) @ p,
    "gradient_of_loop": lambda t, p, q: jax.grad(
        lambda x: jnp.sum(jax.lax.fori_loop(0, 3, lambda i, y: jnp.sin(y) * x, x))
    )(p),
    "exp_log": lambda t, p, q: so3.log(so3.multiply(so3.exp(p), so3.exp(t * THREE))),
    "checkpoint_name": lambda t, p, q: ad_checkpoint.checkpoint_name(p, "p") * t,
    # Moving entries.
    "reshape_by_columns": lambda t, p, q: jnp.reshape(table(p, q), (2, 6), order="F"),
    "reshape_permuted": lambda t, p, q: lax.reshape(table(p, q).reshape(3, 2, 2), (4, 3), (2, 0, 1)),
    "broadcast_between": lambda t, p, q: lax.broadcast_in_dim(table(p, q), (3, 2, 4), (0, 2)),
    "concatenate_columns": lambda t, p, q: lax.concatenate([table(p, q), table(p, q[:2])], 1),
    "pad_negative": lambda t, p, q: lax.pad(q, t, ((-1, -2, 0),)),
    "pad_interior": lambda t, p, q: lax.pad(table(p, q), t, ((1, 0, 2), (0, 2, 1))),
    "rev_all": lambda t, p, q: lax.rev(table(p, q), (0, 1)),
    "slice_strided": lambda t, p, q: lax.slice(table(p, q), (0, 1), (3, 4), (2, 2)),
    "split_columns": lambda t, p, q: lax.split(table(p, q), (1, 0, 3), 1)[2],
    "stack_columns": lambda t, p, q: jnp.stack([p, q[:3]], axis=1),
    "unstack_columns": lambda t, p, q: jnp.unstack(table(p, q), axis=1)[2],
    "squeeze_some": lambda t, p, q: lax.squeeze(p[None, :, None, None], (0, 2)),
    "transpose_cyclic": lambda t, p, q: table(p, q).reshape(3, 2, 2).transpose(2, 0, 1),
    "iota_columns": lambda t, p, q: lax.broadcasted_iota(jnp.uint8, (2, 3), 1),
    "nothing": lambda t, p, q: jnp.zeros((0, 3)) @ p,
    # By indices.
    "dynamic_slice_beyond": lambda t, p, q: lax.dynamic_slice(table(p, q), (jnp.int8(100), jnp.int8(-3)), (2, 3)),
    "dynamic_slice_traced": lambda t, p, q: lax.dynamic_slice(q, (whole(p)[0],), (2,)),
    "dynamic_update_beyond": lambda t, p, q: lax.dynamic_update_slice(table(p, q), p[None, :2], (7, -9)),
    "dynamic_update_traced": lambda t, p, q: lax.dynamic_update_slice(q, p[:2], (whole(p)[1],)),
    "gather_fill": lambda t, p, q: q.at[jnp.array([2, -1, 4, -5])].get(mode="fill", fill_value=7),
    "gather_fill_integers": lambda t, p, q: whole(p).at[jnp.array([2, 9])].get(mode="fill"),
    "gather_clip": lambda t, p, q: q.at[jnp.array([2, 99, -99])].get(mode="clip"),
    "gather_not_wrapped": lambda t, p, q: q.at[jnp.array([-1])].get(wrap_negative_indices=False, mode="clip"),
    "gather_rows": lambda t, p, q: jnp.take_along_axis(table(p, q), jnp.array([[3], [0], [1]]), 1),
    "gather_mapped": lambda t, p, q: jax.vmap(lambda row, i: row[i])(table(p, q), jnp.array([3, 0, 1])),
    "gather_windows": lambda t, p, q: table(p, q)[jnp.array([2, 0]), 1:3],
    "gather_nothing": lambda t, p, q: q[jnp.zeros(0, jnp.int32)],
    "gather_traced": lambda t, p, q: q[whole(p) % 4],
    "scatter_drop": lambda t, p, q: q.at[jnp.array([1, 9])].set(p[:2], mode="drop"),
    "scatter_rows": lambda t, p, q: table(p, q).at[jnp.array([2, 0])].set(jnp.stack([q, 2 * q])),
    "scatter_mapped": lambda t, p, q: jax.vmap(lambda row, i, x: row.at[i].set(x))(
        table(p, q), jnp.array([3, 0, 1]), p
    ),
    "scatter_windows": lambda t, p, q: lax.scatter(table(p, q), jnp.array([[2], [0]]), table(q[:2], q), ROWS),
    "scatter_traced": lambda t, p, q: q.at[whole(p) % 4].set(p),
    "scatter_apply_at_index": lambda t, p, q: q.at[jnp.array([3, 0])].apply(jnp.sin),
    "scatter_multiply": lambda t, p, q: q.at[jnp.array([3, 3])].multiply(p[:2]),
    # Entry by entry.
    **{f.__name__: lambda t, p, q, f=f: f(jnp.sin(p)) for f in OF_ONE},
    **{f.__name__: lambda t, p, q, f=f: f(p, q[1:]) for f in OF_TWO},
    "acosh": lambda t, p, q: lax.acosh(1 + p * p),
    "log": lambda t, p, q: lax.log(p * p),
    "stop_gradient": lambda t, p, q: lax.stop_gradient(p) + jnp.copy(q[1:]),
    "integers_wrap": lambda t, p, q: whole(p, jnp.int8) + whole(p, jnp.int8) * jnp.int8(3),
    "integers_divide": lambda t, p, q: lax.div(whole(p), jnp.int32(-7)) + lax.rem(whole(p), jnp.int32(-7)),
    "integers_divide_by_zero": lambda t, p, q: lax.div(whole(p), 0 * whole(p)) + lax.rem(whole(p), 0 * whole(p)),
    "integers_floor_divide": lambda t, p, q: whole(p) // 7 + whole(p) % -7,
    "bits": lambda t, p, q: (whole(p) & 12) | (whole(p) ^ 5) | ~whole(p) | (whole(p) << 2) | (whole(p) >> 1),
    "bits_counted": lambda t, p, q: lax.population_count(whole(p)) + lax.clz(whole(p)),
    "bits_of_floats": lambda t, p, q: lax.bitcast_convert_type(p, jnp.int64),
    "truth": lambda t, p, q: (p > 0) & ~(q[:3] > 0) | (p == q[1:]) ^ (t > 0),
    "convert_to_integers": lambda t, p, q: (3 * p).astype(jnp.int8) + jnp.int8(1),
    "convert_weakly": lambda t, p, q: small(p) * jnp.where(t > 0, 2.0, 3.0),
    "reduce_precision": lambda t, p, q: lax.reduce_precision(p, 5, 3),
    "round_away": lambda t, p, q: lax.round(3 * p + 0.5, lax.RoundingMethod.AWAY_FROM_ZERO),
    "integer_powers": lambda t, p, q: lax.integer_pow(p, -3) + lax.pow(p, whole(p) % 3) + lax.integer_pow(p, 0),
    "accuracy": lambda t, p, q: lax.exp(p, accuracy=lax.AccuracyMode.DEFAULT) + lax.sin(p, accuracy=None),
    "select_of_three": lambda t, p, q: lax.select_n(whole(p) % 3, p, q[:3], q[1:]),
    "clamp_by_arrays": lambda t, p, q: lax.clamp(-jnp.abs(q[:3]), p, jnp.abs(q[1:])),
    "not_a_number": lambda t, p, q: jnp.stack([jnp.max(jnp.sqrt(p)), jnp.min(jnp.sqrt(p)), jnp.nanmax(jnp.sqrt(p))]),
    "infinities": lambda t, p, q: jnp.stack([jnp.max(1 / (p - p)), jnp.sum(p / jnp.abs(p - p)), jnp.min(1 / (p * 0))]),
    "complex": lambda t, p, q: jnp.abs(lax.complex(p, q[:3]) * (1 + 2j)) + lax.conj(lax.complex(p, p)).imag,
    # Sums and their like.
    "dot_of_bytes": lambda t, p, q: lax.dot(whole(p, jnp.int8), whole(p, jnp.int8)),
    "matmul_widened": lambda t, p, q: jnp.matmul(
        small(table(p, q)), small(table(q, p)), preferred_element_type=jnp.float64
    ),
    "dot_batched": lambda t, p, q: lax.dot_general(
        table(p, q).reshape(3, 2, 2), table(q, p).reshape(2, 3, 2), (((2,), (0,)), ((0,), (1,)))
    ),
    "dot_complex": lambda t, p, q: jnp.vdot(lax.complex(p, q[:3]), lax.complex(q[1:], p)),
    "dot_outer": lambda t, p, q: lax.dot_general(p, q, (((), ()), ((), ()))),
    "sum_of_bytes": lambda t, p, q: lax.reduce_sum_p.bind(whole(p, jnp.int8), axes=(0,), out_sharding=None),
    "sum_of_halves": lambda t, p, q: jnp.sum(jnp.full(64, 0.1, jnp.float16) + 0 * p[0].astype(jnp.float16)),
    "sum_over_none": lambda t, p, q: lax.reduce_sum_p.bind(p, axes=(), out_sharding=None),
    "sum_of_nothing": lambda t, p, q: jnp.sum(p[:0]) + jnp.prod(q[:0]),
    "sum_middle": lambda t, p, q: jnp.sum(table(p, q).reshape(3, 2, 2), axis=(0, 2)),
    "all_any_xor": lambda t, p, q: jnp.stack([jnp.all(p > 0), jnp.any(p > 0), lax.reduce_xor(p > 0, (0,))]),
    "argmax_typed": lambda t, p, q: lax.argmax(table(p, q), 1, jnp.int8),
    "cumulative_reversed": lambda t, p, q: lax.cumsum(q, reverse=True) + lax.cummax(table(p, q), 1)[0],
    "reduce_by_function": lambda t, p, q: lax.reduce(q, t, lambda x, y: x * y + y, (0,)),
    # Calls, loops and whatever else is replayed as it is.
    "jit_closing_over": lambda t, p, q: jax.jit(lambda: t * p @ jnp.asarray(MOMENTUM))(),
    "jit_in_jit": lambda t, p, q: jax.jit(lambda x: jax.jit(jnp.sin)(x).ravel(order="F"))(table(p, q)),
    "jit_sharded": lambda t, p, q: jax.jit(lambda x: 2 * x, in_shardings=one_device(), out_shardings=one_device())(p),
    "sharding_constraint": lambda t, p, q: lax.with_sharding_constraint(2 * p, one_device()),
    "custom_vjp": lambda t, p, q: jax.grad(lambda x: jnp.sum(with_derivative(x)))(p) + with_derivative(p),
    "checkpoint": lambda t, p, q: jax.grad(lambda x: jnp.sum(jax.checkpoint(jnp.sin)(x) ** 2))(p),
    "cond_closing_over": lambda t, p, q: lax.cond(t > 9, lambda: p, lambda: q[1:] * jnp.asarray(MOMENTUM)),
    "while_with_integers": lambda t, p, q: lax.while_loop(lambda c: c[0] < 3, lambda c: (c[0] + 1, c[1] * t), (0, p))[
        1
    ],
    "scan_backwards": lambda t, p, q: lax.scan(
        lambda x, y: (x * y[0], x + y[1]), p, (q, jnp.arange(4.0)), reverse=True
    )[1],
    "barrier": lambda t, p, q: lax.optimization_barrier((p, t))[0],
    "reference": with_reference,
    "random_key": lambda t, p, q: p + jax.random.normal(jax.random.key(3), (3,)),
    "gradient_by_integer": lambda t, p, q: jax.grad(
        lambda n, x: jnp.sum(x * n.astype(x.dtype)), (0, 1), allow_int=True
    )(whole(p), p)[1],
}


def one_device():
    return jax.sharding.SingleDeviceSharding(jax.devices()[0])


def replayed(function, t, p, q):
    entries, out = by_components(function, t, Packed(tuple(p)), Packed(tuple(q)))
    assert len(entries) == np.prod(out.shape, dtype=int)
    assert all(jnp.shape(entry) == () for entry in entries)
    return jnp.stack(entries).reshape(out.shape) if entries else jnp.zeros(out.shape, out.dtype)


NAMES = [*FUNCTIONS]
GROUPS = [NAMES[n : n + 14] for n in range(0, len(NAMES), 14)]  # each is two programs


@pytest.mark.sample(1)
@pytest.mark.parametrize("names", GROUPS, ids=lambda names: names[0])
def test_gives_what_the_function_gives(names):
    made = [FUNCTIONS[name] for name in names]
    found = quick(lambda *given: [replayed(function, *given) for function in made])(TIME, MOMENTUM, POSE)
    truths = quick(lambda *given: [function(*given) for function in made])(TIME, MOMENTUM, POSE)
    for name, x, truth in zip(names, found, truths, strict=True):
        assert (name, x.shape, x.dtype) == (name, truth.shape, truth.dtype)
        if jnp.issubdtype(truth.dtype, jnp.inexact):
            slack = 64 * float(jnp.finfo(truth.dtype).eps)
            size = np.max(np.abs(truth), initial=0, where=np.isfinite(truth))
            np.testing.assert_allclose(x, truth, rtol=slack, atol=slack * size, err_msg=name)
        else:
            np.testing.assert_array_equal(x, truth, err_msg=name)


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", ["matmul", "at_set", "cond", "solve", "large_table"])
def test_has_the_derivative_of_the_function(name):
    function = FUNCTIONS[name]
    case = tuple(map(jnp.asarray, (TIME, MOMENTUM, POSE)))
    found = jax.jit(jax.jacrev(lambda *args: replayed(function, *args), (0, 1, 2)))(*case)
    for x, y in zip(found, jax.jacrev(function, (0, 1, 2))(*case), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-13, atol=1e-13 * max(1.0, np.abs(y).max()))


def test_reports_shape_and_dtype_without_judging():
    entries, out = by_components(lambda t, p: jnp.outer(p, p).astype(jnp.float32), 1.0, Packed(tuple(jnp.ones(3))))
    assert (len(entries), out.shape, out.dtype) == (9, (3, 3), jnp.float32)


@cache
def equations():
    """One equation of each primitive that has a rule, out of all the functions."""

    def of(jaxpr):
        for equation in jaxpr.eqns:
            yield equation
            if equation.primitive.name == "jit":
                yield from of(equation.params["jaxpr"].jaxpr)

    traced = (jax.make_jaxpr(f)(TIME, MOMENTUM, POSE).jaxpr for f in FUNCTIONS.values())
    found = (equation for jaxpr in traced for equation in of(jaxpr) if rule_for(equation))
    return {equation.primitive.name: equation for equation in found}


def test_every_rule_is_put_to_the_test():
    """But those for what only a mesh of devices brings into a jaxpr, or only a JAX later than 0.10.0."""
    assert set(RULES) - set(equations()) <= {"pvary", "stack", "unstack"}


@pytest.mark.parametrize("value", [None, False, (), "novel"])
def test_a_parameter_that_no_rule_knows_is_not_ignored(value):
    for equation in equations().values():
        assert rule_for(equation.replace(params={**equation.params, "novel": value})) is None


def test_effects_are_kept():
    """Whatever a function shows or calls besides, it does once, and in order."""
    seen = []

    def function(t, p, q):
        jax.debug.callback(lambda x: seen.append(float(x)), t, ordered=True)
        jax.debug.callback(lambda x: seen.append(float(x)), jax.jit(jnp.sum)(p), ordered=True)
        return p

    found = quick(lambda *given: replayed(function, *given))(TIME, MOMENTUM, POSE)
    jax.effects_barrier()
    np.testing.assert_array_equal(found, MOMENTUM)
    np.testing.assert_allclose(seen, [TIME, MOMENTUM.sum()])
