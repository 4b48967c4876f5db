"""A million tumbling bodies: the cost of writing a run to a file, of spreading it over devices, and its memory.

    python benchmarks/ensembles.py [--bodies 1000000] [--steps 1000] [--write]

Each row of the table is measured in a process of its own, which runs everything twice and reports the second time, when
all is compiled. `--write` puts the tables into docs/reports/speed.md.
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from harness import Table, main

EVERY = 100
ROUNDS = 3
NAMES = {"ensemble": "`ensemble`", "by hand": "`ensemble`, then `numpy.save`", "simulate": "`simulate`"}
SAVED = {
    "ensemble": "the end, in memory",
    "by hand": f"every {EVERY} steps, .npy",
    "simulate": f"every {EVERY} steps, .zarr",
}


class Cost(NamedTuple):
    """Of one run, all compiled: wall time and processor time in seconds, and the largest memory in bytes."""

    wall: float
    processor: float
    memory: float


def run_once(kind: str, bodies: int, steps: int, devices: int) -> None:
    """Prints the cost of the second of two runs of this process as JSON."""
    import resource

    import jax
    import jax.numpy as jnp
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    import midlie_jax as ml

    random = np.random.default_rng(0)
    attitudes = random.normal(size=(bodies, 4))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    start = ml.RigidState(jnp.asarray(random.normal(size=(bodies, 3))), jnp.asarray(attitudes))
    body = ml.RigidBody(jnp.array([2.0, 3.0, 4.0]))
    mesh = jax.make_mesh((devices,), ("bodies",)) if devices > 1 else None
    folder = Path(tempfile.mkdtemp())

    def run(k: int) -> Any:
        given: dict[str, Any] = {"dt": 0.05, "steps": steps, "mesh": mesh}
        if kind == "ensemble":
            return jax.block_until_ready(ml.ensemble("JACOBI[EA]", body, None, start, **given))
        out = folder / f"{k}.zarr"
        if kind == "by hand":
            path = ml.ensemble("JACOBI[EA]", body, None, start, save_every=EVERY, **given)
            out.mkdir()
            for i, saved in enumerate(jax.tree.leaves(path.states)):
                np.save(out / f"{i}.npy", saved)
        else:
            ml.simulate("JACOBI[EA]", body, None, start, out=out, save_every=EVERY, progress=False, **given)
        shutil.rmtree(out)
        return None

    try:
        run(0)
        wall, processor = time.perf_counter(), time.process_time()
        run(1)
        cost = time.perf_counter() - wall, time.process_time() - processor
    finally:
        shutil.rmtree(folder)
    print(json.dumps([*cost, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss]))


def measured(kind: str, bodies: int, steps: int, devices: int) -> Cost:
    flags = f"--xla_force_host_platform_device_count={devices}"
    command = [sys.executable, __file__, "--run", kind, "--bodies", str(bodies), "--steps", str(steps)]
    command += ["--devices", str(devices)]
    environment = os.environ | {"XLA_FLAGS": flags}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return Cost(*json.loads(done.stdout.splitlines()[-1]))


HEADS = (
    *("run", "states saved", "million body-steps per second", "over `ensemble`"),
    *("processor time per body-step, ns", "largest memory, MB"),
)
MILLION = Table("reports/speed.md", "million", HEADS)


def million(options: Any) -> None:
    bodies, steps = options.bodies, options.steps
    if options.run:
        run_once(options.run, bodies, steps, options.devices)
        return
    kinds = [("ensemble", 1), ("by hand", 1), ("simulate", 1), ("simulate", 2), ("simulate", 4)]
    costs: dict[tuple[str, int], list[Cost]] = {kind: [] for kind in kinds}
    for _ in range(ROUNDS):
        for kind in kinds:
            costs[kind].append(measured(kind[0], bodies, steps, kind[1]))
            print(*kind, costs[kind][-1], flush=True)
    found = {kind: Cost(*map(statistics.median, zip(*costs[kind], strict=True))) for kind in kinds}
    bare = found["ensemble", 1]
    rows = [
        [
            *(NAMES[kind] + (f", {devices} devices" if devices > 1 else ""), SAVED[kind]),
            *(f"{bodies * steps / cost.wall / 1e6:.1f}", f"{bare.wall / cost.wall:.2f}"),
            *(f"{cost.processor / (bodies * steps) * 1e9:.1f}", f"{cost.memory / 1e6:.0f}"),
        ]
        for (kind, devices), cost in found.items()
    ]
    MILLION.show(options.write, rows)


ARGUMENTS = {
    "--bodies": {"type": int, "default": 1_000_000},
    "--steps": {"type": int, "default": 1000},
    "--run": {"choices": list(NAMES), "help": "only one run, in this process"},
    "--devices": {"type": int, "default": 1},
}

if __name__ == "__main__":
    main(__doc__, million, ARGUMENTS)
