"""The speed limit, hand-written C: builds `limit.c` in several forms with the machine's compilers and times it.

    python benchmarks/limit.py      prints the body-steps a second of the best form for each method and dtype, one core

The polynomials and tableaus of midlie_jax are written to a header, so that both compute the same. A form says how many
vector registers hold one number of a group of tops, how many groups take each step in turn, whose square roots and
divisions are used, and whether the compiler may reorder sums; the head of `limit.c` says why each matters.
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp

from midlie_jax._math import components, short_series, weierstrass
from midlie_jax.integrators.flights import jacobi, lie_midpoint
from midlie_jax.integrators.runge_kutta import DOP853, Tableau

SOURCES = tuple(Path(__file__).parent.glob("limit*.[ch]*"))
FLAGS = ("-O3", "-march=native", "-ffast-math", "-std=gnu11", "-Wno-psabi")
METHODS = ("LIEMID", "LIEMID_EARLY", "JACOBI", "SYMMETRIC", "DOP853")
MOMENTS, WEIGHT, DT = (5.0, 5.0, 1.0), 20.0, 0.005


class Form(NamedTuple):
    vectors: int
    groups: int
    hardware_roots: bool = True
    reorders_sums: bool = True

    def __str__(self) -> str:
        roots = "the machine's roots" if self.hardware_roots else "Newton's roots"
        sums = "sums reordered" if self.reorders_sums else "sums as written"
        return f"{self.vectors} vectors, {self.groups} groups, {roots}, {sums}"


class Limit(NamedTuple):
    """The fastest form of a method: seconds a body-step, and what was built with which compiler."""

    cost: float
    compiler: str
    form: Form


@cache
def compilers() -> tuple[str, ...]:
    found = {}
    for name in (os.environ.get("CC", "cc"), "gcc", "clang"):
        path = shutil.which(name)
        if path is None:
            continue
        version = subprocess.run([path, "--version"], capture_output=True, text=True, check=False).stdout
        words = version.partition("\n")[0].split()[1:]  # the first word is the name by which it was called
        command = [path, *FLAGS, "-fsyntax-only", "-x", "c", "-"]
        works = subprocess.run(command, input="#include <math.h>\n", capture_output=True, text=True, check=False)
        if works.returncode == 0:
            found.setdefault(" ".join(words) or os.path.realpath(path), path)
    return tuple(found.values())


@cache
def extra_flags(compiler: str) -> tuple[str, ...]:
    """Flags without which the compiler would leave half of a vector register empty."""
    command = [compiler, *FLAGS, "-dM", "-E", "-x", "c", "-"]
    macros = subprocess.run(command, input="", capture_output=True, text=True, check=True).stdout
    return ("-mprefer-vector-width=512",) if "__AVX512F__" in macros else ()


def header(dtype: str) -> str:
    rough = short_series.FEW_ARCTANGENT[dtype]
    cosine, sine = short_series.half_angle_polynomials(dtype)
    spin_terms = short_series.SPIN_TERMS[dtype]
    tables = {
        "ARCTANGENT": short_series.ARCTANGENT[dtype],
        "ROUGH_ARCTANGENT": rough,
        "ROUGH_SLOPE": tuple(n * c for n, c in enumerate(rough) if n),
        "COSINE": cosine,
        "SPIN_COSINE": short_series.economised(0, spin_terms),
        "SPIN_SINE": short_series.economised(1, spin_terms),
        "SINE": sine,
    }
    epsilon = float(jnp.finfo(dtype).eps)
    first, more = lie_midpoint.STEPS[dtype]
    _, reciprocal_magic, reciprocal_steps = components._RECIPROCAL[dtype]
    _, root_magic, root_steps = components._ROOT[dtype]
    kind, integer = {"float64": ("double", "long long"), "float32": ("float", "int")}[dtype]
    defined = {
        "REAL": kind,
        "INTEGER": integer,
        "EPSILON": repr(epsilon),
        "FIRST": first,
        "RECIPROCAL_MAGIC": reciprocal_magic,
        "RECIPROCAL_STEPS": reciprocal_steps,
        "ROOT_MAGIC": root_magic,
        "ROOT_STEPS": root_steps,
    }
    names = ("SIGMA", "SIGMA_SQUARED_WP", "SIGMA_ODD")
    for name, table in zip(names, weierstrass.step_tables(jacobi.LARGEST_TURN, epsilon), strict=True):
        defined[f"{name}(p, g2, g3)"] = _horner(table, ("g3", "g2", "p"))
    table = DOP853.formula
    assert isinstance(table, Tableau)
    rows = {f"STAGE_{n}": row for n, row in enumerate(table.stages) if row}
    for name, row in {**rows, "STEP": table.weights}.items():
        defined[f"{name}(k)"] = _sum(f"(REAL){weight!r} * k({n})" for n, weight in row.items())
    lines = [f"#define {name} {value}" for name, value in defined.items()]
    lines.append(f"TABLE int MORE[] = {{{', '.join(map(str, more))}}};")
    for name, table in tables.items():
        lines.append(f"TABLE REAL {name}[] = {{{', '.join(map(repr, table))}}};")
    return "\n".join(lines) + "\n"


def _sum(terms: Iterable[str]) -> str:
    return f"({' + '.join(terms)})"


def _horner(table: Any, variables: tuple[str, ...]) -> str:
    """The polynomial with these nested coefficients, as C, by Horner's rule in each variable."""
    if isinstance(table, float):
        return f"(REAL){table!r}"
    *parts, total = (_horner(part, variables[1:]) for part in table)
    for part in reversed(parts):
        total = f"({part} + {variables[0]} * {total})"
    return total


@cache
def built(method: str, dtype: str, form: Form, compiler: str) -> Path:
    names = {
        "METHOD": method,
        "VECTORS": form.vectors,
        "GROUPS": form.groups,
        "HARDWARE_ROOTS": int(form.hardware_roots),
    }
    order = () if form.reorders_sums else ("-fno-associative-math",)
    options = [*FLAGS, *order, *extra_flags(compiler), *(f"-D{name}={value}" for name, value in names.items())]
    return _compiled([compiler, *options, "-o", "limit", "limit.c", "-lm"], _sources(dtype))


def _sources(dtype: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="midlie-limit-"))
    (folder / "limit.h").write_text(header(dtype))
    for source in SOURCES:
        shutil.copy(source, folder)
    return folder


def _compiled(command: list[str], folder: Path) -> Path:
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(f"{command[0]} failed to compile {command[-1]}: {result.stderr.strip()}")
    return folder / "limit"


@cache
def built_for_gpu(method: str, dtype: str, rough: bool) -> Path:
    folder = _sources(dtype)
    options = ["-O3", "-arch=native", "-std=c++20", f"-DMETHOD={method}", *(["--use_fast_math"] if rough else [])]
    return _compiled(["nvcc", *options, "-o", "limit", "limit.cu"], folder)


def measured(program: Path, bodies: int, steps: int, moments=MOMENTS, weight=WEIGHT) -> tuple[float, list[float]]:
    command = [str(program), *map(repr, (bodies, steps, DT, *moments, weight))]
    words = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    return float(words[0]), [float(word) for word in words[1:]]


@cache
def best(method: str, dtype: str) -> Limit:
    """The fastest form: for each compiler the best numbers of vectors and groups, then the other choices one by one."""

    def tried(form: Form, compiler: str) -> Limit:
        program = built(method, dtype, form, compiler)
        return Limit(min(measured(program, 4096, 100)[0] for _ in range(3)), compiler, form)

    found = []
    for compiler in compilers():
        fastest = min(tried(Form(vectors, groups), compiler) for vectors, groups in product((1, 2, 4), (1, 8)))
        for change in ({"hardware_roots": False}, {"reorders_sums": False}):
            fastest = min(fastest, tried(fastest.form._replace(**change), compiler))
        found.append(fastest)
    return min(found)


def limit(method: str, dtype: str, bodies: int = 4096, steps: int = 400) -> float:
    """Seconds a body-step of the best form, measured now.

    The fastest of three processes: where their stacks happen to lie in memory changes the speed by up to a half.
    """
    _, compiler, form = best(method, dtype)
    return min(measured(built(method, dtype, form, compiler), bodies, steps)[0] for _ in range(3))


def main() -> None:
    for method, dtype in product(METHODS, ("float64", "float32")):
        cost, compiler, form = best(method, dtype)
        print(f"{method} {dtype}: {1e-6 / cost:.1f} M/s ({Path(compiler).name}, {form})", flush=True)


if __name__ == "__main__":
    main()
