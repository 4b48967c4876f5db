"""The forces of the package on bodies that travel, and axes: closed forms, limits, wrenches of potentials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, turn, whole

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
    one = ml.torques.Wrench(jnp.ones(3), jnp.arange(3.0))
    for total in (one + one, one + ml.torques.Wrench(np.ones(3), np.arange(3.0))):
        np.testing.assert_array_equal(total.torque, 2 * np.ones(3))
        np.testing.assert_array_equal(total.force, 2 * np.arange(3.0))
    for total in (
        one + np.ones(3),
        np.ones(3) + one,
        jnp.ones(3) + one,
        T.Sum(lambda t, s: one, lambda t, s: jnp.ones(3))(0, 0),
    ):
        np.testing.assert_array_equal(total.torque, 2 * np.ones(3))
        np.testing.assert_array_equal(total.force, np.arange(3.0))


@pytest.mark.sample(0)
@pytest.mark.parametrize("spin", [4.0, *whole(0.0, -7.0)])
def test_the_axis_of_a_heavy_top_is_lagranges_to_1e12(spin):
    moments, weight, times = [2.0, 2.0, 0.9], 3.0, np.array([0.0, 0.4, 0.8])
    momentum, attitude = np.array([0.6, -0.4, spin]), turn(0.7, 0.2, -0.3)
    begin = ml.AxisState.of(ml.RigidState(momentum, attitude))
    run = {"dt": 1 / 320, "steps": 256, "save_every": 128}
    path = quick(lambda s: ml.integrate("SYMMETRIC[SRKN14a]", ml.SymmetricRotor(2.0), T.HeavyTop(weight), s, **run))(
        begin
    )
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
    moved = state.plus(jnp.asarray(np.tile([0.1, 0.2, -0.3, 0.4, -0.2], (5, 1))))
    np.testing.assert_allclose(moved.minus(state), np.tile([0.1, 0.2, -0.3, 0.4, -0.2], (5, 1)), atol=1e-14)


STAYING = ml.RigidState([1.0, 2, 3], [1.0, 0, 0, 0])
AXIS = ml.AxisState([1.0, 2, 3], [0.0, 0.6, 0.8])
FREE = ml.FreeState([1.0, 2, 3], [1.0, 0, 0, 0], [1.0, 0, 0], [0.0, 0, 1])
RIGID = ml.RigidBody([2.0, 2.0, 1.0])
FREE_AXIS = ml.FreeAxisState.of(FREE)
FREE_BODY, FREE_ROTOR = ml.FreeBody(RIGID, 3.0), ml.FreeBody(ml.SymmetricRotor(2.0), 3.0)
ACROSS, CONTROL = T.DipoleInField([0.1, 0, 1], [0, 0, 1.0]), ml.spacecraft.PDControl([1.0, 0, 0, 0], 1.0, 1.0)


def a_force(t, state):
    return ml.torques.Wrench(state.momentum, state.momentum)


def a_tuple(t, state):
    return state.momentum, state.momentum


REFUSED = {
    "a force on a body that stays": ("JACOBI[EA]", RIGID, a_force, STAYING, "got Wrench; a force moves a FreeState"),
    "no mass": ("JACOBI[EA]", RIGID, None, FREE, "belongs to a FreeBody"),
    "no attitude": ("JACOBI[EA]", FREE_ROTOR, None, FREE, "belongs to a FreeBody of a RigidBody"),
    "an axis of a rigid body": ("SYMMETRIC[EA]", RIGID, None, AXIS, "belongs to a SymmetricRotor"),
    "AKW": ("AKW", FREE_BODY, None, FREE, "moves RigidBody, but body is FreeBody of a RigidBody"),
    "PGBS12": ("PGBS12", ml.SymmetricRotor(2.0), None, AXIS, "moves RigidBody, but body is SymmetricRotor"),
    "a dipole across": ("SYMMETRIC[EA]", ml.SymmetricRotor(2.0), ACROSS, AXIS, "holds only the third axis of the body"),
    "the whole attitude": ("SYMMETRIC[EA]", ml.SymmetricRotor(2.0), CONTROL, AXIS, "needs the attitude"),
    "the moment along": (
        "SYMMETRIC[EA]",
        FREE_ROTOR,
        T.PointMass(1.0),
        FREE_AXIS,
        r"write SymmetricRotor\(moment, along\)",
    ),
    "a tuple": ("JACOBI[EA]", FREE_BODY, a_tuple, FREE, "must return a midlie_jax.torques.Wrench"),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_what_does_not_fit_is_refused_before_tracing(case):
    name, body, torque, state, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        ml.integrate(name, body, torque, state, dt=0.1, steps=1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ml.FreeBody([1.0, 2, 2], 3.0), r"FreeBody\(RigidBody\(moments\), mass\)"),
        (lambda: ml.FreeBody(RIGID, [1.0, 2.0]), "mass must be"),
        (lambda: ml.SymmetricRotor(1.0, 2.5), "must not exceed twice"),
        (lambda: ml.AxisState([0.0, 0, 0], [0.0, 0, 2.0]), "axis must be a unit vector"),
        (lambda: ml.FreeState([0.0, 0, 0], [1.0, 0, 0, 0], [0.0, 0], [0.0, 0, 0]), "linear must have shape"),
        (lambda: ml.observe.linear_momentum(STAYING), "does not translate"),
        (lambda: ml.observe.angular_velocity(ml.SymmetricRotor(2.0), AXIS), "of a SymmetricRotor is undefined"),
    ],
)
def test_constructors_name_what_is_wrong(make, message):
    with pytest.raises(ValueError, match=message):
        make()


WEIGHT, PULL = ml.torques.UniformGravity([0.0, 0.0, -9.81]), ml.torques.PointMass(3.0)
PUSH = ml.spacecraft.Thrust([1.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def test_a_sum_is_gravity_if_all_its_terms_are():
    """Also a sum on each of several bodies; and what is left without gravity is the rest of it."""
    each, rest_of = ml.torques.OnEach, ml.torques.without_gravity
    for torque, gravity in ((WEIGHT, True), (WEIGHT + PULL, True), (WEIGHT + PUSH, False), (PUSH + PUSH, False)):
        assert torque.gravitational == each(torque).gravitational == (each(torque) + each(torque)).gravitational
        assert torque.gravitational == gravity
        assert (rest_of(torque) is None) == (rest_of(each(torque)) is None) == gravity
    assert not (WEIGHT + (lambda t, state: state.momentum)).gravitational
    mixed = each(WEIGHT + PUSH + (PULL + PUSH))
    rest = rest_of(mixed + WEIGHT)
    assert [type(term) for term in ml.torques.terms_of(rest)] == [ml.torques.OnEach]
    assert ml.torques.terms_of(rest.terms[0].torque) == [PUSH, PUSH]
    assert rest_of(each(PUSH + PUSH)).torque.terms == (PUSH, PUSH)
    pushes = each(PUSH)
    assert rest_of(pushes) is pushes
    assert ml.torques.terms_of(sum([WEIGHT, PULL], start=WEIGHT)) == [WEIGHT, WEIGHT, PULL]
