"""Compares the speed of this checkout with that of another commit in one run: the cost or gain of a change.

    git worktree add --detach ../before COMMIT
    python benchmarks/against.py ../before

Speed of the methods on the fast top P1, batch 4096, on one core in processor time, float64 and float32. One process for
each checkout compiles and keeps all programs. The two processes run alternately, so that a change of the speed of the
machine affects both.
"""

import os
import time
from pathlib import Path

from harness import ROOT, Served, asked_in_turn, main, requests, shown

BATCH, STEPS, REPEATS = 4096, 100, 7


def named():
    """The methods for rigid bodies of this checkout."""
    from midlie_jax.integrators.registry import ENTRIES
    from midlie_jax.model.bodies import RigidBody

    return [name for name, entry in ENTRIES.items() if issubclass(RigidBody, entry.method.bodies)]


def serve():
    """For each line of the input, times the program that it names and prints seconds a body-step."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_x64", True)

    import midlie_jax as ml

    # By public names alone, which the other checkout has, too.
    tilts = 0.05 + 1e-3 * np.random.default_rng(0).standard_normal(BATCH)
    attitudes = np.stack([np.cos(tilts / 2), np.sin(tilts / 2), 0 * tilts, 0 * tilts], axis=1)
    momenta = np.tile([0.0, 0.0, 50.0], (BATCH, 1))
    compiled = {}
    print(Path(ml.__file__).parent.parent, flush=True)
    for key in requests():
        name, dtype = key
        if key not in compiled:
            body = ml.RigidBody(np.array([5.0, 5.0, 1.0], dtype))
            torque = ml.torques.HeavyTop(np.array(20.0, dtype))
            many = ml.RigidState(momenta.astype(dtype), attitudes.astype(dtype))

            def run(start, name=name, body=body, torque=torque):
                return ml.integrate(name, body, torque, start, dt=0.005, steps=STEPS, save_every=STEPS)

            compiled[key] = jax.jit(jax.vmap(run)), many
            jax.block_until_ready(compiled[key][0](many))
        program, many = compiled[key]
        began = time.process_time()
        jax.block_until_ready(program(many))
        print((time.process_time() - began) / (BATCH * STEPS), flush=True)


def of_checkout(folder):
    """The process that times the programs of a checkout in a folder."""
    process = Served(__file__, {**os.environ, "PYTHONPATH": str(folder)}, folder)
    imported = Path(process.line())
    if imported != Path(folder).resolve():
        raise SystemExit(f"{folder} is not a checkout of midlie_jax: Python imported it from {imported}.")
    return process


def compare(options):
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    shown(["method", "dtype", "before", "after, M body-steps/s", "time after / before"], rows(options.other))


def rows(other):
    before, after = of_checkout(other), of_checkout(ROOT)
    for name in named():
        for dtype in ("float64", "float32"):
            old, new, ratio = asked_in_turn((before, after), (name, dtype), REPEATS)
            yield [name, dtype, f"{1e-6 / old:.1f}", f"{1e-6 / new:.1f}", f"{ratio:.2f}"]


if __name__ == "__main__":
    main(__doc__, compare, {"other": {"type": Path, "help": "a folder with another commit checked out"}}, serve=serve)
