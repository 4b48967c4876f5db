"""Where a number can hide in the code of a run: functions of a number (3,) that give a function of a vector (3,)."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np


def in_a_jit(x):
    return jax.jit(lambda y: jnp.sum(y * jnp.asarray(x)))


def in_two_jits(x):
    return lambda y: jax.jit(lambda z: in_a_jit(x)(z) + 1)(y)


def in_a_scan(x):
    return lambda y: jax.lax.scan(lambda c, _: (c + jnp.sum(y * jnp.asarray(x)), None), y[0], length=2)[0]


def in_a_condition(x):
    return lambda y: jax.lax.cond(y[0] > 1, lambda z: z[0], lambda z: jnp.sum(z * jnp.asarray(x)), y)


def in_a_loop(x):
    return lambda y: jax.lax.while_loop(lambda c: c < 5, lambda c: c + 1 + jnp.sum(jnp.asarray(x)) ** 2, y[0])


def in_a_custom_derivative(x):
    @jax.custom_jvp
    def function(y):
        return jnp.sum(y * jnp.asarray(x))

    function.defjvp(lambda primals, tangents: (function(*primals), tangents[0][0]))
    return lambda y: jax.jit(function)(y)


def in_a_root(x):
    return lambda y: jax.lax.custom_root(
        lambda z: z - jnp.sum(jnp.asarray(x)), y[0], lambda f, z: z + jnp.sum(jnp.asarray(x)), lambda g, z: z
    )


def in_a_partial(x):
    return functools.partial(lambda a, y: jnp.sum(y * jnp.asarray(a)), x)


def in_a_default(x):
    return lambda y, a=x: jnp.sum(y * jnp.asarray(a))


class Weighted(eqx.Module):
    weights: jax.Array

    def __call__(self, y):
        return jnp.sum(y * self.weights)


class Table:
    def __init__(self, numbers):
        self.numbers = numbers

    def at(self, y):
        return in_a_jit(self.numbers)(y)


def called_back(x):
    return lambda y: jax.pure_callback(
        lambda z: np.float64(x[0]) * z[0], jax.ShapeDtypeStruct((), y.dtype), y, vmap_method="sequential"
    )


def in_a_module(x):
    return Weighted(jnp.asarray(x))


def in_a_method(x):
    return Table(x).at


def in_floats(x):
    first, second, third = map(float, x)
    return lambda y: first * y[0] + second * y[1] + third * y[2]


SEEN = (
    *(in_a_jit, in_two_jits, in_a_scan, in_a_condition, in_a_loop, in_a_custom_derivative, in_a_root),
    *(in_a_partial, in_a_default, in_a_module, in_a_method, in_floats),
)
