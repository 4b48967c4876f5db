"""Laws of bodies that travel and of axes, over all flights, schemes and dtypes: what every method must keep of them."""

import re
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, benchmark, epsilon, loop_bodies, quick, real, whole
from travel_cases import (
    ALL,
    FEW,
    KINDS,
    LEVELS,
    LINEAR,
    MASS,
    STEPS,
    at,
    gap,
    integrate,
    moved_by,
    potential,
    roundings,
    run,
    stacked,
    start,
    truth,
)

import midlie_jax as ml
from midlie_jax.integrators.splitting import Splitting

CASES = [*FEW, *whole(*(case for case in ALL if case not in FEW))]
BY_TURNS = [(*case, DTYPES[n % 2]) for n, case in enumerate(FEW)]
BY_TURNS += whole(*((*case, dtype) for case in ALL for dtype in DTYPES if (*case, dtype) not in BY_TURNS))
DT = [*(1 / (16 << level) for level in range(LEVELS)), 0.0]


@cache
def paths(kind, name, dtype):
    return run(kind, name, stacked(*[start(kind, dtype)] * len(DT)), DT)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("kind", "name"), CASES)
def test_order(kind, name):
    order, found, exact = ml.method(name).order, paths(kind, name, "float64"), truth(kind, 1.0)
    assert np.all(found.ok)
    errors = [np.linalg.norm(at(found.states, level, 16 << level).minus(exact)) for level in range(LEVELS)]
    assert errors[0] < 0.5
    if order > 8:  # whose errors are those of rounding
        assert min(errors) < 1e-11
        return
    low, high = (-2, -1) if order <= 2 else (0, 1)
    slope = np.log2(errors[low] / errors[high])
    assert slope > order - 0.35 or errors[high] < 1e-12, (slope, errors)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name", "dtype"), BY_TURNS)
def test_symmetric_methods_come_back_and_a_step_of_no_length_changes_no_bit(kind, name, dtype):
    found = paths(kind, name, dtype)
    first = 1 if kind == "free tensor" else 0  # whose states are converted to principal axes and back
    for leaf in jax.tree.leaves(found.states):
        still = leaf[-1, first:]
        np.testing.assert_array_equal(still, np.broadcast_to(still[:1], still.shape))
    if not ml.method(name).symmetric:
        return
    dt = -np.array(DT)
    back = run(kind, name, jax.tree.map(lambda x: jnp.asarray(x[:, -1]), found.states), dt, np.full(len(dt), -STEPS))
    for level in (2, 3):
        missed = gap(at(back.states, level, -1), at(found.states, level, 0))
        assert missed <= 2 * roundings(name) * epsilon(dtype), missed / epsilon(dtype)


TRAVELLING = [(kind, name) for kind, name in ALL if kind != "axis"]
FEW_TRAVELLING = [case for case in FEW if case[0] != "axis"]
TURNS = [(*case, DTYPES[n % 2]) for n, case in enumerate(FEW_TRAVELLING)]
TURNS += whole(*((*case, dtype) for case in TRAVELLING for dtype in DTYPES if (*case, dtype) not in TURNS))


@pytest.mark.sample(1)
@pytest.mark.parametrize(("kind", "name", "dtype"), TURNS)
def test_a_point_mass_keeps_the_total_momentum(kind, name, dtype):
    """x cross p + R Pi, to rounding, by every splitting; the others keep it as well as they are accurate."""
    torque, state = ml.torques.PointMass(jnp.asarray(3.0, dtype)), start(kind, dtype)
    state = state.made(state.turning, state.linear, jnp.asarray([3.0, 1, -2], dtype))
    path = quick(lambda s: integrate(kind, name, s, jnp.asarray(1 / 32, dtype), torque=torque))(state)
    total = np.asarray(ml.observe.spatial_momentum(path.states), np.float64)
    limit = roundings(name) * epsilon(dtype) if isinstance(ml.method(name), Splitting) else 1e-3
    assert path.ok
    assert np.abs(total - total[0]).max() <= 4 * limit * np.linalg.norm(total[0])
    spin = path.states.turning.spatial_momentum()
    assert jnp.ptp(spin, axis=0).max() > 0.03  # the gravity gradient acts


@pytest.mark.sample(1)
@pytest.mark.parametrize(("kind", "name", "dtype"), TURNS)
def test_free_fall_is_exact_and_the_rotation_that_of_the_body_alone(kind, name, dtype):
    """In uniform gravity, at any step, by every method of order 2 and more."""
    gravity = jnp.asarray([0.3, -0.2, -9.81], dtype)
    state, dt = start(kind, dtype), jnp.asarray(1 / 32, dtype)
    path = quick(lambda s: integrate(kind, name, s, dt, torque=ml.torques.UniformGravity(gravity)))(state)
    t = np.asarray(path.times, np.float64)[:, None]
    linear = np.asarray(LINEAR) + MASS * t * np.asarray(gravity, np.float64)
    start_place, pull = np.asarray(state.position, np.float64), np.asarray(gravity, np.float64)
    position = start_place + t * np.asarray(LINEAR) / MASS + t**2 / 2 * pull
    limit = 2 * roundings(name) * epsilon(dtype)
    np.testing.assert_allclose(path.states.linear, linear, rtol=0, atol=limit * np.abs(linear).max())
    if ml.method(name).order > 1:
        np.testing.assert_allclose(path.states.position, position, rtol=0, atol=limit * np.abs(position).max())
    body = KINDS[kind].body(dtype).body
    alone = quick(lambda s: ml.integrate(name, body, None, s, dt=dt, steps=STEPS, save_every=1))(state.turning)
    assert gap(path.states.turning, alone.states) <= roundings(name) * epsilon(dtype)


UNCOUPLED = ["JACOBI[EA]", *whole(*(name for name in moved_by("free") if name != "JACOBI[EA]"))]


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", UNCOUPLED)
def test_without_coupling_the_rotation_is_that_of_a_rigid_state_bit_for_bit(name, dtype):
    """A plain torque counts as a wrench without a force; compiled as for users, for several bodies at once."""
    torque = ml.torques.HeavyTop(jnp.asarray(2.0, dtype), (0.48, 0.6, 0.64))
    state = stacked(*[start("free", dtype)] * 8)
    run = {"dt": jnp.asarray(1 / 32, dtype), "steps": 64, "save_every": 16}
    body = KINDS["free"].body(dtype)
    path = ml.ensemble(name, body, torque, state, torque_axes=None, **run)
    alone = ml.ensemble(name, body.body, torque, state.turning, torque_axes=None, **run)
    np.testing.assert_array_equal(path.states.momentum, alone.states.momentum)
    np.testing.assert_array_equal(path.states.attitude, alone.states.attitude)
    np.testing.assert_array_equal(path.states.linear, np.broadcast_to(state.linear[:, None], (8, 5, 3)))


AXES = [name for _, name in FEW if _ == "axis" and isinstance(ml.method(name), Splitting)]


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", AXES)
def test_an_axis_moves_as_that_of_a_rigid_body(name):
    """The flow is that of SYMMETRIC on a RigidState, whose laws are tested elsewhere, to rounding."""
    dt, top = jnp.asarray(1 / 32), ml.torques.HeavyTop(2.0)
    rigid, axis = start("free").turning, start("axis")
    body = ml.RigidBody(jnp.array([2.0, 2.0, 0.9]))
    of_rigid = quick(lambda s: ml.integrate(name, body, top, s, dt=dt, steps=STEPS, save_every=1))(rigid)
    of_axis = quick(lambda s: ml.integrate(name, ml.SymmetricRotor(2.0), top, s, dt=dt, steps=STEPS, save_every=1))(
        axis
    )
    assert gap(of_axis.states, ml.AxisState.of(of_rigid.states)) < 4 * roundings(name) * epsilon("float64")


DRIVEN = (
    ml.torques.Damping([0.3, 0.3, 0.1])
    + ml.spacecraft.MomentumWheels([0.0, 0.0, 0.8])
    + ml.spacecraft.ReactionWheels(lambda t: jnp.stack([0 * t, 0 * t, jnp.sin(t)]))
)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["SYMMETRIC[EA]", "GBS12"])
def test_torques_of_the_spin_act_on_an_axis_as_on_a_rigid_body(name):
    """They read the whole angular velocity, or hold vectors of the body: on an axis both must be put into space."""
    (rigid, body), (axis, rotor) = (
        (start("free").turning, ml.RigidBody(jnp.array([2.0, 2.0, 0.9]))),
        (start("axis"), ml.SymmetricRotor(jnp.asarray(2.0), jnp.asarray(0.9))),
    )
    of_rigid, of_axis = (
        quick(lambda s, b=b: ml.integrate(name, b, DRIVEN, s, dt=jnp.asarray(1 / 32), steps=STEPS, save_every=1))(s)
        for s, b in ((rigid, body), (axis, rotor))
    )
    assert gap(of_axis.states, ml.AxisState.of(of_rigid.states)) < 4 * roundings(name) * epsilon("float64")


@pytest.mark.parametrize(
    ("torque", "message"),
    [
        (ml.torques.Damping([0.3, 0.2, 0.1]), "coefficient is .* the first two must be equal"),
        (ml.torques.Damping(0.3), r"write SymmetricRotor\(moment, along\)"),
        (ml.spacecraft.MomentumWheels([0.1, 0.0, 1.0]), "holds only the third axis of the body"),
    ],
)
def test_what_an_axis_cannot_know_is_refused(torque, message):
    for state, body in (
        (start("axis"), ml.SymmetricRotor(2.0)),
        (start("free axis"), ml.FreeBody(ml.SymmetricRotor(2.0), MASS)),
    ):
        with pytest.raises(ValueError, match=message):
            ml.integrate("SYMMETRIC[EA]", body, torque, state, dt=0.1, steps=2)


def test_wheels_across_an_axis_make_a_run_fail():
    wheels = ml.spacecraft.ReactionWheels(lambda t: jnp.stack([t, 0 * t, 0 * t]))
    assert not ml.integrate("SYMMETRIC[EA]", ml.SymmetricRotor(2.0), wheels, start("axis"), dt=0.1, steps=2).ok


SYMPLECTIC = [name for name in moved_by("free") if isinstance(ml.method(name), Splitting)]
FEW_SYMPLECTIC = ["JACOBI[EA]", "LIEMID[EA]", "SLIEMID[EA]", "DLM[EA]", "JACOBI[CHIN4A]", "JACOBI[SRKN6b]"]


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", [*FEW_SYMPLECTIC, *whole(*(n for n in SYMPLECTIC if n not in FEW_SYMPLECTIC))])
def test_the_defect_on_the_phase_space_of_twelve_dimensions(name):
    """M^T W1 M = W0 to rounding where the flight is symplectic; LIEMID misses it, as on a body that stays."""
    canonical = benchmark("claims").canonical
    state, h = start("free"), jnp.asarray(0.1)

    def end(increment):
        return integrate("free", name, state.plus(increment), h, steps=1).states

    def form(momentum):
        """For directions (change of Pi, turn, change of p, of x)."""
        turn_first, two = canonical(momentum), np.zeros((12, 12))
        order = [3, 4, 5, 0, 1, 2]
        two[:6, :6] = turn_first[np.ix_(order, order)]
        two[9:, 6:9], two[6:9, 9:] = np.eye(3), -np.eye(3)
        return two

    after = jax.tree.map(lambda x: x[-1], quick(end)(jnp.zeros(12)))
    change = quick(jax.jacfwd(lambda x: jax.tree.map(lambda y: y[-1], end(x)).minus(after)))(jnp.zeros(12))
    matrix = np.asarray(change)
    defect = np.abs(matrix.T @ form(after.momentum) @ matrix - form(state.momentum)).max()
    assert (defect < 1e-13) == ml.method(name).symplectic, defect
    assert defect < 1e-2


@pytest.mark.sample(1)
@pytest.mark.parametrize(("kind", "name"), CASES)
def test_energy_wavers_as_the_order_says(kind, name):
    """Of a splitting, with the potential that couples place and axis."""
    method = ml.method(name)
    if not isinstance(method, Splitting) or method.order == 1:
        pytest.skip("for splittings of order 2 and more")
    found, torque = paths(kind, name, "float64"), ml.torques.FromPotential(partial(potential, 2.0))
    body = KINDS[kind].body("float64")
    energies = [np.asarray(ml.observe.energy(body, torque, at(found.states, k))) for k in (0, 1)]
    coarse, fine = (np.abs(e[: 32 << k] - e[0]).max() for k, e in enumerate(energies))
    assert coarse / fine > 2 ** (method.order - 0.7) or fine < 1e-12


BATCH = 517


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("kind", "name", "torque", "expected"),
    [
        ("free", "JACOBI[EA]", ml.torques.UniformGravity([0, 0, -9.81]), 1),
        ("axis", "SYMMETRIC[EA]", ml.torques.HeavyTop(2.0), 1),
        # The torque is so long that it has a loop of its own beside the flight's.
        ("free", "JACOBI[EA]", ml.torques.PointMass(3.0), 2),
        ("free axis", "SYMMETRIC[EA]", ml.torques.PointMass(3.0), 2),
        ("free", "JACOBI[EA]", None, 2),
        ("axis", "SYMMETRIC[EA]", None, 1),
        ("axis", "SYMMETRIC[SRKN6b]", ml.torques.HeavyTop(2.0), 1),
        ("free", "RK4", ml.torques.UniformGravity([0, 0, -9.81]), 1),
    ],
)
def test_a_step_is_one_loop_or_two(kind, name, torque, expected):
    """Without a torque given, that of the potential that couples place and axis."""
    one = partial(integrate, kind, name, dt=0.01, torque=torque, steps=8, save_every=8)
    text = real(jax.vmap(one)).lower(stacked(*[start(kind)] * BATCH)).compile().as_text()
    loops = max(len(re.findall(rf"\[{BATCH}\].* fusion\(", body)) for body in loop_bodies(text))
    assert loops == expected * ml.method(name).unroll
