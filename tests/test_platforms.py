"""One package for CPUs and accelerators: what is lowered for each platform, on a machine that need not have it."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import cast, epsilon, integrate, quick, rows, setup

import midlie_jax as ml
from midlie_jax._xla.platform import on_cpu
from midlie_jax.drivers.chunks import chunk_size

PLATFORMS = ["cpu", "cuda", "rocm", "tpu"]
MANY_OPERANDS = r"stablehlo\.reduce\(%\S+ init: %\S+\), \("
DIFFERENT = ["SYMMETRIC[EA]", "GBS10"]  # in the steps of a turn, its stages and its cuts
SETUPS = rows(setup(), setup(weight=-1.0))
BODY = ml.RigidBody([1.0, 2.0, 2.5])
START = ml.RigidState([1.0, 0.8, -1.3], [1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def on_gpu(monkeypatch):
    """Traces as for a GPU; the programs still run here."""
    jax.clear_caches()
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    yield
    jax.clear_caches()


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", DIFFERENT)
def test_outputs_leave_a_step_through_a_reduction_on_cpus_alone(name):
    traced = jax.jit(jax.vmap(lambda s: integrate(name, s, steps=4, save_every=4))).trace(cast(SETUPS, "float32"))
    texts = {platform: traced.lower(lowering_platforms=(platform,)).as_text() for platform in PLATFORMS}
    assert re.search(MANY_OPERANDS, texts["cpu"])
    for platform in PLATFORMS[1:]:
        assert not re.search(MANY_OPERANDS, texts[platform])


@pytest.mark.sample(0)
def test_long_steps_are_cut_on_a_gpu_and_short_ones_are_not(on_gpu):
    for name, cuts in (("GBS12", True), ("DOP853", False), ("JACOBI[EA]", False)):
        run = {"dt": 0.02, "steps": 4, "save_every": 4}
        traced = jax.jit(partial(ml.integrate, name, BODY, ml.torques.HeavyTop(2.0), **run)).trace(START)
        text = traced.lower(lowering_platforms=("cuda",)).as_text()
        assert ("optimization_barrier" in text) == cuts


def test_the_default_device_decides_where_programs_run_and_an_ensemble_on_an_accelerator_is_one_chunk(on_gpu):
    assert not on_cpu()
    assert chunk_size(10**6) == 10**6
    with jax.default_device(jax.devices("cpu")[0]):
        assert on_cpu()
        assert chunk_size(10**6) < 10**6


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), [("JACOBI[SRKN14a]", "float64"), ("GBS10", "float32")])
def test_what_is_traced_for_a_gpu_computes_the_same(name, dtype, on_gpu):
    """Though its loops have other turns: 7 steps are no multiple of any."""

    def end(s):
        return integrate(name, s, steps=7, save_every=7)

    there = quick(jax.vmap(end))(cast(SETUPS, dtype))
    with jax.default_device(jax.devices("cpu")[0]):
        assert on_cpu()
        jax.clear_caches()
        here = quick(jax.vmap(lambda s: end(s)))(cast(SETUPS, dtype))
    assert np.array_equal(here.ok, there.ok)
    for mine, its in zip(jax.tree.leaves(here.states), jax.tree.leaves(there.states), strict=True):
        assert float(jnp.max(jnp.abs(mine - its))) <= 16 * epsilon(dtype)
