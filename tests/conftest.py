"""Settings of every test, made before anything else is imported.

float64 on; mixed dtypes and silent broadcasting over ranks are errors. Nothing here imports midlie_jax: the type
checkers that pytest attaches to the package (see pyproject.toml) come after this file.
"""

import gc
import os
import shutil
import subprocess
import sys
import time
import zlib
from collections import Counter
from itertools import count
from pathlib import Path

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


def known(flags):
    """Those that the installed XLA knows; given others, it ends a process and names them."""
    start = [sys.executable, "-c", "import jax; jax.devices()"]
    done = subprocess.run(start, env=os.environ | {"XLA_FLAGS": " ".join(flags)}, capture_output=True, text=True)
    return [flag for flag in flags if done.returncode == 0 or flag not in done.stderr]


def pytest_addoption(parser):
    parser.addoption("--accelerator", action="store_true", help="run on an accelerator; fail without one")
    parser.addoption("--sample", action="store_true", help="of a law marked sample(n) its first n parameters")
    parser.addoption("--rest", action="store_true", help="what --sample leaves out")
    parser.addoption(
        "--begin", type=int, metavar="N", help="begin with every third file, from the one of number N mod 3"
    )
    parser.addoption("--minutes", type=float, metavar="N", help="skip the tests that would begin after N minutes")


def pytest_configure(config):
    gc.disable()  # see collected_once_a_module
    if config.option.accelerator:
        if jax.default_backend() == "cpu":
            raise pytest.UsageError("JAX sees no accelerator here; bring its programs: pip install 'jax[cuda13]'.")
        print(f"JAX {jax.__version__} on {jax.devices()[0].device_kind}")
        return
    # XLA's CUDA compiler, which test_kernels.py uses without a GPU, must not look for a driver. JAX reads this once, at
    # the first computation of the process, which may be that of another test.
    os.environ.setdefault("JAX_SKIP_CUDA_CONSTRAINTS_CHECK", "1")
    if config.option.markexpr == "not full" and "XLA_FLAGS" not in os.environ:
        os.environ["XLA_FLAGS"] = " ".join(known(HURRIED))
    quiet = jax.__version_info__ >= (0, 12)  # earlier versions report an error for a program that they load
    if quiet and config.option.markexpr == "not full" and config.pluginmanager.has_plugin("cacheprovider"):
        remember_programs(config.cache.mkdir("programs"))


def remember_programs(folder):
    """Has JAX load a program that it compiled in an earlier run; the name of its file is a hash of its HLO and options.

    `pytest --cache-clear` forgets them.
    """
    if sum(path.stat().st_size for path in folder.iterdir()) > MOST_REMEMBERED:
        shutil.rmtree(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


# Files whose laws read the same compiled runs; the others are one group each.
TOGETHER = {"test_inputs": "test_laws"}
# Files that only `make test-rest` runs: pictures and pages of motion, the laboratory, published cases, and
# the applications, whose states, torques and baths are also in the law of paths.
REST = {
    *("test_plot", "test_view", "test_charts", "test_benchmarks", "test_oracles", "test_own_methods"),
    *("test_molecules", "test_molecule_files", "test_shadows", "test_spacecraft", "test_spins"),
}
RELEASE = {"test_docs", "test_release"}  # what `make test` leaves out of them, `make test-release` runs
BEGAN = time.time()
MOST_REMEMBERED = 2e9  # bytes of compiled programs
# Linux gives a process 65530 maps of memory (vm.max_map_count), each compiled loop takes three, and XLA, given no more,
# ends the process with a segmentation fault.
MOST_MAPS = 30_000


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node):
    """All workers go by one clock, also the one that takes the place of a worker that crashed."""
    node.workerinput["began"] = BEGAN


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A group of files is one worker's, so that a program that it needs twice is compiled once.

    `--dist loadgroup` of xdist 3.8 would do this by writing the group into `item._nodeid` (xdist/remote.py), which
    pytest 9.2 does not read.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group_of(nodeid)

    return Groups(config, log)


def group_of(nodeid):
    """The file; of the law of paths and of the pages of docs, which take long, a tenth of the scenes or pages."""
    file, _, parameters = nodeid.partition("[")
    stem = Path(file.partition("::")[0]).stem
    if stem in ("test_paths", "test_docs"):
        return f"{stem} {zlib.crc32(parameters.partition('-')[0].rstrip(']').encode()) % 10}"
    return TOGETHER.get(stem, stem)


def pytest_ignore_collect(collection_path, config):
    """What only `make test-rest` runs is not even imported."""
    return True if config.option.sample and collection_path.stem in REST else None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """With `--sample` the set of `make test`: of each law marked `sample(n)` the first n; with `--rest` the others."""
    if not (config.option.sample or config.option.rest):
        return
    seen, chosen = Counter(), []
    for item in items:
        law, marker = item.nodeid.partition("[")[0], item.get_closest_marker("sample")
        seen[law] += 1
        sampled = item.path.stem not in REST and (marker is None or seen[law] <= marker.args[0])
        chosen.append(sampled == config.option.sample and (sampled or item.path.stem not in RELEASE))
    config.hook.pytest_deselected(items=[item for item, own in zip(items, chosen, strict=True) if not own])
    items[:] = [item for item, own in zip(items, chosen, strict=True) if own]
    if config.option.begin is not None:
        # Three values of N that follow each other begin with all groups of files.
        number = {group: n for n, group in enumerate(dict.fromkeys(group_of(item.nodeid) for item in items))}
        items.sort(
            key=lambda item: ((number[group_of(item.nodeid)] - config.option.begin) % 3, number[group_of(item.nodeid)])
        )


def pytest_runtest_setup(item):
    limit, began = item.config.option.minutes, getattr(item.config, "workerinput", {"began": BEGAN})["began"]
    if limit is not None and time.time() - began > 60 * limit:
        pytest.skip(f"{limit:g} minutes are over")


TESTS = count(1)  # of this process, that have ended


def pytest_runtest_teardown():
    if next(TESTS) % 16 == 0:
        leave_maps_of_memory()


def leave_maps_of_memory():
    """Forgets compiled programs before the process has no more maps of memory; to count these takes up to 30 ms."""
    if maps_of_memory() > MOST_MAPS:
        jax.clear_caches()
        gc.unfreeze()  # what refers to programs in a circle is collected, too
        gc.collect()


def maps_of_memory():
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:  # not Linux
        return 0


@pytest.fixture(scope="module", autouse=True)
def collected_once_a_module():
    """Tracing leaves a million objects behind that live on; Python would look through all of them again and again."""
    gc.collect()
    gc.freeze()


jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
