"""What XLA's CUDA compiler makes of a step, for an H200 and without one: kernels, bytes, and how they round."""

import re

import pytest
from cases import benchmark

from midlie_jax.integrators.runge_kutta import Extrapolation, RungeKutta

kernels = benchmark("kernels")

if kernels.missing():
    pytest.skip(kernels.missing(), allow_module_level=True)

# Momentum, attitude, the force that is kept and `ok`; HeavyTop has no force along its axis.
NUMBERS = {"SYMMETRIC[EA]": 9, "JACOBI[EA]": 9, "LIEMID[EA]": 9, "RK4": 7}
FUSED_OR_ROUGH = r"\bfma\.|\.approx|\.full|\bcall\b"


@pytest.mark.parametrize(
    ("name", "dtype"),
    [("SYMMETRIC[EA]", "float32"), ("JACOBI[EA]", "float64"), ("LIEMID[EA]", "float32"), ("RK4", "float64")],
)
def test_a_turn_of_the_loop_is_one_kernel_that_reads_and_writes_the_state(name, dtype):
    compiled = kernels.compiled(name, dtype)
    turn = compiled.step.times(compiled.unroll)
    state = 2 * NUMBERS[name] * int(dtype[-2:]) // 8
    assert turn.kernels == 1
    assert turn.small <= 2
    assert state <= turn.size <= state + 3
    # No multiply-add with one rounding, no rough division or root: the results are those of a CPU.
    assert not re.search(FUSED_OR_ROUGH, compiled.ptx)


@pytest.mark.parametrize(("levels", "share"), [(6, 0.7), (7, 1 / 3)])
def test_a_long_step_is_cut_where_little_has_to_be_kept(levels, share):
    """GBS12, which XLA alone divides in two, and the same of order 14, of which it repeats much."""
    method = RungeKutta(f"GBS{2 * levels}", Extrapolation(levels, 5.0))
    cut, uncut = (kernels.compiled(method, "float32", cut=cut).step for cut in (True, False))
    assert cut.kernels <= 4
    assert cut.size <= share * uncut.size


def test_the_function_of_many_bodies_is_compiled_once_and_waits_for_no_predicate():
    """On a GPU it stands between barriers: a conditional would bring its predicate to the host in every step."""
    text = kernels.coupled(216)
    assert " conditional(" not in text
    sums = re.findall(r"input_reduce_fusion[\w.\-]* = f64\[216,3\]\S* fusion\(", text)
    assert 2 <= len(sums) <= 4  # over the pairs, before the first step and in each
