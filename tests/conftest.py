"""Settings of every test, made before anything else is imported.

float64 on; mixed dtypes and silent broadcasting over ranks are errors. Nothing here imports midlie_jax: the type
checkers that pytest attaches to the package (see pyproject.toml) come after this file.
"""

import gc
import os
import subprocess
import sys

import jax
import pytest

# Compiled in a hurry, in a third of the time, on CPUs. What is held to rounding asks for the code that users get,
# `cases.REAL`; the whole matrix (-m full) and accelerators run nothing else. `test_shard_map.py` gives its process
# flags of its own.
HURRIED = (
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)


def known(flags):
    """Whether the installed XLA has them; it ends a process that is given others."""
    start = [sys.executable, "-c", "import jax; jax.devices()"]
    return subprocess.run(start, env=os.environ | {"XLA_FLAGS": flags}, capture_output=True).returncode == 0


def pytest_addoption(parser):
    parser.addoption("--accelerator", action="store_true", help="run on an accelerator; fail without one")


def pytest_configure(config):
    if config.option.accelerator:
        if jax.default_backend() == "cpu":
            raise pytest.UsageError("JAX sees no accelerator here; bring its programs: pip install 'jax[cuda13]'.")
        print(f"JAX {jax.__version__} on {jax.devices()[0].device_kind}")
        return
    # XLA's CUDA compiler, which test_kernels.py uses without a GPU, must not look for a driver. JAX reads this once, at
    # the first computation of the process, which may be that of another test.
    os.environ.setdefault("JAX_SKIP_CUDA_CONSTRAINTS_CHECK", "1")
    if config.option.markexpr == "not full" and "XLA_FLAGS" not in os.environ and known(HURRIED):
        os.environ["XLA_FLAGS"] = HURRIED


# Files whose laws read the same compiled runs; the others are one group each. For `pytest --dist loadgroup`.
TOGETHER = {"test_runs": "test_laws", "test_inputs": "test_laws"}


def pytest_itemcollected(item):
    """Before xdist reads the groups, which it does first of all once everything is collected."""
    item.add_marker(pytest.mark.xdist_group(TOGETHER.get(item.path.stem, item.path.stem)))


@pytest.fixture(scope="module", autouse=True)
def collected_once_a_module():
    """Tracing leaves a million objects behind that live on; Python would look through all of them again and again."""
    gc.collect()
    gc.freeze()
    gc.disable()
    yield
    gc.enable()


jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
