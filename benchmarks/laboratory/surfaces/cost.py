"""What a step with sunlight costs, beside one without and a loop in C over the same facets and bodies."""

import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import limit
import numpy as np

import midlie_jax as ml
from midlie_jax._math import components as cp
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.advice.timing import timed_in_turn

SOURCE = Path(limit.__file__).parent / "facets.c"
FACETS, BODIES, CHUNK = 980, 10_000, 2000
HEADS = (
    "facets", "dtype", "C, ps", "additional time, ps", "ratio", "loops over bodies", "memory, bytes a body",
    "gradient / step", "its memory",
)  # fmt: skip
_STEPS, _ROUNDS = 20, 5
_TYPES = {"float64": ("double", "long long"), "float32": ("float", "int")}


def scene(facets: int, dtype: Any) -> tuple[Any, Any, Any]:
    """A body off the centre of an ellipsoid in sunlight, and random states of it."""
    random = np.random.default_rng(0)
    surface = ml.Surface.ellipsoid([3.0, 2.0, 1.0], facets).moved([0.1, 0.2, -0.3])
    surface = surface if facets > 6 else ml.Surface.box([3.0, 2.0, 1.0]).moved([0.1, 0.2, -0.3])
    torque = ml.torques.Sunlight(surface, [0.48, 0.6, 0.64], 1e-3, 0.2, 0.3, 0.5, speed_of_light=1.0)
    attitude = random.normal(size=(BODIES, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    start = ml.RigidState(jnp.asarray(random.normal(size=(BODIES, 3)), dtype), jnp.asarray(attitude, dtype))
    cast: Any = jax.tree.map(lambda x: x.astype(dtype), (ml.RigidBody([1.0, 1.8, 2.3]), torque))
    return *cast, start


def in_c(facets: int, dtype: str) -> Callable[[], float]:
    """A function that returns the seconds of one torque on all bodies, by the fastest form; it agrees with ours."""
    _, torque, start = scene(facets, jnp.dtype(dtype))
    table = np.stack(torque._columns()[:-1], axis=1)
    sun = np.stack(start.seen_from_body(cp.vector(torque.direction)))
    folder = Path(tempfile.mkdtemp(prefix="midlie-facets-"))
    (folder / "numbers").write_bytes(table.tobytes() + sun.tobytes())
    ours = np.asarray(torque(0.0, jax.tree.map(lambda x: x[0], start))) / -1e-3
    programs = []
    for compiler in limit.compilers():
        for vectors in (1, 2, 4):
            program = folder / f"facets-{len(programs)}"
            names = dict(zip(("REAL", "INTEGER"), _TYPES[dtype], strict=True)) | {"VECTORS": vectors}
            flags = [*limit.FLAGS, *limit.extra_flags(compiler), *(f"-D{k}={v}" for k, v in names.items())]
            subprocess.run([compiler, *flags, "-o", str(program), str(SOURCE)], check=True)
            programs.append(program)

    def seconds(program: Path) -> float:
        command = [str(program), str(folder / "numbers"), *map(str, (len(table), BODIES, 5))]
        words = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        difference = np.abs(np.array(words[1:], float) - ours).max()
        assert difference < (1e-11 if dtype == "float64" else 1e-2) * max(1, np.abs(ours).max())
        return float(words[0])

    fastest = min(programs, key=seconds)
    return lambda: seconds(fastest)


def _program(facets: int, dtype: Any, lit: bool) -> tuple[Any, Callable[[], Any]]:
    body, torque, start = scene(facets, dtype)

    def run(start: Any) -> Any:
        options: Any = {"dt": jnp.asarray(0.01, dtype), "steps": _STEPS, "chunk": CHUNK}
        return ml.ensemble("JACOBI[EA]", body, torque if lit else None, start, **options).states.momentum

    program = jax.jit(run, compiler_options=compiler_options(CHUNK)).lower(start).compile()
    return program, lambda: jax.block_until_ready(program(start))


def _gradient(facets: int, dtype: Any) -> tuple[Any, Callable[[], Any]]:
    body, torque, start = scene(facets, dtype)

    def end(start: Any) -> Any:
        options: Any = {"dt": jnp.asarray(0.01, dtype), "steps": _STEPS, "chunk": CHUNK}
        return jnp.sum(ml.ensemble("JACOBI[EA]", body, torque, start, **options).states.momentum[:, -1] ** 2)

    program = jax.jit(jax.grad(end), compiler_options=compiler_options(CHUNK)).lower(start).compile()
    return program, lambda: jax.block_until_ready(program(start))


def loops(program: Any) -> int:
    """The most fused loops over the bodies of a chunk in a loop over blocks of facets."""
    text = program.as_text()
    parts = {part.split()[0].lstrip("%"): part for part in re.split(r"\n}\n+", text) if part.split()}
    bodies = [parts[name] for name in set(re.findall(r"body=%?([\w.\-]+)", text))]
    return max(len(re.findall(rf"\[{CHUNK}\].* fusion\(", body)) for body in bodies if "[16,11]" in body)


def rows() -> Iterator[list[str]]:
    for facets in (FACETS, 80):
        for dtype in _TYPES:
            c = in_c(facets, dtype)
            (step, run), (_, dark), (gradient, slope) = (
                _program(facets, jnp.dtype(dtype), True),
                _program(facets, jnp.dtype(dtype), False),
                _gradient(facets, jnp.dtype(dtype)),
            )
            least = min(c() for _ in range(_ROUNDS))
            timings = timed_in_turn([run, dark, slope], least=_ROUNDS, most=_ROUNDS)
            lit, free, back = (timing.seconds / _STEPS for _, timing in timings)
            # A run of n steps evaluates n + 1 torques.
            own = (lit - free) * _STEPS / (_STEPS + 1)
            count = 1e-12 * facets * BODIES
            bytes_of = [p.memory_analysis().temp_size_in_bytes / BODIES for p in (step, gradient)]
            yield [
                str(facets), dtype, f"{least / count:.0f}", f"{own / count:.0f}", f"{own / least:.2f}",
                str(loops(step)), f"{bytes_of[0]:.0f}", f"{back / lit:.1f}", f"{bytes_of[1]:.0f}",
            ]  # fmt: skip
