"""What the laws of bodies that travel and of axes share: kinds of body and state, one forced motion, compiled runs."""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from cases import BUILDS, METHODS, equal_moments, quick, real, turn
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax.integrators import schemes

STEPS, LEVELS = 128, 4
MASS, ATTITUDE, LINEAR, POSITION = 3.0, turn(0.5, -0.3, 0.8), (1.5, -0.6, 0.9), (0.8, 0.5, -0.4)
MOMENTUM = (1.0, 0.8, -1.3)
WEIGHT, SPRING, COUPLING = 2.0, 1.5, 0.7
TENSOR = np.array([[2.0, 0.1, 0.05], [0.1, 1.7, -0.2], [0.05, -0.2, 2.4]])


class Kind(NamedTuple):
    """A kind of body and state.

    Attributes:
        body: makes the body in a dtype.
        start: makes the state from a FreeState of the body with the same inertia tensor.
        inertia: the inertia tensor, (3, 3); of a symmetric body for axes.
    """

    body: Any
    start: Any
    inertia: np.ndarray


def _free(of):
    return lambda dtype: ml.FreeBody(of(dtype), jnp.asarray(MASS, dtype))


def _rigid(dtype):
    return ml.RigidBody(jnp.array([1.0, 2.0, 2.5], dtype))


def _tensor(dtype):
    return ml.TensorBody(jnp.asarray(TENSOR, dtype))


def _symmetric(dtype):
    return ml.RigidBody(jnp.array([2.0, 2.0, 0.9], dtype))


def _rotor(dtype):
    return ml.SymmetricRotor(jnp.asarray(2.0, dtype), jnp.asarray(0.9, dtype))


SYMMETRIC = np.diag([2.0, 2.0, 0.9])
KINDS = {
    "free": Kind(_free(_rigid), lambda s: s, np.diag([1.0, 2.0, 2.5])),
    "free tensor": Kind(_free(_tensor), lambda s: s, TENSOR),
    "free symmetric": Kind(_free(_symmetric), lambda s: s, SYMMETRIC),
    "axis": Kind(_rotor, lambda s: ml.AxisState.of(s.turning), SYMMETRIC),
    "free axis": Kind(_free(_rotor), ml.FreeAxisState.of, SYMMETRIC),
}


def moved_by(kind, names=None):
    """The names of the methods that move a kind."""
    body = KINDS[kind].body("float64").in_principal_axes()
    asymmetric = kind in ("free", "free tensor")
    movers = [m.name for m in METHODS if m.moves(body) and not (asymmetric and equal_moments(m))]
    return [name for name in movers if names is None or name in names]


# Every kind with the methods that are built differently; every other method in the whole matrix.
FEW = [("free", name) for name in moved_by("free", BUILDS)]
FEW += [("axis", "SYMMETRIC[EA]"), ("axis", "SYMMETRIC[SRKN14a]"), ("axis", "GBS12")]
FEW += [("free axis", "SYMMETRIC[EA]"), ("free axis", "RK4")]
FEW += [("free tensor", "JACOBI[EA]"), ("free symmetric", "SYMMETRIC[EA]")]
ALL = [(kind, name) for kind in KINDS for name in moved_by(kind)]


def start(kind, dtype="float64"):
    state = ml.FreeState(*(jnp.asarray(x, dtype) for x in (MOMENTUM, ATTITUDE, LINEAR, POSITION)))
    return KINDS[kind].start(state)


def third(state):
    """The third axis of the body in space."""
    return state.axis if hasattr(state, "axis") else ml.so3.to_matrix(state.attitude)[:, 2]


def potential(weight, t, state):
    """Gravity on the axis; for a body that travels also a spring, and a field that couples place and axis."""
    del t
    axis = third(state)
    value = weight * axis[2]
    if state.kind.rotation is None:
        return value
    return value + SPRING / 2 * jnp.sum(state.position**2) + COUPLING * jnp.dot(axis, state.position) * axis[0]


def forced(weight):
    return ml.torques.FromPotential(jax.tree_util.Partial(potential, weight))


def integrate(kind, name, state, dt, first=0, weight=None, torque=None, steps=STEPS, save_every=1, **options):
    body, dtype = KINDS[kind].body(state.momentum.dtype), state.momentum.dtype
    if torque is None:
        torque = forced(jnp.asarray(WEIGHT, dtype) if weight is None else weight)
    return ml.integrate(
        name, body, torque, state, dt=dt, steps=steps, save_every=save_every, first_step=first, **options
    )


@cache
def compiled(kind, name, hurried=True):
    return (quick if hurried else real)(jax.vmap(partial(integrate, kind, name)))


def run(kind, name, states, dt, first=None, hurried=True):
    first = np.zeros(len(dt), np.int32) if first is None else first
    dtype = states.momentum.dtype
    return jax.tree.map(np.asarray, compiled(kind, name, hurried)(states, jnp.asarray(dt, dtype), first))


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
    """The end of the forced motion by SciPy on thirteen numbers, with forces written by hand."""
    inertia, travels = KINDS[kind].inertia, start(kind).kind.rotation is not None

    def rate(t, y):
        momentum, q, linear, x = y[:3], y[3:7], y[7:10], y[10:]
        frame = Rotation.from_quat(q, scalar_first=True).as_matrix()
        velocity, e = np.linalg.solve(inertia, momentum), frame[:, 2]
        slope, force = np.array([0.0, 0.0, WEIGHT]), np.zeros(3)
        if travels:
            slope = slope + COUPLING * (e[0] * x + np.array([e @ x, 0, 0]))
            force = -SPRING * x - COUPLING * e[0] * e
        torque = -frame.T @ np.cross(e, slope)
        w, u = q[0], q[1:]
        turning = np.concatenate([[-u @ velocity], w * velocity + np.cross(u, velocity)]) / 2
        return np.concatenate([np.cross(momentum, velocity) + torque, turning, force, linear / MASS])

    y0 = np.concatenate([MOMENTUM, ATTITUDE, LINEAR, POSITION])
    y = solve_ivp(rate, (0, duration), y0, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    y[3:7] /= np.linalg.norm(y[3:7])
    return KINDS[kind].start(ml.FreeState(*map(jnp.asarray, (y[:3], y[3:7], y[7:10], y[10:]))))
