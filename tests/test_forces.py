"""The forces of the package on bodies that travel, and axes: closed forms, limits, wrenches of potentials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, refused, turn, whole

import midlie_jax as ml
from midlie_jax.cli.oracle import exact_motion

T = ml.torques


def test_a_spinning_ball_is_bent_across_its_velocity_and_its_spin():
    rigid = ml.RigidBody([2.0, 2.0, 2.0])
    state = ml.FreeState([1.0, 0.5, -2.0], turn(0.5, -0.3, 0.8), [3.0, 6.0, 9.0], [0.0, 0, 0])
    spin = ml.observe.spatial_angular_velocity(rigid, state.turning)
    wrench = T.Magnus(0.4, wind=[0.5, 0.0, 0.0]).on(ml.FreeBody(rigid, 3.0))(0.0, state)
    np.testing.assert_allclose(wrench.force, 0.4 * np.cross(spin, [0.5, 2.0, 3.0]), atol=1e-14)
    axis = T.Magnus(0.4).on(ml.FreeBody(ml.SymmetricRotor(2.0, 2.0), 3.0))(0.0, ml.FreeAxisState.of(state))
    np.testing.assert_allclose(axis.force, 0.4 * np.cross(spin, [1.0, 2.0, 3.0]), atol=1e-14)


def test_an_engine_pushes_along_the_body_and_turns_it_by_its_lever():
    state = ml.FreeState([1.0, 0.5, -2.0], turn(0.5, -0.3, 0.8), [0.0, 0, 0], [0.0, 0, 0])
    force, lever = jnp.array([0.0, 0.3, 2.0]), jnp.array([0.1, 0.0, -0.5])
    wrench = ml.spacecraft.Thrust(lambda t: t * force, lever)(2.0, state)
    np.testing.assert_allclose(wrench.torque, np.cross(lever, 2 * force), atol=1e-14)
    np.testing.assert_allclose(wrench.force, 2 * ml.so3.to_matrix(state.attitude) @ force, atol=1e-14)


def test_wrenches_add_and_an_array_is_a_torque_alone():
    one, ones = T.Wrench(jnp.ones(3), jnp.arange(3.0)), np.ones(3)
    both = [one + one, one + T.Wrench(ones, np.arange(3.0))]
    alone = [one + ones, ones + one, jnp.ones(3) + one, T.Sum(lambda t, s: one, lambda t, s: jnp.ones(3))(0, 0)]
    for totals, times in ((both, 2), (alone, 1)):
        for total in totals:
            np.testing.assert_array_equal(total.torque, 2 * ones)
            np.testing.assert_array_equal(total.force, times * np.arange(3.0))


@pytest.mark.sample(0)
@pytest.mark.parametrize("spin", [4.0, *whole(0.0, -7.0)])
def test_the_axis_of_a_heavy_top_is_lagranges_to_1e12(spin):
    moments, weight, times = [2.0, 2.0, 0.9], 3.0, np.array([0.0, 0.4, 0.8])
    momentum, attitude = np.array([0.6, -0.4, spin]), turn(0.7, 0.2, -0.3)
    begin = ml.AxisState.of(ml.RigidState(momentum, attitude))
    run = {"dt": 1 / 320, "steps": 256, "save_every": 128}
    path = quick(lambda s: ml.integrate("SYMMETRIC[SRKN14a]", ROTOR, T.HeavyTop(weight), s, **run))(begin)
    exact = ml.AxisState.of(ml.RigidState(*exact_motion(moments, momentum, attitude, times, weight=weight)))
    np.testing.assert_allclose(path.states.axis, exact.axis, atol=1e-12)
    np.testing.assert_allclose(path.states.momentum, exact.momentum, atol=1e-12 * np.abs(momentum).max())


def test_the_momentum_of_a_failed_run_is_no_exception():
    failed = jax.tree.map(lambda x: x * jnp.nan, FREE)
    assert jnp.all(jnp.isnan(ml.observe.spatial_momentum(failed)))


def test_axis_states_and_back():
    """The angle of spin is chosen, and the axis kept, also where it points up or down."""
    axes = np.array([[0.0, 0.6, -0.8], [0, 0, 1], [0, 0, -1], [1e-9, 0, -1], [0.36, 0.48, 0.8]])
    state = ml.AxisState(np.arange(15.0).reshape(5, 3), axes)
    back = ml.AxisState.of(state.with_attitude())
    np.testing.assert_allclose(back.axis, axes, atol=1e-15)
    np.testing.assert_allclose(back.momentum, state.momentum, atol=1e-14)


STAYING = ml.RigidState([1.0, 2, 3], [1.0, 0, 0, 0])
AXIS = ml.AxisState([1.0, 2, 3], [0.0, 0.6, 0.8])
FREE = ml.FreeState([1.0, 2, 3], [1.0, 0, 0, 0], [1.0, 0, 0], [0.0, 0, 1])
RIGID = ml.RigidBody([2.0, 2.0, 1.0])
FREE_AXIS = ml.FreeAxisState.of(FREE)
ROTOR, PULL = ml.SymmetricRotor(2.0), ml.torques.PointMass(3.0)
FREE_BODY, FREE_ROTOR = ml.FreeBody(RIGID, 3.0), ml.FreeBody(ROTOR, 3.0)
A_FORCE, A_TUPLE = (lambda t, s: T.Wrench(s.momentum, s.momentum)), (lambda t, s: (s.momentum, s.momentum))
ACROSS, CONTROL = T.DipoleInField([0.1, 0, 1], [0, 0, 1.0]), ml.spacecraft.PDControl([1.0, 0, 0, 0], 1.0, 1.0)


def go(name, body, torque, state):
    ml.integrate(name, body, torque, state, dt=0.1, steps=1)


test_what_does_not_fit_is_refused = refused(
    (lambda: go("JACOBI[EA]", RIGID, A_FORCE, STAYING), "got Wrench; a force moves a FreeState"),
    (lambda: go("JACOBI[EA]", RIGID, None, FREE), "belongs to a FreeBody"),
    (lambda: go("JACOBI[EA]", FREE_ROTOR, None, FREE), "belongs to a FreeBody of a RigidBody"),
    (lambda: go("SYMMETRIC[EA]", RIGID, None, AXIS), "belongs to a SymmetricRotor"),
    (lambda: go("AKW", FREE_BODY, None, FREE), "moves RigidBody, but body is FreeBody of a RigidBody"),
    (lambda: go("PGBS12", ROTOR, None, AXIS), "moves RigidBody, but body is SymmetricRotor"),
    (lambda: go("SYMMETRIC[EA]", ROTOR, ACROSS, AXIS), "holds only the third axis of the body"),
    (lambda: go("SYMMETRIC[EA]", ROTOR, CONTROL, AXIS), "needs the attitude"),
    (lambda: go("SYMMETRIC[EA]", FREE_ROTOR, PULL, FREE_AXIS), r"write SymmetricRotor\(moment, along\)"),
    (lambda: go("JACOBI[EA]", FREE_BODY, A_TUPLE, FREE), "must return a midlie_jax.torques.Wrench"),
    (lambda: ml.FreeBody([1.0, 2, 2], 3.0), r"FreeBody\(RigidBody\(moments\), mass\)"),
    (lambda: ml.FreeBody(RIGID, [1.0, 2.0]), "mass must be"),
    (lambda: ml.SymmetricRotor(1.0, 2.5), "must not exceed twice"),
    (lambda: ml.AxisState([0.0, 0, 0], [0.0, 0, 2.0]), "axis must be a unit vector"),
    (lambda: ml.FreeState([0.0, 0, 0], [1.0, 0, 0, 0], [0.0, 0], [0.0, 0, 0]), "linear must have shape"),
    (lambda: ml.observe.linear_momentum(STAYING), "does not translate"),
    (lambda: ml.observe.angular_velocity(ml.SymmetricRotor(2.0), AXIS), "of a SymmetricRotor is undefined"),
)


def test_a_sum_is_gravity_if_all_its_terms_are():
    weight, push = T.UniformGravity([0.0, 0.0, -9.81]), ml.spacecraft.Thrust([1.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    for torque, gravity in ((weight, True), (weight + PULL, True), (weight + push, False), (push + push, False)):
        for kind in (torque, T.OnEach(torque), T.OnEach(torque) + T.OnEach(torque)):
            assert kind.gravitational == gravity == (T.without_gravity(kind) is None)
    assert not (weight + (lambda t, state: state.momentum)).gravitational
    (rest,) = T.terms_of(T.without_gravity(T.OnEach(weight + push + (PULL + push)) + weight))
    assert isinstance(rest, T.OnEach)
    assert T.terms_of(rest.torque) == [push, push]
    pushes = T.OnEach(push)
    assert T.without_gravity(pushes) is pushes
    assert T.terms_of(sum([weight, PULL], start=weight)) == [weight, weight, PULL]
