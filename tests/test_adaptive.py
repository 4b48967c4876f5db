"""Laws of the reversible step control: it comes home, keeps the order, and is `integrate` where the density is even."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import AXIS, OTHER, at, cast, epsilon, gap, numbers, quick, rows, setup, true_motion

import midlie_jax as ml

# One that evaluates its force anew, of order 2, and one that keeps it, of order 4.
METHODS = ["LIEMID[EA*]", "JACOBI[CHIN4A]"]
STEPS, EVERY, MOST = 128, 8, 512
T0, T1 = 0.3, 2.1


def beating(weight, t, state):
    """A top in a field that comes and goes."""
    return (1 + jnp.sin(3 * t) / 2) * ml.torques.HeavyTop(weight, AXIS)(t, state)


def lively(strength, t, state):
    return jnp.exp(strength * (jnp.sin(2 * t) + jnp.sum(state.momentum**2) / 4 + 2 * state.vertical()[0]))


def integrate(name, s, dt, t0, strength, rho=None, t1=None, **options):
    start = ml.RigidState(s.momentum, s.attitude)
    torque, density = jax.tree_util.Partial(beating, s.weight), jax.tree_util.Partial(lively, strength)
    given = {"steps": STEPS, "save_every": EVERY} | options
    return ml.integrate_variable_step(
        name, ml.RigidBody(s.moments), torque, start, density=density, dt=dt, t0=t0, rho=rho, t1=t1, **given
    )


def true_end(s, times):
    """Momentum and attitude at increasing times after T0, by another program."""

    def torque(t, r):
        return s.weight * (1 + np.sin(3 * t) / 2) * np.cross(r[2], AXIS)

    return true_motion(s._replace(t0=np.asarray(T0)), times - T0, torque)


@cache
def compiled(name):
    return jax.jit(jax.vmap(partial(integrate, name)))


def asked(dtype="float64"):
    """Rows of (setup, dt, t0, strength): a ladder of steps, another body, and an even density."""
    setups = rows(setup(), setup(), setup(), setup(**OTHER), setup())
    dts, strengths = [0.04, 0.02, 0.01, 0.02, 0.015], [0.5, 0.5, 0.5, 0.7, 0.0]
    return (cast(setups, dtype), *(jnp.asarray(x, dtype) for x in (dts, [T0] * 5, strengths)))


@cache
def run(name, dtype="float64"):
    s, dt, t0, strength = asked(dtype)
    rho = jax.vmap(lambda s, t, k: lively(k, t, ml.RigidState(s.momentum, s.attitude)))(s, t0, strength)
    return numbers(compiled(name)(s, dt, t0, strength, rho))


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), [(METHODS[0], "float32"), (METHODS[1], "float64")])
def test_it_comes_home_by_the_same_steps(name, dtype):
    s, dt, _, strength = asked(dtype)
    out = run(name, dtype)
    assert out.ok.all()
    lengths = np.diff(out.times.astype(np.float64))
    assert np.all(lengths[[0, 3]].max(1) > 1.5 * lengths[[0, 3]].min(1))
    s = s._replace(momentum=out.states.momentum[:, -1], attitude=out.states.attitude[:, -1])
    back = numbers(compiled(name)(s, -dt, out.times[:, -1], strength, out.rho[:, -1]))
    assert back.ok.all()
    there = jax.tree.map(lambda x: x[:, ::-1], (back.times, back.rho, back.states.momentum, back.states.attitude))
    here = (out.times, out.rho, out.states.momentum, out.states.attitude)
    assert gap(there, here) <= 200 * epsilon(dtype)


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", METHODS)
def test_rho_follows_the_density_and_the_motion_keeps_its_order(name):
    out = run(name)
    values = jax.vmap(lambda k, t, s: jax.vmap(partial(lively, k))(t, s))(asked()[3], out.times, out.states)
    away = np.abs(out.rho / np.asarray(values) - 1)
    errors = []
    for row in range(3):
        # After the same time of the control, and so after the same time but for errors of second order.
        upto = (STEPS // EVERY // 4) * 2**row + 1
        truth = true_end(setup(), out.times[row, :upto])
        errors.append((gap(at(out.states, row, slice(upto)), truth), away[row, :upto].max()))
    slopes = np.log2(np.array(errors[0]) / np.array(errors[2])) / 2
    np.testing.assert_allclose(slopes, [ml.method(name).order, 2], atol=0.25)
    assert not away[4].any()


@pytest.mark.sample(0)
def test_it_ends_at_t1_with_the_order_of_the_method_and_waits_there():
    arguments = (*asked(), jnp.full(5, T1))
    function = partial(integrate, METHODS[0], rho=None, steps=MOST, save_every=MOST // 2)  # kept twice on the way
    out = numbers(jax.jit(jax.vmap(lambda s, dt, t0, k, t1: function(s, dt, t0, k, t1=t1)))(*arguments))
    assert out.ok.all()
    assert np.all(out.times[:, -1] == T1)
    truth = true_end(setup(), np.array([T1]))
    errors = [gap(at(out.states, row, slice(-1, None)), truth) for row in range(3)]
    assert abs(np.log2(errors[0] / errors[2]) / 2 - 2) < 0.25
    arrived = out.taken <= MOST // 2
    assert arrived.any()
    assert not arrived.all()
    for kept in (out.times, out.states.momentum, out.states.attitude, out.rho):
        assert np.all(kept[arrived, 1] == kept[arrived, 2])
    assert np.all(out.times[~arrived, 1] < T1)


@pytest.mark.sample(0)
def test_an_even_density_is_integrate():
    s, dt, t0, _ = jax.tree.map(lambda x: x[4], asked())
    start, torque = ml.RigidState(s.momentum, s.attitude), jax.tree_util.Partial(beating, s.weight)
    path = ml.integrate(METHODS[0], ml.RigidBody(s.moments), torque, start, dt=dt, t0=t0, steps=STEPS, save_every=EVERY)
    out = run(METHODS[0])
    assert np.all(out.rho[4] == 1)
    ours = (out.times[4], out.states.momentum[4], out.states.attitude[4])
    assert gap(ours, (path.times, path.states.momentum, path.states.attitude)) <= 64 * epsilon("float64")


# Particles: the same control, and a compile that costs little.


def pull(t, state):
    return -state.position / jnp.sum(state.position**2) ** 1.5


def by_distance(t, state):
    return jnp.sum(state.position**2) ** -0.75


def planet(speed=0.5):
    """At its aphelion at 1, of eccentricity 1 - speed^2."""
    return ml.ParticleState(jnp.stack([jnp.zeros_like(speed), jnp.asarray(speed)]), jnp.array([1.0, 0.0]))


def orbit(start, dt=0.05, density=by_distance, **options):
    body = ml.Particles(jnp.ones((), getattr(start, "like", start).momentum.dtype))
    return ml.integrate_variable_step("Verlet", body, pull, start, density=density, dt=dt, **options)


def test_the_energy_of_an_eccentric_orbit_does_not_drift():
    path = jax.jit(lambda s: orbit(s, steps=16_000, save_every=16))(planet(jnp.array(0.5)))
    assert path.ok
    square = jnp.sum(path.states.momentum**2, -1)
    energy = np.asarray(square / 2 - 1 / jnp.sqrt(jnp.sum(path.states.position**2, -1)))
    error = energy / energy[0] - 1
    first, last = error[:200], error[-200:]
    assert np.abs(error).max() < 0.02
    assert abs(last.mean() - first.mean()) < 0.02 * np.abs(error).max()


def test_runs_in_blocks_have_the_bits_of_one_run():
    """From a carry, with and without t1."""
    start = planet()
    whole = orbit(start, steps=40, save_every=20)
    part = orbit(start, steps=20, save_every=20)
    rest = orbit(part.carry, steps=20, save_every=20)
    parts = zip((rest.times, rest.states, rest.rho), (whole.times, whole.states, whole.rho), strict=True)
    for found, expected in parts:
        jax.tree.map(lambda x, y: np.testing.assert_array_equal(x, y[1:]), found, expected)
    assert (int(rest.taken), int(rest.carry.index)) == (20, 40)
    t1, end = float(part.times[-1]) + 1e-3, float(whole.times[-1])
    until = orbit(start, steps=40, save_every=20, t1=t1)
    on = orbit(until.carry, steps=40, save_every=20, t1=end)
    assert (float(until.times[-1]), float(on.times[-1]), bool(on.ok)) == (t1, end, True)
    np.testing.assert_allclose(on.states.position[-1], whole.states.position[-1], atol=2e-3)


def test_a_carry_of_another_driver_is_refused():
    part = orbit(planet(), steps=2)
    with pytest.raises(ValueError, match="t0 and rho must be left out"):
        orbit(part.carry, steps=2, rho=1.0)
    other = partial(ml.integrate, "Verlet", ml.Particles(jnp.ones(())), pull, dt=0.01, steps=2)
    with pytest.raises(ValueError, match="must be the carry of a run with variable steps"):
        orbit(other(planet()).carry, steps=2)
    with pytest.raises(ValueError, match="variable steps"):
        other(part.carry)


@pytest.mark.sample(0)
def test_gradients_equal_differences():
    def end(x, **until):
        path = orbit(planet(x[0]), dt=x[1], steps=64, save_every=64, **until)
        return path.states.position[-1] @ jnp.array([0.3, -1.1]) + path.states.momentum[-1] @ jnp.array([0.7, 0.4])

    def measured(x):
        fixed = jax.grad(end)(x)
        reverse = jax.grad(partial(end, t1=2.0, adjoint=ml.adjoints.Checkpointed()))(x)
        forward = jax.vmap(lambda d: jax.jvp(partial(end, t1=2.0), (x,), (d,)))(jnp.eye(2))
        return fixed, reverse, forward[1], jnp.stack([end(x), forward[0][0]])

    x, step = jnp.array([0.5, 0.05]), 1e-5
    moved = x[None] + step * jnp.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    fixed, reverse, forward, values = jax.tree.map(np.asarray, quick(jax.vmap(measured))(moved))
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    differences = (values[[1, 3]] - values[[2, 4]]) / (2 * step)
    np.testing.assert_allclose(np.stack([fixed[0], reverse[0]], axis=1), differences, rtol=1e-6)


def test_float32_time_is_not_lost():
    state = ml.ParticleState(jnp.zeros(2, jnp.float32), jnp.array([1.0, 0.0], jnp.float32))
    run = partial(ml.integrate_variable_step, "Verlet", ml.Particles(jnp.float32(1.0)), None, state)
    path = run(density=lambda t, state: jnp.ones_like(t), dt=1e-3, steps=100_000, save_every=100_000)
    assert path.times.dtype == np.float32
    assert abs(path.times[-1] - 100) <= 2 * 100 * epsilon("float32")


def falling(factors, t, state):
    return factors[0] - factors[1] * t + jnp.sign(factors[2]) * jnp.exp(-factors[2] * t)


def test_failures_show_in_ok():
    start = planet(jnp.array(0.5))
    # Too few steps, nowhere to go, and, which cannot raise where it is traced, a dt that points away from t1.
    upto = jax.jit(jax.vmap(lambda dt, t1: orbit(start, dt=dt, steps=8, save_every=8, t1=t1)))
    paths = upto(jnp.array([0.05, 0.05, -0.05]), jnp.array([2.0, 0.0, 2.0]))
    np.testing.assert_array_equal(paths.ok, [False, True, False])
    np.testing.assert_array_equal(paths.taken, [8, 0, 0])

    # A density that falls to nothing at t = 1, one so steep that rho is driven below zero, and none at all.
    falls = jnp.array([[1.0, 1.0, 0.0], [0.0, 0.0, 60.0], [jnp.nan, 0.0, 0.0], [0.0, 0.0, 0.1]])
    many = jax.jit(jax.vmap(lambda f: orbit(start, density=jax.tree_util.Partial(falling, f), steps=64, save_every=64)))
    paths = many(falls)
    np.testing.assert_array_equal(paths.ok, [False, False, False, True])
    assert np.all(np.isfinite(paths.states.position))


def jumping(height, t, state):
    """1, and after half a unit of time more or less; its derivative tells nothing of the jump."""
    return jnp.where(t > 0.5, height, 1.0)


def test_a_density_that_jumps_is_noticed():
    """rho follows the derivative of the density, and would go on as if nothing had happened."""
    heights = jnp.array([1.0, 1.9, 3.0, 1000.0, jnp.inf, 0.3, 1e-3])
    start = planet(jnp.array(0.5))

    def run(height, steps):
        return orbit(start, density=jax.tree_util.Partial(jumping, height), steps=steps, save_every=steps)

    whole, before = (jax.jit(jax.vmap(partial(run, steps=steps)))(heights) for steps in (64, 9))
    np.testing.assert_array_equal(whole.ok, [True, True, False, False, False, False, False])
    assert before.ok.all()
    # Who has strayed waits where it happened.
    np.testing.assert_array_less(whole.times[2:, -1], 0.6)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": jnp.nan}, "dt"),
        ({"t1": -1.0}, "dt must point"),
        ({"rho": 0.0}, "rho"),
        ({"density": lambda t, s: s.position}, "density"),
        ({"density": jax.tree_util.Partial(lively, jnp.float32(1.0))}, "density"),
    ],
)
def test_a_wrong_argument_is_named(changes, named):
    with pytest.raises(ValueError, match=named):
        orbit(planet(jnp.array(0.5)), **({"steps": 8} | changes))


def test_a_method_that_is_not_symmetric_is_refused():
    run = partial(ml.integrate_variable_step, "symplectic Euler", ml.Particles(1.0), None, planet(jnp.array(0.5)))
    with pytest.raises(ValueError, match="symmetric"):
        run(density=by_distance, dt=0.1, steps=1)
