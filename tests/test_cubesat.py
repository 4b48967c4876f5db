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
