"""Apophis past the Earth: starts and ends against figures on which SciPy and 128-bit arithmetic agree."""

import flyby
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import midlie_jax as ml


def check_ends(states):
    for n, end in enumerate(flyby.ENDS):
        state = jax.tree.map(lambda x, n=n: x[n], states)
        size = float(np.linalg.norm(end.momentum))
        np.testing.assert_allclose(state.momentum, end.momentum, atol=1e-8 * size, rtol=0)
        assert flyby.distance(state.attitude, np.array(end.attitude)) < 1e-8
        before, after = (ml.asteroids.tumble(flyby.body(), one) for one in (flyby.start(*end.phases), state))
        assert after.energy_ratio == pytest.approx(end.energy_ratio, abs=6e-6)
        assert after.momentum / before.momentum == pytest.approx(end.momentum_ratio, abs=6e-6)
        cosine = np.asarray(after.pole) @ np.asarray(before.pole)
        assert np.degrees(np.arccos(cosine)) == pytest.approx(end.pole_moves, abs=6e-4)


@pytest.mark.sample(0)
def test_the_ends_by_constant_steps_and_by_steps_that_know_the_perigee():
    """From 26 radii, with a density as it comes and fewer steps; starts are made by two periods, a pole and phases."""
    states = [flyby.start(*end.phases) for end in flyby.ENDS]
    for state, end in zip(states, flyby.ENDS, strict=True):
        np.testing.assert_allclose(state.momentum, end.momentum_before, atol=1e-17)
        np.testing.assert_allclose(state.attitude, end.attitude_before, atol=1e-14)
    both = jax.tree.map(lambda *x: jnp.stack(x), *states)
    scene = "JACOBI[SRKN6b]", flyby.body(), flyby.torque()
    path = ml.ensemble(*scene, both, dt=flyby.HALF / 288, steps=576, t0=-flyby.HALF)
    assert path.ok.all()
    check_ends(path.states)
    density = ml.densities.OrbitalDistance(flyby.orbit(), flyby.PERIGEE)
    run = {"density": density, "steps": 512, "save_every": None, "t0": -flyby.HALF, "t1": flyby.HALF}

    def vary(state, dt):
        return ml.integrate_variable_step(*scene, state, dt=dt, **run)

    many = jax.jit(jax.vmap(vary, (0, None)))
    path = many(both, 150.0)
    assert path.ok.all()
    assert np.all(path.taken < 300)
    check_ends(path.states)
    assert many(both, 1200.0).ok.all()  # two steps at the perigee, far too long for accuracy, are no failure


@pytest.mark.sample(0)
def test_the_density_has_a_longest_step():
    orbit, state = flyby.orbit(), flyby.start(0.0, 0.0)
    density, bare = (ml.densities.OrbitalDistance(orbit, flyby.PERIGEE, longest=n) for n in (16.0, 1e12))
    for t in (0.0, 3e4, 1e5, 1e7):
        ratio = float(flyby.PERIGEE / np.linalg.norm(orbit(t))) ** 1.5
        assert bare(t, state) == pytest.approx(ratio, rel=1e-12)
        assert density(t, state) == pytest.approx((ratio**4 + 16.0**-4) ** 0.25, rel=1e-12)
    with pytest.raises(ValueError, match="longest must be positive and finite"):
        ml.densities.OrbitalDistance(orbit, 1.0, longest=0.0)
