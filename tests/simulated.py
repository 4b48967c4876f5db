"""The run of `test_simulate.py`; as a program, that run in a process of its own: to be killed, or one of several.

    python tests/simulated.py OUT [--devices N] [--process I --processes N --port P] [--torn N]

With `--torn` it is killed in the middle of its N-th file of values, half of which is then there.
"""

import argparse
import itertools
import os
import signal
import sys
from pathlib import Path

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--devices", type=int, default=1)
    parser.add_argument("--process", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--port", type=int)
    parser.add_argument("--torn", type=int)
    options = parser.parse_args()
    os.environ["XLA_FLAGS"] = f"--xla_force_host_platform_device_count={options.devices}"  # and no others

import conftest  # noqa: F401  (float64)
import jax
import jax.numpy as jnp
import numpy as np
import zarr.storage

import midlie_jax as ml

BODIES, STEPS, EVERY = 50, 240, 10  # 25 saved states
RNG = np.random.default_rng(11)
WEIGHTS = RNG.uniform(1, 2, BODIES)
MOMENTS = np.tile([2.0, 2.0, 1.0], (BODIES, 1)) * RNG.uniform(0.9, 1.1, (BODIES, 1))
MOMENTA = RNG.normal(size=(BODIES, 3))
ATTITUDES = RNG.normal(size=(BODIES, 4))
ATTITUDES /= np.linalg.norm(ATTITUDES, axis=1, keepdims=True)


def simulated(out, *, momenta=MOMENTA, method="SYMMETRIC[EA]", torque=None, start=None, **options):
    body = ml.RigidBody(jnp.asarray(MOMENTS))
    start = ml.RigidState(jnp.asarray(momenta), jnp.asarray(ATTITUDES)) if start is None else start
    torque = ml.torques.HeavyTop(jnp.asarray(WEIGHTS)) if torque is None else torque
    given = {"dt": 0.05, "steps": STEPS, "save_every": EVERY, "progress": False}
    cut = {"group": 16, "span": 8, "chunk": 4}  # groups of 16, 16, 16 and 2 bodies; spans of 8, 8, 8 and 1 saved states
    return ml.simulate(method, body, torque, start, out=out, **{**given, **cut, **options})


def tear(number):
    count, whole = itertools.count(1), zarr.storage.LocalStore.set

    async def written(self, key, value):
        if "/c" in key and next(count) == number:  # a chunk
            await whole(self, key, value[: len(value) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        await whole(self, key, value)

    zarr.storage.LocalStore.set = written


def main():
    if options.torn:
        tear(options.torn)
    if options.processes > 1:
        jax.distributed.initialize(f"localhost:{options.port}", options.processes, options.process)
    mesh = jax.make_mesh((len(jax.devices()),), ("bodies",)) if len(jax.devices()) > 1 else None
    simulated(options.out, resume=True, mesh=mesh, progress=lambda work: print(work, flush=True))


if __name__ == "__main__":
    sys.exit(main())
