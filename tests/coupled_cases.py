"""What the laws of coupled bodies share: kinds of state, few bodies and many, one forced motion, compiled runs."""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from cases import BUILDS, METHODS, equal_moments, quick, real
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import midlie_jax as ml

STEPS, LEVELS = 64, 4
SPRING, FIELD, COUPLING = 1.5, 0.9, 0.4
DT = [*(1 / (16 << level) for level in range(LEVELS)), 0.0]


class Kind(NamedTuple):
    """A kind of state of N bodies.

    Attributes:
        count: N. Two are moved number by number, five side by side, with their function compiled apart.
        travels: whether they travel.
        axes: whether only their axes of symmetry are known.
    """

    count: int
    travels: bool = True
    axes: bool = False

    @property
    def state(self) -> Any:
        if self.axes:
            return ml.CoupledFreeAxisState if self.travels else ml.CoupledAxisState
        return ml.CoupledState if self.travels else ml.CoupledRigidState

    @property
    def moments(self) -> np.ndarray:
        """(N, 3), of symmetric bodies for axes."""
        moments = np.random.default_rng(1).uniform(1.0, 1.6, (self.count, 3))
        return moments[:, [0, 0, 2]] if self.axes else moments

    @property
    def mass(self) -> np.ndarray:
        return np.random.default_rng(2).uniform(1.0, 2.0, self.count)

    def body(self, dtype: Any = "float64") -> Any:
        moments = jnp.asarray(self.moments, dtype)
        turning = ml.SymmetricRotor(moments[:, 0], moments[:, 2]) if self.axes else ml.RigidBody(moments)
        return ml.FreeBody(turning, jnp.asarray(self.mass, dtype)) if self.travels else turning

    def of(self, free: ml.CoupledState) -> Any:
        """The state of this kind, from one of bodies that turn and travel."""
        rigid = ml.CoupledRigidState(free.momentum, free.attitude)
        if self.axes:
            axis = ml.AxisState.of(rigid.of_body(slice(None)))
            parts = axis.momentum, axis.axis
        else:
            parts = free.momentum, free.attitude
        return self.state(*parts, free.linear, free.position) if self.travels else self.state(*parts)


KINDS = {
    "two": Kind(2),
    "five": Kind(5),
    "two rigid": Kind(2, travels=False),
    "five rigid": Kind(5, travels=False),
    "two axes": Kind(2, axes=True),
    "five axes": Kind(5, travels=False, axes=True),
}


def moved_by(kind):
    """The names of the methods that move a kind."""
    body = KINDS[kind].body()
    movers = [m.name for m in METHODS if m.several and m.moves(body)]
    return movers if KINDS[kind].axes else [name for name in movers if not equal_moments(name)]


FEW = [("two", "JACOBI[EA]"), ("five", "JACOBI[EA]"), ("five", "JACOBI[SRKN6b]"), ("two", "GBS12")]
FEW += [("two", "JACOBI[SRKN14a]"), ("five", "JACOBI[CHIN4A]"), ("two rigid", "JACOBI[EA]")]
FEW += [("five axes", "SYMMETRIC[EA]"), ("two axes", "SYMMETRIC[SRKN6b]"), ("five rigid", "LIEMID[EA]")]
FEW += [("five", name) for name in moved_by("five") if name in BUILDS and ("five", name) not in FEW]
ALL = [(kind, name) for kind in KINDS for name in moved_by(kind)]


def free_start(count, dtype="float64"):
    rng = np.random.default_rng(count)
    attitude = Rotation.random(count, rng).as_quat(scalar_first=True)
    vectors = rng.normal(size=(3, count, 3))
    momentum, linear, position = vectors[0], 0.5 * vectors[1], vectors[2]
    return ml.CoupledState(*(jnp.asarray(x, dtype) for x in (momentum, attitude, linear, position)))


def start(kind, dtype="float64"):
    return KINDS[kind].of(free_start(KINDS[kind].count, dtype))


def thirds(state):
    """The third axis of each body in space, (N, 3)."""
    return state.axis if hasattr(state, "axis") else ml.so3.to_matrix(state.attitude)[..., 2]


def potential(field, t, state):
    """Of each pair: a spring, axes that align, and their product with the distance d, where the bodies travel."""
    del t
    e = thirds(state)
    value = 0.5 * field * jnp.sum(jnp.sum(e, 0) ** 2)
    if state.kind.rotation is None:
        return value
    d = state.position[:, None] - state.position[None]
    along = jnp.sum(e[:, None] * d, -1)
    return value + SPRING / 4 * jnp.sum(d * d) - COUPLING / 2 * jnp.sum(along * along.T)


def forced(field):
    return ml.torques.FromPotential(jax.tree_util.Partial(potential, field))


def integrate(kind, name, state, dt, first=0, field=None, torque=None, steps=STEPS, save_every=1, **options):
    dtype = state.momentum.dtype
    if torque is None:
        torque = forced(jnp.asarray(FIELD, dtype) if field is None else field)
    run = {"dt": dt, "steps": steps, "save_every": save_every, "first_step": first}
    return ml.integrate(name, KINDS[kind].body(dtype), torque, state, **run, **options)


@cache
def compiled(kind, name, hurried=True):
    return (quick if hurried else real)(jax.vmap(partial(integrate, kind, name)))


def run(kind, name, states, dt, first=None, hurried=True):
    first = np.zeros(len(dt), np.int32) if first is None else first
    dt = jnp.asarray(dt, states.momentum.dtype)
    return jax.tree.map(np.asarray, compiled(kind, name, hurried)(states, dt, first))


@cache
def truth(kind, duration):
    """The end of the forced motion by SciPy on 13 N numbers, with forces written by hand."""
    k = KINDS[kind]
    moments, mass, n = k.moments, k.mass, k.count

    def rate(t, y):
        momentum, q, linear, x = np.split(y, np.cumsum([3 * n, 4 * n, 3 * n]))
        momentum, q, linear, x = momentum.reshape(n, 3), q.reshape(n, 4), linear.reshape(n, 3), x.reshape(n, 3)
        frames = Rotation.from_quat(q, scalar_first=True).as_matrix()
        velocity, e = momentum / moments, frames[:, :, 2]
        slope, force = FIELD * np.tile(e.sum(0), (n, 1)), np.zeros((n, 3))
        if k.travels:
            for i in range(n):
                for j in range(n):
                    if i != j:  # of the pair, the part that moves i
                        d = x[j] - x[i]
                        force[i] += SPRING * d + COUPLING * ((e[j] @ d) * e[i] + (e[i] @ d) * e[j])
                        slope[i] += COUPLING * (e[j] @ d) * d
        torque = -np.einsum("nji,nj->ni", frames, np.cross(e, slope))
        w, u = q[:, :1], q[:, 1:]
        turning = np.concatenate([-np.sum(u * velocity, 1, keepdims=True), w * velocity + np.cross(u, velocity)], 1) / 2
        parts = np.cross(momentum, velocity) + torque, turning, force, linear / mass[:, None]
        return np.concatenate([part.ravel() for part in parts])

    s = free_start(n)
    y0 = np.concatenate([np.asarray(x).ravel() for x in (s.momentum, s.attitude, s.linear, s.position)])
    y = solve_ivp(rate, (0, duration), y0, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    momentum, q, linear, x = np.split(y, np.cumsum([3 * n, 4 * n, 3 * n]))
    q = q.reshape(n, 4) / np.linalg.norm(q.reshape(n, 4), axis=1, keepdims=True)
    return k.of(ml.CoupledState(momentum.reshape(n, 3), q, linear.reshape(n, 3), x.reshape(n, 3)))
