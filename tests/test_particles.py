"""Particles: the schemes in their textbook forms, every kind of mass, order, reversal, splits, batches."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, PARTICLE, epsilon
from scipy.integrate import solve_ivp

import midlie_jax as ml

MASS = np.array([[2.0, 0.3, 0.0, 0.1], [0.3, 1.5, -0.2, 0.0], [0.0, -0.2, 1.0, 0.2], [0.1, 0.0, 0.2, 1.2]])
PLACE, PUSH = np.array([0.3, -0.4, 0.1, 0.6]), np.array([0.5, 0.2, -0.8, 0.1])
STEPS, T0 = 128, 0.4


def force(t, state):
    """A chain with quartic springs, held at both ends, shaken at one."""
    return pull(jnp, t, state.position)


def pull(np, t, u):
    stretch = np.diff(np.concatenate([np.zeros(1, u.dtype), u, np.zeros(1, u.dtype)]))
    shake = np.stack([np.sin(2 * t), 0 * t, 0 * t, 0 * t])
    return np.diff(stretch + stretch**3) + shake


@cache
def compiled(name, steps=STEPS, save_every=1, solo=False):
    def motion(body, momentum, position, dt, t0, first):
        start = ml.ParticleState(momentum, position)
        return ml.integrate(
            name, body, force, start, dt=dt, t0=t0, steps=steps, save_every=save_every, first_step=first
        )

    return jax.jit(motion if solo else jax.vmap(motion, in_axes=(None, 0, 0, 0, 0, None)))


def chain(name, dt, dtype="float64", mass=MASS, momentum=PUSH, position=PLACE, t0=T0):
    """One run for each of dt, as arrays with a leading axis."""
    dt = np.atleast_1d(dt)
    body = ml.Particles(jnp.asarray(mass, dtype))
    tile = [
        jnp.asarray(np.broadcast_to(x, (len(dt), *np.shape(x)[-k:])), dtype) for x, k in ((momentum, 1), (position, 1))
    ]
    times = [jnp.asarray(np.broadcast_to(x, len(dt)), dtype) for x in (dt, t0)]
    return jax.tree.map(np.asarray, compiled(name)(body, *tile, *times, jnp.int32(0)))


DT = 1 / (16 << np.arange(4))


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", PARTICLE)
def test_order(name):
    def rate(t, y):
        return np.concatenate([pull(np, np.float64(t), y[4:]), np.linalg.solve(MASS, y[:4])])

    exact = solve_ivp(rate, (T0, T0 + 1), np.concatenate([PUSH, PLACE]), "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    found, order = chain(name, DT).states, ml.method(name).order
    for part, truth in ((found.momentum, exact[:4]), (found.position, exact[4:])):
        errors = [np.linalg.norm(part[level, 16 << level] - truth) for level in range(4)]
        assert abs(np.log2(errors[-2] / errors[-1]) - order) < 0.1, errors


@pytest.mark.sample(2)
@pytest.mark.parametrize(("name", "dtype"), [*zip(PARTICLE, DTYPES * 9, strict=False)])
def test_symmetric_methods_come_back(name, dtype):
    assert comes_back(name, name, dtype) == ml.method(name).symmetric


def test_first_order_methods_are_adjoint():
    assert comes_back("symplectic Euler", "adjoint symplectic Euler", "float64")
    assert comes_back("adjoint symplectic Euler", "symplectic Euler", "float64")


def comes_back(there, back, dtype):
    """To a unit of rounding a step; misses, where it does, by 1e-3 or more."""
    dt = DT[2:]
    out = chain(there, dt, dtype).states
    end = {"momentum": out.momentum[:, -1], "position": out.position[:, -1]}
    found = chain(back, -dt, dtype, t0=T0 + STEPS * dt, **end).states
    gap = max(np.abs(found.momentum[:, -1] - PUSH).max(), np.abs(found.position[:, -1] - PLACE).max())
    small = gap <= STEPS * epsilon(dtype)
    assert small or gap > 1e-3, gap
    return small


def textbook(name, dt, mass):
    """The usual way to write each method, in NumPy."""
    p, u, velocity = PUSH.copy(), PLACE.copy(), lambda p: np.linalg.solve(mass, p)
    momenta, places = [p], [u]
    v, a = velocity(p), velocity(pull(np, np.float64(T0), u))
    for n in range(STEPS):
        t, t1 = np.float64(T0 + n * dt), np.float64(T0 + (n + 1) * dt)
        if name == "Verlet":  # velocity Verlet; Newmark with beta = 0, gamma = 1/2
            u = u + dt * v + dt**2 / 2 * a
            new = velocity(pull(np, t1, u))
            v, a = v + dt / 2 * (a + new), new
            p = mass @ v
        elif name == "position Verlet":
            half = u + dt / 2 * velocity(p)
            p = p + dt * pull(np, t + dt / 2, half)
            u = half + dt / 2 * velocity(p)
        elif name == "symplectic Euler":
            p = p + dt * pull(np, t, u)
            u = u + dt * velocity(p)
        else:
            u = u + dt * velocity(p)
            p = p + dt * pull(np, t1, u)
        momenta.append(p)
        places.append(u)
    return np.array(momenta), np.array(places)


@pytest.mark.parametrize("name", ["Verlet", "position Verlet", "symplectic Euler", "adjoint symplectic Euler"])
def test_is_the_textbook_form(name):
    """To two units of rounding a step: the operations are the same but in another order."""
    for row, dt in enumerate(DT):
        found = chain(name, DT).states
        for part, truth in zip((found.momentum, found.position), textbook(name, dt, MASS), strict=True):
            assert np.all(np.abs(part[row] - truth) <= 2 * epsilon("float64") * (1 + np.arange(STEPS + 1))[:, None])


NODES = 4  # in space: positions (4, 3)
EDGES = np.array([(i, j) for i in range(NODES) for j in range(i)])
NODE_MASS = np.array([2.0, 0.5, 1.1, 3.0])
SPACE = np.random.default_rng(0).normal(size=(2, NODES, 3))  # momenta and positions


def bonds(t, state):
    """The energy of springs between all nodes, by their positions in any shape."""
    u = state.position.reshape(NODES, 3)
    square = jnp.sum((u[EDGES[:, 0]] - u[EDGES[:, 1]]) ** 2, axis=1)
    return jnp.sum((1 + 0.3 * jnp.sin(t)) * (square - 1) ** 2) / 8


@cache
def in_space(name):
    def motion(mass, momentum, position):
        start = ml.ParticleState(momentum, position)
        body, force = ml.Particles(mass), ml.torques.FromPotential(bonds)
        return ml.integrate(name, body, force, start, dt=jnp.asarray(0.02, position.dtype), steps=16)

    return jax.jit(motion)


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("name", "dtype"), [("Verlet", "float32"), ("implicit midpoint", "float64"), ("RK4", "float64")]
)
def test_one_mass_for_each_particle(name, dtype):
    """A column of masses is the flattened run with each mass three times; a row of three is one for each column."""
    momentum, position = jnp.asarray(SPACE, dtype)
    forms = {
        "column": (NODE_MASS[:, None], np.repeat(NODE_MASS, 3)),
        "row": (NODE_MASS[None, :3], np.tile(NODE_MASS[:3], NODES)),
    }
    for form, repeated in forms.values():
        path = in_space(name)(jnp.asarray(form, dtype), momentum, position)
        flat = in_space(name)(jnp.asarray(repeated, dtype), momentum.ravel(), position.ravel())
        assert path.ok
        assert flat.ok
        for part in ("momentum", "position"):
            found, expected = (getattr(run.states, part) for run in (path, flat))
            assert found.dtype == dtype
            gap = jnp.abs(found.reshape(expected.shape) - expected)
            assert jnp.max(gap) <= 4 * 16 * epsilon(dtype) * jnp.max(jnp.abs(expected))


@pytest.mark.parametrize(("name", "bound"), [("RK4", 1e-6), ("DOP853", 1e-12), ("GBS12", 1e-13)])
def test_runge_kutta_methods_move_particles(name, bound):
    """Two masses on springs, against the closed form."""
    start = ml.ParticleState(jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0]))
    spring = ml.torques.FromPotential(lambda t, state: jnp.sum(state.position**2) / 2)
    path = ml.integrate(name, ml.Particles(jnp.array([1.0, 2.0])), spring, start, dt=0.1, steps=20)
    assert path.ok
    np.testing.assert_allclose(path.states.position[-1], [np.sin(2.0), np.cos(2.0**0.5)], atol=bound)
