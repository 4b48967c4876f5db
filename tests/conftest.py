"""Settings of every test, made before anything else is imported.

float64 on; mixed dtypes and silent broadcasting over ranks are errors. Nothing here imports midlie_jax: the type
checkers that pytest attaches to the package (see pyproject.toml) come after this file.
"""

import gc
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import budget
import jax
import pytest

# Compiled in a hurry, in a third of the time, on CPUs. What is held to rounding asks for the code that users get,
# `cases.REAL`; the whole matrix (-m full) and accelerators run nothing else. `test_shard_map.py` gives its process
# flags of its own.
HURRIED = (
    "--xla_backend_optimization_level=0",
    "--xla_cpu_use_fusion_emitters=false",  # unknown to the XLA of jax 0.12
    "--xla_cpu_parallel_codegen_split_count=1",
)


def known(flag):
    """Whether the installed XLA has this flag; it ends a process that is given another."""
    start = [sys.executable, "-c", "import jax; jax.devices()"]
    return subprocess.run(start, env=os.environ | {"XLA_FLAGS": flag}, capture_output=True).returncode == 0


def pytest_addoption(parser):
    parser.addoption("--accelerator", action="store_true", help="run on an accelerator; fail without one")
    parser.addoption(
        "--budget", type=float, metavar="SECONDS", help="run what takes this processor time, see budget.py"
    )
    parser.addoption("--part", metavar="K/N", help="run part K, counted from 1, of N of about the same cost")
    parser.addoption("--costs", action="store_true", help="keep the processor time of each test in costs.json")


def pytest_configure(config):
    if config.option.accelerator:
        if jax.default_backend() == "cpu":
            raise pytest.UsageError("JAX sees no accelerator here; bring its programs: pip install 'jax[cuda13]'.")
        print(f"JAX {jax.__version__} on {jax.devices()[0].device_kind}")
        return
    # XLA's CUDA compiler, which test_kernels.py uses without a GPU, must not look for a driver. JAX reads this once, at
    # the first computation of the process, which may be that of another test.
    os.environ.setdefault("JAX_SKIP_CUDA_CONSTRAINTS_CHECK", "1")
    if config.option.markexpr == "not full" and "XLA_FLAGS" not in os.environ:
        os.environ["XLA_FLAGS"] = " ".join(filter(known, HURRIED))


# Files whose laws read the same compiled runs; the others are one group each.
TOGETHER = {"test_runs": "test_laws", "test_inputs": "test_laws"}
WHOLE = {"test_docs", "test_shard_map"}  # what they compute, in a process of its own, is one whole
MEASURED: dict[str, float] = {}  # processor seconds of the tests that have run
TEST, START = pytest.StashKey[budget.Test](), pytest.StashKey[float]()


def group_of(name):
    """The group of a node id."""
    stem = Path(name.partition("::")[0]).stem
    return TOGETHER.get(stem, stem)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A group is one worker's, so that a program that it needs twice is compiled once.

    `--dist loadgroup` promises this; but xdist 3.8 with pytest 9.2 spreads the tests of a group over the workers.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group_of(nodeid)

    return Groups(config, log)


def pytest_itemcollected(item):
    item.stash[TEST] = budget.Test.of(item.nodeid, group_of(item.nodeid), item.path.stem in WHOLE)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Leaves out what `--budget` and `--part` do not choose; the most expensive files come first."""
    costs, tests = budget.known_costs(), [item.stash[TEST] for item in items]
    names = {test.name for test in tests}
    if config.option.part:
        which, parts = map(int, config.option.part.split("/"))
        names &= budget.part(tests, costs, which - 1, parts)
    if config.option.budget:
        names &= budget.chosen(tests, costs, config.option.budget)
    config.hook.pytest_deselected(items=[item for item in items if item.stash[TEST].name not in names])
    groups = Counter()
    for test in tests:
        groups[test.unit[0]] += costs.get(test.name, 0.0) * (test.name in names)
    items[:] = sorted(
        (item for item in items if item.stash[TEST].name in names), key=lambda item: -groups[item.stash[TEST].unit[0]]
    )


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    item.stash[START] = budget.processor_time()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item):
    cost = budget.processor_time() - item.stash[START]
    item.user_properties.append((budget.COST, (item.stash[TEST].name, cost)))


def pytest_runtest_logreport(report):
    if report.when == "teardown":
        name, cost = dict(report.user_properties)[budget.COST]
        MEASURED[name] = cost


def pytest_sessionfinish(session):
    if session.config.option.costs and not hasattr(session.config, "workerinput"):
        budget.keep_costs(MEASURED)


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
