"""Laws of the free body: what is conserved over 1e5 steps, and that LIEMID methods without torque are its flight."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    CLASSES,
    FREE,
    LIEMID,
    OTHER,
    RIGID_FLIGHTS,
    ROTATION,
    at,
    by_turns,
    cast,
    compiled,
    continued,
    epsilon,
    gap,
    quick,
    rows,
    run,
    setup,
    whole,
)

import midlie_jax as ml
from midlie_jax.integrators import flights, schemes
from midlie_jax.integrators.splitting import Splitting

LONG, SAVE, BLOCKS = 1000, 10, 100
ASYMMETRIC, SYMMETRIC = [0, 1, 2], [3, 4]
RUNS = rows(
    setup(dt=0.05),
    setup(**OTHER, dt=0.2),
    setup(moments=[1.0, 2.0, 3.0], dt=-0.1),
    setup(moments=[5.0, 5.0, 1.0], momentum=[1.0, -2.0, 20.0], dt=0.02),
    setup(moments=[1.0, 1.0, 1.8], momentum=[1.0, 0.5, 1.0], dt=0.1),
)


@cache
def free(name, dtype, blocks=1):
    """Momentum (rows, n, 3) and attitude (rows, n, 4) every `SAVE` steps, over blocks of `LONG` steps."""
    setups, parts = RUNS, []
    for _ in range(blocks):
        path = run(name, dtype, setups, steps=LONG, save_every=SAVE, forced=False, hurried=False)
        assert np.all(path.ok)
        parts.append(at(path.states))
        setups = continued(setups, path)
    return [np.concatenate(part, axis=1).astype(np.float64) for part in zip(*parts, strict=True)]


def spatial(states):
    """R Pi, in float64 so that reading it adds nothing."""
    momentum, attitude = states
    return np.asarray(ml.so3.rotate(jnp.asarray(attitude), jnp.asarray(momentum)))


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
    changes = drift(spatial((momentum, attitude / length(attitude))))
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
    energy = np.sum(momentum**2 / RUNS.moments[:, None], axis=-1)
    changes = drift(energy)
    assert changes[SYMMETRIC].max() <= WALK * epsilon(dtype), changes / epsilon(dtype)
    assert changes[ASYMMETRIC].min() > 1e-6  # no more than second order in the step otherwise


def flight_only(parts):
    """The method whose step is `parts` flights and nothing else."""
    stages = ((schemes.FLIGHT, 1 / parts),) * parts
    return Splitting(flights.LieMidpoint(), schemes.Scheme("flight", 2, stages, "this test"), "flight")


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("parts", "names", "dtype"),
    [
        (1, ("LIEMID[E1]", "LIEMID[E2]"), "float64"),
        (2, ("LIEMID[EA]", "LIEMID[EA*]"), "float32"),
        *whole(
            (1, ("LIEMID[E1]", "LIEMID[E2]"), "float32"),
            (2, ("LIEMID[EA]", "LIEMID[EA*]"), "float64"),
        ),
    ],
)
def test_liemid_without_torque_is_the_flight(parts, names, dtype):
    """E1 and E2 fly once a step, EA and EA* twice half as far: to the bit. I solves otherwise: to rounding."""
    flown = free(flight_only(parts), dtype)
    for name in names:
        for x, y in zip(free(name, dtype), flown, strict=True):
            np.testing.assert_array_equal(x, y)
    if parts == 1:
        steps = 40
        implicit, explicit = ([x[:, : 1 + steps // SAVE] for x in y] for y in (free("LIEMID[I]", dtype), flown))
        assert gap(implicit, explicit) <= 4 * steps * epsilon(dtype), gap(implicit, explicit) / epsilon(dtype)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "dtype"), by_turns(few=CLASSES[:4]))
def test_momentum_alone_follows_the_whole(name, dtype):
    """Without attitude the momentum is that of the full state, to 4 units of rounding a step."""
    alone = compiled(name, steps=LONG, save_every=SAVE, forced=False, state=ml.MomentumState)(cast(RUNS, dtype))
    momentum, _ = free(name, dtype)
    assert np.all(alone.ok)
    steps = SAVE * np.arange(1, LONG // SAVE + 1)[:, None]
    differences = np.abs(np.asarray(alone.states.momentum) - momentum)[:, 1:]
    size = np.linalg.norm(RUNS.momentum, axis=-1)[:, None, None]
    assert np.all(differences <= 4 * steps * epsilon(dtype) * size)


FLOWN = [f"{flight.name}[E1]" for flight in RIGID_FLIGHTS]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns([*FLOWN, *ROTATION], few=[*FLOWN, *CLASSES]))
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
