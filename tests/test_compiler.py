"""Options of the compiler: given where a program runs at once and nowhere else; what they change of the results;
and one program serves every number of steps, of which a second call traces nothing.
"""

from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import real, setup, suited

import midlie_jax as ml
from midlie_jax._xla import compiler

WIDE = {"xla_cpu_prefer_vector_width": 512}
VECTORISED = {"xla_disable_hlo_passes": "small-while-loop-hoisting"}


def end(spin, steps=3):
    body, torque = ml.RigidBody(jnp.array([1.0, 2.0, 2.5])), ml.torques.HeavyTop(2.0)
    start = ml.RigidState(spin * jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))
    return jnp.sum(ml.integrate("RK4", body, torque, start, dt=0.01, steps=steps).states.momentum[-1])


@pytest.mark.parametrize(
    ("cpu", "flags", "bodies", "expected"),
    [
        ("flags : sse avx2 avx512f avx512dq", "", 1, WIDE),
        ("flags : sse avx2 avx512f avx512dq", "", 64, WIDE | VECTORISED),
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
def test_the_options_reach_every_program_that_runs_at_once_and_no_other(monkeypatch):
    """An option that no compiler knows makes every program fail to which it is given."""
    spins = jnp.array([1.0, 1.1])
    monkeypatch.setattr(compiler, "compiler_options", lambda bodies: {"no_such_option": 1})
    states = ml.RigidState(jnp.ones((2, 3)), jnp.tile(jnp.array([1.0, 0, 0, 0]), (2, 1)))
    for run in (
        lambda: end(1.0),
        lambda: jax.vmap(end)(spins),
        lambda: ml.ensemble("RK4", ml.RigidBody([1.0, 2.0, 2.5]), None, states, dt=0.01, steps=3),
    ):
        with pytest.raises(jax.errors.JaxRuntimeError, match="no_such_option"):
            run()
    # A new number of steps for each call, so that nothing compiled earlier serves it.
    for steps, transform in enumerate((jax.jit, jax.grad, lambda f: lambda x: jax.jit(jax.vmap(f))(x[None])[0]), 4):
        assert np.isfinite(transform(partial(end, steps=steps))(spins[0]))


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), [("JACOBI[EA]", "float64"), ("NMB", "float32")])
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


def test_equal_python_numbers_have_programs_of_their_own():
    """0.0 and -0.0 are equal, and so are 1, 1.0 and True; of each such pair the second ran as the first."""
    body, start = ml.Particles(1.0), ml.ParticleState(jnp.zeros(3), jnp.zeros(3))
    numbers = {"0.0": 3, "-0.0": -3, "0": 2, "False": 1, "1.0": 3, "1": 2, "True": 1}
    numbers |= {"complex(1, 0.0)": 4, "complex(1, -0.0)": -4}
    for text, force in numbers.items():
        path = ml.integrate("symplectic Euler", body, Numbered(eval(text)), start, dt=0.5, steps=1)
        assert float(path.states.momentum[-1, 0]) == pytest.approx(force / 2), text


BODY = ml.RigidBody([1.0, 2.0, 2.5])
STATE = ml.RigidState(jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))


def counting(count, t, state):
    count.append(None)
    return ml.torques.HeavyTop(2.0)(t, state)


def solved(torque, state, dt, t0, steps):
    term = ml.diffrax.RigidBodyTerm(BODY, torque)
    t0, dt = jnp.asarray(t0), jnp.asarray(dt)  # diffrax makes a program for each number of Python's
    return diffrax.diffeqsolve(term, ml.diffrax.LieSolver("JACOBI[EA]"), t0, t0 + steps * dt, dt, state, max_steps=None)


DRIVERS = {
    "integrate": lambda f, x, dt, t0, n: ml.integrate("JACOBI[EA]", BODY, f, x, dt=dt, t0=t0, steps=n, save_every=None),
    "ensemble": lambda f, x, dt, t0, n: ml.ensemble(
        "JACOBI[EA]", BODY, f, jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), x), dt=dt, t0=t0, steps=n
    ),
    "saving": lambda f, x, dt, t0, n: ml.integrate(
        "JACOBI[EA]", BODY, f, x, dt=dt, t0=t0, steps=2 * (32 + n), save_every=32 + n
    ),
    "LieSolver": solved,
}
FIXED = {
    "integrate_variable_step": lambda f, x, dt, t0: ml.integrate_variable_step(
        "JACOBI[EA]", BODY, f, x, density=ml.densities.Spin(BODY.moments, 1.0, 0.1), dt=dt, t0=t0, steps=4
    ),
    "saved often": lambda f, x, dt, t0: ml.integrate("JACOBI[EA]", BODY, f, x, dt=dt, t0=t0, steps=4),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("driver", DRIVERS)
def test_another_call_traces_nothing(driver):
    """With another start, step, first time and number of steps."""
    count = []
    torque = partial(counting, count)
    DRIVERS[driver](torque, STATE, 0.01, 0.0, 7)
    before = len(count)
    assert before > 0
    other = ml.RigidState(2 * STATE.momentum, STATE.attitude)
    for dt, t0, steps in ((0.01, 0.0, 7), (0.02, 0.5, 7), (0.02, 0.5, 10), (-0.01, 1.0, 101)):
        DRIVERS[driver](torque, other, dt, t0, steps)
    assert len(count) == before


@pytest.mark.sample(1)
@pytest.mark.parametrize("driver", FIXED)
def test_a_second_call_with_as_many_steps_traces_nothing(driver):
    count = []
    torque = partial(counting, count)
    FIXED[driver](torque, STATE, 0.01, 0.0)
    before = len(count)
    FIXED[driver](torque, ml.RigidState(2 * STATE.momentum, STATE.attitude), 0.02, 0.5)
    assert len(count) == before > 0


def test_numbers_are_looked_at_in_every_call():
    run = partial(ml.integrate, "SYMMETRIC[EA]", torque=None, dt=0.01, steps=3)
    assert run(body=ml.RigidBody([5.0, 5.0, 1.0]), start=STATE).ok
    assert run(body=ml.RigidBody([5.0, 1.0, 5.0]), start=STATE).ok  # the flight is fitted anew
    with pytest.raises(ValueError, match="two equal moments"):
        run(body=ml.RigidBody([3.0, 2.0, 4.0]), start=STATE)
    nowhere = jax.tree.map(lambda x: jnp.nan * x, STATE)
    with pytest.raises(ValueError, match="start must be finite"):
        run(body=ml.RigidBody([5.0, 5.0, 1.0]), start=nowhere)
    for dt in (0.0, 1e400):
        with pytest.raises(ValueError, match="dt must be finite"):
            run(body=ml.RigidBody([5.0, 5.0, 1.0]), start=STATE, dt=dt)
