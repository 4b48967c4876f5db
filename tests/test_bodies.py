"""Bodies in frames of their own, what is read off a motion, and what every kind of state has beside it."""

import dataclasses
import inspect
from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import epsilon, real, whole
from path_scenes import STATES

import midlie_jax as ml
from midlie_jax.model import so3

RNG = np.random.default_rng(7)
MOMENTS = np.array([1.0, 1.8, 2.3])
AXES = so3.exp(jnp.array([0.4, -1.1, 0.7]))  # principal components to those of the frame of the tensor
TURN = so3.to_matrix(AXES)
TENSOR = TURN @ jnp.diag(jnp.asarray(MOMENTS)) @ TURN.T
BODY = ml.TensorBody(TENSOR)
START = ml.RigidState(jnp.array([0.3, -0.8, 0.5]), so3.exp(jnp.array([0.2, 0.9, -0.4])))
TOP = ml.torques.HeavyTop(1.3, (0.48, 0.6, 0.64))


def tipped(t, state):
    return jnp.sin(t) * jnp.sum(so3.to_matrix(state.attitude)[2] * jnp.array([0.3, 0.5, -0.2]))


TORQUES = {
    "none": None,
    "top": TOP,
    "of the momentum and the body": TOP + ml.torques.BodyTorque(lambda t, s, body: -0.2 * body.velocity(s.momentum)),
    "from a potential": ml.torques.FromPotential(tipped),
}


def in_principal(torque, start):
    """Torque and start seen from the principal frame, by matrices: what `TensorBody` saves its user."""
    axes = so3.from_matrix(jnp.linalg.eigh(TENSOR)[1] * jnp.linalg.det(jnp.linalg.eigh(TENSOR)[1]))
    turn = so3.to_matrix(axes)

    def seen(t, state):
        own = ml.RigidState(turn @ state.momentum, so3.multiply(state.attitude, so3.conjugate(axes)))
        field = torque.on(BODY) if isinstance(torque, ml.torques.Torque) else torque
        return turn.T @ field(t, own)

    moved = ml.RigidState(turn.T @ start.momentum, so3.multiply(start.attitude, axes))
    return turn, (None if torque is None else seen), moved


def same(one, other, slack=2e-14):
    """Whether two states are, up to the sign of a quaternion and to rounding."""
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        sign = jnp.sign(jnp.sum(x * y, axis=-1, keepdims=True)) if x.shape[-1] == 4 else 1
        np.testing.assert_allclose(x, jnp.where(sign == 0, 1, sign) * y, rtol=0, atol=slack)


FRAMES = [("JACOBI[EA]", "of the momentum and the body"), ("DOP853", "from a potential")]


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("method", "name"), [*FRAMES, *whole(*((m, name) for m in ("JACOBI[EA]", "AKW") for name in TORQUES))]
)
def test_a_body_keeps_the_frame_of_its_tensor(method, name):
    torque = TORQUES[name]
    path = ml.integrate(method, BODY, torque, START, dt=0.05, steps=20, save_every=10)
    turn, seen, moved = in_principal(torque, START)
    body, _ = ml.RigidBody.from_tensor(TENSOR)
    other = ml.integrate(method, body, seen, moved, dt=0.05, steps=20, save_every=10)
    assert path.ok
    back = jax.vmap(lambda p, q: ml.RigidState(turn @ p, so3.multiply(q, so3.conjugate(so3.from_matrix(turn)))))
    same(path.states, back(other.states.momentum, other.states.attitude))


def test_tensor_velocity_and_momentum_are_those_of_the_matrix():
    np.testing.assert_allclose(BODY.tensor, TENSOR, atol=1e-14)
    momentum = jnp.asarray(RNG.normal(size=(5, 3)))
    velocity = BODY.velocity(momentum)
    np.testing.assert_allclose(velocity, np.linalg.solve(np.asarray(TENSOR), momentum.T).T, atol=1e-13)
    np.testing.assert_allclose(BODY.momentum(velocity), momentum, atol=1e-13)
    np.testing.assert_allclose(BODY.trace, np.trace(TENSOR), atol=1e-13)


@pytest.mark.sample(0)
def test_tensors_of_many_bodies():
    turns = so3.to_matrix(so3.exp(jnp.asarray(RNG.normal(size=(4, 3)))))
    tensors = turns @ jnp.diag(jnp.asarray(MOMENTS)) @ jnp.swapaxes(turns, -1, -2)
    body, axes = ml.RigidBody.from_tensor(tensors)
    np.testing.assert_allclose(np.linalg.det(axes), 1)
    np.testing.assert_allclose((axes * body.moments[:, None]) @ jnp.swapaxes(axes, 1, 2), tensors, atol=1e-13)
    starts = jax.tree.map(lambda x: jnp.tile(x, (4, 1)), START)
    path = ml.ensemble("JACOBI[EA]", ml.TensorBody(tensors), TOP, starts, dt=0.05, steps=10, chunk=2)
    assert path.ok.all()
    solo = ml.integrate("JACOBI[EA]", ml.TensorBody(tensors[2]), TOP, START, dt=0.05, steps=10, save_every=10)
    same(jax.tree.map(lambda x: x[2], path.states), jax.tree.map(lambda x: x[-1], solo.states))


@pytest.mark.sample(0)
def test_other_states_and_drivers_know_the_frame():
    run = {"dt": 0.02, "steps": 20, "save_every": None}
    end = ml.integrate("JACOBI[EA]", BODY, TOP, START, **run).states
    seen = {"density": lambda t, state: 1 + 0.1 * state.momentum[0] ** 2, "dt": 0.05, "steps": 8}
    principal = ml.TensorBody(jnp.diag(jnp.asarray(MOMENTS)))
    own, other = (ml.integrate_variable_step("LIEMID[EA*]", body, None, START, **seen) for body in (BODY, principal))
    assert own.times[-1] != other.times[-1]  # the density saw another momentum
    term = ml.diffrax.RigidBodyTerm(BODY, TOP)
    options = {"y0": START, "saveat": diffrax.SaveAt(t1=True), "adjoint": diffrax.ForwardMode()}
    for solver, slack in ((ml.diffrax.LieSolver("JACOBI[EA]"), 1e-12), (diffrax.Dopri8(), 1e-3)):
        found = diffrax.diffeqsolve(term, solver, 0.0, 0.4, 0.02, **options).ys
        same(jax.tree.map(lambda x: x[-1], found), end, slack)


# ---- what is read off a motion ----


def test_angular_velocities():
    """The attitude turns by them: R' = R skew(Omega) = skew(omega) R, by differences of the closed flight."""
    body, h = ml.RigidBody(MOMENTS), 1e-4
    own, space = ml.observe.angular_velocity(body, START), ml.observe.spatial_angular_velocity(body, START)
    np.testing.assert_allclose(own, START.momentum / MOMENTS, rtol=4 * epsilon("float64"))
    ends = ml.free_motion(body, START, jnp.array([h, -h])).states.attitude
    turned = so3.log(so3.multiply(ends[0], so3.conjugate(ends[1]))) / (2 * h)
    np.testing.assert_allclose(turned, space, atol=1e-8)
    many = jax.tree.map(lambda x: jnp.tile(x.astype("float32"), (2, 4, 1)), START)
    for velocity in (ml.observe.angular_velocity, ml.observe.spatial_angular_velocity):
        found = velocity(ml.RigidBody(jnp.asarray(MOMENTS, "float32")), many)
        assert (found.shape, found.dtype) == ((2, 4, 3), "float32")
    with pytest.raises(ValueError, match="needs the attitude"):
        inspect.unwrap(ml.observe.spatial_angular_velocity)(body, ml.MomentumState(START.momentum))


@pytest.mark.sample(0)
def test_energy_asks_for_the_time_that_it_depends_on():
    """On an eccentric orbit; a path brings its own times, and a state must be given one."""
    orbit = ml.orbits.KeplerOrbit([1.0, 0.0, 0.0], [0.0, 0.7**0.5, 0.0], 1.0)
    body, torque = ml.RigidBody(MOMENTS), ml.spacecraft.GravityGradient(None, orbit, 1.0)
    path = ml.integrate("JACOBI[EA]", body, torque, START, dt=0.05, steps=40, save_every=10)
    energy = real(partial(ml.observe.energy, body, torque))
    curve = energy(path)
    each = [energy(jax.tree.map(lambda x, i=i: x[i], path.states), path.times[i]) for i in range(5)]
    rounding = 4 * epsilon("float64") * float(jnp.max(ml.observe.kinetic_energy(body, path.states)))
    np.testing.assert_allclose(curve, each, rtol=0, atol=rounding)
    np.testing.assert_allclose(energy(path.states, path.times), each, rtol=0, atol=rounding)
    assert np.ptp(np.asarray(curve) - ml.observe.energy(body, torque, path.states, 0.0)) > 1e-3
    for motion in (path.states, START):
        with pytest.raises(ValueError, match="depends on time: give t"):
            ml.observe.energy(body, torque, motion)
    with pytest.raises(ValueError, match="a path has its own times"):
        ml.observe.energy(body, torque, path, 0.0)
    with pytest.raises(ValueError, match="motion must be a state or a path, got an array"):
        inspect.unwrap(ml.observe.energy)(body, torque, jnp.ones(3))
    with pytest.raises(ValueError, match="one body"):
        ml.observe.energy(ml.RigidBody(jnp.ones((5, 3))), None, START)
    with pytest.raises(ValueError, match=r"Map other axes with jax\.vmap"):
        ml.observe.energy(ml.RigidBody(jnp.ones((4, 3))), None, path)


@pytest.mark.sample(0)
def test_of_many_bodies_with_many_states_each_is_that_of_each_state():
    """Moments and weights have one row for each body, and there are as many saved states as bodies."""
    moments, weights = jnp.asarray(MOMENTS)[None] * jnp.array([[1.0], [1.1], [1.2]]), jnp.array([1.0, 2.0, 3.0])
    bodies = ml.TensorBody(jax.vmap(jnp.diag)(moments))
    torque = ml.torques.HeavyTop(weights, (0.0, 0.6, 0.8))
    starts = jax.tree.map(lambda x: jnp.tile(x, (3, 1)), START)
    path = ml.ensemble("JACOBI[EA]", bodies, torque, starts, dt=0.05, steps=4, save_every=2)
    assert path.states.momentum.shape == (3, 3, 3)

    def each(function):
        def of_one(n, k):
            body = jax.tree.map(lambda x: x[n], bodies)
            return function(body, weights[n], jax.tree.map(lambda x: x[n, k], path.states))

        return np.array([[of_one(n, k) for k in range(3)] for n in range(3)])

    expected = each(lambda b, weight, state: ml.observe.energy(b, ml.torques.HeavyTop(weight, (0.0, 0.6, 0.8)), state))
    for motion, wanted in ((path, expected), (jax.tree.map(lambda x: x[:, -1], path.states), expected[:, -1])):
        for axes in ("auto", 0):
            found = ml.observe.energy(bodies, torque, motion, torque_axes=axes)
            np.testing.assert_allclose(found, wanted, rtol=1e-13)
    for function in (ml.observe.kinetic_energy, ml.observe.angular_velocity, ml.observe.spatial_angular_velocity):
        wanted = each(lambda body, _, state, f=function: f(body, state))
        np.testing.assert_allclose(function(bodies, path.states), wanted, rtol=1e-13, atol=1e-15)


def test_energies_of_large_numbers_do_not_overflow():
    body, state = ml.RigidBody(jnp.full(3, 1e25, jnp.float32)), ml.MomentumState(jnp.full(3, 1e25, jnp.float32))
    assert ml.observe.kinetic_energy(body, state) == pytest.approx(1.5e25, rel=1e-6)


def test_quaternions_of_other_programs():
    from scipy.spatial.transform import Rotation, Slerp

    ours = so3.exp(jnp.asarray(RNG.normal(size=(6, 3))))
    theirs = so3.to_scipy(ours)
    np.testing.assert_allclose(theirs.as_matrix(), so3.to_matrix(ours), atol=1e-15)
    np.testing.assert_array_equal(so3.from_xyzw(so3.to_xyzw(ours)), ours)
    np.testing.assert_allclose(Rotation.from_quat(so3.to_xyzw(ours)).as_matrix(), so3.to_matrix(ours), atol=1e-15)
    shares = np.linspace(0, 1, 5)
    between = jax.vmap(lambda s: so3.slerp(ours[0], -ours[1], s))(jnp.asarray(shares))  # the sign does not matter
    exact = Slerp([0, 1], theirs[:2])(shares).as_matrix()
    np.testing.assert_allclose(so3.to_matrix(between), exact, atol=1e-14)
    assert so3.slerp(ours, ours[::-1], 0.5).shape == (6, 4)


# ---- increments of states, states from velocities, joined bodies ----


def some(kind, *batch):
    def unit(size):
        values = RNG.normal(size=(*batch, size))
        return jnp.asarray(values / np.linalg.norm(values, axis=-1, keepdims=True))

    momentum = jnp.asarray(RNG.normal(size=(*batch, 3)))
    pose = {ml.MomentumState: (), ml.DirectionState: (unit(3),), ml.ParticleState: (momentum[::-1],)}
    return kind(momentum, *pose.get(kind, (unit(4),)))


KINDS = [ml.MomentumState, ml.DirectionState, ml.RigidState, ml.CompensatedState]


@pytest.mark.parametrize(
    ("kind", "batch"), [*zip([*KINDS, ml.ParticleState], [(), (6,), (2, 3), (), (2,)], strict=True)]
)
def test_an_increment_leads_from_one_state_to_the_other(kind, batch):
    one, other = some(kind, *batch), some(kind, *batch)
    same(other.plus(one.minus(other)), one)
    increment = jnp.asarray(RNG.normal(size=one.minus(other).shape)) * 0.9
    np.testing.assert_allclose(one.plus(increment).minus(one), increment, atol=1e-13)
    same(one.plus(jnp.zeros_like(increment)), one)


@pytest.mark.parametrize("kind", KINDS)
def test_the_size_of_a_small_difference_is_that_of_the_increment(kind):
    """Of a quaternion twice its change; in radians."""
    one = some(kind)
    increment = jnp.asarray(RNG.normal(size=one.minus(one).shape)) * 1e-6
    difference = jax.tree.map(jnp.subtract, one.plus(increment), one)
    momentum, angle = difference.kind.sizes(difference)
    assert momentum == pytest.approx(float(jnp.linalg.norm(increment[:3])), rel=1e-4)
    assert angle == pytest.approx(float(jnp.linalg.norm(increment[3:])), rel=1e-4)


@pytest.mark.parametrize("state", [name for name, (body, _) in STATES.items() if not isinstance(body, ml.spins.Spins)])
def test_a_state_from_velocities_has_these_velocities(state):
    body, start = STATES[state]
    first, *others = (getattr(start, field.name) for field in dataclasses.fields(start))
    if isinstance(start, ml.AxisState | ml.FreeAxisState):
        first = first - jnp.sum(first * start.axis, axis=-1, keepdims=True) * start.axis
    velocity = body.turning.velocity(first)
    if start.kind.rotation is not None:
        others[1] = others[1] / jnp.asarray(body.mass)[..., None]
    made = type(start).from_velocity(body, velocity, *others)
    expected = [first, *(getattr(start, field.name) for field in dataclasses.fields(start)[1:])]
    for field, value in zip(dataclasses.fields(start), expected, strict=True):
        np.testing.assert_allclose(getattr(made, field.name), value, rtol=1e-13, atol=1e-13)


def test_a_spin_needs_its_moment():
    axis, velocity = [0.0, 0.6, 0.8], jnp.array([0.3, -0.2, 1.5])
    with pytest.raises(ValueError, match="velocity has a part along the axis"):
        ml.AxisState.from_velocity(ml.SymmetricRotor(2.0), velocity, axis)
    made = ml.AxisState.from_velocity(ml.SymmetricRotor(2.0, 0.5), velocity, axis)
    along = jnp.sum(velocity * jnp.array(axis)) * jnp.array(axis)
    np.testing.assert_allclose(made.momentum, 2.0 * (velocity - along) + 0.5 * along, rtol=1e-14)
    with pytest.raises(ValueError, match="body must be a SymmetricRotor"):
        ml.AxisState.from_velocity(ml.RigidBody([2.0, 2.0, 0.5]), velocity, axis)
    with pytest.raises(ValueError, match="body must be"):
        ml.spins.SpinState.from_velocity(ml.RigidBody([1.0, 2.0, 2.5]), jnp.ones(3))


def test_joined_bodies_are_the_body_of_all_their_points():
    """Bodies made of point masses, joined in any position and attitude: the same as all points at once."""
    rng = np.random.default_rng(3)
    parts, masses, places = [], [], []
    for _ in range(3):
        mass, points = rng.uniform(1, 2, 5), rng.normal(size=(5, 3))
        points -= mass @ points / mass.sum()
        tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, points, strict=True))
        attitude, position = ml.so3.exp(jnp.asarray(rng.normal(size=3))), rng.normal(size=3)
        parts.append((ml.TensorBody(tensor), mass.sum(), position, attitude))
        masses.append(mass)
        places.append(points @ np.asarray(ml.so3.to_matrix(attitude)).T + position)
    parts.append((None, 1.7, [0.3, -1.0, 2.0]))
    mass, points = np.append(np.concatenate(masses), 1.7), np.concatenate([*places, [[0.3, -1.0, 2.0]]])
    body, centre = ml.FreeBody.joined(parts)
    assert isinstance(body.body, ml.TensorBody)
    np.testing.assert_allclose(centre, mass @ points / mass.sum(), rtol=1e-12)
    points = points - np.asarray(centre)
    tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, points, strict=True))
    np.testing.assert_allclose(body.body.tensor, tensor, rtol=1e-12, atol=1e-12)
    with pytest.raises(ValueError, match=r"parts\[0\] must begin with"):
        ml.FreeBody.joined([(ml.SymmetricRotor(1.0), 1.0, [0.0, 0.0, 0.0])])
    for wrong in ([], [(None, 1.0)]):
        with pytest.raises(ValueError, match="parts must be one or more"):
            ml.FreeBody.joined(wrong)
