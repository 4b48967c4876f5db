"""The speed limit, hand-written C: builds `limit.c` with the machine's own compiler and times it.

    python benchmarks/limit.py      prints body-steps a second for each method, dtype and number of vectors, on one core

The polynomials of midlie_jax are written to a header. The best number of vectors that are computed at once is measured.
"""

import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import jax.numpy as jnp

from midlie_jax._kernel import short_series
from midlie_jax.methods.flights import lie_midpoint

SOURCE = Path(__file__).with_name("limit.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp", "-std=gnu11", "-Wno-psabi")


def header(dtype: str, vectors: int) -> str:
    rough = short_series.FEW_ARCTANGENT[dtype]
    terms = short_series.TERMS[dtype]
    tables = {
        "ARCTANGENT": short_series.ARCTANGENT[dtype],
        "ROUGH_ARCTANGENT": rough,
        "ROUGH_SLOPE": tuple(n * c for n, c in enumerate(rough) if n),
        "COSINE": short_series.taylor(0, 0.5, terms),
        "SPIN_COSINE": short_series.taylor(0, 1.0, short_series.SPIN_TERMS[dtype]),
        "SPIN_SINE": short_series.taylor(1, 1.0, short_series.SPIN_TERMS[dtype]),
        "SINE": tuple(0.5 * c for c in short_series.taylor(1, 0.5, terms)),
    }
    kind, integer = {"float64": ("double", "long long"), "float32": ("float", "int")}[dtype]
    lines = [f"#define REAL {kind}", f"#define INTEGER {integer}", f"#define VECTORS {vectors}"]
    lines.append(f"#define EPSILON {float(jnp.finfo(dtype).eps)!r}")
    first, more = lie_midpoint.STEPS[dtype]
    lines += [f"#define FIRST {first}", f"static const int MORE[] = {{{', '.join(map(str, more))}}};"]
    for name, table in tables.items():
        lines.append(f"static const REAL {name}[] = {{{', '.join(map(repr, table))}}};")
    return "\n".join(lines) + "\n"


@cache
def built(dtype: str, vectors: int) -> Path:
    """The path of the compiled program; if compiling fails, a RuntimeError with the compiler's message."""
    folder = Path(tempfile.mkdtemp(prefix="midlie-limit-"))
    (folder / "limit.h").write_text(header(dtype, vectors))
    shutil.copy(SOURCE, folder)
    compiler = os.environ.get("CC", "cc")
    result = subprocess.run(
        [compiler, *FLAGS, "-o", "limit", "limit.c", "-lm"], cwd=folder, capture_output=True, text=True, check=False
    )
    if result.returncode:
        raise RuntimeError(f"{compiler} failed to compile {SOURCE.name}: {result.stderr.strip()}")
    return folder / "limit"


def measured(method: str, dtype: str, vectors: int, cores: int, bodies: int, steps: int) -> tuple[float, list[float]]:
    """Seconds a body-step, and the momentum of the first top at the end."""
    environment = {**os.environ, "OMP_NUM_THREADS": str(cores)}
    command = [str(built(dtype, vectors)), method, str(bodies), str(steps)]
    words = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()
    return float(words[0]), [float(word) for word in words[1:]]


def limit(method: str, dtype: str, cores: int = 1, bodies: int = 4096, steps: int = 400) -> float:
    """Seconds a body-step with the faster number of vectors."""
    return min(measured(method, dtype, vectors, cores, bodies, steps)[0] for vectors in (1, 2))


def main() -> None:
    for method in ("LIEMID", "LIEMID-EARLY", "SYMMETRIC"):
        for dtype in ("float64", "float32"):
            for cores in (1,):
                for vectors in (1, 2):
                    cost, momentum = measured(method, dtype, vectors, cores, 4096, 400)
                    print(f"{method}[EA] {dtype} {cores} cores, {vectors} vectors: {1e-6 / cost:.1f} M/s", momentum)


if __name__ == "__main__":
    main()
