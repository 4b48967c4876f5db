"""Laws of the reversible step control: it comes home, keeps the order, and is `integrate` where the density is even."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS, OTHER, cast, epsilon, gap, numbers, rows, setup, swing, true_motion

import midlie_jax as ml

# One that keeps its force and one that does not, and one of order 4.
METHODS = ["LIEMID[EA]", "JACOBI[EA*]", "JACOBI[CHIN4A]"]
STEPS, EVERY = 96, 8
T0, T1 = 0.3, 1.1


def lively(strength, t, state):
    """A density of time, momentum and pose, on arrays."""
    wave = jnp.sin(2 * t) + jnp.sum(state.momentum**2) / 4 + 2 * ml.so3.to_matrix(state.attitude)[2, 0]
    return jnp.exp(strength * wave)


def integrate(name, s, dt, t0, strength, rho=None, t1=None, **options):
    torque = ml.torques.HeavyTop(s.weight, AXIS) + jax.tree_util.Partial(swing, s.strength)
    start = ml.RigidState(s.momentum, s.attitude)
    density = jax.tree_util.Partial(lively, strength)
    given = {"steps": STEPS, "save_every": EVERY} | options
    return ml.integrate_adaptive(
        name, ml.RigidBody(s.moments), torque, start, density=density, dt=dt, t0=t0, rho=rho, t1=t1, **given
    )


@cache
def compiled(name, **options):
    return jax.jit(jax.vmap(partial(integrate, name, **options)))


def asked(dtype="float64"):
    """Rows of (setup, dt, t0, strength): a ladder of steps, another body, and an even density."""
    setups = rows(setup(), setup(), setup(), setup(**OTHER), setup())
    dts, strengths = [0.04, 0.02, 0.01, 0.02, 0.015], [0.5, 0.5, 0.5, 0.7, 0.0]
    return (cast(setups, dtype), *(jnp.asarray(x, dtype) for x in (dts, [T0] * 5, strengths)))


@cache
def run(name, dtype="float64", **options):
    s, dt, t0, strength = asked(dtype)
    rho = jax.vmap(lambda s, t, k: lively(k, t, ml.RigidState(s.momentum, s.attitude)))(s, t0, strength)
    return numbers(compiled(name, **options)(s, dt, t0, strength, rho))


@cache
def until(name):
    s, dt, t0, strength = asked()
    function = partial(integrate, name, rho=None, steps=768, save_every=256)
    t1 = jnp.full_like(dt, T1)
    return numbers(jax.jit(jax.vmap(lambda s, dt, t0, k, t1: function(s, dt, t0, k, t1=t1)))(s, dt, t0, strength, t1))


@pytest.mark.parametrize(("name", "dtype"), [*((n, "float64") for n in METHODS), ("LIEMID[EA]", "float32")])
def test_it_comes_home_by_the_same_steps(name, dtype):
    s, dt, _, strength = asked(dtype)
    out = run(name, dtype)
    assert out.ok.all()
    lengths = np.diff(out.times.astype(np.float64))
    assert np.all(lengths[:4].max(1) > 1.5 * lengths[:4].min(1))
    s = s._replace(momentum=out.states.momentum[:, -1], attitude=out.states.attitude[:, -1])
    back = numbers(compiled(name)(s, -dt, out.times[:, -1], strength, out.densities[:, -1]))
    assert back.ok.all()
    there = jax.tree.map(lambda x: x[:, ::-1], (back.times, back.densities, back.states.momentum, back.states.attitude))
    here = (out.times, out.densities, out.states.momentum, out.states.attitude)
    assert gap(there, here) <= 200 * epsilon(dtype)


@pytest.mark.parametrize("name", METHODS)
def test_rho_stays_near_the_density(name):
    out = run(name)
    strengths = np.asarray(asked()[3])
    values = jax.vmap(lambda k, t, s: jax.vmap(partial(lively, k))(t, s))(strengths, out.times, out.states)
    away = np.max(np.abs(out.densities / np.asarray(values) - 1), axis=1)
    assert away[0] < 0.1
    # The same number of steps covers less the smaller they are, so the ladder is compared at its least.
    assert away[2] < away[0] / 4
    assert away[4] == 0


@pytest.mark.parametrize("name", METHODS)
def test_it_ends_at_t1_with_the_order_of_the_method(name):
    out = until(name)
    assert out.ok.all()
    assert np.all(out.times[:, -1] == T1)
    assert np.all((0 < out.taken) & (out.taken < 768))
    momentum, attitude = true_motion(setup(), np.array([T1 - T0]))
    errors = []
    for row in range(3):
        reached = (out.states.momentum[row, -1], out.states.attitude[row, -1])
        errors.append(gap(reached, (momentum[0], attitude[0])))
    slope = np.log2(errors[0] / errors[2]) / 2
    assert abs(slope - ml.method(name).order) < 0.25


def test_a_body_that_has_arrived_waits_where_it_is():
    out = until(METHODS[0])
    arrived = out.taken <= 256
    assert arrived.any()
    assert not arrived.all()
    for kept in (out.times, out.states.momentum, out.states.attitude, out.densities):
        assert np.all(kept[arrived, 1] == kept[arrived, -1])


def test_an_even_density_is_integrate():
    s, dt, t0, _ = asked()
    torque = ml.torques.HeavyTop(s.weight[4], AXIS) + jax.tree_util.Partial(swing, s.strength[4])
    start = ml.RigidState(s.momentum[4], s.attitude[4])
    path = ml.integrate(
        METHODS[0], ml.RigidBody(s.moments[4]), torque, start, dt=dt[4], t0=t0[4], steps=STEPS, save_every=EVERY
    )
    out = run(METHODS[0])
    assert np.all(out.densities[4] == 1)
    ours = (out.times[4], out.states.momentum[4], out.states.attitude[4])
    assert gap(ours, (path.times, path.states.momentum, path.states.attitude)) <= 64 * epsilon("float64")


def test_mapped_is_alone():
    out = run(METHODS[0])
    s, dt, t0, strength = jax.tree.map(lambda x: x[3], asked())
    alone = numbers(jax.jit(partial(integrate, METHODS[0]))(s, dt, t0, strength))
    assert alone.ok
    assert alone.taken == out.taken[3] == STEPS
    mapped = (out.times[3], out.densities[3], out.states.momentum[3], out.states.attitude[3])
    assert gap((alone.times, alone.densities, alone.states.momentum, alone.states.attitude), mapped) <= 1e-13


# Particles: the same control, and a compile that costs little.


def pull(t, state):
    """Gravity of a point."""
    del t
    return -state.position / jnp.sum(state.position**2) ** 1.5


def by_distance(t, state):
    del t
    return jnp.sum(state.position**2) ** -0.75


def planet(speed=0.5):
    """At its aphelion at 1, of eccentricity 1 - speed^2."""
    return ml.ParticleState(jnp.stack([jnp.zeros_like(speed), jnp.asarray(speed)]), jnp.array([1.0, 0.0]))


def orbit(start, dt=0.05, density=by_distance, **options):
    body = ml.Particles(jnp.ones((), start.momentum.dtype))
    return ml.integrate_adaptive("Verlet", body, pull, start, density=density, dt=dt, **options)


def test_the_energy_of_an_eccentric_orbit_does_not_drift():
    path = jax.jit(lambda s: orbit(s, steps=64_000, save_every=16))(planet(jnp.array(0.5)))
    assert path.ok
    square = jnp.sum(path.states.momentum**2, -1)
    energy = np.asarray(square / 2 - 1 / jnp.sqrt(jnp.sum(path.states.position**2, -1)))
    error = energy / energy[0] - 1
    first, last = error[:400], error[-400:]
    assert np.abs(error).max() < 0.02
    assert abs(last.mean() - first.mean()) < 0.02 * np.abs(error).max()


@pytest.mark.parametrize("until", [{}, {"t1": 2.0, "reverse": True}])
def test_gradients_equal_differences(until):
    def end(x):
        path = orbit(planet(x[0]), dt=x[1], steps=64, save_every=64, **until)
        return path.states.position[-1] @ jnp.array([0.3, -1.1]) + path.states.momentum[-1] @ jnp.array([0.7, 0.4])

    x = jnp.array([0.5, 0.05])
    reverse, forward = jax.jit(lambda x: (jax.grad(end)(x), jax.jacfwd(end)(x)))(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    sizes, factors = jnp.array([2.0, 1.0, -1.0, -2.0]) * 1e-5, jnp.array([-1.0, 8.0, -8.0, 1.0]) / 12e-5
    moved = x + sizes[:, None, None] * jnp.eye(2)
    np.testing.assert_allclose(reverse, factors @ jax.jit(jax.vmap(jax.vmap(end)))(moved), rtol=1e-7)


def test_a_rigid_gradient_equals_differences():
    s, dt, t0, strength = jax.tree.map(lambda x: x[3], asked())

    def end(x):
        path = integrate("DLM[EA]", s, dt * x, t0, strength * x, steps=8, save_every=8)
        return path.states.momentum[-1] @ jnp.array([0.3, -1.1, 0.5]) + path.states.attitude[-1, 1]

    one = jnp.array(1.0)
    both = jax.jit(lambda x: (end(x), jax.grad(end)(x)))
    (_, slope), step = both(one), 1e-4
    assert abs((both(one + step)[0] - both(one - step)[0]) / (2 * step) - slope) < 1e-6 * abs(slope)


def test_float32_time_is_not_lost():
    state = ml.ParticleState(jnp.zeros(2, jnp.float32), jnp.array([1.0, 0.0], jnp.float32))

    def even(t, state):
        del state
        return jnp.ones_like(t)

    body = ml.Particles(jnp.float32(1.0))
    path = ml.integrate_adaptive("Verlet", body, None, state, density=even, dt=1e-3, steps=100_000, save_every=100_000)
    assert path.times.dtype == np.float32
    assert abs(path.times[-1] - 100) <= 2 * 100 * epsilon("float32")


def test_failures_show_in_ok():
    start = planet(jnp.array(0.5))
    short = orbit(start, steps=8, save_every=8, t1=2.0)
    assert not short.ok
    assert short.taken == 8

    def sinking(t, state):
        del state
        return 1 - t

    # The density falls to nothing at t = 1; and a steep one drives rho below zero.
    sunk = orbit(start, density=sinking, steps=64, save_every=64)
    assert not sunk.ok
    assert np.all(np.isfinite(sunk.states.position))
    assert not orbit(start, density=lambda t, s: jnp.exp(-100 * t), steps=64, save_every=64).ok
    assert not orbit(start, density=lambda t, s: t * jnp.nan, steps=8, save_every=8).ok
    # Traced, a dt that points away from t1 cannot raise.
    assert not jax.jit(lambda dt: orbit(start, dt=dt, steps=8, t1=2.0).ok)(-0.05)
    assert bool(orbit(start, steps=8, t1=0.0).ok)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": jnp.nan}, "dt"),
        ({"t1": -1.0}, "dt must point"),
        ({"rho": 0.0}, "rho"),
        ({"density": 1.0}, "density"),
        ({"density": lambda t, s: s.position}, "density"),
        ({"density": jax.tree_util.Partial(lively, jnp.float32(1.0))}, "density"),
        ({"steps": 0}, "steps"),
        ({"save_every": 3}, "save_every"),
    ],
)
def test_a_wrong_argument_is_named(changes, named):
    with pytest.raises(ValueError, match=named):
        orbit(planet(jnp.array(0.5)), **({"steps": 8} | changes))


def test_a_method_that_is_not_symmetric_is_refused():
    with pytest.raises(ValueError, match="symmetric"):
        ml.integrate_adaptive(
            "symplectic Euler", ml.Particles(1.0), None, planet(jnp.array(0.5)), density=by_distance, dt=0.1, steps=1
        )
