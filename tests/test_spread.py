"""Ensembles over a mesh of devices, and what they observe in place of states."""

import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import refused
from simulated import ATTITUDES, BODIES, MOMENTA, MOMENTS, WEIGHTS

import midlie_jax as ml

BODY, TORQUE = ml.RigidBody(jnp.asarray(MOMENTS)), ml.torques.HeavyTop(jnp.asarray(WEIGHTS))
START = ml.RigidState(jnp.asarray(MOMENTA), jnp.asarray(ATTITUDES))
RUN = {"dt": 0.05, "steps": 20, "save_every": 10}


def ensemble(**options):
    return ml.ensemble("SYMMETRIC[EA]", BODY, TORQUE, START, **{**RUN, **options})


@pytest.mark.sample(0)
def test_a_mesh_changes_no_bit_and_its_loops_send_nothing():
    """In a process with four devices, compiled as users get it; see `meshes.py`."""
    script = Path(__file__).parent / "meshes.py"
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=600, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert set(found) == {"tops", "heated", "mean", "autocorrelation", "explicit", "typed"}
    for name, result in found.items():
        assert (name, result["same"], result["messages in loops"]) == (name, True, 0)


@pytest.mark.sample(0)
def test_statistics_are_those_of_the_bodies_that_can_be_trusted():
    start = ml.RigidState(START.momentum.at[4].set(1e200), START.attitude)  # one that overflows
    run, edges = partial(ml.ensemble, "SYMMETRIC[EA]", BODY, TORQUE, start, chunk=7, **RUN), np.linspace(-1, 1, 9)
    states = run()
    assert np.flatnonzero(~states.ok).tolist() == [4]
    momenta = np.asarray(states.states.momentum)[np.arange(BODIES) != 4]
    mean = run(observe=ml.observe.Mean(momentum)).states
    counts = run(observe=ml.observe.Histogram(momentum, edges)).states
    for k in range(1, 3):  # at the start, which overflows in nothing, the body still counts
        assert mean.number[k] == BODIES - 1
        np.testing.assert_allclose(mean.mean[k], momenta[:, k].mean(axis=0), rtol=1e-13)
        np.testing.assert_allclose(mean.covariance[k], np.cov(momenta[:, k].T), rtol=1e-12)
        for component in range(3):
            expected, _ = np.histogram(momenta[:, k, component], edges)
            np.testing.assert_array_equal(counts[k, component], expected)
    assert mean.number[0] == BODIES


def momentum(t, state):
    return state.momentum


@pytest.mark.sample(0)
def test_statistics_of_truths_and_whole_numbers_are_those_of_real_numbers():
    """In the precision of the run, or of the edges where they have more digits."""
    body, torque, start = jax.tree.map(lambda x: x.astype("float32"), (BODY, TORQUE, START))

    def values(t, state):
        first = state.momentum[0]
        return {"sign": first > 0, "tenths": jnp.floor(10 * first).astype(jnp.int32), "large": jnp.int32(2**30)}

    def run(observe):
        return ml.ensemble("SYMMETRIC[EA]", body, torque, start, observe=observe, chunk=7, **RUN).states

    seen, mean = run(values), run(ml.observe.Mean(values))
    bins = {"sign": [0.25, 0.75, 1.0], "tenths": np.arange(-9.5, 9.0, 0.5), "large": [0.1, 2.0**31]}
    for name, edges in bins.items():
        counts = run(ml.observe.Histogram(lambda t, state, name=name: values(t, state)[name], edges))
        numbers = np.asarray(seen[name], np.float64)
        np.testing.assert_array_equal(counts, [np.histogram(column, edges)[0] for column in numbers.T], err_msg=name)
        assert mean[name].mean.dtype == mean[name].covariance.dtype == "float32"
        np.testing.assert_allclose(mean[name].mean[:, 0], numbers.mean(axis=0), rtol=1e-5, err_msg=name)
        np.testing.assert_allclose(mean[name].covariance[:, 0, 0], numbers.var(axis=0, ddof=1), rtol=1e-4)


def test_a_value_that_is_no_number_is_in_no_bin():
    """Nor is one that is infinite, or that does not count; the upper edge of the last bin is in it."""
    values = jnp.array([np.nan, np.inf, -np.inf, 0.0, 1.0, 2.0, 2.5, 0.5, -0.0, 1.0])
    counted = jnp.arange(len(values)) != 9
    histogram = ml.observe.Histogram(momentum, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(histogram.part(values, counted), [3, 2])


NO_AXES, NO_BINS = ((0.0, 0.0, 0.0), (np.nan, 0.0, 1.0)), ([1.0], [0.0, 0.0], [1.0, 0.0], [[0.0, 1.0]])
test_what_cannot_be_observed_is_named = refused(
    (lambda: ensemble(observe=3), "observe must be a function of .t, state."),
    (lambda: ensemble(observe={}), "observe must be a function"),
    (lambda: ensemble(observe={"energy": 3}), r"observe\['energy'\] must be"),
    (lambda: ensemble(observe=lambda t, state: None), "observe must return an array"),
    (lambda: ensemble(observe=ml.observe.Mean(lambda t, s: {"z": jax.lax.complex(t, t)})), r"must be real.*\['z'\]"),
    (lambda: ensemble(observe=ml.observe.Mean(momentum), t0=jnp.zeros(BODIES)), "give one dt and one t0 for all"),
    *((partial(ml.observe.Axis, axis), "axis must be three finite numbers, not all zero") for axis in NO_AXES),
    *((partial(ml.observe.Histogram, momentum, x), "edges must be at least two increasing numbers") for x in NO_BINS),
)
