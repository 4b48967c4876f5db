"""The batch driver: the same motions as `integrate`, however the batch is cut, and errors that name the cure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import epsilon

import midlie_jax as ml

COUNT, STEPS = 7, 12
METHOD = "LIEMID[E2]"
RNG = np.random.default_rng(3)
MOMENTS = 2 + RNG.uniform(size=(COUNT, 3))
WEIGHTS = RNG.uniform(1, 3, size=COUNT)
DTS = RNG.uniform(0.01, 0.03, size=COUNT)
T0S = RNG.uniform(0, 1, size=COUNT)
START = ml.RigidState(RNG.normal(size=(COUNT, 3)), ml.so3.exp(jnp.asarray(RNG.normal(size=(COUNT, 3)))))


def row(tree, i):
    return jax.tree.map(lambda x: x[i], tree)


def moved(driver, which, dtype, **options):
    """The bodies, which differ in everything, or one of them."""
    moments, weights, start, dt, t0 = jax.tree.map(
        lambda x: jnp.asarray(x[which], dtype), (MOMENTS, WEIGHTS, START, DTS, T0S)
    )
    body, torque = ml.RigidBody(moments), ml.torques.HeavyTop(weights)
    return driver(METHOD, body, torque, start, dt=dt, t0=t0, steps=STEPS, save_every=4, **options)


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_each_body_moves_as_it_would_alone(dtype):
    path = moved(ml.ensemble, slice(None), dtype, chunk=3)
    assert path.times.shape == (COUNT, 4)
    assert path.states.momentum.shape == (COUNT, 4, 3)
    assert path.ok.shape == (COUNT,)
    assert np.all(path.ok)
    for i in (0, COUNT - 1):
        solo = moved(ml.integrate, i, dtype)
        for mine, its in zip(jax.tree.leaves(row(path, i)), jax.tree.leaves(solo), strict=True):
            assert mine.dtype == its.dtype
            np.testing.assert_allclose(mine, its, rtol=0, atol=4 * STEPS * epsilon(dtype))


def test_failures_are_those_of_the_bodies():
    """A body that is spun too fast for its step says so; its neighbours do not."""
    fast = ml.RigidState(START.momentum.at[2].multiply(1e5), START.attitude)
    path = ml.ensemble(METHOD, ml.RigidBody(jnp.asarray(MOMENTS[0])), None, fast, dt=0.02, steps=STEPS, chunk=3)
    assert list(np.flatnonzero(~np.asarray(path.ok))) == [2]


MANY = jax.tree.map(lambda x: jnp.concatenate([x, x, x[:2]]), START)  # 16 bodies, in two chunks of 8
BODY = ml.RigidBody(jnp.asarray(MOMENTS[0]))


def pulled(strengths, table, t, state):
    """One strength a body, and a table that all share."""
    return strengths * table[3] * ml.so3.rotate(ml.so3.conjugate(state.attitude), jnp.array([0.0, 1.0, 0.0]))


def unchecked(**arrays):
    """A state that its class would refuse."""
    return jax.tree.unflatten(jax.tree.structure(START), arrays.values())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"torque": ml.torques.HeavyTop(jnp.ones(10))},
            r"shape \(10, 3\) instead of \(3,\), from its parameters mgl \(10,\); there are 16 bodies",
        ),
        ({"start": row(START, 0)}, "start.momentum must be .n, 3..*midlie_jax.integrate"),
        ({"t0": jnp.ones((7, 2))}, "t0 must be"),
        ({"chunk": 0}, "chunk must be a positive"),
        ({"dt": jnp.zeros(16)}, "dt must be finite and not zero"),
        ({"steps": 2**31}, "count beyond"),
        ({"save_every": 5}, "divisible"),
        ({"torque": ml.torques.HeavyTop(jnp.ones(20)), "torque_axes": 0}, "torque.mgl has 20 rows.*16 bodies"),
        ({"torque": ml.torques.HeavyTop(1.0), "torque_axes": 0}, "torque.mgl has no rows.*16 bodies"),
        ({"torque": ml.torques.HeavyTop(jnp.ones(16)), "torque_axes": 1}, 'torque_axes must be "auto", None'),
        ({"torque": ml.torques.HeavyTop(jnp.ones(16)), "torque_axes": (0, 0)}, "torque_axes.*does not fit the torque"),
        ({"start": jax.tree.map(lambda x: x[:0], MANY)}, r"start holds no bodies.*\(0, 3\)"),
        ({"body": ml.RigidBody(jnp.ones((10, 3)))}, "body.moments has 10 rows.*16 bodies"),
        (
            {"start": unchecked(momentum=MANY.momentum, attitude=jnp.concatenate([MANY.attitude, MANY.attitude[:4]]))},
            r"attitude \(20, 4\) must have the same leading axes",
        ),
        ({"t0": jnp.ones(20)}, "t0 has 20 rows.*16 bodies"),
    ],
)
def test_bad_arguments_are_named_whatever_the_chunks(changes, message):
    given = {"body": BODY, "torque": None, "start": MANY, "dt": 0.02, "steps": STEPS, "chunk": 8} | changes
    with pytest.raises(ValueError, match=message):
        ml.ensemble(METHOD, given.pop("body"), given.pop("torque"), given.pop("start"), **given)


STRENGTHS, FIELDS = jnp.asarray(RNG.uniform(size=16)), jnp.asarray(RNG.normal(size=(16, 3)))
TABLE = jnp.arange(16.0)
MIXED = {
    "of a torque that reads the body": (
        ml.torques.HeavyTop(2.0) + ml.torques.Damping(FIELDS**2),
        lambda i: ml.torques.HeavyTop(2.0) + ml.torques.Damping(FIELDS[i] ** 2),
    ),
    "beside a table as long": (
        jax.tree_util.Partial(pulled, STRENGTHS, TABLE),
        lambda i: jax.tree_util.Partial(pulled, STRENGTHS[i], TABLE),
    ),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", MIXED)
def test_parameters_with_a_row_a_body_are_found(name):
    torque, alone = MIXED[name]
    path = ml.ensemble(METHOD, BODY, torque, MANY, dt=0.02, steps=STEPS, chunk=8)
    assert path.ok.all()
    for i in (0, 15):
        solo = ml.integrate(METHOD, BODY, alone(i), row(MANY, i), dt=0.02, steps=STEPS, save_every=STEPS)
        np.testing.assert_allclose(path.states.momentum[i], solo.states.momentum[-1], rtol=0, atol=1e-14)


def test_mixed_axes_may_be_said():
    torque = ml.torques.HeavyTop(2.0) + ml.torques.DipoleInField(FIELDS, FIELDS[1])
    axes = jax.tree.unflatten(jax.tree.structure(torque), [None, 0, None])  # weight, dipole moment, field
    found = ml.ensemble(METHOD, BODY, torque, MANY, dt=0.02, steps=STEPS)
    for said_axes in (axes, "terms[1].moment", ["terms[1].moment"]):
        said = ml.ensemble(METHOD, BODY, torque, MANY, dt=0.02, steps=STEPS, torque_axes=said_axes)
        np.testing.assert_array_equal(said.states.momentum, found.states.momentum)


def spectrum(amplitudes, rates, own, t, state):
    """A torque that all bodies share in time, with strengths of their own."""
    return jnp.sum(amplitudes * jnp.cos(rates * t)) * sum(own) * state.attitude[1:]


LINES = jax.tree_util.Partial(spectrum, FIELDS[0, 0] + TABLE[:8], TABLE[:8], [STRENGTHS[:8]] * 5)
EIGHT = jax.tree.map(lambda x: x[:8], MANY)
DRAG = ml.torques.Damping(FIELDS[0] ** 2)  # for each axis, or with three bodies one for each


@pytest.mark.parametrize(
    ("torque", "count", "words"),
    [
        (DRAG, 3, r"coefficient \(3,\) may be one value .* Write torque_axes=None, or torque_axes=0"),
        (ml.torques.HeavyTop(STRENGTHS[:3]) + DRAG, 3, r"Write torque_axes=\['terms\[0\].mgl'\], or torque_axes=0"),
        (LINES, 8, "can be read in two ways.*Write torque_axes="),
        (jax.tree_util.Partial(spectrum, TABLE[:8], TABLE[:8], [STRENGTHS[:8]] * 8), 8, "10 parameters .* have 8 rows"),
    ],
    ids=["for each axis", "beside another", "a spectrum", "too many to try"],
)
def test_what_can_be_read_in_two_ways_is_refused(torque, count, words):
    start = jax.tree.map(lambda x: x[:count], MANY)
    with pytest.raises(ValueError, match=words):
        ml.ensemble(METHOD, BODY, torque, start, dt=0.02, steps=STEPS)


@pytest.mark.sample(0)
def test_each_reading_is_taken_when_it_is_said():
    """The shared spectrum and rows of its own strengths, and a drag for each axis, as one body alone has them."""
    names = [jax.tree_util.keystr(path).removeprefix(".") for path, _ in jax.tree_util.tree_leaves_with_path(LINES)]
    names = [name for name in names if "[2]" in name]
    for torque, start, axes, alone in (
        (LINES, EIGHT, names, jax.tree_util.Partial(spectrum, *LINES.args[:2], [STRENGTHS[2]] * 5)),
        (DRAG, jax.tree.map(lambda x: x[:3], MANY), None, DRAG),
        (DRAG, jax.tree.map(lambda x: x[:3], MANY), 0, ml.torques.Damping(DRAG.coefficient[2])),
    ):
        path = ml.ensemble(METHOD, BODY, torque, start, dt=0.02, steps=STEPS, torque_axes=axes)
        solo = ml.integrate(METHOD, BODY, alone, row(MANY, 2), dt=0.02, steps=STEPS, save_every=STEPS)
        np.testing.assert_allclose(path.states.momentum[2], solo.states.momentum[-1], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (0, r"one body gets .*field \(\).* the torque cannot use that"),
        ("mass", "torque_axes names 'mass', but the torque's parameters are terms"),
        (["terms[1].moment"], r"terms\[1\].moment \(\).* cannot use that"),
    ],
)
def test_axes_that_do_not_fit_are_named(axes, words):
    torque = ml.torques.HeavyTop(STRENGTHS[:3]) + ml.torques.DipoleInField(FIELDS[0], FIELDS[1])
    start = jax.tree.map(lambda x: x[:3], MANY)
    with pytest.raises(ValueError, match=words):
        ml.ensemble(METHOD, BODY, torque, start, dt=0.02, steps=STEPS, torque_axes=axes)
