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
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", PARTICLE)
def test_symmetric_methods_come_back(name, dtype):
    assert comes_back(name, name, dtype) == ml.method(name).symmetric


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
def test_first_order_methods_are_adjoint(dtype):
    assert comes_back("symplectic Euler", "adjoint symplectic Euler", dtype)
    assert comes_back("adjoint symplectic Euler", "symplectic Euler", dtype)


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


def test_implicit_midpoint_satisfies_its_equation():
    dt = DT[1]
    found = chain("implicit midpoint", DT).states
    p, u, t = found.momentum[1], found.position[1], T0 + dt * np.arange(STEPS)
    slack = 8 * epsilon("float64")
    middle = [pull(np, t[n] + dt / 2, (u[n] + u[n + 1]) / 2) for n in range(STEPS)]
    np.testing.assert_allclose(p[1:] - p[:-1], dt * np.array(middle), atol=slack)
    np.testing.assert_allclose(u[1:] - u[:-1], dt * np.linalg.solve(MASS, (p[1:] + p[:-1]).T / 2).T, atol=slack)


@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", PARTICLE)
def test_scalar_diagonal_and_full_mass_agree(name, dtype):
    """To four units of rounding a step: a full mass is solved by its factor, the others by division."""
    for mass in (np.full(4, 1.7), np.array([2.0, 0.5, 1.1, 3.0])):
        forms = [mass, np.diag(mass)] + [mass[0]] * bool(np.all(mass == mass[0]))
        first, *others = [chain(name, DT, dtype, form).states for form in forms]
        for other in others:
            for x, y in ((first.momentum, other.momentum), (first.position, other.position)):
                assert np.abs(x - y).max() <= 4 * STEPS * epsilon(dtype)


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
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", [*PARTICLE, "RK4"])
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


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", DTYPES)
def test_energy_momentum_and_derivatives_of_a_column(dtype):
    """Those of the flattened system, and by the masses the sum over the coordinates of each particle."""
    momentum, position = jnp.asarray(SPACE, dtype)
    mass, repeated = jnp.asarray(NODE_MASS[:, None], dtype), jnp.asarray(np.repeat(NODE_MASS, 3), dtype)
    body, slack = ml.Particles(mass), 8 * epsilon(dtype)
    np.testing.assert_allclose(body.momentum(body.velocity(momentum)), momentum, rtol=slack)
    np.testing.assert_allclose(body.velocity(momentum), momentum / np.asarray(mass), rtol=slack)
    column, flat = ml.ParticleState(momentum, position), ml.ParticleState(momentum.ravel(), position.ravel())
    force = ml.torques.FromPotential(bonds)
    for of in (
        lambda b, s: ml.observe.kinetic_energy(b, s),
        lambda b, s: ml.observe.energy(b, force, s, t=jnp.asarray(0.3, dtype)),
    ):
        np.testing.assert_allclose(of(body, column), of(ml.Particles(repeated), flat), rtol=slack)

    def end(mass, momentum, position):
        return jnp.sum(in_space("Verlet")(mass, momentum, position).states.position[-1] ** 2)

    slope = jax.grad(end)(mass, momentum, position)
    each = jax.grad(end)(repeated, momentum.ravel(), position.ravel())
    np.testing.assert_allclose(slope[:, 0], each.reshape(NODES, 3).sum(1), rtol=500 * epsilon(dtype))


@pytest.mark.parametrize("name", PARTICLE[:1])
def test_one_particle_has_a_column_that_is_a_matrix(name):
    """(1, 1), of positions (1,) and (1, 3): the same as the number."""
    for shape in ((1,), (1, 3)):
        start = ml.ParticleState(jnp.ones(shape), jnp.full(shape, 0.5))

        def end(mass, start=start):
            return ml.integrate(name, ml.Particles(mass), lambda t, s: -s.position, start, dt=0.1, steps=8).states

        matrix, number = end([[1.7]]), end(1.7)
        np.testing.assert_allclose(matrix.position, number.position, rtol=1e-14)
        np.testing.assert_allclose(ml.Particles([[1.7]]).momentum(jnp.ones(shape)), jnp.full(shape, 1.7), rtol=1e-15)


@pytest.mark.sample(0)
def test_energy_of_a_chain_is_kept_by_symplectic_methods():
    """Kinetic plus FromPotential's energy: constant but for an oscillation of second order."""

    def potential(t, state):
        stretch = jnp.diff(jnp.concatenate([jnp.zeros(1), state.position, jnp.zeros(1)]))
        return jnp.sum(stretch**2 / 2 + stretch**4 / 4)

    body, torque = ml.Particles(jnp.asarray(MASS)), ml.torques.FromPotential(potential)
    start = ml.ParticleState(jnp.asarray(PUSH), jnp.asarray(PLACE))
    np.testing.assert_allclose(torque(0.0, start), pull(np, np.float64(0.0), PLACE), atol=4 * epsilon("float64"))
    assert ml.observe.kinetic_energy(body, start) == pytest.approx(PUSH @ np.linalg.solve(MASS, PUSH) / 2, rel=1e-15)
    spans = []
    for save_every in (5, 10):
        dt = 0.25 / save_every
        path = ml.integrate("Verlet", body, torque, start, dt=dt, steps=40 * save_every, save_every=save_every)
        energies = jax.vmap(lambda state: ml.observe.energy(body, torque, state))(path.states)
        spans.append(float(jnp.max(jnp.abs(energies - energies[0]))))
    assert spans[0] / spans[1] == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize(("name", "bound"), [("RK4", 1e-6), ("DOP853", 1e-12), ("GBS12", 1e-13)])
def test_runge_kutta_methods_move_particles(name, bound):
    """Two masses on springs, against the closed form."""
    start = ml.ParticleState(jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0]))
    spring = ml.torques.FromPotential(lambda t, state: jnp.sum(state.position**2) / 2)
    path = ml.integrate(name, ml.Particles(jnp.array([1.0, 2.0])), spring, start, dt=0.1, steps=20)
    assert path.ok
    np.testing.assert_allclose(path.states.position[-1], [np.sin(2.0), np.cos(2.0**0.5)], atol=bound)
