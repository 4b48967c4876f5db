"""The benchmarks: cheap parts run with tiny sizes and print their tables; the C of limit.c does the package's work."""

import sys
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark

import midlie_jax as ml
from midlie_jax.cli import scenes

limit = benchmark("limit")
# Module, table, and the sizes that make it small.
SMALL = {
    ("speed", "OBSERVED"): {"OBSERVED_BODIES": 4, "OBSERVED_STEPS": 2, "TURNS": 1},
    ("spins", "CONSERVATION"): {"CHAIN": 8, "CHAIN_TIME": 1.0, "CHAIN_METHODS": ("SUBLATTICES[EA]",)},
    ("solids", "BAR"): {"CASES": ((1.0, 10),)},
    ("work_precision", "FASTEST"): {},
    ("fits", "SEARCH"): {"SEEDS": ()},
}


@pytest.mark.parametrize(("name", "table"), SMALL)
def test_a_part_prints_its_table(name, table, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "one_core", ModuleType("one_core"))  # which would hold the tests to one core
    module = benchmark(name)
    for constant, value in SMALL[name, table].items():
        monkeypatch.setattr(module, constant, value)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        lines = getattr(module, table).show(write=False)
    assert capsys.readouterr().out.splitlines() == lines
    assert len(lines) > 2 or table == "SEARCH"
    assert len({line.count("|") for line in lines}) == 1


def test_spins_move_as_their_closed_forms_say():
    """A wall is fastest at Walker's field; a skyrmion has the charge -1 and moves across the slope; and the rival
    in JAX is of second order."""
    moving = rivals = benchmark("spins")

    fastest = moving.known(moving.WALKER)
    assert max(moving.known(0.9 * moving.WALKER), moving.known(1.1 * moving.WALKER)) < fastest
    spin = np.asarray(moving.guess(40).spin)
    assert abs(moving.charge(spin) + 1) < 1e-12
    x, y = moving.thiele(spin)
    assert abs(y) > 3 * abs(x) > 0
    found = rivals.measured((8, 8), 1.0, {rivals.JAX: (0.05, 0.025)}, rounds=1, reference=("RK4", 0.01))
    assert 3.7 < found[0].error / found[1].error < 4.3


# Each value of each choice occurs: numbers of vectors and groups, whose roots, which order of sums.
PAIRS = {
    ("LIEMID", "float64"): limit.Form(1, 1),
    ("LIEMID_EARLY", "float32"): limit.Form(2, 1, hardware_roots=False),
    ("JACOBI", "float64"): limit.Form(1, 8, hardware_roots=False),
    ("SYMMETRIC", "float64"): limit.Form(4, 1),
    ("DOP853", "float64"): limit.Form(1, 1, reorders_sums=False),
}


@pytest.mark.skipif(not limit.compilers(), reason="`make test` needs no C compiler, and this machine has none")
@pytest.mark.parametrize(("method", "dtype"), PAIRS)
def test_c_program_agrees_with_the_package(method, dtype):
    """To one rounding error a step. The moments differ from each other where the method allows that."""
    name, steps = {"LIEMID_EARLY": "LIEMID"}.get(method, method), 400
    moments = limit.MOMENTS if name == "SYMMETRIC" else (5.0, 4.5, 1.0)
    program = limit.built(method, dtype, PAIRS[method, dtype], limit.compilers()[0])
    _, momentum = limit.measured(program, bodies=1, steps=steps, moments=moments)
    body, torque = ml.RigidBody(jnp.array(moments, dtype)), ml.torques.HeavyTop(jnp.asarray(limit.WEIGHT, dtype))
    start, run = scenes.scene("P1", jnp.dtype(dtype)).start, {"dt": limit.DT, "steps": steps, "save_every": steps}
    path = ml.integrate(name if name == "DOP853" else f"{name}[EA]", body, torque, start, **run)
    ours = np.asarray(path.states.momentum[-1], np.float64)
    assert path.ok
    assert np.linalg.norm(momentum - ours) <= steps * jnp.finfo(dtype).eps * np.linalg.norm(ours)
