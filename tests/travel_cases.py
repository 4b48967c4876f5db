"""What the laws of bodies that translate, of axes and of coupled bodies share: kinds, one forced motion, runs."""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from cases import CLASSES, METHODS, equal_moments, quick, real, turn
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax.integrators import schemes

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
    """The names of the methods that move a kind."""
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
    """Momentum, attitude, linear momentum and position."""
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
    del t
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


def integrate(kind, name, state, dt, first=0, torque=None, steps=STEPS, save_every=1, **options):
    dtype = state.momentum.dtype
    torque = forced(jnp.asarray(WEIGHT, dtype)) if torque is None else torque
    run = {"dt": dt, "steps": steps, "save_every": save_every, "first_step": first}
    return ml.integrate(name, KINDS[kind].body(dtype), torque, state, **run, **options)


@cache
def compiled(kind, name):
    return quick(jax.vmap(partial(integrate, kind, name)))


def run(kind, name, states, dt, first=0):
    dt = jnp.asarray(dt, states.momentum.dtype)
    return jax.tree.map(np.asarray, compiled(kind, name)(states, dt, np.full(len(dt), first, np.int32)))


def loops_of(kind, name, batch, torque=None):
    """The text of a program of eight steps, compiled as for users."""
    one = partial(integrate, kind, name, dt=0.01, torque=torque, steps=8, save_every=8)
    return real(jax.vmap(one)).lower(stacked(*[start(kind)] * batch)).compile().as_text()


def roundings(name, steps=STEPS):
    """How many roundings of one flight each the errors of a run are made of."""
    return steps * max(1, getattr(ml.method(name), "scheme", schemes.EA).flights / 2)


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
