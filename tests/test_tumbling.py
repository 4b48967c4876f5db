"""Two periods, a pole and two phases, and what they make: inverse to each other, against runs and limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import refused

import midlie_jax as ml

MOMENTS = [0.61, 0.965, 1.0]
POLE = [-0.3320328728817035, -0.4230418832197608, 0.8430834693954098]
PERIODS = {"precession_period": 27.374, "rotation_period": 262.2}
BODY = ml.RigidBody(MOMENTS)


def asked(**more):
    return ml.asteroids.tumbling(
        **{"body": BODY, **PERIODS, "axis": "short", "pole": POLE, "phases": (0.0, 0.0), "mode": "short"} | more
    )


def period(tumble, axis):
    """Of the precession of an axis."""
    return tumble.short_axis_period if axis == "short" else tumble.long_axis_period


@pytest.mark.sample(0)
@pytest.mark.parametrize(("mode", "axes"), [("long", (2, 0, 1)), ("short", (1, 0, 2))])
def test_a_start_has_what_was_asked_for(mode, axes):
    """Also where the moments come in another order, and for bodies in a frame of your own."""
    body = ml.RigidBody(jnp.array(MOMENTS)[jnp.array(axes)])
    turned = ml.so3.to_matrix(ml.so3.exp(jnp.array([0.3, -0.5, 0.9])))
    tensor = ml.TensorBody(turned @ jnp.diag(body.moments) @ turned.T)
    for phases in ((-0.2, -1.0), (0.49, 3.0)):
        start = ml.asteroids.tumbling(body, **PERIODS, axis=mode, pole=POLE, phases=phases, mode=mode)
        other = ml.asteroids.tumbling(tensor, **PERIODS, axis=mode, pole=POLE, phases=phases, mode=mode)
        for tumble in (ml.asteroids.tumble(body, start), ml.asteroids.tumble(tensor, other)):
            assert bool(tumble.short_axis) is (mode == "short")
            found = [period(tumble, mode), tumble.rotation_period, *np.asarray(tumble.pole), tumble.energy_ratio]
            ratio = 1.02346487405869 if mode == "short" else 1.0426849053717553
            np.testing.assert_allclose(found, [*PERIODS.values(), *POLE, ratio], rtol=1e-12)
            effective = 2 * ml.observe.kinetic_energy(body, start) / tumble.momentum
            assert tumble.effective_rate == pytest.approx(float(effective), rel=1e-13)
        found = ml.asteroids.tumble(body, start).phases
        np.testing.assert_allclose(found[0], phases[0], atol=1e-13)
        np.testing.assert_allclose(np.sin((found[1] - phases[1]) / 2), 0, atol=5e-13)


@pytest.mark.sample(0)
def test_periods_are_those_of_a_free_body():
    """After a rotation period the momentum is back; both axes have then precessed by what their periods say."""
    body = ml.RigidBody(MOMENTS)
    start = asked(axis="long", phases=(0.1, 0.7), mode="long")
    count = 2000
    path = ml.free_motion(body, start, jnp.linspace(0.0, 262.2, count + 1))
    assert path.ok
    np.testing.assert_allclose(path.states.momentum[-1], start.momentum, atol=1e-13)
    momentum = np.asarray(path.states.momentum)
    assert np.linalg.norm(momentum - momentum[0], axis=-1)[100:-100].min() > 0.01 * np.linalg.norm(momentum[0])
    x = np.cross(POLE, [1.0, 0, 0]) / np.linalg.norm(np.cross(POLE, [1.0, 0, 0]))
    for axis, place in (("short", 2), ("long", 0)):
        direction = np.asarray(ml.so3.rotate(path.states.attitude, jnp.eye(3)[place][None]))
        angle = np.unwrap(np.arctan2(direction @ np.cross(POLE, x), direction @ x))
        turns = 262.2 / float(period(ml.asteroids.tumble(body, start), axis))
        assert (angle[-1] - angle[0]) / (2 * np.pi) == pytest.approx(turns, rel=1e-10)


test_mistakes_are_named = refused(
    (lambda: asked(mode=None), 'both modes have these periods. Give "short"'),
    (lambda: asked(axis="c"), 'axis must be "short" or "long"'),
    (lambda: asked(mode="SAM"), 'mode must be "short", "long" or None'),
    (lambda: asked(rotation_period=100.0), "rotation_period must be at least 7.56693 in the short-axis mode"),
    (lambda: asked(phases=0.3), r"phases must be a tuple \(s, phi\)"),
    (lambda: asked(body=ml.SymmetricRotor(1.0)), "body must be a RigidBody or a TensorBody, got SymmetricRotor"),
    (lambda: asked(body=ml.RigidBody([0.5, 1.0, 1.0])), "rotation_period must be at least inf"),
    (lambda: jax.jit(lambda p: asked(mode=None, rotation_period=p))(262.2), "where body or periods are traced"),
)


@pytest.mark.sample(0)
def test_a_mode_that_alone_has_the_periods_need_not_be_named():
    start = asked(mode=None, rotation_period=100.0)
    assert not ml.asteroids.tumble(BODY, start).short_axis
    assert np.isnan(jax.jit(lambda p: asked(rotation_period=p))(100.0).momentum).all()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_rotation_about_the_middle_axis_never_comes_back(dtype):
    """The rotation period is infinite; both precessions are those of the steady rotation, in either direction."""
    for moments, momentum in (
        ([1.0, 2.0, 2.5], [0.0, 1.5, 0.0]),
        ([2.0, 2.5, 1.0], [-1.5, 0.0, 0.0]),
        ([2.0, 2.0, 1.0], [0.9, -1.2, 0.0]),
        ([2.0, 2.0, 2.5], [0.9, 1.2, 0.0]),
    ):
        body = ml.RigidBody(np.array(moments, dtype))
        found = ml.asteroids.tumble(body, ml.MomentumState(jnp.array(momentum, dtype)))
        assert found.rotation_period == np.inf
        for value in (found.short_axis_period, found.long_axis_period):
            assert value == pytest.approx(2 * np.pi * 2 / 1.5, rel=2 * float(np.finfo(dtype).eps))
            assert value.dtype == dtype
    ball = ml.asteroids.tumble(ml.RigidBody([2.0] * 3), ml.MomentumState([0.0, 1.0, 0.0]))
    assert np.isnan(ball.rotation_period)


@pytest.mark.sample(0)
def test_toutatis_from_published_euler_angles():
    """Takahashi, Busch and Scheeres (2013), 23 days later by the test of another program (Principia)."""
    body = ml.RigidBody([3.0836, 3.235, 1.0])
    rates, angles = np.deg2rad([[14.5, 33.7, -98.5], [147.5, 63.9, 241.5]])
    start = ml.RigidState(body.momentum(jnp.asarray(rates)), ml.so3.from_euler(jnp.asarray(angles), "ZXZ"))
    later = jax.tree.map(lambda x: x[0], ml.free_motion(body, start, [23.159872685]).states)
    np.testing.assert_allclose(np.rad2deg(body.velocity(later.momentum)), [-38.5472, 1.4563, -97.1380], atol=6e-5)
    euler = np.rad2deg(ml.so3.to_euler(later.attitude, "ZXZ")) % 360
    np.testing.assert_allclose(euler, [115.5176, 81.9609, 110.6934], atol=6e-5)
    found = ml.asteroids.tumble(body, start)
    assert not found.short_axis
    np.testing.assert_allclose([found.rotation_period, found.long_axis_period], [5.3804, 7.3996], atol=6e-5)


def test_debris_with_two_equal_moments():
    """C. Robinson and C. Frueh (2025): 93.084 s at 83.62 degrees, and 279.25 s."""
    body, mrp = ml.RigidBody([1.0, 1.0, 0.25]), -np.ones(3) / 3
    square = mrp @ mrp
    attitude = np.append(1 - square, 2 * mrp) / (1 + square)
    start = ml.RigidState(body.momentum(jnp.array([0.03, 0.06, 0.03])), attitude)
    found = ml.asteroids.tumble(body, start)
    np.testing.assert_allclose([found.long_axis_period, found.rotation_period], [93.084, 279.25], rtol=1e-5)
    axis = ml.so3.rotate(start.attitude, jnp.array([0.0, 0.0, 1.0]))
    assert np.rad2deg(np.arccos(axis @ np.asarray(found.pole))) == pytest.approx(83.62, abs=0.005)


def test_all_modes_of_a_pair_of_periods():
    """Each start has the pair in its mode and about its axis; the rates of both axes differ by a circuit."""
    given = {"precession_period": 5.0, "rotation_period": 40.0, "pole": POLE, "phases": (0.1, 0.2)}
    starts = ml.asteroids.tumblings(BODY, **given)
    assert set(starts) == {(mode, axis) for mode in ("short", "long") for axis in ("short", "long")}
    for (mode, axis), start in starts.items():
        found = ml.asteroids.tumble(BODY, start)
        assert bool(found.short_axis) is (mode == "short")
        np.testing.assert_allclose([period(found, axis), found.rotation_period], [5.0, 40.0], rtol=1e-10)
        difference = 1 / found.short_axis_period - 1 / found.long_axis_period
        assert difference == pytest.approx(1 / 40, rel=1e-10)
    assert set(ml.asteroids.tumblings(BODY, **given, axis="long")) == {("short", "long"), ("long", "long")}
    assert not ml.asteroids.tumblings(BODY, **(given | {"rotation_period": 3.0}), axis="short")
    with pytest.raises(ValueError, match="pole must not be zero"):
        ml.asteroids.tumblings(BODY, **(given | {"pole": [0.0, 0.0, 0.0]}))
