"""Wide vectors: asked for where a program runs at once and nowhere else, and the results are the same bits."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import CLASSES, by_turns, real, setup, suited

import midlie_jax as ml
from midlie_jax._kernel import width

WIDE = {"xla_cpu_prefer_vector_width": 512}


@pytest.fixture
def options(monkeypatch):
    """Sets what `vector_width_options` returns."""

    def set_options(value):
        monkeypatch.setattr(width, "vector_width_options", lambda: value)

    return set_options


def end(spin, steps=3):
    body, torque = ml.RigidBody(jnp.array([1.0, 2.0, 2.5])), ml.torques.HeavyTop(2.0)
    start = ml.RigidState(spin * jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))
    return jnp.sum(ml.integrate("RK4", body, torque, start, dt=0.01, steps=steps).states.momentum[-1])


@pytest.mark.parametrize(
    ("cpu", "flags", "expected"),
    [
        ("flags : sse avx2 avx512f avx512dq", "", WIDE),
        ("flags : sse avx2", "", {}),
        ("flags : sse avx2 avx512f", "--xla_cpu_prefer_vector_width=256", {}),
        (None, "", {}),
    ],
)
def test_wide_vectors_are_asked_for_where_the_processor_has_them_and_no_flag_says_otherwise(
    cpu, flags, expected, monkeypatch, tmp_path
):
    file = tmp_path / "cpuinfo"
    if cpu is not None:
        file.write_text(cpu)
    monkeypatch.setattr(width, "_PROCESSOR", file)
    monkeypatch.setenv("XLA_FLAGS", flags)
    width._has_avx512.cache_clear()
    try:
        assert width.vector_width_options() == expected
    finally:
        width._has_avx512.cache_clear()


def test_the_options_reach_every_program_that_runs_at_once_and_no_other(options):
    """An option that no compiler knows makes every program fail to which it is given."""
    spins = jnp.array([1.0, 1.1])
    options({"no_such_option": 1})
    steps = iter(range(4, 100))  # a new number of steps for each call, so that nothing compiled earlier serves it
    for run in (end, jax.vmap(partial(end, steps=3))):
        with pytest.raises(jax.errors.JaxRuntimeError, match="no_such_option"):
            run(1.0 if run is end else spins)
    states = ml.RigidState(jnp.ones((2, 3)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (2, 1)))
    with pytest.raises(jax.errors.JaxRuntimeError, match="no_such_option"):
        ml.ensemble("RK4", ml.RigidBody([1.0, 2.0, 2.5]), None, states, dt=0.01, steps=3)
    for transform in (jax.jit, jax.grad, jax.jacfwd, lambda f: lambda x: jax.jit(jax.vmap(f))(x[None])[0]):
        assert np.isfinite(transform(partial(end, steps=next(steps)))(1.0 + 0 * spins[0]))


@pytest.mark.parametrize(("name", "dtype"), by_turns(CLASSES, CLASSES))
def test_wide_vectors_change_no_bit(name, dtype):
    s = setup()
    body = ml.RigidBody(suited(name, jnp.asarray(s.moments, dtype)))
    torque = ml.torques.HeavyTop(jnp.asarray(2.0, dtype))
    momenta = jnp.asarray(s.momentum * np.linspace(0.9, 1.1, 19)[:, None], dtype)
    starts = ml.RigidState(momenta, jnp.tile(jnp.asarray(s.attitude, dtype), (19, 1)))

    def run(start):
        return ml.integrate(name, body, torque, start, dt=1 / 64, steps=64, save_every=64)

    program = real(jax.vmap(run)).lower(starts)
    ends = [program.compile(compiler_options={"xla_cpu_prefer_vector_width": w})(starts) for w in (256, 512)]
    assert all(jax.tree.leaves(jax.tree.map(np.array_equal, *ends)))
