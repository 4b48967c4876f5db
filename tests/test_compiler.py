"""Options of the compiler: given where a program runs at once and nowhere else; what they change of the results."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import CLASSES, by_turns, real, setup, suited

import midlie_jax as ml
from midlie_jax._xla import compiler

WIDE = {"xla_cpu_prefer_vector_width": 512}
VECTORISED = {"xla_disable_hlo_passes": "small-while-loop-hoisting"}


@pytest.fixture
def options(monkeypatch):
    """Sets what `compiler_options` returns, for any number of bodies."""

    def set_options(value):
        monkeypatch.setattr(compiler, "compiler_options", value if callable(value) else lambda bodies: value)

    return set_options


def end(spin, steps=3):
    body, torque = ml.RigidBody(jnp.array([1.0, 2.0, 2.5])), ml.torques.HeavyTop(2.0)
    start = ml.RigidState(spin * jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))
    return jnp.sum(ml.integrate("RK4", body, torque, start, dt=0.01, steps=steps).states.momentum[-1])


@pytest.mark.parametrize(
    ("cpu", "flags", "bodies", "expected"),
    [
        ("flags : sse avx2 avx512f avx512dq", "", 1, WIDE),
        ("flags : sse avx2 avx512f avx512dq", "", 64, WIDE | VECTORISED),
        ("flags : sse avx2", "", 3, {}),
        ("flags : sse avx2", "", 4, VECTORISED),
        ("flags : sse avx2 avx512f", "--xla_cpu_prefer_vector_width=256", 4, VECTORISED),
        ("flags : sse avx2 avx512f", "--xla_disable_hlo_passes=dce", 4, WIDE),
        (None, "", 1, {}),
    ],
)
def test_options_are_given_where_they_help_and_no_flag_says_otherwise(
    cpu, flags, bodies, expected, monkeypatch, tmp_path
):
    file = tmp_path / "cpuinfo"
    if cpu is not None:
        file.write_text(cpu)
    monkeypatch.setattr(compiler, "_PROCESSOR", file)
    monkeypatch.setenv("XLA_FLAGS", flags)
    compiler._has_avx512.cache_clear()
    try:
        assert compiler.compiler_options(bodies) == expected
    finally:
        compiler._has_avx512.cache_clear()


@pytest.mark.sample(0)
def test_the_bodies_are_counted(options):
    """In the arrays of an ensemble and in the axes of `jax.vmap`, together."""
    counts = []
    options(lambda bodies: counts.append(bodies) or {})
    end(1.0)
    jax.vmap(end)(jnp.ones(5))
    jax.vmap(jax.vmap(end))(jnp.ones((2, 3)))
    states = ml.RigidState(jnp.ones((7, 3)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (7, 1)))
    jax.block_until_ready(ml.ensemble("RK4", ml.RigidBody([1.0, 2.0, 2.5]), None, states, dt=0.01, steps=3))
    *counts, shared, many = counts  # what bodies share is computed first, once
    assert (counts, shared, many) == ([1, 5, 6], 1, 7)


@pytest.mark.sample(0)
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


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns(CLASSES, CLASSES[::3]))
def test_wide_vectors_change_no_bit_and_vectorised_steps_no_more_than_rounding(name, dtype):
    s = setup()
    body = ml.RigidBody(suited(name, jnp.asarray(s.moments, dtype)))
    torque = ml.torques.HeavyTop(jnp.asarray(2.0, dtype))
    momenta = jnp.asarray(s.momentum * np.linspace(0.9, 1.1, 19)[:, None], dtype)
    starts = ml.RigidState(momenta, jnp.tile(jnp.asarray(s.attitude, dtype), (19, 1)))

    def run(start):
        return ml.integrate(name, body, torque, start, dt=1 / 64, steps=64, save_every=64)

    program = real(jax.vmap(run)).lower(starts)
    every = ({"xla_cpu_prefer_vector_width": 256}, WIDE, WIDE | VECTORISED)
    narrow, wide, vectorised = (program.compile(compiler_options=options)(starts) for options in every)
    assert all(jax.tree.leaves(jax.tree.map(np.array_equal, narrow, wide)))
    assert np.array_equal(wide.ok, vectorised.ok)
    bound = 64 * np.finfo(dtype).eps
    for one, other in zip(jax.tree.leaves(wide.states), jax.tree.leaves(vectorised.states), strict=True):
        assert np.max(np.abs(one - other)) <= bound * np.max(np.abs(one))


class Numbered(eqx.Module):
    """A force whose program depends on the type and the sign of a Python number."""

    number: complex | float | bool

    def __call__(self, t, state):
        sign = np.copysign(1.0, np.real(self.number)) * np.copysign(1.0, np.imag(self.number))
        return jnp.array([sign * (1.0, 2.0, 3.0, 4.0)[(bool, int, float, complex).index(type(self.number))], 0.0, 0.0])


@pytest.mark.sample(1)
@pytest.mark.parametrize("outer", [lambda run: run, jax.jit], ids=["alone", "in a program"])
def test_equal_python_numbers_have_programs_of_their_own(outer):
    """0.0 and -0.0 are equal, and so are 1, 1.0 and True; of each such pair the second ran as the first."""
    body, start = ml.Particles(1.0), ml.ParticleState(jnp.zeros(3), jnp.zeros(3))
    for number, force in (
        (0.0, 3),
        (-0.0, -3),
        (0, 2),
        (False, 1),
        (1.0, 3),
        (1, 2),
        (True, 1),
        (complex(1, 0.0), 4),
        (complex(1, -0.0), -4),
    ):
        run = outer(lambda start, n=number: ml.integrate("symplectic Euler", body, Numbered(n), start, dt=0.5, steps=1))
        assert float(run(start).states.momentum[-1, 0]) == pytest.approx(force / 2), number
