"""The hand-written C of benchmarks/limit.c does the work of the package: the same start leads to the same momentum."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark

import midlie_jax as ml
from midlie_jax.cli import scenes

limit = benchmark("limit")

STEPS = 400
# Each value of each choice occurs: numbers of vectors and groups, whose roots, which order of sums.
PAIRS = {
    ("LIEMID", "float64"): limit.Form(1, 1),
    ("LIEMID_EARLY", "float32"): limit.Form(2, 1, hardware_roots=False),
    ("JACOBI", "float64"): limit.Form(1, 8, hardware_roots=False),
    ("JACOBI", "float32"): limit.Form(2, 8),
    ("SYMMETRIC", "float64"): limit.Form(4, 1),
    ("DOP853", "float64"): limit.Form(1, 1, reorders_sums=False),
}


@pytest.mark.sample(1)
@pytest.mark.skipif(not limit.compilers(), reason="`make test` needs no C compiler, and this machine has none")
@pytest.mark.parametrize(("method", "dtype"), PAIRS)
def test_c_program_agrees_with_the_package(method, dtype):
    """To one rounding error a step. The moments differ from each other where the method allows that."""
    name = {"LIEMID_EARLY": "LIEMID"}.get(method, method)
    moments = limit.MOMENTS if name == "SYMMETRIC" else (5.0, 4.5, 1.0)
    program = limit.built(method, dtype, PAIRS[method, dtype], limit.compilers()[0])
    _, momentum = limit.measured(program, bodies=1, steps=STEPS, moments=moments)
    scene = scenes.scene("P1", jnp.dtype(dtype))
    path = ml.integrate(
        name if name == "DOP853" else f"{name}[EA]",
        ml.RigidBody(jnp.array(moments, dtype)),
        ml.torques.HeavyTop(jnp.asarray(limit.WEIGHT, dtype)),
        scene.start,
        dt=limit.DT,
        steps=STEPS,
        save_every=STEPS,
    )
    ours = np.asarray(path.states.momentum[-1], np.float64)
    assert path.ok
    assert np.linalg.norm(momentum - ours) <= STEPS * jnp.finfo(dtype).eps * np.linalg.norm(ours)
