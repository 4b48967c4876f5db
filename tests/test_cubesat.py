"""The recipes of docs/cubesat.md, and the Jacobi constant of docs/orbits.md, against laws and Monte Carlo runs."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_docs import ROOT, blocks

import midlie_jax as ml


@cache
def names(*starts, page="cubesat"):
    """What the first block of a page and the blocks that contain these words define."""
    found = {}
    first, *others = blocks(ROOT / "docs" / f"{page}.md")
    for block in (first, *(block for block in others if any(start in block for start in starts))):
        with jax.numpy_rank_promotion("allow"):  # as for a reader
            exec(compile(block, page, "exec"), found)
    return found


@pytest.mark.sample(0)
def test_the_covariance_is_that_of_monte_carlo_runs():
    """In the axes of the predicted ellipsoid; each variance has a standard error of 1 %, so an error of 5 % fails."""
    page, count = names("pull = ", "def minute"), 20_000
    start, minute = page["slow"], page["minute"]
    keys = jax.random.split(jax.random.key(3), 21)

    @jax.jit
    @jax.vmap
    def run(first, kicks):
        def step(state, kick):
            return minute(state).plus(kick), None

        return jax.lax.scan(step, start.plus(first), kicks)[0]

    first = jax.random.normal(keys[0], (count, 6)) @ jnp.diag(page["deviations"])
    normals = jnp.stack([jax.random.normal(key, (count, 6)) for key in keys[1:]], axis=1)
    kicks = normals @ jnp.sqrt(page["noise"])
    ends = run(first, kicks)
    errors = np.asarray(jax.vmap(lambda state: state.minus(page["end"]))(ends))
    white = np.linalg.solve(np.linalg.cholesky(np.asarray(page["covariance"])), errors.T)
    np.testing.assert_allclose(white @ white.T / count, np.eye(6), atol=0.03)


@pytest.mark.sample(0)
def test_detumbling_slows_every_case_by_magnetic_torques_alone():
    """Magnetic torques have no component along the field; and the median falls below 0.1 deg/s within 6000 s."""
    page = names("drawn = ")
    assert page["speeds"].shape == (1000, 3000)
    assert float(page["median"][-1]) < 0.1
    assert float(jnp.max(page["speeds"][:, -1] / page["speeds"][:, 0])) < 0.2


@pytest.mark.sample(0)
def test_slosh_takes_energy_and_leaves_the_flat_spin():
    """Kinetic plus elastic energy falls with time; both bodies keep their linear and angular momentum."""
    page = names("def slosh")
    states, mass = page["path"].states, page["mass"]
    np.testing.assert_allclose(ml.observe.linear_momentum(states), 0, atol=1e-16)
    arm = states.position[:, 1] - states.position[:, 0]
    stretch = np.asarray(arm - jax.vmap(lambda turn: ml.so3.rotate(turn, page["tank"]))(states.attitude[:, 0]))
    moments = np.stack([page["craft"].moments, np.full(3, 1e-4)])
    spin = np.sum(np.asarray(states.momentum) ** 2 / moments, axis=(1, 2))
    flight = np.sum(np.asarray(states.linear) ** 2 / np.asarray(mass)[:, None], axis=(1, 2))
    energy = (spin + flight + 0.02 * np.sum(stretch**2, axis=1)) / 2
    assert np.all(np.diff(energy) < 1e-9)
    assert float(energy[-1]) < 0.99 * float(energy[0])


def test_a_boom_slows_the_spin_by_the_growth_of_its_moment():
    """The momentum in space stays; the momentum of 1 / moments times it is the rate."""
    page = names("def deployed")
    end, start = page["free"].state(page["carry"]), page["spun"]
    np.testing.assert_allclose(
        ml.so3.rotate(end.attitude, end.momentum), ml.so3.rotate(start.attitude, start.momentum), atol=1e-16
    )
    np.testing.assert_allclose(page["slower"], end.momentum / np.array([0.14, 0.135, 0.01]), rtol=1e-12)


@pytest.mark.sample(0)
def test_the_jacobi_constant_is_the_energy_in_the_rotating_frame():
    """T of the rate relative to the frame, plus gravity and centrifugal potential (Hughes, section 9.1)."""
    page = names("def jacobi", page="orbits")
    body, circle, rate, path = page["body"], page["circle"], page["rate"], page["path"]
    run = {"dt": 20.0, "steps": 1000, "save_every": 100}
    states = ml.integrate("JACOBI[SRKN6b]", body, page["pull"], page["start"], **run).states
    moments, mean_motion = body.moments, float(jnp.linalg.norm(rate))

    @jax.vmap
    def of_frame(state, t):
        def seen(vector):
            return ml.so3.rotate(ml.so3.conjugate(state.attitude), vector)

        relative = state.momentum / moments - seen(rate)
        up, normal = seen(circle(t) / 7.0e6), seen(rate / mean_motion)
        tide = 1.5 * mean_motion**2 * (jnp.sum(moments * up**2) - jnp.sum(moments) / 3)
        return jnp.sum(moments * relative**2) / 2 + tide - mean_motion**2 / 2 * jnp.sum(moments * normal**2)

    expected = of_frame(states, 2000.0 * jnp.arange(11.0))
    np.testing.assert_allclose(path.states[::100], expected, rtol=1e-11)
