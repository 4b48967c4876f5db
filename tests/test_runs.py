"""How a run is made must not matter: batched or alone, in one piece or several, kept often or seldom, with or
without the parts of the state that the torque does not need."""

from fractions import Fraction
from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    CLASSES,
    DTYPES,
    OTHER,
    ROTATION,
    STEPS,
    WAYS,
    Setup,
    at,
    cast,
    compiled,
    each,
    epsilon,
    gap,
    integrate,
    rows,
    run,
    run_solo,
    setup,
    whole,
)

import midlie_jax as ml
from midlie_jax.drivers.clock import time_of

# Runs that differ in everything that can be mapped over: body, torque, start, step.
EACH = (
    setup(),
    setup(**OTHER),
    setup(moments=[2.0, 3.0, 1.5]),
    setup(weight=-0.7, strength=0.3),
    setup(momentum=[0.2, -1.9, 0.4], attitude=OTHER["attitude"]),
    setup(dt=1 / 40),
    setup(dt=-1 / 90, t0=-2.0, first_step=5),
    setup(strength=0.0, attitude=OTHER["attitude"]),  # a top and no more
)
BATCH = rows(*EACH)
TOP = len(EACH) - 1
SAVE = 4


@cache
def batch(name, dtype):
    return run(name, dtype, BATCH)


@cache
def solo(name, dtype, row):
    return run_solo(name, dtype, EACH[row])


FEW = [*product(WAYS, ["float64"]), ("JACOBI[EA]", "float32")]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), [*FEW, *whole(*(x for x in product(ROTATION, DTYPES) if x not in FEW))])
def test_a_batch_equals_its_runs(name, dtype):
    """Vectorised code contracts other products into fused multiply-adds: 4 units a step of the state's size."""
    together = batch(name, dtype)
    for row in range(len(EACH)):
        alone = solo(name, dtype, row)
        np.testing.assert_allclose(together.times[row], alone.times, rtol=epsilon(dtype))
        assert together.ok[row] == alone.ok == np.True_
        allowed = 4 * epsilon(dtype) * np.arange(STEPS + 1)[:, None]
        for x, y in zip(at(together.states, row), at(alone.states), strict=True):
            assert np.all(np.abs(x - y) <= allowed * np.linalg.norm(y, axis=-1, keepdims=True))


@pytest.mark.sample(0)
@pytest.mark.parametrize("mapped", ["moments", "momentum", "dt"])
def test_each_argument_can_be_mapped_alone(mapped):
    """The rest unbatched. One method is enough: mapping is the driver's business."""
    one = cast(EACH[0], "float64")
    many = one._replace(**{mapped: jnp.asarray(getattr(BATCH, mapped))})
    axes = Setup(*(0 if field == mapped else None for field in Setup._fields))
    found = jax.jit(jax.vmap(lambda s: integrate("LIEMID[E2]", s), in_axes=(axes,)))(many)
    for row, value in enumerate(getattr(BATCH, mapped)):
        alone = run_solo("LIEMID[E2]", "float64", EACH[0]._replace(**{mapped: value}))
        states = jax.tree.map(lambda x, row=row: np.asarray(x)[row], found.states)
        assert gap(at(states), at(alone.states)) <= 4 * STEPS * epsilon("float64")


def bits(a, b):
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=WAYS))
def test_a_split_run_equals_the_whole(name):
    """To the bit, although the parts are another program, with another number of steps, that keeps fewer states."""
    half, row = STEPS // 2, WAYS.index(name) % 2 * TOP if name in WAYS else 0  # with `swing` and as a top, in turns
    whole, start = solo(name, "float64", row), EACH[row]
    for first in (7, half):
        momentum, attitude = at(whole.states, first)
        begun = start._replace(momentum=momentum, attitude=attitude, first_step=np.int32(first))
        path = run_solo(name, "float64", begun, steps=half, save_every=SAVE)
        kept = slice(first, first + half + 1, SAVE)
        np.testing.assert_array_equal(path.times, whole.times[kept])
        bits(at(path.states), at(whole.states, kept))


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", each(few=WAYS[:4]))
def test_a_batched_run_split_equals_the_whole(name):
    """The same compiled batch, begun at another step: to the bit."""
    whole, middle = batch(name, "float64"), 48
    momentum, attitude = at(whole.states, slice(None), middle)
    rest = BATCH._replace(momentum=momentum, attitude=attitude, first_step=BATCH.first_step + np.int32(middle))
    left = slice(0, STEPS + 1 - middle)
    found = run(name, "float64", rest)
    bits(at(found.states, slice(None), left), at(whole.states, slice(None), slice(middle, None)))


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=CLASSES[:3]))
def test_one_direction_follows_the_whole(name):
    """A top needs no more than the vertical: momentum and last row of R as the full state gives them."""
    top = jax.tree.map(lambda x: x[None, TOP], cast(BATCH, "float64"))
    found = compiled(name, state=ml.DirectionState)(top)
    whole = batch(name, "float64").states
    allowed = 4 * epsilon("float64") * np.arange(STEPS + 1)[:, None]
    vertical = np.asarray(ml.so3.to_matrix(jnp.asarray(whole.attitude[TOP])))[:, 2]
    for x, y in ((found.states.momentum[0], whole.momentum[TOP]), (found.states.direction[0], vertical)):
        assert np.all(
            np.abs(np.asarray(x) - y) <= (allowed + 4 * epsilon("float64")) * np.linalg.norm(y, axis=-1)[:, None]
        )
    assert found.ok.all()


@pytest.mark.parametrize("dtype", DTYPES)
def test_times_of_steps_are_exact_to_rounding_on_both_sides_of_zero(dtype):
    """For every index of 32 bits, against exact fractions."""
    dt = np.asarray(0.05, dtype)
    indices = np.array([0, 1, 32, 2**24 + 1, 2**30 + 3, 2**31 - 2], np.int32)
    for n in (indices, -indices):
        exact = [float(Fraction(float(dt)) * int(i)) for i in n]
        found = time_of(jnp.zeros((), dtype), jnp.asarray(dt), jnp.asarray(n))
        assert np.allclose(found, exact, rtol=2 * np.finfo(dtype).eps, atol=0)
