"""The kernels of a step on a GPU, counted on a machine without one.

    make kernels        python benchmarks/kernels.py --write

puts a table into docs/reports/gpu.md. XLA's CUDA compiler needs no GPU: it compiles for
the card that `h200.txtpb` describes (NVIDIA H200), and this file reads the optimised program. A step is counted inside
the loop over steps, without what happens once before and after that loop.

Two kinds of launch are counted: kernels that read or write arrays of the batch, and small kernels for what all bodies
share, such as the counter of the loop. The bytes are those that the kernels of the batch read and write.
"""

import importlib.util
import math
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest import mock

os.environ.setdefault("JAX_SKIP_CUDA_CONSTRAINTS_CHECK", "1")  # the compiler asks for a driver otherwise
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax
import jax.numpy as jnp
from harness import Table, main
from jax.experimental import topologies
from jax.sharding import SingleDeviceSharding

import midlie_jax as ml
from midlie_jax._xla import fusion
from midlie_jax.drivers.arguments import as_method
from midlie_jax.integrators import runge_kutta
from midlie_jax.integrators.base import Method

jax.config.update("jax_enable_x64", True)
CARD = Path(__file__).with_name("h200.txtpb")
BATCH, ITERATIONS = 10007, 37  # numbers that nothing else in the program has

NAMES = (
    *("SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]", "RK4", "DOP853", "GBS12", "AKW"),
    *("JACOBI[SRKN14a]", "SYMMETRIC[SRKN14a]"),
)


_NO_KERNEL = {"parameter", "get-tuple-element", "tuple", "bitcast", "constant", "after-all", "while"}
_BYTES = {"f64": 8, "f32": 4, "s32": 4, "u32": 4, "s64": 8, "u64": 8, "s16": 2, "u16": 2, "s8": 1, "u8": 1, "pred": 1}
_INSTRUCTION = re.compile(r"\s+(?:ROOT )?%?([\w.\-]+) = (\(.*?\)|\S+) ([\w\-]+)\((.*)")


class Launches(NamedTuple):
    """What a part of a program launches: kernels over the batch, others, and bytes that the first read and write."""

    kernels: float
    small: float
    size: float

    def times(self, factor: float) -> "Launches":
        return Launches(*(factor * x for x in self))


class Compiled(NamedTuple):
    """A program for the card: steps in an iteration, launches of a step and bytes a body, seconds, code of kernels."""

    unroll: int
    step: Launches
    seconds: float
    ptx: str


def missing() -> str:
    if any(importlib.util.find_spec(f"jax_cuda{version}_plugin") for version in (12, 13)):
        return ""
    return "XLA's CUDA compiler is not installed: `make kernels` installs it in an environment of its own."


def compiled(method: Method | str, dtype: str, *, cut: bool = True) -> Compiled:
    """A method on heavy tops, compiled for the card.

    A long Runge-Kutta step is `cut`, as the package does, or split as on a CPU, which compiles to nothing on a GPU.
    """
    method = as_method(method)
    moments = jnp.array((5.0, 5.0, 1.0) if method.name.startswith("SYMMETRIC") else (2.0, 3.0, 4.0), dtype)
    torque = ml.torques.HeavyTop(jnp.asarray(20.0, dtype))
    card = SingleDeviceSharding(_card())

    def run(momentum, attitude):
        start = ml.RigidState(momentum, attitude)
        steps = ITERATIONS * turn
        run = {"dt": 0.02, "steps": steps, "save_every": steps}
        return ml.integrate(method, ml.RigidBody(moments), torque, start, **run)

    arguments = [jax.ShapeDtypeStruct((BATCH, size), dtype, sharding=card) for size in (3, 4)]
    jax.clear_caches()  # the package traces another program for a GPU
    began = time.perf_counter()
    with (
        mock.patch.object(jax, "default_backend", return_value="gpu"),
        mock.patch.object(runge_kutta, "cut", fusion.cut if cut else fusion.split),
        tempfile.TemporaryDirectory() as folder,
    ):
        turn = method.unroll
        lowered = jax.jit(jax.vmap(run), out_shardings=card).lower(*arguments)
        program = lowered.compile(compiler_options={"xla_backend_optimization_level": 3, "xla_dump_to": folder})
        ptx = "".join(file.read_text() for file in sorted(Path(folder).glob("*.ptx")))
    seconds = time.perf_counter() - began
    jax.clear_caches()
    launches = _loop_over_steps(_computations(program.as_text()))
    return Compiled(turn, launches.times(1 / turn)._replace(size=launches.size / turn / BATCH), seconds, ptx)


def coupled(count: int) -> str:
    def energy(t, state):
        apart = state.position[:, None] - state.position[None]
        return jnp.sum(1 / jnp.sqrt(1 + jnp.sum(apart * apart, axis=-1)))

    def run(*arrays):
        body, torque = ml.FreeBody(ml.RigidBody([1.0, 1.2, 1.5]), 1.0), ml.torques.FromPotential(energy)
        steps = {"dt": 0.02, "steps": ITERATIONS, "save_every": ITERATIONS}
        return ml.integrate("JACOBI[EA]", body, torque, ml.CoupledState(*arrays), **steps)

    card = SingleDeviceSharding(_card())
    arguments = [jax.ShapeDtypeStruct((count, size), "float64", sharding=card) for size in (3, 4, 3, 3)]
    jax.clear_caches()  # the package traces another program for a GPU
    with mock.patch.object(jax, "default_backend", return_value="gpu"):
        text = jax.jit(run, out_shardings=card).lower(*arguments).compile().as_text()
    jax.clear_caches()
    return text or ""


def _card():
    target = CARD.read_text()
    topology = topologies.get_topology_desc("h200", platform="cuda", target_config=target, topology="1x1x1")
    return topology.devices[0]


def _computations(text: str) -> dict[str, list[tuple[str, ...]]]:
    """The instructions of each computation of an optimised program, as (name, shape, operation, rest)."""
    found: dict[str, list[tuple[str, ...]]] = {}
    current = None
    for line in text.splitlines():
        if header := re.match(r"(?:ENTRY )?%?([\w.\-]+) \(.*\{$", line):
            current = found.setdefault(header[1], [])
        elif line.startswith("}"):
            current = None
        elif current is not None and (instruction := _INSTRUCTION.match(line)):
            current.append(instruction.groups())
    return found


def _loop_over_steps(computations) -> Launches:
    for instructions in computations.values():
        for _, _, operation, rest in instructions:
            if operation == "while" and _turns(rest) == ITERATIONS:
                return _launches(computations, _body(rest))
    raise ValueError(f"no loop of {ITERATIONS} turns in the program")


def _launches(computations, name: str) -> Launches:
    total, shapes = [Launches(0, 0, 0)], {}
    for result, shape, operation, rest in computations[name]:
        shapes[result] = shape
        if operation == "while":
            total.append(_launches(computations, _body(rest)).times(_turns(rest)))
        elif operation not in _NO_KERNEL:
            operands = re.findall(r"%([\w.\-]+)", rest.split("),")[0])
            size = _size(shape) + sum(_size(shapes.get(operand, "")) for operand in operands)
            total.append(Launches(1, 0, size) if size >= BATCH else Launches(0, 1, 0))
    return Launches(*map(sum, zip(*total, strict=True)))


def _body(rest: str) -> str:
    return re.search(r"body=%?([\w.\-]+)", rest)[1]


def _turns(rest: str) -> int:
    """How many turns a loop takes. A loop that does not say it would ask the host before each turn: there is none."""
    return int(re.search(r'"known_trip_count":\{"n":"(\d+)"', rest)[1])


def _size(shape: str) -> int:
    arrays = re.findall(r"(\w+)\[([\d,]*)\]", shape)
    return sum(_BYTES[kind] * math.prod(map(int, filter(None, sizes.split(",")))) for kind, sizes in arrays)


def rows() -> Iterator[list[str]]:
    if missing():
        sys.exit(missing())
    for name in NAMES:
        for dtype in ("float32", "float64"):
            found = compiled(name, dtype)
            kernels, small, size = (f"{x:.4g}" for x in found.step)
            yield [name, dtype, str(found.unroll), f"{kernels} + {small}", size, f"{found.seconds:.0f} s"]


TABLE = Table(
    *("reports/gpu.md", "kernels"),
    ("method", "dtype", "steps per iteration", "launches per step", "bytes per body-step", "compile"),
    *(rows, "gpu-kernels", lambda row: row[1] == "float32", (0, 2, 3, 4)),
)

if __name__ == "__main__":
    main(__doc__, TABLE)
