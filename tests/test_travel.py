"""Laws of bodies that translate, of axes and of coupled bodies, over all flights, schemes and dtypes."""

import re
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    CLASSES,
    DTYPES,
    METHODS,
    benchmark,
    epsilon,
    equal_moments,
    loop_bodies,
    quick,
    real,
    refused,
    turn,
    whole,
)
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax.integrators import schemes
from midlie_jax.integrators.splitting import Splitting
from midlie_jax.model.states import Coupled

STEPS, LEVELS = 64, 4
DT = [1 / (16 << level) for level in range(LEVELS)]
WEIGHT, SPRING, COUPLING = 0.9, 1.5, 0.4
TENSOR = np.array([[2.0, 0.1, 0.05], [0.1, 1.7, -0.2], [0.05, -0.2, 2.4]])
MASS, LINEAR = 3.0, (1.5, -0.6, 0.9)
ONE = (1.0, 0.8, -1.3), turn(0.5, -0.3, 0.8), LINEAR, (0.8, 0.5, -0.4)


class Kind(NamedTuple):
    """A kind of body and state. Two bodies are moved number by number, five with their function compiled apart."""

    state: Any
    inertia: np.ndarray  # (3, 3), or (N, 3, 3) of N bodies
    mass: Any  # () or (N,); None if they do not translate

    @property
    def count(self) -> int:
        return len(np.atleast_3d(self.inertia)) if self.inertia.ndim == 3 else 1

    @property
    def axes(self) -> bool:
        return issubclass(self.state, ml.AxisState | ml.FreeAxisState)

    def body(self, dtype: Any = "float64") -> Any:
        moments = jnp.asarray(np.diagonal(self.inertia, axis1=-2, axis2=-1), dtype)
        if self.axes:
            turning: Any = ml.SymmetricRotor(moments[..., 0], moments[..., 2])
        else:
            turning = ml.TensorBody(jnp.asarray(TENSOR, dtype)) if self.inertia is TENSOR else ml.RigidBody(moments)
        return turning if self.mass is None else ml.FreeBody(turning, jnp.asarray(self.mass, dtype))

    def of(self, momentum: Any, attitude: Any, linear: Any, position: Any) -> Any:
        """The state of this kind, from the numbers of bodies that rotate and translate."""
        if self.axes:
            axis = ml.AxisState.of(ml.RigidState(momentum, attitude))
            momentum, attitude = axis.momentum, axis.axis
        return self.state(momentum, attitude, *(() if self.mass is None else (linear, position)))


def several(state, count, axes=False, travels=True):
    moments = np.random.default_rng(1).uniform(1.0, 1.6, (count, 3))
    moments = moments[:, [0, 0, 2]] if axes else moments
    mass = np.random.default_rng(2).uniform(1.0, 2.0, count) if travels else None
    return Kind(state, moments[:, None] * np.eye(3), mass)


SYMMETRIC = np.diag([2.0, 2.0, 0.9])
SINGLE = {
    "free": Kind(ml.FreeState, np.diag([1.0, 2.0, 2.5]), MASS),
    "free tensor": Kind(ml.FreeState, TENSOR, MASS),
    "axis": Kind(ml.AxisState, SYMMETRIC, None),
    "free axis": Kind(ml.FreeAxisState, SYMMETRIC, MASS),
}
COUPLED = {
    "two": several(ml.CoupledState, 2),
    "five": several(ml.CoupledState, 5),
    "two rigid": several(ml.CoupledRigidState, 2, travels=False),
    "five rigid": several(ml.CoupledRigidState, 5, travels=False),
    "two axes": several(ml.CoupledFreeAxisState, 2, axes=True),
    "five axes": several(ml.CoupledAxisState, 5, axes=True, travels=False),
}
KINDS = SINGLE | COUPLED


def moved_by(kind):
    body, symmetric = KINDS[kind].body().in_principal_axes(), KINDS[kind].axes
    movers = [m for m in METHODS if m.moves(body) and (m.several or kind in SINGLE)]
    return [m.name for m in movers if symmetric or not equal_moments(m)]


# Every kind with a fast method, and one method of each class; the others in the whole matrix.
FEW = [("free", name) for name in moved_by("free") if name in (*CLASSES, "JACOBI[SRKN14a]", "JACOBI[CHIN4A]")]
FEW += [("axis", "SYMMETRIC[EA]"), ("axis", "GBS12"), ("free axis", "SYMMETRIC[EA]"), ("free tensor", "JACOBI[EA]")]
FEW += [("two", "JACOBI[EA]"), ("five", "JACOBI[SRKN6b]"), ("five", "JACOBI[CHIN4A]"), ("two rigid", "JACOBI[EA]")]
FEW += [("five axes", "SYMMETRIC[EA]"), ("two axes", "SYMMETRIC[SRKN6b]"), ("five rigid", "LIEMID[EA]")]
ALL = [(kind, name) for kind in KINDS for name in moved_by(kind)]


def numbers_of(kind):
    if kind in SINGLE:
        return [np.array(x) for x in ONE]
    count = KINDS[kind].count
    rng = np.random.default_rng(count)
    attitude = Rotation.random(count, rng).as_quat(scalar_first=True)
    momentum, linear, position = rng.normal(size=(3, count, 3))
    return [momentum, attitude, 0.5 * linear, position]


def start(kind, dtype="float64"):
    return KINDS[kind].of(*(jnp.asarray(x, dtype) for x in numbers_of(kind)))


def potential(weight, t, state):
    """For one body gravity on its axis, a spring, and a field that couples position and axis."""
    e = state.axis if hasattr(state, "axis") else ml.so3.to_matrix(state.attitude)[..., 2]
    travels = state.kind.rotation is not None
    if e.ndim == 1:
        field = SPRING / 2 * jnp.sum(state.position**2) + COUPLING * (e @ state.position) * e[0] if travels else 0
        return weight * e[2] + field
    value = 0.5 * weight * jnp.sum(jnp.sum(e, 0) ** 2)
    if not travels:
        return value
    d = state.position[:, None] - state.position[None]
    along = jnp.sum(e[:, None] * d, -1)
    return value + SPRING / 4 * jnp.sum(d * d) - COUPLING / 2 * jnp.sum(along * along.T)


def by_hand(e, x, travels):
    """Its slopes with the axes (N, 3), and the forces."""
    n = len(e)
    slope, force = np.tile(WEIGHT * (e.sum(0) if n > 1 else np.array([0, 0, 1.0])), (n, 1)), np.zeros((n, 3))
    if not travels:
        return slope, force
    if n == 1:
        slope += COUPLING * (e[0, 0] * x + np.array([[e[0] @ x[0], 0, 0]]))
        return slope, -SPRING * x - COUPLING * e[0, 0] * e
    for i in range(n):
        for j in range(n):
            if i != j:  # of the pair, the part that moves i
                d = x[j] - x[i]
                force[i] += SPRING * d + COUPLING * ((e[j] @ d) * e[i] + (e[i] @ d) * e[j])
                slope[i] += COUPLING * (e[j] @ d) * d
    return slope, force


def forced(weight=WEIGHT):
    return ml.torques.FromPotential(jax.tree_util.Partial(potential, jnp.asarray(weight)))


def integrate(kind, name, state, dt, first=0, torque=None, steps=STEPS, save_every=1):
    dtype = state.momentum.dtype
    torque = forced(jnp.asarray(WEIGHT, dtype)) if torque is None else torque
    run = {"dt": dt, "steps": steps, "save_every": save_every, "first_step": first}
    return ml.integrate(name, KINDS[kind].body(dtype), torque, state, **run)


@cache
def compiled(kind, name):
    return quick(jax.vmap(partial(integrate, kind, name)))


def run(kind, name, states, dt, first=0):
    dt = jnp.asarray(dt, states.momentum.dtype)
    return jax.tree.map(np.asarray, compiled(kind, name)(states, dt, np.full(len(dt), first, np.int32)))


def roundings(name):
    """How many roundings of one flight each the errors of a run are made of."""
    return STEPS * max(1, getattr(ml.method(name), "scheme", schemes.EA).flights / 2)


def stacked(*states):
    return jax.tree.map(lambda *x: jnp.stack(x), *states)


def at(states, *index):
    return jax.tree.map(lambda x: jnp.asarray(x[index]), states)


def gap(a, b):
    """The largest difference of two states' arrays, each relative to its size."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return max(float(np.max(np.abs(np.asarray(x) - np.asarray(y))) / np.max(np.abs(y))) for x, y in pairs)


@cache
def truth(kind, duration):
    """The end of the forced motion by SciPy on 13 N numbers, with forces written by hand."""
    k = KINDS[kind]
    n, inertia, travels = k.count, k.inertia.reshape(-1, 3, 3), k.mass is not None
    mass = np.reshape(k.mass if travels else np.ones(n), (n, 1))

    def split(y):
        return [part.reshape(n, -1) for part in np.split(y, np.cumsum([3 * n, 4 * n, 3 * n]))]

    def rate(t, y):
        momentum, q, linear, x = split(y)
        frames = Rotation.from_quat(q, scalar_first=True).as_matrix()
        velocity, e = np.linalg.solve(inertia, momentum[..., None])[..., 0], frames[:, :, 2]
        slope, force = by_hand(e, x, travels)
        torque = -np.einsum("nji,nj->ni", frames, np.cross(e, slope))
        w, u = q[:, :1], q[:, 1:]
        turning = np.concatenate([-np.sum(u * velocity, 1, keepdims=True), w * velocity + np.cross(u, velocity)], 1) / 2
        parts = np.cross(momentum, velocity) + torque, turning, force, linear / mass
        return np.concatenate([part.ravel() for part in parts])

    y0 = np.concatenate([x.ravel() for x in numbers_of(kind)])
    momentum, q, linear, x = split(solve_ivp(rate, (0, duration), y0, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1])
    numbers = momentum, q / np.linalg.norm(q, axis=1, keepdims=True), linear, x
    return k.of(*(jnp.asarray(part[0] if kind in SINGLE else part) for part in numbers))


CASES = [*FEW, *whole(*(case for case in ALL if case not in FEW))]
BY_TURNS = [(*case, DTYPES[n % 4 > 0]) for n, case in enumerate(FEW)]
BY_TURNS += whole(*((*case, dtype) for case in ALL for dtype in DTYPES if (*case, dtype) not in BY_TURNS))


@cache
def paths(kind, name, dtype):
    return run(kind, name, stacked(*[start(kind, dtype)] * LEVELS), DT)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("kind", "name"), CASES)
def test_order(kind, name):
    order, found, exact = ml.method(name).order, paths(kind, name, "float64"), truth(kind, 0.5)
    assert np.all(found.ok)
    errors = [np.linalg.norm(at(found.states, level, 8 << level).minus(exact)) for level in range(LEVELS)]
    if order > 8:  # whose errors are those of rounding
        assert min(errors) < 1e-11
        return
    low, high = (2, 3) if order <= 2 else (1, 2)
    slope = np.log2(errors[low] / errors[high])
    assert slope > order - 0.35 or errors[high] < 1e-12, (slope, errors)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name", "dtype"), BY_TURNS)
def test_symmetric_methods_come_back_and_coupled_bodies_keep_their_momenta(kind, name, dtype):
    """Linear and angular, to rounding by every splitting; the others keep them as well as they are accurate."""
    found, method, rounding = paths(kind, name, dtype), ml.method(name), roundings(name) * epsilon(dtype)
    if method.symmetric:
        last = jax.tree.map(lambda x: jnp.asarray(x[:, -1]), found.states)
        back = run(kind, name, last, -np.array(DT), -STEPS)
        assert gap(at(back.states, 2, -1), at(found.states, 2, 0)) <= 4 * rounding
    if kind not in COUPLED:
        return
    states, exact = at(found.states, 1), isinstance(method, Splitting) and not method.scheme.displaced
    limit = 8 * rounding if exact else 1e-3
    spin = np.asarray(ml.observe.spatial_momentum(states), np.float64)
    assert np.abs(spin - spin[0]).max() <= limit * np.abs(spin[0]).max()
    if KINDS[kind].mass is not None:
        linear = np.asarray(ml.observe.linear_momentum(states), np.float64)
        assert np.abs(linear - linear[0]).max() <= limit * np.abs(np.asarray(states.linear[0])).max()


SOME = [case for case in FEW if case[0] in COUPLED and case[1] != "JACOBI[CHIN4A]"][1::2]


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("kind", "name"), [*SOME, *whole(*(case for case in ALL if case[0] in COUPLED and case not in SOME))]
)
def test_coupled_bodies_can_be_moved_turned_and_numbered_anew(kind, name):
    """The motion of all bodies, moved and turned in space and in another order, is the motion so changed."""
    turn, shift = ml.so3.exp(jnp.array([0.4, -0.9, 0.3])), jnp.array([2.0, -1.0, 0.5])
    order = np.roll(np.arange(KINDS[kind].count), 1)
    body = jax.tree.map(lambda x: x[order], KINDS[kind].body())

    def turned(vectors):
        return ml.so3.rotate(jnp.broadcast_to(turn, (*vectors.shape[:-1], 4)), vectors)

    def moved(s):
        parts = {name: getattr(s, name)[..., order, :] for name in s.described()}
        for name in {"axis", "linear", "position", *(["momentum"] if KINDS[kind].axes else [])} & {*parts}:
            parts[name] = turned(parts[name])
        if "attitude" in parts:
            attitude = parts["attitude"]
            parts["attitude"] = ml.so3.multiply(jnp.broadcast_to(turn, attitude.shape), attitude)
        if "position" in parts:
            parts["position"] = parts["position"] + jnp.broadcast_to(shift, parts["position"].shape)
        return type(s)(**parts)

    run = {"dt": DT[1], "steps": STEPS}
    found = quick(lambda s: ml.integrate(name, body, forced(), s, **run))(moved(start(kind)))
    expected = moved(at(paths(kind, name, "float64").states, 1))
    limit = 100 * roundings(name) * epsilon("float64") if ml.method(name).keeps_momentum else 1e-4
    assert gap(found.states, expected) < limit


FAST = "JACOBI[EA]"


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), [(FAST, "float64"), *whole(*((n, "float32") for n in moved_by("free")))])
def test_without_coupling_the_rotation_is_that_of_a_rigid_state_bit_for_bit(name, dtype):
    """A plain torque counts as a wrench without a force; compiled as for users, for several bodies at once."""
    torque = ml.torques.HeavyTop(jnp.asarray(2.0, dtype), (0.48, 0.6, 0.64))
    state, body = stacked(*[start("free", dtype)] * 8), KINDS["free"].body(dtype)
    options = {"dt": jnp.asarray(1 / 32, dtype), "steps": 64, "save_every": 16, "torque_axes": None}
    path = ml.ensemble(name, body, torque, state, **options)
    alone = ml.ensemble(name, body.body, torque, state.turning, **options)
    np.testing.assert_array_equal(path.states.momentum, alone.states.momentum)
    np.testing.assert_array_equal(path.states.attitude, alone.states.attitude)
    np.testing.assert_array_equal(path.states.linear, np.broadcast_to(state.linear[:, None], (8, 5, 3)))


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("kind", "name"), [("five", FAST), ("two", FAST), *whole(*(("five", n) for n in moved_by("five") if n != FAST))]
)
def test_bodies_without_coupling_move_each_as_alone(kind, name):
    """Bit for bit without a torque, as an ensemble; under a field on each to rounding, as XLA compiles both apart."""
    body, state = KINDS[kind].body(), start(kind)
    options = {"dt": 1 / 32, "steps": STEPS}
    for torque, limit in ((None, 0), (ml.torques.PointMass(3.0) + ml.torques.HeavyTop(2.0), 100 * epsilon("float64"))):
        each = None if torque is None else ml.torques.OnEach(torque)
        found = ml.ensemble(name, body, each, jax.tree.map(lambda x: jnp.stack([x] * 8), state), **options).states
        alone = ml.ensemble(name, body, torque, state.of_body(slice(None)), torque_axes=None, **options).states
        for a, b in zip(jax.tree.leaves(at(found, 3)), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=limit * roundings(name))


DRIVEN = (
    ml.torques.HeavyTop(2.0)
    + ml.torques.Damping([0.3, 0.3, 0.1])
    + ml.spacecraft.MomentumWheels([0.0, 0.0, 0.8])
    + ml.spacecraft.ReactionWheels(lambda t: jnp.stack([0 * t, 0 * t, jnp.sin(t)]))
)


@pytest.mark.sample(0)
def test_an_axis_moves_as_that_of_a_rigid_body():
    """Torques read the whole angular velocity, or hold vectors of the body: on an axis both must be put into space."""
    of_rigid, of_axis = (
        quick(lambda s, b=b: ml.integrate("SYMMETRIC[EA]", b, DRIVEN, s, dt=1 / 32, steps=STEPS))(s)
        for s, b in (
            (start("free").turning, ml.RigidBody([2.0, 2.0, 0.9])),
            (start("axis"), ml.SymmetricRotor(2.0, 0.9)),
        )
    )
    assert gap(of_axis.states, ml.AxisState.of(of_rigid.states)) < 4 * roundings("SYMMETRIC[EA]") * epsilon("float64")


@pytest.mark.parametrize(
    ("torque", "message"),
    [
        (ml.torques.Damping([0.3, 0.2, 0.1]), "coefficient is .* the first two must be equal"),
        (ml.torques.Damping(0.3), r"write SymmetricRotor\(moment, along\)"),
        (ml.spacecraft.MomentumWheels([0.1, 0.0, 1.0]), "holds only the third axis of the body"),
    ],
)
def test_what_an_axis_cannot_know_is_refused(torque, message):
    rotor = ml.SymmetricRotor(2.0)
    for state, body in ((start("axis"), rotor), (start("free axis"), ml.FreeBody(rotor, MASS))):
        with pytest.raises(ValueError, match=message):
            ml.integrate("SYMMETRIC[EA]", body, torque, state, dt=0.1, steps=2)
    across = ml.spacecraft.ReactionWheels(lambda t: jnp.stack([t, 0 * t, 0 * t]))
    assert not ml.integrate("SYMMETRIC[EA]", rotor, across, start("axis"), dt=0.1, steps=2).ok


SYMPLECTIC = [
    *(("free", name) for name in ("JACOBI[SRKN6b]", "LIEMID[EA]", "DLM[EA]")),
    *(("two", name) for name in ("JACOBI[EA]", "JACOBI[CHIN4A]")),
]
OTHERS = [case for case in ALL if case[0] in ("free", "two") and isinstance(ml.method(case[1]), Splitting)]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("kind", "name"), [*SYMPLECTIC, *whole(*(case for case in OTHERS if case not in SYMPLECTIC))])
def test_the_defect_on_the_phase_space(kind, name):
    """M^T W1 M = W0 on 12 dimensions a body, to rounding where the flight is symplectic; LIEMID misses it."""
    canonical = benchmark("claims").canonical
    state, size = start(kind), 12 * KINDS[kind].count

    def end(increment):
        return at(integrate(kind, name, state.plus(increment), jnp.asarray(0.1), steps=1).states, -1)

    def form(momenta):
        """Of each body, for directions (change of Pi, turn, change of p, of x)."""
        blocks, order = np.zeros((size, size)), [3, 4, 5, 0, 1, 2]
        for i, momentum in enumerate(momenta.reshape(-1, 3)):
            block = blocks[12 * i : 12 * (i + 1), 12 * i : 12 * (i + 1)]
            block[:6, :6] = canonical(momentum)[np.ix_(order, order)]
            block[9:, 6:9], block[6:9, 9:] = np.eye(3), -np.eye(3)
        return blocks

    after = quick(end)(jnp.zeros(size))
    matrix = np.asarray(quick(jax.jacfwd(lambda x: end(x).minus(after)))(jnp.zeros(size)))
    defect = np.abs(matrix.T @ form(after.momentum) @ matrix - form(state.momentum)).max()
    assert (defect < 1e-12) == ml.method(name).symplectic, defect
    assert defect < 1e-2


BATCH = 517


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("kind", "name", "torque", "expected"),
    [
        ("free", "JACOBI[EA]", ml.torques.UniformGravity([0, 0, -9.81]), 1),
        # The torque is so long that it has a loop of its own beside the flight's.
        ("free axis", "SYMMETRIC[EA]", ml.torques.PointMass(3.0), 2),
        ("free", "RK4", ml.torques.UniformGravity([0, 0, -9.81]), 1),
        # The kick and the flights of both; what the function reads; the function; the kick.
        ("two", "JACOBI[EA]", ml.asteroids.MutualGravity(1.0, degree=4), 4),
    ],
)
def test_a_step_is_few_loops(kind, name, torque, expected):
    one = partial(integrate, kind, name, dt=0.01, torque=torque, steps=8, save_every=8)
    bodies = loop_bodies(real(jax.vmap(one)).lower(stacked(*[start(kind)] * BATCH)).compile().as_text())
    steps = 1 if kind in COUPLED else ml.method(name).unroll  # a long function has one copy in the program
    assert max(len(re.findall(rf"\[{BATCH}\].* fusion\(", body)) for body in bodies) == expected * steps


class Directions(Coupled, ml.DirectionState):
    """A kind of coupled bodies that the package does not have."""


@pytest.mark.sample(1)
@pytest.mark.parametrize("count", [2, 5])
def test_any_kind_of_state_can_be_coupled(count):
    """A few bodies as scalars, more side by side; without a coupling each moves as it would alone."""
    body, field = ml.RigidBody([1.0, 2.0, 2.5]), ml.torques.FromPotential(lambda t, s: jnp.sum(s.direction[..., 2]))
    momenta = jnp.outer(1 + 0.1 * jnp.arange(float(count)), jnp.array([1.0, 0.8, -1.3]))
    together = Directions(momenta, jnp.tile(jnp.array([0.0, 0.6, 0.8]), (count, 1)))

    def end(state):
        path = quick(lambda: ml.integrate("JACOBI[EA]", body, field, state, dt=0.01, steps=20, save_every=None))()
        assert path.ok
        return path.states

    own = end(together.of_body(1))
    assert type(own) is ml.DirectionState
    np.testing.assert_allclose(end(together).of_body(1).minus(own), np.zeros(5), atol=1e-14)
    assert list(Directions.described()["direction"][0]) == ["member", "axis"]


# ---- coupled bodies under every driver ----


def replicas(state, count=4):
    factors = 1 + 0.01 * jnp.arange(float(count))
    many = jax.tree.map(lambda x: jnp.stack([x] * count), state)
    return type(state)(many.momentum * factors[:, None, None], *jax.tree.leaves(many)[1:])


@pytest.mark.sample(0)
def test_an_ensemble_moves_replicas():
    """As each alone, also with a body and a step for each; and the energy is that of each."""
    body, torque, one = KINDS["two axes"].body(), forced(), start("two axes")
    many, options = replicas(one), {"steps": 20, "save_every": 10}
    own = jax.tree.map(lambda x: jnp.stack([x * (1 + 0.01 * k) for k in range(4)]), body)
    dt = jnp.linspace(0.01, 0.02, 4)
    found = ml.ensemble("SYMMETRIC[EA]", own, torque, many, dt=dt, **options)
    alone = ml.integrate("SYMMETRIC[EA]", at(own, 2), torque, at(many, 2), dt=dt[2], **options)
    assert gap(at(found.states, 2), alone.states) < 1e-12
    energies = ml.observe.energy(own, torque, found)
    assert energies.shape == (4, 3)
    np.testing.assert_allclose(energies[2], ml.observe.energy(at(own, 2), torque, alone), rtol=1e-12)


@pytest.mark.sample(0)
def test_bodies_with_full_tensors_move_as_in_their_principal_axes():
    one, kind, torque = start("five"), KINDS["five"], ml.torques.OnEach(ml.torques.PointMass(3.0))
    frames = jnp.broadcast_to(ml.so3.exp(jnp.array([0.3, -0.5, 0.9])), (5, 4))
    axes = np.asarray(ml.so3.to_matrix(frames[0]))
    tensor = ml.FreeBody(ml.TensorBody(axes @ kind.inertia @ axes.T), kind.mass)
    attitude = ml.so3.multiply(one.attitude, ml.so3.conjugate(frames))
    turned = ml.CoupledState(ml.so3.rotate(frames, one.momentum), attitude, one.linear, one.position)
    options = {"dt": 0.02, "steps": 20, "save_every": None}
    found = ml.integrate("JACOBI[EA]", tensor, torque, turned, **options)
    expected = ml.integrate("JACOBI[EA]", kind.body(), torque, one, **options)
    assert gap(found.states.position, expected.states.position) < 1e-12
    assert gap(found.states.momentum, ml.so3.rotate(frames, expected.states.momentum)) < 1e-12


def step(body, torque, state, name="JACOBI[EA]"):
    return ml.integrate(name, body, torque, state, dt=0.1, steps=1)


REFUSED = [
    (lambda b, t, s: step(b, lambda t, s: jnp.zeros(3), s), "torque must return|one row"),
    (lambda b, t, s: step(at(b, np.array([0, 0])), t, s), "leading axes"),
    (lambda b, t, s: step(b, t, replicas(s)), "midlie_jax.ensemble"),
    (lambda b, t, s: step(b, ml.torques.UniformGravity([0, 0, 1.0]), s), r"OnEach\(UniformGravity"),
    (lambda b, t, s: step(b.body, None, ml.CoupledRigidState(s.momentum, s.attitude), "PGBS8"), "moves one body"),
    (
        lambda b, t, s: ml.recommend(b, t, s, tolerance=1e-3, duration=1.0, length=1.0),
        "start must be of one body for recommend",
    ),
    (
        lambda b, t, s: step(b, ml.spacecraft.PDControl([1.0, 0.0, 0.0, 0.0], 1.0, 1.0), s),
        r"PDControl acts on one body.*OnEach\(PDControl",
    ),
    (lambda b, t, s: step(at(b, 0), ml.torques.OnEach(ml.torques.PointMass(1.0)), s.of_body(0)), "leave OnEach out"),
    (lambda b, t, s: ml.CoupledState(*(x[0] for x in jax.tree.leaves(s))), r"\(..., N, 3\) for N bodies"),
    (lambda b, t, s: ml.CoupledState.of_bodies(s), "FreeState"),
]

FIVE = KINDS["five"].body(), forced(), start("five")
test_what_is_refused = refused(*((partial(call, *FIVE), message) for call, message in REFUSED))
