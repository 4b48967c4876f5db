"""Laws of every rotation method: order, reversal, rest; that how a run is made does not matter; and free bodies.

A new method is tested by being registered.
"""

from fractions import Fraction
from functools import cache, partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    BUILDS,
    CLASSES,
    DTYPES,
    FREE,
    LIEMID,
    METHODS,
    OTHER,
    RIGID_FLIGHTS,
    ROTATION,
    STEPS,
    WAYS,
    Setup,
    at,
    by_turns,
    cast,
    compiled,
    continued,
    each,
    epsilon,
    equal_moments,
    gap,
    integrate,
    quick,
    rows,
    run,
    run_solo,
    setup,
    true_motion,
    whole,
)

import midlie_jax as ml
from midlie_jax.drivers.clock import time_of
from midlie_jax.integrators import flights, schemes
from midlie_jax.integrators.splitting import Splitting

# Two bodies at halving steps; row r reaches time 1 at step 16 << r % 4. Then a row for each law that needs one.
LEVELS = 4
RUNS = rows(*(setup(**body, dt=1 / (16 << level)) for body in ({}, OTHER) for level in range(LEVELS)), setup(dt=0.0))
STILL = 2 * LEVELS
# The runs used where rounding is measured: times 2 and 1, before small differences have grown much.
SHORT = [2, 3, 6, 7]


# In float64 all that are built differently; in float32 every second class.
SINGLE = CLASSES[::2]
TAKEN = [*product(BUILDS, ["float64"]), *product(SINGLE, ["float32"])]
TAKEN += whole(*(pair for pair in product(ROTATION, DTYPES) if pair not in TAKEN))


@cache
def paths(name, dtype):
    return run(name, dtype, RUNS)


def roundings(name):
    """Steps, counted once for every two flights in them."""
    return STEPS * max(1, getattr(ml.method(name), "scheme", schemes.EA).flights / 2)


@cache
def truth(body, equal):
    start = setup(**(OTHER if body else {}))
    moments = start.moments[[0, 0, 2]] if equal else start.moments
    return true_motion(start._replace(moments=moments), np.array([1.0]))


# At higher orders the errors of these steps are those of rounding: `test_schemes.py` measures each scheme by itself.
MEASURED = [method.name for method in METHODS if method.order <= 4 and not getattr(method, "small", None)]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", each(MEASURED))
def test_order(name):
    """Measured on an asymmetric body under a torque that depends on attitude and time, at the smallest steps."""
    found, order = paths(name, "float64"), ml.method(name).order
    for body in (0, 1):
        exact = [part[0] for part in truth(body, equal_moments(name))]
        errors = []
        for level in range(LEVELS):
            state = at(found.states, body * LEVELS + level, 16 << level)
            errors.append([np.linalg.norm(x - y) for x, y in zip(state, exact, strict=True)])
        coarse, fine = errors[-2:] if order <= 2 else errors[:2]
        slopes = np.log2(np.divide(coarse, fine))
        assert np.all(np.abs(slopes - order) < (0.1 if order <= 2 else 0.2)), (slopes, errors)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=SINGLE))
def test_float32_follows_float64(name):
    """Each step rounds a few times, and the motion magnifies it little in this time: half a unit a step at most."""
    single, double = paths(name, "float32"), paths(name, "float64")
    assert single.states.momentum.dtype == single.times.dtype == np.float32
    assert np.all(single.ok)
    assert np.all(double.ok)
    for row in SHORT:
        difference = gap(at(single.states, row), at(double.states, row))
        assert difference <= roundings(name) / 2 * epsilon("float32"), difference / epsilon("float32")


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "dtype"), TAKEN)
def test_symmetric_methods_come_back(name, dtype):
    """N steps of dt, then N of -dt. The others miss by their own error, of 1e-3 or more here at order 1."""
    gaps, method = missed(name, name, dtype), ml.method(name)
    if method.symmetric:
        assert max(gaps) <= roundings(name) * epsilon(dtype), np.array(gaps) / epsilon(dtype)
    elif method.order == 1:
        assert min(gaps) > 1e-3, gaps


def missed(there, back, dtype):
    """How far from the start the method `back` ends after the steps of `there`."""
    out = paths(there, dtype)
    returned = run(back, dtype, continued(RUNS, out, dt=-RUNS.dt, t0=RUNS.t0 + STEPS * RUNS.dt))
    return [gap(at(returned.states, row, -1), at(out.states, row, 0)) for row in SHORT]


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_first_order_methods_are_adjoint(dtype):
    """A step of -dt by one undoes a step of dt by the other."""
    for there, back in (("LIEMID[E1]", "LIEMID[E2]"), ("LIEMID[E2]", "LIEMID[E1]")):
        gaps = missed(there, back, dtype)
        assert max(gaps) <= STEPS * epsilon(dtype), np.array(gaps) / epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), TAKEN)
def test_a_step_of_no_length_changes_no_bit(name, dtype):
    states = paths(name, dtype).states
    for part, start in zip(at(states, STILL), at(states, STILL, 0), strict=True):
        np.testing.assert_array_equal(part, np.broadcast_to(start, part.shape))


FLOWN = [f"{flight.name}[EA]" for flight in RIGID_FLIGHTS]


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", each(list(dict.fromkeys([*FLOWN, *ROTATION])), few=[*FLOWN, *CLASSES]))
def test_thirty_radians_a_step_are_refused(name):
    """By every method: none has a step of which such a turn is a part of the truth."""
    rng = np.random.default_rng(0)
    masses = rng.uniform(0.3, 1, (1000, 3))
    if equal_moments(name):
        masses[:, 1] = masses[:, 0]
    moments = masses.sum(1, keepdims=True) - masses
    momentum = rng.normal(size=(1000, 3))
    momentum *= 30 / np.linalg.norm(momentum / moments, axis=1, keepdims=True)

    def run(moments, momentum):
        start = ml.RigidState(momentum, jnp.array([1.0, 0, 0, 0]))
        return ml.integrate(name, ml.RigidBody(moments), None, start, dt=1.0, steps=1).ok

    assert not np.any(quick(jax.vmap(run))(moments, momentum))


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
KEPT = 4


@cache
def batch(name, dtype):
    return run(name, dtype, BATCH)


@cache
def solo(name, dtype, row):
    return run_solo(name, dtype, EACH[row])


FEW = [*product(WAYS[::2], ["float64"]), ("JACOBI[EA]", "float32")]


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
@pytest.mark.parametrize("name", each(few=WAYS[::2]))
def test_a_split_run_equals_the_whole(name):
    """To the bit, although the parts are another program, with another number of steps, that keeps fewer states."""
    half = STEPS // 2
    row = TOP * (name in WAYS[2::4])  # with `swing` and as a top, in turns
    whole, start = solo(name, "float64", row), EACH[row]
    for first in (7, half):
        momentum, attitude = at(whole.states, first)
        begun = start._replace(momentum=momentum, attitude=attitude, first_step=np.int32(first))
        path = run_solo(name, "float64", begun, steps=half, save_every=KEPT)
        kept = slice(first, first + half + 1, KEPT)
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


LONG, SAVE, BLOCKS = 1000, 10, 100
ASYMMETRIC, SYMMETRIC = [0, 1, 2], [3, 4]
FREE_RUNS = rows(
    setup(dt=0.05),
    setup(**OTHER, dt=0.2),
    setup(moments=[1.0, 2.0, 3.0], dt=-0.1),
    setup(moments=[5.0, 5.0, 1.0], momentum=[1.0, -2.0, 20.0], dt=0.02),
    setup(moments=[1.0, 1.0, 1.8], momentum=[1.0, 0.5, 1.0], dt=0.1),
)


@cache
def free(name, dtype, blocks=1):
    """Momentum (rows, n, 3) and attitude (rows, n, 4) every `SAVE` steps, over blocks of `LONG` steps."""
    setups, parts = FREE_RUNS, []
    for _ in range(blocks):
        path = run(name, dtype, setups, steps=LONG, save_every=SAVE, forced=False, hurried=False)
        assert np.all(path.ok)
        parts.append(at(path.states))
        setups = continued(setups, path)
    return [np.concatenate(part, axis=1).astype(np.float64) for part in zip(*parts, strict=True)]


def drift(series):
    """The largest change of each row, relative to its size."""
    start = series[:, :1]
    axes = tuple(range(2, series.ndim))
    change, size = np.square(series - start), np.square(start)
    if axes:
        change, size = change.sum(axes), size.sum(axes)
    return np.sqrt(change / size).max(axis=1)


# A flight rounds each entry of R and Pi a few times. The errors fall either way and add up as a random walk (see
# test_rounding.py): a few eps, times the square root of the number of flights. Anything that leans one way breaks this.
WALK = 4 * np.sqrt(LONG * BLOCKS)


def length(part):
    return np.linalg.norm(part, axis=-1, keepdims=True)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns(few=FREE))
def test_spatial_momentum_of_a_free_body(name, dtype):
    """R Pi with R the rotation that the attitude stands for; that the attitude stays unit is the next law."""
    momentum, attitude = free(name, dtype, BLOCKS)
    changes = drift(np.asarray(ml.so3.rotate(jnp.asarray(attitude / length(attitude)), jnp.asarray(momentum))))
    if not ml.method(name).keeps_momentum:
        # The errors of a method of order 12 are below rounding at this step, in float32 also those of order 8.
        assert ml.method(name).order > (8 if dtype == "float64" else 7) or changes[ASYMMETRIC].max() > 1e3 * epsilon(
            dtype
        ), changes
    else:
        turns = getattr(ml.method(name), "scheme", schemes.E2).flights
        assert changes.max() <= np.sqrt(turns) * WALK * epsilon(dtype), changes / epsilon(dtype)


@pytest.mark.sample(2)
@pytest.mark.parametrize(("name", "dtype"), by_turns(few=FREE))
def test_attitude_stays_a_unit_quaternion(name, dtype):
    """To the rounding of one step, however many came before."""
    _, attitude = free(name, dtype, BLOCKS)
    changes = np.abs(length(attitude)[..., 0] - 1).max(axis=1)
    assert changes.max() <= 2 * epsilon(dtype), changes / epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns([*LIEMID, "LIEMID[I]"]))
def test_energy_of_a_symmetric_free_body(name, dtype):
    """I Psi = h exp(-Psi/2) Pi keeps the part of Pi along the axis of symmetry, and |Pi| by construction."""
    momentum, _ = free(name, dtype, BLOCKS)
    energy = np.sum(momentum**2 / FREE_RUNS.moments[:, None], axis=-1)
    changes = drift(energy)
    assert changes[SYMMETRIC].max() <= WALK * epsilon(dtype), changes / epsilon(dtype)
    assert changes[ASYMMETRIC].min() > 1e-6  # no more than second order in the step otherwise


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("parts", "names", "dtype"),
    [(1, ("LIEMID[E1]", "LIEMID[E2]"), "float64"), (2, ("LIEMID[EA]", "LIEMID[EA*]"), "float32")],
)
def test_liemid_without_torque_is_the_flight(parts, names, dtype):
    """E1 and E2 fly once a step, EA and EA* twice half as far: to the bit. I solves otherwise: to rounding."""
    flight = schemes.Scheme("flight", 2, ((schemes.FLIGHT, 1 / parts),) * parts, "this test")
    flown = free(Splitting(flights.LieMidpoint(), flight, "flight"), dtype)
    for name in names:
        bits(free(name, dtype), flown)
    if parts == 1:
        steps = 40
        implicit, explicit = ([x[:, : 1 + steps // SAVE] for x in y] for y in (free("LIEMID[I]", dtype), flown))
        assert gap(implicit, explicit) <= 4 * steps * epsilon(dtype), gap(implicit, explicit) / epsilon(dtype)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "dtype"), by_turns(few=CLASSES[:4]))
def test_momentum_alone_follows_the_whole(name, dtype):
    """Without attitude the momentum is that of the full state, to 4 units of rounding a step."""
    alone = compiled(name, steps=LONG, save_every=SAVE, forced=False, state=ml.MomentumState)(cast(FREE_RUNS, dtype))
    momentum, _ = free(name, dtype)
    assert np.all(alone.ok)
    steps = SAVE * np.arange(1, LONG // SAVE + 1)[:, None]
    differences = np.abs(np.asarray(alone.states.momentum) - momentum)[:, 1:]
    size = np.linalg.norm(FREE_RUNS.momentum, axis=-1)[:, None, None]
    assert np.all(differences <= 4 * steps * epsilon(dtype) * size)


FLOWN_ONCE = [f"{flight.name}[E1]" for flight in RIGID_FLIGHTS]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns([*FLOWN_ONCE, *ROTATION], few=FLOWN_ONCE))
def test_a_pose_keeps_its_length_at_any_turn_that_is_not_refused(name, dtype):
    """What rounding takes from the length of a direction or an attitude does not grow, turned by up to 2.4 radians."""
    turns = np.linspace(0.1, 2.4, 24).astype(dtype)
    body = ml.RigidBody(jnp.ones(3, dtype))
    momentum, direction = jnp.array([0.0, 0.6, 0.8], dtype), jnp.array([1.0, 0, 0], dtype)

    @quick
    @partial(jax.vmap, in_axes=(None, 0))
    def run(start, dt):
        path = ml.integrate(name, body, None, start, dt=dt, steps=100, save_every=100)
        return path.states.parts()[1], path.ok

    starts = ml.DirectionState(momentum, direction), ml.RigidState(momentum, jnp.array([0.6, 0.8, 0, 0], dtype))
    pose, ok = run(starts[len(name) % 2], turns)
    length = np.linalg.norm(np.stack(pose), axis=0)
    assert ok[turns < 0.8].all()
    np.testing.assert_allclose(length[np.asarray(ok)], 1, atol=4 * epsilon(dtype))
