"""A function that a program calls many times is performed once for all calls, with the results of each call."""

import jax
import jax.numpy as jnp
import numpy as np

from midlie_jax._xla.hoisting import Operation, hoist, perform

COUNT = 7


@jax.jit
def place(a, t):
    return jnp.exp(-a * t), jnp.sqrt(1 + t)


def in_stages(h, n, a, x):
    """A step that asks for a place at several times, and a derivative of it in the end."""
    for k in range(COUNT):
        near, far = place(a, n * h + k / COUNT)
        x = x * near + jnp.sin(x) / far
    return x


def step(h, n, a, x):
    return in_stages(h, n, a, x), jax.jvp(lambda t: place(a, t)[0], (n * h,), (h,))[1] * x


ARGUMENTS = 0.25, 3.0, 0.7, 1.1


def prepared():
    known, varying = [True, True, True, False], [False, True, False, False]
    return hoist(jax.make_jaxpr(step)(*ARGUMENTS), known, varying)


def test_a_step_that_asks_many_times_is_the_step_itself():
    split = prepared()
    results = split.rest(split.prepare(*ARGUMENTS[:3], None), *ARGUMENTS)
    np.testing.assert_allclose(results, step(*ARGUMENTS), rtol=4e-16)


def test_what_many_calls_share_is_in_the_program_once():
    """All calls of the step in one, and that of the derivative."""

    def calls(function, *arguments):
        return sum(e.primitive.name == "jit" for e in jax.make_jaxpr(function)(*arguments).jaxpr.eqns)

    split = prepared()
    assert calls(step, *ARGUMENTS) == COUNT + 1
    assert calls(lambda *x: split.prepare(*x, None), *ARGUMENTS[:3]) == 2


def equation_of(function, *arguments):
    (equation,) = jax.make_jaxpr(function)(*arguments).eqns
    return equation


def test_calls_on_the_same_numbers_are_one():
    values = {0: jnp.asarray(0.5)}
    cosine = equation_of(jnp.cos, 0.5)
    perform([Operation(cosine, [0], [1]), Operation(cosine, [0], [2])], values)
    assert values[1] is values[2]


def test_keys_of_random_numbers_are_left_as_they_are():
    """They are no numbers, so each call is performed alone."""
    split = equation_of(jax.jit(jax.random.split), jax.random.key(0))
    values = {k: jax.random.key(k) for k in (1, 2)}
    columns = perform([Operation(split, [k], [k + 2]) for k in (1, 2)], values)
    assert not columns
    for k in (1, 2):
        own = jax.random.split(jax.random.key(k))
        assert np.array_equal(jax.random.key_data(values[k + 2]), jax.random.key_data(own))
