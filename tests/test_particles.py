"""Particles: textbook forms of schemes, kinds of mass, order, reversal; deformable solids, and d'Alembert's bar."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import solids
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
def compiled(name):
    def motion(body, momentum, position, dt, t0):
        return ml.integrate(name, body, force, ml.ParticleState(momentum, position), dt=dt, t0=t0, steps=STEPS)

    return jax.jit(jax.vmap(motion, in_axes=(None, 0, 0, 0, 0)))


def chain(name, dt, dtype="float64", momentum=PUSH, position=PLACE, t0=T0):
    places = [jnp.asarray(np.broadcast_to(x, (len(dt), 4)), dtype) for x in (momentum, position)]
    times = [jnp.asarray(np.broadcast_to(x, len(dt)), dtype) for x in (dt, t0)]
    return jax.tree.map(np.asarray, compiled(name)(ml.Particles(jnp.asarray(MASS, dtype)), *places, *times))


DT = 1 / (16 << np.arange(4))


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", [*PARTICLE, "RK4"])
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


@pytest.mark.sample(0)
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


TEXTBOOK = {  # kick and drift, in parts of a step
    "Verlet": [(0.5, 1), (0.5, 0)],
    "position Verlet": [(0, 0.5), (1, 0.5)],
    "symplectic Euler": [(1, 1)],
    "adjoint symplectic Euler": [(0, 1), (1, 0)],
}


@pytest.mark.parametrize("name", TEXTBOOK)
def test_is_the_textbook_form(name):
    """To two units of rounding a step: the operations are the same but in another order."""
    found = chain(name, DT).states
    for row, dt in enumerate(DT):
        p, u = PUSH, PLACE
        for n in range(1 + STEPS):
            for part, truth in ((found.momentum, p), (found.position, u)):
                assert np.all(np.abs(part[row, n] - truth) <= 2 * epsilon("float64") * (1 + n))
            t = T0 + n * dt
            for kick, drift in TEXTBOOK[name]:
                p = p + kick * dt * pull(np, t, u)
                u, t = u + drift * dt * np.linalg.solve(MASS, p), t + drift * dt


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("name", "dtype"), [("Verlet", "float32"), ("implicit midpoint", "float64"), ("GBS12", "float64")]
)
def test_one_mass_for_each_particle(name, dtype):
    """A column of masses is the flattened run with each mass three times; a row of three is one for each column."""
    masses, (momentum, position) = np.array([2.0, 0.5, 1.1, 3.0]), np.random.default_rng(0).normal(size=(2, 4, 3))

    def run(mass, shape):
        body, *start = (jnp.asarray(x, dtype) for x in (mass, momentum.reshape(shape), position.reshape(shape)))
        springs, dt = (lambda t, state: -state.position * (1 + state.position**2)), jnp.asarray(0.02, dtype)
        return ml.integrate(name, ml.Particles(body), springs, ml.ParticleState(*start), dt=dt, steps=16)

    for form, repeated in ((masses[:, None], np.repeat(masses, 3)), (masses[None, :3], np.tile(masses[:3], 4))):
        path, flat = run(form, (4, 3)), run(repeated, 12)
        assert path.ok & flat.ok
        for found, expected in zip(*map(jax.tree.leaves, (path.states, flat.states)), strict=True):
            assert found.dtype == dtype
            gap = jnp.abs(found.reshape(expected.shape) - expected)
            assert jnp.max(gap) <= 4 * 16 * epsilon(dtype) * jnp.max(jnp.abs(expected))


MU, LAME = 3.0, 8.0


def test_the_energy_is_that_of_a_homogeneous_deformation():
    """Of a body of two tetrahedra, of volumes 1/6 and 1/3; and does not feel a rotation."""
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    energy = solids.NeoHookean(jnp.asarray(nodes), [[0, 1, 2, 3], [1, 2, 3, 4]], MU, LAME)
    value = jax.jit(lambda state: energy(0.0, state))
    F = np.array([[1.2, 0.1, 0.0], [-0.2, 0.9, 0.3], [0.1, 0.0, 1.1]])
    log_J = np.log(np.linalg.det(F))
    exact = 1 / 2 * (MU / 2 * (np.sum(F**2) - 3) - MU * log_J + LAME / 2 * log_J**2)
    turn = np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.array([0.4, 1.0, -2.0]))))
    for map_ in (F, turn @ F):
        bent = ml.ParticleState(jnp.zeros_like(nodes), jnp.asarray(nodes @ map_.T + 3.0))
        assert value(bent) == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize(("courant", "bound"), [(1.0, 1e-13), (0.4, 1e-13)])
def test_the_nodes_of_a_bar_move_as_known(courant, bound):
    """At c h = dx as d'Alembert's waves, otherwise at the frequency of elements and steps; over 10,000 steps."""
    found = solids.case(courant, 10_000)
    assert np.abs(found.found - found.exact).max() < bound
    if courant == 1.0:
        assert found.frequency == pytest.approx(solids.MODE * np.pi, rel=1e-15)
